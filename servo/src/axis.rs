//! One axis as its servo knows it: what its drive says, and what was commanded when.

use can::Instant;
use drive::{AxisCommand, AxisState, Finite, Homing, Power, Setpoint};

use crate::excitation::Playing;
use crate::host_loop::Loop;
use crate::search::Search;
use crate::{
    HomingFailure, Knot, PositionLoop, ServoAxisConfig, State, StopCause, TrackingError, limit,
};

/// Commands remembered per axis; a sample older than that is compared with the oldest.
pub(crate) const REMEMBERED: usize = 16;

/// Share of its greatest velocity below which a motor counts as still.
const STILL: f64 = 0.01;

/// An axis.
pub(crate) struct Axis {
    pub(crate) config: ServoAxisConfig,
    /// [`DriveGroup::delay`](drive::DriveGroup::delay) of its group.
    delay: usize,
    /// What the drive says.
    pub(crate) state: AxisState,
    /// The set-point of this cycle.
    pub(crate) knot: Knot,
    /// What holds the weight on it there, N·m.
    pub(crate) torque: f64,
    /// Positions commanded, the newest first.
    commanded: [f64; REMEMBERED],
    /// Cycles in a row in which the drive was told to follow.
    followed: usize,
    /// It searched for its reference in this homing.
    pub(crate) searched: bool,
    pub(crate) command: AxisCommand,
    pub(crate) tracking: TrackingError,
    /// The command that the sample of this cycle answers, rad, if the sample is new and its error counts.
    pub(crate) expected: Option<f64>,
    /// What measures it, if anything does, and what that adds in this cycle.
    pub(crate) playing: Option<Playing>,
    pub(crate) excitation: f64,
    reference: ReferenceWatch,
    /// The position loop, if it is closed here.
    host: Option<Loop>,
    /// The search of this homing, if it is made here.
    search: Option<Search>,
}

impl Axis {
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
            host: match config.position_loop {
                PositionLoop::Drive => None,
                PositionLoop::Host(host) => {
                    Some(Loop::new(host, config.increments_per_radian, delay))
                }
            },
            search: None,
        }
    }

    /// Takes what the drive says, `periods` of `dt` seconds after the last cycle.
    pub(crate) fn observe(&mut self, state: AxisState, periods: u32, dt: f64) {
        let seeking = matches!(self.command, AxisCommand::Seek(_));
        // The pulse may come in the very cycle in which a stop ends the search.
        let led = self.search.is_some() && self.followed > 0;
        let attained =
            led && self.state.homing != Homing::Attained && state.homing == Homing::Attained;
        let step =
            self.reference
                .observe(&state, seeking, attained, self.config.max_acceleration, dt);
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
    }

    /// Counts the tracking error of a new sample, rad, while the effector is in `state`.
    pub(crate) fn track(&mut self, error: f64, state: State) {
        if self.state.age > 0 {
            return;
        }
        if state == State::Moving {
            self.tracking.record(error);
        }
        let counts = matches!(state, State::Standing | State::Moving) && self.is_homed();
        self.expected = counts.then_some(self.state.position + error);
    }

    /// The counter was set while the axis followed: every position so far is `step`, rad, further.
    fn shift(&mut self, step: f64) {
        self.knot.position += step;
        self.commanded.iter_mut().for_each(|at| *at += step);
        if let Some(host) = &mut self.host {
            host.shift(step);
        }
    }

    /// A search for the reference begins.
    pub(crate) fn begin_homing(&mut self) {
        self.searched = false;
        self.reference = ReferenceWatch::default();
        let homing = self.config.homing.filter(|_| !self.is_homed());
        self.search = homing.map(|homing| Search::new(homing, self.config.increments_per_radian));
    }

    /// Whether it is homed here, and it is its turn: `order` is what homes now.
    pub(crate) fn is_searching(&self, order: Option<u8>) -> bool {
        let under_way = self.search.is_some_and(|search| !search.is_done());
        under_way && order == Some(self.config.homing_order)
    }

    /// Whether its drive is to home it now.
    pub(crate) fn homes_itself(&self, order: Option<u8>) -> bool {
        self.config.homing.is_none() && !self.is_homed() && order == Some(self.config.homing_order)
    }

    /// Whether it has no reference yet, or still moves from having found it.
    pub(crate) fn needs_homing(&self) -> bool {
        !self.is_homed() || self.search.is_some_and(|search| !search.is_done())
    }

    /// Moves the search one period on.
    pub(crate) fn advance_search(&mut self, now: Instant, dt: f64) -> Result<(), HomingFailure> {
        let follows = self.follows();
        let Some(mut search) = self.search else {
            return Ok(());
        };
        let reversed = search.is_reversed();
        let result = search.advance(&mut self.knot, &self.state, follows, now, dt);
        if result.is_err() {
            search.brake(&mut self.knot, dt);
        }
        if search.is_reversed() && !reversed {
            // It goes back from where it is, not from where it was to be.
            self.capture();
        }
        self.searched |= search.is_seeking();
        self.search = Some(search);
        result
    }

    /// Brakes a search that was stopped in the middle. A lost axis keeps its last set-point.
    pub(crate) fn brake_search(&mut self, dt: f64) {
        let lost = self.is_lost();
        if let Some(search) = self.search.as_mut().filter(|_| !lost) {
            search.brake(&mut self.knot, dt);
        }
    }

    /// What the counter showed at the reference before it was set there; `None` without a search.
    pub(crate) fn homing_offset(&self) -> Option<i64> {
        self.searched.then_some(self.reference.offset)
    }

    /// Whether the drive, by a sample taken under a set-point of ours, follows set-points.
    pub(crate) fn follows(&self) -> bool {
        self.is_watched() && self.state.following && self.state.power == Power::On
    }

    /// Takes the measured position as the commanded one, so that following begins without a jump.
    pub(crate) fn capture(&mut self) {
        self.knot = Knot {
            position: self.state.position,
            velocity: 0.0,
        };
        self.commanded = [self.state.position; REMEMBERED];
        if let Some(host) = &mut self.host {
            host.capture(self.state.position);
        }
    }

    /// Whether its drive has a fault and is not heard any more.
    pub(crate) fn is_lost(&self) -> bool {
        self.state.fault.is_some() && self.state.age > 0
    }

    /// Takes the motor for standing at the last set-point; or, if its loop is closed here, for what it
    /// was last seen to do, since torque does not stop at a set-point, nor in
    /// deadlines `missed`. Where a lost axis is, its last velocity does not tell: it keeps its last set-point.
    pub(crate) fn rest(&mut self, missed: u32, dt: f64) {
        let lost = self.is_lost();
        let Some(host) = self.host.as_mut().filter(|_| !lost) else {
            self.knot.velocity = 0.0;
            self.commanded[1] = self.commanded[0];
            return;
        };
        let velocity = host.measured_velocity();
        // The sample shows the command of `delay` cycles ago, and the newest is one old.
        let shown = self.delay - 1 + self.state.age as usize + missed as usize;
        self.commanded = std::array::from_fn(|age| {
            self.state.position + velocity * dt * (shown as f64 - age as f64)
        });
        self.knot = Knot {
            position: self.commanded[0],
            velocity,
        };
        host.follow(self.commanded, velocity);
    }

    /// Whether its position loop is closed here.
    pub(crate) fn is_host_closed(&self) -> bool {
        self.host.is_some()
    }

    /// Whether its motor is the servo's to move or to hold, whatever the effector does.
    pub(crate) fn is_led(&self) -> bool {
        self.host.is_some() && self.state.power == Power::On
    }

    /// Measured velocity and limit, rad/s, if the motor is faster than a loop closed here allows.
    pub(crate) fn runaway(&self) -> Option<(f64, f64)> {
        self.host.as_ref().and_then(Loop::runaway)
    }

    /// The last position sent and the step to it.
    pub(crate) fn last_step(&self, dt: f64) -> Knot {
        let [last, before_last, ..] = self.commanded;
        Knot {
            position: last,
            velocity: (last - before_last) / dt,
        }
    }

    /// Whether `position` may be commanded next.
    pub(crate) fn vet(&self, position: f64, dt: f64) -> Result<(), StopCause> {
        let [last, before_last, ..] = self.commanded;
        limit::check(&self.config.limits(), before_last, last, position, dt)
    }

    /// Whether a sample taken under a set-point of ours is there. A drive that then does not follow
    /// is none the less watched: the growing error is how it shows.
    pub(crate) fn is_watched(&self) -> bool {
        self.followed >= self.delay
    }

    /// Commanded minus measured, rad, for the command that the sample shows the effect of.
    pub(crate) fn error(&self) -> f64 {
        if let Some(host) = &self.host {
            return host.error(&self.state);
        }
        // This cycle's command is not in `commanded` yet, so the newest there is one period old.
        let age = (self.delay - 1)
            .saturating_add(self.state.age as usize)
            .min(REMEMBERED - 1);
        self.commanded[age] - self.state.position
    }

    /// The limit switch, upper or not, that is closed and stands in the way of motion in `sense`; of an axis
    /// with a reference. A search for it looks at the switches itself.
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
        self.state.velocity.abs() <= STILL * self.config.max_velocity
    }

    /// Keeps `command` for the write and remembers the set-point.
    pub(crate) fn command(&mut self, command: AxisCommand) {
        let follows = matches!(command, AxisCommand::Follow(_) | AxisCommand::Seek(_));
        self.followed = if follows {
            self.followed.saturating_add(1)
        } else {
            0
        };
        self.commanded.rotate_right(1);
        self.commanded[0] = self.knot.position;
        self.command = command;
    }

    /// Finds what measures it in this cycle, of macrostep `macrostep` if it is one.
    pub(crate) fn excite(&mut self, macrostep: Option<u64>) {
        if let Some(playing) = &mut self.playing {
            self.excitation = playing.value(macrostep);
        }
    }

    /// Turns the set-point into what its drive is to follow: the position itself, or what the loop
    /// closed here makes of it.
    pub(crate) fn regulate(&mut self, dt: f64) -> AxisCommand {
        if self.host.is_some() && self.followed == 0 {
            self.capture();
        }
        // Only a measured position taken over can be NaN; such an axis never settles, and the
        // time-out of what it settles for names it.
        let Some(position) = Finite::new(self.excited_position()) else {
            return AxisCommand::Off;
        };
        let setpoint = match &mut self.host {
            Some(host) => host.regulate(self.knot, self.torque, dt, &mut self.excitation),
            None => match self.torque_beside() {
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

    /// Takes on as much of the way to `torque`, N·m, as the loop closed here gives away in exchange: together they put
    /// out what they did, but for the dry friction that the loop forgets.
    pub(crate) fn hand_over(&mut self, torque: f64) {
        if let Some(host) = &mut self.host {
            self.torque += host.hand_over(torque - self.torque);
        }
    }

    fn excited_position(&self) -> f64 {
        let by_position = self.host.is_none() && self.config.torque_offset.is_none();
        if by_position && self.excitation != 0.0 {
            self.knot.position + self.excitation
        } else {
            self.knot.position
        }
    }

    /// The torque beside the position, if its drive takes one.
    fn torque_beside(&self) -> Option<Finite> {
        self.config.torque_offset?;
        Finite::new(self.excitation)
    }

    /// A cycle in which the set-point stands still: a loop closed here goes on.
    pub(crate) fn hold(&mut self, dt: f64) {
        let follows = matches!(self.command, AxisCommand::Follow(_) | AxisCommand::Seek(_));
        if self.host.is_some() && follows {
            self.command = self.regulate(dt);
        }
    }
}

/// Sees a drive set its counter at the reference: the greatest step during a search that no motor can make.
#[derive(Clone, Copy, Debug, Default)]
struct ReferenceWatch {
    /// The last sample: rad, increments.
    last: Option<(f64, i64)>,
    /// The way to it in one period, and the periods of it.
    way: Option<(f64, f64)>,
    periods: f64,
    /// The way in one period to the sample before.
    earlier: Option<(f64, f64)>,
    /// Cycles since that brought no sample.
    gap: u32,
    searching: bool,
    /// The step, increments. Samples that came early or late make steps too, but smaller ones.
    offset: i64,
}

impl ReferenceWatch {
    /// A step is the counter's own if the motor would need this many times its greatest acceleration.
    const IMPOSSIBLE: f64 = 4.0;

    /// Steps up to this are a counter's resolution, counts.
    const COARSE: f64 = 2.0;

    /// Takes a sample; the step of the counter in it, rad, if it was set in between. It was if a motor
    /// cannot have made the step, or if the drive now first says that it `attained` the reference.
    fn observe(
        &mut self,
        state: &AxisState,
        seeking: bool,
        attained: bool,
        max_acceleration: f64,
        dt: f64,
    ) -> Option<f64> {
        // The sample that tells of success may be the first one after the step.
        let searching = seeking || state.homing == Homing::InProgress;
        let searched = std::mem::replace(&mut self.searching, searching) || searching;
        if state.age > 0 {
            self.gap = self.gap.saturating_add(1);
            return None;
        }
        let periods = f64::from(std::mem::take(&mut self.gap)) + 1.0;
        let sample = (state.position, i64::from(state.increments.0));
        let last = self.last.replace(sample)?;
        let moved = (sample.0 - last.0, (sample.1 - last.1) as f64);
        let last_periods = std::mem::replace(&mut self.periods, periods);
        let way = self.way.replace((moved.0 / periods, moved.1 / periods))?;
        let earlier = self.earlier.replace(way);
        let mut step = moved.0 - way.0 * periods;
        let possible = Self::IMPOSSIBLE * max_acceleration * (periods * dt).powi(2);
        // A coarse counter makes steps of a count or two of its own, whatever the motor does.
        let seen = (moved.1 - way.1 * periods).abs() > Self::COARSE;
        let impossible = searched && seen && step.abs() > possible;
        if !attained && !impossible {
            return None;
        }
        let mut counts = way.1 * periods - moved.1;
        if attained
            && !impossible
            && let Some(earlier) = earlier
        {
            // The drive may say so one sample late: a step too small to be seen is then in the way before.
            step += (way.0 - earlier.0) * (last_periods + periods);
            counts -= (way.1 - earlier.1) * (last_periods + periods);
        }
        let counts = counts.round() as i64;
        if counts.abs() > self.offset.abs() {
            self.offset = counts;
        }
        if impossible {
            // The way to this sample is of two counts.
            (self.way, self.earlier) = (None, None);
        }
        Some(step)
    }
}

#[cfg(test)]
mod tests {
    use drive::Increments;

    use super::*;

    const COUNTS: f64 = 4000.0 / std::f64::consts::TAU;

    /// What the watch makes of samples of homing state and counts, a period of 2 ms apart.
    fn offset(samples: &[(Homing, i32)]) -> i64 {
        let mut watch = ReferenceWatch::default();
        for &(homing, counts) in samples {
            let state = AxisState {
                position: f64::from(counts) / COUNTS,
                increments: Increments(counts),
                homing,
                ..AxisState::default()
            };
            watch.observe(&state, false, false, 1500.0, 0.002);
        }
        watch.offset
    }

    #[test]
    fn a_small_step_is_taken_as_it_is_whether_the_word_comes_with_it_or_after() {
        use Homing::{Attained, InProgress};
        for jump in [-14, 9, 14, 500] {
            for late in [false, true] {
                let mut watch = ReferenceWatch::default();
                let (mut led, mut was) = (0.0, InProgress);
                for number in 0..8 {
                    let counts = 4 * number + if number >= 4 { jump } else { 0 };
                    let homing = match number {
                        5.. => Attained,
                        4 if !late => Attained,
                        _ => InProgress,
                    };
                    let state = AxisState {
                        position: f64::from(counts) / COUNTS,
                        increments: Increments(counts),
                        homing,
                        ..AxisState::default()
                    };
                    let attained = std::mem::replace(&mut was, homing) != homing;
                    led += watch
                        .observe(&state, true, attained, 1500.0, 0.002)
                        .unwrap_or(0.0);
                }
                let led = led * COUNTS;
                assert!((led - f64::from(jump)).abs() < 0.5, "{jump}, {late}: {led}");
            }
        }
    }

    #[test]
    fn the_step_to_the_reference_is_the_offset_and_jitter_is_not() {
        use Homing::{Attained, InProgress};
        let search = [(InProgress, -100), (InProgress, -96), (InProgress, -92)];
        let home = [(Attained, 4), (Attained, 4), (Attained, 4)];
        assert_eq!(offset(&[&search[..], &home].concat()), -92);
        // Two periods' way in one: the sample was taken late.
        let late = [(InProgress, -140), (InProgress, -120), (InProgress, -80)];
        assert_eq!(offset(&[&late[..], &search, &home].concat()), -92);
        let fast = [(Attained, 100), (Attained, 200), (Attained, 400)];
        assert_eq!(offset(&[&search[..], &home, &fast].concat()), -92);
    }
}
