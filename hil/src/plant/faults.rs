//! Faults of a motor, its sensors and its power stage.

use super::{EndStops, Trip};

/// A fault of a motor with its load, of its sensors or of its power stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlantFault {
    /// The shaft is blocked.
    Blocked,
    /// The encoder gives no signal: its counter does not change, and there is no index pulse. The counter continues from
    /// its value at the end of the fault, so the counts of the motion during the fault are lost.
    EncoderFrozen,
    /// The counter jumps once by this number of increments, and keeps the offset.
    EncoderJump(i32),
    /// The encoder counts backwards. The counter continues from its value at the end of the fault, so it keeps an offset of
    /// twice the motion during the fault.
    EncoderInverted,
    /// The home switch never closes.
    HomeSwitchDead,
    /// The limit switches never close.
    LimitSwitchesDead,
    /// The upper limit switch is closed: a broken wire of a normally closed contact.
    LimitSwitchClosed,
    /// The encoder has no index pulse.
    IndexMissing,
    /// The power stage reports over-current. A motor without power trips when it gets power.
    OverCurrent,
    /// The power stage reports over-temperature.
    OverTemperature,
    /// The supply has this share of its voltage, 0 to 1.
    Sagging(f64),
    /// The brake does not hold.
    BrakeSlips,
    /// Two phases of the motor are swapped: the torque has the wrong sign.
    SwappedPhases,
    /// A buffer stands this far, rad, before the motor in the direction of its motion; before a motor at rest, in the
    /// positive direction.
    Buffer {
        /// Distance to the buffer, rad.
        distance: f64,
        /// Stiffness of the buffer at the motor, N·m/rad.
        stiffness: f64,
    },
}

/// The faults of an axis in effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PlantFaults {
    pub(super) blocked: bool,
    pub(super) frozen: bool,
    pub(super) inverted: bool,
    pub(super) index_missing: bool,
    /// States of home, negative and positive switch that do not depend on the shaft.
    pub(super) stuck: [Option<bool>; 3],
    pub(super) trip: Option<Trip>,
    /// Share of the supply voltage.
    pub(super) supply: f64,
    pub(super) brake_slips: bool,
    /// Buffers of the motor without the fault.
    pub(super) buffers: Option<Option<EndStops>>,
}

impl PlantFaults {
    pub(super) const NONE: Self = Self {
        blocked: false,
        frozen: false,
        inverted: false,
        index_missing: false,
        stuck: [None; 3],
        trip: None,
        supply: 1.0,
        brake_slips: false,
        buffers: None,
    };
}

/// Torque that blocks a shaft, N·m.
pub(super) const BLOCK: f64 = 1e6;
