//! Trapezoidal velocity profile of one axis over one segment.

/// One axis over one segment: from `start_velocity` to `cruise`, at `cruise`, and on to `end_velocity`, with one
/// acceleration. Position counts from the segment's start in the direction of travel.
///
/// The three speeds determine whether the axis accelerates or brakes before and after the cruise. The same form
/// therefore covers accelerate-decelerate, accelerate-accelerate, constant, decelerate-decelerate and the dip (brake,
/// slow travel, accelerate).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Trapezoid {
    distance: f64,
    start_velocity: f64,
    cruise: f64,
    pub(super) end_velocity: f64,
    /// Durations of the three phases, s.
    first: f64,
    middle: f64,
    last: f64,
}

/// Course of one axis over a segment. All speeds are along the direction of travel and not negative, and
/// `start_velocity² + end_velocity² <= 2 acceleration · distance`.
///
/// With this condition, the axis could brake to a standstill and accelerate again within the segment. Therefore every
/// duration that is at least the shortest duration has a profile, and planning needs no second pass.
#[derive(Clone, Copy, Debug)]
pub(super) struct Course {
    pub(super) distance: f64,
    pub(super) start_velocity: f64,
    pub(super) end_velocity: f64,
    pub(super) acceleration: f64,
}

impl Course {
    /// The shortest time with at most `max_velocity`, s.
    pub(super) fn shortest(&self, max_velocity: f64) -> f64 {
        let Self { distance: s, start_velocity: vp, end_velocity: vk, acceleration: a } = *self;
        if s <= 0.0 {
            return 0.0;
        }
        // Acceleration to `peak` and braking from `peak` use the whole distance when (2 peak² − vp² − vk²) / 2a = s.
        let peak = (a * s + (vp * vp + vk * vk) / 2.0).sqrt().min(max_velocity).max(vp).max(vk);
        let ramps = (2.0 * peak * peak - vp * vp - vk * vk) / (2.0 * a);
        (2.0 * peak - vp - vk) / a + (s - ramps).max(0.0) / peak
    }

    /// The profile with exactly this `duration`, which is at least the shortest time.
    pub(super) fn lasting(&self, duration: f64) -> Trapezoid {
        let cruise = self.cruise(duration);
        let Self { distance, start_velocity, end_velocity, acceleration } = *self;
        let mut first = (cruise - start_velocity).abs() / acceleration;
        let mut last = (end_velocity - cruise).abs() / acceleration;
        let ramps = first + last;
        // At the shortest time the ramps meet. Rounding must not make the ramps overlap.
        if ramps > duration {
            first *= duration / ramps;
            last *= duration / ramps;
        }
        Trapezoid {
            distance,
            start_velocity,
            cruise,
            end_velocity,
            first,
            middle: (duration - first - last).max(0.0),
            last,
        }
    }

    /// The cruise speed `c` for the requested distance. The distance covered in `t` is
    /// `c t − sgn(c − vp) (c − vp)² / 2a − sgn(c − vk) (c − vk)² / 2a`.
    /// The distance grows with `c`. Each of the three ranges of `c` has a closed solution.
    fn cruise(&self, t: f64) -> f64 {
        let Self { distance: s, start_velocity: vp, end_velocity: vk, acceleration: a } = *self;
        let (low, high) = (vp.min(vk), vp.max(vk));
        let squares = (vp * vp + vk * vk) / 2.0;
        let gap = high - low;
        if s >= high * t - gap * gap / (2.0 * a) {
            let b = a * t + vp + vk;
            let c = a * s + squares;
            2.0 * c / (b + (b * b - 4.0 * c).max(0.0).sqrt())
        } else if s > low * t + gap * gap / (2.0 * a) {
            (s - (high * high - low * low) / (2.0 * a)) / (t - gap / a)
        } else {
            let b = a * t - vp - vk;
            let c = (a * s - squares).max(0.0);
            let root = (b * b + 4.0 * c).sqrt();
            if b > 0.0 { 2.0 * c / (b + root) } else { (root - b) / 2.0 }
        }
    }
}

/// Half the time over which the acceleration at an instant is averaged, s: far below a period, far above rounding.
const AROUND: f64 = 1e-7;

impl Trapezoid {
    /// Position and velocity `t` seconds after the segment's start.
    pub(super) fn at(&self, t: f64) -> (f64, f64) {
        let rest = self.duration() - t;
        if t < self.first {
            let a = self.starting();
            (t * (self.start_velocity + a * t / 2.0), self.start_velocity + a * t)
        } else if rest <= 0.0 {
            (self.distance, self.end_velocity)
        } else if rest < self.last {
            // Time is counted back from the end, so that the end is met exactly.
            let a = self.ending();
            (self.distance - rest * (self.end_velocity - a * rest / 2.0), self.end_velocity - a * rest)
        } else {
            let ramp = self.first * (self.start_velocity + self.cruise) / 2.0;
            (ramp + self.cruise * (t - self.first), self.cruise)
        }
    }

    /// Acceleration `t` seconds after the segment's start. At a jump, the mean of both values; outside the segment, zero.
    pub(super) fn acceleration(&self, t: f64) -> f64 {
        let at = |t: f64| match self.duration() - t {
            _ if t < 0.0 => 0.0,
            _ if t < self.first => self.starting(),
            rest if rest > 0.0 && rest < self.last => self.ending(),
            _ => 0.0,
        };
        0.5 * (at(t - AROUND) + at(t + AROUND))
    }

    fn duration(&self) -> f64 {
        self.first + self.middle + self.last
    }

    fn starting(&self) -> f64 {
        (self.cruise - self.start_velocity) / self.first
    }

    fn ending(&self) -> f64 {
        (self.end_velocity - self.cruise) / self.last
    }
}
