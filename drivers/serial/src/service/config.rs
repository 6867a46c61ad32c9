//! Configuration of a service port.

use std::time::Duration;

use super::TIME_OUT;
use crate::Settings;
#[cfg(doc)]
use crate::{epos2, epos4};

/// Device on the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dialect {
    /// An EPOS2 on RS-232: [`epos2`].
    Epos2,
    /// An EPOS4 on USB or RS-232: [`epos4`].
    Epos4,
}

/// Configuration of a client.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// Device on the line.
    pub dialect: Dialect,
    /// Settings of the line, which give the transmission time of bytes.
    pub settings: Settings,
    /// Time to wait for an answer; at least the frame time-out of the device. The factory setting is [`TIME_OUT`].
    pub time_out: Duration,
    /// Number of repetitions of a request that failed on the line.
    pub retries: u8,
    /// Longest object of a segmented transfer, bytes.
    pub capacity: usize,
}

impl Config {
    /// Time-out of the factory setting, one repetition, and objects of up to 4096 bytes.
    pub const fn new(dialect: Dialect, settings: Settings) -> Self {
        Self {
            dialect,
            settings,
            time_out: TIME_OUT,
            retries: 1,
            capacity: 4096,
        }
    }
}
