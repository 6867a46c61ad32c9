//! One axis controller on a serial line during operation.

use can::Instant;
use serial::nfv2::Status;

use super::AxisCounters;
use super::config::{AxisConfig, Control, GroupConfig, Protocol};
use super::exchange::{Exchange, Reading};
use super::fault::{AxisControllerFault, FaultLatch};
use super::flaws::{self, Flaw, History};
use super::phase::{Acknowledgement, Phase, PhaseEvent};
use super::plausibility::{FreezeCheck, Measured, PositionCheck, Verdict};
use super::stream::{Answer, Stream};
use super::telegram::{ControllerMode, Dialect, Telegram};
use crate::{AxisCommand, AxisState, Homing, Milliamperes, Power, Refusal, Scale, Setpoint, Switches};

/// Cycles in a row that a drive may need to forget its reference, damaged answers included.
const CYCLES_TO_UNREFERENCE: u32 = 25;

/// Cycles within which the counters of two axes change places.
const CYCLES_TO_SWAP: u32 = 8;

/// Status bits of a drive that limits its motor, whose answers may stay the same.
const LIMITED: u16 = Status::UPPER_LIMIT
    | Status::LOWER_LIMIT
    | Status::POSITION_LIMITED
    | Status::SPEED_LIMITED
    | Status::CURRENT_LIMITED;

/// One drive during operation.
///
/// [`Phase`] says what the drive is told, and its transition function what changes that. Every other field is
/// independent of the phase.
///
/// Nothing here waits or allocates. A cycle calls, one after the other: [`take`](Self::take) and
/// [`end_of_read`](Self::end_of_read); [`FaultLatch::reset`], [`FaultLatch::stop_with`] and [`check`](Self::check) for
/// all axes; [`command`](Self::command) and [`handed_over`](Self::handed_over).
#[derive(Clone, Debug)]
pub(super) struct SerialAxis {
    pub(super) setup: Setup,
    phase: Phase,
    acknowledgement: Acknowledgement,
    pub(super) faults: FaultLatch,
    pub(super) exchange: Exchange,
    stream: Stream,
    position_check: PositionCheck,
    freeze_check: FreezeCheck,
    history: History,
    /// Position of the last answer, accepted or not.
    seen: i32,
    /// Cycles for which another axis may find its counter here.
    unsure: u32,
    /// The counter jumped in this reading.
    jumped: Option<AxisControllerFault>,
    /// A reported fault. A telegram is left out before it counts: an answer then is that of another drive.
    probed: Option<AxisControllerFault>,
    /// Answers of the last reading: without a request, and the last request has none.
    unasked: bool,
    unanswered: bool,
    /// The last telegram was left out.
    left_out: bool,
    status: DebouncedStatus,
    measured: Measured,
    reference: Reference,
    pulse: Pulse,
    /// As the last reading left it.
    state: AxisState,
    /// Set-point of the last telegram, in the units of the drive.
    setpoint: i16,
    pub(super) telegram: Telegram,
    /// The telegram is the first to take torque away: older telegrams that the line still holds are discarded before it.
    pub(super) discards_unsent: bool,
    /// The telegram may be left out: it repeats what the drive has acknowledged, with another set-point at most.
    repeats: bool,
    pub(super) counters: AxisCounters,
}

/// What does not change while the group lives.
#[derive(Clone, Copy, Debug)]
pub(super) struct Setup {
    pub(super) dialect: Dialect,
    scale: Scale,
    torque_constant: f64,
    /// Torque at which the overcurrent protection acts, N·m.
    torque_limit: f64,
    /// Greatest set-point, in the units of the drive.
    full_scale: i16,
    /// Greatest plausible current, mA.
    greatest_current: u16,
    tolerated_missing: u32,
    /// Answers name no drive, and the group has other drives: a telegram is left out before a reported fault counts.
    pub(super) probes: bool,
}

/// Status bits, debounced: a bit counts when two answers in a row agree about it.
#[derive(Clone, Copy, Debug, Default)]
struct DebouncedStatus {
    confirmed: Status,
    /// Bits of the last answer.
    last: Status,
}

/// Whether the counter stood at zero when the drive first showed its reference, as the index pulse leaves it.
#[derive(Clone, Copy, Debug, Default)]
struct Pulse {
    seen: bool,
    /// When the drive was last asked for a status that showed no reference.
    before: Instant,
}

/// Reference of the position counter, as the host knows it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Reference {
    /// Positions of the counter are relative.
    #[default]
    Unknown,
    /// Positions of the counter are absolute.
    Known,
    /// The counter jumped or may have lost counts. The drive is told to forget its reference, which the next host would
    /// trust.
    Invalid,
}

#[derive(Clone, Debug)]
pub(super) struct Learnt {
    pub(super) answer: Answer,
    pub(super) at: Instant,
    pub(super) stream: Stream,
}

impl SerialAxis {
    pub(super) fn new(group: &GroupConfig, config: &AxisConfig, line: u8) -> Self {
        let limit = config.limit().map_or(0, |Milliamperes(limit)| limit);
        let dialect = Dialect::new(group.protocol, config.address, config.control);
        let setup = Setup {
            dialect,
            scale: config.scale,
            torque_constant: config.torque_constant,
            torque_limit: config.max_current * config.torque_constant,
            full_scale: match config.control {
                Control::Current => limit,
                Control::Pwm => serial::nfv2::FULL_PWM,
            },
            // The protection acts after the current was there.
            greatest_current: limit.unsigned_abs().saturating_mul(3) / 2,
            tolerated_missing: group.tolerated_missing,
            probes: false,
        };
        Self {
            setup,
            phase: Phase::Off,
            acknowledgement: Acknowledgement::BROUGHT_UP,
            faults: FaultLatch::new(line),
            exchange: Exchange::new(group.protocol, group.tolerated_missing, Instant::ZERO),
            stream: Stream::new(group.protocol, config.address),
            position_check: PositionCheck::new(group, config),
            freeze_check: FreezeCheck::new(setup.full_scale),
            history: History::default(),
            seen: 0,
            unsure: 0,
            jumped: None,
            probed: None,
            unasked: false,
            unanswered: false,
            left_out: false,
            status: DebouncedStatus::default(),
            measured: Measured::default(),
            reference: Reference::default(),
            pulse: Pulse::default(),
            state: AxisState::default(),
            setpoint: 0,
            telegram: Telegram::NONE,
            discards_unsent: false,
            repeats: false,
            counters: AxisCounters::default(),
        }
    }

    /// Starts operation after bring-up: without torque, at the position of the last answer.
    pub(super) fn begin(&mut self, learnt: Learnt) {
        let Learnt { answer, at, stream } = learnt;
        let setup = self.setup;
        self.phase = Phase::Off;
        self.acknowledgement = Acknowledgement::BROUGHT_UP;
        self.faults.reset();
        self.exchange = Exchange::new(setup.dialect.protocol, setup.tolerated_missing, at);
        self.stream = stream;
        self.position_check.begin(answer.position.0, at);
        self.freeze_check = FreezeCheck::new(setup.full_scale);
        self.history = History::default();
        (self.seen, self.unsure) = (answer.position.0, 0);
        (self.jumped, self.probed) = (None, None);
        self.measured.take(answer);
        let status = self.measured.status;
        self.status = DebouncedStatus { confirmed: status, last: status };
        self.reference = match status.any(Status::SYNCHRONIZED) {
            true => Reference::Known,
            false => Reference::Unknown,
        };
        self.pulse = Pulse { seen: false, before: at };
        self.state = AxisState { at, ..AxisState::default() };
        self.setpoint = 0;
        self.repeats = false;
        self.telegram = self.encode();
        self.measure();
    }

    pub(super) fn take(&mut self, bytes: &[u8], now: Instant) {
        let (owed, asked) = (self.exchange.outstanding(), self.exchange.asked());
        let foreign = self.counters.foreign;
        let found = self.stream.take(bytes, owed, asked, &mut self.counters);
        if let Some(address) = self.stream.foreign().filter(|_| self.counters.foreign > foreign) {
            self.exchange.refuse(Flaw::OtherDrive(address));
        }
        self.unsure = self.unsure.saturating_sub(1);
        (self.unasked, self.unanswered) = (found.count > owed, owed > 0 && found.count == 0);
        if let Some(answer) = self.exchange.receive(&found, &mut self.counters) {
            self.seen = answer.position.0;
            match self.flaw(answer, found.before) {
                Some(flaw) => {
                    self.counters.implausible += 1;
                    self.exchange.refuse(flaw);
                }
                None => self.judge(answer, now),
            }
        }
    }

    /// What is wrong with an answer whose contents alone are plausible.
    fn flaw(&self, answer: Answer, before: Option<Answer>) -> Option<Flaw> {
        if self.setup.dialect.protocol == Protocol::Nfv2 {
            return None;
        }
        let (expected, moved) = self.position_check.predicted(self.exchange.sent_at)?;
        if before.is_some_and(|before| flaws::are_reversed(before, answer, moved)) {
            return Some(Flaw::Reversed);
        }
        self.history.is_old(answer, expected, moved).then_some(Flaw::Old)
    }

    /// Whether the counter has jumped in this reading to the place of the counter of `other`, and the reverse.
    pub(super) fn swaps_with(&self, other: &Self) -> bool {
        let near = |of: &Self, seen: i32| {
            let reach = of.position_check.reach_in(f64::from(CYCLES_TO_SWAP));
            of.history.is_near(seen, reach)
        };
        let proven = self.probed.is_some() && self.unasked && other.unanswered;
        proven || self.jumped.is_some() && other.unsure > 0 && near(other, self.seen) && near(self, other.seen)
    }

    fn judge(&mut self, answer: Answer, now: Instant) {
        let greatest = self.setup.greatest_current;
        if answer.current.is_some_and(|current| current.0.unsigned_abs() > greatest) {
            self.counters.implausible += 1;
            self.exchange.refuse(Flaw::Garbled);
            return;
        }
        let may_index = self.phase.mode() == ControllerMode::Index || self.acknowledgement.may_index();
        let sent_at = self.exchange.sent_at;
        let mut indexed = false;
        let verdict = self.position_check.judge(answer, sent_at, may_index);
        if self.position_check.contradicts() {
            self.exchange.refuse(Flaw::Garbled);
        }
        match verdict {
            Verdict::Plausible => {}
            Verdict::Implausible => {
                self.counters.implausible += 1;
                self.unsure = CYCLES_TO_SWAP;
                return;
            }
            Verdict::Unconfirmed => {
                self.exchange.reading = Reading::Unconfirmed;
                return;
            }
            Verdict::Indexed(before) => {
                self.counters.indexed += 1;
                self.status.last = before.unwrap_or(self.status.last);
                indexed = true;
            }
            Verdict::Jumped { from, status } => {
                if answer.status.is_none() {
                    self.status.last = status.unwrap_or(self.status.last);
                }
                let restarted = self.loses_reference(status.unwrap_or(self.status.last));
                self.doubt_reference();
                let to = answer.position.0;
                let jumped = AxisControllerFault::Jumped { from, to };
                self.jumped = Some(if restarted { AxisControllerFault::Restarted } else { jumped });
                self.unsure = CYCLES_TO_SWAP;
            }
        }
        self.accept(answer, now, indexed, may_index);
    }

    fn accept(&mut self, answer: Answer, now: Instant, indexed: bool, may_index: bool) {
        self.counters.accepted += 1;
        self.exchange.reading = Reading::Accepted;
        self.history.push(answer);
        let answers = &mut self.acknowledgement.answers;
        *answers = answers.saturating_add(1);
        (self.state.at, self.state.sampled) = (now, self.exchange.asked_at);
        if let Some(status) = answer.status {
            if self.contradicts(status, may_index) {
                self.exchange.refuse(Flaw::Garbled);
            }
            self.look_for_pulse(answer.position.0, status);
            self.status.take(status);
        }
        if indexed {
            self.pulse.seen = true;
            // Two positions at the pulse confirm the status, which only one of their answers may have.
            self.status.confirm(Status::SYNCHRONIZED);
        }
        self.measured.take(answer);
        self.measure();
        // A faulted drive is not told its mode any more.
        let answers = self.setup.dialect.answers_to_switch_on();
        if !self.faults.is_latched() && self.jumped.is_none() && self.acknowledgement.answers >= answers {
            self.phase = self.phase.next(PhaseEvent::SwitchedOn);
        }
        if self.loses_reference(self.status.confirmed) {
            self.reference = Reference::Unknown;
            self.jumped.get_or_insert(AxisControllerFault::Restarted);
        }
        let forgetting = matches!(self.phase, Phase::Unreferencing { .. });
        let synchronized = self.status.confirmed.any(Status::SYNCHRONIZED);
        if self.reference == Reference::Unknown && synchronized && may_index && !forgetting {
            match self.pulse.seen {
                true => self.reference = Reference::Known,
                false => {
                    let fault = AxisControllerFault::NotIndexed { position: answer.position.0 };
                    _ = self.jumped.get_or_insert(fault);
                }
            }
        }
        let responsive = self.phase.has_torque() && !self.status.confirmed.any(LIMITED);
        if let Some(cycles) = self.freeze_check.judge(self.measured, self.setpoint, responsive) {
            self.doubt_reference();
            self.faults.latch(AxisControllerFault::Frozen { cycles });
        }
    }

    /// Whether a drive with torque cannot show this status after its last one: only manual mode clears its own faults, and
    /// only the index pulse gives it a reference.
    fn contradicts(&self, status: Status, may_index: bool) -> bool {
        const HELD: u16 = Status::OVERCURRENT | Status::ERROR;
        let last = self.status.last;
        let cleared = last.0 & !status.0 & HELD != 0;
        let referenced = status.any(Status::SYNCHRONIZED) && !last.any(Status::SYNCHRONIZED);
        self.phase.has_torque() && self.acknowledgement.is_complete() && (cleared || referenced && !may_index)
    }

    /// Judges the first answer with a reference. The pulse came after the last answer without one.
    fn look_for_pulse(&mut self, position: i32, status: Status) {
        let asked_at = self.exchange.sent_at;
        if !status.any(Status::SYNCHRONIZED) {
            self.pulse = Pulse { seen: false, before: asked_at };
        } else if !self.status.last.any(Status::SYNCHRONIZED) {
            self.pulse.seen = self.position_check.is_near_zero(position, asked_at.since(self.pulse.before));
        }
    }

    /// Discards the reference until the next search. The axis controller is told to discard it too.
    pub(super) fn doubt_reference(&mut self) {
        self.reference = Reference::Invalid;
    }

    fn measure(&mut self) {
        let (scale, measured) = (&self.setup.scale, self.measured);
        self.state.increments = measured.position;
        self.state.position = scale.position(measured.position);
        self.state.velocity = self.position_check.velocity() / scale.increments_per_radian();
        self.state.torque = scale.torque_of(measured.current, self.setup.torque_constant);
        self.state.torque_limit = self.setup.torque_limit;
    }

    /// Ends the reading of a cycle. `due` says whether the cycle before asked for an answer. Returns the state, and
    /// whether the answer is missing.
    pub(super) fn end_of_read(&mut self, due: bool) -> (AxisState, bool) {
        if let Some(fault) = self.jumped.take() {
            self.faults.latch(fault);
        }
        let status = self.status.confirmed;
        let doubt = self.exchange.doubt();
        let reported = [
            (Status::POWER_STAGE_FAULT, AxisControllerFault::PowerStage),
            (Status::OVERCURRENT, AxisControllerFault::Overcurrent),
            (Status::ERROR, AxisControllerFault::Error),
        ];
        // In an emergency stop the host itself told the drive to be in its error state.
        let probed = self.probed.take();
        probed.into_iter().for_each(|fault| self.faults.latch(fault));
        if self.phase != Phase::EmergencyStop {
            let reported = reported.into_iter().filter(|(bit, _)| status.any(*bit));
            let mut reported = reported.map(|(_, fault)| doubt.unwrap_or(fault));
            let may_probe = self.setup.probes && self.repeats && self.phase.has_torque();
            if may_probe && probed.is_none() && !self.faults.is_latched() {
                self.probed = reported.next();
            } else {
                reported.for_each(|fault| self.faults.latch(fault));
            }
        }
        let exchange = self.exchange.end_of_reading(due);
        for fault in exchange.faults.into_iter().flatten() {
            self.faults.latch(fault);
        }
        let power = self.power();
        self.state = AxisState {
            age: exchange.age,
            power,
            homing: match (self.reference, self.phase.searches()) {
                (Reference::Known, _) => Homing::Attained,
                (Reference::Unknown | Reference::Invalid, true) => Homing::InProgress,
                (Reference::Unknown | Reference::Invalid, false) => Homing::NotHomed,
            },
            following: power == Power::On && !self.faults.is_latched(),
            torque_limited: status.any(Status::CURRENT_LIMITED),
            switches: Switches {
                home: status.any(Status::HOME_SWITCH),
                lower_limit: status.any(Status::LOWER_LIMIT),
                upper_limit: status.any(Status::UPPER_LIMIT),
            },
            fault: self.faults.first(),
            ..self.state
        };
        (self.state, exchange.missing)
    }

    fn power(&self) -> Power {
        if self.phase.has_torque() {
            Power::On
        } else if self.phase.rests() && self.acknowledgement.is_complete() {
            Power::Off
        } else {
            Power::Changing
        }
    }

    /// The set-point in the drive's units, if the command brings one; the reason if it cannot be followed. A
    /// faulted axis has none: it is being stopped by any command.
    pub(super) fn check(&self, command: AxisCommand) -> Result<Option<i16>, Refusal> {
        let setpoint = match command {
            _ if self.faults.is_latched() => return Ok(None),
            AxisCommand::Home => return Err(Refusal::WrongKind),
            AxisCommand::Follow(setpoint) | AxisCommand::Seek(setpoint) => setpoint,
            AxisCommand::Off | AxisCommand::ResetFault | AxisCommand::Stand => return Ok(None),
        };
        let setup = &self.setup;
        let raw = match (setup.dialect.control, setpoint) {
            (Control::Current, Setpoint::Torque(torque)) => setup
                .scale
                .milliamperes(torque.get(), setup.torque_constant)
                .map(|current| current.0)
                .filter(|current| current.unsigned_abs() <= setup.full_scale.unsigned_abs()),
            (Control::Pwm, Setpoint::Duty(duty)) => setup.scale.pulse_width(duty.get()).map(|width| width.0),
            (
                Control::Current | Control::Pwm,
                Setpoint::Position(_)
                | Setpoint::PositionWithTorque { .. }
                | Setpoint::Velocity(_)
                | Setpoint::Torque(_)
                | Setpoint::Duty(_),
            ) => return Err(Refusal::WrongKind),
        };
        if !self.phase.has_torque() {
            return Err(Refusal::NotOn);
        }
        raw.map(Some).ok_or(Refusal::OutOfRange)
    }

    /// Takes the command of this cycle. `setpoint` is the result of [`check`](Self::check); `hold` keeps the set-point
    /// of the last cycle, because another axis refused its own.
    pub(super) fn command(&mut self, command: AxisCommand, setpoint: Option<i16>, hold: bool) {
        if let Phase::Unreferencing { cycles } = self.phase
            && cycles >= CYCLES_TO_UNREFERENCE
        {
            let fault = AxisControllerFault::KeepsReference { cycles };
            self.faults.latch(fault);
        }
        if command == AxisCommand::ResetFault {
            self.probed = None;
        }
        let before = self.phase;
        self.phase = before.next(self.event(command));
        let search_begins = self.phase.searches() && !before.searches();
        self.reference = match self.reference {
            Reference::Known if search_begins => Reference::Unknown,
            Reference::Invalid if !self.status.may_be(Status::SYNCHRONIZED) => Reference::Unknown,
            unchanged => unchanged,
        };
        let mode_changes = self.phase.mode() != before.mode();
        if mode_changes {
            self.acknowledgement = Acknowledgement::pending(before.mode());
        }
        self.discards_unsent = mode_changes && self.phase.rests();
        self.repeats = self.acknowledgement.is_complete() && !self.faults.is_latched() && !self.may_have_restarted();
        self.setpoint = match setpoint {
            _ if !self.phase.follows() || self.may_have_restarted() => 0,
            _ if hold => self.setpoint,
            Some(setpoint) => setpoint,
            None => 0,
        };
        self.telegram = self.encode();
    }

    /// What a command means to an axis with these faults and this reference.
    fn event(&self, command: AxisCommand) -> PhaseEvent {
        match command {
            AxisCommand::ResetFault => PhaseEvent::Off,
            _ if self.faults.is_emergency_stop() => PhaseEvent::EmergencyStop,
            AxisCommand::Off => PhaseEvent::Off,
            _ if self.faults.is_latched() => PhaseEvent::Fault,
            AxisCommand::Seek(_) => PhaseEvent::Seek {
                drive_referenced: self.status.may_be(Status::SYNCHRONIZED),
                index_found: self.reference == Reference::Known,
            },
            AxisCommand::Follow(_) | AxisCommand::Stand | AxisCommand::Home => PhaseEvent::Follow,
        }
    }

    fn encode(&self) -> Telegram {
        let (dialect, mode) = (self.setup.dialect.asking(self.exchange.next()), self.phase.mode());
        let Acknowledgement { telegrams, answers, .. } = self.acknowledgement;
        let tell = !self.acknowledgement.is_complete();
        match self.phase {
            Phase::Off | Phase::EmergencyStop => dialect.rest(mode, telegrams, self.reference == Reference::Invalid),
            Phase::SwitchingOn => dialect.switch_on(answers),
            Phase::Unreferencing { cycles } => {
                let unreference = dialect.may_unreference(cycles);
                dialect.follow(mode, self.setpoint, tell, unreference)
            }
            Phase::Following | Phase::SearchingIndex | Phase::IndexFound => {
                dialect.follow(mode, self.setpoint, tell, false)
            }
            Phase::FaultReaction(_) => dialect.zero(),
        }
    }

    /// Whether the last answer may come from a drive that restarted, which a set-point would switch on again.
    fn may_have_restarted(&self) -> bool {
        let unreferenced = self.loses_reference(self.status.last);
        let suspicious = self.position_check.is_beyond_reach() || unreferenced;
        self.setup.dialect.setpoints_switch_on() && suspicious
    }

    /// Whether a drive with this status has lost a reference that the host knows.
    fn loses_reference(&self, status: Status) -> bool {
        self.reference == Reference::Known && !status.any(Status::SYNCHRONIZED)
    }

    /// Leaves the telegram out where that can prove a delay of the answers. Returns whether it does.
    pub(super) fn leave_out(&mut self) -> bool {
        let probes = self.probed.is_some() && !self.left_out;
        let leaves_out = self.repeats && (self.exchange.wants_gap() || probes);
        self.left_out = leaves_out;
        if leaves_out {
            self.exchange.leave_out(&mut self.counters);
        }
        leaves_out
    }

    /// Whether the line took the whole telegram.
    pub(super) fn handed_over(&mut self, taken: bool, now: Instant) {
        self.exchange.send(taken, now, &mut self.counters);
        if taken {
            let telegrams = &mut self.acknowledgement.telegrams;
            *telegrams = telegrams.saturating_add(1);
        }
    }

    /// The last telegram to a drive whose group ends.
    pub(super) fn farewell(&self) -> Telegram {
        let mode = if self.faults.is_emergency_stop() { ControllerMode::Error } else { ControllerMode::Manual };
        let dialect = self.setup.dialect;
        dialect.farewell(mode, self.reference == Reference::Invalid)
    }
}

impl DebouncedStatus {
    fn take(&mut self, status: Status) {
        let differ = status.0 ^ self.last.0;
        self.confirmed = Status(self.confirmed.0 & differ | status.0 & !differ);
        self.last = status;
    }

    /// Confirms bits that the last answer may not have had.
    fn confirm(&mut self, bits: u16) {
        self.confirmed.0 |= bits;
        self.last.0 |= bits;
    }

    /// Whether `bit` is confirmed, or shown by the last answer.
    fn may_be(&self, bit: u16) -> bool {
        self.confirmed.any(bit) || self.last.any(bit)
    }
}
