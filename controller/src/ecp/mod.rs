//! The effector control process: executes a [`Task`] for one effector over its servo link.
//!
//! The controller thread calls [`Ecp::poll`] once after each servo cycle; a lockstep bench calls the function in each
//! cycle. The poll receives reports, updates the effector's image, and executes the current generator: its first step,
//! then its terminal condition and next step for each macrostep (see [`generator`](crate::generator)). It converts the
//! set-points of the generator to motor positions and velocities, and sends orders to the servo.
//!
//! The poll waits for no other thread. A [`Planner`] computes the first step of a generator. Only a first step may
//! allocate or take long. With [`AtOnce`] the poll computes it. The macrosteps ahead of the servo, the orders that wait
//! for room in the queue, and the time without a report are limited.
//!
//! A motion is ended by the terminal condition, the coordinator or the task, an error of the generator, [`Ecp::stop`] or
//! the servo. The instruction ends when the effector stands again or is faulted, or when a time limit passes. The first
//! failure ends the task.
//!
//! A generator may end while the effector moves. If the next instruction is a generator that [can begin in
//! motion](crate::generator::Generator::begins_in_motion), it plans from the end of the last macrostep and continues
//! without a stop. Otherwise the effector is braked ([`Order::Stop`]). [`Ecp::replace`] replaces a generator in motion in
//! the same way.
//!
//! Velocities and accelerations are converted between tool, joints and motors by central differences.
//!
//! Read [`Task`] first, then [`Ecp::poll`].

mod activity;
mod around;
mod config;
mod error;
mod image;
mod motion;
mod partners;
mod planning;
mod since_report;
mod steps;
mod subcontrollers;
mod task;
#[cfg(test)]
pub(crate) mod tests;

use std::{collections::VecDeque, num::NonZeroU64, time::Duration};

use can::Instant;
use servo::{EffectorLink, LawParameters, Order, Phase, ServoReport, Snapshot};

use crate::generator::{Execution, Pace, SlowedPart};
use crate::robot::Arm;
use crate::sensor::Sensors;

use activity::{Activity, StopOrder};
pub use config::EcpConfig;
pub use error::{Busy, ChartPhase, Class, EcpError, ReplaceRefused};
use image::Effector;
use partners::{Barrier, Links, is_barrier};
pub use planning::{AtOnce, Plan, Planner};
pub(crate) use planning::{Planning, Preparation};
use since_report::SinceReport;
use steps::Journal;
pub use steps::{StepEvent, StepLog, StepRecord, StepRecords, step_log};
pub use subcontrollers::{Meetings, Subcontrollers};
use task::Instruction;
pub use task::Task;

/// The end of an instruction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EcpEvent {
    /// Index of the instruction in the task.
    pub instruction: usize,
    /// Result of the instruction. After an error, the remaining instructions were dropped.
    pub outcome: Result<(), EcpError>,
    /// Whether [`Ecp::replace`] replaced the motion. The replacement is the next instruction.
    pub replaced: bool,
}

/// Summary of an ECP's state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status {
    /// Phase of the effector in the last report; `Off` before any report.
    pub phase: Phase,
    /// Index of the current instruction, if any.
    pub instruction: Option<usize>,
}

/// Commanded motor velocity, rad/s, below which zero is commanded. The last velocity of a generator may contain a
/// rounding error, such as that of `sin(2.0 * PI)`.
const STILL: f64 = 1e-9;

/// Greatest number of macrosteps that one poll computes. The other processes of the thread must not wait for long.
const BURST: u16 = 10;

/// Effector control process of one effector. See the [module](self).
pub struct Ecp {
    effector: Effector,
    link: EffectorLink,
    config: EcpConfig,
    task: Task,
    instruction: usize,
    activity: Activity,
    planning: Planning,
    report: Option<ServoReport>,
    /// The servo ended a reset without success, in this instruction.
    reset_failed: bool,
    /// Orders that wait for room in the servo's queue, or for the first macrosteps behind a barrier.
    outbox: VecDeque<Order>,
    /// Number of the last macrostep made.
    sent: u64,
    /// Number of the last macrostep executed up to the period in which its images are read.
    executed: u64,
    /// The macrostep of this motion.
    pace: Pace,
    /// Number of the last macrostep before this instruction.
    base: u64,
    /// Phase of the flow chart that computes macrosteps; `None` outside a motion.
    chart: Option<ChartPhase>,
    /// Whether the next motion has to wait.
    held: bool,
    /// Whether the present motion was replaced.
    replaced: bool,
    /// Number of the last macrostep before the effector left standstill.
    origin: u64,
    /// The next instruction continues from the end of the last macrostep, which ends in motion.
    in_motion: bool,
    /// Time from the report of the last computed macrostep to the end of this macrostep, at the programmed speed.
    margin: Duration,
    /// The generator that replaces the present one with the next macrostep.
    replacement: Option<Box<dyn Execution + Send>>,
    /// Time of the last report or accepted order.
    heard: Instant,
    /// Begin of the wait of the effector for its partners, if it waits.
    waiting: Option<Instant>,
    /// Number of the last servo cycle seen, and the time at which a poll first saw it. Times of cycles are not compared with
    /// times of polls: an emulated cell has a time of its own.
    turned: (u64, Instant),
    sensors: Sensors,
    links: Links,
    /// Number of the present step of the generator, 0 for the first step.
    turn: u64,
    journal: Journal,
    /// Whether the coordinator of the team has ended the present motion.
    ended_by_team: bool,
    /// Whether the present or last instruction is a motion, and whether its generator has commanded the effector.
    moves: bool,
    commanded: bool,
    /// Whether the task awaits a list that begins after the present list. Messages of the task are then for the awaited
    /// list.
    awaited: bool,
    since_report: SinceReport,
    /// Whether the last macrostep of this motion has a cycle law.
    under_law: bool,
    /// The cycle law of the last macrostep made, also after its motion.
    law: Option<LawParameters>,
    /// The first macrostep of this motion continues the path from which the law has displaced the effector.
    continues_law: bool,
    /// Whether the cycle law ended the present or last motion at a touch.
    touched: bool,
    /// Servo cycle after which the last barrier was sent.
    barrier_sent: Option<u64>,
    /// Number of the macrostep that the present fault of the servo ended; `None` if the effector stood.
    fault_macrostep: Option<u64>,
    /// The part of the present or last motion that joints slow, until it is taken.
    slowed: Option<SlowedPart>,
}

impl Ecp {
    /// A process without a task.
    pub fn new(arm: Arm, link: EffectorLink, config: EcpConfig) -> Self {
        Self {
            effector: Effector::new(arm),
            link,
            config,
            task: Task::new(),
            instruction: 0,
            activity: Activity::Idle,
            planning: Planning::with(Box::new(AtOnce::default())),
            report: None,
            reset_failed: false,
            outbox: VecDeque::with_capacity(config.most_orders() + 1),
            sent: 0,
            executed: 0,
            pace: config.pace,
            base: 0,
            chart: None,
            held: false,
            replaced: false,
            origin: 0,
            in_motion: false,
            margin: Duration::ZERO,
            replacement: None,
            heard: Instant::ZERO,
            waiting: None,
            turned: (0, Instant::ZERO),
            sensors: Sensors::default(),
            links: Links::default(),
            turn: 0,
            journal: Journal::default(),
            ended_by_team: false,
            moves: false,
            commanded: false,
            awaited: false,
            since_report: SinceReport::default(),
            under_law: false,
            law: None,
            continues_law: false,
            touched: false,
            barrier_sent: None,
            fault_macrostep: None,
            slowed: None,
        }
    }

    /// The virtual sensors of this process.
    pub fn sensors(&mut self) -> &mut Sensors {
        &mut self.sensors
    }

    /// Duration of the cell's macrostep.
    pub(crate) fn cell_macrostep(&self) -> Duration {
        self.config.period * u32::from(self.config.pace.periods)
    }

    /// Keeps a journal of all further steps.
    pub fn keep_steps(&mut self, log: StepLog) {
        self.journal.log = Some(log);
    }

    /// Replaces the planner, before the first task.
    pub fn plan_with(&mut self, planner: Box<dyn Planner>) {
        self.planning = Planning::with(planner);
    }

    /// Takes a task, which begins with the next poll. Fails while another task is in progress.
    pub fn execute(&mut self, task: Task) -> Result<(), Busy> {
        if let Some(instruction) = self.status().instruction {
            return Err(Busy { instruction });
        }
        self.task = task;
        self.instruction = 0;
        self.awaited = false;
        Ok(())
    }

    /// Brakes the effector and drops the rest of the task. The current instruction ends with [`EcpError::Stopped`],
    /// unless the process already brakes because of an error.
    pub fn stop(&mut self) {
        match &mut self.activity {
            // The generator ended in motion.
            Activity::Stopping { outcome, .. } if outcome.is_ok() => {
                *outcome = Err(EcpError::Stopped);
            }
            Activity::Stopping { .. } => {}
            Activity::Idle if self.task.is_empty() => {}
            _ => self.brake(Err(EcpError::Stopped)),
        }
    }

    /// The present state.
    pub fn status(&self) -> Status {
        let busy = !matches!(self.activity, Activity::Idle) || !self.task.is_empty();
        Status { phase: self.phase(), instruction: busy.then_some(self.instruction) }
    }

    /// Holds the effector before its next motion or meeting, or releases it. A stop is executed all the same.
    pub fn hold(&mut self, held: bool) {
        self.held = held;
    }

    /// Whether a homed effector stands and waits with its next motion or meeting for the end of a [hold](Self::hold).
    pub fn is_held(&self) -> bool {
        let next = self.task.instructions.front();
        let moves =
            next.is_some_and(|next| matches!(next, Instruction::Run(_) | Instruction::Meet(_) | Instruction::Tie(_)));
        let ready = matches!(self.activity, Activity::Idle) && self.phase() == Phase::Standing && self.homed();
        self.held && moves && ready && !self.in_motion
    }

    /// Whether the generator of the present or last instruction has returned a set-point. A generator that only waits
    /// returns none.
    pub(crate) fn has_commanded(&self) -> bool {
        self.commanded
    }

    /// Phase of the flow chart in the last motion, and number of its macrosteps before the present one; `None` after
    /// another instruction. The number is `None` if a fault ended a macrostep of the motion before.
    pub(crate) fn chart(&self) -> Option<(ChartPhase, Option<u64>)> {
        let step = match self.fault_macrostep {
            Some(macrostep) => macrostep.checked_sub(self.base + 1),
            None => Some(self.executed.saturating_sub(self.base)),
        };
        self.chart.map(|phase| (phase, step))
    }

    /// Number of the macrostep that the present fault of the servo ended, counted from the start of the process; `None`
    /// without a fault or if the effector stood.
    pub(crate) fn fault_macrostep(&self) -> Option<NonZeroU64> {
        self.fault_macrostep.and_then(NonZeroU64::new)
    }

    /// State of the effector in the last servo cycle.
    pub fn latest(&self) -> Snapshot {
        self.link.latest.read()
    }

    /// Receives the servo's reports, performs the actions due at `now`, and returns the end of an instruction, if
    /// any.
    ///
    /// Call this function again until it returns `None`. A generator that reads images needs a call between the report
    /// and the end of each macrostep. Other generators need a call every `macrosteps_ahead` macrosteps. The servo brakes
    /// a moving effector without a next macrostep and reports a fault.
    pub fn poll(&mut self, now: Instant) -> Option<EcpEvent> {
        while let Ok(report) = self.link.reports.pop() {
            self.heard = now;
            // A change of phase may be reported before the images of its macrostep are due. The macrostep before is then
            // complete, also if an override let its end and its report fall into one cycle.
            let Snapshot { macrostep, .. } = report.snapshot;
            let executed = if report.reached { macrostep } else { macrostep.saturating_sub(1) };
            if report.reached || executed > self.executed {
                self.executed = executed;
                self.effector.measured = report.snapshot;
            }
            // A fault belongs to the macrostep in which it occurred, also if later ones were computed before.
            let before = self.report.unwrap_or_default();
            if report.fault != before.fault {
                let moved = before.snapshot.phase == Phase::Moving;
                self.fault_macrostep = report.fault.filter(|_| moved).map(|_| macrostep);
            }
            let failed = before.resetting && !report.resetting && report.snapshot.phase == Phase::Faulted;
            self.reset_failed |= failed;
            self.report = Some(report);
            self.since_report.restart(report.snapshot.at);
        }
        let latest = self.latest();
        if latest.cycle != self.turned.0 {
            self.turned = (latest.cycle, now);
        }
        self.since_report.count(latest.at, latest.rate);
        self.sensors.poll(latest.at);
        if matches!(self.activity, Activity::Idle) {
            if self.is_held() {
                return None;
            }
            let disables = matches!(self.task.instructions.front(), Some(Instruction::Disable));
            // The order to disable would overtake a barrier, and the partners would wait in vain.
            if disables && self.is_at_barrier() && self.wait_for_partners(now).is_ok() {
                self.offer(now);
                return None;
            }
            let Some(instruction) = self.task.instructions.pop_front() else {
                self.offer(now);
                return None;
            };
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
        self.report.map_or(Phase::Off, |report| report.snapshot.phase)
    }

    fn homed(&self) -> bool {
        self.report.is_some_and(|report| report.snapshot.homed)
    }

    /// The fault of the last report, or `consequence` if there is none.
    fn cause_of(&self, consequence: EcpError) -> EcpError {
        self.report.and_then(|report| report.fault).map_or(consequence, EcpError::Servo)
    }

    fn end(&mut self, outcome: Result<(), EcpError>) -> EcpEvent {
        self.activity = Activity::Idle;
        let replaced = std::mem::take(&mut self.replaced) && outcome.is_ok();
        let event = EcpEvent { instruction: self.instruction, outcome, replaced };
        self.instruction += 1;
        // The messages received from the task so far were for this motion.
        if self.moves && !replaced && !self.awaited {
            self.receive_from_task();
        }
        if outcome.is_err() {
            self.task.instructions.clear();
            (self.in_motion, self.replacement) = (false, None);
        }
        event
    }

    /// Sends the waiting orders for which the queue has room, all at once. Orders sent one by one would be unsafe: if
    /// the thread lost the processor after the first macrostep, the servo would run out of macrosteps. A barrier is
    /// sent together with the first macrosteps behind it, so that all partners begin in the same cycle.
    fn offer(&mut self, now: Instant) {
        let undecided = matches!(
            self.activity,
            Activity::Awaiting { .. } | Activity::Planning { .. } | Activity::Meeting { admitted: Some(_), .. }
        );
        if undecided && self.outbox.back().is_some_and(is_barrier) {
            return;
        }
        let count = self.outbox.len().min(self.link.orders.slots());
        if count == 0 {
            return;
        }
        let stopping = self.outbox.front() == Some(&Order::Stop);
        if self.outbox.iter().take(count).any(is_barrier) {
            self.barrier_sent = Some(self.latest().cycle);
        }
        let room = self.link.orders.write_chunk_uninit(count).expect("the queue has this many slots");
        room.fill_from_iter(self.outbox.drain(..count));
        self.heard = now;
        if let (true, Activity::Stopping { order, .. }) = (stopping, &mut self.activity) {
            *order = StopOrder::Sent(now);
        }
    }

    /// Drops the waiting orders. The numbers of their macrosteps are used again.
    fn clear_outbox(&mut self) {
        let moves = self.outbox.iter().filter(|order| matches!(order, Order::Move(_)));
        self.sent -= moves.count() as u64;
        self.outbox.clear();
    }

    fn begin(&mut self, instruction: Instruction, now: Instant) -> Option<Result<(), EcpError>> {
        let phase = self.phase();
        self.chart = None;
        (self.moves, self.commanded) = (matches!(instruction, Instruction::Run(_)), false);
        self.reset_failed = false;
        let partner_stop = self.partner_stop();
        if let Some(error) = partner_stop
            && !matches!(instruction, Instruction::ResetFault | Instruction::Disable)
        {
            self.brake(Err(error));
            return None;
        }
        let order = match instruction {
            Instruction::ResetFault if partner_stop.is_some() => Order::Stop,
            Instruction::ResetFault if phase != Phase::Faulted => return Some(Ok(())),
            Instruction::ResetFault => Order::ResetFault,
            _ if phase == Phase::Faulted => return Some(Err(self.cause_of(EcpError::Faulted))),
            Instruction::Disable => Order::Disable,
            Instruction::Enable => Order::Enable,
            Instruction::Run(run) if self.in_motion => return self.begin_run(run, now),
            _ if phase != Phase::Standing => return Some(Err(EcpError::NotStanding { phase })),
            Instruction::Home => Order::Home,
            Instruction::Meet(meeting) => return self.come_to(Barrier::Meeting(meeting), now),
            Instruction::Tie(members) => return self.come_to(Barrier::Team(members), now),
            Instruction::Untie => Order::Untie,
            Instruction::Run(_) if !self.homed() => return Some(Err(EcpError::NotHomed)),
            Instruction::Run(run) => return self.begin_run(run, now),
        };
        if order != Order::Untie && self.is_done(order) {
            return Some(Ok(()));
        }
        self.outbox.push_back(order);
        self.activity = Activity::Switching { order, since: now };
        None
    }

    /// Whether the effector is already in the state to which an order leads.
    fn is_done(&self, order: Order) -> bool {
        match order {
            Order::Enable => self.phase() == Phase::Standing,
            Order::Stop => self.phase() == Phase::Standing && self.partner_stop().is_none(),
            Order::Home => self.phase() == Phase::Standing && self.homed(),
            Order::Disable | Order::ResetFault => self.phase() == Phase::Off,
            Order::Move(macrostep) => self.executed >= macrostep.number,
            Order::Meet { .. } | Order::Tie { .. } | Order::Untie => true,
        }
    }

    fn advance(&mut self, now: Instant) -> Option<Result<(), EcpError>> {
        let phase = self.phase();
        let clearing =
            matches!(self.activity, Activity::Switching { order: Order::ResetFault, .. }) && !self.reset_failed;
        if phase == Phase::Faulted && !clearing {
            self.clear_outbox();
            return Some(Err(self.cause_of(EcpError::Faulted)));
        }
        let stops = matches!(
            self.activity,
            Activity::Stopping { .. } | Activity::Switching { order: Order::Stop | Order::Disable, .. }
        );
        if !stops && self.is_stopped_by_touch() {
            self.touched = true;
            // The order also acknowledges the touch.
            self.brake(Ok(()));
            return None;
        }
        if !stops {
            let met = match self.partner_stop() {
                // The effector would stop here without the partner: the coordinator has ended the motion of the team,
                // or the last macrostep of a generator that ended in motion is executed.
                Some(_) if self.ends_with_partners() => {
                    self.brake(Ok(()));
                    return None;
                }
                Some(error) => Err(error),
                None => self.wait_for_partners(now),
            };
            if met.is_err() {
                self.brake(met);
                return None;
            }
        }
        match self.activity {
            Activity::Idle => None,
            Activity::Switching { order, since } => {
                let waited = now.since(since);
                let patience = if order == Order::Home { self.config.homing } else { self.config.switching };
                if self.outbox.is_empty() && self.is_done(order) {
                    return Some(Ok(()));
                }
                let homing = matches!(phase, Phase::Standing | Phase::Homing);
                if order == Order::Home && !homing {
                    // The servo ended homing without an order of this process. Homing is not resumed.
                    self.break_off(now);
                } else if waited > patience {
                    self.brake(Err(EcpError::TimedOut { phase, waited }));
                }
                None
            }
            Activity::Meeting { .. } if phase != Phase::Standing => Some(Err(EcpError::BrokenOff { phase })),
            Activity::Meeting { barrier, admitted: Some(members), .. } => {
                self.outbox.push_back(match barrier {
                    Barrier::Meeting(_) => Order::Meet { members },
                    Barrier::Team(_) => Order::Tie { members },
                });
                Some(Ok(()))
            }
            Activity::Meeting { ref mut since, .. } => {
                // A partner may be slowed.
                if self.link.latest.read().rate < 1.0 {
                    *since = now;
                }
                let waited = now.since(*since);
                (waited > self.config.meeting).then_some(Err(EcpError::Unmet { waited }))
            }
            Activity::Awaiting { since, .. } => self.await_images(since, now),
            Activity::Planning { since } => {
                let outcome = self.advance_planning(since, now);
                // The macrosteps follow in the same poll.
                if outcome.is_none() && matches!(self.activity, Activity::Running(_)) {
                    return self.advance_motion(now);
                }
                outcome
            }
            Activity::Running(_) | Activity::Arriving | Activity::RunningOut => self.advance_motion(now),
            Activity::Stopping { order: StopOrder::Waiting(ref mut since), .. } => {
                let waited = now.since(*since.get_or_insert(now));
                (waited > self.config.switching).then(|| Err(self.cause_of(EcpError::Silent { waited })))
            }
            Activity::Stopping { order: StopOrder::Sent(since), outcome } => {
                let waited = now.since(since);
                // A standstill from before the stop does not count: the servo may still start an earlier order. Two
                // macrosteps of the cell are enough, because the servo takes orders each period and reports each change.
                let settled = waited > self.config.period * u32::from(self.config.pace.periods) * 2;
                if settled && matches!(phase, Phase::Standing | Phase::Off) {
                    Some(outcome)
                } else {
                    (waited > self.config.switching).then(|| Err(self.cause_of(EcpError::TimedOut { phase, waited })))
                }
            }
        }
    }

    /// Waits for standstill after the servo has broken off an instruction, and then ends the instruction.
    fn break_off(&mut self, now: Instant) {
        let phase = self.phase();
        let outcome = Err(self.cause_of(EcpError::BrokenOff { phase }));
        self.clear_outbox();
        self.activity = Activity::Stopping { order: StopOrder::Sent(now), outcome };
    }

    /// Drops the generator and the waiting orders, and queues a stop of the effector.
    fn brake(&mut self, outcome: Result<(), EcpError>) {
        self.in_motion = false;
        self.clear_outbox();
        self.outbox.push_back(Order::Stop);
        self.activity = Activity::Stopping { order: StopOrder::Waiting(None), outcome };
    }
}
