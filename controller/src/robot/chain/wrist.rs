//! Closed forms of arms with a spherical wrist: three axes that meet carry the wrist's centre, three orient the flange.

use nalgebra::{Matrix3, Vector3};
use servo::MAX_AXES;

use super::pose_error::Target;
use super::screws::Screws;
use super::subproblems::{Roots, across, angle, distance, product, turned};

/// Geometry of the first three axes of an arm that gives a closed form.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shoulder {
    /// Axes 1 and 2 are parallel.
    Elbow,
    /// Axes 0 and 1 meet in this point.
    Crossing(Vector3<f64>),
    /// Axes 0 and 1 are parallel.
    Upright,
    /// Axes 1 and 2 meet in this point.
    CrossingElbow(Vector3<f64>),
}

/// A six-axis arm whose last three axes meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SphericalWrist {
    screws: Screws,
    centre: Vector3<f64>,
    shoulder: Shoulder,
}

impl SphericalWrist {
    pub(super) fn find(screws: &Screws) -> Option<Self> {
        if screws.count != 6 || screws.prismatic[..6].contains(&true) {
            return None;
        }
        let centre = screws.meeting([3, 4, 5])?;
        let shoulder = if screws.are_parallel(1, 2) && !screws.are_parallel(0, 1) {
            Shoulder::Elbow
        } else if let Some(point) = screws.crossing(0, 1) {
            Shoulder::Crossing(point)
        } else if screws.are_parallel(0, 1) && !screws.are_parallel(1, 2) {
            Shoulder::Upright
        } else {
            Shoulder::CrossingElbow(screws.crossing(1, 2)?)
        };
        Some(Self { screws: *screws, centre, shoulder })
    }

    /// Offers the branches of a pose. Returns whether the pose leaves an angle open.
    pub(super) fn visit(
        &self,
        target: &Target,
        near: &[f64; MAX_AXES],
        mut offer: impl FnMut(&[f64; MAX_AXES]),
    ) -> bool {
        let screws = &self.screws;
        let displacement = screws.displacement(target);
        let centre = displacement.of(&self.centre);
        let (mut open, mut wrist_open) = (false, false);
        self.arm(&centre, near, &mut open, |arm| {
            let mut joints = *near;
            joints[..3].copy_from_slice(&arm);
            let carried = screws.rotation(0, arm[0]) * screws.rotation(1, arm[1]) * screws.rotation(2, arm[2]);
            let wrist = carried.matrix().tr_mul(&displacement.rotation);
            let axes = [screws.axes[3], screws.axes[4], screws.axes[5]];
            wrist_open |= orient(&axes, &wrist, [near[3], near[4], near[5]], |angles| {
                joints[3..6].copy_from_slice(&angles);
                offer(&joints);
            });
        });
        open || wrist_open
    }

    /// Visits the angles of the first three axes that carry the wrist's centre to a point.
    fn arm(&self, point: &Vector3<f64>, near: &[f64; MAX_AXES], open: &mut bool, mut visit: impl FnMut([f64; 3])) {
        let (s, c) = (&self.screws, &self.centre);
        let [k0, k1, k2] = [s.axes[0], s.axes[1], s.axes[2]];
        let [p0, p1, p2] = [s.points[0], s.points[1], s.points[2]];
        match self.shoulder {
            Shoulder::Elbow => {
                // Axes 1 and 2 keep the coordinate along their direction.
                let roots = product(&-k0, &k1, &(point - p0), k1.dot(&(c - p0)));
                for q0 in roots.or_near(near[0], open) {
                    let lowered = s.moved(0, -q0, point);
                    let roots = planar_distance(&k2, &(c - p2), &(p1 - p2), &(lowered - p1));
                    for q2 in roots.or_near(near[2], open) {
                        let bent = s.moved(2, q2, c);
                        let q1 = angle_or(&k1, &(bent - p1), &(lowered - p1), near[1], open);
                        visit([q0, q1, q2]);
                    }
                }
            }
            Shoulder::Crossing(o) => {
                let roots = distance(&k2, &(c - p2), &(o - p2), (point - o).norm());
                for q2 in roots.or_near(near[2], open) {
                    let bent = s.moved(2, q2, c);
                    two(&k0, &k1, &(bent - o), &(point - o), [near[0], near[1]], open, |q0, q1| visit([q0, q1, q2]));
                }
            }
            Shoulder::Upright => {
                let roots = product(&k2, &k0, &(c - p2), k0.dot(&(point - p2)));
                for q2 in roots.or_near(near[2], open) {
                    let bent = s.moved(2, q2, c);
                    let roots = planar_distance(&k1, &(bent - p1), &(p0 - p1), &(point - p0));
                    for q1 in roots.or_near(near[1], open) {
                        let swung = s.moved(1, q1, &bent);
                        let q0 = angle_or(&k0, &(swung - p0), &(point - p0), near[0], open);
                        visit([q0, q1, q2]);
                    }
                }
            }
            Shoulder::CrossingElbow(o) => {
                let roots = distance(&-k0, &(point - p0), &(o - p0), (c - o).norm());
                for q0 in roots.or_near(near[0], open) {
                    let lowered = s.moved(0, -q0, point);
                    two(&k1, &k2, &(c - o), &(lowered - o), [near[1], near[2]], open, |q1, q2| visit([q0, q1, q2]));
                }
            }
        }
    }
}

/// The angles about `axis` by which `vector` turns until its distance from `from` is the length of `to`, all seen along
/// the axis.
pub(super) fn planar_distance(
    axis: &Vector3<f64>,
    vector: &Vector3<f64>,
    from: &Vector3<f64>,
    to: &Vector3<f64>,
) -> Roots {
    let seen = |vector: &Vector3<f64>| vector - axis * axis.dot(vector);
    distance(axis, &seen(vector), &seen(from), seen(to).norm())
}

/// The angle from one vector to another, or `near` if one of the vectors lies on the axis.
pub(super) fn angle_or(axis: &Vector3<f64>, from: &Vector3<f64>, to: &Vector3<f64>, near: f64, open: &mut bool) -> f64 {
    angle(axis, from, to).unwrap_or_else(|| {
        *open = true;
        near
    })
}

/// Visits the angles about two axes that turn one vector to another, about the second axis first.
fn two(
    first: &Vector3<f64>,
    second: &Vector3<f64>,
    from: &Vector3<f64>,
    to: &Vector3<f64>,
    near: [f64; 2],
    open: &mut bool,
    mut visit: impl FnMut(f64, f64),
) {
    for inner in product(second, first, from, first.dot(to)).or_near(near[1], open) {
        let carried = turned(second, inner, from);
        visit(angle_or(first, &carried, to, near[0], open), inner);
    }
}

/// Visits the angles about three axes whose rotations make up one rotation. Returns whether an angle is open.
pub(super) fn orient(
    [first, second, third]: &[Vector3<f64>; 3],
    rotation: &Matrix3<f64>,
    near: [f64; 3],
    mut visit: impl FnMut([f64; 3]),
) -> bool {
    let mut open = false;
    let end = rotation * third;
    for middle in product(second, first, third, first.dot(&end)).or_near(near[1], &mut open) {
        let carried = turned(second, middle, third);
        // Where the first and the third axis are one line, only the sum of their angles is determined.
        let start = angle_or(first, &carried, &end, near[0], &mut open);
        let aside = across(third);
        let back = turned(second, -middle, &turned(first, -start, &(rotation * aside)));
        let last = angle_or(third, &aside, &back, near[2], &mut open);
        visit([start, middle, last]);
    }
    open
}
