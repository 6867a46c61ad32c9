//! Solutions of inverse kinematics, the preferred solution first.

use std::ops::Deref;

use super::{Joints, KinematicsError, drive_train::DriveTrain};

/// Joints that bring the flange to one pose, the preferred solution first. At least one, at most [`Solutions::MOST`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solutions {
    joints: [Joints; Self::MOST],
    count: usize,
}

impl Solutions {
    /// Largest number of branches of a robot.
    pub const MOST: usize = 8;

    /// The solution nearest to the present posture.
    pub fn preferred(&self) -> &Joints {
        &self.joints[0]
    }

    /// No solution yet.
    pub(super) fn none() -> Self {
        Self { joints: [Joints::from([]); Self::MOST], count: 0 }
    }

    /// Inserts a solution at this distance from the present posture. `distances` has the distances of the present
    /// solutions. A solution beyond [`MOST`](Self::MOST) is dropped.
    pub(super) fn insert(&mut self, distances: &mut [f64; Self::MOST], joints: Joints, distance: f64) {
        if self.count == Self::MOST {
            return;
        }
        let mut place = self.count;
        while place > 0 && distances[place - 1] > distance {
            distances[place] = distances[place - 1];
            self.joints[place] = self.joints[place - 1];
            place -= 1;
        }
        distances[place] = distance;
        self.joints[place] = joints;
        self.count += 1;
    }

    /// The same solutions, each converted by `joints` for a robot with other axes.
    pub(super) fn map(mut self, joints: impl Fn(&Joints) -> Joints) -> Self {
        for solution in &mut self.joints[..self.count] {
            *solution = joints(solution);
        }
        self
    }
}

/// The branch of a robot with a single branch.
impl From<Joints> for Solutions {
    fn from(joints: Joints) -> Self {
        Self { joints: [joints; Self::MOST], count: 1 }
    }
}

impl Deref for Solutions {
    type Target = [Joints];

    fn deref(&self) -> &[Joints] {
        &self.joints[..self.count]
    }
}

/// Collects the branches of one inverse problem: those within all limits, nearest first, or the reason why there are
/// none.
pub(super) struct Search<'a, const N: usize> {
    drive_train: &'a DriveTrain<N>,
    /// The present posture.
    pub(super) near: &'a [f64; N],
    /// Whether a branch is abandoned at the first joint beyond its limit.
    hasty: bool,
    found: Solutions,
    distances: [f64; Solutions::MOST],
    refused: Option<(f64, KinematicsError)>,
    margin: f64,
}

impl<'a, const N: usize> Search<'a, N> {
    /// The solutions among the branches that `visit` offers. `visit` must offer the same branches in each call. If
    /// there is no solution, a second call follows every branch to its end to find the reason.
    pub(super) fn run(
        drive_train: &'a DriveTrain<N>,
        near: &'a [f64; N],
        visit: impl Fn(&mut Self),
    ) -> Result<Solutions, KinematicsError> {
        let mut search = Self {
            drive_train,
            near,
            hasty: true,
            found: Solutions::none(),
            distances: [f64::INFINITY; Solutions::MOST],
            refused: None,
            margin: f64::INFINITY,
        };
        visit(&mut search);
        if search.found.count == 0 {
            search.hasty = false;
            visit(&mut search);
        }
        if search.found.count > 0 {
            return Ok(search.found);
        }
        let unreachable = KinematicsError::Unreachable { margin: search.margin };
        Err(search.refused.map_or(unreachable, |(_, error)| error))
    }

    /// Sets the joints of a branch from `first` on, each in the turn nearest to the present posture.
    pub(super) fn turn<const K: usize>(&self, joints: &mut [f64; N], first: usize, angles: [f64; K]) {
        for (axis, angle) in (first..).zip(angles) {
            joints[axis] = self.drive_train.turn(axis, angle, joints, self.near[axis]);
        }
    }

    /// Whether a branch with this joint of `axis` is to be followed further.
    pub(super) fn follows(&self, joints: &[f64; N], axis: usize) -> bool {
        !self.hasty || self.drive_train.check_joint(axis, joints[axis]).is_ok()
    }

    /// Records the distance, m, by which a pair of branches is out of reach.
    pub(super) fn out_of_reach(&mut self, margin: f64) {
        self.margin = self.margin.min(margin);
    }

    /// Records why branches are missing. The reason is reported only if no branch was refused for a limit.
    pub(super) fn refuse(&mut self, error: KinematicsError) {
        self.refused.get_or_insert((f64::INFINITY, error));
    }

    /// Takes a branch, whose limits are those of the drive train.
    pub(super) fn offer(&mut self, joints: [f64; N]) {
        self.take(joints, self.drive_train.motors_from_joints(&joints).err());
    }

    /// Takes a branch. A branch without a refusal is kept; of the others, the refusal of the nearest is remembered. The
    /// distance of a branch is the largest joint travel from `near`.
    pub(super) fn take(&mut self, joints: [f64; N], refusal: Option<KinematicsError>) {
        let travel = joints.iter().zip(self.near).map(|(a, b)| (a - b).abs());
        // The numbers are finite, so the slower `f64::max` with its check for NaN is not needed.
        let distance = travel.fold(0.0, |most, way| if way > most { way } else { most });
        if let Some(error) = refusal {
            if self.refused.is_none_or(|(nearest, _)| distance < nearest) {
                self.refused = Some((distance, error));
            }
            return;
        }
        self.found.insert(&mut self.distances, Joints::from(joints), distance);
    }
}
