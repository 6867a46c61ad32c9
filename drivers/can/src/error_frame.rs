//! Error frames: what the kernel says of the bus and of the controller on it.
//!
//! An error frame is made by the kernel and never was on the wire. Its identifier is a set of
//! classes, several at once being normal, and its data says more about each
//! (Linux, `include/uapi/linux/can/error.h`).

use crate::{ControllerState, Frame};

const CONTROLLER: u32 = 0x004;
const BUS_OFF: u32 = 0x040;
const RESTARTED: u32 = 0x100;

/// What a controller says of itself (`CAN_ERR_CRTL_*`), several flags at once being normal.
const WARNING: u8 = 0x0C;
const PASSIVE: u8 = 0x30;
const ACTIVE: u8 = 0x40;

/// The state of a port's controller once an error frame was seen; `None` unless the kernel made `frame` to report an
/// error.
///
/// An error frame with a state has the whole state. The state before matters only for a frame without a state. Of
/// several statements in one frame the worst holds. Other classes are ignored; data that is not there reads as zero.
pub(crate) fn state_after(frame: &Frame, before: ControllerState) -> Option<ControllerState> {
    if !frame.is_error() {
        return None;
    }
    let has = |class| frame.raw_id() & class != 0;
    let flags = frame.data().get(1).filter(|_| has(CONTROLLER));
    let says = |flag| flags.is_some_and(|flags| flags & flag != 0);
    Some(if has(BUS_OFF) {
        ControllerState::BusOff
    } else if says(PASSIVE) {
        ControllerState::Passive
    } else if says(WARNING) {
        ControllerState::Warning
    } else if has(RESTARTED) || says(ACTIVE) {
        ControllerState::Active
    } else {
        before
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(classes: u32, data: [u8; 8]) -> Frame {
        Frame::from_raw(0x2000_0000 | classes, 8, data).unwrap()
    }

    #[test]
    fn the_state_follows_what_the_frame_states() {
        use ControllerState::{Active, BusOff, Passive, Warning};
        // Classes, controller flags, state before, state after.
        let cases = [
            (0x004, 0x04, Active, Warning),
            (0x004, 0x08, Active, Warning),
            (0x004, 0x10, Warning, Passive),
            (0x004, 0x20, Active, Passive),
            (0x004, 0x18, Active, Passive),
            (0x004, 0x08, Passive, Warning),
            (0x004, 0x40, Passive, Active),
            (0x004, 0x01, Passive, Passive),
            (0x040, 0x00, Passive, BusOff),
            (0x044, 0x20, Passive, BusOff),
            (0x100, 0x00, BusOff, Active),
            (0x104, 0x08, BusOff, Warning),
            (0x088, 0x40, Warning, Warning),
            (0x020, 0x00, BusOff, BusOff),
        ];
        for (classes, flags, before, after) in cases {
            let frame = error(classes, [0, flags, 0, 0, 0, 0, 0, 0]);
            assert_eq!(state_after(&frame, before), Some(after), "{classes:#05x}, {flags:#04x}");
        }
    }

    #[test]
    fn the_kernel_of_a_serial_adapter_reports_a_warning_so() {
        let frame = error(0x204, [0, 0x0C, 0, 0, 0, 0, 96, 0]);
        assert_eq!(state_after(&frame, ControllerState::Active), Some(ControllerState::Warning));
    }

    #[test]
    fn a_frame_from_the_bus_is_no_error_frame() {
        let frame = Frame::from_raw(0x004, 8, [0; 8]).unwrap();
        assert_eq!(state_after(&frame, ControllerState::Active), None);
    }
}
