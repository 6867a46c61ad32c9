//! The cycle of one effector: checks its axes, takes orders, finds the next set-points and checks them.

mod homing;
mod motion;

use std::time::Duration;

use can::Instant;
use drive::{AxisCommand, AxisState, Power};

use crate::{
    After, Answer, AxisRecord, Counters, EffectorConfig, EffectorLink, MAX_AXES, Order, Publisher, Record,
    ServoAxisConfig, ServoEvent, ServoFault, ServoReport, ServoState, Snapshot, StopCause, StraightStop, latest,
};
use crate::{axis::ServoAxis, interpolate::Segment, motion_time::Motion, servo::OpenGates};

/// Longest wait for standstill after the last set-point of a stop. The power is then switched off.
const STANDSTILL_WAIT: Duration = Duration::from_millis(100);

/// Number of cycles in a row in which a bus may refuse the set-points of a stop. After that, the drives count as
/// standing.
const REFUSED_IN_STOP: u32 = 3;

/// Commanded speed, rad/s, below which an axis at a limit switch counts as at rest. The speed covers rounding errors
/// of generators.
const CREEP: f64 = 1e-3;

/// Data of a servo cycle for each of its effectors.
#[derive(Clone, Copy)]
pub(crate) struct Tick {
    pub(crate) number: u64,
    pub(crate) now: Instant,
    /// The nominal period, s.
    pub(crate) dt: f64,
    /// A stop of all effectors is requested.
    pub(crate) stop: bool,
    pub(crate) open: OpenGates,
    /// Deadlines missed in a row, if they exceed the limit.
    pub(crate) overrun: Option<u32>,
    /// Advance of the motion time.
    pub(crate) motion: Motion,
    /// Periods since the last cycle: 1 plus the number of missed deadlines.
    pub(crate) periods: u32,
    /// Number of cycles in a row, up to the last, in which a bus of this effector refused the batch. The set-points
    /// are then repeated.
    pub(crate) refused: u32,
}

pub(crate) struct Effector {
    index: u8,
    pub(crate) axes: Vec<ServoAxis>,
    enabling_timeout: Duration,
    homing_timeout: Duration,
    orders: rtrb::Consumer<Order>,
    /// Number of orders at the front of the queue that were checked and are neither stop nor disable.
    scanned: usize,
    reports: rtrb::Producer<ServoReport>,
    latest: Publisher,
    pub(crate) state: ServoState,
    /// Time at which `state` was entered.
    since: Instant,
    pub(crate) fault: Option<ServoFault>,
    segment: Option<Segment>,
    stop: StraightStop,
    /// The present stop was restarted because a bus refused its set-points.
    stop_restarted: bool,
    /// While [`ServoState::Halting`]: the drives have come to rest.
    halted: bool,
    /// Number of the last macrostep begun.
    macrostep: u64,
    /// This cycle has a report for the controller.
    news: bool,
    /// In this cycle `report_at` periods of the macrostep have passed.
    due: bool,
    /// Time that the slowest axis needs to stop from its greatest velocity.
    stopping_time: Duration,
    pub(crate) counters: Counters,
}

impl Effector {
    pub(crate) fn new(index: u8, config: &EffectorConfig, delays: &[usize]) -> (Self, EffectorLink) {
        let (order_sender, orders) = rtrb::RingBuffer::new(config.queue);
        // One report per macrostep, plus the few changes of phase that one order can cause.
        let (reports, report_receiver) = rtrb::RingBuffer::new(config.queue + 16);
        let (publisher, latest) = latest();
        let stops = config.axes.iter().map(ServoAxisConfig::stopping_time);
        let effector = Self {
            index,
            axes: config.axes.iter().map(|axis| ServoAxis::new(*axis, delays[axis.group])).collect(),
            enabling_timeout: config.enabling_timeout,
            homing_timeout: config.homing_timeout,
            orders,
            scanned: 0,
            reports,
            latest: publisher,
            state: ServoState::Off,
            since: Instant::ZERO,
            fault: None,
            segment: None,
            stop: StraightStop::new([], 1.0),
            stop_restarted: false,
            halted: false,
            macrostep: 0,
            news: false,
            due: false,
            stopping_time: Duration::try_from_secs_f64(stops.fold(0.0, f64::max)).unwrap_or(Duration::MAX),
            counters: Counters::default(),
        };
        (effector, EffectorLink { orders: order_sender, reports: report_receiver, latest })
    }

    /// Duration of the slowest stop, including the wait for standstill.
    pub(crate) fn longest_stop(&self) -> Duration {
        self.stopping_time.saturating_add(STANDSTILL_WAIT)
    }

    /// Takes the states of the drives, by group and index within the group.
    pub(crate) fn set_states(&mut self, state: impl Fn(usize, usize) -> AxisState, tick: &Tick) {
        for axis in &mut self.axes {
            axis.observe(state(axis.config.group, axis.config.index_in_group), tick.periods, tick.dt);
        }
    }

    pub(crate) fn commands(&self) -> impl Iterator<Item = (usize, usize, AxisCommand)> {
        self.axes.iter().map(|axis| (axis.config.group, axis.config.index_in_group, axis.command))
    }

    /// One cycle: from the states of the axes to their commands.
    pub(crate) fn step(&mut self, tick: &Tick) {
        self.news = false;
        self.due = false;
        self.check(tick);
        self.take_stops(tick);
        self.take_orders(tick);
        if self.is_held(tick) {
            self.axes.iter_mut().for_each(|axis| axis.hold(tick.dt));
        } else {
            self.advance(tick);
            self.command(tick);
        }
        let due = self.due && self.state == ServoState::Moving;
        let snapshot = self.snapshot(tick);
        self.latest.publish(&snapshot);
        if due || self.news {
            let reached = self.state != ServoState::Moving || self.segment.as_ref().is_none_or(Segment::has_reported);
            let report = ServoReport { snapshot, reached, fault: self.fault };
            self.counters.dropped_reports += u64::from(self.reports.push(report).is_err());
        }
    }

    /// Whether the set-points of the last cycle are repeated because a bus refused them.
    fn is_held(&mut self, tick: &Tick) -> bool {
        if matches!(self.state, ServoState::Braking(_)) && tick.refused > REFUSED_IN_STOP {
            // The drives receive no set-point and count as standing. The stop is restarted only once: a restart in
            // every cycle would never end while a motor is measured to move.
            if !self.stop_restarted {
                self.axes.iter_mut().for_each(|axis| axis.rest(0, tick.dt));
                self.begin_stop(tick);
                self.stop_restarted = true;
            }
            return false;
        }
        let follows = matches!(self.state, ServoState::Standing | ServoState::Moving | ServoState::Braking(_));
        tick.refused > 0 && follows
    }

    /// Checks drive faults, following errors, limit switches and overruns, and updates the tracking statistics.
    ///
    /// A closed limit switch stops an effector that continues towards the switch, or that the switch holds back from
    /// its commanded position. An axis may rest on the switch or move away from the switch.
    fn check(&mut self, tick: &Tick) {
        if let Some(missed) = tick.overrun {
            // In the missed cycles, the drives stood at their last set-points or continued by them.
            let late = tick.periods - 1;
            self.axes.iter_mut().for_each(|axis| axis.rest(late, tick.dt));
            self.fail(tick, None, StopCause::Overrun { missed });
        }
        for index in 0..self.axes.len() {
            let axis = &mut self.axes[index];
            if let Some(fault) = axis.state.fault {
                if self.state != ServoState::Resetting {
                    self.fail(tick, index, StopCause::Drive(fault));
                }
                continue;
            }
            let (error, limit) = (axis.error(), axis.config.following_error);
            let commanding = matches!(self.state, ServoState::Standing | ServoState::Moving | ServoState::Braking(_));
            if !axis.is_watched() || !commanding && !axis.is_led() {
                continue;
            }
            if let Some((velocity, limit)) = axis.runaway() {
                self.lose(tick, index, StopCause::Runaway { velocity, limit });
                continue;
            }
            if tick.overrun.is_some() && axis.is_host_closed() {
                // The commands were adapted to the missed deadlines, but the sample is older.
                continue;
            }
            axis.track(error, self.state);
            let beyond = error.abs() > limit;
            // Direction of the last command, or of the position that the motor does not reach.
            let sense = if beyond { error } else { axis.knot.velocity };
            let judged = commanding && (beyond || sense.abs() > CREEP);
            let switch = axis.limit_switch(sense).filter(|_| judged);
            if let Some(upper) = switch {
                // The drive itself stops this axis at the switch, and the loop of the axis works. The servo brakes the
                // other axes.
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

    /// Latches the first fault and leaves the present state.
    fn fail(&mut self, tick: &Tick, axis: impl Into<Option<usize>>, cause: StopCause) {
        self.latch(axis.into(), cause);
        self.apply(tick, ServoEvent::Fault);
    }

    /// Latches a fault of a position loop. Such a loop cannot brake, so the power is switched off at once.
    fn lose(&mut self, tick: &Tick, axis: usize, cause: StopCause) {
        self.latch(Some(axis), cause);
        self.apply(tick, ServoEvent::ControlLost);
    }

    fn latch(&mut self, axis: Option<usize>, cause: StopCause) {
        let axis = axis.map(|axis| axis as u8);
        self.fault.get_or_insert(ServoFault { axis, cause });
    }

    /// Finds stops anywhere in the queue and executes them first. Orders queued before the stop keep their order,
    /// but motion, gates and homing among them are dropped.
    fn take_stops(&mut self, tick: &Tick) {
        if tick.stop {
            self.apply(tick, ServoEvent::Disable);
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
            let dropped =
                matches!(order, Order::Move(_) | Order::Gate(_) | Order::Home) || tick.stop && order == Order::Enable;
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

    /// Executes orders from the front of the queue until an order has to wait. Macrosteps are left to
    /// [`Effector::advance`].
    fn take_orders(&mut self, tick: &Tick) {
        for _ in 0..self.orders.slots() {
            let Ok(&order) = self.orders.peek() else {
                return;
            };
            let answer = if tick.stop { Answer::Refuse } else { self.state.next(order.event()) };
            match answer {
                Answer::To(next) => match order {
                    Order::Move(_) => return,
                    Order::Gate(gate) => {
                        if self.state != ServoState::Standing || !tick.open.contain(gate) {
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

    /// Changes the state by `event`; false if the event is refused.
    fn apply(&mut self, tick: &Tick, event: ServoEvent) -> bool {
        match self.state.next(event) {
            Answer::To(next) => self.enter(tick, next),
            Answer::Wait | Answer::Refuse => return false,
        }
        true
    }

    fn enter(&mut self, tick: &Tick, next: ServoState) {
        let last = self.state;
        if next == last {
            return;
        }
        self.state = next;
        // A macrostep that was cut off is never continued.
        if next != ServoState::Moving {
            self.segment = None;
        }
        // A failed reset returns to its previous phase, and is reported as well.
        self.news |= next.phase() != last.phase() || last == ServoState::Resetting;
        match (last, next) {
            // The stop continues; only the state after it changes.
            (ServoState::Braking(_), ServoState::Braking(_)) | (ServoState::Halting(_), ServoState::Halting(_)) => {
                return;
            }
            (_, ServoState::Braking(_)) => {
                self.begin_stop(tick);
                self.stop_restarted = false;
            }
            (_, ServoState::Halting(_)) => self.halted = false,
            (_, ServoState::Enabling) if !self.stands_as_commanded() => {
                // The arm was moved while it was off, so the old feed-forward torques are wrong.
                self.axes.iter_mut().for_each(|axis| axis.torque = 0.0);
            }
            (_, ServoState::Homing) => self.axes.iter_mut().for_each(ServoAxis::begin_homing),
            (ServoState::Resetting, ServoState::Off) => self.fault = None,
            _ => {}
        }
        self.since = tick.now;
    }

    /// A straight stop from the last set-points.
    fn begin_stop(&mut self, tick: &Tick) {
        let from = self.axes.iter().map(|axis| (axis.last_step(tick.dt), axis.config.max_acceleration));
        self.stop = StraightStop::new(from, tick.dt);
    }

    /// Advances the set-points by one period, and the state with them.
    fn advance(&mut self, tick: &Tick) {
        let waited = tick.now.since(self.since);
        match self.state {
            ServoState::Off | ServoState::Faulted => {}
            ServoState::Enabling => {
                let on = |axis: &ServoAxis| axis.state.power == Power::On;
                if self.axes.iter().all(on) && self.settle() {
                    self.apply(tick, ServoEvent::Done);
                } else if waited > self.enabling_timeout {
                    let late = self.first(|axis| !axis.follows());
                    self.fail(tick, late, StopCause::NotReady { waited });
                }
            }
            ServoState::Standing => {
                if matches!(self.orders.peek(), Ok(Order::Move(_))) {
                    self.follow_macrosteps(tick);
                }
            }
            ServoState::Homing => self.home(tick, waited),
            ServoState::Moving => self.follow_macrosteps(tick),
            ServoState::Braking(after) => {
                if self.stop.advance() {
                    self.place_stop();
                    self.since = tick.now;
                } else if after == After::Stand
                    || waited >= self.standstill_wait()
                    || self.axes.iter().all(ServoAxis::is_still)
                {
                    self.apply(tick, ServoEvent::Done);
                }
            }
            ServoState::Halting(after) => {
                let axes = self.axes.iter_mut();
                axes.for_each(|axis| axis.brake_search(tick.dt));
                // A search may reverse, so a short standstill does not prove its end.
                let still = self.axes.iter().all(ServoAxis::is_still);
                self.halted |= waited >= self.longest_stop() || still && waited >= STANDSTILL_WAIT;
                if waited > self.longest_stop().saturating_add(self.enabling_timeout) {
                    let late = self.first(|axis| !axis.follows());
                    self.fail(tick, late, StopCause::NotReady { waited });
                    self.apply(tick, ServoEvent::Done);
                } else if after == After::Stand {
                    // Following restarts only after standstill.
                    if self.halted && self.settle() {
                        self.apply(tick, ServoEvent::Done);
                    }
                } else if self.halted {
                    self.apply(tick, ServoEvent::Done);
                }
            }
            ServoState::Resetting => {
                if self.axes.iter().all(|axis| axis.state.fault.is_none()) {
                    self.apply(tick, ServoEvent::Done);
                } else if waited > self.enabling_timeout {
                    let late = self.first(|axis| axis.state.fault.is_some());
                    self.fail(tick, late, StopCause::NotReady { waited });
                }
            }
        }
    }

    /// Whether all axes have their reference and stand within the following error of their last command.
    fn stands_as_commanded(&self) -> bool {
        self.axes.iter().all(|axis| {
            let error = axis.knot.position - axis.state.position;
            axis.is_homed() && error.abs() <= axis.config.following_error
        })
    }

    /// The first axis for which `what` holds, or axis 0.
    fn first(&self, what: impl Fn(&ServoAxis) -> bool) -> usize {
        self.axes.iter().position(what).unwrap_or(0)
    }

    /// Longest time from the last set-point of a stop to switching off the power. A drive that brakes by itself gets
    /// the time of the longest stop.
    fn standstill_wait(&self) -> Duration {
        if self.axes.iter().any(|axis| axis.state.fault.is_some()) { self.longest_stop() } else { STANDSTILL_WAIT }
    }

    /// Takes the set-points of the straight stop. A lost axis keeps its last set-point, because its drive receives no
    /// other.
    fn place_stop(&mut self) {
        for (index, axis) in self.axes.iter_mut().enumerate().filter(|(_, axis)| !axis.is_lost()) {
            axis.knot = self.stop.at(index);
        }
    }

    /// Converts state and set-points to one command per axis.
    ///
    /// A loop that the servo closes is regulated as long as its axis has power. `Stand` would give such an axis no
    /// torque, and the axis would fall. An axis with a drive fault gets `Stand` all the same, because no loop can act
    /// through a faulted drive. The group then brakes a drive commanded by pulse width by shorting its motor. A drive
    /// commanded by current coasts, even under load.
    fn command(&mut self, tick: &Tick) {
        let halted = self.halted;
        let on = self.axes.iter().all(|axis| axis.state.power == Power::On);
        let order = self.homing_order();
        let macrostep = (self.state == ServoState::Moving).then_some(self.macrostep);
        for axis in &mut self.axes {
            axis.excite(macrostep);
            let follow = match self.state {
                ServoState::Enabling => on,
                ServoState::Standing | ServoState::Moving | ServoState::Braking(_) => true,
                ServoState::Homing => order.is_none(),
                ServoState::Halting(after) => halted && after == After::Stand,
                ServoState::Off | ServoState::Faulted | ServoState::Resetting => false,
            };
            let command = match self.state {
                ServoState::Off | ServoState::Faulted => AxisCommand::Off,
                ServoState::Resetting => AxisCommand::ResetFault,
                // With `Stand`, the group brakes a faulted axis if possible. `Off` would let the axis coast.
                _ if axis.state.fault.is_some() => AxisCommand::Stand,
                ServoState::Homing if axis.homes_itself(order) => AxisCommand::Home,
                _ if follow || axis.is_led() => axis.regulate(tick.dt),
                _ => AxisCommand::Stand,
            };
            axis.command(command);
        }
    }

    /// A value of each axis, in the order of a macrostep.
    fn each<T: Default>(&self, value: impl Fn(&ServoAxis) -> T) -> [T; MAX_AXES] {
        std::array::from_fn(|axis| self.axes.get(axis).map(&value).unwrap_or_default())
    }

    fn snapshot(&self, tick: &Tick) -> Snapshot {
        Snapshot {
            cycle: tick.number,
            at: tick.now,
            phase: self.state.phase(),
            homed: self.axes.iter().all(ServoAxis::is_homed),
            macrostep: self.macrostep,
            rate: tick.motion.rate,
            axes: self.axes.len() as u8,
            commanded: self.each(|axis| axis.knot.position),
            commanded_velocity: self.each(|axis| axis.knot.velocity),
            measured: self.each(|axis| axis.state.position),
            velocity: self.each(|axis| axis.state.velocity),
            torque: self.each(|axis| axis.state.torque),
            switches: self.each(|axis| axis.state.switches),
            sampled: self.each(|axis| axis.state.sampled),
            age: self.each(|axis| axis.state.age),
        }
    }

    pub(crate) fn record(&self, tick: &Tick) -> Record {
        let mut record = Record {
            cycle: tick.number,
            at: tick.now,
            effector: self.index,
            axes: self.axes.len() as u8,
            phase: self.state.phase(),
            faulted: self.fault.is_some(),
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
    fn event(&self) -> ServoEvent {
        match self {
            Self::Enable => ServoEvent::Enable,
            Self::Home => ServoEvent::Home,
            // A gate is queued and refused in the same states as the motion behind it.
            Self::Move(_) | Self::Gate(_) => ServoEvent::Move,
            Self::Stop => ServoEvent::Stop,
            Self::Disable => ServoEvent::Disable,
            Self::ResetFault => ServoEvent::ResetFault,
        }
    }
}
