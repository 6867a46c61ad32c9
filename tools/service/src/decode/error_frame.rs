//! Text of error frames: reports of a kernel about the bus and its CAN controller.
//!
//! The identifier is a set of classes, and the data have the details of some of them (Linux,
//! `include/uapi/linux/can/error.h`).

use can::Frame;

/// Text of an error frame.
pub(super) fn text(frame: &Frame) -> String {
    let byte = |at: usize| frame.data().get(at).copied().unwrap_or_default();
    let classes = [
        (0x001, "transmission timed out".to_owned()),
        (0x002, "arbitration lost".to_owned()),
        (0x004, controller(byte(1))),
        (0x008, protocol(byte(2))),
        (0x010, "fault of the transceiver".to_owned()),
        (0x020, "no acknowledgement".to_owned()),
        (0x040, "bus-off".to_owned()),
        (0x080, "bus error".to_owned()),
        (0x100, "controller restarted".to_owned()),
        (0x200, format!("error counters: transmit {}, receive {}", byte(6), byte(7))),
    ];
    let texts = classes.into_iter().filter(|(class, _)| frame.raw_id() & class != 0).map(|(_, text)| text);
    let texts: Vec<_> = texts.collect();
    if texts.is_empty() { "no class is set".to_owned() } else { texts.join("; ") }
}

fn controller(flags: u8) -> String {
    let table = [
        (0x01, "receive overflow"),
        (0x02, "transmit overflow"),
        (0x04, "warning limit of receive errors"),
        (0x08, "warning limit of transmit errors"),
        (0x10, "error passive by receive errors"),
        (0x20, "error passive by transmit errors"),
        (0x40, "error active again"),
    ];
    listed("controller", flags, &table)
}

fn protocol(flags: u8) -> String {
    let table = [
        (0x01, "single bit"),
        (0x02, "frame format"),
        (0x04, "bit stuffing"),
        (0x08, "dominant bit not sent"),
        (0x10, "recessive bit not sent"),
        (0x20, "bus overload"),
        (0x40, "active error announced"),
        (0x80, "in transmission"),
    ];
    listed("protocol violation", flags, &table)
}

/// `what` and the names of the set flags.
fn listed(what: &str, flags: u8, table: &[(u8, &str)]) -> String {
    let names: Vec<_> = table.iter().filter(|(flag, _)| flags & flag != 0).map(|(_, name)| *name).collect();
    if names.is_empty() { what.to_owned() } else { format!("{what}: {}", names.join(", ")) }
}
