//! The cycle of one effector: check its axes, take orders, find the next set-points, vet them.

mod homing;
mod motion;

use std::time::Duration;

use can::Instant;
use drive::{AxisCommand, AxisState, Power};

use crate::axis::Axis;
use crate::excitation::Playing;
use crate::interpolate::Segment;
use crate::servo::OpenGates;
use crate::{
    After, Answer, AxisRecord, Counters, EffectorConfig, EffectorLink, Event, Excitation,
    ExcitationError, Knot, MAX_AXES, Order, Record, Report, ServoAxisConfig, ServoFault, State,
    StopCause, StraightStop, TrackingError,
};

/// Longest time the drives get to come to rest after the last set-point of a stop, before power
/// is taken from them.
const STANDSTILL_WAIT: Duration = Duration::from_millis(100);

/// Cycles in a row that a bus may refuse the set-points of a stop; then the drives count as standing.
const REFUSED_IN_STOP: u32 = 3;

/// Commanded speed, rad/s, below which an axis is taken for at rest beside a limit switch: what generators round.
const CREEP: f64 = 1e-3;

/// What a servo's cycle tells each of its effectors.
#[derive(Clone, Copy)]
pub(crate) struct Tick {
    pub(crate) number: u64,
    pub(crate) now: Instant,
    /// The nominal period, s.
    pub(crate) dt: f64,
    /// Somebody asked for everything to stop.
    pub(crate) stop: bool,
    pub(crate) open: OpenGates,
    /// Deadlines missed in a row, if they are too many.
    pub(crate) overrun: Option<u32>,
    /// Periods since the last cycle: 1 and the deadlines missed.
    pub(crate) periods: u32,
    /// Cycles in a row, up to the last, whose batch a bus of this effector did not take: the set-points are due again.
    pub(crate) refused: u32,
}

/// One effector as its servo knows it.
pub(crate) struct Effector {
    index: u8,
    axes: Vec<Axis>,
    enabling_timeout: Duration,
    homing_timeout: Duration,
    orders: rtrb::Consumer<Order>,
    /// Orders at the front of the queue known to be neither stop nor disable.
    scanned: usize,
    reports: rtrb::Producer<Report>,
    state: State,
    /// When `state` was entered.
    since: Instant,
    fault: Option<ServoFault>,
    segment: Option<Segment>,
    stop: StraightStop,
    /// The present stop was restarted, because a bus took no set-point of the first one.
    stop_restarted: bool,
    /// While [`State::Halting`]: the drives have come to rest.
    halted: bool,
    /// Number of the last macrostep begun.
    macrostep: u64,
    /// Something happened in this cycle that the controller is to hear of.
    news: bool,
    /// The time the slowest axis needs to stop from its greatest velocity.
    stopping_time: Duration,
    counters: Counters,
}

impl Effector {
    pub(crate) fn new(
        index: u8,
        config: &EffectorConfig,
        delays: &[usize],
    ) -> (Self, EffectorLink) {
        let (order_sender, orders) = rtrb::RingBuffer::new(config.queue);
        // One report per macrostep, and the few changes of phase that one order can cause.
        let (reports, report_receiver) = rtrb::RingBuffer::new(config.queue + 16);
        let stops = config.axes.iter().map(ServoAxisConfig::stopping_time);
        let effector = Self {
            index,
            axes: config
                .axes
                .iter()
                .map(|axis| Axis::new(*axis, delays[axis.group]))
                .collect(),
            enabling_timeout: config.enabling_timeout,
            homing_timeout: config.homing_timeout,
            orders,
            scanned: 0,
            reports,
            state: State::Off,
            since: Instant::ZERO,
            fault: None,
            segment: None,
            stop: StraightStop::new(&[], &[], 1.0),
            stop_restarted: false,
            halted: false,
            macrostep: 0,
            news: false,
            stopping_time: Duration::try_from_secs_f64(stops.fold(0.0, f64::max))
                .unwrap_or(Duration::MAX),
            counters: Counters::default(),
        };
        (
            effector,
            EffectorLink {
                orders: order_sender,
                reports: report_receiver,
            },
        )
    }

    pub(crate) fn state(&self) -> State {
        self.state
    }

    pub(crate) fn fault(&self) -> Option<ServoFault> {
        self.fault
    }

    pub(crate) fn counters(&self) -> &Counters {
        &self.counters
    }

    /// The time the slowest stop takes, standstill wait included.
    pub(crate) fn longest_stop(&self) -> Duration {
        self.stopping_time.saturating_add(STANDSTILL_WAIT)
    }

    pub(crate) fn has_power(&self) -> bool {
        self.axes.iter().any(|axis| axis.state.power != Power::Off)
    }

    pub(crate) fn homing_offsets(&self) -> impl Iterator<Item = Option<i64>> {
        self.axes.iter().map(Axis::homing_offset)
    }

    pub(crate) fn tracking(&self) -> impl Iterator<Item = TrackingError> {
        self.axes.iter().map(|axis| axis.tracking)
    }

    /// Excites axis `axis`, if there is one.
    pub(crate) fn excite(
        &mut self,
        axis: usize,
        excitation: Excitation,
        dt: f64,
    ) -> Result<(), ExcitationError> {
        let effector = usize::from(self.index);
        let found = self.axes.get_mut(axis);
        let found = found.ok_or(ExcitationError::NoSuchAxis { effector, axis })?;
        excitation.check(&found.config, dt)?;
        found.playing = Some(Playing::new(excitation));
        Ok(())
    }

    /// Takes what the drives say, by group and index in it.
    pub(crate) fn set_states(&mut self, state: impl Fn(usize, usize) -> AxisState, tick: &Tick) {
        for axis in &mut self.axes {
            let state = state(axis.config.group, axis.config.index_in_group);
            axis.observe(state, tick.periods, tick.dt);
        }
    }

    /// The drive group of each axis.
    pub(crate) fn groups(&self) -> impl Iterator<Item = usize> {
        self.axes.iter().map(|axis| axis.config.group)
    }

    /// The command of each axis, with its group and the index in it.
    pub(crate) fn commands(&self) -> impl Iterator<Item = (usize, usize, AxisCommand)> {
        let command = |axis: &Axis| (axis.config.group, axis.config.index_in_group, axis.command);
        self.axes.iter().map(command)
    }

    /// One cycle: from the states of the axes to their commands.
    pub(crate) fn step(&mut self, tick: &Tick) {
        self.news = false;
        self.check(tick);
        self.take_stops(tick);
        self.take_orders(tick);
        if self.is_held(tick) {
            self.axes.iter_mut().for_each(|axis| axis.hold(tick.dt));
        } else {
            self.advance(tick);
            self.command(tick);
        }
        let due = self.state == State::Moving && self.segment.is_some_and(|s| s.is_at_report());
        if due || self.news {
            self.report(tick);
        }
    }

    /// Whether the set-points of the last cycle are due again, because a bus did not take them.
    fn is_held(&mut self, tick: &Tick) -> bool {
        if matches!(self.state, State::Braking(_)) && tick.refused > REFUSED_IN_STOP {
            // The drives hear no set-point, and stand by now. The stop is restarted once: a restart in every cycle would
            // never end while a motor is measured to move.
            if !self.stop_restarted {
                self.axes.iter_mut().for_each(|axis| axis.rest(0, tick.dt));
                self.begin_stop(tick);
                self.stop_restarted = true;
            }
            return false;
        }
        let follows = matches!(
            self.state,
            State::Standing | State::Moving | State::Braking(_)
        );
        tick.refused > 0 && follows
    }

    /// Faults of drives, following errors, limit switches, overruns; the tracking statistics.
    ///
    /// A closed limit switch stops an effector that goes on towards it, and one that it holds back from where it
    /// was told to be. It does neither to an axis that rests on it or leaves it: that is the way off.
    fn check(&mut self, tick: &Tick) {
        if let Some(missed) = tick.overrun {
            // The drives have stood at their last set-points meanwhile, or run on by them.
            let late = tick.periods - 1;
            let axes = self.axes.iter_mut();
            axes.for_each(|axis| axis.rest(late, tick.dt));
            self.fail(tick, None, StopCause::Overrun { missed });
        }
        for index in 0..self.axes.len() {
            let axis = &mut self.axes[index];
            if let Some(fault) = axis.state.fault {
                if self.state != State::Resetting {
                    self.fail(tick, index, StopCause::Drive(fault));
                }
                continue;
            }
            let (error, limit) = (axis.error(), axis.config.following_error);
            let commanding = matches!(
                self.state,
                State::Standing | State::Moving | State::Braking(_)
            );
            if !axis.is_watched() || !commanding && !axis.is_led() {
                continue;
            }
            if let Some((velocity, limit)) = axis.runaway() {
                self.lose(tick, index, StopCause::Runaway { velocity, limit });
                continue;
            }
            if tick.overrun.is_some() && axis.is_host_closed() {
                // Its commands are those of now, its sample is from before the deadlines missed.
                continue;
            }
            axis.track(error, self.state);
            let beyond = error.abs() > limit;
            // The command of the last cycle, or the one that the motor does not come up to.
            let sense = if beyond { error } else { axis.knot.velocity };
            let judged = commanding && (beyond || sense.abs() > CREEP);
            let switch = axis.limit_switch(sense).filter(|_| judged);
            if let Some(upper) = switch {
                // Its drive stops it there whatever it is told, and its loop works: the others are braked.
                self.fail(tick, index, StopCause::LimitSwitch { upper });
            } else if beyond || error.is_nan() {
                let host_closed = axis.is_host_closed();
                let cause = StopCause::FollowingError { error, limit };
                if host_closed {
                    self.lose(tick, index, cause);
                } else {
                    self.fail(tick, index, cause);
                }
            }
        }
    }

    /// Latches the first fault and leaves the present state for it.
    fn fail(&mut self, tick: &Tick, axis: impl Into<Option<usize>>, cause: StopCause) {
        self.latch(axis.into(), cause);
        self.apply(tick, Event::Fault);
    }

    /// The same for a loop that does not work, and so cannot brake: power goes at once.
    fn lose(&mut self, tick: &Tick, axis: usize, cause: StopCause) {
        self.latch(Some(axis), cause);
        self.apply(tick, Event::ControlLost);
    }

    fn latch(&mut self, axis: Option<usize>, cause: StopCause) {
        let axis = axis.map(|axis| axis as u8);
        self.fault.get_or_insert(ServoFault { axis, cause });
    }

    /// Finds stops anywhere in the queue and carries them out before all else: what was queued
    /// before them keeps its order, less the macrosteps.
    fn take_stops(&mut self, tick: &Tick) {
        if tick.stop {
            self.apply(tick, Event::Disable);
        }
        let waiting = self.orders.slots();
        let Ok(chunk) = self.orders.read_chunk(waiting) else {
            return;
        };
        let (front, back) = chunk.as_slices();
        let unseen = front.iter().chain(back).enumerate().skip(self.scanned);
        let stops = unseen.filter(|(_, order)| matches!(order, Order::Stop | Order::Disable));
        let last_stop = stops.map(|(index, _)| index).last();
        self.scanned = waiting;
        for _ in 0..last_stop.map_or(0, |index| index + 1) {
            let Some(order) = self.pop() else { return };
            self.news = true;
            let dropped = matches!(order, Order::Move(_) | Order::Gate(_) | Order::Home)
                || tick.stop && order == Order::Enable;
            if dropped || !self.apply(tick, order.event()) {
                self.counters.refused_orders += 1;
            }
        }
    }

    fn pop(&mut self) -> Option<Order> {
        let order = self.orders.pop().ok()?;
        self.scanned = self.scanned.saturating_sub(1);
        Some(order)
    }

    /// Carries out orders from the front of the queue until one has to wait. Macrosteps are for
    /// [`Effector::advance`].
    fn take_orders(&mut self, tick: &Tick) {
        for _ in 0..self.orders.slots() {
            let Ok(&order) = self.orders.peek() else {
                return;
            };
            let event = order.event();
            let answer = if tick.stop {
                Answer::Refuse
            } else {
                self.state.next(event)
            };
            match answer {
                Answer::To(next) => match order {
                    Order::Move(_) => return,
                    Order::Gate(gate) => {
                        if self.state != State::Standing || !tick.open.contain(gate) {
                            return;
                        }
                    }
                    _ => self.enter(tick, next),
                },
                Answer::Wait => return,
                Answer::Refuse => self.counters.refused_orders += 1,
            }
            self.pop();
            self.news = true;
        }
    }

    /// Goes where `event` leads; false if it is refused.
    fn apply(&mut self, tick: &Tick, event: Event) -> bool {
        match self.state.next(event) {
            Answer::To(next) => self.enter(tick, next),
            Answer::Wait | Answer::Refuse => return false,
        }
        true
    }

    /// What has to be prepared on the way into a state.
    fn enter(&mut self, tick: &Tick, next: State) {
        let last = self.state;
        if next == last {
            return;
        }
        self.state = next;
        // A reset that failed leads back to the phase it came from, and is news all the same.
        self.news |= next.phase() != last.phase() || last == State::Resetting;
        match (last, next) {
            // The stop goes on, only its end is another.
            (State::Braking(_), State::Braking(_)) | (State::Halting(_), State::Halting(_)) => {
                return;
            }
            (_, State::Braking(_)) => {
                self.begin_stop(tick);
                self.stop_restarted = false;
                self.segment = None;
            }
            (_, State::Halting(_)) => self.halted = false,
            (_, State::Enabling) if !self.stands_as_commanded() => {
                // Somebody moved it while it was off, and its links do not weigh what they did.
                self.axes.iter_mut().for_each(|axis| axis.torque = 0.0);
            }
            (_, State::Homing) => self.axes.iter_mut().for_each(Axis::begin_homing),
            (State::Resetting, State::Off) => self.fault = None,
            _ => {}
        }
        self.since = tick.now;
    }

    /// A straight stop from the last set-points.
    fn begin_stop(&mut self, tick: &Tick) {
        let mut knots = [Knot::default(); MAX_AXES];
        let mut accelerations = [0.0; MAX_AXES];
        for (index, axis) in self.axes.iter().enumerate() {
            knots[index] = axis.last_step(tick.dt);
            accelerations[index] = axis.config.max_acceleration;
        }
        let used = self.axes.len();
        self.stop = StraightStop::new(&knots[..used], &accelerations[..used], tick.dt);
    }

    /// Moves the set-points one period on, and the state with them.
    fn advance(&mut self, tick: &Tick) {
        let waited = tick.now.since(self.since);
        match self.state {
            State::Off | State::Faulted => {}
            State::Enabling => {
                let on = |axis: &Axis| axis.state.power == Power::On;
                if self.axes.iter().all(on) && self.settle() {
                    self.apply(tick, Event::Done);
                } else if waited > self.enabling_timeout {
                    let late = self.first(|axis| !axis.follows());
                    self.fail(tick, late, StopCause::NotReady { waited });
                }
            }
            State::Standing => {
                if matches!(self.orders.peek(), Ok(Order::Move(_))) {
                    self.follow_macrosteps(tick);
                }
            }
            State::Homing => self.home(tick, waited),
            State::Moving => self.follow_macrosteps(tick),
            State::Braking(after) => {
                if self.stop.advance() {
                    self.place_stop();
                    self.since = tick.now;
                } else if after == After::Stand
                    || waited >= self.standstill_wait()
                    || self.axes.iter().all(Axis::is_still)
                {
                    self.apply(tick, Event::Done);
                }
            }
            State::Halting(after) => {
                let axes = self.axes.iter_mut();
                axes.for_each(|axis| axis.brake_search(tick.dt));
                // A search may reverse, so a moment without motion is not yet the end of it.
                let still = self.axes.iter().all(Axis::is_still);
                self.halted |= waited >= self.longest_stop() || still && waited >= STANDSTILL_WAIT;
                if waited > self.longest_stop().saturating_add(self.enabling_timeout) {
                    let late = self.first(|axis| !axis.follows());
                    self.fail(tick, late, StopCause::NotReady { waited });
                    self.apply(tick, Event::Done);
                } else if after == After::Stand {
                    // Set-points are taken up again only once nothing moves.
                    if self.halted && self.settle() {
                        self.apply(tick, Event::Done);
                    }
                } else if self.halted {
                    self.apply(tick, Event::Done);
                }
            }
            State::Resetting => {
                if self.axes.iter().all(|axis| axis.state.fault.is_none()) {
                    self.apply(tick, Event::Done);
                } else if waited > self.enabling_timeout {
                    let late = self.first(|axis| axis.state.fault.is_some());
                    self.fail(tick, late, StopCause::NotReady { waited });
                }
            }
        }
    }

    /// Whether all axes have their reference and are where they were last told to be.
    fn stands_as_commanded(&self) -> bool {
        self.axes.iter().all(|axis| {
            let error = axis.knot.position - axis.state.position;
            axis.is_homed() && error.abs() <= axis.config.following_error
        })
    }

    /// The first axis for which `what` holds, or the first.
    fn first(&self, what: impl Fn(&Axis) -> bool) -> usize {
        self.axes.iter().position(what).unwrap_or(0)
    }

    /// How long after the last set-point of a stop the power may stay on at most. A drive that
    /// brakes by itself gets as long as the set-points could have taken.
    fn standstill_wait(&self) -> Duration {
        if self.axes.iter().any(|axis| axis.state.fault.is_some()) {
            self.longest_stop()
        } else {
            STANDSTILL_WAIT
        }
    }

    /// Takes the set-points of the straight stop. A lost axis keeps its last one, since its drive hears no other.
    fn place_stop(&mut self) {
        let axes = self.axes.iter_mut().enumerate();
        for (index, axis) in axes.filter(|(_, axis)| !axis.is_lost()) {
            axis.knot = self.stop.at(index);
        }
    }

    /// Turns state and set-points into one command per axis.
    ///
    /// An axis whose loop is closed here is regulated from its first cycle with power to its last: told to
    /// stand it would have no torque, and fall. One whose drive has a fault is told so all the same, for there is
    /// no loop through a drive that has a fault: its group brakes it if it commands pulse widths, by shorting the
    /// motor, and lets it coast, loaded or not, if it commands current.
    fn command(&mut self, tick: &Tick) {
        let halted = self.halted;
        let on = self.axes.iter().all(|axis| axis.state.power == Power::On);
        let order = self.homing_order();
        let macrostep = (self.state == State::Moving).then_some(self.macrostep);
        for axis in &mut self.axes {
            axis.excite(macrostep);
            let follow = match self.state {
                State::Enabling => on,
                State::Standing | State::Moving | State::Braking(_) => true,
                State::Homing => order.is_none(),
                State::Halting(after) => halted && after == After::Stand,
                State::Off | State::Faulted | State::Resetting => false,
            };
            let command = match self.state {
                State::Off | State::Faulted => AxisCommand::Off,
                State::Resetting => AxisCommand::ResetFault,
                // Its group brakes an axis that has a fault, if that can be; off would let it coast.
                _ if axis.state.fault.is_some() => AxisCommand::Stand,
                State::Homing if axis.homes_itself(order) => AxisCommand::Home,
                _ if follow || axis.is_led() => axis.regulate(tick.dt),
                _ => AxisCommand::Stand,
            };
            axis.command(command);
        }
    }

    fn report(&mut self, tick: &Tick) {
        let mut report = Report {
            at: tick.now,
            phase: self.state.phase(),
            homed: self.axes.iter().all(Axis::is_homed),
            macrostep: self.macrostep,
            commanded: [0.0; MAX_AXES],
            measured: [0.0; MAX_AXES],
            velocity: [0.0; MAX_AXES],
            fault: self.fault,
        };
        for (index, axis) in self.axes.iter().enumerate() {
            report.commanded[index] = axis.knot.position;
            report.measured[index] = axis.state.position;
            report.velocity[index] = axis.state.velocity;
        }
        self.counters.dropped_reports += u64::from(self.reports.push(report).is_err());
    }

    /// What the recording keeps of this cycle.
    pub(crate) fn record(&self, tick: &Tick) -> Record {
        let mut record = Record {
            cycle: tick.number,
            at: tick.now,
            effector: self.index,
            axes: self.axes.len() as u8,
            phase: self.state.phase(),
            ..Record::default()
        };
        for (axis, kept) in self.axes.iter().zip(&mut record.axis) {
            *kept = AxisRecord {
                commanded: axis.knot.position,
                command: axis.command,
                excitation: axis.excitation,
                measured: axis.state.position,
                expected: axis.expected,
                increments: axis.state.increments,
                velocity: axis.state.velocity,
                torque: axis.state.torque,
                homing: axis.state.homing,
            };
        }
        record
    }
}

impl Order {
    fn event(&self) -> Event {
        match self {
            Self::Enable => Event::Enable,
            Self::Home => Event::Home,
            // A gate waits and is refused where the motion behind it would be.
            Self::Move(_) | Self::Gate(_) => Event::Move,
            Self::Stop => Event::Stop,
            Self::Disable => Event::Disable,
            Self::ResetFault => Event::ResetFault,
        }
    }
}
