//! One drive during operation.

mod lost;

use std::time::Duration;

use can::{Frame, Instant};
use canopen::cia402::{Controlword, ModeOfOperation, PowerState, Statusword, questions_position};
use canopen::emcy::Emergency;
use canopen::nmt;
use master::power::{self, PowerStateMachine};

use super::config::{AxisConfig, CyclicMode, GroupConfig};
use super::contact::Contact;
use super::homing::Search;
use super::measurement::Measurement;
use super::process_data::{self, Answer};
use super::program::MAXON;
use super::search_evidence::SearchRules;
use super::search_watch::SearchWatch;
use super::service::{ModeSwitch, Service};
use super::status_warnings::StatusWarnings;
use super::target::Target;
use crate::bus::Learnt;
use crate::{AxisCommand, AxisState, EmergencyStop, Fault, Permille, Power, Refusal, WarningCause};

/// Answers until a controlword surely has its effect in the statusword. The drive latches the word at the next SYNC
/// and acts on it afterwards. The SYNC after that samples the effect, and the following cycle reads the sample.
pub(super) const ANSWERS_TO_EFFECT: u32 = 4;

/// State of one drive during operation: last answer, commanded state and latched fault.
///
/// Nothing here waits or allocates. The order of calls within a cycle is:
/// 1. [`in_time`](Self::in_time), [`answered`](Self::answered), [`inputs`](Self::inputs), [`shows`](Self::shows),
///    [`heard`](Self::heard) and [`emergency`](Self::emergency), as frames arrive;
/// 2. in [`Cia402Group::recover`](super::Cia402Group::recover), [`begin_recovery`](Self::begin_recovery), or the end of
///    a recovery: [`begin`](Self::begin) after success, [`end_recovery`](Self::end_recovery) after a failure;
/// 3. [`end_of_read`](Self::end_of_read);
/// 4. [`check`](Self::check) of every axis;
/// 5. [`command`](Self::command) and [`handed_over`](Self::handed_over).
#[derive(Clone, Debug)]
pub(super) struct CanAxis {
    group: GroupConfig,
    /// Without the objects that bring-up writes.
    config: AxisConfig,

    state: AxisState,
    statusword: Statusword,
    warnings: StatusWarnings,
    measurement: Measurement,
    /// The last SYNC was answered.
    answered: bool,
    contact: Option<Contact>,
    /// Cycles in a row whose set-point the port did not take.
    not_sent: u32,
    error_code: u16,
    /// Cycles since the error code came.
    error_age: u32,
    heartbeat: Option<Instant>,
    /// NMT state of the node, as its last heartbeat reports it.
    node_state: nmt::NmtState,
    booted: bool,
    /// A reset of the fault demands a new bring-up of the drive.
    recovery_due: bool,
    /// The present reset has begun a recovery.
    recovery_tried: bool,
    /// A drive in pre-operational took the order to remove its torque, and must show its statusword.
    switched_off: bool,

    goal: Goal,
    /// Answers received in time since the goal changed.
    answers: u32,
    unsettled_since: Option<Instant>,
    power: PowerStateMachine,
    search: Search,
    search_watch: SearchWatch,
    modes: ModeSwitch,
    /// A request to change the mode of operation is under way.
    telling: bool,
    /// The drive failed a service request. No further request is made until the fault is reset.
    unserved: bool,
    /// The target of the last cycle was a position held under torque.
    held: bool,
    target: Target,
}

/// The state that the drive is commanded to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Goal {
    /// No torque.
    #[default]
    Off,
    /// No torque and no fault.
    ResetFault,
    /// Torque.
    On,
    /// Braked by a quick stop, for a fault that the drive itself does not see.
    Stopped,
}

impl CanAxis {
    pub(super) fn new(group: &GroupConfig, axis: &AxisConfig) -> Self {
        let config = AxisConfig { configuration: Vec::new(), ..axis.clone() };
        Self::started(*group, config, Instant::ZERO, Learnt::default())
    }

    /// Starts operation after bring-up. The drive is not enabled, and its position is known before any controlword
    /// could enable it.
    pub(super) fn begin(&mut self, now: Instant, learnt: Learnt) {
        // Bring-up neither resets nor checks the counter.
        let doubted = self.search.doubted;
        *self = Self::started(self.group, self.config.clone(), now, learnt);
        self.search.doubted |= doubted;
        if let Some(mode) = learnt.mode_shown {
            self.shows(mode);
        }
    }

    fn started(group: GroupConfig, config: AxisConfig, now: Instant, learnt: Learnt) -> Self {
        let mut axis = Self {
            group,
            state: AxisState { at: now, ..AxisState::default() },
            statusword: learnt.statusword,
            warnings: StatusWarnings::default(),
            measurement: Measurement::new(&group, &config, learnt.position),
            answered: false,
            contact: Contact::new(&config, group.tolerated_missing, learnt.inputs),
            not_sent: 0,
            error_code: learnt.error_code,
            error_age: 0,
            heartbeat: None,
            node_state: nmt::NmtState::Operational,
            booted: false,
            recovery_due: false,
            recovery_tried: false,
            switched_off: false,
            goal: Goal::Off,
            answers: 0,
            unsettled_since: None,
            power: PowerStateMachine::default(),
            search: Search::new(SearchRules::new(&group, &config)),
            search_watch: SearchWatch::new(&config),
            modes: ModeSwitch::settled(config.mode.of_operation()),
            telling: false,
            unserved: false,
            held: false,
            target: Target::default(),
            config,
        };
        axis.measurement.tell(&mut axis.state);
        let faulted = matches!(learnt.statusword.power_state(), PowerState::Fault | PowerState::FaultReactionActive);
        axis.search.doubted = faulted && questions_position(learnt.error_code);
        let word = axis.homing_word(learnt.statusword);
        axis.search.learnt(word);
        axis.judge_power(PowerState::NotReadyToSwitchOn);
        axis
    }

    /// The statusword without bit 15, unless the drive is maxon's: the meaning of this bit is vendor-specific.
    fn homing_word(&self, word: Statusword) -> Statusword {
        let told = self.config.identity.vendor == MAXON && word.has(Statusword::EPOS_REFERENCED);
        word.with(Statusword::EPOS_REFERENCED, told)
    }

    pub(super) fn fault(&self) -> Option<Fault> {
        self.state.fault
    }

    pub(super) fn drive_fault(&self, code: u16) -> Fault {
        let node = self.config.node.raw();
        Fault::Drive { node, code }
    }

    /// Notes that the last SYNC was answered. A cycle that reads only older answers counts as a missing answer: a
    /// drive that lags behind is treated as silent.
    pub(super) fn in_time(&mut self) {
        self.answered = true;
        self.answers = self.answers.saturating_add(1);
    }

    /// Takes an answer received at `at`, sampled at the SYNC that was sent at `sampled`.
    pub(super) fn answered(&mut self, answer: Answer, sampled: Instant, at: Instant) {
        let before = self.statusword.power_state();
        self.statusword = answer.statusword;
        let enabled = self.statusword.power_state() == PowerState::OperationEnabled;
        self.warnings.look(self.statusword, enabled && !self.search.may_set_counter());
        let position = answer.position;
        let failure = self.search.answered(self.homing_word(answer.statusword), position, sampled, at);
        if let Some(fault) = failure.and_then(|failure| failure.fault(self.config.node)) {
            self.latch(fault);
        }
        let search = self.search.may_set_counter();
        let search_speed = search.then_some(self.config.homing.search_speed);
        let taken = self.measurement.take(position, sampled, at, search_speed);
        if let Err(jump) = &taken {
            let jump = *jump;
            self.doubt_reference();
            self.latch(jump);
        }
        self.measurement.tell(&mut self.state);
        self.state.stalled = self.search_watch.look(self.search.has_begun(), position, sampled);
        self.state.at = at;
        if taken.is_ok() {
            self.state.sampled = sampled;
        }
        self.state.torque = self.config.scale.torque(answer.torque, self.config.rated_torque);
        self.state.torque_limit = self.config.rated_torque;
        self.state.torque_limited = self.statusword.has(Statusword::INTERNAL_LIMIT);
        self.judge_power(before);
    }

    fn judge_power(&mut self, before: PowerState) {
        let node = self.config.node.raw();
        let dropped =
            before == PowerState::OperationEnabled && self.goal == Goal::On && self.answers > ANSWERS_TO_EFFECT;
        match self.statusword.power_state() {
            PowerState::FaultReactionActive | PowerState::Fault => {
                self.latch(self.drive_fault(self.error_code));
            }
            PowerState::OperationEnabled => {}
            PowerState::NotReadyToSwitchOn
            | PowerState::SwitchOnDisabled
            | PowerState::ReadyToSwitchOn
            | PowerState::SwitchedOn
            | PowerState::QuickStopActive
            | PowerState::Unknown => {
                // A drive that reacts to a lost connection stops without entering the fault state, but reports an
                // error code.
                if dropped && self.error_code != 0 {
                    self.latch(self.drive_fault(self.error_code));
                } else if dropped {
                    self.latch(Fault::PowerLost { node, statusword: self.statusword.0 });
                }
            }
        }
    }

    /// The warnings of the statusword since the last call.
    pub(super) fn take_warnings(&mut self) -> impl Iterator<Item = WarningCause> + use<> {
        self.warnings.take()
    }

    /// Takes a heartbeat or boot-up received at `at`.
    pub(super) fn heard(&mut self, state: nmt::NmtState, at: Instant) {
        self.heartbeat = Some(at);
        self.node_state = state;
        if state == nmt::NmtState::Initialising {
            self.booted = true;
            self.search.forget();
        }
    }

    /// Takes the mode of operation that the drive reported unasked. Frames arrive in the order of sending, so a report
    /// read behind an answer is no older than that answer.
    pub(super) fn shows(&mut self, found: ModeOfOperation) {
        let settled = self.modes.settled_in().filter(|_| !self.telling);
        if let Some(expected) = settled.filter(|expected| *expected != found) {
            self.modes = ModeSwitch::settled(found);
            self.latch(Fault::ModeChanged { node: self.config.node.raw(), expected, found });
        }
    }

    /// Takes the digital inputs. `None` for a drive without a contact of the emergency stop, and for an undecodable frame.
    pub(super) fn inputs(&mut self, data: &[u8]) -> Option<()> {
        self.contact.as_mut()?.take(data)
    }

    /// Discards the reference until the next search.
    pub(super) fn doubt_reference(&mut self) {
        self.search.doubt();
    }

    /// The demand of a stop by the contact of the emergency stop.
    pub(super) fn emergency_stop(&self) -> Option<EmergencyStop> {
        let works = self.is_operational() && !self.booted && !self.state.recovering;
        self.contact?.emergency_stop(works)
    }

    /// Takes an EMCY. An error of a drive that is commanded to be on is a fault, also if the drive itself goes on.
    pub(super) fn emergency(&mut self, emergency: &Emergency) {
        if emergency.is_reset() {
            self.error_code = 0;
            return;
        }
        self.name_fault(emergency.code);
        if self.goal == Goal::On && !emergency.leaves_device_working() {
            self.latch(self.drive_fault(emergency.code));
        }
    }

    /// Stores the error code of a drive fault. The code may arrive before or after the statusword that shows the
    /// fault. An error of the position discards the reference.
    fn name_fault(&mut self, found: u16) {
        if questions_position(found) {
            self.doubt_reference();
        }
        (self.error_code, self.error_age) = (found, 0);
        if let Some(Fault::Drive { code: code @ 0, .. }) = &mut self.state.fault {
            *code = found;
        }
    }

    /// Ends the reading of a cycle. Latches faults of missing answers, heartbeats and transmissions, and of a node that
    /// left the state operational. `due` is true if the last cycle had to send a SYNC. Returns the state and whether
    /// the answer is missing.
    pub(super) fn end_of_read(&mut self, now: Instant, due: bool) -> (AxisState, bool) {
        let node = self.config.node.raw();
        let missing = due && !self.answered;
        if self.answered {
            self.state.age = 0;
        } else if due {
            self.state.age = self.state.age.saturating_add(1);
        }
        self.answered = false;
        self.contact.iter_mut().for_each(|contact| contact.end_of_read(due));
        // The code of a warning does not name a later fault.
        self.error_age = self.error_age.saturating_add(1);
        if self.error_age > ANSWERS_TO_EFFECT {
            self.error_code = 0;
        }
        let waited = now.since(*self.heartbeat.get_or_insert(now));
        if !self.is_operational() || self.booted {
            self.latch(Fault::LeftOperational { node });
        }
        // Checked before silence, because dropped set-points may cause the silence.
        if self.not_sent > self.group.tolerated_missing {
            self.latch(Fault::NotSent { node, cycles: self.not_sent });
        }
        if self.state.age > self.group.tolerated_missing {
            self.latch(Fault::Silent { node, cycles: self.state.age });
        }
        if waited > self.group.heartbeat_lost_after() {
            self.latch(Fault::HeartbeatLost { node, waited });
        }
        self.state.power = self.power();
        self.state.following = self.following();
        self.state.homing = self.search.state();
        (self.state, missing)
    }

    fn power(&self) -> Power {
        match self.statusword.power_state() {
            PowerState::OperationEnabled if self.goal == Goal::On && self.answers > ANSWERS_TO_EFFECT => Power::On,
            PowerState::OperationEnabled | PowerState::QuickStopActive | PowerState::FaultReactionActive => {
                Power::Changing
            }
            PowerState::SwitchOnDisabled | PowerState::ReadyToSwitchOn | PowerState::SwitchedOn
                if self.goal == Goal::On =>
            {
                Power::Changing
            }
            PowerState::NotReadyToSwitchOn
            | PowerState::SwitchOnDisabled
            | PowerState::ReadyToSwitchOn
            | PowerState::SwitchedOn
            | PowerState::Fault
            | PowerState::Unknown => Power::Off,
        }
    }

    /// Bit 12 is ignored: a recorded EPOS shows 0x0737 once enabled, with this bit clear.
    fn following(&self) -> bool {
        self.state.power == Power::On
            && self.state.fault.is_none()
            && !self.search.needs_homing_mode()
            && !self.telling
            && self.modes.is(self.config.mode.of_operation())
    }

    /// Converts the set-point of a command to the drive's units; `None` for a command without a set-point. An error
    /// says why the set-point is refused. The set-point of a faulted axis is ignored, because the axis is being
    /// stopped.
    pub(super) fn check(&self, command: AxisCommand) -> Result<Option<Target>, Refusal> {
        let setpoint = match command {
            AxisCommand::Follow(setpoint) => setpoint,
            AxisCommand::Seek(_) if self.state.fault.is_none() => return Err(Refusal::WrongKind),
            _ => return Ok(None),
        };
        if self.state.fault.is_some() {
            return Ok(None);
        }
        let target = Target::of(setpoint, &self.config)?;
        if self.state.power != Power::On {
            return Err(Refusal::NotOn);
        }
        target.map(Some).ok_or(Refusal::OutOfRange)
    }

    pub(super) fn node(&self) -> u8 {
        self.config.node.raw()
    }

    pub(super) fn mode(&self) -> CyclicMode {
        self.config.mode
    }

    /// Latches a lag that the group does not tolerate: any where the host closes a loop, and more than the tolerated number
    /// where the drive closes the position loop.
    pub(super) fn judge_lag(&mut self, periods: u32, latency: Duration) {
        let most = self.group.tolerated_latency(self.config.mode);
        if latency > most {
            self.latch(Fault::Late { node: self.node(), periods, latency, most });
        }
    }

    /// Latches that no SYNC was sent for so long that the drive braked by itself. A controlword that enables the drive
    /// would make it follow an old target, so the drive gets a quick stop instead.
    pub(super) fn left_alone(&mut self, waited: Duration) {
        let node = self.config.node.raw();
        self.latch(Fault::HostLate { node, waited });
    }

    pub(super) fn refuse(&mut self, refusal: Refusal) {
        self.latch(Fault::Refused { node: self.config.node.raw(), refusal });
    }

    /// Takes the command of this cycle. `setpoint` is the result of [`check`](Self::check). `hold` keeps the target of
    /// the last cycle, because another axis refused its own. `watched` says that the drives have been sent a heartbeat,
    /// whose absence they would notice.
    pub(super) fn command(
        &mut self,
        command: AxisCommand,
        setpoint: Option<Target>,
        hold: bool,
        watched: bool,
        now: Instant,
    ) -> Frame {
        let goal = self.goal_of(command);
        self.recovery_tried &= goal == self.goal;
        if command == AxisCommand::ResetFault && !self.state.recovering {
            self.demand_recovery(goal != self.goal, now);
            self.reset();
        }
        if goal != self.goal {
            self.goal = goal;
            self.answers = 0;
            self.unsettled_since = None;
        }
        let powered = self.state.power == Power::On && goal == Goal::On;
        self.search.command(
            command == AxisCommand::Home,
            powered,
            self.modes.is(ModeOfOperation::Homing) && !self.telling,
            now,
        );
        self.aim(command, setpoint, hold, powered);
        self.judge_progress(now);

        let goal = match goal {
            Goal::Off | Goal::Stopped => power::Goal::Off,
            Goal::ResetFault => power::Goal::ResetFault,
            Goal::On => power::Goal::On,
        };
        let word = match self.statusword.power_state() {
            PowerState::OperationEnabled | PowerState::QuickStopActive if self.goal == Goal::Stopped => {
                Controlword::QUICK_STOP
            }
            // The drive would not miss us before it has heard us.
            PowerState::SwitchedOn if self.goal == Goal::On && !watched => Controlword::SWITCH_ON,
            // A search adds its bits only while the drive is enabled: the search ends with the power.
            _ => self.search.controlword(self.power.step(self.statusword, goal)),
        };
        process_data::encode(self.config.node, self.config.mode, word, self.target)
    }

    /// Whether the last frame of [`command`](Self::command) leads the drive to torque, or keeps its torque.
    pub(super) fn is_for_torque(&self) -> bool {
        self.goal == Goal::On
    }

    /// Whether the drive stands at its last target without a further one: the drive is enabled in a position mode.
    pub(super) fn holds_position(&self) -> bool {
        let enabled = self.statusword.power_state() == PowerState::OperationEnabled;
        enabled && !self.rests_at_zero() && !self.telling && self.modes.is(self.config.mode.of_operation())
    }

    /// Notes whether the port took the frame from [`command`](Self::command) and the SYNC before it.
    pub(super) fn handed_over(&mut self, taken: bool) {
        self.not_sent = if taken { 0 } else { self.not_sent.saturating_add(1) };
    }

    fn goal_of(&self, command: AxisCommand) -> Goal {
        match command {
            AxisCommand::Off => Goal::Off,
            AxisCommand::ResetFault => Goal::ResetFault,
            AxisCommand::Stand | AxisCommand::Home | AxisCommand::Follow(_) | AxisCommand::Seek(_) => {
                if self.state.fault.is_some() { Goal::Stopped } else { Goal::On }
            }
        }
    }

    /// Chooses the target. As long as the drive does not act on the target, the target follows the measured position,
    /// so enabling moves nothing. Once the drive acts on the target, only set-points change it.
    fn aim(&mut self, command: AxisCommand, setpoint: Option<Target>, hold: bool, powered: bool) {
        let holding = powered && self.modes.is(self.config.mode.of_operation());
        if !(holding && self.held) {
            self.target = self.resting_target().into();
        }
        // A feed-forward torque applies for one cycle only.
        self.target.torque = Permille(0);
        self.held = holding;
        if !holding || hold {
            return;
        }
        match (command, setpoint) {
            (AxisCommand::Follow(_), Some(setpoint)) if self.following() => self.target = setpoint,
            _ if self.rests_at_zero() => self.target = Target::default(),
            _ => {}
        }
    }

    fn resting_target(&self) -> i32 {
        if self.rests_at_zero() { 0 } else { self.measurement.reported.0 }
    }

    /// Whether the axis stands by a velocity or torque of zero instead of a held position.
    fn rests_at_zero(&self) -> bool {
        match self.config.mode {
            CyclicMode::Csp | CyclicMode::CspWithTorque => false,
            CyclicMode::Csv | CyclicMode::Cst => true,
        }
    }

    fn wanted_mode(&self) -> ModeOfOperation {
        if self.search.needs_homing_mode() { ModeOfOperation::Homing } else { self.config.mode.of_operation() }
    }

    fn judge_progress(&mut self, now: Instant) {
        let torque = matches!(
            self.statusword.power_state(),
            PowerState::OperationEnabled | PowerState::QuickStopActive | PowerState::FaultReactionActive
        );
        let settled = match self.goal {
            Goal::Off | Goal::ResetFault => !torque,
            // The fault of the stop is latched already, and stays the first.
            Goal::Stopped => true,
            Goal::On => self.state.power == Power::On && !self.search.halting() && self.modes.is(self.wanted_mode()),
        };
        if settled {
            self.unsettled_since = None;
            return;
        }
        let waited = now.since(*self.unsettled_since.get_or_insert(now));
        if waited > self.group.transition_timeout {
            let (node, statusword) = (self.config.node.raw(), self.statusword.0);
            self.latch(Fault::Stuck { node, statusword, waited });
        }
    }

    /// Latches a fault. The first fault stays until reset, because later ones are mostly its consequences.
    pub(super) fn latch(&mut self, fault: Fault) {
        self.state.fault.get_or_insert(fault);
    }
}
