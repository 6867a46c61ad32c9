//! Geometry of the Polycrank: upper cranks, forearm and tool, with their reach, facings and Jacobian.

use std::f64::consts::PI;

use nalgebra::{Isometry3, Matrix3, Vector3};

use super::AXES;
use crate::robot::{
    Jacobian,
    arm::{self, PARALLEL},
    free_parameter::Ring,
};

/// Lever that converts a turn of the forearm's plane to a distance, m.
const LEVER: f64 = 0.5;
/// Distance from folded upper cranks, m, at which the reach begins to move away from them.
const EARLY: f64 = 0.1;

/// The lengths that determine poses, m. Offsets along one axis are summed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cranks {
    pub(super) upper: [f64; 2],
    pub(super) upper_offset: f64,
    pub(super) forearm: f64,
    pub(super) forearm_offset: f64,
    pub(super) flange_offset: f64,
}

/// One of the two orientations of the forearm's plane for a pose.
pub(super) struct Facing {
    /// q1 + q2 + q3.
    pub(super) phi: f64,
    /// q4 + q5 + q6.
    pub(super) psi: f64,
    /// q7.
    pub(super) roll: f64,
    /// Unit vector in the forearm's plane, perpendicular to axis 1.
    pub(super) ahead: Vector3<f64>,
    /// Vector from axis 1 to the end of the forearm, without the offsets, m.
    pub(super) end: Vector3<f64>,
}

pub(super) struct Stand {
    /// The forearm's reach, m.
    pub(super) reach: f64,
    ahead: Vector3<f64>,
    end: Vector3<f64>,
}

impl Stand {
    /// Travel of the arm from the present state to `facing`, m.
    pub(super) fn way_to(&self, facing: &Facing) -> f64 {
        (facing.end - self.end).norm() + LEVER * (facing.ahead - self.ahead).norm()
    }
}

/// Both pairs of crank angles for which the end of two cranks lies at a point, and the sine of the bend. The first
/// angle of a pair belongs to the first crank. The second angle is relative to the first crank. A point out of reach
/// is replaced by the nearest point within reach. For a point on the axis itself, the first angle is `kept`.
pub(super) fn angles([inner, outer]: [f64; 2], (x, y): (f64, f64), kept: f64) -> ([(f64, f64); 2], f64) {
    let square = x * x + y * y;
    let (sum, difference) = (inner + outer, inner - outer);
    // Sine and cosine of half the bend, by the law of cosines.
    let half = |squares: f64| (squares / (4.0 * inner * outer)).clamp(0.0, 1.0).sqrt();
    let sin = half(sum * sum - square);
    let cos = half(square - difference * difference);
    let half = sin.atan2(cos);
    let (bend, bend_sin) = (2.0 * half, 2.0 * sin * cos);
    if square < PARALLEL * PARALLEL {
        return ([(kept, bend), (kept, -bend)], bend_sin);
    }
    // Angle between the first crank and the line to the point: half the bend for equal cranks, otherwise by the law of
    // tangents.
    let lead = half - (difference * sin).atan2(sum * cos);
    let point = y.atan2(x);
    ([(point - lead, bend), (point + lead, -bend)], bend_sin)
}

/// End points of two cranks. `first` is the angle of the first crank, `both` the sum of the two angles.
fn ends([inner, outer]: [f64; 2], first: f64, both: f64) -> [(f64, f64); 2] {
    let ((s1, c1), (s2, c2)) = (first.sin_cos(), both.sin_cos());
    let (x, y) = (inner * c1, inner * s1);
    [(x, y), (x + outer * c2, y + outer * s2)]
}

/// Unit vectors in the forearm's plane perpendicular to axis 1, and along axis 4.
fn plane(phi: f64) -> (Vector3<f64>, Vector3<f64>) {
    let (s, c) = phi.sin_cos();
    (Vector3::new(c, s, 0.0), Vector3::new(s, -c, 0.0))
}

impl Cranks {
    /// End points of the upper cranks, perpendicular to axis 1.
    fn upper_ends(&self, q: &[f64; AXES]) -> [(f64, f64); 2] {
        ends(self.upper, q[0], q[0] + q[1])
    }

    /// End points of the forearm's cranks, (ahead, up) in the forearm's plane.
    fn forearm_ends(&self, q: &[f64; AXES]) -> [(f64, f64); 2] {
        ends([self.forearm; 2], q[3], q[3] + q[4])
    }

    pub(super) fn stand(&self, q: &[f64; AXES]) -> Stand {
        let ([_, (x, y)], [_, (reach, height)]) = (self.upper_ends(q), self.forearm_ends(q));
        let (ahead, _) = plane(q[0] + q[1] + q[2]);
        Stand { reach, ahead, end: Vector3::new(x, y, height) + ahead * reach }
    }

    pub(super) fn forward(&self, q: &[f64; AXES]) -> Isometry3<f64> {
        let (ahead, along) = plane(q[0] + q[1] + q[2]);
        let (level, approach) = tool(&ahead, q[3] + q[4] + q[5]);
        let ([_, (x, y)], [_, (reach, height)]) = (self.upper_ends(q), self.forearm_ends(q));
        let origin = Vector3::new(x, y, height + self.upper_offset)
            + ahead * reach
            + along * self.forearm_offset
            + approach * self.flange_offset;
        let (s7, c7) = q[6].sin_cos();
        let axes = [level * c7 + along * s7, along * c7 - level * s7, approach];
        arm::pose(origin, Matrix3::from_columns(&axes))
    }

    pub(super) fn jacobian(&self, q: &[f64; AXES]) -> Jacobian {
        let (ahead, along) = plane(q[0] + q[1] + q[2]);
        let (_, approach) = tool(&ahead, q[3] + q[4] + q[5]);
        let (upper, forearm) = (self.upper_ends(q), self.forearm_ends(q));
        let [_, (x, y)] = upper;
        let [_, (reach, height)] = forearm;
        let mut jacobian = Jacobian::zeros();
        let mut turn = |axis: usize, direction: &Vector3<f64>, lever: Vector3<f64>| {
            jacobian.fixed_view_mut::<3, 1>(0, axis).copy_from(&direction.cross(&lever));
            jacobian.fixed_view_mut::<3, 1>(3, axis).copy_from(direction);
        };
        // An offset along an axis does not move about the same axis, and is left out.
        let flange = approach * self.flange_offset;
        let end = Vector3::new(x, y, 0.0) + ahead * reach + along * self.forearm_offset + flange;
        for (axis, (x, y)) in [(0.0, 0.0), upper[0], upper[1]].into_iter().enumerate() {
            turn(axis, &Vector3::z(), end - Vector3::new(x, y, 0.0));
        }
        for (axis, (a, b)) in [(0.0, 0.0), forearm[0], forearm[1]].into_iter().enumerate() {
            let lever = ahead * (reach - a) + Vector3::z() * (height - b) + flange;
            turn(3 + axis, &along, lever);
        }
        turn(6, &approach, Vector3::zeros());
        jacobian
    }

    /// Both facings of a pose. The plane of one facing has the direction `(c, s)`, perpendicular to axis 1. `tilt` is
    /// the sine of the angle between axis 1 and tool axis.
    pub(super) fn facings(
        &self,
        origin: &Vector3<f64>,
        axes: &Matrix3<f64>,
        (c, s): (f64, f64),
        tilt: f64,
    ) -> [Facing; 2] {
        let (normal, approach) = (axes.column(0), axes.column(2));
        let ahead = Vector3::new(c, s, 0.0);
        let along = Vector3::new(s, -c, 0.0);
        let level = Vector3::new(-approach.z * c, -approach.z * s, tilt);
        let (phi, psi) = (s.atan2(c), tilt.atan2(-approach.z));
        let roll = normal.dot(&along).atan2(normal.dot(&level));
        let middle = origin - approach * self.flange_offset - Vector3::z() * self.upper_offset;
        let offset = along * self.forearm_offset;
        [
            Facing { phi, psi, roll, ahead, end: middle - offset },
            Facing { phi: phi + PI, psi: -psi, roll: roll + PI, ahead: -ahead, end: middle + offset },
        ]
    }

    /// The reaches of the forearm for which both pairs of cranks arrive at the end of a facing. Both pairs stay
    /// `spare` m from stretched, and the upper cranks also from folded. Fails with the missing distance, m.
    pub(super) fn reaches(&self, facing: &Facing, spare: f64) -> Result<Ring, f64> {
        let Facing { end, ahead, .. } = facing;
        let [inner, outer] = self.upper.map(f64::abs);
        let (near, far) = ((inner - outer).abs() + spare, inner + outer - spare);
        let along = end.x * ahead.x + end.y * ahead.y;
        let across = end.y * ahead.x - end.x * ahead.y;
        let span = half_chord(2.0 * self.forearm - spare, end.z)?;
        Ok(Ring {
            centre: along,
            inner: half_chord(near, across).unwrap_or(0.0),
            outer: half_chord(far, across)?,
            low: -span,
            high: span,
        })
    }

    /// The ring with a hole that grows gradually over [`EARLY`] m. The true hole, where the upper cranks would fold,
    /// appears faster than the reach can follow.
    pub(super) fn ahead_of_the_hole(&self, facing: &Facing, ring: Ring) -> Ring {
        let Facing { end, ahead, .. } = facing;
        let [inner, outer] = self.upper.map(f64::abs);
        let across = (end.y * ahead.x - end.x * ahead.y).abs();
        let folded = (inner - outer).abs();
        let early = (folded + EARLY - across).clamp(0.0, EARLY);
        Ring { inner: early + half_chord(folded, across).unwrap_or(0.0), ..ring }
    }
}

/// The first axis of the tool before its roll, and the tool axis.
fn tool(ahead: &Vector3<f64>, psi: f64) -> (Vector3<f64>, Vector3<f64>) {
    let (s, c) = psi.sin_cos();
    let up = Vector3::z();
    (ahead * c + up * s, ahead * s - up * c)
}

/// Half the chord of a circle at a distance from its centre. Fails with the distance by which the line misses the
/// circle.
fn half_chord(radius: f64, distance: f64) -> Result<f64, f64> {
    let distance = distance.abs();
    if distance - radius > Ring::POINT {
        return Err(distance - radius);
    }
    Ok(((radius - distance) * (radius + distance)).max(0.0).sqrt())
}
