use std::ops::Deref;

use super::{Joints, KinematicsError, drive_train::DriveTrain};

/// Joints that put the flange at one pose, the preferred first; never empty, at most [`Solutions::MOST`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solutions {
    joints: [Joints; Self::MOST],
    count: usize,
}

impl Solutions {
    /// The most branches a robot here has.
    pub const MOST: usize = 8;

    /// The solution nearest to where the robot is.
    pub fn preferred(&self) -> &Joints {
        &self.joints[0]
    }
}

impl Deref for Solutions {
    type Target = [Joints];

    fn deref(&self) -> &[Joints] {
        &self.joints[..self.count]
    }
}

/// Collects the branches of one inverse problem: those within all limits, nearest first, and what to
/// say if there are none.
pub(super) struct Search<'a, const N: usize> {
    drive_train: &'a DriveTrain<N>,
    near: &'a [f64; N],
    found: Solutions,
    distances: [f64; Solutions::MOST],
    refused: KinematicsError,
    refused_at: f64,
}

impl<'a, const N: usize> Search<'a, N> {
    pub(super) fn new(drive_train: &'a DriveTrain<N>, near: &'a [f64; N]) -> Self {
        Self {
            drive_train,
            near,
            found: Solutions {
                joints: [Joints::from([0.0; N]); Solutions::MOST],
                count: 0,
            },
            distances: [f64::INFINITY; Solutions::MOST],
            refused: KinematicsError::Unreachable {
                margin: f64::INFINITY,
            },
            refused_at: f64::INFINITY,
        }
    }

    /// Where the robot is.
    pub(super) const fn near(&self) -> &'a [f64; N] {
        self.near
    }

    /// Sets one joint of a branch to `angle`, in the turn nearest to where the robot is.
    pub(super) fn turn(&self, joints: &mut [f64; N], axis: usize, angle: f64) {
        joints[axis] = self.drive_train.turn(axis, angle, joints, self.near[axis]);
    }

    /// Whether these axes of a branch, all that is known of it so far, are within their joint limits.
    pub(super) fn follow(&mut self, joints: &[f64; N], known: &[usize]) -> bool {
        let refusal = known
            .iter()
            .find_map(|&axis| self.drive_train.check_joint(axis, joints[axis]).err());
        if let Some(error) = refusal {
            self.refuse(joints, known, error);
        }
        refusal.is_none()
    }

    /// Notes why a branch does not exist; what the branch nearest to `near` is refused for stands.
    pub(super) fn refuse(&mut self, joints: &[f64; N], known: &[usize], error: KinematicsError) {
        let travel = known
            .iter()
            .map(|&axis| (joints[axis] - self.near[axis]).abs());
        self.refuse_at(travel.fold(0.0, f64::max), error);
    }

    /// Takes a branch if the robot can stand there. Distance is the largest joint travel from `near`.
    pub(super) fn offer(&mut self, joints: [f64; N]) {
        let travel = joints.iter().zip(self.near).map(|(a, b)| (a - b).abs());
        let distance = travel.fold(0.0, f64::max);
        if let Err(error) = self.drive_train.motors_from_joints(&joints) {
            return self.refuse_at(distance, error);
        }
        let Solutions {
            joints: list,
            count,
        } = &mut self.found;
        if *count == Solutions::MOST {
            return;
        }
        let mut place = *count;
        while place > 0 && self.distances[place - 1] > distance {
            self.distances[place] = self.distances[place - 1];
            list[place] = list[place - 1];
            place -= 1;
        }
        self.distances[place] = distance;
        list[place] = Joints::from(joints);
        *count += 1;
    }

    fn refuse_at(&mut self, distance: f64, error: KinematicsError) {
        if distance < self.refused_at {
            (self.refused_at, self.refused) = (distance, error);
        }
    }

    pub(super) fn finish(self) -> Result<Solutions, KinematicsError> {
        if self.found.count > 0 {
            Ok(self.found)
        } else {
            Err(self.refused)
        }
    }
}
