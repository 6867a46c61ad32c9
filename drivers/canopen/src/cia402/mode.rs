//! Modes of operation (CiA 402-2 §8.4.10 to §8.4.12).

use std::fmt;

/// Mode of operation of a drive, objects 0x6060 (commanded) and 0x6061 (shown).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ModeOfOperation {
    /// No mode (0).
    None,
    /// Profile position, PP (1).
    ProfilePosition,
    /// Velocity, VL (2), of frequency converters.
    Velocity,
    /// Profile velocity, PV (3).
    ProfileVelocity,
    /// Profile torque, PT (4).
    ProfileTorque,
    /// Homing, HM (6).
    Homing,
    /// Interpolated position, IP (7).
    InterpolatedPosition,
    /// Cyclic synchronous position, CSP (8).
    CyclicSynchronousPosition,
    /// Cyclic synchronous velocity, CSV (9).
    CyclicSynchronousVelocity,
    /// Cyclic synchronous torque, CST (10).
    CyclicSynchronousTorque,
    /// A mode of the vendor (negative), or an unknown mode.
    Other(i8),
}

impl ModeOfOperation {
    /// The value of object 0x6060.
    pub const fn raw(self) -> i8 {
        match self {
            Self::None => 0,
            Self::ProfilePosition => 1,
            Self::Velocity => 2,
            Self::ProfileVelocity => 3,
            Self::ProfileTorque => 4,
            Self::Homing => 6,
            Self::InterpolatedPosition => 7,
            Self::CyclicSynchronousPosition => 8,
            Self::CyclicSynchronousVelocity => 9,
            Self::CyclicSynchronousTorque => 10,
            Self::Other(raw) => raw,
        }
    }

    /// From the value of object 0x6061.
    pub const fn from_raw(raw: i8) -> Self {
        match raw {
            0 => Self::None,
            1 => Self::ProfilePosition,
            2 => Self::Velocity,
            3 => Self::ProfileVelocity,
            4 => Self::ProfileTorque,
            6 => Self::Homing,
            7 => Self::InterpolatedPosition,
            8 => Self::CyclicSynchronousPosition,
            9 => Self::CyclicSynchronousVelocity,
            10 => Self::CyclicSynchronousTorque,
            raw => Self::Other(raw),
        }
    }
}

impl fmt::Display for ModeOfOperation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::None => "no mode",
            Self::ProfilePosition => "profile position",
            Self::Velocity => "velocity",
            Self::ProfileVelocity => "profile velocity",
            Self::ProfileTorque => "profile torque",
            Self::Homing => "homing",
            Self::InterpolatedPosition => "interpolated position",
            Self::CyclicSynchronousPosition => "cyclic synchronous position",
            Self::CyclicSynchronousVelocity => "cyclic synchronous velocity",
            Self::CyclicSynchronousTorque => "cyclic synchronous torque",
            Self::Other(raw) => return write!(f, "mode {raw}"),
        })
    }
}

/// Object 0x6502: the modes that a drive supports (CiA 402-2 §8.4.12).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SupportedModes(pub u32);

impl SupportedModes {
    /// EPOS4: PP, PV, HM, CSP, CSV, CST.
    pub const EPOS4: Self = Self(0x0000_03A5);

    /// Whether the drive has `mode`; the object says nothing of vendors' modes, so `false` for them.
    pub const fn contains(self, mode: ModeOfOperation) -> bool {
        self.0 & Self::bit(mode) != 0
    }

    /// Modes 1 to 10 have bits 0 to 9.
    const fn bit(mode: ModeOfOperation) -> u32 {
        match mode {
            ModeOfOperation::None | ModeOfOperation::Other(_) => 0,
            mode => 1 << (mode.raw() - 1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mode_byte_survives_the_round_trip() {
        for raw in i8::MIN..=i8::MAX {
            assert_eq!(ModeOfOperation::from_raw(raw).raw(), raw);
        }
    }

    #[test]
    fn epos4_has_six_modes() {
        use ModeOfOperation::*;
        let modes = [
            ProfilePosition,
            ProfileVelocity,
            Homing,
            CyclicSynchronousPosition,
            CyclicSynchronousVelocity,
            CyclicSynchronousTorque,
        ];
        for mode in modes {
            assert!(SupportedModes::EPOS4.contains(mode));
        }
        for mode in [None, Velocity, ProfileTorque, InterpolatedPosition, Other(-1), Other(5)] {
            assert!(!SupportedModes::EPOS4.contains(mode), "{mode}");
        }
    }
}
