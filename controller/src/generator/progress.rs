//! Progress along a tool path from rest to rest: a family of profiles.
//!
//! A profile is a course of the path parameter s, 0 to 1, in a unit time: a shape of seven phases of constant jerk, and
//! a warp that slows the shape where joints are fast or change their speed. Neither depends on a limit. The duration of
//! a course is the shortest time in which the course keeps all limits. This duration does not rise when a limit rises,
//! and therefore the shortest duration in the family does not rise either.

use super::{Axes, JointLimit, MotionLimits};

/// Velocity, acceleration and jerk of the path parameter, 1/s, 1/s², 1/s³.
pub(super) type Rates = [f64; 3];

/// Number of cells of a warp.
pub(super) const CELLS: usize = 32;

/// Derivatives of the joint positions over the path parameter at one place, relative to the limits of the joints.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) s: f64,
    /// Greatest first derivative of a joint, divided by the limit of velocity, s.
    pub(super) speed: f64,
    /// The joint with the greatest.
    fastest: u8,
    /// First and second derivatives, divided by the limits of acceleration, s².
    pub(super) slope: Axes,
    pub(super) bend: Axes,
}

impl Place {
    /// A place with these derivatives of the joint positions, rad and m.
    pub(super) fn new(s: f64, slope: &Axes, bend: &Axes, limits: &MotionLimits, axes: usize) -> Self {
        let mut place = Self { s, speed: 0.0, fastest: 0, slope: Axes::default(), bend: Axes::default() };
        for axis in 0..axes {
            let speed = (slope[axis] / limits.max_velocity[axis]).abs();
            if speed > place.speed {
                (place.speed, place.fastest) = (speed, axis as u8);
            }
            place.slope[axis] = slope[axis] / limits.max_acceleration[axis];
            place.bend[axis] = bend[axis] / limits.max_acceleration[axis];
        }
        place
    }

    /// Bounds the rate of the path parameter at this place, 1/s (m/s for an arc length), because of a joint.
    pub(super) fn bound(&mut self, speed: f64, joint: u8) {
        if self.speed * speed < 1.0 {
            (self.speed, self.fastest) = (1.0 / speed, joint);
        }
    }

    pub(super) fn between(&self, next: &Self, s: f64) -> Self {
        let share = ((s - self.s) / (next.s - self.s)).clamp(0.0, 1.0);
        let mix = |a: &Axes, b: &Axes| std::array::from_fn(|axis| a[axis] + share * (b[axis] - a[axis]));
        let speed = self.speed + share * (next.speed - self.speed);
        Self {
            s,
            speed,
            fastest: self.fastest,
            slope: mix(&self.slope, &next.slope),
            bend: mix(&self.bend, &next.bend),
        }
    }

    /// The shortest duration of a course by the limits of the joints at this place, s.
    pub(super) fn duration(&self, [_, rate, push, _]: [f64; 4]) -> f64 {
        (self.speed * rate.abs()).max(self.forces(rate, push).fold(0.0, f64::max).sqrt())
    }

    /// Acceleration of each joint, relative to its limit.
    fn forces(&self, rate: f64, push: f64) -> impl Iterator<Item = f64> {
        let square = rate * rate;
        self.slope.iter().zip(&self.bend).map(move |(slope, bend)| (slope * push + bend * square).abs())
    }

    /// The joint and its limit that decide the duration.
    pub(super) fn decided_by(&self, [_, rate, push, _]: [f64; 4]) -> (u8, JointLimit) {
        let (mut joint, mut most) = (0, 0.0);
        for (axis, force) in self.forces(rate, push).enumerate() {
            if force > most {
                (joint, most) = (axis as u8, force);
            }
        }
        let by_speed = self.speed * rate.abs() >= most.sqrt();
        if by_speed { (self.fastest, JointLimit::Velocity) } else { (joint, JointLimit::Acceleration) }
    }
}

/// Course from 0 to 1 in a unit time, from rest to rest: symmetric, with seven phases of constant jerk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Shape {
    /// Durations of a ramp, and of its jerk phases.
    pub(super) ramp: f64,
    pub(super) rise: f64,
    /// Peaks of velocity, acceleration and jerk.
    pub(super) peaks: Rates,
}

impl Shape {
    /// `ramp`: duration of the acceleration, 0 to 1/2. `share`: duration of a jerk phase relative to the ramp, 0 to
    /// 1/2.
    pub(super) fn new(ramp: f64, share: f64) -> Self {
        let rise = ramp * share;
        let velocity = 1.0 / (1.0 - ramp);
        let acceleration = velocity / (ramp - rise);
        Self { ramp, rise, peaks: [velocity, acceleration, acceleration / rise] }
    }

    /// The fastest shape within limits of the path parameter, and its duration, s.
    pub(super) fn fastest([velocity, acceleration, jerk]: Rates) -> (Self, f64) {
        let acceleration = acceleration.min((velocity * jerk).sqrt());
        let rise = acceleration / jerk;
        let mut ramp = velocity / acceleration + rise;
        let mut duration = 1.0 / velocity + ramp;
        let mut share = rise / ramp;
        if velocity * ramp > 1.0 {
            // The path is too short for the velocity, and possibly for the acceleration.
            let peak = acceleration * ((rise * rise + 4.0 / acceleration).sqrt() - rise) / 2.0;
            (ramp, share) = if peak >= acceleration * rise {
                let ramp = peak / acceleration + rise;
                (ramp, rise / ramp)
            } else {
                (2.0 * (0.5 / jerk).cbrt(), 0.5)
            };
            duration = 2.0 * ramp;
        }
        (Self::new(ramp / duration, share), duration)
    }

    /// Path parameter and its three derivatives. Where the jerk jumps, the value after the jump.
    pub(super) fn at(&self, time: f64) -> [f64; 4] {
        if time > 0.5 {
            let [way, velocity, acceleration, jerk] = self.first_half(1.0 - time);
            return [1.0 - way, velocity, -acceleration, jerk];
        }
        self.first_half(time)
    }

    fn first_half(&self, time: f64) -> [f64; 4] {
        let Self { ramp, rise, peaks: [velocity, acceleration, jerk] } = *self;
        if time < rise {
            return [jerk * time.powi(3) / 6.0, jerk * time * time / 2.0, jerk * time, jerk];
        }
        if time < ramp - rise {
            let (t, begin) = (time - rise, jerk * rise * rise / 2.0);
            let way = begin * rise / 3.0 + t * (begin + acceleration * t / 2.0);
            return [way, begin + acceleration * t, acceleration, 0.0];
        }
        let half = velocity * ramp / 2.0;
        if time < ramp {
            let left = ramp - time;
            let way = half - left * (velocity - jerk * left * left / 6.0);
            return [way, velocity - jerk * left * left / 2.0, jerk * left, -jerk];
        }
        [half + velocity * (time - ramp), velocity, 0.0, 0.0]
    }

    /// The time at which the path parameter has a value.
    pub(super) fn time_of(&self, way: f64) -> f64 {
        if way > 0.5 {
            return 1.0 - self.time_of(1.0 - way);
        }
        let Self { ramp, rise, peaks: [velocity, acceleration, jerk] } = *self;
        let begin = jerk * rise * rise / 2.0;
        let (first, half) = (begin * rise / 3.0, velocity * ramp / 2.0);
        if way <= first {
            return (6.0 * way / jerk).cbrt();
        }
        if way >= half {
            return ramp + (way - half) / velocity;
        }
        let t = ((begin * begin + 2.0 * acceleration * (way - first)).sqrt() - begin) / acceleration;
        if rise + t <= ramp - rise {
            return rise + t;
        }
        // The velocity exceeds half of its peak, so that the iteration converges.
        let mut left = (half - way) / velocity;
        for _ in 0..6 {
            let excess = left * (velocity - jerk * left * left / 6.0) - (half - way);
            left -= excess / (velocity - jerk * left * left / 2.0);
        }
        ramp - left
    }
}

/// A density h of the path: the shape passes a place h times more slowly. A quadratic B-spline of the path parameter,
/// so that the jerk is bounded.
#[derive(Clone, Copy, Debug)]
pub(super) struct Warp {
    coefficients: [f64; CELLS + 2],
    /// Integral of the density up to each cell.
    sums: [f64; CELLS + 1],
}

impl Warp {
    /// A density of 1 to 1 + `strength`, by a demand of 0 to 1 in each cell.
    pub(super) fn new(demand: &[f64; CELLS], strength: f64) -> Self {
        let greatest = |cell: usize| {
            let around = cell.saturating_sub(1)..=(cell + 1).min(CELLS - 1);
            around.map(|it| demand[it]).fold(0.0, f64::max)
        };
        let mut coefficients = std::array::from_fn(|at| 1.0 + strength * greatest(at.saturating_sub(1).min(CELLS - 1)));
        let mut warp = Self { coefficients, sums: [0.0; CELLS + 1] };
        let total: f64 = (0..CELLS).map(|cell| warp.part(cell, 1.0)).sum();
        coefficients = coefficients.map(|value| value / total);
        warp.coefficients = coefficients;
        for cell in 0..CELLS {
            warp.sums[cell + 1] = warp.sums[cell] + warp.part(cell, 1.0);
        }
        warp
    }

    fn three(&self, cell: usize) -> [f64; 3] {
        [self.coefficients[cell], self.coefficients[cell + 1], self.coefficients[cell + 2]]
    }

    /// Integral of the density over the first part `u`, 0 to 1, of a cell.
    fn part(&self, cell: usize, u: f64) -> f64 {
        let [a, b, c] = self.three(cell);
        let rest = 1.0 - u;
        (a * (1.0 - rest.powi(3)) / 6.0 + b * u * (0.5 + u * (0.5 - u / 3.0)) + c * u.powi(3) / 6.0) / CELLS as f64
    }

    /// Density and its first two derivatives over the path parameter.
    fn density(&self, cell: usize, u: f64) -> [f64; 3] {
        let ([a, b, c], n) = (self.three(cell), CELLS as f64);
        let rest = 1.0 - u;
        let value = a * rest * rest / 2.0 + b * (0.5 + u * rest) + c * u * u / 2.0;
        [value, n * (b * (1.0 - 2.0 * u) - a * rest + c * u), n * n * (a - 2.0 * b + c)]
    }

    /// Cell and part of the cell at a path parameter.
    pub(super) fn place(s: f64) -> (usize, f64) {
        let scaled = s * CELLS as f64;
        let cell = (scaled as usize).min(CELLS - 1);
        (cell, (scaled - cell as f64).clamp(0.0, 1.0))
    }

    /// Integral of the density up to a path parameter in this part of a cell.
    pub(super) fn way(&self, (cell, u): (usize, f64)) -> f64 {
        self.sums[cell] + self.part(cell, u)
    }

    /// Cell and part of the cell at which the integral of the density has a value.
    pub(super) fn find(&self, way: f64) -> (usize, f64) {
        let cell = self.sums.partition_point(|sum| *sum <= way).clamp(1, CELLS) - 1;
        let target = way - self.sums[cell];
        let mut u = (target / (self.sums[cell + 1] - self.sums[cell])).clamp(0.0, 1.0);
        for _ in 0..8 {
            let slope = self.density(cell, u)[0] / CELLS as f64;
            let next = (u - (self.part(cell, u) - target) / slope).clamp(0.0, 1.0);
            if next == u {
                break;
            }
            u = next;
        }
        (cell, u)
    }

    /// Path parameter and its three derivatives in this part of a cell, from those of the shape.
    pub(super) fn warped(&self, (cell, u): (usize, f64), [_, velocity, acceleration, jerk]: [f64; 4]) -> [f64; 4] {
        let [density, first, second] = self.density(cell, u);
        let rate = velocity / density;
        let push = (acceleration - first * rate * rate) / density;
        let change = (jerk - 3.0 * first * rate * push - second * rate.powi(3)) / density;
        [(cell as f64 + u) / CELLS as f64, rate, push, change]
    }
}

/// Course of the path parameter in a unit time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Course {
    pub(super) shape: Shape,
    pub(super) warp: Option<Warp>,
}

impl Course {
    /// Path parameter, velocity and acceleration at a time from 0 to 1.
    pub(super) fn at(&self, time: f64) -> [f64; 3] {
        let [s, rate, push, _] = self.passed(self.shape.at(time));
        [s, rate, push]
    }

    fn passed(&self, shape: [f64; 4]) -> [f64; 4] {
        self.warp.as_ref().map_or(shape, |warp| warp.warped(warp.find(shape[0]), shape))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shape_reaches_its_end_and_its_time_is_the_inverse_of_its_way() {
        for (ramp, share) in [(0.5, 0.5), (0.5, 0.1), (0.3, 0.5), (0.2, 0.01), (1e-3, 0.3)] {
            let shape = Shape::new(ramp, share);
            assert_eq!(shape.at(0.0)[..3], [0.0; 3]);
            assert!((shape.at(1.0)[0] - 1.0).abs() < 1e-12 && (shape.at(0.5)[0] - 0.5).abs() < 1e-12);
            for k in 1..1000 {
                let time = f64::from(k) / 1000.0;
                let [way, velocity, acceleration, _] = shape.at(time);
                assert!((shape.time_of(way) - time).abs() < 1e-7, "{ramp} {share} {time}: {}", shape.time_of(way));
                let [behind, ahead] = [shape.at(time - 1e-6), shape.at(time + 1e-6)];
                assert!((ahead[0] - behind[0] - 2e-6 * velocity).abs() < 1e-9 * shape.peaks[1].sqrt(), "{time}");
                assert!((ahead[1] - behind[1] - 2e-6 * acceleration).abs() < 3e-12 * shape.peaks[2], "{time}");
            }
        }
    }

    #[test]
    fn derivatives_of_a_warped_course_are_those_of_its_path_parameter() {
        let mut demand = [0.1; CELLS];
        demand[10] = 1.0;
        demand[25] = 0.5;
        let course = Course { shape: Shape::new(0.3, 0.4), warp: Some(Warp::new(&demand, 10.0)) };
        let warp = course.warp.unwrap();
        for k in 1..1000 {
            let (time, dt) = (f64::from(k) / 1000.0, 1e-5);
            let [behind, here, ahead] = [-dt, 0.0, dt].map(|by| course.passed(course.shape.at(time + by)));
            let way = warp.way(Warp::place(here[0]));
            assert!((way - course.shape.at(time)[0]).abs() < 1e-12, "{time}");
            let difference = |order: usize| (ahead[order] - behind[order]) / (2.0 * dt);
            assert!((difference(0) - here[1]).abs() < 1e-5 * 10.0, "{time}: {} {}", difference(0), here[1]);
            assert!((difference(1) - here[2]).abs() < 1e-2, "{time}: {} {}", difference(1), here[2]);
        }
        assert_eq!(course.at(0.0), [0.0; 3]);
        assert!((course.at(1.0)[0] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_fastest_shape_is_within_its_limits_and_reaches_one_of_each_phase() {
        for (limits, reached) in [
            ([1.0, 10.0, 1000.0], [true, true, true]),
            ([100.0, 10.0, 1000.0], [false, true, true]),
            ([100.0, 1000.0, 100.0], [false, false, true]),
            ([1.0, 1000.0, 100.0], [true, false, true]),
        ] {
            let (shape, time) = Shape::fastest(limits);
            for order in 0..3 {
                let share = shape.peaks[order] / time.powi(order as i32 + 1) / limits[order];
                assert!(share <= 1.0 + 1e-9 && (share > 1.0 - 1e-9) == reached[order], "{limits:?}: {order} {share}");
            }
        }
    }
}
