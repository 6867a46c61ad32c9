//! Fault injection on a serial line.

use crate::plant::Noise;

/// What goes wrong on a line, each way; nothing by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LineFaults {
    /// Decides what is drawn at random.
    pub seed: u64,
    /// From the host to the device.
    pub to_device: WireFaults,
    /// From the device to the host.
    pub to_host: WireFaults,
}

/// What goes wrong in one direction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WireFaults {
    /// Probability that a data bit arrives inverted.
    pub bit_error_rate: f64,
    /// Probability of each byte to be lost together with all that follow it without a gap.
    pub tear: f64,
    /// Probability of each byte to arrive twice.
    pub duplicate: f64,
    /// Whether the line hangs, whatever is sent.
    pub stuck: Option<Stuck>,
}

/// How a line hangs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stuck {
    /// Nothing arrives.
    Silent,
    /// Every byte arrives as this one: 0x00 or 0xFF.
    At(u8),
}

/// A wire with its faults.
#[derive(Debug)]
pub(super) struct Wire {
    faults: WireFaults,
    noise: Noise,
    /// Whether the rest of the burst is lost.
    torn: bool,
    pub(super) corrupted: u64,
    pub(super) lost: u64,
    pub(super) duplicated: u64,
}

impl Default for Wire {
    fn default() -> Self {
        Self {
            faults: WireFaults::default(),
            noise: Noise::new(0),
            torn: false,
            corrupted: 0,
            lost: 0,
            duplicated: 0,
        }
    }
}

impl Wire {
    pub(super) fn set(&mut self, faults: WireFaults, seed: u64) {
        self.faults = faults;
        self.noise = Noise::new(seed);
        self.torn = false;
    }

    /// The line was free for a while.
    pub(super) fn pause(&mut self) {
        self.torn = false;
    }

    /// What arrives of a byte: nothing, one, or two.
    pub(super) fn carry(&mut self, byte: u8) -> [Option<u8>; 2] {
        if self.faults == WireFaults::default() {
            return [Some(byte), None];
        }
        self.torn |= self.happens(self.faults.tear);
        let arrives = match self.faults.stuck {
            Some(Stuck::Silent) => None,
            _ if self.torn => None,
            Some(Stuck::At(level)) => Some(level),
            None => {
                let flipped = (0..8).fold(0, |flipped, bit| {
                    flipped | u8::from(self.happens(self.faults.bit_error_rate)) << bit
                });
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
