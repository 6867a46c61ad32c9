//! The fastest course of the path parameter within the limits of tool and joints.
//!
//! The search tries all courses of a fixed family, and omits only courses that cannot be the fastest: the duration of a
//! course is at least its duration at any one place. A few places decide the durations of most courses, and are tried
//! first.

use super::SlowedPart;
use super::progress::{CELLS, Course, Place, Rates, Shape, Warp};

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
/// Accepted relative distance of a duration from the least duration by the decisive places.
const NEAR: f64 = 1e-4;
/// Largest number of decisive places, which is also the largest number of searches for a shape.
const DECISIVE: usize = 16;

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

/// Indices of the places that decided the last courses, the last one first.
#[derive(Clone, Copy, Debug, Default)]
struct Decisive {
    places: [usize; DECISIVE],
    count: usize,
}

impl Decisive {
    /// Puts a place first. The place that decided longest ago leaves.
    fn put(&mut self, place: usize) {
        let known = self.places[..self.count].iter().position(|it| *it == place);
        let last = known.unwrap_or_else(|| {
            self.count = (self.count + 1).min(DECISIVE);
            self.count - 1
        });
        self.places.copy_within(..last, 1);
        self.places[0] = place;
    }

    fn iter(&self) -> impl Iterator<Item = usize> + use<> {
        self.places.into_iter().take(self.count)
    }
}

impl Bounds<'_> {
    /// The fastest course, and its duration, s. `None` if the limits of the tool alone determine the motion.
    pub(super) fn fastest(&self) -> Option<(Course, f64)> {
        let (shape, least) = Shape::fastest(self.tool);
        let by_tool = Course { shape, warp: None };
        let mut decisive = Decisive::default();
        let time = self.duration(&by_tool, f64::INFINITY, &mut decisive);
        if time <= least * (1.0 + SAME) {
            return None;
        }
        let mut best = (by_tool, time);
        let (shape, time) = self.fastest_shape(&mut decisive);
        if time < best.1 {
            best = (Course { shape, warp: None }, time);
        }
        if self.constant_speed {
            return Some(best);
        }
        let by_slope: fn(&Place, usize) -> f64 = |place, axis| place.slope[axis].abs();
        let by_bend: fn(&Place, usize) -> f64 = |place, axis| place.bend[axis].abs().sqrt();
        for (axis, by) in (0..=self.axes).rev().flat_map(|axis| [by_slope, by_bend].map(|by| (axis, by))) {
            let Some(demand) = self.demand(axis, by) else { continue };
            for strength in STRENGTHS {
                let warp = Some(Warp::new(&demand, strength));
                for shape in RAMPS.into_iter().flat_map(|ramp| JERK_SHARES.map(|share| Shape::new(ramp, share))) {
                    let course = Course { shape, warp };
                    let time = self.duration(&course, best.1, &mut decisive);
                    if time < best.1 {
                        best = (course, time);
                    }
                }
            }
        }
        Some(best)
    }

    /// The part in which the fastest motion within the limits of the tool would exceed the limits of joints, around the
    /// place of the greatest excess.
    pub(super) fn slowed(&self) -> Option<SlowedPart> {
        let (shape, least) = Shape::fastest(self.tool);
        let mut slowed: Option<SlowedPart> = None;
        // Begin of the present part, and whether this part has the greatest excess.
        let (mut begin, mut greatest) = (None, false);
        for place in self.places {
            let motion = shape.at(shape.time_of(place.s));
            let times = place.duration(motion) / least;
            if times <= 1.0 + SAME {
                (begin, greatest) = (None, false);
                continue;
            }
            let from = *begin.get_or_insert(place.s);
            if slowed.is_none_or(|part| times > part.times) {
                let (joint, limit) = place.decided_by(motion);
                slowed = Some(SlowedPart { from, to: place.s, joint, limit, times });
                greatest = true;
            } else if let Some(part) = slowed.as_mut().filter(|_| greatest) {
                part.to = place.s;
            }
        }
        slowed
    }

    /// The shape without a warp that takes the least time, and this time.
    ///
    /// The search regards the decisive places alone, and its least duration is no longer than the least duration by all
    /// places. The search is repeated with the place that decides its result until both durations agree.
    fn fastest_shape(&self, decisive: &mut Decisive) -> (Shape, f64) {
        let mut best = (Shape::new(0.5, 0.5), f64::INFINITY);
        for _ in 0..DECISIVE {
            let least = (2.0 * SHORTEST).ln();
            let (ramp, _) = least_of(least, |ramp| self.fastest_with(0.5 * ramp.exp(), decisive).1);
            let (shape, bound) = self.fastest_with(0.5 * ramp.exp(), decisive);
            let time = self.duration(&Course { shape, warp: None }, f64::INFINITY, decisive);
            if time < best.1 {
                best = (shape, time);
            }
            if best.1 <= bound * (1.0 + NEAR) {
                break;
            }
        }
        best
    }

    /// The fastest shape with a ramp by the decisive places, and its duration, s. Its jerk phases are as short as the
    /// jerk limit permits, since the acceleration is then the least.
    fn fastest_with(&self, ramp: f64, decisive: &Decisive) -> (Shape, f64) {
        let [velocity, acceleration, jerk] = self.tool;
        let free = Bounds { tool: [velocity, acceleration, f64::INFINITY], ..*self };
        let without_jerk = |shape: Shape| {
            let course = Course { shape, warp: None };
            let time = free.by_tool(shape.peaks).max(free.at_phases(&course));
            decisive.iter().map(|place| free.at_place(&self.places[place], &course)).fold(time, f64::max)
        };
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

    /// The shortest duration of a course within all limits, s; infinity if that is above `most`.
    fn duration(&self, course: &Course, most: f64, decisive: &mut Decisive) -> f64 {
        let mut time = match course.warp {
            Some(_) => 0.0,
            None => self.by_tool(course.shape.peaks),
        };
        let above = |place: usize| self.at_place(&self.places[place], course) > most;
        let first = decisive.iter().find(|place| above(*place));
        if let Some(place) = first {
            decisive.put(place);
            return f64::INFINITY;
        }
        time = time.max(self.at_phases(course));
        if time > most {
            return f64::INFINITY;
        }
        let mut last = None;
        for (at, place) in self.places.iter().enumerate() {
            let here = self.at_place(place, course);
            if here > time {
                (time, last) = (here, Some(at));
            }
            if time > most {
                break;
            }
        }
        if let Some(place) = last {
            decisive.put(place);
        }
        if time > most { f64::INFINITY } else { time }
    }

    /// The shortest duration of a course by the limits where its jerk changes, s.
    fn at_phases(&self, course: &Course) -> f64 {
        let Shape { ramp, rise, peaks: [_, _, jerk] } = course.shape;
        let phases = [(0.0, [jerk, jerk]), (rise, [jerk, 0.0]), (ramp - rise, [0.0, -jerk]), (ramp, [-jerk, 0.0])];
        let mut time = 0.0_f64;
        for (instant, jerks) in phases.into_iter().flat_map(|(begin, jerks)| [(begin, jerks), (1.0 - begin, jerks)]) {
            let shape = course.shape.at(instant);
            let Some(warp) = &course.warp else {
                time = time.max(self.place(shape[0]).duration(shape));
                continue;
            };
            let found = warp.find(shape[0]);
            for jerk in jerks {
                let motion = warp.warped(found, [shape[0], shape[1], shape[2], jerk]);
                time = time.max(self.by_tool([motion[1], motion[2], motion[3]]));
            }
            let motion = warp.warped(found, shape);
            time = time.max(self.place(motion[0]).duration(motion));
        }
        time
    }

    /// The shortest duration of a course by the limits at one place, s.
    fn at_place(&self, place: &Place, course: &Course) -> f64 {
        let Some(warp) = &course.warp else {
            return place.duration(course.shape.at(course.shape.time_of(place.s)));
        };
        let found = Warp::place(place.s);
        let way = warp.way(found);
        let motion = warp.warped(found, course.shape.at(course.shape.time_of(way)));
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
