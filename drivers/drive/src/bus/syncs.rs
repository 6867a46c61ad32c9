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

/// Periods whose SYNCs are remembered. A greater lag of answers counts as this one.
const REMEMBERED: usize = 16;

/// The SYNCs sent to which answers may still arrive.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Syncs {
    pub(crate) last: Option<Instant>,
    before: Option<Instant>,
    /// The last cycle had to send a SYNC.
    pub(crate) attempted: bool,
    /// The port took the SYNC of the last cycle.
    pub(crate) sent: bool,
    /// Time of each batch, and whether it had a SYNC that the port took; a ring.
    periods: [Option<(Instant, bool)>; REMEMBERED],
    /// Place of the last batch in the ring.
    present: usize,
}

impl Syncs {
    /// The SYNC that an answer received at `at` belongs to: the last one sent before the answer. `None` if the answer
    /// is older than the last two SYNCs.
    pub(crate) fn of_answer(&self, at: Instant) -> Option<Instant> {
        [self.last, self.before].into_iter().flatten().find(|sync| at >= *sync)
    }

    /// The SYNC that an answer received at `at` belongs to, if all answers come `lag` periods late. `None` if the answer
    /// is older than the last two SYNCs, or belongs to none.
    pub(crate) fn of_late_answer(&self, at: Instant, lag: u32) -> Option<Instant> {
        let received = self.of_answer(at)?;
        if lag == 0 {
            return Some(received);
        }
        let mut periods = (0..REMEMBERED).filter_map(|ago| self.period(ago));
        periods.find(|(begin, _)| at >= *begin)?;
        let sampled = periods.skip((lag as usize).min(REMEMBERED - 2) - 1).find(|(_, synced)| *synced);
        sampled.map(|(sync, _)| sync)
    }

    /// Whether an answer received at `at` was received after the last batch was sent.
    pub(crate) fn is_present(&self, at: Instant) -> bool {
        self.period(0).is_some_and(|(begin, _)| at >= begin)
    }

    fn period(&self, ago: usize) -> Option<(Instant, bool)> {
        self.periods[(self.present + REMEMBERED - ago) % REMEMBERED]
    }

    /// Notes that a batch with a SYNC was handed to the port, which took the SYNC if `sent`.
    pub(crate) fn send(&mut self, now: Instant, sent: bool) {
        self.attempted = true;
        self.sent = sent;
        if sent {
            self.before = self.last.replace(now);
        }
        self.begin_period(now, sent);
    }

    /// Begins the period of a batch.
    pub(crate) fn begin_period(&mut self, now: Instant, synced: bool) {
        self.present = (self.present + 1) % REMEMBERED;
        self.periods[self.present] = Some((now, synced));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Instant {
        Instant::from_nanos(millis * 1_000_000)
    }

    #[test]
    fn a_late_answer_belongs_to_an_earlier_sync() {
        let mut syncs = Syncs::default();
        for period in 0..40 {
            syncs.send(at(10 * period), true);
        }
        // Answers to a SYNC of 10 ms come 3 and 13 ms after the SYNC that they are taken for.
        let table = [
            (393, 0, Some(390)),
            (393, 2, Some(370)),
            (383, 2, Some(360)),
            (373, 0, None),
            (393, 14, Some(250)),
            (393, 99, Some(250)),
        ];
        for (received, lag, sync) in table {
            assert_eq!(syncs.of_late_answer(at(received), lag), sync.map(at), "{received} ms, lag {lag}");
        }
        assert!(syncs.is_present(at(391)) && !syncs.is_present(at(389)));
        syncs.begin_period(at(400), false);
        syncs.send(at(410), true);
        // The batch of 400 ms had no SYNC.
        assert_eq!(syncs.of_late_answer(at(413), 1), Some(at(390)));
        assert_eq!(syncs.of_late_answer(at(413), 2), Some(at(390)));
        assert_eq!(syncs.of_late_answer(at(413), 0), Some(at(410)));
    }
}
