//! Inputs: terminal, filter, polarity, and the interrupts that trigger TPDOs (CiA 401).
//!
//! ```text
//! edges, light gates, scene ──► terminal ──► filter 0x6003 ──► polarity 0x6002 ──► 0x6000
//!                                                                                     │ change
//!                                 TPDO event ◄── 0x6005 ◄── 0x6006, 0x6007, 0x6008 ◄──┘
//! ```

use std::collections::VecDeque;
use std::time::Duration;

use can::Instant;
use canopen::Object;

use super::config::{InputEdge, LightGate};
use super::lines::{Lines, bit};
use super::probe::InputProbe;
use super::table;
use crate::node::objects::Objects;
use crate::node::table::{Entry, Slot};

/// Interval between two looks of the light gates.
const LOOK: Duration = Duration::from_millis(1);

#[derive(Debug)]
pub(super) struct Inputs {
    objects: InputObjects,
    /// Levels at the terminals, and behind the filter.
    pub(super) terminals: u64,
    filtered: u64,
    /// Time since which a terminal has differed from its filtered level.
    differs_since: [Option<Instant>; 64],
    filter_time: Duration,
    /// Edges to come, in ascending order.
    edges: VecDeque<InputEdge>,
    gates: Vec<LightGate>,
    /// Inputs with levels of the scene, and the last level of each.
    probes: Vec<(u8, InputProbe, bool)>,
    /// Time of the next look of the light gates.
    look_at: Instant,
    /// Time up to which the inputs have been simulated.
    now: Instant,
}

#[derive(Debug)]
struct InputObjects {
    read: Lines,
    polarity: Lines,
    filter: Lines,
    enable: Slot,
    any_change: Lines,
    low_to_high: Lines,
    high_to_low: Lines,
}

impl InputObjects {
    fn of(table: &[Entry], bytes: u8) -> Option<Self> {
        let lines = |index| Lines::of(table, index, bytes);
        Some(Self {
            read: lines(table::READ_INPUT)?,
            polarity: lines(table::POLARITY_INPUT)?,
            filter: lines(table::FILTER_CONSTANT)?,
            enable: Slot::find(table, Object::new(table::INTERRUPT_ENABLE, 0))?,
            any_change: lines(table::ANY_CHANGE)?,
            low_to_high: lines(table::LOW_TO_HIGH)?,
            high_to_low: lines(table::HIGH_TO_LOW)?,
        })
    }
}

impl Inputs {
    /// Inputs at `now`, all low; `None` for a module without inputs.
    pub(super) fn new(
        table: &[Entry],
        bytes: u8,
        filter_time: Duration,
        mut edges: Vec<InputEdge>,
        gates: Vec<LightGate>,
        probes: Vec<(u8, InputProbe)>,
        now: Instant,
    ) -> Option<Self> {
        edges.sort_by_key(|edge| edge.at);
        Some(Self {
            objects: InputObjects::of(table, bytes)?,
            terminals: 0,
            filtered: 0,
            differs_since: [None; 64],
            filter_time,
            edges: edges.into(),
            gates,
            probes: probes.into_iter().map(|(index, probe)| (index, probe, false)).collect(),
            look_at: now,
            now,
        })
    }

    /// Adds an edge. An edge in the past occurs at once.
    pub(super) fn schedule(&mut self, edge: InputEdge) {
        let at = self.edges.partition_point(|other| other.at <= edge.at);
        self.edges.insert(at, edge);
    }

    /// Takes over the levels that the scene computed for `now`. Returns whether a level has changed.
    pub(super) fn sense(&mut self, now: Instant) -> bool {
        let mut has_changed = false;
        for (index, probe, last) in &mut self.probes {
            let level = probe.level();
            if level != *last {
                *last = level;
                let at = self.edges.partition_point(|other| other.at <= now);
                self.edges.insert(at, InputEdge { at: now, index: *index, level });
                has_changed = true;
            }
        }
        has_changed
    }

    /// Time of the next edge, look or end of a filter time.
    pub(super) fn poll_timeout(&self) -> Option<Instant> {
        let edge = self.edges.front().map(|edge| edge.at);
        let look = (!self.gates.is_empty()).then_some(self.look_at);
        let filters = self.differs_since.iter().flatten().map(|since| *since + self.filter_time);
        filters.chain(edge).chain(look).min()
    }

    /// Advances the inputs to `now`, each event at its own time.
    pub(super) fn advance(&mut self, now: Instant, objects: &mut Objects) {
        while let Some(at) = self.poll_timeout().filter(|at| *at <= now) {
            self.now = self.now.max(at);
            while let Some(edge) = self.edges.front().copied().filter(|edge| edge.at <= self.now) {
                self.edges.pop_front();
                self.set_terminal(edge.index, edge.level);
            }
            if self.look_at <= self.now {
                self.look_at = self.now + LOOK;
                for number in 0..self.gates.len() {
                    let (index, level) = (self.gates[number].index, self.gates[number].level());
                    self.set_terminal(index, level);
                }
            }
            self.update(objects);
        }
        self.now = self.now.max(now);
    }

    fn set_terminal(&mut self, index: u8, level: bool) {
        if level {
            self.terminals |= bit(index);
        } else {
            self.terminals &= !bit(index);
        }
    }

    /// Passes the terminals through filter and polarity, and writes 0x6000.
    pub(super) fn update(&mut self, objects: &mut Objects) {
        let filter = self.objects.filter.get(objects);
        for (index, since) in (0..).zip(&mut self.differs_since) {
            let line = bit(index);
            if (self.terminals ^ self.filtered) & line == 0 {
                *since = None;
                continue;
            }
            let began = *since.get_or_insert(self.now);
            if filter & line == 0 || self.now.since(began) >= self.filter_time {
                self.filtered ^= line;
                *since = None;
            }
        }
        let before = self.objects.read.get(objects);
        let value = self.filtered ^ self.objects.polarity.get(objects);
        self.objects.read.set(value, objects);
        let value = self.objects.read.get(objects);
        if objects.u(self.objects.enable) == 0 {
            return;
        }
        let any = self.objects.any_change.get(objects);
        let rising = self.objects.low_to_high.get(objects) & value;
        let falling = self.objects.high_to_low.get(objects) & !value;
        let events = (before ^ value) & (any | rising | falling);
        for (byte, slot) in events.to_le_bytes().into_iter().zip(self.objects.read.slots()) {
            if byte != 0 {
                objects.count_event(slot);
            }
        }
    }
}
