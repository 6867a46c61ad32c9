//! Closed forms of arms with three parallel axes: six-axis arms whose last two axes meet, planar five-axis arms, SCARA
//! arms.

use nalgebra::{Matrix3, Vector3};
use servo::MAX_AXES;

use super::pose_error::Target;
use super::screws::Screws;
use super::subproblems::{across, angle, product, turned};
use super::wrist::{angle_or, planar_distance};

/// Three revolute joints whose axes are parallel.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Plane {
    /// Numbers of the joints.
    axes: [usize; 3],
    /// Common direction of the axes.
    along: Vector3<f64>,
    /// Whether an axis has the common direction (1) or the opposite direction (-1).
    signs: [f64; 3],
    points: [Vector3<f64>; 3],
}

impl Plane {
    fn find(screws: &Screws, axes: [usize; 3]) -> Option<Self> {
        let [a, b, c] = axes;
        if !screws.are_parallel(a, b) || !screws.are_parallel(a, c) || axes.iter().any(|&axis| screws.prismatic[axis]) {
            return None;
        }
        let along = screws.axes[a];
        Some(Self {
            axes,
            along,
            signs: axes.map(|axis| along.dot(&screws.axes[axis]).signum()),
            points: axes.map(|axis| screws.points[axis]),
        })
    }

    /// Visits the angles that turn the plane by `rotation` and carry the point of the last axis to `point`.
    fn visit(
        &self,
        rotation: &Matrix3<f64>,
        point: &Vector3<f64>,
        joints: &[f64; MAX_AXES],
        open: &mut bool,
        mut visit: impl FnMut(&[f64; MAX_AXES]),
    ) {
        let (along, [p0, p1, p2]) = (&self.along, self.points);
        let [a, b, c] = self.axes;
        let near = |number: usize| joints[self.axes[number]] * self.signs[number];
        let aside = across(along);
        let sum = angle_or(along, &aside, &(rotation * aside), 0.0, open);
        for second in planar_distance(along, &(p2 - p1), &(p0 - p1), &(point - p0)).or_near(near(1), open) {
            let bent = p1 + turned(along, second, &(p2 - p1));
            let first = angle_or(along, &(bent - p0), &(point - p0), near(0), open);
            let mut joints = *joints;
            joints[a] = first * self.signs[0];
            joints[b] = second * self.signs[1];
            joints[c] = (sum - first - second) * self.signs[2];
            visit(&joints);
        }
    }
}

/// An arm whose axis 0 carries three parallel axes. These carry one axis, or two axes that meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ParallelArm {
    screws: Screws,
    plane: Plane,
    /// A point on axis 4, and on axis 5 if there is one.
    wrist: Vector3<f64>,
}

impl ParallelArm {
    pub(super) fn find(screws: &Screws) -> Option<Self> {
        if !(5..=6).contains(&screws.count) || screws.prismatic.contains(&true) {
            return None;
        }
        let plane = Plane::find(screws, [1, 2, 3])?;
        if screws.are_parallel(0, 1) || screws.are_parallel(3, 4) {
            return None;
        }
        let wrist = if screws.count == 6 { screws.crossing(4, 5)? } else { screws.points[4] };
        Some(Self { screws: *screws, plane, wrist })
    }

    /// Offers the branches of a pose. Returns whether the pose leaves an angle open.
    pub(super) fn visit(
        &self,
        target: &Target,
        near: &[f64; MAX_AXES],
        mut offer: impl FnMut(&[f64; MAX_AXES]),
    ) -> bool {
        let (s, along) = (&self.screws, &self.plane.along);
        let displacement = s.displacement(target);
        let wrist = displacement.of(&self.wrist);
        let mut open = false;
        // The three parallel axes keep the coordinate along their direction.
        let offset = along.dot(&(self.wrist - s.points[0]));
        let roots = product(&-s.axes[0], along, &(wrist - s.points[0]), offset);
        for q0 in roots.or_near(near[0], &mut open) {
            let lowered = s.rotation(0, -q0).matrix() * displacement.rotation;
            // The common direction, as the flange sees it at zero.
            let seen = lowered.tr_mul(along);
            let mut joints = *near;
            joints[0] = q0;
            let mut finish = |joints: &[f64; MAX_AXES], open: &mut bool| {
                let mut wrist = s.rotation(4, joints[4]).into_inner();
                if s.count == 6 {
                    wrist *= s.rotation(5, joints[5]).into_inner();
                }
                // The point of axis 3, carried back over the wrist to the flange, and forward to the target.
                let mut point = s.moved(4, -joints[4], &self.plane.points[2]);
                if s.count == 6 {
                    point = s.moved(5, -joints[5], &point);
                }
                let point = s.moved(0, -q0, &displacement.of(&point));
                self.plane.visit(&(lowered * wrist.transpose()), &point, joints, open, &mut offer);
            };
            if s.count == 5 {
                joints[4] = -angle_or(&s.axes[4], along, &seen, -near[4], &mut open);
                finish(&joints, &mut open);
                continue;
            }
            for q4 in product(&s.axes[4], along, &s.axes[5], seen.dot(&s.axes[5])).or_near(near[4], &mut open) {
                joints[4] = q4;
                let carried = turned(&s.axes[4], -q4, along);
                joints[5] = match angle(&s.axes[5], &carried, &seen) {
                    Some(back) => -back,
                    None => {
                        open = true;
                        near[5]
                    }
                };
                finish(&joints, &mut open);
            }
        }
        open
    }
}

/// Three parallel revolute axes, with or without one linear axis along them, in any order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scara {
    screws: Screws,
    plane: Plane,
    quill: usize,
}

impl Scara {
    pub(super) fn find(screws: &Screws) -> Option<Self> {
        if screws.count != 4 {
            return None;
        }
        let quill = screws.prismatic[..4].iter().position(|&prismatic| prismatic)?;
        let turning = match quill {
            0 => [1, 2, 3],
            1 => [0, 2, 3],
            2 => [0, 1, 3],
            _ => [0, 1, 2],
        };
        let plane = Plane::find(screws, turning)?;
        screws.are_parallel(quill, turning[0]).then_some(Self { screws: *screws, plane, quill })
    }

    /// Offers the branches of a pose. Returns whether the pose leaves an angle open.
    pub(super) fn visit(&self, target: &Target, near: &[f64; MAX_AXES], offer: impl FnMut(&[f64; MAX_AXES])) -> bool {
        let displacement = self.screws.displacement(target);
        let last = &self.plane.points[2];
        let point = displacement.of(last);
        let mut joints = *near;
        joints[self.quill] = self.screws.axes[self.quill].dot(&(point - last));
        let mut open = false;
        self.plane.visit(&displacement.rotation, &point, &joints, &mut open, offer);
        open
    }
}
