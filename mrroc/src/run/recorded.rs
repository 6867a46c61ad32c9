//! The recording of a run and its flight recorder.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Context;
use can::InterfaceName;
use controller::sensor::ForceTorque;
use servo::Servo;

use super::{Requests, RunOptions};
use crate::cell::CellFile;
use crate::outputs::Outputs;
use crate::recording::{self, Facts, Flights};
use crate::setup::Devices;

pub(super) use crate::recording::Recorder;

/// Entries of the journal that a recording may lag behind the servo: some seconds.
const JOURNAL: usize = 1 << 14;

/// Orders that a recording may lag behind the servo: some seconds, and the full queues of several robots.
const ORDERS: usize = 1 << 11;

/// The files of a recording, and the directory of the flight recorder.
pub(super) struct Recording<'a> {
    stream: Option<recording::Files<'a>>,
    flight: Option<PathBuf>,
}

impl<'a> Recording<'a> {
    /// Opens the files of `--record`, if the file is a recording.
    pub(super) fn open(outputs: &mut Outputs, options: &'a RunOptions, file: &CellFile) -> anyhow::Result<Self> {
        let stream = options.recording().map(|path| recording::open(outputs, path, file)).transpose()?;
        Ok(Self { stream, flight: None })
    }

    /// Finds the directory of the flight recorder, if the run has one.
    pub(super) fn find_flights(&mut self, file: &CellFile, options: &RunOptions) -> anyhow::Result<()> {
        self.flight = recording::flight_directory(file, options)?;
        Ok(())
    }

    /// Whether the whole run is streamed to a file.
    pub(super) fn is_streamed(&self) -> bool {
        self.stream.is_some()
    }

    /// Whether anything is recorded.
    pub(super) fn is_wanted(&self) -> bool {
        self.is_streamed() || self.flight.is_some()
    }

    /// The recorder of the run, if anything is recorded. `interfaces`: names in the candump log. `utc_of_zero`: UTC of the
    /// zero of the run's times, ns since 1970.
    pub(super) fn begin(
        self,
        file: &Arc<CellFile>,
        (options, requests, utc_of_zero): (&RunOptions, &Requests, Option<u64>),
        servo: &mut Servo,
        (devices, sensors): (&Devices, &[ForceTorque]),
        interfaces: &[InterfaceName],
    ) -> anyhow::Result<Option<Recorder>> {
        if !self.is_wanted() {
            return Ok(None);
        }
        let facts = Facts::of_run(file, options.bench, utc_of_zero)?;
        let words = recording::words(devices, sensors).into_iter().map(|word| word.taken).collect();
        let journal = servo.keep_journal(JOURNAL, ORDERS, words);
        let mut recorder = Recorder::new(file, facts, journal, interfaces.to_vec());
        if let Some((path, mcap, frames)) = self.stream {
            recorder.stream_to(path, mcap, frames).with_context(|| path.display().to_string())?;
        }
        if let Some(directory) = self.flight {
            recorder.keep_window(Flights::new(file, &directory, requests.flight.clone()));
        }
        Ok(Some(recorder))
    }
}
