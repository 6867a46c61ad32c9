//! Tests of cycle and thread by their public interface, in one executable. `page_faults` has a process of its own.

mod no_allocation;
mod planted;
mod scripted;

use std::sync::{Mutex, MutexGuard, PoisonError};

// The names that `scripted` expects beside itself.
use mrroc_servo::{
    EffectorConfig, FeedForward, FrozenWatch, HostLoop, Law, Output, PositionLoop, ServoAxisConfig, ServoConfig,
    regulator,
};

/// Runs the tests by the clock one at a time, because they take the CPU from each other.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}
