//! Smooth joint positions along a path of the tool, for arms with more axes than a pose determines.
//!
//! The inverse kinematics of such an arm chooses the free parameter from the present posture. Where the choice changes,
//! the speed of the joints changes abruptly. A guide is a smooth curve near these joint positions. The joint positions
//! nearest to the guide that bring the tool to its pose are smooth as well, and depend on the path parameter alone.

use nalgebra::{SMatrix, SVector};
use servo::MAX_AXES;

use super::{Axes, Pose};
use crate::robot::{Arm, Joints, KinematicsError};

/// Number of cells of the curve.
const CELLS: usize = 16;
const DEGREE: usize = 3;
/// Number of control points.
const POINTS: usize = CELLS + DEGREE;
/// Largest number of Newton steps from the guide to the pose. The distance of the guide from the pose is some
/// millimetres.
const STEPS: usize = 4;
/// Distance that counts as rounding, m and rad.
const ROUNDING: f64 = 1e-12;
/// Damping of a Newton step, relative to a lever of 1 m.
const DAMPING: f64 = 1e-10;
/// Number of coordinates of a pose.
const COORDINATES: usize = 6;

/// A cubic B-spline over the path parameter, 0 to 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct Guide {
    points: [Axes; POINTS],
    /// Number of control points that are set.
    set: usize,
}

impl Guide {
    /// A guide without control points, if a pose does not determine the joints of the arm.
    pub(super) fn of(arm: &Arm) -> Option<Self> {
        (arm.axes() > COORDINATES).then_some(Self { points: [Axes::default(); POINTS], set: 0 })
    }

    /// Takes the joint positions of a part of the path, which continues the parts before.
    pub(super) fn follow(&mut self, from: (f64, &Axes), to: (f64, &Axes)) {
        while self.set < POINTS && Self::place(self.set) <= to.0 {
            let share = ((Self::place(self.set) - from.0) / (to.0 - from.0)).clamp(0.0, 1.0);
            self.points[self.set] = mixed(from.1, to.1, share);
            self.set += 1;
        }
    }

    fn knot(index: usize) -> f64 {
        index.saturating_sub(DEGREE).min(CELLS) as f64 / CELLS as f64
    }

    /// Path parameter of a control point: the mean of the knots inside its range.
    fn place(point: usize) -> f64 {
        (1..=DEGREE).map(|knot| Self::knot(point + knot)).sum::<f64>() / DEGREE as f64
    }

    /// The curve, by de Boor's algorithm.
    fn at(&self, s: f64) -> Axes {
        let cell = ((s * CELLS as f64) as usize).min(CELLS - 1);
        let mut points: [Axes; DEGREE + 1] = std::array::from_fn(|at| self.points[cell + at]);
        for round in 1..=DEGREE {
            for at in (round..=DEGREE).rev() {
                let low = Self::knot(cell + at);
                let high = Self::knot(cell + at + DEGREE + 1 - round);
                points[at] = mixed(&points[at - 1], &points[at], (s - low) / (high - low));
            }
        }
        points[DEGREE]
    }

    /// The joint positions that bring the tool to `pose`, from the guide at `s` by steps of least length.
    pub(super) fn inverse(&self, arm: &Arm, pose: &Pose, s: f64) -> Result<Axes, KinematicsError> {
        let flange = pose * arm.flange_from_tool().inverse();
        let mut joints = self.at(s);
        for _ in 0..=STEPS {
            let given = Joints::new(&joints[..arm.axes()]).expect("a robot has no more axes than the servo");
            let here = arm.robot().forward(&given)?;
            let turn = (flange.rotation * here.rotation.inverse()).scaled_axis();
            let way = flange.translation.vector - here.translation.vector;
            let missing = SVector::<f64, COORDINATES>::from_fn(|row, _| if row < 3 { way[row] } else { turn[row - 3] });
            if missing.norm() < ROUNDING {
                // The conversion checks all ranges.
                return arm.motors(&joints).map(|_| joints);
            }
            let jacobian = arm.robot().jacobian(&given)?;
            let square = jacobian * jacobian.transpose() + SMatrix::identity() * DAMPING;
            let Some(square) = square.cholesky() else { break };
            let step = jacobian.transpose() * square.solve(&missing);
            for axis in 0..MAX_AXES {
                joints[axis] += step[axis];
            }
        }
        arm.inverse(pose, &joints)
    }
}

fn mixed(from: &Axes, to: &Axes, share: f64) -> Axes {
    std::array::from_fn(|axis| from[axis] + (to[axis] - from[axis]) * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_guide_of_a_straight_course_is_this_course_and_a_kink_becomes_smooth() {
        let course = |kink: f64, s: f64| {
            let mut joints = Axes::default();
            joints[0] = 1.0 - 2.0 * s + kink * (s - 0.4).max(0.0);
            joints
        };
        for kink in [0.0, 3.0] {
            let mut guide = Guide { points: [Axes::default(); POINTS], set: 0 };
            for part in 0..50 {
                let [from, to] = [part, part + 1].map(|part| f64::from(part) / 50.0);
                guide.follow((from, &course(kink, from)), (to, &course(kink, to)));
            }
            assert_eq!(guide.set, POINTS);
            let ds = 1e-3;
            for k in 1..1000 {
                let s = f64::from(k) * ds;
                let [behind, here, ahead] = [s - ds, s, s + ds].map(|s| guide.at(s)[0]);
                assert!((here - course(kink, s)[0]).abs() < 1e-12 + 0.05 * kink, "{kink} {s}: {here}");
                let bend = (ahead - 2.0 * here + behind) / (ds * ds);
                assert!(bend.abs() < 1e-6 + 16.0 * kink, "{kink} {s}: {bend}");
            }
            assert_eq!([guide.at(0.0), guide.at(1.0)], [0.0, 1.0].map(|s| course(kink, s)), "{kink}");
        }
    }
}
