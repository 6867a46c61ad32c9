//! Age of the answers of all drives of a bus: measured at the end of bring-up, and proven in operation.
//!
//! At the end of bring-up, a SYNC stands alone until every drive has answered, so the latency of TPDO 1 is measured without
//! ambiguity. In operation, a SYNC is left out, with all set-points of its cycle, if answers of a drive were missing and have
//! come back ([`cia402`](crate::cia402), `answer_age`). The motion continues one period later.

use std::time::Duration;

use can::{Instant, Port};
use canopen::sync::Sync;

use super::CanBus;
use crate::cia402::Oddity;
use crate::{AxisCommand, BringUpError, Warning, WarningCause};

/// Least time between two SYNCs that are left out.
const APART: Duration = Duration::from_secs(1);

/// Greatest number of SYNCs that stand alone. A single late answer may be the fault of the host.
const ROUNDS: u32 = 5;

/// Least time in which an answer to a SYNC that stands alone is awaited.
const LONGEST_AT_LEAST: Duration = Duration::from_millis(100);

/// The SYNCs of bring-up that stand alone.
#[derive(Clone, Debug, Default)]
pub(super) struct LoneSyncs {
    /// Every sensor of the bus is ready, and needs no further SYNC.
    sensors: bool,
    /// Time of the SYNC whose answers are awaited.
    sent: Option<Instant>,
    rounds: u32,
    /// Of each drive: the shortest latency, and whether the present SYNC was answered.
    drives: Vec<(Option<Duration>, bool)>,
}

impl LoneSyncs {
    pub(super) fn of(drives: usize) -> Self {
        Self { drives: vec![(None, false); drives], ..Self::default() }
    }

    pub(super) fn reset(&mut self) {
        (self.sensors, self.sent, self.rounds) = (false, None, 0);
        self.drives.fill((None, false));
    }

    /// Takes the answer of a drive. Only the first answer to a SYNC counts.
    pub(super) fn answered(&mut self, drive: usize, at: Instant) {
        let (shortest, answered) = &mut self.drives[drive];
        let Some(sent) = self.sent.filter(|sent| !*answered && at >= *sent) else { return };
        let latency = at.since(sent);
        *answered = true;
        *shortest = Some(shortest.map_or(latency, |shortest| shortest.min(latency)));
    }

    /// Latencies of the drives; zero for a drive that was not measured.
    fn latencies(&self) -> impl Iterator<Item = Duration> {
        self.drives.iter().map(|(shortest, _)| shortest.unwrap_or_default())
    }
}

impl<P: Port> CanBus<P> {
    /// Whether bring-up has measured the latency of every drive, after all sensors are ready. Sends SYNCs that stand alone
    /// until then. A latency that the loop of an axis does not permit is an error.
    pub(super) fn latencies_are_known(&mut self, now: Instant) -> Result<bool, BringUpError> {
        if !self.lone.sensors {
            self.lone.sensors = self.sensors_are_ready(now)?;
        }
        if !self.lone.sensors {
            return Ok(false);
        }
        let longest = LONGEST_AT_LEAST.max(self.config.tolerated_missing.saturating_add(2) * self.config.period);
        let Some(sent) = self.lone.sent else {
            // The answers to the SYNCs of the sensors.
            let quiet = self.syncs.last.is_none_or(|last| now.since(last) >= longest);
            if quiet && !self.lone.drives.is_empty() && self.port.send(now, &[Sync::default().encode()])? > 0 {
                self.lone.sent = Some(now);
                self.lone.rounds += 1;
                self.lone.drives.iter_mut().for_each(|(_, answered)| *answered = false);
            }
            return Ok(self.lone.drives.is_empty());
        };
        let waited = now.since(sent);
        if waited <= longest && self.lone.drives.iter().any(|(_, answered)| !answered) {
            return Ok(false);
        }
        self.lone.sent = None;
        let in_time = |(shortest, _): &(Option<Duration>, bool)| shortest.is_some_and(|it| it <= self.config.period);
        if self.lone.rounds < ROUNDS && !self.lone.drives.iter().all(in_time) {
            return Ok(false);
        }
        for (drive, (shortest, _)) in self.lone.drives.iter().enumerate() {
            let (node, most) = (self.drives.node(drive), self.drives.tolerated_latency(drive, &self.config));
            match *shortest {
                None => return Err(BringUpError::NoAnswer { node, waited: longest }),
                Some(latency) if latency > most => return Err(BringUpError::Late { node, latency, most }),
                Some(_) => {}
            }
        }
        Ok(true)
    }

    /// Periods by which the answers of each drive are late, as bring-up measured. A latency above a period is a warning.
    pub(super) fn measured_lags(&mut self) -> Vec<u32> {
        let period = self.config.period.as_nanos().max(1);
        let mut lags = Vec::with_capacity(self.lone.drives.len());
        for (drive, latency) in self.lone.latencies().enumerate() {
            let periods = u32::try_from(latency.as_nanos().saturating_sub(1) / period).unwrap_or(u32::MAX);
            lags.push(periods);
            if periods > 0 {
                let (node, cause) = (self.drives.node(drive), WarningCause::Late { periods, latency });
                self.warnings.add(Warning { after: Duration::ZERO, node, cause, count: 1 });
            }
        }
        lags
    }

    /// Decides whether the SYNC of this cycle is left out: at most once a second, and never while the bus takes or answers
    /// nothing.
    pub(super) fn consider_proof(&mut self, now: Instant, commands: &[AxisCommand]) {
        let due = self.proved_at.is_none_or(|proved| now.since(proved) >= APART);
        self.leaves_out = due && self.needs_sync && self.is_answered_and_taken() && self.drives.ask_for_proof(commands);
        if self.leaves_out {
            self.proved_at = Some(now);
        }
    }

    /// Begins the period of the batch that was handed over, and notes what the answers of earlier periods show.
    pub(super) fn begin_period(&mut self, now: Instant, synced: bool) {
        let leaves_out = std::mem::take(&mut self.leaves_out);
        let after = now.since(self.up_since);
        let warnings = &mut self.warnings;
        self.drives.begin_period(synced, leaves_out, &self.config, |oddity| {
            let (node, cause, count) = match oddity {
                Oddity::Late { node, periods, latency } => (node, WarningCause::Late { periods, latency }, 1),
                Oddity::Surplus { node, answers } => (node, WarningCause::Surplus, u64::from(answers)),
            };
            warnings.add(Warning { after, node, cause, count });
        });
    }
}
