//! Configuration of a service port.

use std::time::Duration;

use super::TIME_OUT;
use crate::Settings;
#[cfg(doc)]
use crate::{epos2, epos4};

/// Which device is on the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dialect {
    /// An EPOS2 on RS-232: [`epos2`].
    Epos2,
    /// An EPOS4 on USB or RS-232: [`epos4`].
    Epos4,
}

/// How a client goes about it.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// Which device is on the line.
    pub dialect: Dialect,
    /// How the line is set; bytes take their time on it.
    pub settings: Settings,
    /// How long an answer may take; no shorter than the device's frame time-out, [`TIME_OUT`] as delivered.
    pub time_out: Duration,
    /// Number of repetitions of a request that failed on the line.
    pub retries: u8,
    /// The longest object that is transferred in segments, bytes.
    pub capacity: usize,
}

impl Config {
    /// Maxon's time-out, one more attempt, and objects of up to 4096 bytes.
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
