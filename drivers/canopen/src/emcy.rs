//! EMCY (CiA 301 §7.2.7): the frame that a node sends when an error appears, and again when the error has gone.

use can::Frame;

use crate::{NodeId, cob, frame};

/// An EMCY frame, `080 + node#code register vendor`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Emergency {
    /// The sender.
    pub node: NodeId,
    /// Error code. 0x0000 means that an error has gone. [`crate::cia402::FaultTable`] has the texts.
    pub code: u16,
    /// Object 0x1001.
    pub error_register: ErrorRegister,
    /// Five bytes with a meaning of the vendor.
    pub vendor: [u8; 5],
}

impl Emergency {
    /// The frame.
    pub fn encode(self) -> Frame {
        let [low, high] = self.code.to_le_bytes();
        let [a, b, c, d, e] = self.vendor;
        frame(cob::emcy(self.node), [low, high, self.error_register.0, a, b, c, d, e])
    }

    /// `None` for other frames and lengths other than 8.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let cob::Function::Emcy(node) = cob::Function::of(frame.standard_data_id()?)? else {
            return None;
        };
        let &[low, high, register, a, b, c, d, e] = frame.data() else {
            return None;
        };
        Some(Self {
            node,
            code: u16::from_le_bytes([low, high]),
            error_register: ErrorRegister(register),
            vendor: [a, b, c, d, e],
        })
    }

    /// Whether the frame reports the end of an error.
    pub fn is_reset(&self) -> bool {
        self.code & 0xFF00 == 0
    }

    /// Whether the error leaves the function of the device as it is: lost frames (0x8110) and error passive (0x8120)
    /// concern the bus only, and their consequences have faults of their own. Any other code, also an unknown one, reports
    /// an error of the device (CiA 301 §7.2.7.1).
    pub fn leaves_device_working(&self) -> bool {
        matches!(self.code, 0x8110 | 0x8120)
    }
}

/// Object 0x1001 (CiA 301 §7.5.2.2): the kinds of error that are present.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErrorRegister(pub u8);

impl ErrorRegister {
    /// Any error.
    pub const GENERIC: Self = Self(1 << 0);
    /// Current.
    pub const CURRENT: Self = Self(1 << 1);
    /// Voltage.
    pub const VOLTAGE: Self = Self(1 << 2);
    /// Temperature.
    pub const TEMPERATURE: Self = Self(1 << 3);
    /// Communication.
    pub const COMMUNICATION: Self = Self(1 << 4);
    /// Specific to the device profile.
    pub const DEVICE_PROFILE: Self = Self(1 << 5);
    /// Specific to the vendor.
    pub const VENDOR: Self = Self(1 << 7);

    /// Whether all bits of `other` are set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// The bits of both.
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_emergency_is_code_register_and_five_vendor_bytes() {
        let emergency = Emergency {
            node: NodeId::new(3).unwrap(),
            code: 0x8611,
            error_register: ErrorRegister::GENERIC.with(ErrorRegister::DEVICE_PROFILE),
            vendor: [1, 2, 3, 4, 5],
        };
        assert_eq!(emergency.encode().to_string(), "083#1186210102030405");
        assert_eq!(Emergency::decode(&emergency.encode()), Some(emergency));
        assert!(emergency.error_register.contains(ErrorRegister::DEVICE_PROFILE));
        assert!(!emergency.error_register.contains(ErrorRegister::VOLTAGE));
        assert!(!emergency.is_reset());
    }

    #[test]
    fn errors_of_the_bus_alone_leave_the_device_working() {
        let of =
            |code| Emergency { node: NodeId::new(3).unwrap(), code, error_register: ErrorRegister(0), vendor: [0; 5] };
        for code in [0x8110, 0x8120] {
            assert!(of(code).leaves_device_working(), "{code:#06x}");
        }
        for code in
            [0x1000, 0x2310, 0x3210, 0x4210, 0x5000, 0x6100, 0x7300, 0x8130, 0x8140, 0x8250, 0x8611, 0x9000, 0xFF01]
        {
            assert!(!of(code).leaves_device_working(), "{code:#06x}");
        }
    }

    #[test]
    fn sync_and_short_frames_are_no_emergencies() {
        assert_eq!(Emergency::decode(&Frame::new(cob::SYNC, &[0; 8]).unwrap()), None);
        let id = cob::emcy(NodeId::new(3).unwrap());
        for length in 0..8 {
            assert_eq!(Emergency::decode(&Frame::new(id, &[0; 8][..length]).unwrap()), None);
        }
    }
}
