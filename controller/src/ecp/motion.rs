//! Motion of an effector by a generator: first step, next steps, and the end of the motion.

use std::time::Duration;

use can::Instant;
use servo::{Macrostep, Order, Phase, Snapshot};

use super::task::Instruction;
use super::{Activity, BURST, ChartPhase, Ecp, EcpError, NotRunning, STILL};
use crate::generator::{Axes, AxesState, Execution, Generator, Run, Setpoint, Step};

impl Ecp {
    /// Replaces the generator of the present motion. The new generator plans from the end of the macrosteps that were
    /// already sent ([`macrosteps_ahead`](super::EcpConfig::macrosteps_ahead)); the replaced instruction ends with success. If the new generator
    /// cannot begin in motion, the effector is braked first.
    ///
    /// A second call before the next poll replaces the first. Without a motion by a generator, the call is refused.
    pub fn replace(&mut self, generator: impl Generator) -> Result<(), NotRunning> {
        if !matches!(self.activity, Activity::Running(_)) {
            return Err(NotRunning);
        }
        self.replacement = Some(Box::new(Run::new(generator)));
        Ok(())
    }

    pub(super) fn begin_run(&mut self, run: Box<dyn Execution + Send>, now: Instant) -> Option<Result<(), EcpError>> {
        // The last report may be old: an effector at rest sends none.
        let latest = self.latest();
        self.effector.measured = latest;
        if !self.in_motion {
            self.effector.commanded = AxesState::at_rest(latest.commanded);
            // Numbers of macrosteps that the servo dropped at a stop are not used again.
            self.sent = self.sent.max(latest.macrostep);
            self.origin = self.sent;
        }
        self.base = self.sent;
        self.chart = Some(ChartPhase::FirstStep);
        self.replacement = None;
        let left = self.pace.periods.saturating_sub(self.pace.read_at);
        self.margin = self.config.period * u32::from(left.saturating_sub(1));
        self.pace = match run.pace(self.config.pace) {
            Ok(pace) => pace,
            Err(error) => return self.fail(EcpError::Generator { step: 0, error }),
        };
        self.planning.begin(run, &self.effector, self.macrostep());
        self.activity = Activity::Planning { since: now };
        None
    }

    /// Ends an instruction by an error before its first macrostep. A moving effector is braked first.
    fn fail(&mut self, error: EcpError) -> Option<Result<(), EcpError>> {
        if !self.in_motion {
            return Some(Err(error));
        }
        self.brake(Err(error));
        None
    }

    /// Takes the result of a first step, once it is computed.
    pub(super) fn advance_planning(&mut self, since: Instant, now: Instant) -> Option<Result<(), EcpError>> {
        let phase = self.phase();
        if phase != Phase::Standing && !(self.in_motion && phase == Phase::Moving) {
            return self.fail(EcpError::BrokenOff { phase });
        }
        let Some((run, first)) = self.planning.finished() else {
            let waited = now.since(since);
            // In motion, the stop must reach the servo before the last macrostep ends.
            let reported = self.report.map_or(now, |report| report.snapshot.at);
            let late = if self.in_motion {
                self.outstanding() == 0 && now.since(reported) > self.margin
            } else {
                waited > self.config.planning
            };
            return if late { self.fail(EcpError::Unplanned { waited }) } else { None };
        };
        self.heard = now;
        // A next step that follows at once reads the present state, not the state before the planning.
        self.effector.measured = self.latest();
        if first.is_ok() {
            self.chart = Some(ChartPhase::NextStep);
        }
        let commanded = match first {
            Ok(Step::Continue(None)) => Ok(()),
            Ok(Step::Continue(setpoint)) => self.command(setpoint),
            Ok(Step::Ended) => return self.conclude().then_some(Ok(())),
            Err(error) => Err(EcpError::Generator { step: 0, error }),
        };
        if let Err(error) = commanded {
            return self.fail(error);
        }
        self.in_motion = false;
        self.activity = Activity::Running(run);
        None
    }

    pub(super) fn advance_motion(&mut self, now: Instant) -> Option<Result<(), EcpError>> {
        let phase = self.phase();
        let waited = now.since(self.heard);
        if !matches!(phase, Phase::Standing | Phase::Moving) {
            self.break_off(now);
        } else if waited > self.config.silence + self.macrostep() {
            // Slowed motion reports later.
            let Snapshot { rate, at, .. } = self.latest();
            if phase == Phase::Moving && rate < 1.0 && now.since(at) <= self.config.silence {
                self.heard = now;
            } else {
                self.brake(Err(EcpError::Silent { waited }));
            }
        } else if matches!(self.activity, Activity::Arriving) {
            let arrived = phase == Phase::Standing && self.outstanding() == 0;
            return arrived.then_some(Ok(()));
        } else if matches!(self.activity, Activity::RunningOut) {
            self.run_out();
        } else {
            for _ in 0..BURST {
                if self.step() {
                    return Some(Ok(()));
                }
            }
        }
        None
    }

    /// Stops a motion whose generator ended in motion, once its last macrostep is reported. If images are read after
    /// the last period of a macrostep, the stop must be sent in the same poll.
    fn run_out(&mut self) {
        if self.outstanding() == 0 {
            self.brake(Ok(()));
        }
    }

    /// Requests the next macrostep from the generator if the macrostep is due. Returns whether the instruction ends at
    /// once, because the next one continues its motion.
    fn step(&mut self) -> bool {
        let outstanding = self.outstanding();
        let Activity::Running(run) = &mut self.activity else {
            return false;
        };
        if let Some(replacement) = self.replacement.take() {
            self.task.instructions.push_front(Instruction::Run(replacement));
            self.replaced = true;
            return self.conclude();
        }
        if outstanding >= u64::from(run.macrosteps_ahead(self.config.macrosteps_ahead)) {
            return false;
        }
        match run.next_step(&self.effector) {
            Ok(Step::Continue(setpoint)) => {
                if let Err(error) = self.command(setpoint) {
                    self.brake(Err(error));
                }
            }
            Ok(Step::Ended) => return self.conclude(),
            Err(error) => self.brake(Err(EcpError::Generator { step: self.sent - self.base, error })),
        }
        false
    }

    /// Ends the motion of a generator that has ended. Returns whether the next instruction continues the motion.
    fn conclude(&mut self) -> bool {
        if self.effector.commanded.velocity == Axes::default() {
            self.activity = Activity::Arriving;
            return false;
        }
        let next = self.task.instructions.front();
        self.in_motion = next.is_some_and(|next| matches!(next, Instruction::Run(run) if run.begins_in_motion()));
        if !self.in_motion {
            self.activity = Activity::RunningOut;
            self.run_out();
        }
        self.in_motion
    }

    /// Duration of a macrostep of this motion.
    pub(super) fn macrostep(&self) -> Duration {
        self.config.period * u32::from(self.pace.periods)
    }

    /// Number of macrosteps of this motion that were made and not yet reported.
    pub(super) fn outstanding(&self) -> u64 {
        self.sent.saturating_sub(self.executed.max(self.origin))
    }

    /// Converts the generator's set-point to a macrostep and puts the macrostep into the outbox.
    fn command(&mut self, setpoint: Option<Setpoint>) -> Result<(), EcpError> {
        let step = self.sent - self.base;
        if let Some(axis) = setpoint.and_then(|setpoint| setpoint.not_finite()) {
            return Err(EcpError::NotFinite { step, axis });
        }
        let out_of_reach = |error| EcpError::OutOfReach { step, error };
        let seconds = self.macrostep().as_secs_f64();
        let mut motors = self.effector.motors(setpoint, seconds).map_err(out_of_reach)?;
        for velocity in motors.velocity.iter_mut().filter(|it| it.abs() < STILL) {
            *velocity = 0.0;
        }
        let torque = self.effector.arm.torques(&motors.position).map_err(out_of_reach)?;
        self.effector.commanded = motors;
        self.sent += 1;
        self.outbox.push_back(Order::Move(Macrostep {
            number: self.sent,
            steps: self.pace.periods,
            report_at: self.pace.read_at,
            position: motors.position,
            velocity: motors.velocity,
            acceleration: motors.acceleration,
            torque,
        }));
        Ok(())
    }
}
