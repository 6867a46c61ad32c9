//! Monitoring of the share of missed deadlines.

/// Least number of deadlines over which the share is judged, and the same as a multiple of the tolerated row.
const WINDOW: u32 = 1000;
const ROWS: u32 = 16;

/// A host that misses many deadlines, although never too many in a row, moves the robot at a fraction of its speed and
/// delays every stop.
#[derive(Debug)]
pub(crate) struct OverloadWatch {
    window: u32,
    /// Deadlines of the present window, and the missed ones among them.
    deadlines: u32,
    missed: u32,
}

impl OverloadWatch {
    pub(crate) fn new(max_missed_in_row: u32) -> Self {
        Self { window: WINDOW.max(max_missed_in_row.saturating_mul(ROWS)), deadlines: 0, missed: 0 }
    }

    /// Counts a cycle after `missed` deadlines. Returns the missed deadlines and the deadlines of the window that ends
    /// with this cycle, if more than a quarter of them were missed.
    pub(crate) fn count(&mut self, missed: u32) -> Option<(u32, u32)> {
        self.deadlines = self.deadlines.saturating_add(missed).saturating_add(1);
        self.missed = self.missed.saturating_add(missed);
        if self.deadlines < self.window {
            return None;
        }
        let (missed, deadlines) = (std::mem::take(&mut self.missed), std::mem::take(&mut self.deadlines));
        (missed > deadlines / 4).then_some((missed, deadlines))
    }
}
