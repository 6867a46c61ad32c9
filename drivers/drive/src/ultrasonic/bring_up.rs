//! Bring-up of an ultrasonic matrix.

use can::Instant;
use serial::Line;
use serial::ultrasonic::{IDENTIFY, Reply, Request};

use super::config::UltrasonicConfig;
use super::fault::UltrasonicError;
use super::receiver::Receiver;

/// Bring-up of a matrix: the driver drains the line, requests the identity and compares the identity.
///
/// ```text
/// drain ──quiet for a period──► asked ──identity──► ready, or another matrix
///   ▲                             │
///   └──── other frames, or no answer in time
/// ```
///
/// A matrix ignores requests during a measurement. The request is therefore repeated until
/// [`UltrasonicConfig::boot_timeout`].
#[derive(Clone, Debug)]
pub(super) struct BringUp {
    config: UltrasonicConfig,
    stage: Stage,
    receiver: Receiver,
    begun: Instant,
    bytes: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// The last byte was read at `since`.
    Draining { since: Instant },
    /// The request was sent at `at`.
    Asked { at: Instant },
}

impl BringUp {
    /// Begins at `now`. The configuration is checked.
    pub(super) fn new(config: &UltrasonicConfig, now: Instant) -> Self {
        Self { config: *config, stage: Stage::Draining { since: now }, receiver: Receiver::new(), begun: now, bytes: 0 }
    }

    /// Reads the line and asks. Returns whether the matrix is ready.
    pub(super) fn advance(
        &mut self,
        line: &mut impl Line,
        buffer: &mut [u8],
        now: Instant,
    ) -> Result<bool, UltrasonicError> {
        let count = line.read(now, buffer).map_err(UltrasonicError::Line)?;
        self.bytes = self.bytes.saturating_add(count as u32);
        match self.stage {
            Stage::Draining { .. } if count > 0 => self.stage = Stage::Draining { since: now },
            Stage::Draining { since } if now.since(since) >= self.config.period => {
                let (frame, length) = Request::Identify.encode();
                // A request that the line does not accept ends like a request without an answer.
                line.write(now, &frame[..length]).map_err(UltrasonicError::Line)?;
                self.receiver.restart();
                self.stage = Stage::Asked { at: now };
            }
            Stage::Draining { .. } => {}
            Stage::Asked { at } => {
                for byte in &buffer[..count] {
                    match self.receiver.receive(*byte).and_then(Reply::decode) {
                        Some(Reply::Identity { size, pitch, slot }) => {
                            return compare(&self.config, size, pitch, slot).map(|()| true);
                        }
                        Some(Reply::Refusal { command: IDENTIFY, reason }) => {
                            return Err(UltrasonicError::Refused { reason: reason.code() });
                        }
                        // A reply to a query before the bring-up.
                        Some(Reply::Pair { .. } | Reply::Row { .. } | Reply::Refusal { .. }) | None => {}
                    }
                }
                if now.since(at) >= self.config.answer_timeout(Request::Identify) {
                    line.discard_unsent();
                    self.stage = Stage::Draining { since: now };
                }
            }
        }
        let waited = now.since(self.begun);
        if waited > self.config.boot_timeout {
            return Err(match self.bytes {
                0 => UltrasonicError::Absent { waited },
                bytes => UltrasonicError::Garbled { bytes },
            });
        }
        Ok(false)
    }
}

fn compare(config: &UltrasonicConfig, size: u8, pitch: u16, slot: u16) -> Result<(), UltrasonicError> {
    if size != config.size {
        return Err(UltrasonicError::OfAnotherSize { declared: config.size, found: size });
    }
    let declared = config.pitch_on_wire();
    if pitch != declared {
        return Err(UltrasonicError::OfAnotherPitch { declared, found: pitch });
    }
    let declared = config.slot_on_wire();
    if slot != declared {
        return Err(UltrasonicError::OfAnotherSlot { declared, found: slot });
    }
    Ok(())
}
