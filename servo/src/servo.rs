//! The cycle of the servo.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use drive::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters, Warnings};

use crate::effector::{Effector, Tick};
use crate::recorder::Recorder;
use crate::{
    Counters, EffectorLink, Excitation, ExcitationError, Record, ServoConfig, ServoError,
    ServoFault, State, TrackingError,
};

/// Steps every effector of a cell on one tick grid.
///
/// # The cycle
/// [`step`](Self::step) reads what the drives sampled at the SYNC before, checks it, finds the next
/// set-points, vets them, writes them, and sends SYNC with them. It is [`prepare`](Self::prepare)
/// and [`send`](Self::send) in one: a thread may prepare shortly before the deadline and send
/// exactly at it, so that SYNC alone carries the jitter. Either way a cycle costs at most one system
/// call each way per bus, and from sample to effect two periods pass.
///
/// None of the three allocates, locks, formats or waits. The deadline of a cycle is the nominal
/// time of its SYNC; whoever misses one skips it and says so with [`missed`](Self::missed). Motion is then
/// late by as many periods, never faster: set-points always advance by one nominal period.
///
/// # Stops
/// Whatever stops an effector brakes it along a straight line within its acceleration limits first
/// ([`StraightStop`](crate::StraightStop)). A [`StopRequest`] does so to all of them, and then
/// switches them off.
pub struct Servo {
    period: Duration,
    max_missed_in_row: u32,
    groups: Vec<Group>,
    effectors: Vec<Effector>,
    stop: StopRequest,
    gates: Gates,
    recorder: Option<Recorder>,
    cycles: u64,
    /// When SYNC was sent last.
    sent: Option<Instant>,
    /// Missed since the last cycle, in a row up to it, and ever.
    missed: u32,
    missed_in_row: u32,
    missed_ever: u64,
}

struct Group {
    drives: Box<dyn DriveGroup>,
    states: Vec<AxisState>,
    commands: Vec<AxisCommand>,
    is_up: bool,
    /// Cycles in a row, up to the last, whose batch the bus did not take whole.
    refused_in_row: u32,
}

impl Group {
    /// Cycles in a row, up to the last, whose set-points are due again. A group whose axes all have a fault has no
    /// set-points: a bus that is gone holds up no stop.
    fn refused(&self) -> u32 {
        if self.states.iter().all(|state| state.fault.is_some()) {
            0
        } else {
            self.refused_in_row
        }
    }
}

/// Asks a servo to brake every effector and switch it off; for Ctrl-C and the like.
///
/// It holds for the rest of the run: orders that come after it are refused.
#[derive(Clone, Debug, Default)]
pub struct StopRequest(Arc<AtomicBool>);

/// The gates that effectors wait at ([`Order::Gate`](crate::Order::Gate)), all shut at first.
///
/// A cycle looks at them once for all effectors: those that wait at a gate go on in the same cycle, whenever it
/// is opened. A gate stays open.
#[derive(Clone, Debug, Default)]
pub struct Gates(Arc<AtomicU64>);

impl Gates {
    /// How many there are, numbered from 0.
    pub const COUNT: u8 = 64;

    /// Opens a gate. What was sent to the effectors before is there when they pass it. There is none beyond
    /// [`Gates::COUNT`], and whoever waits there is not let through.
    pub fn open(&self, gate: u8) {
        self.0.fetch_or(bit(gate), Ordering::Release);
    }

    fn open_ones(&self) -> OpenGates {
        OpenGates(self.0.load(Ordering::Acquire))
    }
}

/// The gates that are open in a cycle.
#[derive(Clone, Copy)]
pub(crate) struct OpenGates(u64);

impl OpenGates {
    pub(crate) fn contain(self, gate: u8) -> bool {
        self.0 & bit(gate) != 0
    }
}

fn bit(gate: u8) -> u64 {
    1u64.checked_shl(gate.into()).unwrap_or(0)
}

/// Why a servo's drives did not come up. None of them has power.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NotUp {
    /// The drive group of this index failed.
    Group(usize, BringUpError),
    /// Somebody used the [`StopRequest`].
    Stopped,
}

impl StopRequest {
    /// Asks. From any thread, or from a signal handler.
    pub fn request(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether anybody asked.
    pub fn is_requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl Servo {
    /// A servo for `groups`, with one link per effector of `config`, in its order.
    pub fn new(
        config: &ServoConfig,
        groups: Vec<Box<dyn DriveGroup>>,
    ) -> Result<(Self, Vec<EffectorLink>), ServoError> {
        let axes: Vec<usize> = groups.iter().map(|group| group.axes()).collect();
        config.check(&axes)?;
        let delays: Vec<usize> = groups.iter().map(|group| group.delay()).collect();
        let effectors = config.effectors.iter().zip(0..);
        let (effectors, links) = effectors
            .map(|(config, index)| Effector::new(index, config, &delays))
            .unzip();
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
            gates: Gates::default(),
            recorder: None,
            cycles: 0,
            sent: None,
            missed: 0,
            missed_in_row: 0,
            missed_ever: 0,
        };
        Ok((servo, links))
    }

    /// Moves the bring-up of every group forward; call it every period until it is ready.
    pub fn bring_up(&mut self, now: Instant) -> Poll<Result<(), NotUp>> {
        if self.stop.is_requested() {
            return Poll::Ready(Err(NotUp::Stopped));
        }
        let mut up = true;
        for (index, group) in self.groups.iter_mut().enumerate().filter(|(_, g)| !g.is_up) {
            match group.drives.bring_up(now) {
                Poll::Ready(Ok(())) => group.is_up = true,
                Poll::Ready(Err(error)) => {
                    return Poll::Ready(Err(NotUp::Group(index, error)));
                }
                Poll::Pending => up = false,
            }
        }
        if up {
            Poll::Ready(Ok(()))
        } else {
            Poll::Pending
        }
    }

    /// One cycle. Only once [`bring_up`](Self::bring_up) is ready.
    pub fn step(&mut self, now: Instant) {
        self.prepare(now);
        self.send(now);
    }

    /// Everything of a cycle but its sending; `now` is the time of its SYNC, or shortly before.
    #[cfg_attr(mrroc_rtsan, sanitize(realtime = "nonblocking"))]
    pub fn prepare(&mut self, now: Instant) {
        self.read(now);
        self.compute(now);
        self.write(now);
    }

    /// Takes in what the drives sampled: the first part of [`prepare`](Self::prepare), for a caller that times each.
    pub fn read(&mut self, now: Instant) {
        for group in &mut self.groups {
            group.drives.read(now, &mut group.states);
        }
    }

    /// Finds the set-points and vets them: the second part, which touches no bus.
    pub fn compute(&mut self, now: Instant) {
        let tick = self.tick(now);
        for effector in &mut self.effectors {
            effector.set_states(|group, index| self.groups[group].states[index], &tick);
            let refused = effector.groups().map(|group| self.groups[group].refused());
            let tick = Tick {
                refused: refused.max().unwrap_or(0),
                ..tick
            };
            effector.step(&tick);
            for (group, index, command) in effector.commands() {
                self.groups[group].commands[index] = command;
            }
            if let Some(recorder) = &mut self.recorder {
                recorder.record(Record {
                    dt: self.sent.map_or(Duration::ZERO, |sent| now.since(sent)),
                    ..effector.record(&tick)
                });
            }
        }
    }

    /// Hands the set-points to the buses, which keep them until [`send`](Self::send): the third part.
    pub fn write(&mut self, now: Instant) {
        for group in &mut self.groups {
            group.drives.write(now, &group.commands);
        }
    }

    /// Sends SYNC and what was prepared, on every bus.
    ///
    /// After a refused batch the next cycle repeats the set-points of every effector with an axis on that bus. The motion
    /// of these effectors is then late by a period, and no drive is ever handed two steps at once. Other effectors go on.
    /// A bus whose axes all have a fault holds up nothing.
    #[cfg_attr(mrroc_rtsan, sanitize(realtime = "nonblocking"))]
    pub fn send(&mut self, now: Instant) {
        self.sent = Some(now);
        for group in &mut self.groups {
            let taken = group.drives.send(now);
            group.refused_in_row = if taken {
                0
            } else {
                group.refused_in_row.saturating_add(1)
            };
        }
    }

    /// Says that `count` deadlines passed without a cycle since the last one.
    ///
    /// Cycles that each missed some count as one row; a punctual one ends it. A row longer than
    /// [`ServoConfig::max_missed_in_row`] is a fault of every effector: its drives have stood at their last
    /// set-points, and there it stops.
    pub fn missed(&mut self, count: u32) {
        self.missed = self.missed.saturating_add(count);
    }

    /// Says that `count` deadlines passed while the cell's own time stood still: they are counted and
    /// have no other effect.
    pub fn slipped(&mut self, count: u32) {
        self.missed_ever += u64::from(count);
    }

    fn tick(&mut self, now: Instant) -> Tick {
        let missed = std::mem::take(&mut self.missed);
        self.missed_ever += u64::from(missed);
        let row = if missed == 0 {
            0
        } else {
            self.missed_in_row.saturating_add(missed)
        };
        self.missed_in_row = row;
        let number = self.cycles;
        self.cycles += 1;
        Tick {
            number,
            now,
            dt: self.period.as_secs_f64(),
            periods: missed.saturating_add(1),
            stop: self.stop.is_requested(),
            open: self.gates.open_ones(),
            overrun: (row > self.max_missed_in_row).then_some(row),
            refused: 0,
        }
    }

    /// Takes the power from every axis without braking it first (category 0).
    ///
    /// For when the cycle itself cannot be trusted any more. A drive obeys what it latched at a
    /// SYNC, so two of these a period apart are the least.
    #[cfg_attr(mrroc_rtsan, sanitize(realtime = "nonblocking"))]
    pub fn cut_power(&mut self, now: Instant) {
        for group in &mut self.groups {
            group.commands.fill(AxisCommand::Off);
            group.drives.write(now, &group.commands);
            group.drives.send(now);
        }
    }

    /// Begins a recording of at most `capacity` records, one per effector and cycle. Drain it from
    /// another thread; what does not fit is counted.
    pub fn record(&mut self, capacity: usize) -> rtrb::Consumer<Record> {
        let (recorder, records) = Recorder::new(capacity);
        self.recorder = Some(recorder);
        records
    }

    /// Excites axis `axis` of effector `effector` while the effector carries out the macrosteps that the excitation
    /// is for; to be called before the cycles begin, and once more to change it. Nothing is added otherwise.
    ///
    /// All the guards of the axis stay in force. An excitation beyond a quarter of what its loop may put out is
    /// refused; where the drive closes the loop, a torque beyond a quarter of the rated one, or a position beyond a
    /// quarter of the following error or beyond the axis's acceleration.
    pub fn excite(
        &mut self,
        effector: usize,
        axis: usize,
        excitation: Excitation,
    ) -> Result<(), ExcitationError> {
        let dt = self.period.as_secs_f64();
        let found = self.effectors.get_mut(effector);
        let found = found.ok_or(ExcitationError::NoSuchAxis { effector, axis })?;
        found.excite(axis, excitation, dt)
    }

    /// A handle that opens the gates that effectors wait at.
    pub fn gates(&self) -> Gates {
        self.gates.clone()
    }

    /// A handle that stops everything.
    pub fn stop_request(&self) -> StopRequest {
        self.stop.clone()
    }

    /// Time from one SYNC to the next.
    pub fn period(&self) -> Duration {
        self.period
    }

    /// What effector `index` does; `None` if there is no such effector.
    pub fn state(&self, index: usize) -> Option<State> {
        self.effectors.get(index).map(Effector::state)
    }

    /// Why effector `index` was stopped, if it was.
    pub fn fault(&self, index: usize) -> Option<ServoFault> {
        self.effectors.get(index).and_then(Effector::fault)
    }

    /// Whether every effector is off or faulted and no drive of theirs says that it has power.
    pub fn is_off(&self) -> bool {
        self.effectors.iter().all(|effector| {
            matches!(effector.state(), State::Off | State::Faulted) && !effector.has_power()
        })
    }

    /// The longest that stopping any effector takes: its set-points, then its drives.
    pub fn longest_stop(&self) -> Duration {
        let longest = self.effectors.iter().map(Effector::longest_stop).max();
        longest.unwrap_or_default().saturating_mul(2)
    }

    /// How far the axes of effector `index` were from their commands; empty if there is no such
    /// effector.
    pub fn tracking(&self, index: usize) -> impl Iterator<Item = TrackingError> {
        self.effectors
            .get(index)
            .into_iter()
            .flat_map(Effector::tracking)
    }

    /// How far the counters of the axes of effector `index` were moved when homing found the reference,
    /// increments, to about one cycle's motion: what the counter since power-on showed there. `None`
    /// for an axis that did not home in this run.
    pub fn homing_offsets(&self, index: usize) -> impl Iterator<Item = Option<i64>> {
        self.effectors
            .get(index)
            .into_iter()
            .flat_map(Effector::homing_offsets)
    }

    /// What was counted so far.
    pub fn counters(&self) -> Counters {
        let mut sum = Counters {
            cycles: self.cycles,
            missed_cycles: self.missed_ever,
            dropped_records: self.recorder.as_ref().map_or(0, Recorder::dropped),
            ..Counters::default()
        };
        for counters in self.effectors.iter().map(Effector::counters) {
            sum.macrosteps += counters.macrosteps;
            sum.refused_orders += counters.refused_orders;
            sum.dropped_reports += counters.dropped_reports;
        }
        sum
    }

    /// What the drives of each group have reported while they went on.
    pub fn warnings(&self) -> impl Iterator<Item = &Warnings> {
        self.groups.iter().map(|group| group.drives.warnings())
    }

    /// What each group counted so far.
    pub fn group_counters(&self) -> impl Iterator<Item = GroupCounters> {
        self.groups.iter().map(|group| group.drives.counters())
    }
}

#[cfg(test)]
mod tests;
