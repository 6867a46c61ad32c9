//! Error frames: what the kernel says of the bus and of the controller on it.
//!
//! An error frame is made by the kernel and never was on the wire. Its identifier is a set of
//! classes, several at once being normal, and its data says more about each
//! (Linux, `include/uapi/linux/can/error.h`). [`ErrorFrame::state_after`] is the transition function
//! of a port's [`ControllerState`].

use std::fmt;

use crate::{ControllerState, Frame};

const TX_TIMEOUT: u32 = 0x001;
const LOST_ARBITRATION: u32 = 0x002;
const CONTROLLER: u32 = 0x004;
const PROTOCOL: u32 = 0x008;
const TRANSCEIVER: u32 = 0x010;
const NO_ACKNOWLEDGE: u32 = 0x020;
const BUS_OFF: u32 = 0x040;
const BUS_ERROR: u32 = 0x080;
const RESTARTED: u32 = 0x100;
const COUNTS: u32 = 0x200;
const ALL_CLASSES: u32 = 0x1FFF_FFFF;

/// A decoded error frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ErrorFrame {
    classes: u32,
    data: [u8; 8],
}

impl ErrorFrame {
    /// `None` unless the kernel made `frame` to report an error.
    ///
    /// Classes that a later kernel may add are kept and ignored; data that is not there reads as zero.
    pub fn parse(frame: &Frame) -> Option<Self> {
        if !frame.is_error() {
            return None;
        }
        let mut data = [0; 8];
        let given = frame.data();
        data[..given.len()].copy_from_slice(given);
        Some(Self {
            classes: frame.raw_id() & ALL_CLASSES,
            data,
        })
    }

    /// The driver gave up on a frame.
    pub fn tx_timeout(&self) -> bool {
        self.has(TX_TIMEOUT)
    }

    /// What the controller says of itself.
    pub fn controller(&self) -> Option<ControllerFlags> {
        self.has(CONTROLLER)
            .then_some(ControllerFlags(self.data[1]))
    }

    /// Nobody acknowledged a frame: no other node is listening.
    pub fn no_acknowledge(&self) -> bool {
        self.has(NO_ACKNOWLEDGE)
    }

    /// The controller left the bus.
    pub fn bus_off(&self) -> bool {
        self.has(BUS_OFF)
    }

    /// An error on the bus; a broken bus makes floods of them.
    pub fn bus_error(&self) -> bool {
        self.has(BUS_ERROR)
    }

    /// The controller takes part in the bus again after bus-off.
    pub fn restarted(&self) -> bool {
        self.has(RESTARTED)
    }

    /// The controller's error counters, from kernels and drivers that give them.
    pub fn counts(&self) -> Option<ErrorCounts> {
        self.has(COUNTS).then_some(ErrorCounts {
            transmit: self.data[6],
            receive: self.data[7],
        })
    }

    /// The controller's state once this frame was seen.
    ///
    /// An error frame with a state has the whole state. The state before matters only for a frame without a state. Of
    /// several statements in one frame the worst holds.
    pub fn state_after(&self, before: ControllerState) -> ControllerState {
        let controller = self.controller().unwrap_or_default();
        if self.bus_off() {
            ControllerState::BusOff
        } else if controller.0 & ControllerFlags::PASSIVE != 0 {
            ControllerState::Passive
        } else if controller.0 & ControllerFlags::WARNING != 0 {
            ControllerState::Warning
        } else if self.restarted() || controller.0 & ControllerFlags::ACTIVE != 0 {
            ControllerState::Active
        } else {
            before
        }
    }

    fn has(&self, class: u32) -> bool {
        self.classes & class != 0
    }
}

/// What a controller says of itself (`CAN_ERR_CRTL_*`), several flags at once being normal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ControllerFlags(pub u8);

impl ControllerFlags {
    const WARNING: u8 = 0x0C;
    const PASSIVE: u8 = 0x30;
    const ACTIVE: u8 = 0x40;

    /// The controller's receive buffer overflowed: frames were lost before the kernel saw them.
    pub fn receive_overflow(self) -> bool {
        self.0 & 0x01 != 0
    }

    /// The controller's transmit buffer overflowed.
    pub fn transmit_overflow(self) -> bool {
        self.0 & 0x02 != 0
    }
}

/// The error counters of a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ErrorCounts {
    /// Transmit error counter.
    pub transmit: u8,
    /// Receive error counter.
    pub receive: u8,
}

/// The classes in words, then the counters: `controller passive, bus error; tx 128, rx 0`.
impl fmt::Display for ErrorFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let flags = self.controller().unwrap_or_default();
        let words = [
            (self.bus_off(), "bus-off"),
            (self.restarted(), "restarted"),
            (
                flags.0 & ControllerFlags::PASSIVE != 0,
                "controller passive",
            ),
            (
                flags.0 & ControllerFlags::WARNING != 0,
                "controller warning",
            ),
            (flags.0 & ControllerFlags::ACTIVE != 0, "controller active"),
            (flags.receive_overflow(), "receive overflow"),
            (flags.transmit_overflow(), "transmit overflow"),
            (self.no_acknowledge(), "no acknowledge"),
            (self.tx_timeout(), "transmit timeout"),
            (self.has(LOST_ARBITRATION), "lost arbitration"),
            (self.has(PROTOCOL), "protocol violation"),
            (self.has(TRANSCEIVER), "transceiver"),
            (self.bus_error(), "bus error"),
        ];
        let mut said = words
            .iter()
            .filter(|(holds, _)| *holds)
            .map(|(_, word)| word);
        write!(f, "{}", said.next().unwrap_or(&"error"))?;
        said.try_for_each(|word| write!(f, ", {word}"))?;
        match self.counts() {
            Some(ErrorCounts { transmit, receive }) => write!(f, "; tx {transmit}, rx {receive}"),
            None => Ok(()),
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
    fn each_class_reads_its_own_bytes() {
        let all = error(0x3FF, [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(all.controller(), Some(ControllerFlags(2)));
        assert_eq!(
            all.counts(),
            Some(ErrorCounts {
                transmit: 7,
                receive: 8
            })
        );
        assert!(all.tx_timeout() && all.no_acknowledge() && all.bus_error());

        let none = error(0, [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(none.controller(), None);
        assert_eq!(none.counts(), None);
    }

    #[test]
    fn the_kernel_of_a_serial_adapter_reports_a_warning_so() {
        let frame = error(0x204, [0, 0x0C, 0, 0, 0, 0, 96, 0]);
        assert_eq!(
            frame.state_after(ControllerState::Active),
            ControllerState::Warning
        );
        assert_eq!(frame.to_string(), "controller warning; tx 96, rx 0");
        assert_eq!(
            error(0x0E0, [0; 8]).to_string(),
            "bus-off, no acknowledge, bus error"
        );
        assert_eq!(error(0, [0; 8]).to_string(), "error");
    }

    #[test]
    fn a_frame_from_the_bus_is_no_error_frame() {
        let frame = Frame::from_raw(0x004, 8, [0; 8]).unwrap();
        assert_eq!(ErrorFrame::parse(&frame), None);
    }
}
