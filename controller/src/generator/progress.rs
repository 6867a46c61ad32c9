//! Progress along a tool path from rest to rest: the fastest of a family of profiles within the limits of tool and
//! joints.
//!
//! A profile is a course of the path parameter s, 0 to 1, in a unit time: a shape of seven phases of constant jerk, and
//! a warp that slows the shape where joints are fast or change their speed. Neither depends on a limit. The duration of
//! a course is the shortest time in which the course keeps all limits. This duration does not rise when a limit rises,
//! and therefore the shortest duration in the family does not rise either.

use super::{Axes, MotionLimits};

/// Velocity, acceleration and jerk of the path parameter, 1/s, 1/s², 1/s³.
pub(super) type Rates = [f64; 3];

/// Number of cells of a warp.
const CELLS: usize = 32;
/// Strengths of a warp: how much slower the path parameter is where a joint is fastest than where the joint rests.
const STRENGTHS: [f64; 4] = [1.0, 3.0, 10.0, 30.0];
/// Greatest ratio of the least demand on the speed along the path to the greatest, for a warp.
const UNEVEN: f64 = 0.7;
/// Durations of both ramps of a warped shape, and of the jerk phases relative to a ramp.
const RAMPS: [f64; 7] = [0.5, 0.42, 0.34, 0.26, 0.18, 0.1, 0.05];
const JERK_SHARES: [f64; 4] = [0.5, 0.3, 0.15, 0.05];
/// Smallest ramp of a shape, and smallest jerk phase relative to a ramp.
const SHORTEST: f64 = 1e-4;
/// Steps of a golden-section search, and of the scan before.
const STEPS: u32 = 22;
const SCANNED: u32 = 8;
/// Largest number of jerk phases that are tried for a ramp.
const REFINEMENTS: u32 = 7;
/// Relative difference of durations that counts as none.
const SAME: f64 = 1e-9;

/// Derivatives of the joint positions over the path parameter at one place, relative to the limits of the joints.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) s: f64,
    /// Greatest first derivative of a joint, divided by the limit of velocity, s.
    speed: f64,
    /// First and second derivatives, divided by the limits of acceleration, s².
    slope: Axes,
    bend: Axes,
}

impl Place {
    /// A place with these derivatives of the joint positions, rad and m.
    pub(super) fn new(s: f64, slope: &Axes, bend: &Axes, limits: &MotionLimits, axes: usize) -> Self {
        let mut place = Self { s, speed: 0.0, slope: Axes::default(), bend: Axes::default() };
        for axis in 0..axes {
            place.speed = place.speed.max((slope[axis] / limits.max_velocity[axis]).abs());
            place.slope[axis] = slope[axis] / limits.max_acceleration[axis];
            place.bend[axis] = bend[axis] / limits.max_acceleration[axis];
        }
        place
    }

    fn between(&self, next: &Self, s: f64) -> Self {
        let share = ((s - self.s) / (next.s - self.s)).clamp(0.0, 1.0);
        let mix = |a: &Axes, b: &Axes| std::array::from_fn(|axis| a[axis] + share * (b[axis] - a[axis]));
        let speed = self.speed + share * (next.speed - self.speed);
        Self { s, speed, slope: mix(&self.slope, &next.slope), bend: mix(&self.bend, &next.bend) }
    }

    /// The shortest duration of a course by the limits of the joints at this place, s.
    fn duration(&self, [_, rate, push, _]: [f64; 4]) -> f64 {
        let square = rate * rate;
        let forces = self.slope.iter().zip(&self.bend).map(|(slope, bend)| (slope * push + bend * square).abs());
        (self.speed * rate.abs()).max(forces.fold(0.0, f64::max).sqrt())
    }
}

/// Course from 0 to 1 in a unit time, from rest to rest: symmetric, with seven phases of constant jerk.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Shape {
    /// Durations of a ramp, and of its jerk phases.
    ramp: f64,
    rise: f64,
    /// Peaks of velocity, acceleration and jerk.
    peaks: Rates,
}

impl Shape {
    /// `ramp`: duration of the acceleration, 0 to 1/2. `share`: duration of a jerk phase relative to the ramp, 0 to
    /// 1/2.
    fn new(ramp: f64, share: f64) -> Self {
        let rise = ramp * share;
        let velocity = 1.0 / (1.0 - ramp);
        let acceleration = velocity / (ramp - rise);
        Self { ramp, rise, peaks: [velocity, acceleration, acceleration / rise] }
    }

    /// The fastest shape within limits of the path parameter, and its duration, s.
    fn fastest([velocity, acceleration, jerk]: Rates) -> (Self, f64) {
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
    fn at(&self, time: f64) -> [f64; 4] {
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
    fn time_of(&self, way: f64) -> f64 {
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
struct Warp {
    coefficients: [f64; CELLS + 2],
    /// Integral of the density up to each cell.
    sums: [f64; CELLS + 1],
}

impl Warp {
    /// A density of 1 to 1 + `strength`, by a demand of 0 to 1 in each cell.
    fn new(demand: &[f64; CELLS], strength: f64) -> Self {
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
    fn place(s: f64) -> (usize, f64) {
        let scaled = s * CELLS as f64;
        let cell = (scaled as usize).min(CELLS - 1);
        (cell, (scaled - cell as f64).clamp(0.0, 1.0))
    }

    /// Path parameter and its three derivatives, from those of the shape.
    fn warped(&self, shape: [f64; 4]) -> [f64; 4] {
        let way = shape[0];
        let cell = self.sums.partition_point(|sum| *sum <= way).clamp(1, CELLS) - 1;
        let target = way - self.sums[cell];
        let mut u = (target / (self.sums[cell + 1] - self.sums[cell])).clamp(0.0, 1.0);
        for _ in 0..8 {
            let slope = self.density(cell, u)[0] / CELLS as f64;
            u = (u - (self.part(cell, u) - target) / slope).clamp(0.0, 1.0);
        }
        self.warped_at(cell, u, shape)
    }

    /// The same, if the place is known.
    fn warped_at(&self, cell: usize, u: f64, [_, velocity, acceleration, jerk]: [f64; 4]) -> [f64; 4] {
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
    shape: Shape,
    warp: Option<Warp>,
}

impl Course {
    /// Path parameter, velocity and acceleration at a time from 0 to 1.
    pub(super) fn at(&self, time: f64) -> [f64; 3] {
        let [s, rate, push, _] = self.passed(self.shape.at(time));
        [s, rate, push]
    }

    fn passed(&self, shape: [f64; 4]) -> [f64; 4] {
        self.warp.as_ref().map_or(shape, |warp| warp.warped(shape))
    }
}

/// Limits of a motion along a path.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds<'a> {
    /// Limits of the tool.
    pub(super) tool: Rates,
    pub(super) axes: usize,
    /// Places of the path in ascending order, from 0 to 1.
    pub(super) places: &'a [Place],
    /// Whether the speed is constant between acceleration and braking.
    pub(super) constant_speed: bool,
}

impl Bounds<'_> {
    /// The fastest course, and its duration, s. `None` if the limits of the tool alone determine the motion.
    pub(super) fn fastest(&self) -> Option<(Course, f64)> {
        let (shape, least) = Shape::fastest(self.tool);
        let by_tool = Course { shape, warp: None };
        let time = self.duration(&by_tool, f64::INFINITY, &mut 0);
        if time <= least * (1.0 + SAME) {
            return None;
        }
        let mut best = (by_tool, time);
        let (shape, time) = self.fastest_shape();
        if time < best.1 {
            best = (Course { shape, warp: None }, time);
        }
        if self.constant_speed {
            return Some(best);
        }
        let mut hint = 0;
        let by_slope: fn(&Place, usize) -> f64 = |place, axis| place.slope[axis].abs();
        let by_bend: fn(&Place, usize) -> f64 = |place, axis| place.bend[axis].abs().sqrt();
        for (axis, by) in (0..=self.axes).flat_map(|axis| [by_slope, by_bend].map(|by| (axis, by))) {
            let Some(demand) = self.demand(axis, by) else { continue };
            for strength in STRENGTHS {
                let warp = Some(Warp::new(&demand, strength));
                for shape in RAMPS.into_iter().flat_map(|ramp| JERK_SHARES.map(|share| Shape::new(ramp, share))) {
                    let course = Course { shape, warp };
                    let time = self.duration(&course, best.1, &mut hint);
                    if time < best.1 {
                        best = (course, time);
                    }
                }
            }
        }
        Some(best)
    }

    /// The shape without a warp that takes the least time, and this time.
    fn fastest_shape(&self) -> (Shape, f64) {
        let least = (2.0 * SHORTEST).ln();
        let (ramp, _) = least_of(least, |ramp| self.fastest_with(0.5 * ramp.exp()).1);
        self.fastest_with(0.5 * ramp.exp())
    }

    /// The fastest shape with a ramp, and its duration, s. Its jerk phases are as short as the jerk limit permits,
    /// since the acceleration is then the least.
    fn fastest_with(&self, ramp: f64) -> (Shape, f64) {
        let [velocity, acceleration, jerk] = self.tool;
        let free = Bounds { tool: [velocity, acceleration, f64::INFINITY], ..*self };
        let without_jerk = |shape| free.duration(&Course { shape, warp: None }, f64::INFINITY, &mut 0);
        let by_jerk = |shape: &Shape| (shape.peaks[2] / jerk).cbrt();
        let mut shape = Shape::new(ramp, 0.5);
        let mut best = (shape, f64::INFINITY);
        for _ in 0..REFINEMENTS {
            let time = without_jerk(shape);
            let within = time.max(by_jerk(&shape));
            if within < best.1 {
                best = (shape, within);
            }
            // The jerk is velocity / (ramp² share (1 − share)), and the velocity does not depend on the share.
            let product = shape.peaks[0] / (ramp * ramp * jerk * time.powi(3));
            let share = (2.0 * product / (1.0 + (1.0 - 4.0 * product).max(0.0).sqrt())).clamp(SHORTEST, 0.5);
            if (ramp * share - shape.rise).abs() <= SAME * ramp {
                break;
            }
            shape = Shape::new(ramp, share);
        }
        best
    }

    /// Demand on the speed in each cell, 0 to 1, of one joint, or of all joints together. `None` if a warp has no use.
    fn demand(&self, axis: usize, by: fn(&Place, usize) -> f64) -> Option<[f64; CELLS]> {
        let mut demand = [0.0_f64; CELLS];
        let axes = if axis < self.axes { axis..axis + 1 } else { 0..self.axes };
        for axis in axes {
            let mut own = [0.0_f64; CELLS];
            for place in self.places {
                let (cell, _) = Warp::place(place.s);
                own[cell] = own[cell].max(by(place, axis));
            }
            // A cell without a place is as its neighbour.
            for cell in 1..CELLS {
                own[cell] = if own[cell] == 0.0 { own[cell - 1] } else { own[cell] };
            }
            let greatest = own.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
            demand.iter_mut().zip(own).for_each(|(sum, own)| *sum += own / greatest);
        }
        let greatest = demand.iter().copied().fold(0.0, f64::max);
        let least = demand.iter().copied().fold(f64::INFINITY, f64::min);
        (least < UNEVEN * greatest).then(|| demand.map(|value| value / greatest))
    }

    /// The shortest duration of a course within all limits, s; infinity if that is above `most`. `hint` is the place
    /// that decided the last course above `most`: the same place is likely to decide the next.
    fn duration(&self, course: &Course, most: f64, hint: &mut usize) -> f64 {
        let mut time = match course.warp {
            Some(_) => 0.0,
            None => self.by_tool(course.shape.peaks),
        };
        time = time.max(self.at_place(&self.places[*hint], course));
        if time > most {
            return f64::INFINITY;
        }
        let Shape { ramp, rise, .. } = course.shape;
        for begin in [0.0, rise, ramp - rise, ramp] {
            for instant in [begin, 1.0 - begin] {
                let before = course.shape.at((instant - 1e-12).max(0.0));
                let after = course.shape.at((instant + 1e-12).min(1.0));
                let here = course.shape.at(instant);
                for jerk in [before[3], after[3]] {
                    let motion = course.passed([here[0], here[1], here[2], jerk]);
                    time = time.max(self.place(motion[0]).duration(motion));
                    if course.warp.is_some() {
                        time = time.max(self.by_tool([motion[1], motion[2], motion[3]]));
                    }
                }
            }
        }
        if time > most {
            return f64::INFINITY;
        }
        for (at, place) in self.places.iter().enumerate() {
            time = time.max(self.at_place(place, course));
            if time > most {
                *hint = at;
                return f64::INFINITY;
            }
        }
        time
    }

    /// The shortest duration of a course by the limits at one place, s.
    fn at_place(&self, place: &Place, course: &Course) -> f64 {
        let Some(warp) = &course.warp else {
            return place.duration(course.shape.at(course.shape.time_of(place.s)));
        };
        let (cell, u) = Warp::place(place.s);
        let way = warp.sums[cell] + warp.part(cell, u);
        let motion = warp.warped_at(cell, u, course.shape.at(course.shape.time_of(way)));
        place.duration(motion).max(self.by_tool([motion[1], motion[2], motion[3]]))
    }

    fn place(&self, s: f64) -> Place {
        let next = self.places.partition_point(|place| place.s <= s).clamp(1, self.places.len() - 1);
        self.places[next - 1].between(&self.places[next], s)
    }

    fn by_tool(&self, peaks: Rates) -> f64 {
        let [velocity, acceleration, jerk] = std::array::from_fn(|order| peaks[order].abs() / self.tool[order]);
        velocity.max(acceleration.sqrt()).max(jerk.cbrt())
    }
}

/// Argument from `least` to 0 with the least value of a function, and this value: a scan, and a golden-section search
/// around the best of the scan.
fn least_of(least: f64, mut value: impl FnMut(f64) -> f64) -> (f64, f64) {
    let at = |step: u32| least * (1.0 - f64::from(step) / f64::from(SCANNED));
    let mut best = (0.0, f64::INFINITY);
    let mut nearest = 0;
    for step in 0..=SCANNED {
        let found = value(at(step));
        if found <= best.1 {
            (best, nearest) = ((at(step), found), step);
        }
    }
    let golden = (5.0_f64.sqrt() - 1.0) / 2.0;
    let (mut low, mut high) = (at(nearest.saturating_sub(1)), at((nearest + 1).min(SCANNED)));
    let [mut left, mut right] = [high - golden * (high - low), low + golden * (high - low)];
    let [mut at_left, mut at_right] = [value(left), value(right)];
    for _ in 0..STEPS {
        if at_left < at_right {
            (high, right, at_right) = (right, left, at_left);
            left = high - golden * (high - low);
            at_left = value(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = low + golden * (high - low);
            at_right = value(right);
        }
    }
    for found in [(left, at_left), (right, at_right)] {
        if found.1 < best.1 {
            best = found;
        }
    }
    best
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
            let (cell, u) = Warp::place(here[0]);
            let way = warp.sums[cell] + warp.part(cell, u);
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
