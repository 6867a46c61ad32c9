//! Runs of a library without the feature `recording`: nothing is recorded.

use std::sync::Arc;

use can::{Instant, InterfaceName, TraceEntry};
use controller::sensor::ForceTorque;
use drive::device::DeviceSample;
use serial::LineEntry;
use servo::{Record, Servo};

use super::{Requests, RunOptions};
use crate::cell::CellFile;
use crate::outputs::Outputs;
use crate::row_file::IncompleteFile;
use crate::setup::Devices;

/// No recording. [`RunOptions::check`] has refused a file of one.
pub(super) struct Recording;

impl Recording {
    pub(super) fn open(_: &mut Outputs, _: &RunOptions, _: &CellFile) -> anyhow::Result<Self> {
        Ok(Self)
    }

    pub(super) fn find_flights(&mut self, _: &CellFile, _: &RunOptions) -> anyhow::Result<()> {
        Ok(())
    }

    pub(super) fn is_streamed(&self) -> bool {
        false
    }

    pub(super) fn is_wanted(&self) -> bool {
        false
    }

    pub(super) fn begin(
        self,
        _: &Arc<CellFile>,
        _: (&RunOptions, &Requests, Option<u64>),
        _: &mut Servo,
        _: (&Devices, &[ForceTorque]),
        _: &[InterfaceName],
    ) -> anyhow::Result<Option<Recorder>> {
        Ok(None)
    }
}

/// The recorder of a run, of which there is none.
pub(super) enum Recorder {}

impl Recorder {
    pub(super) fn drain_journal(&mut self) {
        match *self {}
    }

    pub(super) fn record(&mut self, _: &Record) {
        match *self {}
    }

    pub(super) fn bus(&mut self, _: usize, _: &TraceEntry) {
        match *self {}
    }

    pub(super) fn line(&mut self, _: usize, _: &LineEntry) {
        match *self {}
    }

    pub(super) fn sample(&mut self, _: usize, _: Instant, _: Option<&DeviceSample>) {
        match *self {}
    }

    pub(super) fn drained(&mut self, _: u64) {
        match *self {}
    }

    pub(super) fn finish(self, _: u64, _: bool) -> Vec<IncompleteFile> {
        match self {}
    }
}
