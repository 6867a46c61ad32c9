//! The axis controllers of the IRb-6 and IRp-6, one on each serial line, in both of their protocols.
//!
//! [`AxisControllerGroup`] is the host's end. Read [`DriveGroup`] first.

mod config;
mod stream;

use std::task::Poll;

use can::Instant;
use serial::Line;

pub use serial::{Settings, StopBits};

pub use config::{AxisConfig, ConfigError, Control, CurrentGains, GroupConfig, Protocol};

use crate::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters};

/// Axis controllers, each on a line of its own. The module says what it does with each command.
pub struct AxisControllerGroup<L: Line> {
    lines: Vec<L>,
    config: GroupConfig,
    axes: Vec<AxisConfig>,
    counters: GroupCounters,
}

impl<L: Line> AxisControllerGroup<L> {
    /// A group that has sent nothing yet; states and commands come in the order of `axes`, and so do
    /// the lines.
    pub fn new(
        lines: Vec<L>,
        config: GroupConfig,
        axes: &[AxisConfig],
    ) -> Result<Self, ConfigError> {
        config::check(&config, axes, lines.len())?;
        Ok(Self {
            lines,
            config,
            axes: axes.to_vec(),
            counters: GroupCounters::default(),
        })
    }
}

impl<L: Line> DriveGroup for AxisControllerGroup<L> {
    fn axes(&self) -> usize {
        self.axes.len()
    }

    /// A drive samples when a telegram arrives and only then takes its set-point: the answer to the next
    /// telegram, read a cycle after that was sent, is the first to show where it got.
    fn delay(&self) -> usize {
        2
    }

    fn bring_up(&mut self, _now: Instant) -> Poll<Result<(), BringUpError>> {
        Poll::Pending
    }

    fn read(&mut self, _now: Instant, _states: &mut [AxisState]) {}

    fn write(&mut self, _now: Instant, _commands: &[AxisCommand]) {}

    fn send(&mut self, _now: Instant) -> bool {
        !self.lines.is_empty() && self.config.attempts > 0
    }

    fn counters(&self) -> GroupCounters {
        self.counters
    }
}
