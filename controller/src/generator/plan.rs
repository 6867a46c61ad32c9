//! Jerk-limited trajectory by Ruckig, slowed to last a whole number of macrosteps.

use rsruckig::prelude::{DataArrayOrVec, InputParameter, Ruckig, RuckigResult, ThrowErrorHandler, Trajectory};

use super::{GeneratorError, newsmooth::whole_macrosteps};

/// Greatest number of durations tried for a motion that begins or ends in motion.
const ATTEMPTS: usize = 10;

/// Jerk-limited trajectory of `N` coordinates.
#[derive(Debug)]
pub(super) struct Plan<const N: usize> {
    /// Start, target and limits for [`solve`](Self::solve).
    pub(super) input: InputParameter<N>,
    solver: Ruckig<N, ThrowErrorHandler>,
    trajectory: Trajectory<N>,
    /// Duration in macrosteps; 0 before [`solve`](Self::solve), or without motion.
    pub(super) macrosteps: u32,
    /// Trajectory time per macrostep, s.
    step: f64,
    /// Trajectory time divided by real time; at most 1, up to rounding.
    pace: f64,
}

impl<const N: usize> Plan<N> {
    /// An unsolved plan.
    pub(super) fn new() -> Self {
        Self {
            input: InputParameter::new(None),
            solver: Ruckig::new(None, 1.0),
            trajectory: Trajectory::new(None),
            macrosteps: 0,
            step: 0.0,
            pace: 1.0,
        }
    }

    /// Solves the plan for the duration `given`, s, or for the shortest duration within the limits. The duration is
    /// then rounded up to a multiple of `macrostep`, s.
    ///
    /// A motion from rest to rest is stretched. A motion that begins or ends in motion is solved again for the longer
    /// duration, because a stretched motion would have other speeds at its ends.
    pub(super) fn solve(&mut self, given: Option<f64>, macrostep: f64) -> Result<(), GeneratorError> {
        self.input.minimum_duration = None;
        let needed = self.calculate()?;
        let given = given.unwrap_or(needed);
        if given < needed {
            return Err(GeneratorError::TooShort { needed, given });
        }
        self.macrosteps = whole_macrosteps(given, macrostep)?;
        if self.macrosteps == 0 {
            return Ok(());
        }
        if self.rests_at_its_ends() {
            self.step = needed / f64::from(self.macrosteps);
            self.pace = self.step / macrostep;
            return Ok(());
        }
        (self.step, self.pace) = (macrostep, 1.0);
        for _ in 0..ATTEMPTS {
            let duration = f64::from(self.macrosteps) * macrostep;
            self.input.minimum_duration = Some(duration);
            let found = self.calculate()?;
            if (found - duration).abs() < 1e-6 * macrostep {
                return Ok(());
            }
            // Some durations are impossible, and the solver then takes the next possible one.
            self.macrosteps = whole_macrosteps(found, macrostep)?;
        }
        Err(GeneratorError::NoProfile)
    }

    /// Solves the plan and returns its duration, s.
    pub(super) fn calculate(&mut self) -> Result<f64, GeneratorError> {
        match self.solver.calculate(&self.input, &mut self.trajectory) {
            Ok(RuckigResult::Working | RuckigResult::Finished) => Ok(self.trajectory.get_duration()),
            Ok(_) | Err(_) => Err(GeneratorError::NoProfile),
        }
    }

    fn rests_at_its_ends(&self) -> bool {
        let input = &self.input;
        let ends = [&input.current_velocity, &input.current_acceleration, &input.target_velocity];
        ends.into_iter().all(|end| (0..N).all(|axis| end[axis] == 0.0))
    }

    /// Position, velocity and acceleration after `done` macrosteps.
    pub(super) fn at(&self, done: u32) -> [[f64; N]; 3] {
        let [position, velocity, acceleration] = self.state(f64::from(done) * self.step);
        [position, velocity.map(|value| value * self.pace), acceleration.map(|value| value * self.pace * self.pace)]
    }

    /// Position, velocity and acceleration at a time of the trajectory, s.
    pub(super) fn state(&self, time: f64) -> [[f64; N]; 3] {
        let mut position = DataArrayOrVec::Stack([0.0; N]);
        let mut velocity = DataArrayOrVec::Stack([0.0; N]);
        let mut acceleration = DataArrayOrVec::Stack([0.0; N]);
        self.trajectory.at_time(
            time,
            &mut Some(&mut position),
            &mut Some(&mut velocity),
            &mut Some(&mut acceleration),
            &mut None,
            &mut None,
        );
        let values = |values: DataArrayOrVec<f64, N>| std::array::from_fn(|axis| values[axis]);
        [values(position), values(velocity), values(acceleration)]
    }
}
