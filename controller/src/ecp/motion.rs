//! Motion of an effector by a generator: first step, next steps, and the end of the motion.

use std::cell::RefCell;
use std::mem::replace;
use std::time::Duration;

use can::Instant;
use servo::{Macrostep, Order, Phase, Snapshot};

use super::around::Around;
use super::partners::Links;
use super::task::Instruction;
use super::{Activity, BURST, ChartPhase, Ecp, EcpConfig, EcpError, NotRunning, STILL, StepEvent};
use crate::coordination::{LinkError, MemberLink, Turn};
use crate::generator::{Axes, AxesState, Execution, Generator, GeneratorError, Pace, Run, Setpoint, Step};
use crate::sensor::Sensors;

/// Most bursts of short macrosteps in one poll.
const MOST_BURSTS: u16 = 10;

/// Bound of the number of macrosteps ahead, if they are shorter than the macrosteps of the cell.
const SHORT_MACROSTEPS: u64 = 1000;

impl EcpConfig {
    /// Greatest number of macrosteps that are ahead of the last reported macrostep.
    pub fn most_orders(&self) -> usize {
        self.orders_ahead(self.macrosteps_ahead.max(1), Pace::PERIOD) as usize
    }

    /// Number of macrosteps of this pace that last as long as `macrosteps` of the cell, with a bound. At least
    /// `macrosteps`.
    fn orders_ahead(&self, macrosteps: u16, pace: Pace) -> u64 {
        let macrosteps = u64::from(macrosteps);
        let short = macrosteps * u64::from(self.pace.periods / pace.periods);
        short.min(SHORT_MACROSTEPS).max(macrosteps)
    }
}

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
        (self.replacement, self.ended_by_team) = (None, false);
        let left = self.pace.periods.saturating_sub(self.pace.read_at);
        self.margin = self.config.period * u32::from(left);
        self.pace = match run.pace(self.config.pace) {
            Ok(pace) => pace,
            Err(error) => return self.fail(EcpError::Generator { step: 0, error }),
        };
        let (cell, Pace { periods, .. }) = (self.config.pace.periods, self.pace);
        if self.links.team.is_some() && self.pace != self.config.pace {
            return self.fail(EcpError::Generator { step: 0, error: GeneratorError::PaceInTeam { cell, periods } });
        }
        let description = run.description();
        let cycle = self.latest().at;
        self.journal.begin(cycle, description.generator, description.first);
        self.turn = 0;
        if let Some(link) = self.links.present() {
            link.begin();
        }
        self.sensors.begin();
        self.sensors.initiate(cycle);
        self.sensors.poll(cycle);
        self.activity = Activity::Awaiting { run, since: now };
        self.await_images(now, now)
    }

    /// Reads the images of the first step once they are there, and begins to plan.
    pub(super) fn await_images(&mut self, since: Instant, now: Instant) -> Option<Result<(), EcpError>> {
        if let Some(phase) = self.left_phase() {
            return self.fail(EcpError::BrokenOff { phase });
        }
        let Activity::Awaiting { run, .. } = &mut self.activity else {
            return None;
        };
        let (class, latest) = (run.description().first, self.link.latest.read());
        let cycle = latest.at;
        match turn(class, self.links.present(), &self.sensors, 0, &latest) {
            Ok(Turn::Ready) => {}
            Ok(Turn::Waiting) => {
                let waited = now.since(since);
                return if self.is_late(waited) { self.fail(EcpError::Unread { step: 0, waited }) } else { None };
            }
            Ok(Turn::EndMotion) => return self.conclude().then_some(Ok(())),
            Err(error) => return self.fail(EcpError::Link { step: 0, error }),
        }
        let around = Around {
            effector: &self.effector,
            sensors: &mut self.sensors,
            coordinator: self.links.present(),
            journal: RefCell::new(&mut self.journal),
            now: cycle,
        };
        if let Err(error) = run.initiate(&around) {
            return self.fail(EcpError::Generator { step: 0, error });
        }
        let macrostep = self.macrostep();
        let Activity::Awaiting { run, since } = replace(&mut self.activity, Activity::Idle) else {
            return None;
        };
        self.planning.begin(run, macrostep);
        self.activity = Activity::Planning { since };
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

    /// Whether the first step of a generator, `waited` for since its begin, is too late. In motion, the stop must reach
    /// the servo before the last macrostep ends.
    fn is_late(&self, waited: Duration) -> bool {
        if !self.in_motion {
            return waited > self.config.planning;
        }
        let cycle = self.latest().at;
        let reported = self.report.map_or(cycle, |report| report.snapshot.at);
        self.outstanding() == 0 && cycle.since(reported) + self.config.period > self.margin
    }

    /// The phase, if a motion cannot begin in it.
    fn left_phase(&self) -> Option<Phase> {
        let phase = self.phase();
        let begins = phase == Phase::Standing || self.in_motion && phase == Phase::Moving;
        (!begins).then_some(phase)
    }

    /// Takes the result of a first step, once it is computed.
    pub(super) fn advance_planning(&mut self, since: Instant, now: Instant) -> Option<Result<(), EcpError>> {
        if let Some(phase) = self.left_phase() {
            return self.fail(EcpError::BrokenOff { phase });
        }
        let Some((mut run, first)) = self.planning.finished() else {
            let waited = now.since(since);
            return if self.is_late(waited) { self.fail(EcpError::Unplanned { waited }) } else { None };
        };
        self.heard = now;
        // A next step that follows at once reads the present state, not the state before the planning.
        self.effector.measured = self.latest();
        let cycle = self.effector.measured.at;
        if first.is_ok() {
            self.chart = Some(ChartPhase::NextStep);
        }
        let mut around = Around {
            effector: &self.effector,
            sensors: &mut self.sensors,
            coordinator: self.links.present(),
            journal: RefCell::new(&mut self.journal),
            now: cycle,
        };
        let commanded = match first.and_then(|()| run.commit(&mut around)) {
            Ok(Step::Continue(None)) => Ok(()),
            Ok(Step::Continue(Some(_))) if self.links.team.is_some() && !self.in_motion => {
                Err(EcpError::Generator { step: 0, error: GeneratorError::CommandsAtFirst })
            }
            Ok(Step::Continue(setpoint)) => self.command(setpoint),
            Ok(Step::Ended) => return self.conclude().then_some(Ok(())),
            Err(error) => Err(EcpError::Generator { step: 0, error }),
        };
        if let Err(error) = commanded {
            return self.fail(error);
        }
        self.journal.commit(cycle, || run.digest());
        self.sensors.initiate(cycle);
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
            let alive = now.since(self.turned.1) <= self.config.silence;
            if phase == Phase::Moving && self.latest().rate < 1.0 && alive {
                self.heard = now;
            } else {
                self.brake(Err(EcpError::Silent { waited }));
            }
        } else if !matches!(self.activity, Activity::Running(_))
            && self.outstanding() > 0
            && !self.is_at_barrier()
            && self.is_ended_by_task()
        {
            self.brake(Ok(()));
        } else if matches!(self.activity, Activity::Arriving) {
            let arrived = phase == Phase::Standing && self.outstanding() == 0;
            return arrived.then_some(Ok(()));
        } else if matches!(self.activity, Activity::RunningOut) {
            self.run_out();
        } else {
            // Short macrosteps are sent for the same time, within a bound of the computing time.
            let short = (self.config.pace.periods / self.pace.periods).clamp(1, MOST_BURSTS);
            for _ in 0..BURST * short {
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
        let class = run.description().every;
        let ahead = run.macrosteps_ahead(self.config.macrosteps_ahead);
        if outstanding >= if class == 0 { self.config.orders_ahead(ahead, self.pace) } else { 1 } {
            return false;
        }
        let latest = self.link.latest.read();
        let cycle = latest.at;
        match turn(class, self.links.present(), &self.sensors, self.turn + 1, &latest) {
            Ok(Turn::Ready) => {}
            Ok(Turn::Waiting) => return false,
            Ok(Turn::EndMotion) => return self.end_as_ordered(),
            Err(error) => {
                self.brake(Err(EcpError::Link { step: self.sent - self.base, error }));
                return false;
            }
        }
        self.turn += 1;
        self.journal.next(class);
        let mut around = Around {
            effector: &self.effector,
            sensors: &mut self.sensors,
            coordinator: self.links.present(),
            journal: RefCell::new(&mut self.journal),
            now: cycle,
        };
        match run.next_step(&mut around) {
            Ok(Step::Continue(setpoint)) => {
                self.sensors.initiate(cycle);
                if let Err(error) = self.command(setpoint) {
                    self.brake(Err(error));
                } else if let Activity::Running(run) = &self.activity {
                    self.journal.note(cycle, StepEvent::Exchange, None);
                    self.journal.commit(cycle, || run.digest());
                }
            }
            Ok(Step::Ended) => return self.conclude(),
            Err(error) => self.brake(Err(EcpError::Generator { step: self.sent - self.base, error })),
        }
        false
    }

    /// Ends the motion that the coordinator ends. The coordinator of a team ends all members after the same macrostep. The
    /// task ends the motion at once, whatever was sent ahead.
    fn end_as_ordered(&mut self) -> bool {
        self.ended_by_team = self.links.team.is_some();
        // A stop would drop the barrier.
        if self.ended_by_team || self.is_at_barrier() {
            return self.conclude();
        }
        self.brake(Ok(()));
        false
    }

    /// Whether the task ends a motion whose generator has ended while macrosteps are still executed.
    fn is_ended_by_task(&mut self) -> bool {
        let (latest, step) = (self.latest(), self.turn);
        let Links { team: None, task: Some(link) } = &mut self.links else {
            return false;
        };
        matches!(link.poll(step, latest.at, latest.rate), Ok(Turn::EndMotion))
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

/// Whether a step of this class can take its images: readings that it waits for, and the order of its number. Times are those
/// of servo cycles, as all times of images.
fn turn(
    class: u8,
    coordinator: Option<&mut (dyn MemberLink + 'static)>,
    sensors: &Sensors,
    step: u64,
    latest: &Snapshot,
) -> Result<Turn, LinkError> {
    if class & 2 != 0 && !sensors.are_ready() {
        return Ok(Turn::Waiting);
    }
    coordinator.map_or(Ok(Turn::Ready), |link| link.poll(step, latest.at, latest.rate))
}
