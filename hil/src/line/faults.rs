//! Fault injection on a serial line.

use std::time::Duration;

use crate::plant::Noise;

/// Faults of a line in each direction. The default is no fault.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LineFaults {
    /// Seed of the random faults.
    pub seed: u64,
    /// From the host to the device.
    pub to_device: WireFaults,
    /// From the device to the host.
    pub to_host: WireFaults,
    /// Delay of all bytes from the device to the host, without a USB adapter.
    pub late: Duration,
    /// The adapter of the host accepts all bytes for the device, and sends none until the end of the fault. Then it sends
    /// all of them in order.
    pub held: bool,
    /// Greatest number of damaged telegrams, of both directions together; `None` without a limit. A telegram is a sequence
    /// of bytes without a gap.
    pub count: Option<u32>,
}

/// Faults of one direction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WireFaults {
    /// Probability that a data bit arrives inverted.
    pub bit_error_rate: f64,
    /// Probability, per byte, that the byte and all bytes that follow without a gap are lost.
    pub tear: f64,
    /// Probability, per byte, that the byte arrives twice.
    pub duplicate: f64,
    /// Permanent fault of the line, independent of the bytes sent.
    pub stuck: Option<Stuck>,
}

/// Permanent faults of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stuck {
    /// Nothing arrives.
    Silent,
    /// Every byte arrives with this value: 0x00 or 0xFF.
    At(u8),
    /// Every byte arrives with a random value: the ends have different baud rates.
    Garbled,
}

/// Telegrams that the present faults of a line damage.
#[derive(Debug, Default)]
pub(super) struct Damage {
    /// Telegrams still to damage.
    pub(super) left: Option<u32>,
    /// Telegrams that have been damaged.
    pub(super) telegrams: u64,
}

#[derive(Debug, Default)]
pub(super) struct Wire {
    faults: WireFaults,
    noise: Noise,
    /// Whether the rest of the telegram is lost.
    torn: bool,
    /// Whether the telegram counts as damaged. Its further bytes may be damaged too.
    damaged: bool,
    pub(super) corrupted: u64,
    pub(super) lost: u64,
    pub(super) duplicated: u64,
}

impl Wire {
    pub(super) fn set(&mut self, faults: WireFaults, seed: u64) {
        self.faults = faults;
        self.noise = Noise::new(seed);
        self.begin_telegram();
    }

    /// The next byte is the first of a telegram.
    pub(super) fn begin_telegram(&mut self) {
        (self.torn, self.damaged) = (false, false);
    }

    /// Whether a fault may damage the present telegram. Counts the telegram as damaged.
    pub(super) fn damages(&mut self, damage: &mut Damage) -> bool {
        if !self.damaged && damage.left != Some(0) {
            self.damaged = true;
            damage.left = damage.left.map(|left| left - 1);
            damage.telegrams += 1;
        }
        self.damaged
    }

    /// The received bytes for a sent byte: zero, one or two.
    pub(super) fn carry(&mut self, byte: u8, damage: &mut Damage) -> [Option<u8>; 2] {
        let exhausted = damage.left == Some(0) && !self.damaged;
        if exhausted || self.faults == WireFaults::default() {
            return [Some(byte), None];
        }
        let arrives = self.distort(byte);
        if arrives != [Some(byte), None] {
            self.damages(damage);
        }
        arrives
    }

    fn distort(&mut self, byte: u8) -> [Option<u8>; 2] {
        self.torn |= self.happens(self.faults.tear);
        let arrives = match self.faults.stuck {
            Some(Stuck::Silent) => None,
            _ if self.torn => None,
            Some(Stuck::At(level)) => Some(level),
            Some(Stuck::Garbled) => Some(self.noise.bits() as u8),
            None => {
                let flipped =
                    (0..8).fold(0, |flipped, bit| flipped | u8::from(self.happens(self.faults.bit_error_rate)) << bit);
                Some(byte ^ flipped)
            }
        };
        let Some(arriving) = arrives else {
            self.lost += 1;
            return [None, None];
        };
        self.corrupted += u64::from(arriving != byte);
        let again = self.happens(self.faults.duplicate);
        self.duplicated += u64::from(again);
        [arrives, arrives.filter(|_| again)]
    }

    fn happens(&mut self, probability: f64) -> bool {
        probability > 0.0 && 0.5 * (self.noise.symmetric() + 1.0) < probability
    }
}
