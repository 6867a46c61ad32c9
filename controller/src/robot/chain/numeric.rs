//! Inverse kinematics of any chain: the Levenberg-Marquardt method from a fixed sequence of starts.

use std::f64::consts::{PI, TAU};

use nalgebra::{Vector3, Vector6};
use servo::MAX_AXES;

use super::super::{Joints, KinematicsError, Solutions};
use super::pose_error::{PoseError, Target};
use super::{Chain, geometry::Frames};

/// Largest error of a solution, m and rad.
const EXACT: f64 = 1e-9;

/// Largest error of a solution of an arm with fewer than six axes, m and rad. Poses from texts have fewer digits than
/// an exact pose of such an arm needs. An exact solution is preferred.
const NEARBY: f64 = 1e-6;

/// Number of starts in which an exact solution is sought before a nearby solution is taken.
const EXACT_STARTS: usize = 4;

/// Share of half a range, counted from the middle of the range, beyond which a redundant arm moves a joint back.
const COMFORT: f64 = 0.75;

/// Square of the scaled error that rounding leaves.
const LEAST: f64 = 1e-29;

/// Square of the scaled error below which a step that does not reduce the error is the last.
const DONE: f64 = 1e-25;

/// Damping at zero error. A singular matrix needs some damping.
pub(super) const FLOOR: f64 = 1e-13;

/// Least and greatest factor of the square of the error in the damping.
const LIGHTEST: f64 = 1e-3;
const HEAVIEST: f64 = 1e6;

/// Numbers of starts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Starts {
    /// Starts within the ranges of the joints.
    bounded: usize,
    /// Starts that ignore the ranges of the joints, to tell a pose beyond a limit from a pose out of reach.
    unbounded: usize,
}

impl Starts {
    /// For a chain without a closed form.
    pub(super) const ALL: Self = Self { bounded: 64, unbounded: 8 };

    /// After a closed form has found no solution.
    pub(super) const FEW: Self = Self { bounded: 8, unbounded: 4 };
}

/// Most steps from one start.
const STEPS: usize = 60;

/// Number of steps in which the error has to fall by half.
const PATIENCE: usize = 8;

/// Largest step of a joint, rad (or in characteristic lengths).
const STRIDE: f64 = 1.0;

/// Result of one start.
#[derive(Clone, Copy, Debug)]
pub(super) struct Descent {
    pub(super) joints: [f64; MAX_AXES],
    pub(super) error: PoseError,
    pub(super) steps: usize,
}

/// Cost of a search.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cost {
    /// Number of starts.
    pub(super) starts: usize,
    /// Number of steps from all starts.
    pub(super) steps: usize,
}

impl Chain {
    /// Searches a posture for a pose. The search starts at `near`, and continues with the other starts until one of
    /// them leads to a solution.
    pub(super) fn search(
        &self,
        target: &Target,
        near: &[f64; MAX_AXES],
        starts: Starts,
        cost: &mut Cost,
    ) -> Result<Solutions, KinematicsError> {
        self.within_reach(target)?;
        let mut best: Option<Descent> = None;
        for (bounded, starts) in [(true, starts.bounded), (false, starts.unbounded)] {
            for start in 0..starts {
                let descent = self.descend(target, self.start(start, near), bounded);
                cost.starts += 1;
                cost.steps += descent.steps;
                if self.solves_exactly(&descent.error) {
                    return self.solution(descent, near);
                }
                if best.is_none_or(|best| self.square(&descent.error) < self.square(&best.error)) {
                    best = Some(descent);
                }
                if let Some(best) = best.filter(|best| start + 1 >= EXACT_STARTS && self.solves(&best.error)) {
                    return self.solution(best, near);
                }
            }
        }
        let error = best.expect("there is at least one start").error;
        Err(self.miss(&error))
    }

    /// The solution that a start led to. Without bounds the solution may lie beyond a limit, which is the reason for the
    /// refusal.
    fn solution(&self, mut descent: Descent, near: &[f64; MAX_AXES]) -> Result<Solutions, KinematicsError> {
        self.turn(&mut descent.joints, near);
        self.drives.motors(&descent.joints)?;
        Ok(Joints::from_padded(&descent.joints, self.geometry.axes).into())
    }

    /// The refusal of a pose, with the error of the nearest posture found.
    fn miss(&self, error: &PoseError) -> KinematicsError {
        let (distance, angle) = (error.distance(), error.angle());
        if angle < NEARBY {
            KinematicsError::Unreachable { margin: distance }
        } else {
            KinematicsError::Missed { distance, angle }
        }
    }

    /// Refuses a pose that is farther away than the arm is long.
    fn within_reach(&self, target: &Target) -> Result<(), KinematicsError> {
        let margin = (target.origin - self.root).norm() - self.reach;
        if margin > NEARBY { Err(KinematicsError::Unreachable { margin }) } else { Ok(()) }
    }

    /// Whether this error is small enough for a solution.
    pub(super) fn solves(&self, error: &PoseError) -> bool {
        let most = if self.geometry.axes < 6 { NEARBY } else { EXACT };
        error.distance() <= most && error.angle() <= most
    }

    pub(super) fn solves_exactly(&self, error: &PoseError) -> bool {
        error.distance() <= EXACT && error.angle() <= EXACT
    }

    /// Adds the whole turns to each joint that bring the joint nearest to `near` within its range.
    pub(super) fn turn(&self, joints: &mut [f64; MAX_AXES], near: &[f64; MAX_AXES]) {
        for (axis, joint) in joints[..self.geometry.axes].iter_mut().enumerate() {
            if self.geometry.is_prismatic(axis) {
                continue;
            }
            let range = self.drives.joint_limits[axis];
            let mut nearest = *joint;
            if (near[axis] - nearest).abs() > PI {
                nearest += TAU * ((near[axis] - nearest) / TAU).round();
            }
            let inside = match range.exceeded_by(nearest) {
                None => nearest,
                Some(limit) if limit == range.low => nearest + TAU * ((limit - nearest) / TAU).ceil(),
                Some(limit) => nearest - TAU * ((nearest - limit) / TAU).ceil(),
            };
            *joint = if range.exceeded_by(inside).is_none() { inside } else { nearest };
        }
    }

    /// Start number `number`: `near`, then points of an additive recurrence that covers the ranges evenly.
    fn start(&self, number: usize, near: &[f64; MAX_AXES]) -> [f64; MAX_AXES] {
        let mut joints = *near;
        if number == 0 {
            return joints;
        }
        for (axis, joint) in joints[..self.geometry.axes].iter_mut().enumerate() {
            let part = (0.5 + number as f64 * self.recurrence[axis]).fract();
            *joint = if self.turns[axis] {
                near[axis] + (part - 0.5) * TAU
            } else {
                let range = self.drives.joint_limits[axis];
                range.low + part * (range.high - range.low)
            };
        }
        joints
    }

    /// Square of the error, with lengths in characteristic lengths.
    pub(super) fn square(&self, error: &PoseError) -> f64 {
        error.scaled(self.length).norm_squared()
    }

    /// Minimises the error from one start. The joints stay within their ranges if `bounded`.
    pub(super) fn descend(&self, target: &Target, mut joints: [f64; MAX_AXES], bounded: bool) -> Descent {
        if bounded {
            self.clamp(&mut joints);
        }
        let mut frames = self.geometry.frames(&joints);
        let mut error = target.error(&frames);
        let mut square = self.square(&error);
        let (mut mark, mut damping, mut steps) = (square, 1.0, 0);
        while square > LEAST && steps < STEPS {
            steps += 1;
            let mut moved = joints;
            let Some(step) = self.step(target, &frames, &error, &joints, damping * square + FLOOR, bounded) else {
                break;
            };
            for (joint, step) in moved.iter_mut().zip(step) {
                *joint += step;
            }
            if bounded {
                self.clamp(&mut moved);
            }
            let moved_frames = self.geometry.frames(&moved);
            let moved_error = target.error(&moved_frames);
            let moved_square = self.square(&moved_error);
            if moved_square < square {
                (joints, frames, error, square) = (moved, moved_frames, moved_error, moved_square);
                damping = (damping * 0.3_f64).max(LIGHTEST);
            } else if square < DONE {
                break;
            } else {
                damping = (damping * 6.0_f64).min(HEAVIEST);
            }
            if steps % PATIENCE == 0 {
                if square > 0.5 * mark {
                    break;
                }
                mark = square;
            }
        }
        Descent { joints, error, steps }
    }

    /// Keeps the joints within their ranges, except joints that turn a whole turn.
    fn clamp(&self, joints: &mut [f64; MAX_AXES]) {
        for (axis, joint) in joints[..self.geometry.axes].iter_mut().enumerate() {
            if !self.turns[axis] {
                let range = self.drives.joint_limits[axis];
                *joint = joint.clamp(range.low, range.high);
            }
        }
    }

    /// One damped step of all joints, or `None` if the equations have no solution.
    pub(super) fn step(
        &self,
        target: &Target,
        frames: &Frames,
        error: &PoseError,
        joints: &[f64; MAX_AXES],
        damping: f64,
        bounded: bool,
    ) -> Option<[f64; MAX_AXES]> {
        let wanted = error.scaled(self.length);
        let mut columns = [Vector6::zeros(); MAX_AXES];
        let mut free = 0;
        let mut of_axis = [0; MAX_AXES];
        let tool = target.free_axis.map(|axis| frames.rotation * axis);
        for (axis, &joint) in joints[..self.geometry.axes].iter().enumerate() {
            let column = self.column(frames, axis, tool.as_ref());
            let slope = column.dot(&wanted);
            let range = self.drives.joint_limits[axis];
            // A joint at an end of its range stays there while the error would push the joint outwards.
            let held = bounded
                && !self.turns[axis]
                && (joint <= range.low && slope < 0.0 || joint >= range.high && slope > 0.0);
            if !held {
                columns[free] = column;
                of_axis[free] = axis;
                free += 1;
            }
        }
        let columns = &columns[..free];
        let mut matrix = [[0.0; MAX_AXES]; MAX_AXES];
        let mut step = [0.0; MAX_AXES];
        let mut parts = [0.0; MAX_AXES];
        let size = if tool.is_some() { 5 } else { 6 };
        if free <= size {
            for row in 0..free {
                for column in 0..=row {
                    matrix[row][column] = columns[row].dot(&columns[column]);
                }
                matrix[row][row] += damping;
                parts[row] = columns[row].dot(&wanted);
            }
            solve(&mut matrix, &mut parts, free)?;
        } else {
            // The shortest of all steps, beside a part p that moves joints back from the ends of their ranges by at most
            // the error: p + J' (J J' + d)⁻¹ (e - J p).
            let mut sides = [0.0; MAX_AXES];
            let size_of_error = wanted.norm();
            for (part, &axis) in parts.iter_mut().zip(&of_axis[..free]) {
                *part = self.discomfort(axis, joints[axis]) * size_of_error;
            }
            for row in 0..6 {
                for column in 0..=row {
                    matrix[row][column] = columns.iter().map(|it| it[row] * it[column]).sum();
                }
                matrix[row][row] += damping;
                sides[row] = wanted[row] - columns.iter().zip(&parts).map(|(it, part)| it[row] * part).sum::<f64>();
            }
            if let Some(tool) = tool {
                // No error lies along the free axis.
                for row in 0..3 {
                    for column in 0..=row {
                        matrix[3 + row][3 + column] += tool[row] * tool[column];
                    }
                }
            }
            solve(&mut matrix, &mut sides, 6)?;
            for (part, column) in parts.iter_mut().zip(columns) {
                *part += (0..6).map(|row| column[row] * sides[row]).sum::<f64>();
            }
        }
        let most = parts[..free].iter().fold(0.0_f64, |most, part| most.max(part.abs()));
        if !most.is_finite() {
            return None;
        }
        let share = if most > STRIDE { STRIDE / most } else { 1.0 };
        for (part, &axis) in parts[..free].iter().zip(&of_axis) {
            let unit = if self.geometry.is_prismatic(axis) { self.length } else { 1.0 };
            step[axis] = part * share * unit;
        }
        Some(step)
    }

    /// Direction and urgency, 0 to 1, of a motion back from an end of the range of a joint.
    fn discomfort(&self, axis: usize, joint: f64) -> f64 {
        let range = self.drives.joint_limits[axis];
        if range.is_continuous() {
            return 0.0;
        }
        let place = (2.0 * joint - range.low - range.high) / (range.high - range.low);
        -place.signum() * ((place.abs() - COMFORT) / (1.0 - COMFORT)).clamp(0.0, 1.0)
    }

    /// Change of the flange per unit of one joint. Lengths are in characteristic lengths, also the unit of a linear
    /// joint. A rotation about the free axis of the tool does not count.
    fn column(&self, frames: &Frames, axis: usize, tool: Option<&Vector3<f64>>) -> Vector6<f64> {
        let along = frames.axes[axis];
        let (linear, mut angular) = if self.geometry.is_prismatic(axis) {
            (along, Vector3::zeros())
        } else {
            (along.cross(&(frames.origin - frames.points[axis])) / self.length, along)
        };
        if let Some(tool) = tool {
            angular -= tool * tool.dot(&angular);
        }
        Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    }
}

/// Length that counts as much as a radian, m, of an arm of this reach.
pub(super) fn characteristic_length(reach: f64) -> f64 {
    if reach > 0.0 { 0.5 * reach } else { 1.0 }
}

/// Steps of the additive recurrence in each of `axes` dimensions: powers of the inverse of the root of
/// xⁿ⁺¹ = x + 1, as in the R-sequence of M. Roberts.
pub(super) fn recurrence(axes: usize) -> [f64; MAX_AXES] {
    let mut root = 2.0_f64;
    for _ in 0..64 {
        root = (1.0 + root).powf(1.0 / (axes as f64 + 1.0));
    }
    std::array::from_fn(|axis| root.powi(-(axis as i32) - 1))
}

/// Solves a symmetric positive definite system of `size` equations in place, by Cholesky's method on the lower triangle.
/// `None` if the matrix is not positive definite.
fn solve(matrix: &mut [[f64; MAX_AXES]; MAX_AXES], sides: &mut [f64; MAX_AXES], size: usize) -> Option<()> {
    for row in 0..size {
        for column in 0..=row {
            let products = matrix[row][..column].iter().zip(&matrix[column][..column]).map(|(a, b)| a * b);
            let sum = matrix[row][column] - products.sum::<f64>();
            if row != column {
                matrix[row][column] = sum / matrix[column][column];
            } else if sum > 0.0 {
                matrix[row][row] = sum.sqrt();
            } else {
                return None;
            }
        }
    }
    for row in 0..size {
        for inner in 0..row {
            sides[row] -= matrix[row][inner] * sides[inner];
        }
        sides[row] /= matrix[row][row];
    }
    for row in (0..size).rev() {
        for inner in row + 1..size {
            sides[row] -= matrix[inner][row] * sides[inner];
        }
        sides[row] /= matrix[row][row];
    }
    Some(())
}
