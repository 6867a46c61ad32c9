//! A jerk-limited plan by Ruckig, stretched to end with a macrostep.

use rsruckig::prelude::{
    DataArrayOrVec, InputParameter, Ruckig, RuckigResult, ThrowErrorHandler, Trajectory,
};

use super::GeneratorError;
use super::newsmooth::whole_macrosteps;

/// A plan of `N` coordinates.
#[derive(Debug)]
pub(super) struct Plan<const N: usize> {
    /// Start, targets and limits of [`solve`](Self::solve).
    pub(super) input: InputParameter<N>,
    solver: Ruckig<N, ThrowErrorHandler>,
    trajectory: Trajectory<N>,
    /// Macrosteps that the plan takes; 0 before it is solved.
    pub(super) macrosteps: u32,
    /// Trajectory seconds per macrostep.
    step: f64,
    /// Time scale of the slowed trajectory, at most 1.
    pace: f64,
}

impl<const N: usize> Plan<N> {
    /// A plan with space for this many waypoints.
    pub(super) fn new(on_the_way: usize) -> Self {
        let mut trajectory = Trajectory::new(None);
        trajectory.reserve_sections(on_the_way + 1);
        Self {
            input: InputParameter::with_waypoints(None, on_the_way),
            solver: Ruckig::with_waypoints(None, 1.0, on_the_way),
            trajectory,
            macrosteps: 0,
            step: 0.0,
            pace: 1.0,
        }
    }

    /// Solves the plan. The duration is `given`, s, or the shortest within the limits. The trajectory is slowed so that
    /// the duration is a whole number of macrosteps.
    pub(super) fn solve(
        &mut self,
        given: Option<f64>,
        macrostep: f64,
    ) -> Result<(), GeneratorError> {
        match self.solver.calculate(&self.input, &mut self.trajectory) {
            Ok(RuckigResult::Working | RuckigResult::Finished) => {}
            Ok(_) | Err(_) => return Err(GeneratorError::NoProfile),
        }
        let needed = self.trajectory.get_duration();
        let given = given.unwrap_or(needed);
        if given < needed {
            return Err(GeneratorError::TooShort { needed, given });
        }
        self.macrosteps = whole_macrosteps(given, macrostep)?;
        if self.macrosteps > 0 {
            self.step = needed / f64::from(self.macrosteps);
            self.pace = self.step / macrostep;
        }
        Ok(())
    }

    /// Position and velocity after this many macrosteps.
    pub(super) fn at(&self, done: u32) -> ([f64; N], [f64; N]) {
        let mut position = DataArrayOrVec::Stack([0.0; N]);
        let mut velocity = DataArrayOrVec::Stack([0.0; N]);
        self.trajectory.at_time(
            f64::from(done) * self.step,
            &mut Some(&mut position),
            &mut Some(&mut velocity),
            &mut None,
            &mut None,
            &mut None,
        );
        let velocity = std::array::from_fn(|axis| velocity[axis] * self.pace);
        (std::array::from_fn(|axis| position[axis]), velocity)
    }
}
