//! One axis of an effector: state of its drive and history of its commands.

use can::Instant;
use drive::{AxisCommand, AxisState, Finite, Homing, Increments, Power, Setpoint};

use crate::config::FrozenWatch;
use crate::excitation::Playing;
use crate::host_loop::Loop;
use crate::oscillation::{Bounds, Finding, Oscillation, OscillationWatch};
use crate::progress::Progress;
use crate::reference_watch::ReferenceWatch;
use crate::search::Search;
use crate::{HomingFailure, Knot, PositionLoop, ServoAxisConfig, ServoState, StopCause, TrackingError, limit};

/// Commands remembered per axis. A sample older than that is compared with the oldest command.
pub(crate) const REMEMBERED: usize = 16;
/// Fraction of the greatest velocity below which a motor counts as still.
const STILL: f64 = 0.01;

/// Greatest number of missed cycles for which a motor is taken to have gone on at its measured velocity. The clock of a
/// host that was suspended shows more.
const MOST_EXTRAPOLATED: u32 = 100;

/// Greatest distance of a motor from its last rest at which its load counts as unchanged: the range of positions,
/// divided by this number.
const SAME_LOAD: f64 = 8.0;

/// Shortest distance of set-points, increments, during which the measured position must change.
const FROZEN: f64 = 16.0;

/// The measured position at its last change, and the following error then, rad.
#[derive(Clone, Copy, Default)]
struct Change {
    increments: Option<Increments>,
    error: f64,
}

pub(crate) struct ServoAxis {
    pub(crate) config: ServoAxisConfig,
    /// [`DriveGroup::delay`](drive::DriveGroup::delay) of its group.
    delay: usize,
    pub(crate) state: AxisState,
    /// The set-point of this cycle.
    pub(crate) knot: Knot,
    /// Feed-forward torque at this set-point, which holds the weight on the axis, N·m.
    pub(crate) torque: f64,
    /// Commanded positions, the newest first.
    commanded: [f64; REMEMBERED],
    /// Cycles in a row in which the drive was commanded to follow.
    followed: usize,
    /// The axis searched for its reference during this homing.
    pub(crate) searched: bool,
    pub(crate) command: AxisCommand,
    pub(crate) tracking: TrackingError,
    /// The command that the sample of this cycle answers, rad, if the sample is new and its error counts.
    pub(crate) expected: Option<f64>,
    /// The excitation under way, if any, and the value that it adds in this cycle.
    pub(crate) playing: Option<Playing>,
    pub(crate) excitation: f64,
    reference: ReferenceWatch,
    /// The last change of the measured position.
    change: Change,
    progress: Progress,
    oscillation: OscillationWatch,
    /// The greatest oscillation of the run, and the number of the cycle that found the first one.
    pub(crate) oscillates: Option<(Oscillation, u64)>,
    /// The axis is off while the others brake, because its measured position does not change.
    pub(crate) cut: bool,
    /// The counter may have lost counts, and the drive was not told yet.
    pub(crate) doubted: bool,
    host: Option<Loop>,
    /// Position of the motor in the last cycle with power, rad, if the motor was at a standstill. Otherwise the
    /// position at the first standstill without power.
    parked: Option<f64>,
    /// Whether the motor may have been moved since the power was switched off.
    displaced: bool,
    /// The search of this homing, if the servo homes the axis.
    search: Option<Search>,
}

impl ServoAxis {
    pub(crate) fn new(config: ServoAxisConfig, delay: usize) -> Self {
        Self {
            config,
            delay,
            state: AxisState::default(),
            knot: Knot::default(),
            torque: 0.0,
            commanded: [0.0; REMEMBERED],
            followed: 0,
            searched: false,
            command: AxisCommand::Off,
            tracking: TrackingError::default(),
            expected: None,
            playing: None,
            excitation: 0.0,
            reference: ReferenceWatch::default(),
            change: Change::default(),
            progress: Progress::default(),
            oscillation: OscillationWatch::default(),
            oscillates: None,
            cut: false,
            doubted: false,
            host: match config.position_loop {
                PositionLoop::Drive => None,
                PositionLoop::Host(host) => Some(Loop::new(host, config.increments_per_radian, delay)),
            },
            parked: None,
            displaced: false,
            search: None,
        }
    }

    /// Takes the state of the drive, `periods` of `dt` seconds after the last cycle.
    pub(crate) fn observe(&mut self, state: AxisState, periods: u32, dt: f64) {
        let seeking = matches!(self.command, AxisCommand::Seek(_));
        // The index pulse may come in the cycle in which a stop ends the search.
        let led = self.search.is_some() && self.followed > 0;
        let attained = led && self.state.homing != Homing::Attained && state.homing == Homing::Attained;
        let step = self.reference.observe(&state, seeking, attained, self.config.max_acceleration, dt);
        self.progress.observe(&state, f64::from(periods) * dt);
        // The motor of an axis without power is not braked by a loop, and its counter may be set. The new count may
        // also come after the end of a search by the drive, before the drive follows set-points.
        let set = step.is_some() && state.increments != self.state.increments;
        let braked = state.power == Power::On && (state.following || state.homing == Homing::InProgress);
        if set || !braked {
            self.forget_course();
        }
        if let Some(step) = step
            && led
        {
            self.shift(step);
        }
        if let Some(host) = &mut self.host {
            host.observe(&state, periods, dt);
        }
        self.state = state;
        self.expected = None;
        self.park(set);
    }

    /// Notes whether the motor is moved while it has no power. `set`: the counter was set.
    fn park(&mut self, set: bool) {
        let position = self.state.position;
        if self.state.power == Power::On {
            (self.parked, self.displaced) = (self.is_still().then_some(position), false);
            return;
        }
        // Without a reference, the position is not comparable with earlier positions.
        let moved = self.parked.is_some_and(|parked| (position - parked).abs() > self.config.following_error);
        self.displaced |= moved || set || !self.is_homed();
        if self.parked.is_none() && self.is_still() {
            self.parked = Some(position);
        }
    }

    /// Whether the output that held the load of the motor at its last rest also holds the load at the present position.
    /// The function is called while the motor has no power.
    pub(crate) fn has_the_load_of_its_rest(&self) -> bool {
        !self.displaced && !self.is_far_from_rest()
    }

    fn is_far_from_rest(&self) -> bool {
        let reach = (self.config.max_position - self.config.min_position) / SAME_LOAD;
        // A position that is not a number is far.
        let near = |host: &Loop| host.distance_from_rest(self.state.position) <= reach;
        !self.host.as_ref().is_none_or(near)
    }

    /// Discards the output that held the load of the motor at its last rest.
    pub(crate) fn forget_load(&mut self) {
        self.host.iter_mut().for_each(Loop::forget);
    }

    /// Takes the following error of cycle `number`, rad. Returns an oscillation that grows, if the servo closes the loop.
    /// Another oscillation is noted. `elapsed` is the time since the last cycle, s.
    pub(crate) fn watch_oscillation(&mut self, error: f64, number: u64, elapsed: f64) -> Option<Oscillation> {
        let ServoAxisConfig { increments_per_radian, max_acceleration, following_error, .. } = self.config;
        let still_below = self.still_below();
        let bounds = Bounds { increments_per_radian, still_below, max_acceleration, following_error };
        if self.excitation != 0.0 || !self.is_homed() {
            self.oscillation.forget();
            return None;
        }
        self.oscillation.command(self.knot.velocity, elapsed, &bounds);
        if self.state.age > 0 {
            return None;
        }
        let found = self.oscillation.observe(error, &bounds)?;
        let (Finding::Lasting(it) | Finding::Growing(it)) = found;
        let (worst, _) = self.oscillates.get_or_insert((it, number));
        if it.velocity() > worst.velocity() {
            *worst = it;
        }
        matches!(found, Finding::Growing(_)).then_some(it).filter(|_| self.is_host_closed())
    }

    /// The oscillation of the last swings, if they grow. The loop then is unstable, and the motor may be faster than
    /// permitted before its amplitude counts as grown.
    pub(crate) fn swings_up(&self) -> Option<Oscillation> {
        self.oscillation.swings_up(self.config.increments_per_radian).filter(|_| self.is_host_closed())
    }

    /// The cause of a stop by the following error `error`, rad.
    pub(crate) fn not_following(&self, error: f64) -> StopCause {
        let limit = self.config.following_error;
        let swings = self.swings_up().map(StopCause::Oscillates);
        swings.or(self.blocked(error)).unwrap_or(StopCause::FollowingError { error, limit })
    }

    /// The cause of a stop if the motor lacks `behind`, rad, and pushes there with its torque at the limit. A motor
    /// that moves away from its set-point is not blocked: its phases or its encoder may be reversed.
    fn blocked(&self, behind: f64) -> Option<StopCause> {
        let (torque, limit) = self.state.torque_at_limit()?;
        let leaves = self.state.velocity * behind.signum() < -self.still_below();
        let pushes = torque * behind > 0.0 && !leaves;
        pushes.then_some(StopCause::Blocked { torque, limit, behind, stands: false })
    }

    /// The cause of a stop if the measured position stands still for `travel`, rad, with the following error `error`,
    /// rad.
    fn stands(&self, travel: f64, error: f64) -> StopCause {
        // A motor at rest does not push, unless its counter has jumped.
        match self.blocked(error).filter(|_| self.knot.velocity != 0.0) {
            Some(StopCause::Blocked { torque, limit, .. }) => {
                StopCause::Blocked { torque, limit, behind: travel, stands: true }
            }
            _ => StopCause::Frozen { travel },
        }
    }

    /// Counts the tracking error of a new sample, rad, while the effector is in `state`.
    pub(crate) fn track(&mut self, error: f64, state: ServoState) {
        if self.state.age > 0 {
            return;
        }
        if state == ServoState::Moving {
            self.tracking.record(error);
        }
        let counts = matches!(state, ServoState::Standing | ServoState::Moving) && self.is_homed();
        self.expected = counts.then_some(self.state.position + error);
    }

    /// Moves all remembered positions by `step`, rad, because the counter was set while the axis followed.
    fn shift(&mut self, step: f64) {
        self.knot.position += step;
        self.commanded.iter_mut().for_each(|at| *at += step);
        if let Some(host) = &mut self.host {
            host.shift(step);
        }
    }

    pub(crate) fn begin_homing(&mut self) {
        self.searched = false;
        self.reference = ReferenceWatch::default();
        let homing = self.config.homing.filter(|_| !self.is_homed());
        self.search = homing.map(|homing| Search::new(homing, self.config.increments_per_radian));
    }

    /// Whether the servo is searching for the reference of this axis. `order` is the homing order whose turn it is.
    pub(crate) fn is_searching(&self, order: Option<u8>) -> bool {
        let under_way = self.search.is_some_and(|search| !search.is_done());
        under_way && order == Some(self.config.homing_order)
    }

    /// Whether the drive has to home the axis now.
    pub(crate) fn homes_itself(&self, order: Option<u8>) -> bool {
        self.config.homing.is_none() && !self.is_homed() && order == Some(self.config.homing_order)
    }

    /// Whether the axis has no reference, or its search has not ended yet.
    pub(crate) fn needs_homing(&self) -> bool {
        !self.is_homed() || self.search.is_some_and(|search| !search.is_done())
    }

    pub(crate) fn advance_search(&mut self, now: Instant, dt: f64) -> Result<(), HomingFailure> {
        let follows = self.follows();
        let Some(mut search) = self.search else {
            return Ok(());
        };
        let reversed = search.reversed;
        let result = search.advance(&mut self.knot, &self.state, follows, now, dt);
        if result.is_err() {
            search.brake(&mut self.knot, dt);
        }
        if search.reversed && !reversed {
            // The reversed search starts from the measured position instead of the commanded one.
            self.capture();
        }
        self.searched |= search.is_seeking();
        self.search = Some(search);
        result
    }

    /// Brakes an interrupted search. A lost axis keeps its last set-point.
    pub(crate) fn brake_search(&mut self, dt: f64) {
        let lost = self.is_lost();
        if let Some(search) = self.search.as_mut().filter(|_| !lost) {
            search.brake(&mut self.knot, dt);
        }
    }

    /// Count at the reference before the counter was set there; `None` without a search.
    pub(crate) fn homing_offset(&self) -> Option<i64> {
        self.searched.then_some(self.reference.offset)
    }

    /// Whether the drive follows set-points, as shown by a sample taken under a set-point.
    pub(crate) fn follows(&self) -> bool {
        self.is_watched() && self.state.following && self.state.power == Power::On
    }

    /// Takes the measured position as the commanded one. Following then starts without a jump.
    pub(crate) fn capture(&mut self) {
        self.knot = Knot::at_rest(self.state.position);
        self.commanded = [self.state.position; REMEMBERED];
        // The following error changes in one step here, without a motion of the set-points.
        self.change = Change::default();
        if self.is_far_from_rest() {
            self.forget_load();
        }
        if let Some(host) = &mut self.host {
            host.capture(self.state.position, self.torque);
        }
    }

    /// Whether the drive has a fault and does not answer.
    pub(crate) fn is_lost(&self) -> bool {
        self.state.fault.is_some() && self.state.age > 0
    }

    /// Estimates the motion of the motor after missed or refused cycles, and adapts the remembered commands to it.
    ///
    /// A drive that closes the position loop stands at its last set-point. A motor whose loop the servo closes
    /// continues at its last measured velocity, also during the `missed` deadlines, because a torque set-point does
    /// not stop the motor. A lost axis keeps its last set-point, because its last velocity does not give its
    /// position.
    pub(crate) fn rest(&mut self, missed: u32, dt: f64) {
        let lost = self.is_lost();
        let Some(host) = self.host.as_mut().filter(|_| !lost) else {
            self.knot.velocity = 0.0;
            self.commanded[1] = self.commanded[0];
            return;
        };
        let velocity = host.measured_velocity;
        // The sample shows the command of `delay` cycles ago. The newest command is one cycle old.
        let missed = missed.min(MOST_EXTRAPOLATED);
        let shown = self.delay - 1 + (self.state.age + self.state.lag) as usize + missed as usize;
        self.commanded = std::array::from_fn(|age| self.state.position + velocity * dt * (shown as f64 - age as f64));
        self.knot = Knot::new(self.commanded[0], velocity);
        host.follow(self.commanded, velocity);
        // The following error changes in one step here, without a motion of the set-points.
        self.change = Change::default();
        self.oscillation.forget();
    }

    pub(crate) fn is_host_closed(&self) -> bool {
        self.host.is_some()
    }

    /// Whether the servo has to move or hold the motor in every state of the effector.
    pub(crate) fn is_led(&self) -> bool {
        self.host.is_some() && self.state.power == Power::On
    }

    /// Measured velocity and limit, rad/s, if the motor is faster than a loop closed by the servo allows.
    pub(crate) fn runaway(&self) -> Option<(f64, f64)> {
        self.host.as_ref().and_then(Loop::runaway)
    }

    /// The last position sent, and the velocity of the step to it.
    pub(crate) fn last_step(&self, dt: f64) -> Knot {
        let [last, before_last, ..] = self.commanded;
        Knot::new(last, (last - before_last) / dt)
    }

    /// Checks whether `position` may be commanded next.
    pub(crate) fn vet(&self, position: f64, dt: f64) -> Result<(), StopCause> {
        let [last, before_last, ..] = self.commanded;
        limit::check(&self.config, before_last, last, position, dt)
    }

    /// Whether a sample taken under a set-point exists. The check does not require that the drive follows: a drive
    /// that does not follow is detected by its growing error.
    pub(crate) fn is_watched(&self) -> bool {
        self.followed >= self.delay + self.state.lag as usize
    }

    /// Following error, rad: commanded minus measured position, for the command whose effect the sample shows.
    pub(crate) fn error(&self) -> f64 {
        if let Some(host) = &self.host {
            return host.error(&self.state);
        }
        // `commanded` does not contain this cycle's command yet; its newest entry is one period old.
        let periods = self.state.age.saturating_add(self.state.lag) as usize;
        let age = (self.delay - 1).saturating_add(periods).min(REMEMBERED - 1);
        self.commanded[age] - self.state.position
    }

    /// The last set-points were repeated, because a bus refused some: the drive may have stopped the motor at once.
    pub(crate) fn was_refused(&mut self) {
        self.progress.forget();
        self.oscillation.forget();
    }

    /// Forgets the last samples of the position and of the following error: no loop braked the motor, or the counter
    /// was set.
    fn forget_course(&mut self) {
        self.change = Change::default();
        self.progress.forget();
        self.oscillation.forget();
    }

    /// The cause of a stop if the set-points or the motor must have moved so far since the measured position last
    /// changed that the encoder fails or the axis is blocked. `error` is the present following error.
    pub(crate) fn frozen(&mut self, error: f64) -> Option<StopCause> {
        let seen = Change { increments: Some(self.state.increments), error };
        if self.state.age > 0 || self.config.frozen == FrozenWatch::Off {
            return None;
        }
        if self.change.increments != seen.increments || !self.follows() {
            self.change = seen;
        }
        let travel = (error - self.change.error).abs();
        let limit = (0.5 * self.config.following_error).max(FROZEN / self.config.increments_per_radian.abs());
        let expected = travel * self.config.increments_per_radian.abs() >= 2.0 && self.follows();
        let stands = (travel > limit).then_some(travel).or_else(|| self.stands_at_once().filter(|_| expected));
        // No load explains a position that starts at once.
        let starts = || self.starts_at_once().map(|travel| StopCause::Frozen { travel });
        stands.map(|travel| self.stands(travel, error)).or_else(starts)
    }

    /// The same while the drive homes the axis, where the set-points are not known.
    pub(crate) fn frozen_in_homing(&self) -> Option<StopCause> {
        let searching = self.state.homing == Homing::InProgress && self.state.power == Power::On;
        let by_drive = self.config.homing.is_none();
        let watched = searching && by_drive && self.state.age == 0 && self.config.frozen == FrozenWatch::Always;
        let travel = self.stands_at_once().or(self.state.stalled).filter(|_| watched)?;
        Some(match self.state.torque_at_limit() {
            Some((torque, limit)) => StopCause::Blocked { torque, limit, behind: travel, stands: true },
            None => StopCause::Frozen { travel },
        })
    }

    fn starts_at_once(&self) -> Option<f64> {
        let ServoAxisConfig { increments_per_radian, max_velocity, max_acceleration, .. } = self.config;
        self.progress.started(increments_per_radian, max_velocity, max_acceleration).filter(|_| self.follows())
    }

    fn stands_at_once(&self) -> Option<f64> {
        let ServoAxisConfig { increments_per_radian, max_velocity, max_acceleration, .. } = self.config;
        self.progress.frozen(increments_per_radian, max_velocity, max_acceleration)
    }

    /// The closed limit switch that blocks motion in `sense`: true for the upper one. `None` for an axis without a
    /// reference, whose search evaluates the switches itself.
    pub(crate) fn limit_switch(&self, sense: f64) -> Option<bool> {
        let towards = sense * self.config.increments_per_radian;
        let switches = &self.state.switches;
        let upper = towards > 0.0 && switches.upper_limit;
        let lower = towards < 0.0 && switches.lower_limit;
        (self.is_homed() && (upper || lower)).then_some(upper)
    }

    pub(crate) fn is_homed(&self) -> bool {
        self.state.homing == Homing::Attained
    }

    pub(crate) fn is_still(&self) -> bool {
        self.state.velocity.abs() <= self.still_below()
    }

    /// Greatest speed of a motor that counts as still, rad/s.
    pub(crate) fn still_below(&self) -> f64 {
        STILL * self.config.max_velocity
    }

    /// Commanded positions, rad, the newest first, and the delay of the drive group.
    pub(crate) fn past(&self) -> (&[f64; REMEMBERED], u8) {
        (&self.commanded, self.delay as u8)
    }

    /// Stores `command` for the write and remembers the set-point.
    pub(crate) fn command(&mut self, command: AxisCommand) {
        let follows = matches!(command, AxisCommand::Follow(_) | AxisCommand::Seek(_));
        self.followed = if follows { self.followed.saturating_add(1) } else { 0 };
        self.commanded.rotate_right(1);
        self.commanded[0] = self.knot.position;
        self.command = command;
    }

    /// Takes the excitation of this cycle. `macrostep` is the macrostep under way, if any.
    pub(crate) fn excite(&mut self, macrostep: Option<u64>) {
        if let Some(playing) = &mut self.playing {
            self.excitation = playing.value(macrostep);
        }
    }

    /// Converts the set-point to the drive's command. The command holds the position itself, or the output of the loop
    /// that the servo closes.
    pub(crate) fn regulate(&mut self, dt: f64) -> AxisCommand {
        if self.host.is_some() && self.followed == 0 {
            self.capture();
        }
        // The position can only be NaN if a measured position was taken over. Such an axis never settles, and the
        // time-out of that wait names the axis.
        let Some(position) = Finite::new(self.excited_position()) else {
            return AxisCommand::Off;
        };
        let setpoint = match &mut self.host {
            Some(host) => host.regulate(self.knot, self.torque, dt, &mut self.excitation),
            None => match self.config.torque_offset.and_then(|_| Finite::new(self.excitation)) {
                Some(torque) => Setpoint::PositionWithTorque { position, torque },
                None => Setpoint::Position(position),
            },
        };
        if self.search.is_some_and(|search| search.is_seeking()) {
            AxisCommand::Seek(setpoint)
        } else {
            AxisCommand::Follow(setpoint)
        }
    }

    /// Bumpless transfer from the integral part of a loop closed by the servo to the feed-forward torque, towards
    /// `torque`, N·m. The total output stays the same, except for the dry friction that the loop drops.
    pub(crate) fn hand_over(&mut self, torque: f64) {
        if let Some(host) = &mut self.host {
            self.torque += host.hand_over(torque - self.torque);
        }
    }

    fn excited_position(&self) -> f64 {
        let by_position = self.host.is_none() && self.config.torque_offset.is_none();
        if by_position && self.excitation != 0.0 { self.knot.position + self.excitation } else { self.knot.position }
    }

    /// A cycle without a new set-point. A loop closed by the servo continues.
    pub(crate) fn hold(&mut self, dt: f64) {
        let follows = matches!(self.command, AxisCommand::Follow(_) | AxisCommand::Seek(_));
        if self.host.is_some() && follows {
            self.command = self.regulate(dt);
        }
    }
}
