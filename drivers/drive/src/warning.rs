//! Warnings: errors that drives and I/O nodes report without a fault, counted and bounded.

use std::time::Duration;

use canopen::cia402::FaultTable;
use thiserror::Error;

/// An error reported by EMCY without a fault since the start of operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "node {node}: EMCY {code:#06x} ({text}), error register {register:#04x}",
    text = .table.text(*.code)
)]
pub struct Warning {
    /// Time from the start of operation to the first report.
    pub after: Duration,
    /// Node-ID.
    pub node: u8,
    /// Error code.
    pub code: u16,
    /// Meaning of the error code.
    pub table: FaultTable,
    /// Object 0x1001.
    pub register: u8,
    /// How often the node reported the error.
    pub count: u64,
}

/// The warnings of a group: the first [`KEPT`](Self::KEPT) different ones, and the number of reports that had no room.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Warnings {
    kept: Vec<Warning>,
    omitted: u64,
}

impl Warnings {
    /// Greatest number of different warnings.
    pub const KEPT: usize = 32;

    pub(crate) const NONE: Self = Self { kept: Vec::new(), omitted: 0 };

    /// No warning, with reserved room for later ones.
    pub(crate) fn with_room() -> Self {
        Self { kept: Vec::with_capacity(Self::KEPT), omitted: 0 }
    }

    pub(crate) fn clear(&mut self) {
        self.kept.clear();
        self.omitted = 0;
    }

    /// Adds a report. A report of the same node, code and register as an earlier one increases its count.
    pub(crate) fn add(&mut self, warning: Warning) {
        let kind = |it: &Warning| (it.node, it.code, it.register);
        let mut kept = self.kept.iter();
        match kept.position(|kept| kind(kept) == kind(&warning)) {
            Some(same) => self.kept[same].count += warning.count,
            None if self.kept.len() < Self::KEPT => self.kept.push(warning),
            None => self.omitted += warning.count,
        }
    }

    /// Removes the last report of `code` by `node`, because the drive has a fault of this code.
    pub(crate) fn explain(&mut self, node: u8, code: u16) {
        let mut kept = self.kept.iter();
        let last = kept.rposition(|kept| (kept.node, kept.code) == (node, code));
        let Some(last) = last else { return };
        self.kept[last].count -= 1;
        if self.kept[last].count == 0 {
            self.kept.remove(last);
        }
    }

    /// The warnings, in the order of their first report.
    pub fn iter(&self) -> impl Iterator<Item = &Warning> {
        self.kept.iter()
    }

    /// Reports for which there was no room.
    pub fn omitted(&self) -> u64 {
        self.omitted
    }
}
