//! Configuration of position loops.

use serde::{Deserialize, Serialize};

use super::refusal::{first_wrong, is_not_negative};
use crate::regulator::{CascadeConfig, IncrementalConfig, ProportionalConfig};

/// Who closes the position loop of an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum PositionLoop {
    /// Its drive: the servo sends positions.
    #[default]
    Drive,
    /// The servo: the drive is sent velocity, torque or pulse width.
    Host(HostLoop),
}

/// A position loop that the servo closes.
///
/// It compares each sample with the command that it shows the effect of,
/// [`DriveGroup::delay`](drive::DriveGroup::delay) cycles before. Where an answer is missing the axis is
/// taken to have moved as it was told to, until the next sample says how far it did move.
///
/// A loop that does not work cannot brake either: where the motor gets faster than
/// `runaway_velocity`, or further from its command than
/// [`ServoAxisConfig::following_error`](crate::ServoAxisConfig::following_error), the power of the
/// effector is taken at once (category 0).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HostLoop {
    /// From position error to output.
    pub law: Law,
    /// What the output is.
    pub output: Output,
    /// What the motion asked for is known to need; added before the output is limited.
    pub feed_forward: FeedForward,
    /// Measured motor speed, rad/s, that no working loop reaches; above
    /// [`ServoAxisConfig::max_velocity`](crate::ServoAxisConfig::max_velocity).
    pub runaway_velocity: f64,
}

/// A control law.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Law {
    /// The law of the IRp-6: two zeros, one pole, one integrator, in encoder counts and periods.
    Incremental(IncrementalConfig),
    /// Proportional position loop over a proportional-integral velocity loop.
    Cascade(CascadeConfig),
    /// Proportional-integral position loop, for a drive that closes the velocity loop itself.
    Proportional(ProportionalConfig),
}

/// What a drive that closes no position loop is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// Velocity of the motor, rad/s.
    Velocity,
    /// Torque of the motor, N·m.
    Torque,
    /// Share of the full pulse width, -1 to 1.
    Duty,
}

/// Output that the commanded motion needs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct FeedForward {
    /// Per commanded velocity, output·s/rad: viscous friction, and back-EMF under `control = "pwm"`; 1 under `control =
    /// "velocity"`.
    pub velocity: f64,
    /// Per commanded acceleration, output·s²/rad: inertia; under `control = "velocity"` the lag of the drive's loop, s.
    pub acceleration: f64,
    /// In the sense of the commanded velocity: dry friction while sliding fast.
    pub coulomb: f64,
    /// The same at break-away, at least `coulomb`; `coulomb` where absent.
    pub stiction: Option<f64>,
    /// Velocity over which it falls from `stiction` to `coulomb`, rad/s: to 0.37 of the difference. Needed with
    /// `stiction`.
    pub stribeck_velocity: Option<f64>,
    // The cell fills the default in. The servo leaves `Macrostep::torque` out where the factor is absent.
    /// Per torque, 1/(N·m), that the robot's `weight` takes: 1 where absent under `control = "current"` or `"torque"`;
    /// under `control = "pwm"` winding resistance / (torque constant * supply voltage).
    pub weight: Option<f64>,
    /// Always: the mean weight of the load, where the robot has no `weight`.
    pub constant: f64,
}

/// Commanded speed, rad/s, over which dry friction changes its sign: what generators round must not be a hammer.
const REVERSAL: f64 = 1e-3;

impl FeedForward {
    /// What dry friction takes at a commanded velocity, rad/s. Nothing at rest.
    pub(crate) fn dry(&self, velocity: f64) -> f64 {
        let mut level = self.coulomb;
        if let (Some(stiction), Some(stribeck_velocity)) = (self.stiction, self.stribeck_velocity)
            && stiction > level
        {
            let x = velocity / stribeck_velocity;
            level += (stiction - level) * (-x * x).exp();
        }
        level * (velocity / REVERSAL).clamp(-1.0, 1.0)
    }
}

impl Law {
    /// The most that it puts out either way, in the loop's unit of output.
    pub fn limit(&self) -> f64 {
        match self {
            Self::Incremental(law) => law.limit,
            Self::Cascade(law) => law.limit,
            Self::Proportional(law) => law.limit,
        }
    }
}

impl HostLoop {
    /// The first field that makes no sense.
    pub(super) fn nonsense(&self, max_velocity: f64) -> Option<&'static str> {
        let field = match &self.law {
            Law::Incremental(law) => law.nonsense(),
            Law::Cascade(law) => law.nonsense(),
            Law::Proportional(law) => law.nonsense(),
        };
        let FeedForward { velocity, acceleration, coulomb, stiction, stribeck_velocity, weight, constant } =
            self.feed_forward;
        let [stiction, stribeck_velocity, weight] =
            [stiction, stribeck_velocity, weight].map(|given| given.unwrap_or(0.0));
        let by_velocity = self.output == Output::Velocity;
        let falls = stiction > coulomb;
        let fields = [
            (
                !matches!(self.law, Law::Proportional(_)) || by_velocity,
                "law of its loop, which leaves the velocity to a drive that has no loop for it,",
            ),
            (self.output != Output::Duty || self.law.limit() <= 1.0, "limit of its loop, a duty above 1,"),
            (is_not_negative(velocity), "feed_forward.velocity"),
            (is_not_negative(acceleration), "feed_forward.acceleration"),
            (is_not_negative(coulomb), "feed_forward.coulomb"),
            (is_not_negative(stiction) && (stiction == 0.0 || stiction >= coulomb), "feed_forward.stiction"),
            (
                is_not_negative(stribeck_velocity) && (!falls || stribeck_velocity > 0.0),
                "feed_forward.stribeck_velocity",
            ),
            (is_not_negative(weight), "feed_forward.weight"),
            (weight == 0.0 || !by_velocity, "feed_forward.weight, a torque for a drive that is sent velocities,"),
            (constant.is_finite(), "feed_forward.constant"),
            (
                self.runaway_velocity.is_finite() && self.runaway_velocity > max_velocity,
                "runaway_velocity, not above max_velocity,",
            ),
        ];
        field.or_else(|| first_wrong(fields))
    }
}
