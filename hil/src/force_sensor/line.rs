//! The serial sensor: an ATI transducer behind the controller board of the IRp-6 laboratory.
//!
//! The protocol is that of the MRROC++ driver of 2005 (`ati3084MK`). The line has 115200 baud and 8N1. A request is one
//! byte without header and checksum:
//!
//! | request | effect |
//! |---|---|
//! | 0x62 `b` | the present load reads as zero from now on; no reply |
//! | 0x71 `q` | a reply of 14 bytes: six 16-bit counts, high byte first, then two bytes of unknown meaning |
//!
//! The driver ignores the last two bytes. A comment in the driver says that the board sends a message after power-on.
//! No source gives the following behaviour; the emulator chooses it:
//!
//! * The sample of a reply is taken when the last bit of the query has arrived.
//! * The message after power-on is one line of text.
//! * A query that arrives while a reply or the text is sent is lost. A bias request always takes effect.
//! * All other bytes are ignored. Before the text is sent, the board ignores every byte.
//! * The bias is one sample, including its noise.

use std::time::Duration;

use can::Instant;
use serial::{Settings, StopBits};

use super::transducer::{Transducer, counts_16};
use super::{ForceSensorError, TransducerConfig, WrenchProbe};
use crate::{LineDevice, Mechanism, outbox::Outbox};

const BIAS: u8 = b'b';
const QUERY: u8 = b'q';
/// Bytes of a reply.
const REPLY: usize = 14;

/// Configuration of a serial sensor.
#[derive(Clone, Debug)]
pub struct SerialForceSensorConfig {
    /// Time of power-on.
    pub power_on: Instant,
    /// Errors and range of the transducer.
    pub transducer: TransducerConfig,
    /// Force of one count, N.
    pub force_per_count: f64,
    /// Torque of one count, N·m.
    pub torque_per_count: f64,
    /// Last two bytes of a reply.
    pub trailer: [u8; 2],
    /// Text after power-on, with its line end. An empty text is not sent.
    pub greeting: &'static str,
    /// Delay from power-on to the first byte of the text.
    pub boot_delay: Duration,
    /// Delay from the query to the first byte of its reply.
    pub answer_delay: Duration,
}

impl SerialForceSensorConfig {
    /// A sensor with the scale of the MRROC++ driver: 10/115 N and 5/940 N·m per count.
    pub fn new(transducer: TransducerConfig) -> Self {
        Self {
            power_on: Instant::ZERO,
            transducer,
            force_per_count: 10.0 / 115.0,
            torque_per_count: 5.0 / 940.0,
            trailer: [0; 2],
            greeting: "Force/torque controller (emulated)\r\n",
            boot_delay: Duration::from_millis(50),
            answer_delay: Duration::from_micros(100),
        }
    }
}

/// A force/torque sensor at a serial line.
pub struct SerialForceSensor {
    transducer: Transducer,
    force_per_count: f64,
    torque_per_count: f64,
    trailer: [u8; 2],
    boots_at: Instant,
    answer_delay: Duration,
    outbox: Outbox,
    /// Whether a byte is on the wire.
    sending: bool,
    lost_queries: u64,
}

impl SerialForceSensor {
    /// Settings of the line: 115200 8N1.
    pub const SETTINGS: Settings = Settings { baud: 115_200, stop_bits: StopBits::One };

    /// A sensor switched on at [`SerialForceSensorConfig::power_on`].
    pub fn new(config: SerialForceSensorConfig, probe: Box<dyn WrenchProbe>) -> Result<Self, ForceSensorError> {
        let (force, torque) = (config.force_per_count, config.torque_per_count);
        if ![force, torque].iter().all(|count| count.is_finite() && *count > 0.0) {
            return Err(ForceSensorError::Count { force, torque });
        }
        let boots_at = config.power_on + config.boot_delay;
        let mut outbox = Outbox::new();
        outbox.put(boots_at, config.greeting.as_bytes());
        Ok(Self {
            transducer: Transducer::new(config.transducer, config.power_on, probe)?,
            force_per_count: force,
            torque_per_count: torque,
            trailer: config.trailer,
            boots_at,
            answer_delay: config.answer_delay,
            outbox,
            sending: false,
            lost_queries: 0,
        })
    }

    /// Number of lost queries: queries that arrived during boot, or while the text or a reply was sent.
    pub fn lost_queries(&self) -> u64 {
        self.lost_queries
    }

    fn reply(&mut self, now: Instant) -> [u8; REPLY] {
        let values = self.transducer.read(now).values;
        let mut reply = [0; REPLY];
        for (at, value) in values.into_iter().enumerate() {
            let per_count = if at < 3 { self.force_per_count } else { self.torque_per_count };
            reply[2 * at..2 * at + 2].copy_from_slice(&counts_16(value, per_count).to_be_bytes());
        }
        reply[REPLY - 2..].copy_from_slice(&self.trailer);
        reply
    }
}

impl LineDevice for SerialForceSensor {
    fn receive(&mut self, byte: u8, now: Instant) {
        self.outbox.run(now);
        let booted = now >= self.boots_at;
        let busy = self.sending || !self.outbox.is_empty();
        match byte {
            BIAS if booted => self.transducer.set_bias(now),
            QUERY if booted && !busy => {
                let reply = self.reply(now);
                self.outbox.put(now + self.answer_delay, &reply);
            }
            QUERY => self.lost_queries += 1,
            _ => {}
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<u8> {
        let byte = self.outbox.poll_transmit(now);
        // The line calls this function again when the last bit of a byte was sent.
        self.sending = byte.is_some();
        byte
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.outbox.poll_timeout()
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.outbox.run(now);
    }

    fn mechanism(&self) -> Option<&Mechanism> {
        self.transducer.mechanism()
    }
}
