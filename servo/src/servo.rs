//! The cycle of the servo.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::{task::Poll, time::Duration};

use can::Instant;
use drive::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters, Warnings};

use crate::axis::ServoAxis;
use crate::effector::{Effector, Tick};
use crate::journal::{Journal, JournalEvent, JournalReader};
use crate::motion_time::{Bounds, MotionTime, SpeedOverride};
use crate::overload::OverloadWatch;
use crate::state::CellEvent;
use crate::{
    CellState, Counters, CycleLaw, EffectorLink, Excitation, ExcitationError, LawBound, LawError, Oscillation, Record,
    ServoConfig, ServoError, ServoFault, ServoState, StopCause, TeamState, TrackingError,
};
use crate::{excitation::Playing, recorder::Recorder, team};

/// Steps every effector of a cell on one tick grid.
///
/// # The cycle
/// [`step`](Self::step) reads and checks the samples that the drives took at the last SYNC. Then the function finds,
/// checks and writes the next set-points, and sends SYNC with them. [`prepare`](Self::prepare) and
/// [`send`](Self::send) are the two parts of `step`. A thread may prepare shortly before the deadline and send exactly
/// at it, so that only SYNC carries the jitter. In both cases a cycle costs at most one system call each way per bus,
/// and two periods pass from sample to effect.
///
/// None of the three functions allocates, locks, formats or waits. The deadline of a cycle is the nominal time of its
/// SYNC. A caller that misses a deadline skips the cycle and reports the miss by [`missed`](Self::missed). The motion
/// is then late by the missed periods, but never faster: set-points always advance by one nominal period.
///
/// # Stops
/// Every stop first brakes the effector along a straight line within its acceleration limits
/// ([`StraightStop`](crate::StraightStop)). Exceptions are a failed position loop and [`cut_power`](Self::cut_power),
/// which switch the power off at once. A [`StopRequest`] brakes all effectors, and then switches them off. The states are
/// those of [`ServoState`] for an effector, [`TeamState`] for a team, and [`CellState`] for the cell.
///
/// # Cycle laws
/// An effector may have one [`CycleLaw`], which displaces the interpolated set-points of macrosteps that carry
/// [`LawParameters`](crate::LawParameters).
///
/// # Teams
/// Effectors that are [tied](crate::Order::Tie) begin each macrostep together, and a stop of one stops all: see
/// [`TeamState`].
pub struct Servo {
    period: Duration,
    max_missed_in_row: u32,
    groups: Vec<Group>,
    effectors: Vec<Effector>,
    stop: StopRequest,
    state: CellState,
    motion_time: MotionTime,
    recorder: Option<Recorder>,
    journal: Option<Journal>,
    cycles: u64,
    /// Time of the last SYNC.
    sent: Option<Instant>,
    /// Missed deadlines: since the last cycle, in a row up to the last cycle, and in total.
    missed: u32,
    missed_in_row: u32,
    missed_ever: u64,
    overload: OverloadWatch,
}

struct Group {
    drives: Box<dyn DriveGroup>,
    states: Vec<AxisState>,
    commands: Vec<AxisCommand>,
    is_up: bool,
    /// Number of cycles in a row, up to the last, in which the bus did not take the whole batch.
    refused_in_row: u32,
}

impl Group {
    /// Number of cycles in a row, up to the last, whose set-points must be repeated. A group whose axes all have a
    /// fault has no set-points, so a failed bus delays no stop.
    fn refused(&self) -> u32 {
        if self.states.iter().all(|state| state.fault.is_some()) { 0 } else { self.refused_in_row }
    }
}

/// Request to brake every effector and switch it off, for example on Ctrl-C.
///
/// The request holds for the rest of the run, and later orders are refused.
#[derive(Clone, Debug, Default)]
pub struct StopRequest(Arc<AtomicBool>);

/// Why the drives of a servo did not come up. None of the drives has power.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NotUp {
    /// The drive group of this index failed.
    Group(usize, BringUpError),
    /// A [`StopRequest`] ended the bring-up.
    Stopped,
}

impl StopRequest {
    /// Requests the stop, from any thread or from a signal handler.
    pub fn request(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether a stop was requested.
    pub fn is_requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl Servo {
    /// A servo for `groups`, and one link per effector of `config`, in the same order.
    pub fn new(
        config: &ServoConfig,
        groups: Vec<Box<dyn DriveGroup>>,
    ) -> Result<(Self, Vec<EffectorLink>), ServoError> {
        let axes: Vec<usize> = groups.iter().map(|group| group.axes()).collect();
        config.check(&axes)?;
        let delays: Vec<usize> = groups.iter().map(|group| group.delay()).collect();
        let effectors = config.effectors.iter().zip(0..);
        let (effectors, links) = effectors.map(|(config, index)| Effector::new(index, config, &delays)).unzip();
        let group = |drives: Box<dyn DriveGroup>| Group {
            states: vec![AxisState::default(); drives.axes()],
            commands: vec![AxisCommand::Off; drives.axes()],
            is_up: false,
            refused_in_row: 0,
            drives,
        };
        let servo = Self {
            period: config.period,
            max_missed_in_row: config.max_missed_in_row,
            groups: groups.into_iter().map(group).collect(),
            effectors,
            stop: StopRequest::default(),
            state: CellState::default(),
            motion_time: MotionTime::new(),
            recorder: None,
            journal: None,
            cycles: 0,
            sent: None,
            missed: 0,
            missed_in_row: 0,
            missed_ever: 0,
            overload: OverloadWatch::new(config.max_missed_in_row),
        };
        Ok((servo, links))
    }

    /// Advances the bring-up of every group. Call this function every period until it is ready.
    pub fn bring_up(&mut self, now: Instant) -> Poll<Result<(), NotUp>> {
        let stop = self.stop.is_requested();
        if let Some(journal) = &mut self.journal {
            journal.note(now, JournalEvent::BringUp { stop });
        }
        if stop {
            self.take(CellEvent::Stop);
            return Poll::Ready(Err(NotUp::Stopped));
        }
        let result = self.bring_up_groups(now);
        if let Some(journal) = &mut self.journal {
            journal.note_words(now);
        }
        result
    }

    fn bring_up_groups(&mut self, now: Instant) -> Poll<Result<(), NotUp>> {
        let mut up = true;
        for (index, group) in self.groups.iter_mut().enumerate() {
            if group.is_up {
                group.drives.wait(now);
                continue;
            }
            match group.drives.bring_up(now) {
                Poll::Ready(Ok(())) => group.is_up = true,
                Poll::Ready(Err(error)) => {
                    return Poll::Ready(Err(NotUp::Group(index, error)));
                }
                Poll::Pending => up = false,
            }
        }
        if up { Poll::Ready(Ok(())) } else { Poll::Pending }
    }

    fn take(&mut self, event: CellEvent) {
        self.state = self.state.next(event);
    }

    /// One cycle. Call this function only after [`bring_up`](Self::bring_up) is ready.
    pub fn step(&mut self, now: Instant) {
        self.prepare(now);
        self.send(now);
    }

    /// All of a cycle except sending. `now` is the time of its SYNC, or shortly before.
    #[cfg_attr(mrroc_rtsan, sanitize(realtime = "nonblocking"))]
    pub fn prepare(&mut self, now: Instant) {
        self.read(now);
        self.compute(now);
        self.write(now);
    }

    /// Reads the samples of the drives: the first part of [`prepare`](Self::prepare), for a caller that measures the
    /// time of each part.
    pub fn read(&mut self, now: Instant) {
        for group in &mut self.groups {
            group.drives.read(now, &mut group.states);
        }
    }

    /// Finds and checks the set-points: the second part, without access to a bus.
    pub fn compute(&mut self, now: Instant) {
        let tick = self.tick(now);
        for (index, effector) in self.effectors.iter_mut().enumerate() {
            let mut kept = 0;
            effector.receive_orders(|order| {
                kept += self.journal.as_mut().map_or(0, |journal| u32::from(journal.keep(order)));
            });
            if let Some(journal) = self.journal.as_mut().filter(|_| kept > 0) {
                journal.note(now, JournalEvent::Orders { effector: index as u8, count: kept });
            }
            effector.set_states(|group, index| self.groups[group].states[index], &tick);
            let refused = effector.axes.iter().map(|axis| self.groups[axis.config.group].refused()).max();
            effector.begin_cycle(refused.unwrap_or(0), &tick);
        }
        team::coordinate(&mut self.effectors, &tick);
        for (index, effector) in self.effectors.iter_mut().enumerate() {
            effector.end_cycle(&tick);
            for (group, axis) in effector.take_doubted() {
                self.groups[group].drives.doubt_reference(axis);
            }
            for (group, axis, command) in effector.commands() {
                self.groups[group].commands[axis] = command;
            }
            if let Some(journal) = &mut self.journal {
                journal.note_fault(now, index, effector.fault);
            }
            if let Some(recorder) = &mut self.recorder {
                recorder.record(Record {
                    dt: self.sent.map_or(Duration::ZERO, |sent| now.since(sent)),
                    ..effector.record(&tick)
                });
            }
        }
        let holds = |effector: &Effector| effector.holds_for_brake();
        self.take(if self.is_off() {
            CellEvent::PowerOff
        } else if self.effectors.iter().all(|effector| effector.is_off() || holds(effector)) {
            CellEvent::Holds
        } else {
            CellEvent::PowerOn
        });
    }

    /// Passes the set-points to the groups, which keep them until [`send`](Self::send): the third part.
    pub fn write(&mut self, now: Instant) {
        for group in &mut self.groups {
            group.drives.write(now, &group.commands);
        }
    }

    /// Sends SYNC and the prepared set-points, on every bus.
    ///
    /// After a refused batch, the next cycle repeats the set-points of every effector with an axis on that bus, and of
    /// its team. The motion of these effectors is then late by a period, and no drive ever receives two steps at once.
    /// Other effectors continue. A bus whose axes all have a fault delays no effector.
    #[cfg_attr(mrroc_rtsan, sanitize(realtime = "nonblocking"))]
    pub fn send(&mut self, now: Instant) {
        self.sent = Some(now);
        for group in &mut self.groups {
            let taken = group.drives.send(now);
            group.refused_in_row = if taken { 0 } else { group.refused_in_row.saturating_add(1) };
        }
        if let Some(journal) = &mut self.journal {
            journal.note_words(now);
            journal.note(now, JournalEvent::Sent);
        }
    }

    /// Adds the punctuality of the last cycle to the journal: the time from the deadline to [`send`](Self::send), and
    /// the duration of the cycle.
    pub fn note_timing(&mut self, now: Instant, late: Duration, step: Duration) {
        if let Some(journal) = &mut self.journal {
            journal.note(now, JournalEvent::Timing { late, step });
        }
    }

    /// Reports that the last cycle ended by a panic. The cycle counts as a refused batch on every bus: the next cycle
    /// repeats the set-points, because the buses may not have taken them.
    pub fn cycle_panicked(&mut self) {
        for group in &mut self.groups {
            group.refused_in_row = group.refused_in_row.saturating_add(1);
        }
    }

    /// Reports that `count` deadlines passed without a cycle since the last one.
    ///
    /// Misses before successive cycles count as one row, which a punctual cycle ends. A row longer than
    /// [`ServoConfig::max_missed_in_row`] is a fault of every effector. The drives have then stood at their last
    /// set-points, where the stop starts. A quarter of missed deadlines, in rows of any length, is a fault too: see
    /// [`StopCause::Overloaded`].
    pub fn missed(&mut self, count: u32) {
        self.missed = self.missed.saturating_add(count);
    }

    /// Reports that `count` deadlines passed while the cell's own time stood still. These deadlines are counted and
    /// have no other effect.
    pub fn slipped(&mut self, count: u32) {
        self.missed_ever += u64::from(count);
    }

    fn tick(&mut self, now: Instant) -> Tick {
        let missed = std::mem::take(&mut self.missed);
        self.missed_ever += u64::from(missed);
        let row = if missed == 0 { 0 } else { self.missed_in_row.saturating_add(missed) };
        self.missed_in_row = row;
        let overload = self.overload.count(missed);
        let number = self.cycles;
        self.cycles += 1;
        let dt = self.period.as_secs_f64();
        let effectors = &self.effectors;
        let refuses = |axis: &ServoAxis| self.groups[axis.config.group].refused() > 0;
        let held = effectors.iter().any(|it| it.state == ServoState::Moving && it.axes.iter().any(refuses));
        let (stop, target) = (self.stop.is_requested(), self.motion_time.target());
        if let Some(journal) = &mut self.journal {
            journal.note(now, JournalEvent::Cycle { number, missed, stop, rate: target });
        }
        let emergency = self.emergency_stop();
        let contact = if emergency.is_some() { CellEvent::ContactOpens } else { CellEvent::ContactsClose };
        let events = [Some(CellEvent::Up), Some(contact), stop.then_some(CellEvent::Stop)];
        self.state = events.into_iter().flatten().fold(self.state, CellState::next);
        let bounds = |rate| effectors.iter().map(|it| it.rate_bounds(rate)).fold(Bounds::NONE, Bounds::within);
        Tick {
            number,
            now,
            dt,
            motion: if held { self.motion_time.hold() } else { self.motion_time.advance(target, dt, bounds) },
            periods: missed.saturating_add(1),
            stop: self.state.is_ending(),
            effectors: !u32::MAX.checked_shl(effectors.len() as u32).unwrap_or(0),
            overrun: (row > self.max_missed_in_row).then_some(row),
            overload: overload.map(|(missed, deadlines)| StopCause::Overloaded { missed, deadlines }),
            emergency,
        }
    }

    /// The first open contact of the emergency stop; otherwise the first that is not known.
    fn emergency_stop(&self) -> Option<StopCause> {
        let groups = (0..).zip(&self.groups);
        let contacts = groups.filter_map(|(group, it)| Some((group, it.drives.emergency_stop()?)));
        let (group, contact) = contacts.min_by_key(|(_, contact)| !contact.known)?;
        Some(StopCause::EmergencyStop { group, contact })
    }

    /// Switches off the power of every axis without braking first (category 0).
    ///
    /// This function is for a cycle that has failed. A drive executes at a SYNC the command latched before, so at
    /// least two calls a period apart are necessary.
    #[cfg_attr(mrroc_rtsan, sanitize(realtime = "nonblocking"))]
    pub fn cut_power(&mut self, now: Instant) {
        if let Some(journal) = &mut self.journal {
            journal.note(now, JournalEvent::Cut);
        }
        self.take(CellEvent::Cut);
        for group in &mut self.groups {
            group.commands.fill(AxisCommand::Off);
            group.drives.write(now, &group.commands);
            group.drives.send(now);
        }
    }

    /// Starts a recording of at most `capacity` records, one per effector and cycle. Another thread drains the
    /// recording. Records that do not fit are counted.
    pub fn record(&mut self, capacity: usize) -> rtrb::Consumer<Record> {
        let (recorder, records) = Recorder::new(capacity);
        self.recorder = Some(recorder);
        records
    }

    /// Starts a journal of at most `entries` entries and `orders` orders that were not read yet. Each change of one of
    /// `words` is an entry: words that groups and cycle laws set to the values that they took from other threads. Call this
    /// function before the bring-up. Another thread drains the journal. What does not fit is counted.
    pub fn keep_journal(&mut self, entries: usize, orders: usize, words: Vec<Arc<AtomicU64>>) -> JournalReader {
        let (journal, reader) = Journal::new(entries, orders, words, self.effectors.len());
        self.journal = Some(journal);
        reader
    }

    /// Excites axis `axis` of effector `effector` during the macrosteps given in the excitation. Call this function
    /// before the cycles begin, and again to change the excitation. Outside these macrosteps nothing is added.
    ///
    /// All monitoring of the axis stays active. An excitation must not exceed a quarter of the output limit of a loop
    /// that the servo closes. Where the drive closes the loop, an added torque must not exceed a quarter of the rated
    /// torque. An added position must not exceed a quarter of the following error, or the acceleration of the axis.
    pub fn excite(&mut self, effector: usize, axis: usize, excitation: Excitation) -> Result<(), ExcitationError> {
        let found = self.effectors.get_mut(effector).and_then(|effector| effector.axes.get_mut(axis));
        let found = found.ok_or(ExcitationError::NoSuchAxis { effector, axis })?;
        excitation.check(&found.config, self.period.as_secs_f64())?;
        found.playing = Some(Playing::new(excitation));
        Ok(())
    }

    /// Installs the cycle law of effector `effector`, with the bounds of the displacement of each of its motors. Call this
    /// function before the cycles begin. An effector has at most one law. The law runs in macrosteps that carry
    /// [`LawParameters`](crate::LawParameters).
    pub fn install_law(
        &mut self,
        effector: usize,
        law: Box<dyn CycleLaw>,
        bounds: &[LawBound],
    ) -> Result<(), LawError> {
        if self.cycles > 0 {
            return Err(LawError::Running);
        }
        let found = self.effectors.get_mut(effector).ok_or(LawError::NoSuchEffector { effector })?;
        found.install_law(law, bounds)
    }

    /// A handle to stop all effectors.
    pub fn stop_request(&self) -> StopRequest {
        self.stop.clone()
    }

    /// A handle to the speed of all motion, for tasks.
    pub fn speed_override(&self) -> SpeedOverride {
        self.motion_time.requested.clone()
    }

    /// Follows the override of an operator too. The speed is the product of both fractions.
    pub fn follow_override(&mut self, speed: SpeedOverride) {
        self.motion_time.operator = speed;
    }

    /// Time from one SYNC to the next.
    pub fn period(&self) -> Duration {
        self.period
    }

    /// State of the cell.
    pub fn cell_state(&self) -> CellState {
        self.state
    }

    /// State of the team of effector `index`; `None` if there is no such effector.
    pub fn team_state(&self, index: usize) -> Option<TeamState> {
        self.effectors.get(index).map(|effector| effector.team.state)
    }

    /// State of effector `index`; `None` if there is no such effector.
    pub fn state(&self, index: usize) -> Option<ServoState> {
        self.effectors.get(index).map(|effector| effector.state)
    }

    /// The fault that stopped effector `index`, if any.
    pub fn fault(&self, index: usize) -> Option<ServoFault> {
        self.effectors.get(index).and_then(|effector| effector.fault)
    }

    /// Whether every effector is off or faulted, and every drive reports that it has no power.
    pub fn is_off(&self) -> bool {
        self.effectors.iter().all(Effector::is_off)
    }

    /// Longest duration of a stop of any effector: first its set-points, then its drives.
    pub fn longest_stop(&self) -> Duration {
        self.effectors.iter().map(Effector::longest_stop).max().unwrap_or_default().saturating_mul(2)
    }

    /// Tracking errors of the axes of effector `index`; empty if there is no such effector.
    pub fn tracking(&self, index: usize) -> impl Iterator<Item = TrackingError> {
        self.axes(index).map(|axis| axis.tracking)
    }

    /// Change of the counters of effector `index` when homing found the reference, increments: the count since
    /// power-on at the reference. The uncertainty is about one cycle's motion. `None` for an axis that did not home in
    /// this run.
    pub fn homing_offsets(&self, index: usize) -> impl Iterator<Item = Option<i64>> {
        self.axes(index).map(ServoAxis::homing_offset)
    }

    /// The greatest oscillation of each axis of effector `index` about its set-points, and the time from the first cycle to
    /// the first oscillation.
    pub fn oscillations(&self, index: usize) -> impl Iterator<Item = Option<(Oscillation, Duration)>> {
        let period = self.period.as_secs_f64();
        self.axes(index)
            .map(move |axis| axis.oscillates.map(|(it, cycle)| (it, Duration::from_secs_f64(cycle as f64 * period))))
    }

    fn axes(&self, index: usize) -> impl Iterator<Item = &ServoAxis> {
        let effector = self.effectors.get(index).into_iter();
        effector.flat_map(|effector| &effector.axes)
    }

    /// The counters of the servo.
    pub fn counters(&self) -> Counters {
        let mut sum = Counters {
            cycles: self.cycles,
            missed_cycles: self.missed_ever,
            dropped_records: self.recorder.as_ref().map_or(0, |recorder| recorder.dropped),
            ..Counters::default()
        };
        for counters in self.effectors.iter().map(|effector| &effector.counters) {
            sum.macrosteps += counters.macrosteps;
            sum.refused_orders += counters.refused_orders;
            sum.dropped_reports += counters.dropped_reports;
        }
        sum
    }

    /// The warnings of each group's drives.
    pub fn warnings(&self) -> impl Iterator<Item = &Warnings> {
        self.groups.iter().map(|group| group.drives.warnings())
    }

    /// The counters of each group.
    pub fn group_counters(&self) -> impl Iterator<Item = GroupCounters> {
        self.groups.iter().map(|group| group.drives.counters())
    }
}

#[cfg(test)]
pub(crate) mod tests;
