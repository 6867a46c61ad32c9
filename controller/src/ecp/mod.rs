//! The effector control process: walks a [`Task`] for one effector over its servo link.
//!
//! [`Ecp::poll`] is called again and again, by a thread at macrostep rate or by a lockstep bench in each
//! cycle. It takes in reports, keeps the effector's image, turns the flow chart of the generator under way
//! (see [`generator`](crate::generator)), converts what it asks for to motors and offers orders to the
//! servo. It never waits, allocates only what a generator's first step does, and bounds everything: the
//! macrosteps ahead of the servo, the one order that did not fit, the time it listens to silence.
//!
//! An instruction is over when the effector stands again, whatever ended it: the terminal condition, an
//! error of the generator, [`Ecp::stop`] or the servo. If a generator ends while the effector moves, it is
//! braked ([`Order::Stop`]). The first failure ends the task.
//!
//! Motor velocities are carried through the drive train by numeric central differences.
//!
//! Read [`Task`] first, then [`Ecp::poll`].

mod error;
mod image;
mod meetings;
mod subcontrollers;
mod task;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::time::Duration;

use can::Instant;
use servo::{EffectorLink, Macrostep, Order, Phase, Report};

use crate::generator::{
    Axes, AxesState, EffectorImage, Execution, GeneratorError, ImageSource, Setpoint, Step,
};
use crate::robot::Arm;

pub use error::EcpError;
use image::Effector;
pub use meetings::Meetings;
pub use subcontrollers::Subcontrollers;
use task::Instruction;
pub use task::Task;

/// How an ECP paces its effector and how long it is patient.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EcpConfig {
    /// Servo period.
    pub period: Duration,
    /// Periods per macrostep, at least 1.
    pub steps: u16,
    /// The period of a macrostep after which the servo reports, 1 ..= `steps`; what is left of the macrostep
    /// is the time in which the next one must be computed by a generator that reads images.
    pub report_at: u16,
    /// Macrosteps, at least 1, that a generator whose next steps read no images may be ahead of the one
    /// being executed. Others compute the next macrostep from the report of the one before. The servo's
    /// order queue must hold more than that, or a stop has to wait for room behind macrosteps.
    pub lead: u16,
    /// How long the servo may neither report nor take an order while something is under way.
    pub silence: Duration,
    /// How long switching on or off, resetting and braking may take.
    pub switching: Duration,
    /// How long homing may take.
    pub homing: Duration,
    /// How long it may wait for the partners of a meeting.
    pub meeting: Duration,
}

impl EcpConfig {
    /// 10 periods of 2 ms, reported 2 periods before their end, 4 macrosteps ahead.
    pub const fn usual() -> Self {
        Self {
            period: Duration::from_millis(2),
            steps: 10,
            report_at: 8,
            lead: 4,
            silence: Duration::from_millis(500),
            switching: Duration::from_secs(5),
            homing: Duration::from_secs(120),
            meeting: Duration::from_secs(600),
        }
    }

    /// How long a macrostep lasts.
    pub fn macrostep(&self) -> Duration {
        self.period * u32::from(self.steps)
    }
}

/// An instruction has ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// Its index in the task.
    pub instruction: usize,
    /// How it ended. After an error, the instructions behind it were dropped.
    pub outcome: Result<(), EcpError>,
}

/// What an ECP knows at a glance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status {
    /// What the effector does, as last reported; `Off` before any report.
    pub phase: Phase,
    /// Whether every axis is homed.
    pub homed: bool,
    /// Index of the instruction under way, if one is.
    pub instruction: Option<usize>,
    /// Instructions waiting behind it.
    pub waiting: usize,
    /// Number of the last macrostep sent.
    pub sent: u64,
    /// Number of the last macrostep reported.
    pub executed: u64,
}

/// The task that an ECP was given while it has another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("instruction {instruction} is under way")]
pub struct Busy {
    /// Its index in its task.
    pub instruction: usize,
}

/// What is under way. Every state but the first ends by a report or by its deadline.
enum Activity {
    Idle,
    /// An order other than a macrostep or a stop was sent.
    Switching {
        order: Order,
        since: Instant,
    },
    /// Its partners are waited for, or, once it is admitted, all are there.
    Meeting {
        meeting: u8,
        since: Instant,
        admitted: bool,
    },
    /// The generator is asked for macrosteps.
    Running {
        run: Box<dyn Execution + Send>,
    },
    /// The last macrostep was sent; it leads to a stand.
    Arriving,
    /// A stop is offered (`since` is `None`) or sent; `outcome` is what it will have ended with.
    Stopping {
        since: Option<Instant>,
        outcome: Result<(), EcpError>,
    },
}

/// One effector's subcontroller. See the [module](self).
pub struct Ecp {
    effector: Effector,
    link: EffectorLink,
    config: EcpConfig,
    task: Task,
    instruction: usize,
    activity: Activity,
    report: Option<Report>,
    /// The orders that wait for room in the queue.
    outbox: VecDeque<Order>,
    /// Numbers of the last macrostep made, of the last one reported, and of the last one before this motion.
    sent: u64,
    executed: u64,
    base: u64,
    /// When the servo last reported or took an order.
    heard: Instant,
}

impl Ecp {
    /// A subcontroller that has nothing to do yet.
    pub fn new(arm: Arm, link: EffectorLink, config: EcpConfig) -> Self {
        Self {
            effector: Effector::new(arm),
            link,
            config,
            task: Task::new(),
            instruction: 0,
            activity: Activity::Idle,
            report: None,
            outbox: VecDeque::with_capacity(usize::from(config.lead.max(1)) + 1),
            sent: 0,
            executed: 0,
            base: 0,
            heard: Instant::ZERO,
        }
    }

    /// Takes a task; it begins with the next poll. Refused while another is under way.
    pub fn execute(&mut self, task: Task) -> Result<(), Busy> {
        if let Some(instruction) = self.status().instruction {
            return Err(Busy { instruction });
        }
        self.task = task;
        self.instruction = 0;
        Ok(())
    }

    /// Brakes and drops the rest of the task. The instruction under way ends with [`EcpError::Stopped`].
    pub fn stop(&mut self) {
        match self.activity {
            Activity::Stopping { .. } => {}
            Activity::Idle if self.task.is_empty() => {}
            _ => self.brake(Err(EcpError::Stopped)),
        }
    }

    /// What is going on.
    pub fn status(&self) -> Status {
        let busy = !matches!(self.activity, Activity::Idle) || !self.task.is_empty();
        Status {
            phase: self.phase(),
            homed: self.homed(),
            instruction: busy.then_some(self.instruction),
            waiting: self.task.len(),
            sent: self.sent,
            executed: self.executed,
        }
    }

    /// The meeting at which it waits for its partners.
    fn meeting(&self) -> Option<u8> {
        match self.activity {
            Activity::Meeting { meeting, .. } => Some(meeting),
            _ => None,
        }
    }

    /// Lets it go on from the meeting it waits at. What follows is sent at the next poll, and waits for the gate.
    fn admit(&mut self) {
        if let Activity::Meeting { admitted, .. } = &mut self.activity {
            *admitted = true;
        }
    }

    /// Whether it has gone on from a meeting and sent all that it has to send for now.
    fn has_left(&self, meeting: u8) -> bool {
        self.meeting() != Some(meeting) && self.outbox.is_empty()
    }

    /// The effector's image, as generators see it.
    pub fn image(&self) -> Result<EffectorImage, GeneratorError> {
        self.effector.effector()
    }

    /// Motor positions that the effector was commanded to take when it last reported, rad; `None` before any report.
    pub fn commanded(&self) -> Option<Axes> {
        self.report.map(|report| report.commanded)
    }

    /// Takes in what the servo reported, does what is due at `now` and tells if an instruction ended.
    ///
    /// Call it again while it returns an event, and often enough: generators that read the effector need it
    /// within the periods that `report_at` leaves of a macrostep, others within `lead` macrosteps. The servo
    /// brakes an effector that it finds moving without a macrostep.
    pub fn poll(&mut self, now: Instant) -> Option<Event> {
        while let Ok(report) = self.link.reports.pop() {
            self.heard = now;
            self.executed = report.macrostep;
            self.effector.measure(&report);
            self.report = Some(report);
        }
        if matches!(self.activity, Activity::Idle) {
            let instruction = self.task.instructions.pop_front()?;
            self.heard = now;
            if let Some(outcome) = self.begin(instruction, now) {
                return Some(self.end(outcome));
            }
        }
        let outcome = self.advance(now);
        self.offer(now);
        Some(self.end(outcome?))
    }

    fn phase(&self) -> Phase {
        self.report.map_or(Phase::Off, |report| report.phase)
    }

    fn homed(&self) -> bool {
        self.report.is_some_and(|report| report.homed)
    }

    fn fault(&self) -> EcpError {
        self.cause_of(EcpError::Faulted)
    }

    /// The fault that began a stop, where the stop ends in `consequence`: the cause is reported, not what followed from it.
    fn cause_of(&self, consequence: EcpError) -> EcpError {
        self.report
            .and_then(|report| report.fault)
            .map_or(consequence, EcpError::Servo)
    }

    fn end(&mut self, outcome: Result<(), EcpError>) -> Event {
        self.activity = Activity::Idle;
        let event = Event {
            instruction: self.instruction,
            outcome,
        };
        self.instruction += 1;
        if outcome.is_err() {
            self.task.instructions.clear();
        }
        event
    }

    /// Sends the orders waiting, as many as the queue takes. The servo sees them all at once: were it to
    /// see the first macrostep of a motion alone, a thread that loses the processor there would starve it.
    fn offer(&mut self, now: Instant) {
        let count = self.outbox.len().min(self.link.orders.slots());
        if count == 0 {
            return;
        }
        let stopping = self.outbox.front() == Some(&Order::Stop);
        let room = self
            .link
            .orders
            .write_chunk_uninit(count)
            .expect("the queue has this many slots");
        room.fill_from_iter(self.outbox.drain(..count));
        self.heard = now;
        if let (true, Activity::Stopping { since, .. }) = (stopping, &mut self.activity) {
            *since = Some(now);
        }
    }

    /// Drops what waits to be sent.
    fn clear_outbox(&mut self) {
        let moves = self
            .outbox
            .iter()
            .filter(|order| matches!(order, Order::Move(_)));
        self.sent -= moves.count() as u64;
        self.outbox.clear();
    }

    fn begin(&mut self, instruction: Instruction, now: Instant) -> Option<Result<(), EcpError>> {
        let phase = self.phase();
        let order = match instruction {
            Instruction::ResetFault if phase != Phase::Faulted => return Some(Ok(())),
            Instruction::ResetFault => Order::ResetFault,
            _ if phase == Phase::Faulted => return Some(Err(self.fault())),
            Instruction::Disable => Order::Disable,
            Instruction::Enable => Order::Enable,
            _ if phase != Phase::Standing => return Some(Err(EcpError::NotStanding { phase })),
            Instruction::Home => Order::Home,
            Instruction::Meet(meeting) => {
                self.activity = Activity::Meeting {
                    meeting,
                    since: now,
                    admitted: false,
                };
                return None;
            }
            Instruction::Run(_) if !self.homed() => return Some(Err(EcpError::NotHomed)),
            Instruction::Run(run) => return self.begin_run(run),
        };
        if self.is_done(order) {
            return Some(Ok(()));
        }
        self.outbox.push_back(order);
        self.activity = Activity::Switching { order, since: now };
        None
    }

    /// Whether the effector already is where an order leads.
    fn is_done(&self, order: Order) -> bool {
        match order {
            Order::Enable | Order::Stop => self.phase() == Phase::Standing,
            Order::Home => self.phase() == Phase::Standing && self.homed(),
            Order::Disable | Order::ResetFault => self.phase() == Phase::Off,
            Order::Move(macrostep) => self.executed >= macrostep.number,
            Order::Gate(_) => true,
        }
    }

    fn begin_run(&mut self, mut run: Box<dyn Execution + Send>) -> Option<Result<(), EcpError>> {
        let report = self.report?;
        self.effector.commanded = AxesState::at_rest(report.commanded);
        // Macrosteps that a stop has dropped keep their numbers.
        self.sent = self.sent.max(report.macrostep);
        self.base = self.sent;
        let first = run.first_step(&self.effector, self.config.macrostep());
        self.activity = Activity::Running { run };
        match first {
            Ok(Step::Ended) => Some(Ok(())),
            Ok(Step::Continue(None)) => None,
            Ok(Step::Continue(setpoint)) => self.command(setpoint).err().map(Err),
            Err(error) => Some(Err(EcpError::Generator { step: 0, error })),
        }
    }

    fn advance(&mut self, now: Instant) -> Option<Result<(), EcpError>> {
        let phase = self.phase();
        let clearing = matches!(
            self.activity,
            Activity::Switching {
                order: Order::ResetFault,
                ..
            }
        );
        if phase == Phase::Faulted && !clearing {
            self.clear_outbox();
            return Some(Err(self.fault()));
        }
        match self.activity {
            Activity::Idle => None,
            Activity::Switching { order, since } => {
                let waited = now.since(since);
                let patience = if order == Order::Home {
                    self.config.homing
                } else {
                    self.config.switching
                };
                if self.outbox.is_empty() && self.is_done(order) {
                    return Some(Ok(()));
                }
                let homing = matches!(phase, Phase::Standing | Phase::Homing);
                if order == Order::Home && !homing {
                    // Whoever stopped the servo did not ask for the rest of the search.
                    self.break_off(now);
                } else if waited > patience {
                    self.brake(Err(EcpError::TimedOut { phase, waited }));
                }
                None
            }
            Activity::Meeting { .. } if phase != Phase::Standing => {
                Some(Err(EcpError::BrokenOff { phase }))
            }
            Activity::Meeting {
                meeting,
                admitted: true,
                ..
            } => {
                self.outbox.push_back(Order::Gate(meeting));
                Some(Ok(()))
            }
            Activity::Meeting { since, .. } => {
                let waited = now.since(since);
                (waited > self.config.meeting).then_some(Err(EcpError::Unmet { waited }))
            }
            Activity::Running { .. } | Activity::Arriving => self.advance_motion(now),
            Activity::Stopping { since: None, .. } => {
                let waited = now.since(self.heard);
                (waited > self.config.switching)
                    .then(|| Err(self.cause_of(EcpError::Silent { waited })))
            }
            Activity::Stopping {
                since: Some(since),
                outcome,
            } => {
                let waited = now.since(since);
                // A stand that was reported before the stop does not count: the servo may just be about to
                // begin with what it was sent. It takes orders each period and tells of each change.
                let settled = waited > self.config.macrostep() * 2;
                if settled && matches!(phase, Phase::Standing | Phase::Off) {
                    Some(outcome)
                } else {
                    (waited > self.config.switching)
                        .then(|| Err(self.cause_of(EcpError::TimedOut { phase, waited })))
                }
            }
        }
    }

    fn advance_motion(&mut self, now: Instant) -> Option<Result<(), EcpError>> {
        let phase = self.phase();
        let waited = now.since(self.heard);
        if !matches!(phase, Phase::Standing | Phase::Moving) {
            self.break_off(now);
        } else if waited > self.config.silence + self.config.macrostep() {
            self.brake(Err(EcpError::Silent { waited }));
        } else if matches!(self.activity, Activity::Arriving) {
            let arrived = phase == Phase::Standing && self.executed.max(self.base) >= self.sent;
            return arrived.then_some(Ok(()));
        } else {
            for _ in 0..self.config.lead.max(1) {
                self.step();
            }
        }
        None
    }

    /// Ends what the servo has ended, once the effector rests.
    fn break_off(&mut self, now: Instant) {
        let phase = self.phase();
        let fault = self.report.and_then(|report| report.fault);
        let outcome = Err(fault.map_or(EcpError::BrokenOff { phase }, EcpError::Servo));
        self.clear_outbox();
        self.activity = Activity::Stopping {
            since: Some(now),
            outcome,
        };
    }

    /// Asks the generator for the next macrostep if one is due.
    fn step(&mut self) {
        let Activity::Running { run } = &mut self.activity else {
            return;
        };
        let lead = if run.runs_ahead() {
            u64::from(self.config.lead.max(1))
        } else {
            1
        };
        if self.sent - self.executed.max(self.base) >= lead {
            return;
        }
        match run.next_step(&self.effector) {
            Ok(Step::Continue(setpoint)) => {
                if let Err(error) = self.command(setpoint) {
                    self.brake(Err(error));
                }
            }
            Ok(Step::Ended) if self.effector.commanded.velocity.iter().any(|v| *v != 0.0) => {
                self.brake(Ok(()));
            }
            Ok(Step::Ended) => self.activity = Activity::Arriving,
            Err(error) => self.brake(Err(EcpError::Generator {
                step: self.sent - self.base,
                error,
            })),
        }
    }

    /// Makes a macrostep of what the generator asked for and puts it into the outbox.
    fn command(&mut self, setpoint: Option<Setpoint>) -> Result<(), EcpError> {
        let step = self.sent - self.base;
        if let Some(axis) = setpoint.and_then(|setpoint| setpoint.not_finite()) {
            return Err(EcpError::NotFinite { step, axis });
        }
        let out_of_reach = |error| EcpError::OutOfReach { step, error };
        let motors = self.effector.motors(setpoint).map_err(out_of_reach)?;
        let torque = self.effector.arm.torques(&motors.position);
        let torque = torque.map_err(out_of_reach)?;
        self.effector.commanded = motors;
        self.sent += 1;
        self.outbox.push_back(Order::Move(Macrostep {
            number: self.sent,
            steps: self.config.steps,
            report_at: self.config.report_at,
            position: motors.position,
            velocity: motors.velocity,
            torque,
        }));
        Ok(())
    }

    /// Drops the generator and what it wanted next, and stops the effector.
    fn brake(&mut self, outcome: Result<(), EcpError>) {
        self.clear_outbox();
        self.outbox.push_back(Order::Stop);
        self.activity = Activity::Stopping {
            since: None,
            outcome,
        };
    }
}
