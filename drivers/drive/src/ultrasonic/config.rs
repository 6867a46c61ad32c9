//! Configuration of an ultrasonic matrix, and the checks made before the first byte.

use std::time::Duration;

use serde::{Deserialize, Serialize};
use serial::Settings;
use serial::ultrasonic::{FRAME, MAX_REQUEST, Request, SETTINGS};
use thiserror::Error;

use super::state::{MOST_ECHOES, MOST_SHOTS};

/// Least time by which a reply may exceed its computed time, for the delays of matrix, adapter and tty.
const SPARE: Duration = Duration::from_millis(20);

/// The echoes of a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum ScanKind {
    /// Each element listens to its own emission. A shot is one row; a matrix has up to 16 rows.
    #[default]
    Rows,
    /// All elements listen to all emissions. A shot is one emitter; a matrix has up to 4 × 4 elements.
    Pairs,
}

/// Configuration of a matrix and of its line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UltrasonicConfig {
    /// Period of the servo cycle.
    pub period: Duration,
    /// Settings of the line.
    pub settings: Settings,
    /// Elements per row and column.
    pub size: u8,
    /// Distance between neighbouring elements, m, up to 6.5 m.
    pub pitch: f64,
    /// Firing slot: duration of one emission with its echoes.
    pub slot: Duration,
    /// The echoes of a scan.
    pub scan: ScanKind,
    /// Number of queries in a row that may remain without a valid reply. One more is a fault.
    pub tolerated_missing: u32,
    /// Time limit of bring-up, from its start to the identity.
    pub boot_timeout: Duration,
}

/// Why a configuration is refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum UltrasonicConfigError {
    #[error("{size} elements per row, must be 1 to {most} for this kind of scan")]
    Size { size: u8, most: u8 },
    #[error("a pitch of {pitch} m, must be 0.1 mm to 6.5 m")]
    Pitch { pitch: f64 },
    #[error("a firing slot of {slot:?}, must be 1 to 65534 µs")]
    Slot { slot: Duration },
    #[error("a servo period of zero")]
    Period,
}

impl UltrasonicConfig {
    /// A matrix of the factory settings: 12 × 12 elements, 20 mm apart, slots of 3.5 ms, scanned by rows.
    pub fn new(period: Duration) -> Self {
        Self {
            period,
            settings: SETTINGS,
            size: 12,
            pitch: 0.02,
            slot: Duration::from_micros(3_500),
            scan: ScanKind::Rows,
            tolerated_missing: 3,
            boot_timeout: Duration::from_secs(2),
        }
    }

    /// Checks the numbers.
    pub fn check(&self) -> Result<(), UltrasonicConfigError> {
        let most = match self.scan {
            ScanKind::Rows => MOST_SHOTS as u8,
            ScanKind::Pairs => 4,
        };
        let Self { size, pitch, slot, .. } = *self;
        if !(1..=most).contains(&size) {
            return Err(UltrasonicConfigError::Size { size, most });
        }
        if !(1e-4..=6.5).contains(&pitch) {
            return Err(UltrasonicConfigError::Pitch { pitch });
        }
        if !(1..=65_534).contains(&slot.as_micros()) {
            return Err(UltrasonicConfigError::Slot { slot });
        }
        if self.period.is_zero() {
            return Err(UltrasonicConfigError::Period);
        }
        Ok(())
    }

    /// Number of shots of a scan, and number of echo times of a shot.
    pub fn shots(&self) -> (usize, usize) {
        let size = usize::from(self.size);
        let (shots, echoes) = match self.scan {
            ScanKind::Rows => (size, size),
            ScanKind::Pairs => (size * size, size * size),
        };
        (shots.min(MOST_SHOTS), echoes.min(MOST_ECHOES))
    }

    /// Query number `number` of a scan.
    pub fn query(&self, number: usize) -> Request {
        match self.scan {
            ScanKind::Rows => Request::Row(number as u8),
            ScanKind::Pairs => {
                let elements = usize::from(self.size).pow(2);
                let element = |number: usize| {
                    let size = usize::from(self.size);
                    ((number / size) as u8, (number % size) as u8)
                };
                Request::Pair { emitter: element(number / elements), receiver: element(number % elements) }
            }
        }
    }

    /// Number of queries of a scan.
    pub fn queries(&self) -> usize {
        let (shots, echoes) = self.shots();
        match self.scan {
            ScanKind::Rows => shots,
            ScanKind::Pairs => shots * echoes,
        }
    }

    /// Longest time from sending a query to the end of its reply.
    pub fn answer_timeout(&self, query: Request) -> Duration {
        let emissions = match query {
            Request::Identify => 0,
            Request::Pair { .. } => 1,
            Request::Row(_) => u32::from(self.size),
        };
        let bytes = MAX_REQUEST + FRAME + query.reply_length(self.size);
        self.slot * emissions + self.settings.line_time(bytes) + 2 * self.period + SPARE
    }

    /// Duration of a scan without lost queries: emissions, bytes, and up to two servo periods per query.
    pub fn scan_time(&self) -> Duration {
        let query = self.query(0);
        let emissions = if self.scan == ScanKind::Rows { u32::from(self.size) } else { 1 };
        let bytes = query.encode().1 + query.reply_length(self.size);
        let exchange = self.slot * emissions + self.settings.line_time(bytes) + 2 * self.period;
        exchange * self.queries() as u32
    }

    /// Pitch as the matrix reports it, 0.1 mm.
    pub(super) fn pitch_on_wire(&self) -> u16 {
        (self.pitch * 1e4).round() as u16
    }

    /// Firing slot as the matrix reports it, µs.
    pub(super) fn slot_on_wire(&self) -> u16 {
        self.slot.as_micros().try_into().unwrap_or(u16::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn configurations_beyond_the_scan_or_the_wire_are_refused() {
        let usual = UltrasonicConfig::new(Duration::from_millis(2));
        assert_eq!(usual.check(), Ok(()));
        let pairs = UltrasonicConfig { scan: ScanKind::Pairs, ..usual };
        let bad = [
            (UltrasonicConfig { size: 0, ..usual }, UltrasonicConfigError::Size { size: 0, most: 16 }),
            (UltrasonicConfig { size: 17, ..usual }, UltrasonicConfigError::Size { size: 17, most: 16 }),
            (pairs, UltrasonicConfigError::Size { size: 12, most: 4 }),
            (UltrasonicConfig { pitch: 0.0, ..usual }, UltrasonicConfigError::Pitch { pitch: 0.0 }),
            (UltrasonicConfig { slot: Duration::ZERO, ..usual }, UltrasonicConfigError::Slot { slot: Duration::ZERO }),
            (UltrasonicConfig { period: Duration::ZERO, ..usual }, UltrasonicConfigError::Period),
        ];
        for (config, error) in bad {
            assert_eq!(config.check(), Err(error));
        }
        assert!(UltrasonicConfig { pitch: f64::NAN, ..usual }.check().is_err());
    }

    #[test]
    fn a_scan_of_pairs_asks_for_each_pair_once() {
        let config =
            UltrasonicConfig { size: 3, scan: ScanKind::Pairs, ..UltrasonicConfig::new(Duration::from_millis(2)) };
        assert_eq!(config.queries(), 81);
        assert_eq!(config.query(0), Request::Pair { emitter: (0, 0), receiver: (0, 0) });
        assert_eq!(config.query(1), Request::Pair { emitter: (0, 0), receiver: (0, 1) });
        assert_eq!(config.query(80), Request::Pair { emitter: (2, 2), receiver: (2, 2) });
        let mut queries: Vec<_> = (0..81).map(|number| format!("{:?}", config.query(number))).collect();
        queries.sort();
        queries.dedup();
        assert_eq!(queries.len(), 81);
    }
}
