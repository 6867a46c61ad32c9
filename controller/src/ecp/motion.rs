//! Motion of an effector by a generator: first step, next steps, and the end of the motion.

use std::array;
use std::cell::RefCell;
use std::mem::replace;
use std::num::NonZeroU64;
use std::time::Duration;

use can::Instant;
use servo::{LawParameters, MAX_AXES, Macrostep, Order, Phase, Snapshot, StopCause};

use super::around::Around;
use super::task::Instruction;
use super::{Activity, BURST, ChartPhase, Ecp, EcpError, ReplaceRefused, STILL, StepEvent};
use crate::coordination::{LinkError, MemberLink, Turn};
use crate::generator::{
    Axes, AxesState, EffectorCommand, Execution, Generator, GeneratorError, Pace, Run, SlowedPart, Step,
};
use crate::sensor::{Prompt, Sensors};

/// Most bursts of short macrosteps in one poll.
const MOST_BURSTS: u16 = 10;

impl Ecp {
    /// Replaces the generator of the present motion. The new generator plans from the end of the macrosteps that were
    /// already sent ([`macrosteps_ahead`](super::EcpConfig::macrosteps_ahead)); the replaced instruction ends with success. If the new generator
    /// cannot begin in motion, the effector is braked first.
    ///
    /// A second call before the next poll replaces the first. Without a motion by a generator, the call is refused.
    ///
    /// In a motion of a team under a coordinator, the call is refused too. The coordinator numbers the macrosteps of
    /// all members, and a new plan would restart the numbers of one member. As in MRROC++, only the coordinator ends
    /// the motion of its members. The task then gives the members their next motion.
    pub fn replace(&mut self, generator: impl Generator) -> Result<(), ReplaceRefused> {
        if !matches!(self.activity, Activity::Running(_)) {
            return Err(ReplaceRefused::NotRunning);
        }
        if self.is_in_team() {
            return Err(ReplaceRefused::InTeam);
        }
        // The messages received from the task so far were for the replaced motion.
        self.receive_from_task();
        self.replacement = Some(Box::new(Run::new(generator)));
        Ok(())
    }

    /// Takes the part of the present or last motion that joints slow.
    pub fn take_slowed(&mut self) -> Option<SlowedPart> {
        self.slowed.take()
    }

    /// Whether the cycle law ended the present or last motion at a touch ([`StopCause::Touched`]). Such a motion ends with
    /// success.
    pub fn has_touched(&self) -> bool {
        self.touched
    }

    /// Whether the servo has stopped the effector because its cycle law met a touch.
    pub(super) fn is_stopped_by_touch(&self) -> bool {
        let fault = self.report.and_then(|report| report.fault);
        fault.is_some_and(|fault| fault.cause == StopCause::Touched)
    }

    pub(super) fn begin_run(&mut self, run: Box<dyn Execution + Send>, now: Instant) -> Option<Result<(), EcpError>> {
        // The last report may be old: an effector at rest sends none.
        let latest = self.latest();
        self.effector.measured = latest;
        self.continues_law = !self.in_motion && self.keeps_displacement(run.law(), &latest);
        if !self.in_motion {
            let kept = |axis: usize| if self.continues_law { latest.displacement[axis] } else { 0.0 };
            let path = array::from_fn(|axis| latest.commanded[axis] - kept(axis));
            self.effector.commanded = AxesState::at_rest(path);
            // Numbers of macrosteps that the servo dropped at a stop are not used again.
            self.sent = self.sent.max(latest.macrostep);
            self.origin = self.sent;
        }
        self.base = self.sent;
        self.chart = Some(ChartPhase::FirstStep);
        (self.replacement, self.ended_by_team, self.under_law, self.touched) = (None, false, false, false);
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

    /// Whether a motion under `law` continues the path of the motion before: the effector stands beside that path, and its
    /// law has kept the displacement.
    fn keeps_displacement(&self, law: Option<LawParameters>, latest: &Snapshot) -> bool {
        let same = law.is_some() && law == self.law;
        same && latest.phase == Phase::Standing && latest.displacement != [0.0; MAX_AXES]
    }

    /// Reads the images of the first step once they are there, and begins to plan.
    pub(super) fn await_images(&mut self, since: Instant, now: Instant) -> Option<Result<(), EcpError>> {
        if let Some(phase) = self.left_phase() {
            return self.fail(EcpError::BrokenOff { phase });
        }
        if self.is_ended_by_task() {
            return self.end_before_motion();
        }
        let Activity::Awaiting { run, .. } = &mut self.activity else {
            return None;
        };
        let latest = self.link.latest.read();
        let cycle = latest.at;
        match turn(&**run, self.links.present(), &self.sensors, None, &latest) {
            Ok(Turn::Ready) => {}
            Ok(Turn::Waiting) => {
                let waited = now.since(since);
                return if self.is_late(waited) { self.fail(EcpError::Unread { step: 0, waited }) } else { None };
            }
            Ok(Turn::EndMotion) => return self.end_before_motion(),
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
        self.slowed = None;
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

    /// Ends a motion before its first macrostep, by order of the task or the coordinator. The effector may still
    /// execute the end of the previous motion.
    fn end_before_motion(&mut self) -> Option<Result<(), EcpError>> {
        if !self.in_motion {
            return Some(Ok(()));
        }
        self.end_as_ordered();
        None
    }

    /// Whether the first step of a generator is too late after a wait of `waited`. In motion, the stop must reach the
    /// servo before the end of the last macrostep. A pause delays this end.
    fn is_late(&self, waited: Duration) -> bool {
        if !self.in_motion {
            return waited > self.config.planning;
        }
        self.outstanding() == 0 && self.since_report.passed() + self.config.period > self.margin
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
        if self.is_ended_by_task() {
            return self.end_before_motion();
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
            self.slowed = run.slowed();
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
            Ok(Step::Continue(EffectorCommand { setpoint: None, .. })) => Ok(()),
            Ok(Step::Continue(_)) if self.links.team.is_some() && !self.in_motion => {
                Err(EcpError::Generator { step: 0, error: GeneratorError::CommandsAtFirst })
            }
            Ok(Step::Continue(command)) => self.command(&command),
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
        // The servo sends no report while a step of an effector at rest waits for its images.
        let owed = !matches!(self.activity, Activity::Running(_)) || self.outstanding() > 0 || !self.outbox.is_empty();
        let limit = if owed { self.config.silence + self.macrostep() } else { self.config.planning };
        if !(matches!(phase, Phase::Standing | Phase::Moving) || self.is_settling()) {
            self.break_off(now);
        } else if waited > limit {
            // Slowed motion reports later.
            let alive = now.since(self.turned.1) <= self.config.silence;
            if phase == Phase::Moving && self.latest().rate < 1.0 && alive {
                self.heard = now;
            } else {
                let step = self.sent - self.base;
                self.brake(Err(if owed { EcpError::Silent { waited } } else { EcpError::Unread { step, waited } }));
            }
        } else if self.obeys_end() {
            // `obeys_end` has begun the end of the motion.
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

    /// Whether the effector brakes at the end of its path because its cycle law still moved the effector.
    fn is_settling(&self) -> bool {
        let ended = matches!(self.activity, Activity::Arriving) && self.under_law && self.outstanding() == 0;
        ended && self.phase() == Phase::Stopping && self.report.is_some_and(|report| report.fault.is_none())
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
        match turn(&**run, self.links.present(), &self.sensors, NonZeroU64::new(self.turn + 1), &latest) {
            Ok(Turn::Ready) => {}
            Ok(Turn::Waiting) => return false,
            Ok(Turn::EndMotion) => {
                self.end_as_ordered();
                return false;
            }
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
            Ok(Step::Continue(command)) => {
                self.sensors.initiate(cycle);
                if let Err(error) = self.command(&command) {
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

    /// Ends the motion if the task has ordered the end, unless a replacement ends the motion. Returns whether this poll
    /// ends the motion.
    fn obeys_end(&mut self) -> bool {
        if !self.is_ended_by_task() {
            return false;
        }
        match self.activity {
            Activity::Running(_) if self.replacement.is_none() => self.end_as_ordered(),
            Activity::Arriving | Activity::RunningOut if self.continues() && !self.is_at_barrier() => {
                self.brake(Ok(()));
            }
            _ => return false,
        }
        true
    }

    /// Whether the last macrostep still takes time: the macrostep is not reported yet, or an override or a pause delays
    /// its end.
    fn continues(&self) -> bool {
        self.outstanding() > 0 || self.phase() == Phase::Moving && self.latest().rate < 1.0
    }

    /// Ends the motion that the coordinator or the task ends. The coordinator of a team ends all members after the same
    /// macrostep. The task ends the motion at once, and drops the macrosteps sent ahead. No other motion continues an
    /// ended motion.
    fn end_as_ordered(&mut self) {
        self.ended_by_team = self.is_in_team();
        // A stop order would drop the barrier.
        if self.ended_by_team || self.is_at_barrier() { self.end_unchained() } else { self.brake(Ok(())) }
    }

    /// Ends the motion of a generator that has ended. Returns whether the next instruction continues the motion.
    fn conclude(&mut self) -> bool {
        let next = self.task.instructions.front();
        let begins = next.is_some_and(|next| matches!(next, Instruction::Run(run) if run.begins_in_motion()));
        // A law ends with its motion, and the plan of the next motion begins where the law has moved the effector.
        if begins && self.ends_in_motion() && !self.under_law {
            self.in_motion = true;
            return true;
        }
        self.end_unchained();
        false
    }

    /// Waits until the macrosteps already sent are executed, and then brakes an effector in motion.
    fn end_unchained(&mut self) {
        self.in_motion = false;
        if self.ends_in_motion() {
            self.activity = Activity::RunningOut;
            self.run_out();
        } else {
            self.activity = Activity::Arriving;
        }
    }

    /// Whether the effector moves at the end of the last computed macrostep.
    fn ends_in_motion(&self) -> bool {
        self.effector.commanded.velocity != Axes::default()
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
    fn command(&mut self, &EffectorCommand { setpoint, law }: &EffectorCommand) -> Result<(), EcpError> {
        let step = self.sent - self.base;
        self.commanded |= setpoint.is_some();
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
        self.margin = self.config.period * u32::from(self.pace.periods.saturating_sub(self.pace.read_at));
        self.sent += 1;
        let continues_law = std::mem::take(&mut self.continues_law) && law == self.law;
        (self.under_law, self.law) = (law.is_some(), law);
        self.outbox.push_back(Order::Move(Macrostep {
            number: self.sent,
            steps: self.pace.periods,
            report_at: self.pace.read_at,
            position: motors.position,
            velocity: motors.velocity,
            acceleration: motors.acceleration,
            torque,
            law,
            continues_law,
        }));
        Ok(())
    }
}

/// Whether the images of a step are available: the order with the number of the step, and the declared readings of
/// interactive sensors. `step` is `None` for the first step. An end of the motion does not wait for readings. All times
/// are times of servo cycles.
fn turn(
    run: &dyn Execution,
    coordinator: Option<&mut (dyn MemberLink + 'static)>,
    sensors: &Sensors,
    step: Option<NonZeroU64>,
    latest: &Snapshot,
) -> Result<Turn, LinkError> {
    let number = step.map_or(0, NonZeroU64::get);
    let turn = coordinator.map_or(Ok(Turn::Ready), |link| link.poll(number, latest.at, latest.rate))?;
    let waits = turn == Turn::Ready && run.require(step.is_none(), &Prompt(sensors)).is_err();
    Ok(if waits { Turn::Waiting } else { turn })
}
