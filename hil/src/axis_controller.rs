//! The serial axis controllers of the IRb-6 and IRp-6, one drive per line, with either of their telegrams.
//!
//! [`Nfv2AxisController`] speaks [`serial::nfv2`], [`HiMoxaAxisController`] the older [`serial::hi_moxa`]; the drive
//! behind both is one. It is a power stage on 48 V that follows pulse widths or, by its own loop, currents; a
//! position counter that it can have zeroed by an index pulse; and protections that act without the host:
//! over-current and limit switches. The host closes all other loops. A set-point stays until the next one, for any
//! time. The drive keeps counter and reference while it has power, even when its host restarts.
//!
//! When the last byte of a request arrives, the drive reads its sensors, does what it was told, and answers after
//! [`AxisControllerConfig::answer_delay`]. The plant moves in sub-steps of 100 µs from power-on. A value that is read
//! is up to one sub-step old, and a value that is set acts up to one sub-step early. Both are constant at a steady
//! period.
//!
//! The telegrams are documented, the drive is not. These are choices: the current loop turns each
//! sub-step and its gains are pulse width per mA; over-current trips at the first sub-step beyond the
//! limit; a closed limit switch shorts the winding against set-points further into it and lets go of
//! others; positive counts run towards the upper switch; the index flag stays until the search is left;
//! a set-point for a mode the drive is not in is ignored; what follows an incomplete request after a pause
//! of [`GAP`] is a new one. Left out: speed and position modes, which no host used, and the limit flags 10 to 12
//! of NFv2.
//!
//! A drive in error mode opens the emergency stop of its [`Cabinet`]: no drive of the cabinet has power while any
//! drive is in error. A drive whose power stage was in use meanwhile needs manual mode to regain power. In manual
//! mode the fault is shown while the stop is open and not latched, so that drives can leave error one after the
//! other. A drive that trips stops itself alone.

mod cabinet;
mod drive;
mod hi_moxa;
mod nfv2;
#[cfg(test)]
mod tests;
mod unit;

pub use cabinet::Cabinet;
pub use hi_moxa::HiMoxaAxisController;
pub use nfv2::Nfv2AxisController;

use std::time::Duration;

use can::Instant;

use crate::plant::{AxisConfig, Mount};

/// A request that stops in its middle for so long does not go on.
pub const GAP: Duration = Duration::from_micros(500);

/// What distinguishes one unit from another.
#[derive(Clone, Debug)]
pub struct AxisControllerConfig {
    /// When it is switched on.
    pub power_on: Instant,
    /// Decides noise and ripple.
    pub seed: u64,
    /// Motor, load and sensors. Of the amplifier only the trip current counts, until the host sends its own.
    pub axis: AxisConfig,
    /// Where its axis is mounted; `None` for a motor with a load of its own.
    pub mount: Option<Mount>,
    /// What a pulse width of 1000 puts on the winding, V.
    pub supply: f64,
    /// From the last byte of a request to the first of its answer.
    pub answer_delay: Duration,
    /// What the position counter shows at first, encoder pulses: of a drive that had power before.
    pub counter: i32,
    /// Whether that counter is referenced.
    pub synchronized: bool,
    /// After so long without a set-point the drive takes it for zero. The real ones have no such thing.
    pub watchdog: Option<Duration>,
    /// Where it stands; a clone of this configuration is in the same one.
    pub cabinet: Cabinet,
}

impl AxisControllerConfig {
    /// A drive that was just switched on, quick to answer, without a watchdog, in a cabinet of its own.
    pub fn new(axis: AxisConfig) -> Self {
        Self {
            power_on: Instant::ZERO,
            seed: 0,
            axis,
            mount: None,
            supply: 48.0,
            answer_delay: Duration::from_micros(100),
            counter: 0,
            synchronized: false,
            watchdog: None,
            cabinet: Cabinet::default(),
        }
    }
}
