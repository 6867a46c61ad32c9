//! Derivatives of the joint positions along a path of the tool, from joint positions at ascending path parameters.

use super::progress::Place;
use super::{Axes, MotionLimits};

/// Largest number of places.
pub(super) const PLACES: usize = 1_024;

/// Places of a path, as far as the path is followed.
#[derive(Debug)]
pub(super) struct Survey<'a> {
    places: Vec<Place>,
    limits: &'a MotionLimits,
    axes: usize,
    /// Slope of the remainder, which decreases to zero along the path.
    remainder: &'a Axes,
    /// Path parameter and joint positions of the last node.
    last: (f64, Axes),
    /// Path parameter and slope from the node before to the last node.
    behind: Option<(f64, Axes)>,
    bend: Axes,
}

impl<'a> Survey<'a> {
    /// A survey from the start of the path. `places` is the memory for the result.
    pub(super) fn begin(
        mut places: Vec<Place>,
        limits: &'a MotionLimits,
        axes: usize,
        remainder: &'a Axes,
        start: &Axes,
    ) -> Self {
        places.clear();
        Self { places, limits, axes, remainder, last: (0.0, *start), behind: None, bend: Axes::default() }
    }

    pub(super) fn is_full(&self) -> bool {
        // A node adds one place, and the end another.
        self.places.len() + 2 >= PLACES
    }

    fn slope(&self, s: f64, joints: &Axes) -> Axes {
        let ahead = s - self.last.0;
        std::array::from_fn(|axis| (joints[axis] - self.last.1[axis]) / ahead - self.remainder[axis])
    }

    /// Largest change of the slope of a joint at the last node if `joints` is the next node, relative to the largest
    /// slope.
    pub(super) fn change(&self, s: f64, joints: &Axes) -> f64 {
        let Some((_, from_last)) = self.behind else { return 0.0 };
        let to_next = self.slope(s, joints);
        let (mut change, mut most) = (0.0_f64, 0.0_f64);
        for axis in 0..self.axes {
            change = change.max((to_next[axis] - from_last[axis]).abs());
            most = most.max(to_next[axis].abs()).max(from_last[axis].abs());
        }
        if change > 0.0 { change / most } else { 0.0 }
    }

    /// Adds a node.
    pub(super) fn add(&mut self, s: f64, joints: Axes) {
        let to_next = self.slope(s, &joints);
        let (at, _) = self.last;
        if let Some((before, from_last)) = self.behind {
            let (behind, ahead) = (at - before, s - at);
            let both = behind + ahead;
            self.bend = std::array::from_fn(|axis| 2.0 * (to_next[axis] - from_last[axis]) / both);
            if self.places.is_empty() {
                self.push(before, &std::array::from_fn(|axis| from_last[axis] - self.bend[axis] * behind / 2.0));
            }
            self.push(at, &std::array::from_fn(|axis| (from_last[axis] * ahead + to_next[axis] * behind) / both));
        }
        self.behind = Some((at, to_next));
        self.last = (s, joints);
    }

    fn push(&mut self, s: f64, slope: &Axes) {
        self.places.push(Place::new(s, slope, &self.bend, self.limits, self.axes));
    }

    /// The places of the path, whose last node is the end.
    pub(super) fn end(mut self) -> Vec<Place> {
        if let Some((before, from_last)) = self.behind {
            let (s, _) = self.last;
            self.push(s, &std::array::from_fn(|axis| from_last[axis] + self.bend[axis] * (s - before) / 2.0));
        }
        self.places
    }
}
