//! Choice of the parameter that a pose leaves open for a robot of seven axes.
//!
//! The choice depends on the present posture and on the distance from there to the pose. A robot that is told to
//! stand does not move. A densely sampled path gives joints without jumps.

/// A range of the free parameter with a gap. The range reaches `outer` to either side of `centre`, limited by `low`
/// and `high`. Points nearer than `inner` to `centre` are excluded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ring {
    pub(super) centre: f64,
    pub(super) inner: f64,
    pub(super) outer: f64,
    pub(super) low: f64,
    pub(super) high: f64,
}

impl Ring {
    /// Tolerance for rounding errors in a ring that is a single point.
    pub(super) const POINT: f64 = 1e-12;

    /// The two pieces, lower first. An empty piece ends before it begins.
    pub(super) fn pieces(&self) -> [(f64, f64); 2] {
        let Self { centre, inner, outer, low, high } = *self;
        let (from, to) = ((centre - outer).max(low), (centre + outer).min(high));
        if inner <= 0.0 {
            return [(from, to), (1.0, 0.0)];
        }
        [(from, to.min(centre - inner)), (from.max(centre + inner), to)]
    }

    /// The point of the ring nearest to `wish`. Fails with the distance by which the ring is empty.
    pub(super) fn nearest(&self, wish: f64) -> Result<f64, f64> {
        let mut best: Option<f64> = None;
        let mut missing = f64::INFINITY;
        for (from, to) in self.pieces() {
            if from - to > Self::POINT {
                missing = missing.min(from - to);
                continue;
            }
            let point = wish.max(from.min(to)).min(to.max(from));
            if best.is_none_or(|best| (point - wish).abs() < (best - wish).abs()) {
                best = Some(point);
            }
        }
        best.ok_or(missing)
    }

    /// The part of the ring on the same side of its centre as `point`.
    pub(super) fn half(mut self, point: f64) -> Self {
        if point > self.centre {
            self.low = self.low.max(self.centre);
        } else {
            self.high = self.high.min(self.centre);
        }
        self
    }

    /// The middle of the piece that contains `point`.
    pub(super) fn middle(&self, point: f64) -> f64 {
        let pieces = self.pieces();
        let within = |&&(from, to): &&(f64, f64)| point >= from && point <= to;
        pieces.iter().find(within).map_or(point, |(from, to)| 0.5 * (from + to))
    }
}

/// Moves the parameter from its present value towards `comfort`. The displacement is at most [`GAIN`] times the
/// travel of the arm, and decreases within `band` of `comfort`.
pub(super) fn drift(from: f64, comfort: f64, way: f64, band: f64) -> f64 {
    let missing = comfort - from;
    from + missing * (GAIN * way / missing.abs().max(band)).min(1.0)
}

/// Displacement of the parameter per travel of the arm. A value above one keeps the parameter ahead of the moving
/// edges of its range.
const GAIN: f64 = 2.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_point_of_a_ring_is_on_the_side_of_the_wish() {
        let ring = |inner, outer| Ring { centre: 1.0, inner, outer, low: -0.5, high: 2.5 };
        for (inner, outer, wish, expected) in [
            (0.0, 1.0, 1.2, Ok(1.2)),
            (0.0, 1.0, 3.0, Ok(2.0)),
            (0.0, 9.0, 3.0, Ok(2.5)),
            (0.0, 9.0, -3.0, Ok(-0.5)),
            (0.5, 1.0, 1.2, Ok(1.5)),
            (0.5, 1.0, 0.8, Ok(0.5)),
            (0.5, 1.0, -7.0, Ok(0.0)),
            (0.5, 0.5, 2.0, Ok(1.5)),
            (2.0, 3.0, 1.0, Err(0.5)),
        ] {
            assert_eq!(ring(inner, outer).nearest(wish), expected, "{inner} {wish}");
        }
    }

    #[test]
    fn a_robot_that_stands_keeps_its_parameter() {
        assert_eq!(drift(0.3, 1.0, 0.0, 0.1), 0.3);
        assert_eq!(drift(0.3, 1.0, 9.0, 0.1), 1.0);
        assert!((drift(0.0, 1.0, 0.01, 0.1) - 0.02).abs() < 1e-15);
        assert!((drift(0.0, -0.05, 0.01, 0.1) + 0.01).abs() < 1e-15);
    }
}
