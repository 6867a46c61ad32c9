//! Interpolation inside one macrostep: a cubic per motor.

use crate::{MAX_AXES, Macrostep};

/// Position, rad, and velocity, rad/s, of one motor at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Knot {
    /// Position, rad.
    pub position: f64,
    /// Velocity, rad/s.
    pub velocity: f64,
}

/// The cubic that has position and velocity of `from` at time 0 and of `to` at `duration` seconds, evaluated at the
/// fraction `u` of the duration.
pub fn hermite(from: Knot, to: Knot, duration: f64, u: f64) -> Knot {
    let distance = to.position - from.position;
    let (v0, v1) = (from.velocity * duration, to.velocity * duration);
    // p(u) = p0 + v0 u + b u² + c u³. This form has the least rounding error for the small steps near u = 0.
    let b = 3.0 * distance - 2.0 * v0 - v1;
    let c = v0 + v1 - 2.0 * distance;
    Knot {
        position: from.position + u * (v0 + u * (b + u * c)),
        velocity: (v0 + u * (2.0 * b + u * 3.0 * c)) / duration,
    }
}

/// A macrostep under way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Segment {
    macrostep: Macrostep,
    from: [Knot; MAX_AXES],
    from_torque: [f64; MAX_AXES],
    /// Periods already commanded.
    done: u16,
    /// Duration of the segment, s.
    duration: f64,
}

impl Segment {
    /// A segment from `from` with the torques `from_torque`, N·m. `macrostep.steps` is at least 1.
    pub(crate) fn new(macrostep: Macrostep, from: [Knot; MAX_AXES], from_torque: [f64; MAX_AXES], dt: f64) -> Self {
        let duration = f64::from(macrostep.steps) * dt;
        Self { macrostep, from, from_torque, done: 0, duration }
    }

    /// Advances by one period. [`Segment::at`] then returns the new knot of an axis.
    pub(crate) fn advance(&mut self) {
        self.done += 1;
    }

    /// Present set-point of `axis`. The set-point of the last period equals the macrostep exactly.
    pub(crate) fn at(&self, axis: usize) -> Knot {
        let to = Knot { position: self.macrostep.position[axis], velocity: self.macrostep.velocity[axis] };
        if self.is_over() {
            return to;
        }
        hermite(self.from[axis], to, self.duration, self.share())
    }

    /// Feed-forward torque of `axis` at this set-point, which holds the weight, N·m.
    pub(crate) fn torque(&self, axis: usize) -> f64 {
        let (from, to) = (self.from_torque[axis], self.macrostep.torque[axis]);
        from + self.share() * (to - from)
    }

    fn share(&self) -> f64 {
        f64::from(self.done) / f64::from(self.macrostep.steps)
    }

    pub(crate) fn is_over(&self) -> bool {
        self.done >= self.macrostep.steps
    }

    /// Whether `report_at` periods have passed.
    pub(crate) fn has_reported(&self) -> bool {
        self.done >= self.macrostep.report_at
    }

    pub(crate) fn is_at_report(&self) -> bool {
        self.done == self.macrostep.report_at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cubic_meets_both_ends() {
        let from = Knot { position: 1.0, velocity: -2.0 };
        let to = Knot { position: 3.0, velocity: 4.0 };
        for (u, end) in [(0.0, from), (1.0, to)] {
            let knot = hermite(from, to, 0.5, u);
            assert!((knot.position - end.position).abs() < 1e-12, "{knot:?}");
            assert!((knot.velocity - end.velocity).abs() < 1e-12, "{knot:?}");
        }
    }

    #[test]
    fn constant_acceleration_is_reproduced_exactly() {
        let truth = |t: f64| Knot { position: 2.0 + 3.0 * t + 2.5 * t * t, velocity: 3.0 + 5.0 * t };
        for step in 0..=10 {
            let t = 0.02 * f64::from(step);
            let knot = hermite(truth(0.0), truth(0.2), 0.2, t / 0.2);
            assert!((knot.position - truth(t).position).abs() < 1e-12);
            assert!((knot.velocity - truth(t).velocity).abs() < 1e-12);
        }
    }
}
