//! Outputs: polarity, filter mask, and error value (CiA 401).
//!
//! ```text
//! 0x6200 ──► polarity 0x6202 ──► filter mask 0x6208 ──┐
//!                                                      ├──► terminal
//! 0x6207 ──────────────────────► error mode 0x6206 ───┘
//! ```
//!
//! An error sets the outputs whose error mode is on to their error value. The others keep their level. The outputs stay
//! so until the host writes 0x6200 again.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use can::Instant;

use super::lines::{Lines, bit};
use super::table;
use crate::node::objects::Objects;
use crate::node::table::Entry;

/// Level of an output, and the time of its last change.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OutputState {
    /// Level at the terminal.
    pub level: bool,
    /// Time of the last change; `None` if the output was low from the beginning.
    pub changed_at: Option<Instant>,
}

/// Level at the terminal of one output, for a valve or a relay that the output switches. Clones read the same output.
///
/// The level is low until the probe is connected ([`DigitalIo::connect`](super::DigitalIo::connect)).
#[derive(Clone, Debug, Default)]
pub struct OutputProbe(Arc<AtomicBool>);

impl OutputProbe {
    /// Present level at the terminal.
    pub fn level(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Shows the level at the terminal.
    pub(crate) fn show(&self, level: bool) {
        self.0.store(level, Ordering::Relaxed);
    }
}

#[derive(Debug)]
pub(super) struct Outputs {
    objects: OutputObjects,
    pub(super) terminals: u64,
    changed_at: [Option<Instant>; 64],
    /// Probes with the indices of their outputs.
    probes: Vec<(u8, OutputProbe)>,
    /// Whether an error set the outputs, and 0x6200 was not written since.
    failed: bool,
    /// Whether the terminals are off because of a reset of the node.
    restarting: bool,
}

#[derive(Debug)]
struct OutputObjects {
    write: Lines,
    polarity: Lines,
    error_mode: Lines,
    error_value: Lines,
    filter_mask: Lines,
}

impl OutputObjects {
    fn of(table: &[Entry], bytes: u8) -> Option<Self> {
        let lines = |index| Lines::of(table, index, bytes);
        Some(Self {
            write: lines(table::WRITE_OUTPUT)?,
            polarity: lines(table::POLARITY_OUTPUT)?,
            error_mode: lines(table::ERROR_MODE)?,
            error_value: lines(table::ERROR_VALUE)?,
            filter_mask: lines(table::FILTER_MASK)?,
        })
    }
}

impl Outputs {
    /// Outputs of a module at power-on, all low; `None` for a module without outputs.
    pub(super) fn new(table: &[Entry], bytes: u8) -> Option<Self> {
        let objects = OutputObjects::of(table, bytes)?;
        Some(Self {
            objects,
            terminals: 0,
            changed_at: [None; 64],
            probes: Vec::new(),
            failed: false,
            restarting: true,
        })
    }

    pub(super) fn state(&self, index: u8) -> OutputState {
        let changed_at = self.changed_at.get(usize::from(index)).copied().flatten();
        OutputState { level: self.terminals & bit(index) != 0, changed_at }
    }

    /// Shows the level of output `index` in `probe` from now on.
    pub(super) fn connect(&mut self, index: u8, probe: OutputProbe) {
        probe.show(self.terminals & bit(index) != 0);
        self.probes.push((index, probe));
    }

    /// Applies a write of 0x6200, which ends the state after an error.
    pub(super) fn write(&mut self, now: Instant, objects: &Objects) {
        self.failed = false;
        self.update(now, objects);
    }

    /// Applies a write of polarity or filter mask.
    pub(super) fn update(&mut self, now: Instant, objects: &Objects) {
        if !self.failed {
            let value = self.objects.write.get(objects) ^ self.objects.polarity.get(objects);
            let mask = self.objects.filter_mask.get(objects);
            self.set(self.terminals & !mask | value & mask, now);
        }
    }

    /// Applies error mode and error value.
    pub(super) fn fail(&mut self, now: Instant, objects: &Objects) {
        self.failed = true;
        let (value, mode) = (self.objects.error_value.get(objects), self.objects.error_mode.get(objects));
        self.set(self.terminals & !mode | value & mode, now);
    }

    /// A reset of the node, or a loss of the supply, switches all outputs off.
    pub(super) fn switch_off(&mut self, now: Instant) {
        self.set(0, now);
        self.failed = false;
        self.restarting = true;
    }

    /// Boot after a reset. A reset of the communication has set the error values, and the boot keeps them.
    pub(super) fn start(&mut self, now: Instant, objects: &Objects) {
        if std::mem::take(&mut self.restarting) {
            self.update(now, objects);
        }
    }

    fn set(&mut self, terminals: u64, now: Instant) {
        let changed = self.terminals ^ terminals;
        for (index, changed_at) in (0..).zip(&mut self.changed_at) {
            if changed & bit(index) != 0 {
                *changed_at = Some(now);
            }
        }
        self.terminals = terminals;
        for (index, probe) in &self.probes {
            probe.show(terminals & bit(*index) != 0);
        }
    }
}
