//! Interpolation inside one macrostep: a quintic per motor.

use crate::{LawParameters, MAX_AXES, Macrostep};

/// State of one motor at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Knot {
    /// Position, rad.
    pub position: f64,
    /// Velocity, rad/s.
    pub velocity: f64,
    /// Acceleration, rad/s².
    pub acceleration: f64,
}

impl Knot {
    /// A motor that moves at constant velocity, rad and rad/s.
    pub const fn new(position: f64, velocity: f64) -> Self {
        Self { position, velocity, acceleration: 0.0 }
    }

    /// Standstill at `position`, rad.
    pub const fn at_rest(position: f64) -> Self {
        Self::new(position, 0.0)
    }
}

/// The quintic that has position, velocity and acceleration of `from` at time 0 and of `to` at `duration` seconds,
/// evaluated at the fraction `u` of the duration.
///
/// Between samples of a motion of constant acceleration, the quintic is that motion.
pub fn quintic(from: Knot, to: Knot, duration: f64, u: f64) -> Knot {
    // Velocities and accelerations per duration. The differences are those from the motion of constant acceleration.
    let (v0, v1) = (from.velocity * duration, to.velocity * duration);
    let (a0, a1) = (from.acceleration * duration * duration, to.acceleration * duration * duration);
    let distance = to.position - from.position - v0 - a0 / 2.0;
    let (dv, da) = (v1 - v0 - a0, a1 - a0);
    // p(u) = p0 + v0 u + a0 u²/2 + c3 u³ + c4 u⁴ + c5 u⁵. This form has the least rounding error near u = 0.
    let c3 = 10.0 * distance - 4.0 * dv + da / 2.0;
    let c4 = -15.0 * distance + 7.0 * dv - da;
    let c5 = 6.0 * distance - 3.0 * dv + da / 2.0;
    Knot {
        position: from.position + u * (v0 + u * (a0 / 2.0 + u * (c3 + u * (c4 + u * c5)))),
        velocity: (v0 + u * (a0 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)))) / duration,
        acceleration: (a0 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5))) / (duration * duration),
    }
}

/// Acceleration, rad/s², at the end of the cubic that joins positions and velocities of `from` and `to` in `duration`
/// seconds. A motion that does not state its acceleration gets this one. The error is proportional to `duration²`.
pub fn cubic_end_acceleration(from: Knot, to: Knot, duration: f64) -> f64 {
    let distance = to.position - from.position;
    ((2.0 * from.velocity + 4.0 * to.velocity) - 6.0 * distance / duration) / duration
}

/// A macrostep under way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Segment {
    macrostep: Macrostep,
    from: [Knot; MAX_AXES],
    to: [Knot; MAX_AXES],
    from_torque: [f64; MAX_AXES],
    /// Periods of motion time already commanded.
    done: f64,
    /// Duration of the segment, s.
    duration: f64,
    /// The report after `report_at` periods is made.
    reported: bool,
}

/// State from which a macrostep begins.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Start {
    pub(crate) knots: [Knot; MAX_AXES],
    /// Feed-forward torques, N·m.
    pub(crate) torque: [f64; MAX_AXES],
}

impl Segment {
    /// A segment from `start`. `macrostep.steps` is at least 1.
    pub(crate) fn new(macrostep: Macrostep, start: Start, dt: f64) -> Self {
        let duration = f64::from(macrostep.steps) * dt;
        let from = start.knots;
        let to = std::array::from_fn(|axis| {
            let mut to = Knot::new(macrostep.position[axis], macrostep.velocity[axis]);
            to.acceleration = match macrostep.acceleration {
                Some(acceleration) => acceleration[axis],
                None => cubic_end_acceleration(from[axis], to, duration),
            };
            to
        });
        Self { macrostep, from, to, from_torque: start.torque, done: 0.0, duration, reported: false }
    }

    /// Advances by `periods` of motion time, 0 to 1. [`Segment::at`] then returns the new knot of an axis. Returns
    /// whether the report is due: for the first time, `report_at` periods have passed, or an advance by `next` periods
    /// would pass them. An override thus leaves the controller as many cycles for the next macrostep as without one.
    pub(crate) fn advance(&mut self, periods: f64, next: f64) -> bool {
        self.done += periods;
        let due = !self.reported && self.done + next > f64::from(self.macrostep.report_at);
        self.reported |= due;
        due
    }

    /// Present set-point of `axis`. The set-point of the last period equals the macrostep exactly.
    pub(crate) fn at(&self, axis: usize) -> Knot {
        if self.is_over() {
            return self.to[axis];
        }
        quintic(self.from[axis], self.to[axis], self.duration, self.share())
    }

    /// Set-point of `axis` after `periods` more of motion time, at most that of the end of this segment.
    pub(crate) fn ahead(&self, axis: usize, periods: f64) -> Knot {
        let share = ((self.done + periods) / f64::from(self.macrostep.steps)).min(1.0);
        quintic(self.from[axis], self.to[axis], self.duration, share)
    }

    /// Feed-forward torque of `axis` at this set-point, which holds the weight, N·m.
    pub(crate) fn torque(&self, axis: usize) -> f64 {
        let (from, to) = (self.from_torque[axis], self.macrostep.torque[axis]);
        from + self.share() * (to - from)
    }

    fn share(&self) -> f64 {
        (self.done / f64::from(self.macrostep.steps)).min(1.0)
    }

    pub(crate) fn is_over(&self) -> bool {
        self.done >= f64::from(self.macrostep.steps)
    }

    /// Periods of motion time that remain for the next segment if this one advances by `periods`. `None` if this
    /// segment still continues afterwards.
    pub(crate) fn excess(&self, periods: f64) -> Option<f64> {
        let excess = self.done + periods - f64::from(self.macrostep.steps);
        (excess > 0.0 || self.is_over()).then_some(excess.max(0.0))
    }

    /// The end of this segment, from which the next one begins.
    pub(crate) fn end(&self) -> Start {
        Start { knots: self.to, torque: self.macrostep.torque }
    }

    /// Parameters of the cycle law during this segment.
    pub(crate) fn law(&self) -> Option<&LawParameters> {
        self.macrostep.law.as_ref()
    }

    pub(crate) fn is_reported(&self) -> bool {
        self.reported
    }

    /// The first of the first `axes` axes that moves at the end of this segment.
    pub(crate) fn ends_in_motion(&self, axes: usize) -> Option<usize> {
        self.to[..axes].iter().position(|to| to.velocity != 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quintic_meets_both_ends() {
        let from = Knot { position: 1.0, velocity: -2.0, acceleration: 7.0 };
        let to = Knot { position: 3.0, velocity: 4.0, acceleration: -5.0 };
        for (u, end) in [(0.0, from), (1.0, to)] {
            let knot = quintic(from, to, 0.5, u);
            assert!((knot.position - end.position).abs() < 1e-12, "{knot:?}");
            assert!((knot.velocity - end.velocity).abs() < 1e-12, "{knot:?}");
            assert!((knot.acceleration - end.acceleration).abs() < 1e-11, "{knot:?}");
        }
    }

    #[test]
    fn a_motion_of_fifth_degree_is_reproduced_exactly() {
        let truth = |t: f64| Knot {
            position: 2.0 + t * (3.0 + t * (2.5 + t * (-4.0 + t * (6.0 - t * 7.0)))),
            velocity: 3.0 + t * (5.0 + t * (-12.0 + t * (24.0 - t * 35.0))),
            acceleration: 5.0 + t * (-24.0 + t * (72.0 - t * 140.0)),
        };
        for step in 0..=10 {
            let t = 0.02 * f64::from(step);
            let knot = quintic(truth(0.0), truth(0.2), 0.2, t / 0.2);
            assert!((knot.position - truth(t).position).abs() < 1e-12);
            assert!((knot.velocity - truth(t).velocity).abs() < 1e-12);
            assert!((knot.acceleration - truth(t).acceleration).abs() < 1e-10);
        }
    }

    #[test]
    fn the_end_acceleration_of_a_cubic_is_found_without_its_start_acceleration() {
        let truth = |t: f64| Knot {
            position: 1.0 + t * (2.0 + t * (3.0 - t * 4.0)),
            velocity: 2.0 + t * (6.0 - t * 12.0),
            acceleration: 6.0 - t * 24.0,
        };
        let found = cubic_end_acceleration(truth(0.1), truth(0.3), 0.2);
        assert!((found - truth(0.3).acceleration).abs() < 1e-11, "{found}");
    }
}
