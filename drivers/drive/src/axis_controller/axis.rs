//! One axis controller on a serial line during operation.

use can::Instant;
use serial::LineError;
use serial::nfv2::Status;

use super::AxisCounters;
use super::config::{AxisConfig, Control, GroupConfig};
use super::fault::AxisControllerFault;
use super::gate::{Gate, Verdict};
use super::stream::{Answer, Stream};
use super::telegram::{ANSWERS_TO_EFFECT, Aim, Dialect, Telegram};
use crate::{
    AxisCommand, AxisState, Fault, Homing, Milliamperes, Power, Refusal, Scale, Setpoint, Switches,
};

/// Answers in a row that may be the same in every bit after the set-points have changed.
const ANSWERS_TO_FREEZE: u32 = 25;

/// Cycles over which missing answers are counted together, and how many of them may be missing.
const WINDOW: u32 = 200;
const MISSING_IN_WINDOW: u32 = WINDOW / 4;

/// Cycles in a row that a drive may need to forget its reference, damaged answers among them.
const CYCLES_TO_UNREFERENCE: u32 = 25;

/// Status bits with which a drive says that it does not follow in full, and why its answers may stay the same.
const HELD: u16 = Status::UPPER_LIMIT
    | Status::LOWER_LIMIT
    | Status::POSITION_LIMITED
    | Status::SPEED_LIMITED
    | Status::CURRENT_LIMITED;

/// One drive during operation: what it said, what it is told, and what stands in the way.
///
/// Nothing here waits or allocates. The order within a cycle is [`take`](Self::take),
/// [`end_of_read`](Self::end_of_read); [`reset`](Self::reset), [`stop_with`](Self::stop_with) and
/// [`check`](Self::check) for all axes, then [`command`](Self::command), [`telegram`](Self::telegram) and [`handed_over`](Self::handed_over).
#[derive(Clone, Debug)]
pub(super) struct Axis {
    setup: Setup,
    gate: Gate,
    pub(super) stream: Stream,
    pub(super) counters: AxisCounters,

    state: AxisState,
    /// Bits that two answers in a row agreed about.
    status: Status,
    /// Those of the last answer.
    reported: Status,
    /// The counter has its reference, and we know since when.
    referenced: bool,
    /// Requests that were not answered yet, as far as answers to them can still come.
    owed: u32,
    answered: bool,
    /// An answer of this cycle came that the next one has to confirm.
    awaited: bool,
    sent_at: Instant,
    /// Since the window began: cycles in which an answer was due, and how many of those were missing.
    due: u32,
    missing: u32,
    /// Cycles in a row whose set-point the line did not take.
    not_sent: u32,

    aim: Aim,
    /// Answers since the aim changed.
    answers: u32,
    /// Telegrams sent since then.
    told: u32,
    /// The aim before was to index; the pulse may have come until the drive heard of this one.
    was_indexing: bool,
    powered: bool,
    seeking: bool,
    /// The drive is to forget its reference before it seeks.
    unreferencing: bool,
    /// Cycles in a row in which it was so.
    unreferenced: u32,
    /// Its counter jumped: it is to forget its reference, which whoever comes after us would go by.
    misled: bool,
    telegram: Telegram,
    /// It is the first that takes torque away: no older one is to reach the drive before it.
    overtakes: bool,
    setpoint: i16,
    likeness: Likeness,
    /// A fault among those since the last reset was a panic.
    panics: bool,
    /// Told to be in error with an axis that panicked, until the next reset.
    stopped: bool,
}

/// What does not change while the group lives.
#[derive(Clone, Copy, Debug)]
struct Setup {
    line: u8,
    dialect: Dialect,
    scale: Scale,
    torque_constant: f64,
    /// Greatest set-point, in the units of it.
    full_scale: i16,
    /// Greatest current that is believed, mA.
    greatest_current: u16,
    tolerated_missing: u32,
}

/// What set-points there were while answers were alike, and how many came since those changed.
#[derive(Clone, Copy, Debug, Default)]
struct Likeness {
    answer: Answer,
    answers: u32,
    low: i16,
    high: i16,
}

/// What bring-up learnt of a drive.
#[derive(Clone, Debug)]
pub(super) struct Learnt {
    pub(super) answer: Answer,
    pub(super) at: Instant,
    pub(super) stream: Stream,
}

impl Axis {
    pub(super) fn new(group: &GroupConfig, config: &AxisConfig, line: u8) -> Self {
        let limit = config.limit().map_or(0, |Milliamperes(limit)| limit);
        let dialect = Dialect {
            protocol: group.protocol,
            address: config.address,
            control: config.control,
        };
        let setup = Setup {
            line,
            dialect,
            scale: config.scale,
            torque_constant: config.torque_constant,
            full_scale: match config.control {
                Control::Current => limit,
                Control::Pwm => serial::nfv2::FULL_PWM,
            },
            // The protection acts after the current was there.
            greatest_current: limit.unsigned_abs().saturating_mul(3) / 2,
            tolerated_missing: group.tolerated_missing,
        };
        Self {
            setup,
            gate: Gate::new(group, config),
            stream: Stream::new(group.protocol, config.address),
            counters: AxisCounters::default(),
            state: AxisState::default(),
            status: Status::default(),
            reported: Status::default(),
            referenced: false,
            owed: 0,
            answered: false,
            awaited: false,
            sent_at: Instant::ZERO,
            due: 0,
            missing: 0,
            not_sent: 0,
            aim: Aim::Manual,
            answers: 0,
            told: 0,
            was_indexing: false,
            powered: false,
            seeking: false,
            unreferencing: false,
            unreferenced: 0,
            misled: false,
            telegram: Telegram::NONE,
            overtakes: false,
            setpoint: 0,
            likeness: Likeness::default(),
            panics: false,
            stopped: false,
        }
    }

    pub(super) fn dialect(&self) -> Dialect {
        self.setup.dialect
    }

    /// Starts operation after bring-up: without torque, where the last answer was.
    pub(super) fn begin(&mut self, learnt: Learnt) {
        let Answer { status, .. } = learnt.answer;
        self.state = AxisState {
            at: learnt.at,
            ..AxisState::default()
        };
        self.stream = learnt.stream;
        self.gate.begin(learnt.answer.position.0, learnt.at);
        (self.status, self.reported) = (status, status);
        self.referenced = status.any(Status::SYNCHRONIZED);
        (self.owed, self.answered, self.not_sent) = (0, false, 0);
        (self.aim, self.answers, self.powered) = (Aim::Manual, ANSWERS_TO_EFFECT, false);
        (self.seeking, self.unreferencing, self.was_indexing) = (false, false, false);
        (self.unreferenced, self.due, self.missing) = (0, 0, 0);
        (self.misled, self.stopped) = (false, false);
        (self.sent_at, self.panics, self.told) = (learnt.at, false, 1);
        (self.telegram, self.setpoint) = (self.setup.dialect.rest(Aim::Manual, 1, false), 0);
        self.likeness = Likeness::default();
        self.measure(learnt.answer);
    }

    /// Takes what one reading of the line held.
    pub(super) fn take(&mut self, bytes: &[u8], now: Instant) {
        let found = self.stream.take(bytes, self.owed, &mut self.counters);
        self.counters.surplus += u64::from(found.count.saturating_sub(self.owed));
        self.counters.late += u64::from(found.count.min(self.owed).saturating_sub(1));
        if let Some(answer) = found.answer
            && self.owed > 0
        {
            // What is still owed never comes, or comes next and is then one too many.
            self.owed = 0;
            self.judge(answer, now);
        }
    }

    fn judge(&mut self, answer: Answer, now: Instant) {
        if answer.current.0.unsigned_abs() > self.setup.greatest_current {
            self.counters.implausible += 1;
            return;
        }
        let indexing =
            self.aim == Aim::Index || (self.was_indexing && self.answers < ANSWERS_TO_EFFECT);
        match self.gate.judge(answer, self.sent_at, indexing) {
            Verdict::Passed => {}
            Verdict::Refused => {
                self.counters.implausible += 1;
                return;
            }
            Verdict::Awaited => {
                self.awaited = true;
                return;
            }
            Verdict::Indexed(before) => {
                self.counters.indexed += 1;
                self.reported = before;
            }
            Verdict::Jumped(from) => {
                let restarted = self.referenced && !answer.status.any(Status::SYNCHRONIZED);
                (self.referenced, self.misled) = (false, true);
                self.latch(if restarted {
                    AxisControllerFault::Restarted
                } else {
                    let to = answer.position.0;
                    AxisControllerFault::Jumped { from, to }
                });
            }
        }
        self.accept(answer, now, indexing);
    }

    fn accept(&mut self, answer: Answer, now: Instant, indexing: bool) {
        self.counters.accepted += 1;
        self.answered = true;
        self.answers = self.answers.saturating_add(1);
        self.state.at = now;
        let before = std::mem::replace(&mut self.reported, answer.status);
        let differ = answer.status.0 ^ before.0;
        self.status = Status(self.status.0 & differ | answer.status.0 & !differ);
        self.measure(answer);
        self.settle();
        let synchronized = self.status.any(Status::SYNCHRONIZED);
        if indexing && synchronized {
            self.referenced = true;
        } else if self.referenced && !synchronized {
            self.referenced = false;
            self.latch(AxisControllerFault::Restarted);
        }
        self.judge_likeness(answer);
    }

    fn measure(&mut self, answer: Answer) {
        let scale = &self.setup.scale;
        self.state.increments = answer.position;
        self.state.position = scale.position(answer.position);
        self.state.velocity = self.gate.velocity() / scale.increments_per_radian();
        self.state.torque = scale.torque_of(answer.current, self.setup.torque_constant);
    }

    fn settle(&mut self) {
        // A faulted drive is not told its mode any more.
        let told = self.state.fault.is_none();
        if told && self.answers >= self.setup.dialect.answers_to_switch_on() {
            match self.aim {
                Aim::Drive | Aim::Index => self.powered = true,
                Aim::Manual | Aim::Error => {}
            }
        }
    }

    fn judge_status(&mut self) {
        for (bit, fault) in [
            (Status::POWER_STAGE_FAULT, AxisControllerFault::PowerStage),
            (Status::OVERCURRENT, AxisControllerFault::Overcurrent),
            (Status::ERROR, AxisControllerFault::Error),
        ] {
            // Whom we told to be in error says so.
            if self.status.any(bit) && self.aim != Aim::Error {
                self.latch(fault);
            }
        }
    }

    fn judge_likeness(&mut self, answer: Answer) {
        let setpoint = self.setpoint;
        let alike = &mut self.likeness;
        if answer != alike.answer || !self.powered || self.status.any(HELD) {
            *alike = Likeness {
                answer,
                answers: 0,
                low: setpoint,
                high: setpoint,
            };
            return;
        }
        alike.low = alike.low.min(setpoint);
        alike.high = alike.high.max(setpoint);
        let range = i32::from(alike.high) - i32::from(alike.low);
        // An axis at rest may well say the same for hours; what counts is from the change on.
        if range > i32::from(self.setup.full_scale) / 20 {
            alike.answers += 1;
        }
        if alike.answers >= ANSWERS_TO_FREEZE {
            let cycles = alike.answers;
            self.latch(AxisControllerFault::Frozen { cycles });
        }
    }

    /// The line failed.
    pub(super) fn line_failed(&mut self, error: LineError) {
        self.latch(AxisControllerFault::Line(error));
    }

    /// Ends the reading of a cycle: what was to come and did not. `due` says whether the cycle before asked for
    /// an answer. Returns the state and whether the answer is missing, which one that awaits confirmation is not.
    pub(super) fn end_of_read(&mut self, due: bool) -> (AxisState, bool) {
        let awaited = std::mem::take(&mut self.awaited);
        let missing = due && !self.answered && !awaited;
        if self.answered {
            self.state.age = 0;
        } else if due {
            self.state.age = self.state.age.saturating_add(1);
        }
        self.answered = false;
        self.judge_status();
        let (tolerated, age) = (self.setup.tolerated_missing, self.state.age);
        // Before silence, which it may be the cause of.
        if self.not_sent > tolerated {
            let cycles = self.not_sent;
            self.latch(AxisControllerFault::NotSent { cycles });
        }
        if age > tolerated {
            self.latch(AxisControllerFault::Silent { cycles: age });
        }
        // Each gap is short, and the loop runs on old samples all the same.
        if tolerated < MISSING_IN_WINDOW {
            self.due += u32::from(due);
            self.missing += u32::from(missing);
            let (missing, cycles) = (self.missing, self.due);
            if missing > MISSING_IN_WINDOW {
                self.latch(AxisControllerFault::Late { missing, cycles });
            }
            if missing > MISSING_IN_WINDOW || cycles >= WINDOW {
                (self.due, self.missing) = (0, 0);
            }
        }
        self.state.power = self.power();
        self.state.following = self.state.power == Power::On && self.state.fault.is_none();
        self.state.homing = match (self.referenced, self.seeking) {
            (true, _) => Homing::Attained,
            (false, true) => Homing::InProgress,
            (false, false) => Homing::NotHomed,
        };
        self.state.switches = Switches {
            home: self.status.any(Status::HOME_SWITCH),
            lower_limit: self.status.any(Status::LOWER_LIMIT),
            upper_limit: self.status.any(Status::UPPER_LIMIT),
        };
        (self.state, missing)
    }

    fn power(&self) -> Power {
        let effected = self.answers >= ANSWERS_TO_EFFECT;
        match self.aim {
            Aim::Manual | Aim::Error if effected => Power::Off,
            Aim::Drive | Aim::Index if self.powered => Power::On,
            Aim::Manual | Aim::Error | Aim::Drive | Aim::Index => Power::Changing,
        }
    }

    /// The set-point in the drive's units, if the command brings one; the reason if it cannot be followed. A
    /// faulted axis has none: it is being stopped, whatever it is told.
    pub(super) fn check(&self, command: AxisCommand) -> Result<Option<i16>, Refusal> {
        let faulted = self.state.fault.is_some();
        let setpoint = match command {
            AxisCommand::Home if !faulted => return Err(Refusal::WrongKind),
            AxisCommand::Follow(setpoint) | AxisCommand::Seek(setpoint) if !faulted => setpoint,
            AxisCommand::Off
            | AxisCommand::ResetFault
            | AxisCommand::Stand
            | AxisCommand::Home
            | AxisCommand::Follow(_)
            | AxisCommand::Seek(_) => return Ok(None),
        };
        let Setup {
            dialect,
            scale,
            torque_constant,
            full_scale,
            ..
        } = &self.setup;
        let raw = match (dialect.control, setpoint) {
            (Control::Current, Setpoint::Torque(torque)) => scale
                .milliamperes(torque.get(), *torque_constant)
                .map(|current| current.0)
                .filter(|current| current.unsigned_abs() <= full_scale.unsigned_abs()),
            (Control::Pwm, Setpoint::Duty(duty)) => {
                scale.pulse_width(duty.get()).map(|width| width.0)
            }
            (
                Control::Current | Control::Pwm,
                Setpoint::Position(_)
                | Setpoint::PositionWithTorque { .. }
                | Setpoint::Velocity(_)
                | Setpoint::Torque(_)
                | Setpoint::Duty(_),
            ) => return Err(Refusal::WrongKind),
        };
        if self.state.power != Power::On {
            return Err(Refusal::NotOn);
        }
        raw.map(Some).ok_or(Refusal::OutOfRange)
    }

    pub(super) fn refuse(&mut self, refusal: Refusal) {
        self.latch(AxisControllerFault::Refused(refusal));
    }

    /// Takes the command of this cycle. `setpoint` is what [`check`](Self::check) said; `hold` keeps that of the
    /// last cycle, because another axis refused its own.
    pub(super) fn command(&mut self, command: AxisCommand, setpoint: Option<i16>, hold: bool) {
        if self.unreferenced >= CYCLES_TO_UNREFERENCE {
            let cycles = self.unreferenced;
            self.latch(AxisControllerFault::KeepsReference { cycles });
        }
        let faulted = self.state.fault.is_some();
        let powered = self.powered;
        let seek = match command {
            AxisCommand::Seek(_) => !faulted && powered,
            _ => false,
        };
        if seek && !self.seeking {
            self.unreferencing = self.reported.any(Status::SYNCHRONIZED);
            self.referenced = false;
        }
        self.seeking = seek;
        let still =
            self.status.any(Status::SYNCHRONIZED) || self.reported.any(Status::SYNCHRONIZED);
        self.unreferencing &= seek && still;
        self.misled &= still;
        let aim = match command {
            AxisCommand::ResetFault => Aim::Manual,
            _ if self.panics || self.stopped => Aim::Error,
            AxisCommand::Off => Aim::Manual,
            // Whatever a faulted drive is, it stays, with a zero set-point: the motor brakes itself.
            _ if faulted => self.aim,
            // One pulse is what it seeks.
            AxisCommand::Seek(_) if seek && !self.unreferencing && !self.referenced => Aim::Index,
            AxisCommand::Seek(_)
            | AxisCommand::Follow(_)
            | AxisCommand::Stand
            | AxisCommand::Home => Aim::Drive,
        };
        self.overtakes = aim != self.aim && matches!(aim, Aim::Manual | Aim::Error);
        if aim != self.aim {
            self.was_indexing = self.aim == Aim::Index;
            self.aim = aim;
            (self.answers, self.told) = (0, 0);
        }
        let follows = matches!(aim, Aim::Drive | Aim::Index) && powered && !faulted;
        self.setpoint = match setpoint {
            _ if !follows || self.may_have_restarted() => 0,
            _ if hold => self.setpoint,
            Some(setpoint) => setpoint,
            None => 0,
        };
        let unreference = self.unreferencing && follows;
        let turn = self.unreferenced;
        self.unreferenced = if unreference { turn + 1 } else { 0 };
        self.telegram = match aim {
            // What takes torque away is said in every cycle.
            Aim::Manual | Aim::Error => {
                self.powered = false;
                self.setup.dialect.rest(aim, self.told, self.misled)
            }
            Aim::Drive | Aim::Index if faulted => self.setup.dialect.zero(),
            Aim::Drive | Aim::Index if powered => {
                let tell = self.answers < ANSWERS_TO_EFFECT;
                let dialect = self.setup.dialect;
                let unreference = unreference && dialect.may_unreference(turn);
                dialect.follow(aim, self.setpoint, tell, unreference)
            }
            Aim::Drive | Aim::Index => self.setup.dialect.switch_on(self.answers),
        };
    }

    /// Whether the last answer may be that of a drive which restarted, and would take a set-point for being switched
    /// on again.
    fn may_have_restarted(&self) -> bool {
        let unreferenced = self.referenced && !self.reported.any(Status::SYNCHRONIZED);
        self.setup.dialect.setpoints_switch_on() && (self.gate.leapt() || unreferenced)
    }

    pub(super) fn telegram(&self) -> &[u8] {
        self.telegram.bytes()
    }

    /// Whether what the line still holds of older telegrams is to be dropped before this one.
    pub(super) fn overtakes(&self) -> bool {
        self.overtakes
    }

    /// Whether the line took the whole telegram.
    pub(super) fn handed_over(&mut self, taken: bool, now: Instant) {
        if taken {
            self.counters.sent += 1;
            self.told = self.told.saturating_add(1);
            self.not_sent = 0;
            self.sent_at = now;
            // An answer that is later than the next one never counted.
            self.owed = (self.owed + 1).min(2);
        } else {
            self.counters.refused += 1;
            self.not_sent = self.not_sent.saturating_add(1);
        }
    }

    /// Whether the line took the last telegram.
    pub(super) fn was_sent(&self) -> bool {
        self.not_sent == 0
    }

    /// Whether a fault is latched: no set-point of this axis is followed.
    pub(super) fn is_faulted(&self) -> bool {
        self.state.fault.is_some()
    }

    /// What is said last to a drive whose group ends.
    pub(super) fn farewell(&self) -> Telegram {
        let dialect = self.setup.dialect;
        let aim = if self.panics || self.stopped {
            Aim::Error
        } else {
            Aim::Manual
        };
        dialect.farewell(aim, self.misled)
    }

    /// What the drive and the line still show is latched again by the next reading.
    pub(super) fn reset(&mut self) {
        self.state.fault = None;
        (self.panics, self.stopped) = (false, false);
    }

    /// Whether this axis itself has panicked since its last reset.
    pub(super) fn panics(&self) -> bool {
        self.panics
    }

    /// The axis of `line` panicked: this drive too is to open the cabinet's circuit.
    pub(super) fn stop_with(&mut self, line: u8) {
        if !self.panics && !self.stopped {
            self.stopped = true;
            self.latch(AxisControllerFault::Cabinet { line });
        }
    }

    /// The first fault stays until reset: the later ones are mostly its consequences. A panic is one in any
    /// place.
    fn latch(&mut self, fault: AxisControllerFault) {
        let line = self.setup.line;
        self.panics |= fault.is_panic();
        let fault = Fault::AxisController { line, fault };
        self.state.fault.get_or_insert(fault);
    }
}
