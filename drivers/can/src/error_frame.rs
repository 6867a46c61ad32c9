//! Error frames: reports of the kernel about the bus and the CAN controller.
//!
//! The kernel makes error frames; they were never on the wire. The identifier is a bit set of
//! error classes, and the data bytes give details of each class
//! (Linux, `include/uapi/linux/can/error.h`).

use crate::{ControllerState, Frame};

const CONTROLLER: u32 = 0x004;
const BUS_OFF: u32 = 0x040;
const RESTARTED: u32 = 0x100;

/// State flags of the controller, data byte 1 (`CAN_ERR_CRTL_*`). Several may be set.
const WARNING: u8 = 0x0C;
const PASSIVE: u8 = 0x30;
const ACTIVE: u8 = 0x40;

/// State of a port's controller after `frame`; `None` if `frame` is not an error frame.
///
/// The worst state in the frame holds. A frame without a state leaves the state `before`. Other classes are ignored.
/// Missing data bytes count as zero.
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
