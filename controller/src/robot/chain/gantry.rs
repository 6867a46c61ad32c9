//! Closed form of Cartesian arms: three linear axes, and up to three revolute axes behind them.

use nalgebra::{Matrix3, Vector3};
use servo::MAX_AXES;

use super::pose_error::Target;
use super::screws::Screws;
use super::subproblems::across;
use super::wrist::{angle_or, orient};

/// Least volume of three unit vectors that count as independent.
const INDEPENDENT: f64 = 1e-3;

/// Three linear axes, and up to three revolute axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Gantry {
    screws: Screws,
    /// Positions of the linear axes for a translation.
    positions: Matrix3<f64>,
}

impl Gantry {
    pub(super) fn find(screws: &Screws) -> Option<Self> {
        let turning = 3..screws.count;
        if !(3..=6).contains(&screws.count)
            || screws.prismatic[..3].contains(&false)
            || turning.clone().any(|axis| screws.prismatic[axis])
            || turning.skip(1).any(|axis| screws.are_parallel(axis - 1, axis))
        {
            return None;
        }
        let directions = Matrix3::from_columns(&screws.axes[..3]);
        if directions.determinant().abs() < INDEPENDENT {
            return None;
        }
        Some(Self { screws: *screws, positions: directions.try_inverse()? })
    }

    /// Offers the branches of a pose. Returns whether the pose leaves an angle open.
    pub(super) fn visit(
        &self,
        target: &Target,
        near: &[f64; MAX_AXES],
        mut offer: impl FnMut(&[f64; MAX_AXES]),
    ) -> bool {
        let s = &self.screws;
        let displacement = s.displacement(target);
        let rotation = &displacement.rotation;
        let mut open = false;
        let mut finish = |angles: [f64; 3]| {
            let mut joints = *near;
            joints[3..6].copy_from_slice(&angles);
            let turned = (3..s.count).rev().fold(Vector3::zeros(), |point, axis| s.moved(axis, joints[axis], &point));
            let positions = self.positions * (displacement.of(&Vector3::zeros()) - turned);
            joints[..3].copy_from_slice(positions.as_slice());
            offer(&joints);
        };
        let near = [near[3], near[4], near[5]];
        match s.count {
            4 => {
                let aside = across(&s.axes[3]);
                finish([angle_or(&s.axes[3], &aside, &(rotation * aside), near[0], &mut open), near[1], near[2]]);
            }
            5 => {
                let first = angle_or(&s.axes[3], &s.axes[4], &(rotation * s.axes[4]), near[0], &mut open);
                let aside = across(&s.axes[4]);
                let back = s.rotation(3, -first) * (rotation * aside);
                finish([first, angle_or(&s.axes[4], &aside, &back, near[1], &mut open), near[2]]);
            }
            6 => return orient(&[s.axes[3], s.axes[4], s.axes[5]], rotation, near, finish),
            _ => finish(near),
        }
        open
    }
}
