//! Branches of a closed form: exact, within all limits, nearest first.

use servo::MAX_AXES;

use super::super::{Joints, KinematicsError, Solutions};
use super::Chain;
use super::forms::Form;
use super::numeric::FLOOR;
use super::pose_error::Target;

/// Square of the scaled error of a branch from which Newton's method continues.
const NEAR_BRANCH: f64 = 1e-4;

/// Square of the scaled error of an exact branch.
const EXACT_BRANCH: f64 = 1e-24;

/// Most steps of Newton's method from a branch.
const STEPS: usize = 6;

/// Largest excess of a branch beyond a limit before Newton's method, rad or m.
const ROUGH: f64 = 1e-3;

/// Joint difference below which two branches are one, rad or m.
const SAME: f64 = 1e-7;

/// Collects the branches of one pose.
struct Branches<'a> {
    chain: &'a Chain,
    target: &'a Target,
    near: &'a [f64; MAX_AXES],
    found: Solutions,
    distances: [f64; Solutions::MOST],
    /// Whether the solutions reach the pose exactly, and not only nearby.
    exact: bool,
    /// Branches beyond a limit, not yet verified.
    beyond: [[f64; MAX_AXES]; Solutions::MOST],
    refused: usize,
}

/// A branch after Newton's method.
struct Settled {
    joints: [f64; MAX_AXES],
    /// Whether the branch reaches the pose exactly, and not only nearby.
    exact: bool,
}

impl Chain {
    /// The branches of a pose within all limits, nearest first. `None` if the closed form has no answer, because the
    /// pose is out of reach or leaves an angle open.
    pub(super) fn branches(
        &self,
        form: &Form,
        target: &Target,
        near: &[f64; MAX_AXES],
    ) -> Option<Result<Solutions, KinematicsError>> {
        let mut branches = Branches {
            chain: self,
            target,
            near,
            found: Solutions::none(),
            distances: [f64::INFINITY; Solutions::MOST],
            exact: false,
            beyond: [[0.0; MAX_AXES]; Solutions::MOST],
            refused: 0,
        };
        let open = form.visit(target, near, |joints| branches.offer(joints));
        if branches.found.is_empty() && !open {
            return branches.refusal();
        }
        (!branches.found.is_empty()).then_some(Ok(branches.found))
    }

    /// The posture of a branch, made exact. `None` if the branch does not lead to the pose.
    fn settle(&self, target: &Target, mut joints: [f64; MAX_AXES]) -> Option<Settled> {
        let mut frames = self.geometry.frames(&joints);
        let mut error = target.error(&frames);
        let mut square = self.square(&error);
        if square.is_nan() || square > NEAR_BRANCH {
            return None;
        }
        for _ in 0..STEPS {
            if square < EXACT_BRANCH {
                break;
            }
            let step = self.step(target, &frames, &error, &joints, FLOOR, false)?;
            let mut moved = joints;
            for (joint, step) in moved.iter_mut().zip(step) {
                *joint += step;
            }
            let moved_frames = self.geometry.frames(&moved);
            let moved_error = target.error(&moved_frames);
            let moved_square = self.square(&moved_error);
            if moved_square >= square {
                break;
            }
            (joints, frames, error, square) = (moved, moved_frames, moved_error, moved_square);
        }
        self.solves(&error).then(|| Settled { joints, exact: self.solves_exactly(&error) })
    }
}

impl Branches<'_> {
    fn offer(&mut self, joints: &[f64; MAX_AXES]) {
        let mut joints = *joints;
        self.chain.turn(&mut joints, self.near);
        let limits = self.chain.drives.joint_limits[..self.chain.geometry.axes].iter().zip(&joints);
        let mut excess = limits.map(|(limits, joint)| (limits.low - joint).max(joint - limits.high));
        if excess.any(|excess| excess > ROUGH) {
            return self.refuse(joints);
        }
        let Some(Settled { joints, exact }) = self.chain.settle(self.target, joints) else {
            return;
        };
        if self.chain.drives.motors(&joints).is_err() {
            return self.refuse(joints);
        }
        if exact && !self.exact {
            self.found = Solutions::none();
        } else if self.exact && !exact {
            return;
        }
        self.exact = exact;
        let axes = self.chain.geometry.axes;
        let differs = |other: &Joints| other.iter().zip(&joints).any(|(a, b)| (a - b).abs() > SAME);
        if self.found.iter().all(differs) {
            let distance = self.distance(&joints);
            self.found.insert(&mut self.distances, Joints::from_padded(&joints, axes), distance);
        }
    }

    /// Largest joint travel from the present posture, rad or m.
    fn distance(&self, joints: &[f64; MAX_AXES]) -> f64 {
        joints.iter().zip(self.near).fold(0.0, |most, (a, b)| f64::max(most, (a - b).abs()))
    }

    fn refuse(&mut self, joints: [f64; MAX_AXES]) {
        if self.refused < self.beyond.len() {
            self.beyond[self.refused] = joints;
            self.refused += 1;
        }
    }

    /// The limit that the nearest branch exceeds.
    fn refusal(&self) -> Option<Result<Solutions, KinematicsError>> {
        let settled = self.beyond[..self.refused].iter().filter_map(|joints| self.chain.settle(self.target, *joints));
        let nearest =
            settled.map(|settled| settled.joints).min_by(|a, b| self.distance(a).total_cmp(&self.distance(b)))?;
        let solution = Joints::from_padded(&nearest, self.chain.geometry.axes);
        Some(self.chain.drives.motors(&nearest).map(|_| solution.into()))
    }
}
