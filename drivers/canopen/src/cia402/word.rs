//! Controlword and statusword (CiA 402-2 §8.4.1, §8.4.2).

use std::fmt;

/// Power state of a drive by its statusword (CiA 402-2 §8.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PowerState {
    /// Self-test after power-on.
    NotReadyToSwitchOn,
    /// The power stage may not be switched on yet.
    SwitchOnDisabled,
    /// The drive waits for the command switch on.
    ReadyToSwitchOn,
    /// Power is on, no torque.
    SwitchedOn,
    /// Torque.
    OperationEnabled,
    /// Braking by quick stop, or standing after it.
    QuickStopActive,
    /// Braking because of a fault.
    FaultReactionActive,
    /// No torque, latched until a fault reset.
    Fault,
    /// A pattern that CiA 402 does not know.
    Unknown,
}

impl PowerState {
    /// The state bits of the statusword, bits 0 to 3, 5 and 6; `None` for the unknown state.
    ///
    /// Bit 4 (voltage enabled) and the rest are the device's to add.
    pub const fn bits(self) -> Option<Statusword> {
        Some(Statusword(match self {
            Self::NotReadyToSwitchOn => 0x00,
            Self::SwitchOnDisabled => 0x40,
            Self::ReadyToSwitchOn => 0x21,
            Self::SwitchedOn => 0x23,
            Self::OperationEnabled => 0x27,
            Self::QuickStopActive => 0x07,
            Self::FaultReactionActive => 0x0F,
            Self::Fault => 0x08,
            Self::Unknown => return None,
        }))
    }
}

impl fmt::Display for PowerState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotReadyToSwitchOn => "not ready to switch on",
            Self::SwitchOnDisabled => "switch on disabled",
            Self::ReadyToSwitchOn => "ready to switch on",
            Self::SwitchedOn => "switched on",
            Self::OperationEnabled => "operation enabled",
            Self::QuickStopActive => "quick stop active",
            Self::FaultReactionActive => "fault reaction active",
            Self::Fault => "fault",
            Self::Unknown => "unknown power state",
        })
    }
}

/// Statusword, object 0x6041.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Statusword(pub u16);

impl Statusword {
    /// The drive feeds its power stage (bit 4).
    pub const VOLTAGE_ENABLED: u16 = 1 << 4;
    /// A warning is present (bit 7).
    pub const WARNING: u16 = 1 << 7;
    /// The controlword is obeyed (bit 9).
    pub const REMOTE: u16 = 1 << 9;
    /// The target is reached, or after halt the axis stands (bit 10).
    pub const TARGET_REACHED: u16 = 1 << 10;
    /// A limit inside the drive is in force (bit 11).
    pub const INTERNAL_LIMIT: u16 = 1 << 11;
    /// Bit 12, whose meaning depends on the mode of operation.
    pub const MODE_SPECIFIC_12: u16 = 1 << 12;
    /// Bit 13, whose meaning depends on the mode of operation.
    pub const MODE_SPECIFIC_13: u16 = 1 << 13;
    /// EPOS2 and EPOS4: the position is referenced to home (bit 15).
    pub const EPOS_REFERENCED: u16 = 1 << 15;

    /// The power state, by the masks of CiA 402-2 §8.4.2.
    ///
    /// The masks leave out bits 4, 8, 14 and 15, so EPOS2's words on the way from switched on to
    /// operation enabled (0x4123 and 0x4133, bit 14 set during refresh) are switched on.
    pub const fn power_state(self) -> PowerState {
        match self.0 & 0x4F {
            0x00 => return PowerState::NotReadyToSwitchOn,
            0x40 => return PowerState::SwitchOnDisabled,
            0x0F => return PowerState::FaultReactionActive,
            0x08 => return PowerState::Fault,
            _ => {}
        }
        match self.0 & 0x6F {
            0x21 => PowerState::ReadyToSwitchOn,
            0x23 => PowerState::SwitchedOn,
            0x27 => PowerState::OperationEnabled,
            0x07 => PowerState::QuickStopActive,
            _ => PowerState::Unknown,
        }
    }

    /// Whether all bits of `mask` are set.
    pub const fn has(self, mask: u16) -> bool {
        self.0 & mask == mask
    }

    /// The same with the bits of `mask` set or cleared.
    pub const fn with(self, mask: u16, set: bool) -> Self {
        Self(if set { self.0 | mask } else { self.0 & !mask })
    }

    /// Whether the target is reached; in homing mode read [`HomingStatus::of`](super::HomingStatus::of) instead.
    pub const fn target_reached(self) -> bool {
        self.has(Self::TARGET_REACHED)
    }
}

/// Controlword, object 0x6040.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Controlword(pub u16);

impl Controlword {
    /// Bit 1 clear: power off at once, from any state but the faults.
    pub const DISABLE_VOLTAGE: Self = Self(0x0000);
    /// Bit 2 clear: brake by option 0x605A (CiA 402-2 §8.4.5).
    pub const QUICK_STOP: Self = Self(0x0002);
    /// To ready to switch on.
    pub const SHUTDOWN: Self = Self(0x0006);
    /// To switched on. In operation enabled the same word disables operation.
    pub const SWITCH_ON: Self = Self(0x0007);
    /// To operation enabled.
    pub const ENABLE_OPERATION: Self = Self(0x000F);
    /// Clears a fault at the rising edge of bit 7.
    pub const FAULT_RESET: Self = Self(0x0080);

    /// Bit 4: homing runs; new set-point in profile position; interpolation active.
    pub const START: u16 = 1 << 4;
    /// Bit 5 of profile position: do not wait for the last set-point.
    pub const CHANGE_IMMEDIATELY: u16 = 1 << 5;
    /// Bit 6 of profile position: the target is relative.
    pub const RELATIVE: u16 = 1 << 6;
    /// Bit 7: fault reset.
    pub const RESET: u16 = 1 << 7;
    /// Bit 8: stop by option 0x605D (CiA 402-2 §8.4.8).
    pub const HALT: u16 = 1 << 8;

    /// Whether all bits of `mask` are set.
    pub const fn has(self, mask: u16) -> bool {
        self.0 & mask == mask
    }

    /// The same with the bits of `mask` set or cleared.
    pub const fn with(self, mask: u16, set: bool) -> Self {
        Self(if set { self.0 | mask } else { self.0 & !mask })
    }

    /// The command to the power state machine in bits 0 to 3, as a device reads it.
    ///
    /// Bit 7 is not part of the command. A fault reset is the rising edge of bit 7, which shows in two successive words.
    pub const fn power_command(self) -> PowerCommand {
        match self.0 & 0x0F {
            word if word & 0b0010 == 0 => PowerCommand::DisableVoltage,
            word if word & 0b0100 == 0 => PowerCommand::QuickStop,
            0b0111 => PowerCommand::SwitchOn,
            0b1111 => PowerCommand::EnableOperation,
            _ => PowerCommand::Shutdown,
        }
    }
}

/// Command to the power state machine in the low bits of a controlword (CiA 402-2 §8.4.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PowerCommand {
    /// Bit 1 is clear.
    DisableVoltage,
    /// Bit 1 is set, bit 2 clear.
    QuickStop,
    /// Bits 1 and 2 are set, bit 0 clear.
    Shutdown,
    /// Bits 0 to 2 are set, bit 3 clear; in operation enabled it means disable operation.
    SwitchOn,
    /// Bits 0 to 3 are set.
    EnableOperation,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statuswords_decode_by_the_mask_table() {
        use PowerState::*;
        let table = [
            (0x0000, NotReadyToSwitchOn),
            (0x0040, SwitchOnDisabled),
            (0x0740, SwitchOnDisabled),
            (0x0060, SwitchOnDisabled),
            (0x0021, ReadyToSwitchOn),
            (0x0721, ReadyToSwitchOn),
            (0x0023, SwitchedOn),
            (0x0723, SwitchedOn),
            (0x4123, SwitchedOn),
            (0x4133, SwitchedOn),
            (0x0137, OperationEnabled),
            (0x0737, OperationEnabled),
            (0x8737, OperationEnabled),
            (0x0117, QuickStopActive),
            (0x010F, FaultReactionActive),
            (0x011F, FaultReactionActive),
            (0x002F, FaultReactionActive),
            (0x0108, Fault),
            (0x0128, Fault),
            (0x0001, Unknown),
            (0x0003, Unknown),
            (0x0061, Unknown),
            (0x004F, Unknown),
        ];
        for (raw, state) in table {
            assert_eq!(Statusword(raw).power_state(), state, "{raw:#06x}");
        }
    }

    #[test]
    fn every_known_state_encodes_to_bits_that_decode_to_it() {
        use PowerState::*;
        let known = [
            NotReadyToSwitchOn,
            SwitchOnDisabled,
            ReadyToSwitchOn,
            SwitchedOn,
            OperationEnabled,
            QuickStopActive,
            FaultReactionActive,
            Fault,
        ];
        for state in known {
            assert_eq!(state.bits().map(Statusword::power_state), Some(state));
        }
        assert_eq!(Unknown.bits(), None);
    }

    #[test]
    fn controlwords_decode_to_the_command_they_encode() {
        use PowerCommand::*;
        let table = [
            (Controlword::DISABLE_VOLTAGE, DisableVoltage),
            (Controlword::QUICK_STOP, QuickStop),
            (Controlword::SHUTDOWN, Shutdown),
            (Controlword::SWITCH_ON, SwitchOn),
            (Controlword::ENABLE_OPERATION, EnableOperation),
            (Controlword(0x001F), EnableOperation),
            (Controlword(0x010F), EnableOperation),
            (Controlword(0x000D), DisableVoltage),
            (Controlword(0x000B), QuickStop),
            (Controlword(0x000E), Shutdown),
        ];
        for (word, command) in table {
            assert_eq!(word.power_command(), command, "{word:?}");
        }
    }
}
