//! Bring-up of a force/torque sensor on a serial line.

use can::Instant;
use serial::Line;
use serial::ati::{REPLY, REQUEST, Reply, Request};

use super::config::SerialWrenchConfig;
use super::fault::WrenchError;
use super::sampler::Sampler;

/// Number of answers that end bring-up.
const ANSWERS: u32 = 8;

/// Bring-up of a sensor: the line is drained until it is quiet, and eight queries are answered.
///
/// ```text
/// drain ──quiet for a period──► query ──14 bytes──► query … ──8 answers──► ready
///   ▲                             │
///   └─────── other bytes, or no answer in time
/// ```
///
/// The text that a sensor sends after power-on is drained. A query without an answer within
/// [`SerialWrenchConfig::answer_timeout`] is repeated. The time limit from the begin or the last answer to the next
/// answer is [`SerialWrenchConfig::boot_timeout`]. Bring-up fails if most answers took more than a period, because in
/// operation an answer must arrive within a period.
#[derive(Clone, Debug)]
pub(super) struct BringUp {
    config: SerialWrenchConfig,
    stage: Stage,
    /// Time of the last answer, or of the begin of bring-up.
    since: Instant,
    /// Number of bytes since `since` that were no answer.
    bytes: u32,
    answers: u32,
    late: u32,
    held: [u8; REPLY],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// The last byte was read at `since`.
    Draining { since: Instant },
    /// The query was sent at `at`, and `heard` bytes of the answer have been received.
    Queried { at: Instant, heard: usize, late: bool },
}

impl BringUp {
    /// Begins at `now`. The configuration is checked.
    pub(super) fn new(config: &SerialWrenchConfig, now: Instant) -> Self {
        Self {
            config: *config,
            stage: Stage::Draining { since: now },
            since: now,
            bytes: 0,
            answers: 0,
            late: 0,
            held: [0; REPLY],
        }
    }

    /// Reads the line and sends the next query. Returns whether the sensor is ready.
    pub(super) fn advance(
        &mut self,
        line: &mut impl Line,
        buffer: &mut [u8],
        sampler: &mut Sampler,
        now: Instant,
    ) -> Result<bool, WrenchError> {
        let count = line.read(now, buffer).map_err(WrenchError::Line)?;
        let period = self.config.period;
        let mut query = false;
        match self.stage {
            Stage::Draining { .. } if count > 0 => self.drain(count, now),
            Stage::Draining { since } => query = now.since(since) >= period,
            Stage::Queried { at, heard, late } => {
                let (total, waited) = (heard + count, now.since(at));
                if let Some(room) = self.held.get_mut(heard..total) {
                    room.copy_from_slice(&buffer[..count]);
                }
                if total == REPLY {
                    self.answered(at, late, sampler, now)?;
                    query = true;
                } else if total > REPLY || waited >= self.config.answer_timeout {
                    line.discard_unsent();
                    self.drain(total, now);
                } else {
                    self.stage = Stage::Queried { at, heard: total, late: late || waited >= period };
                }
            }
        }
        if self.answers >= ANSWERS && sampler.has_sample() {
            return Ok(true);
        }
        let waited = now.since(self.since);
        if waited > self.config.boot_timeout {
            return Err(match self.bytes {
                0 => WrenchError::Absent { waited, address: "baud rate" },
                bytes => WrenchError::Garbled { bytes, length: REPLY },
            });
        }
        if query {
            // A query that the line does not accept ends like a query without an answer.
            line.write(now, &Request::Query.encode()).map_err(WrenchError::Line)?;
            self.stage = Stage::Queried { at: now, heard: 0, late: false };
        }
        Ok(false)
    }

    fn drain(&mut self, bytes: usize, now: Instant) {
        self.bytes = self.bytes.saturating_add(bytes as u32);
        self.stage = Stage::Draining { since: now };
    }

    fn answered(&mut self, at: Instant, late: bool, sampler: &mut Sampler, now: Instant) -> Result<(), WrenchError> {
        let arrived = at + self.config.settings.line_time(REQUEST);
        sampler.take(Reply::decode(self.held).counts.map(i32::from), arrived);
        sampler.check_samples()?;
        (self.since, self.bytes) = (now, 0);
        self.answers += 1;
        self.late += u32::from(late);
        if self.answers == ANSWERS && self.late > ANSWERS / 2 {
            return Err(WrenchError::Late { late: self.late, answers: self.answers });
        }
        Ok(())
    }
}
