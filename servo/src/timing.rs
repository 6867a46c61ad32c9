//! Timing of the cycles of a servo thread.

use crate::thread::{AccountReads, LateCycles, WaitReport};
use crate::{Histogram, Servo};

/// Punctuality of a servo thread.
#[derive(Clone, Debug, Default)]
pub struct Timing {
    /// Time from the requested wake-up until the thread ran.
    pub wake_up: Histogram,
    /// Time from a cycle's deadline to the sending of its SYNC: the jitter at the drives. Skipped deadlines are not
    /// included; [`Counters`](crate::Counters) counts them.
    pub sync: Histogram,
    /// Duration of a cycle, without waiting.
    pub step: Histogram,
    /// Time from SYNC to the last answer, for every group and every cycle with an answer.
    pub bus: Histogram,
    /// Cost of waiting for the deadlines.
    pub wait: WaitReport,
    /// Causes of late cycles: those whose SYNC left more than a hundredth of the period after the deadline.
    pub late: LateCycles,
    /// Number of and reasons for readings of the kernel's account.
    pub account: AccountReads,
}

impl Timing {
    /// Counts the bus times that the groups of `servo` report.
    pub fn record_bus(&mut self, servo: &Servo) {
        for counters in servo.group_counters() {
            if !counters.last_bus_time.is_zero() {
                self.bus.record(counters.last_bus_time);
            }
        }
    }
}
