//! The SYNCs of a bus: whether its nodes need SYNC, and the SYNC of each answer.

use can::Instant;

use crate::cia401::{self, IoConfig};
use crate::cia402::{self, AxisConfig};

/// Whether a PDO of these nodes is synchronous (CiA 301 §7.5.2.35, §7.5.2.37). A bus without such a PDO carries no SYNC.
pub(crate) fn needs_sync(axes: &[AxisConfig], io: &[IoConfig]) -> bool {
    let drives = axes.iter().flat_map(cia402::pdo_setups);
    let io = io.iter().filter_map(|io| cia401::pdo_setups(io).ok()).flatten();
    let mut used = drives.chain(io).filter(|setup| !setup.mapping.entries().is_empty());
    used.any(|setup| setup.transmission.is_synchronous())
}

/// The SYNCs sent to which answers may still arrive.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Syncs {
    pub(crate) last: Option<Instant>,
    before: Option<Instant>,
    /// The last cycle had to send a SYNC.
    pub(crate) attempted: bool,
    /// The port took the SYNC of the last cycle.
    pub(crate) sent: bool,
}

impl Syncs {
    /// The SYNC that an answer received at `at` belongs to: the last one sent before the answer. `None` if the answer
    /// is older than the last two SYNCs.
    pub(crate) fn of_answer(&self, at: Instant) -> Option<Instant> {
        [self.last, self.before].into_iter().flatten().find(|sync| at >= *sync)
    }

    pub(crate) fn send(&mut self, now: Instant, sent: bool) {
        self.attempted = true;
        self.sent = sent;
        if sent {
            self.before = self.last.replace(now);
        }
    }
}
