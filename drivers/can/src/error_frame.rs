//! Error frames: what the kernel says of the bus and of the controller on it.
//!
//! An error frame is made by the kernel and never was on the wire. Its identifier is a set of
//! classes, several at once being normal, and its data says more about each
//! (Linux, `include/uapi/linux/can/error.h`). [`ErrorFrame::state_after`] is the transition function
//! of a port's [`ControllerState`].

use crate::{ControllerState, Frame};

const CONTROLLER: u32 = 0x004;
const BUS_OFF: u32 = 0x040;
const RESTARTED: u32 = 0x100;

/// What a controller says of itself (`CAN_ERR_CRTL_*`), several flags at once being normal.
const WARNING: u8 = 0x0C;
const PASSIVE: u8 = 0x30;
const ACTIVE: u8 = 0x40;

/// A decoded error frame: what it says of the controller's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ErrorFrame {
    classes: u32,
    /// Zero unless the class [`CONTROLLER`] is among the classes.
    controller: u8,
}

impl ErrorFrame {
    /// `None` unless the kernel made `frame` to report an error.
    ///
    /// Other classes are ignored; data that is not there reads as zero.
    pub fn parse(frame: &Frame) -> Option<Self> {
        let classes = frame.raw_id();
        let controller = frame.data().get(1).copied();
        frame.is_error().then_some(Self {
            classes,
            controller: controller
                .filter(|_| classes & CONTROLLER != 0)
                .unwrap_or(0),
        })
    }

    /// The controller's state once this frame was seen.
    ///
    /// An error frame with a state has the whole state. The state before matters only for a frame without a state. Of
    /// several statements in one frame the worst holds.
    pub fn state_after(&self, before: ControllerState) -> ControllerState {
        if self.classes & BUS_OFF != 0 {
            ControllerState::BusOff
        } else if self.controller & PASSIVE != 0 {
            ControllerState::Passive
        } else if self.controller & WARNING != 0 {
            ControllerState::Warning
        } else if self.classes & RESTARTED != 0 || self.controller & ACTIVE != 0 {
            ControllerState::Active
        } else {
            before
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(classes: u32, data: [u8; 8]) -> ErrorFrame {
        let frame = Frame::from_raw(0x2000_0000 | classes, 8, data).unwrap();
        ErrorFrame::parse(&frame).unwrap()
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
            assert_eq!(
                frame.state_after(before),
                after,
                "{classes:#05x}, {flags:#04x}"
            );
        }
    }

    #[test]
    fn the_kernel_of_a_serial_adapter_reports_a_warning_so() {
        let frame = error(0x204, [0, 0x0C, 0, 0, 0, 0, 96, 0]);
        assert_eq!(
            frame.state_after(ControllerState::Active),
            ControllerState::Warning
        );
    }

    #[test]
    fn a_frame_from_the_bus_is_no_error_frame() {
        let frame = Frame::from_raw(0x004, 8, [0; 8]).unwrap();
        assert_eq!(ErrorFrame::parse(&frame), None);
    }
}
