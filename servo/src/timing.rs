//! Times of the cycles of a servo thread.

use crate::thread::{AccountReads, LateCycles, WaitReport};
use crate::{Histogram, Servo};

/// How punctual a servo thread was.
#[derive(Clone, Debug, Default)]
pub struct Timing {
    /// From when the thread asked to be woken to when it ran.
    pub wake_up: Histogram,
    /// From a cycle's deadline to when its SYNC was handed over: the jitter that drives see. A
    /// deadline that was skipped is not in it; [`Counters`](crate::Counters) has how many were.
    pub sync: Histogram,
    /// Time a cycle took, waiting excluded.
    pub step: Histogram,
    /// From SYNC to the last answer, of every group and cycle in which one came.
    pub bus: Histogram,
    /// What waiting for the deadlines cost.
    pub wait: WaitReport,
    /// Who made cycles late: their SYNC left more than a hundredth of the period after the deadline.
    pub late: LateCycles,
    /// How often the kernel was asked who, and why.
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
