//! Bounds of the speed along a path of the tool by the limits of the joints.

use super::SlowedPart;
use super::cells::{Cells, Coupling};
use super::feed::Feed;
use super::progress::Place;

/// Number of instants at which a feed is compared with the limits of the joints.
const INSTANTS: u32 = 4_000;
/// Excess over a limit that is neglected, relative.
const SAME: f64 = 1e-9;

/// Derivatives of the joint positions over the arc length of a path, relative to the limits of the joints.
#[derive(Clone, Debug)]
pub(super) struct Demands {
    /// Places in ascending order, from the start of the path to its end.
    places: Vec<Place>,
    axes: usize,
    /// Whether the joints bound the speed on the whole path by the same value.
    constant_speed: bool,
}

impl Demands {
    pub(super) const fn new(places: Vec<Place>, axes: usize, constant_speed: bool) -> Self {
        Self { places, axes, constant_speed }
    }

    /// Bounds the speed between two arc lengths, m/s, because of a joint.
    pub(super) fn bound(&mut self, [from, to]: [f64; 2], speed: f64, joint: u8) {
        let first = self.places.partition_point(|place| place.s <= from).max(1) - 1;
        let last = self.places.partition_point(|place| place.s < to).min(self.places.len() - 1);
        self.places[first..=last].iter_mut().for_each(|place| place.bound(speed, joint));
    }

    /// Adds the limits of the joints to cells of the path.
    pub(super) fn couple(&self, cells: &mut Cells) {
        let count = cells.bounds.len();
        let none = || Coupling { slopes: vec![0.0; count], bends: vec![0.0; count] };
        let mut couplings: Vec<Coupling> = (0..self.axes).map(|_| none()).collect();
        let mut speeds = vec![0.0_f64; count];
        let mut first = 0;
        for cell in 0..count {
            // All places of the cell, and one more place beyond each end.
            while first + 1 < self.places.len() && self.places[first + 1].s <= cells.nodes[cell] {
                first += 1;
            }
            let beyond = self.places[first..].partition_point(|place| place.s < cells.nodes[cell + 1]);
            for place in &self.places[first..(first + beyond + 1).min(self.places.len())] {
                speeds[cell] = speeds[cell].max(place.speed);
                for (axis, Coupling { slopes, bends }) in couplings.iter_mut().enumerate() {
                    slopes[cell] = slopes[cell].max(place.slope[axis].abs());
                    bends[cell] = bends[cell].max(place.bend[axis].abs());
                }
            }
        }
        let bend = |cell: usize| couplings.iter().map(|coupling| coupling.bends[cell]).fold(0.0, f64::max);
        let by_joints: Vec<f64> = (0..count).map(|cell| (1.0 / speeds[cell]).min(1.0 / bend(cell).sqrt())).collect();
        let least = by_joints.iter().copied().fold(f64::INFINITY, f64::min);
        for (bound, own) in cells.bounds.iter_mut().zip(by_joints) {
            *bound = bound.min(if self.constant_speed { least } else { own });
        }
        cells.couplings.extend(couplings);
    }

    /// The part of the path in which a feed exceeds the limits of joints, around the place of the greatest excess.
    pub(super) fn slowed(&self, feed: &Feed) -> Option<SlowedPart> {
        let length = self.places[self.places.len() - 1].s;
        let mut slowed: Option<SlowedPart> = None;
        let (mut begin, mut greatest) = (None, false);
        for instant in 0..=INSTANTS {
            let state = feed.at(feed.duration() * f64::from(instant) / f64::from(INSTANTS));
            let motion = [state.distance, state.velocity, state.acceleration, state.jerk];
            let next = self.places.partition_point(|place| place.s <= state.distance).clamp(1, self.places.len() - 1);
            let place = self.places[next - 1].between(&self.places[next], state.distance);
            let (times, s) = (place.duration(motion), state.distance / length);
            if times <= 1.0 + SAME {
                (begin, greatest) = (None, false);
                continue;
            }
            let from = *begin.get_or_insert(s);
            if slowed.is_none_or(|part| times > part.times) {
                let (joint, limit) = place.decided_by(motion);
                slowed = Some(SlowedPart { from, to: s, joint, limit, times });
                greatest = true;
            } else if let Some(part) = slowed.as_mut().filter(|_| greatest) {
                part.to = s;
            }
        }
        slowed
    }
}
