//! The cycle of one effector: checks its axes, takes orders, finds the next set-points and checks them.

mod check;
mod envelope;
mod homing;
mod law;
mod motion;
mod orders;
mod reset;
mod slip;

use std::time::Duration;

use can::Instant;
use drive::{AxisCommand, AxisState, Power};

use crate::{
    After, Answer, AxisRecord, Counters, EffectorConfig, EffectorLink, Knot, MAX_AXES, Order, Publisher, Record,
    ServoAxisConfig, ServoEvent, ServoFault, ServoReport, ServoState, Snapshot, StopCategory, StopCause, StraightStop,
    Trail, latest,
};
use crate::{axis::ServoAxis, interpolate::Segment, limit, motion_time::Motion, team::Team};

/// Longest wait for standstill after the last set-point of a stop. The power is then switched off.
const STANDSTILL_WAIT: Duration = Duration::from_millis(100);

/// Number of cycles in a row in which a bus may refuse the set-points of a stop. After that, the drives count as
/// standing.
const REFUSED_IN_STOP: u32 = 3;

/// Data of a servo cycle for each of its effectors.
#[derive(Clone, Copy)]
pub(crate) struct Tick {
    pub(crate) number: u64,
    pub(crate) now: Instant,
    /// The nominal period, s.
    pub(crate) dt: f64,
    /// A stop of all effectors is requested.
    pub(crate) stop: bool,
    /// Bit set of the effectors of the cell.
    pub(crate) effectors: u32,
    /// Deadlines missed in a row, if they exceed the limit.
    pub(crate) overrun: Option<u32>,
    /// The cause of a stop by too great a share of missed deadlines.
    pub(crate) overload: Option<StopCause>,
    /// The cause of a stop by an input of the emergency stop.
    pub(crate) emergency: Option<StopCause>,
    /// Advance of the motion time.
    pub(crate) motion: Motion,
    /// Periods since the last cycle: 1 plus the number of missed deadlines.
    pub(crate) periods: u32,
}

pub(crate) struct Effector {
    index: u8,
    pub(crate) axes: Vec<ServoAxis>,
    enabling_timeout: Duration,
    homing_timeout: Duration,
    orders: rtrb::Consumer<Order>,
    /// Number of orders in the queue that this cycle sees. Later orders wait for the next cycle.
    visible: usize,
    /// Number of orders at the front of the queue that were checked and are neither stop nor disable.
    scanned: usize,
    reports: rtrb::Producer<ServoReport>,
    latest: Publisher,
    /// Time of the cycle that found the last set-points.
    commanded_at: Instant,
    pub(crate) state: ServoState,
    /// Time at which `state` was entered.
    since: Instant,
    pub(crate) fault: Option<ServoFault>,
    pub(crate) team: Team,
    /// An order or a fault stopped the effector, and its team was not told yet.
    pub(crate) stopped: bool,
    /// Number of cycles in a row, up to the last, in which a bus of this effector refused the batch.
    refused: u32,
    /// In this cycle, the set-points of the last cycle are repeated, because a bus of this effector or of a partner
    /// refused them.
    pub(crate) held: bool,
    segment: Option<Segment>,
    /// The macrostep decides on this cycle. Its set-points in `next` are taken after all effectors have found theirs.
    decided: bool,
    next: [Knot; MAX_AXES],
    law: Option<law::Installed>,
    stop: StraightStop,
    /// The envelope of the stop.
    envelope: envelope::Envelope,
    /// The motion ended in this cycle while the law still moved the effector, which brakes to a stand.
    pub(crate) settling: bool,
    /// Where the effector rests on its brakes after an orderly power-off, while the brakes are watched.
    rest: Option<slip::Rest>,
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
        let (publisher, latest) = latest(config.axes.len());
        let stops = config.axes.iter().map(ServoAxisConfig::stopping_time);
        let effector = Self {
            index,
            axes: config.axes.iter().map(|axis| ServoAxis::new(*axis, delays[axis.group])).collect(),
            enabling_timeout: config.enabling_timeout,
            homing_timeout: config.homing_timeout,
            orders,
            visible: 0,
            scanned: 0,
            reports,
            latest: publisher,
            commanded_at: Instant::ZERO,
            state: ServoState::Off,
            since: Instant::ZERO,
            fault: None,
            team: Team::apart(1 << index),
            stopped: false,
            refused: 0,
            held: false,
            segment: None,
            decided: false,
            next: [Knot::default(); MAX_AXES],
            law: None,
            stop: StraightStop::new([], 1.0),
            envelope: envelope::Envelope::default(),
            settling: false,
            rest: None,
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

    /// The bit of this effector in a bit set of effectors.
    pub(crate) fn bit(&self) -> u32 {
        1 << self.index
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

    /// Axes whose counters may have lost counts since the last call, by group and index within the group.
    pub(crate) fn take_doubted(&mut self) -> impl Iterator<Item = (usize, usize)> {
        let doubted = self.axes.iter_mut().filter(|axis| axis.doubted);
        doubted.map(|axis| {
            axis.doubted = false;
            (axis.config.group, axis.config.index_in_group)
        })
    }

    pub(crate) fn commands(&self) -> impl Iterator<Item = (usize, usize, AxisCommand)> {
        self.axes.iter().map(|axis| (axis.config.group, axis.config.index_in_group, axis.command))
    }

    /// First part of a cycle: checks the axes, and takes orders up to a barrier or a macrostep. `refused` is the number
    /// of cycles in a row, up to the last, in which a bus of this effector refused the batch.
    pub(crate) fn begin_cycle(&mut self, refused: u32, tick: &Tick) {
        (self.news, self.due, self.decided) = (false, false, false);
        (self.refused, self.settling) = (refused, false);
        self.check(tick);
        self.take_stops(tick);
        self.take_orders(tick);
    }

    /// Last part of a cycle, after all effectors were [coordinated](crate::team::coordinate): from set-points to
    /// commands.
    pub(crate) fn end_cycle(&mut self, tick: &Tick) {
        if self.held {
            self.axes.iter_mut().for_each(|axis| axis.hold(tick.dt));
        } else {
            if self.decided {
                self.take_set_points();
            } else {
                self.advance(tick);
            }
            self.command(tick);
            self.commanded_at = tick.now;
        }
        let due = self.due && self.state == ServoState::Moving;
        let snapshot = self.snapshot(tick);
        self.latest.publish(&snapshot);
        self.latest.publish_trail(&self.trail(tick.dt));
        if due || self.news {
            let reached = self.state != ServoState::Moving || self.segment.as_ref().is_none_or(Segment::is_reported);
            let resetting = self.state == ServoState::Resetting;
            let report = ServoReport { snapshot, reached, fault: self.fault, resetting };
            self.counters.dropped_reports += u64::from(self.reports.push(report).is_err());
        }
    }

    /// Whether a bus refused the set-points of the last cycle, and the effector must repeat them.
    pub(crate) fn must_repeat(&self) -> bool {
        let braking = self.is_braking();
        let follows = braking || matches!(self.state, ServoState::Standing | ServoState::Moving);
        let given_up = braking && self.refused > REFUSED_IN_STOP;
        self.refused > 0 && follows && !given_up
    }

    /// Restarts a stop whose set-points a bus refuses too long. The drives receive no set-point and count as standing.
    /// The stop is restarted only once: a restart in every cycle would never end while a motor is measured to move.
    pub(crate) fn restart_refused_stop(&mut self, tick: &Tick) {
        if self.is_braking() && self.refused > REFUSED_IN_STOP && !self.stop_restarted {
            self.axes.iter_mut().for_each(|axis| axis.rest(0, tick.dt));
            self.begin_stop(tick);
            self.set_envelope();
            self.stop_restarted = true;
        }
    }

    /// Latches the first fault and leaves the present state.
    fn fail(&mut self, tick: &Tick, axis: impl Into<Option<usize>>, cause: StopCause) {
        self.latch(axis.into(), cause);
        self.apply(tick, ServoEvent::Fault);
    }

    /// Latches a fault of a position loop that cannot brake, so the power is switched off at once.
    fn lose(&mut self, tick: &Tick, axis: usize, cause: StopCause) {
        self.latch(Some(axis), cause);
        self.fault.iter_mut().for_each(|fault| fault.category = StopCategory::Zero);
        self.apply(tick, ServoEvent::ControlLost);
    }

    fn latch(&mut self, axis: Option<usize>, cause: StopCause) {
        let axis = axis.map(|axis| axis as u8);
        // A fault of the effector itself replaces that of a partner, and the end of a motion by its law.
        let first = self.fault.filter(|_| !self.needs_acknowledgement());
        self.fault = Some(first.unwrap_or(ServoFault::new(axis, cause)));
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
        self.begin_brake_watch(last, next, tick);
        self.stopped |=
            matches!(next, ServoState::Off | ServoState::Braking(_) | ServoState::Halting(_) | ServoState::Faulted);
        // A macrostep that was cut off is never continued.
        let segment = if next == ServoState::Moving { None } else { self.segment.take() };
        self.leave_law(last, next, segment.as_ref());
        // A failed reset returns to its previous phase, and is reported as well.
        self.news |= next.phase() != last.phase() || last == ServoState::Resetting;
        match (last, next) {
            // The stop continues; only the state after it changes.
            (ServoState::Braking(before), ServoState::Braking(after)) => {
                if before.category() != after.category() {
                    self.set_envelope();
                }
                return;
            }
            (ServoState::Halting(_), ServoState::Halting(_)) => return,
            (_, ServoState::Braking(_)) => {
                self.begin_stop(tick);
                self.set_envelope();
                self.stop_restarted = false;
            }
            (_, ServoState::Halting(_)) => {
                self.set_envelope();
                self.halted = false;
            }
            (_, ServoState::Enabling) => {
                if !self.stands_as_commanded() {
                    // The arm was moved while it was off, so the old feed-forward torques are wrong.
                    self.axes.iter_mut().for_each(|axis| axis.torque = 0.0);
                }
                // The load of a motor depends on the positions of all motors of the arm.
                if !self.axes.iter().all(ServoAxis::has_the_load_of_its_rest) {
                    self.axes.iter_mut().for_each(ServoAxis::forget_load);
                }
            }
            (_, ServoState::Homing) => self.axes.iter_mut().for_each(ServoAxis::begin_homing),
            (ServoState::Resetting, ServoState::Off) => {
                self.fault = None;
                self.axes.iter_mut().for_each(|axis| axis.cut = false);
            }
            _ => {}
        }
        self.since = tick.now;
    }

    /// Stops with a partner of the team. The effector then stands, and takes motion only after a stop or disable order.
    pub(crate) fn stop_with(&mut self, partner: u8, tick: &Tick) {
        self.stop_as_intended(tick, None, StopCause::Partner { effector: partner });
    }

    /// Brakes to a stand with power on. Motion is refused until a stop or disable order acknowledges `cause`.
    fn stop_as_intended(&mut self, tick: &Tick, axis: Option<usize>, cause: StopCause) {
        self.latch(axis, cause);
        self.apply(tick, ServoEvent::Stop);
        self.news = true;
    }

    /// Whether the effector is off or faulted, and all its drives report that they have no power.
    pub(crate) fn is_off(&self) -> bool {
        let off = matches!(self.state, ServoState::Off | ServoState::Faulted);
        off && self.axes.iter().all(|axis| axis.state.power == Power::Off)
    }

    /// Whether the servo brakes the effector.
    pub(crate) fn is_braking(&self) -> bool {
        matches!(self.state, ServoState::Braking(_))
    }

    /// Number of periods of the stop that begins in this cycle, if any.
    pub(crate) fn stop_periods(&self) -> Option<u32> {
        self.is_braking().then(|| self.stop.periods())
    }

    /// Lets the stop that begins in this cycle last at least this number of periods.
    pub(crate) fn brake_over(&mut self, periods: u32) {
        if self.stop.periods() < periods {
            self.stop = self.stop.lasting(periods);
            self.set_envelope();
        }
    }

    /// A straight stop from the last set-points.
    fn begin_stop(&mut self, tick: &Tick) {
        let motors = self.axes.iter().map(|axis| limit::braking(&axis.config, axis.last_step(tick.dt)));
        self.stop = StraightStop::new(motors, tick.dt);
    }

    /// Advances the set-points by one period, and the state with them.
    fn advance(&mut self, tick: &Tick) {
        let waited = tick.now.since(self.since);
        match self.state {
            ServoState::Off => self.watch_brakes(tick),
            ServoState::Faulted | ServoState::Standing | ServoState::Moving => {}
            ServoState::Enabling => {
                let on = |axis: &ServoAxis| axis.state.power == Power::On;
                if self.axes.iter().all(on) && self.settle() {
                    self.apply(tick, ServoEvent::Done);
                } else if waited > self.enabling_timeout {
                    let late = self.first(|axis| !axis.follows());
                    self.fail(tick, late, StopCause::NotReady { waited });
                }
            }
            ServoState::Homing => self.home(tick, waited),
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
                if let Some((axis, cause)) = self.not_halting(waited) {
                    self.lose(tick, axis, cause);
                    return;
                }
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
            ServoState::Resetting => self.reset(tick, waited),
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
                _ if axis.cut => AxisCommand::Off,
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

    /// The set-points up to the last cycle that found some, at the servo period `period`, s.
    fn trail(&self, period: f64) -> Trail {
        let mut trail = Trail { at: self.commanded_at, period, ..Trail::default() };
        for (index, axis) in self.axes.iter().enumerate() {
            let (past, delay) = axis.past();
            (trail.positions[index], trail.delays[index]) = (*past, delay);
        }
        trail
    }

    fn snapshot(&self, tick: &Tick) -> Snapshot {
        Snapshot {
            cycle: tick.number,
            at: tick.now,
            phase: self.state.phase(),
            homed: self.axes.iter().all(ServoAxis::is_homed),
            macrostep: self.macrostep,
            team_macrostep: self.team.macrosteps,
            waiting: self.is_waiting(),
            rate: tick.motion.rate,
            axes: self.axes.len() as u8,
            commanded: self.each(|axis| axis.knot.position),
            commanded_velocity: self.each(|axis| axis.knot.velocity),
            displacement: self.law.as_ref().map_or([0.0; MAX_AXES], law::Installed::displacements),
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
        let displacements = self.law.as_ref().map_or([0.0; MAX_AXES], law::Installed::displacements);
        for ((axis, kept), displacement) in self.axes.iter().zip(&mut record.axis).zip(displacements) {
            *kept = AxisRecord {
                commanded: axis.knot.position,
                displacement,
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
