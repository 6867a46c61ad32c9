//! Levels of inputs that the scene computes.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Level at the terminal of an input, set by the scene at each of its steps. Clones are the same terminal.
///
/// The module reads the level right after the step of the scene, at the time of the step. An edge therefore has the time
/// of the step in which it occurs, at most 100 µs after the true edge. The level is low at first.
#[derive(Clone, Debug, Default)]
pub struct InputProbe(Arc<AtomicBool>);

impl InputProbe {
    /// Level of the terminal: high or low.
    pub fn level(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Sets the level of the terminal: high or low.
    pub fn set(&self, level: bool) {
        self.0.store(level, Ordering::Relaxed);
    }
}
