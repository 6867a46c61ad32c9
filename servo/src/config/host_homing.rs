//! Configuration of homing by the servo.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::refusal::{first_wrong, is_positive};

/// How the servo homes an axis whose drive has an index latch but no homing of its own.
///
/// The axis searches its home switch, stops, pauses and leaves the switch again slowly, in the
/// opposite sense. From where the switch opens it goes on with [`AxisCommand::Seek`](drive::AxisCommand::Seek): the
/// first index pulse there is the reference, as with the methods of CiA 402. If the switch is closed at the start the axis leaves it first, so that it is always
/// entered from the same side. A limit switch in the way turns a search round once, if `reverse_at_limit`
/// says so; anywhere else it ends homing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HostHoming {
    /// Sense in which the home switch is searched.
    pub direction: Direction,
    /// The search for the home switch.
    pub search: HomingLeg,
    /// The way to the index pulse.
    pub zero: HomingLeg,
    /// Acceleration at both ends of each leg, rad/s².
    pub acceleration: f64,
    /// Rest after each leg.
    pub pause: Duration,
    /// Samples in a row that have to agree before a switch counts as closed or open; at least 1.
    pub debounce: u32,
    /// A search that meets a limit switch goes back across the home switch and begins again, once.
    pub reverse_at_limit: bool,
}

/// One leg of homing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingLeg {
    /// Motor speed, rad/s.
    pub velocity: f64,
    /// Longest way without finding what it is for, rad.
    pub distance: f64,
    /// Longest time without finding what it is for.
    pub timeout: Duration,
}

/// A direction of the motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Direction {
    /// Towards lower positions.
    Negative,
    /// Towards higher positions.
    Positive,
}

impl HostHoming {
    /// The first field that makes no sense.
    pub(super) fn nonsense(&self, max_velocity: f64, max_acceleration: f64) -> Option<&'static str> {
        let within = |value: f64, limit: f64| value > 0.0 && value <= limit;
        first_wrong([
            (within(self.search.velocity, max_velocity), "homing.search.velocity"),
            (is_positive(self.search.distance), "homing.search.distance"),
            (!self.search.timeout.is_zero(), "homing.search.timeout"),
            (within(self.zero.velocity, max_velocity), "homing.zero.velocity"),
            (is_positive(self.zero.distance), "homing.zero.distance"),
            (!self.zero.timeout.is_zero(), "homing.zero.timeout"),
            (within(self.acceleration, max_acceleration), "homing.acceleration"),
            (self.debounce > 0, "homing.debounce"),
        ])
    }
}
