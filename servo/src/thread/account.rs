//! The kernel's account of the calling thread, read in the slack of a cycle.

use std::{fs::File, os::unix::fs::FileExt, time::Duration};

use serde::Serialize;

use super::Usage;

/// Quiet cycles after which the account is read. Each wake-up costs a small delay, and the sum over many quiet cycles
/// must not be taken for the delay of one cycle.
const STALE: u32 = 16;

/// Greatest duration of a minor page fault without contention. A longer fault, for instance with a read from a disk,
/// disturbs its own cycle, after which the account is read.
const FAULT: Duration = Duration::from_micros(2);

/// Number of readings of the kernel's account of the thread by reason. Each reading takes two system calls.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct AccountReads {
    /// After a cycle that was late or otherwise out of the ordinary.
    pub disturbed: u64,
    /// After the last of 16 quiet cycles.
    pub quiet: u64,
    /// Before the wait, because the work after a cycle took more than a hundredth of the period.
    pub slack: u64,
}

/// Counts of the kernel for one thread since the last reading.
#[derive(Debug, Default)]
pub struct Account {
    /// `/proc/thread-self/schedstat`, opened before the first cycle; none where the kernel has none.
    schedstat: Option<File>,
    last: Usage,
    /// Wake-up latencies of the quiet cycles since then: an upper bound of their delays.
    quiet: Duration,
    cycles: u32,
    /// Number of readings in cycles.
    pub(super) reads: AccountReads,
}

impl Account {
    /// An account of the calling thread, starting now.
    pub fn open() -> Self {
        let mut account = Self { schedstat: File::open("/proc/thread-self/schedstat").ok(), ..Self::default() };
        account.begin();
        account
    }

    pub(super) fn skip(&mut self) {
        self.begin();
        self.reads.slack += 1;
    }

    /// Starts counting: two system calls.
    fn begin(&mut self) {
        self.last = Usage { delay: self.delay(), ..Usage::of_this_thread() };
        (self.quiet, self.cycles) = (Duration::ZERO, 0);
    }

    /// Counts of the disturbed cycle that was `late`, without the share of the quiet cycles before. Restarts the
    /// counts.
    pub fn settle(&mut self, late: Duration) -> Usage {
        let (before, quiet, cycles) = (self.last, self.quiet, self.cycles);
        self.begin();
        self.reads.disturbed += 1;
        of_last(self.last.since(before), late, quiet, cycles)
    }

    /// Takes a quiet cycle, whose wake-up was late by `latency`.
    pub fn pass(&mut self, latency: Duration) {
        self.quiet += latency;
        self.cycles += 1;
        if self.cycles >= STALE {
            self.begin();
            self.reads.quiet += 1;
        }
    }

    /// Time that the thread was runnable and did not run: the second field, ns
    /// (Documentation/scheduler/sched-stats.rst).
    fn delay(&self) -> Option<Duration> {
        let mut text = [0; 64];
        let read = self.schedstat.as_ref()?.read_at(&mut text, 0).ok()?;
        parse(text.get(..read)?)
    }
}

/// The part of `counted` that delayed the last cycle, whose lateness was `late`. `quiet` is the sum of the wake-up
/// latencies of the quiet `cycles` before.
fn of_last(counted: Usage, late: Duration, quiet: Duration, cycles: u32) -> Usage {
    let mut counted = counted;
    if counted.switches == 0 {
        // Without a context switch all delays happened at wake-ups, and the delays of quiet wake-ups did no harm.
        counted.delay = counted.delay.map(|delay| delay.saturating_sub(quiet));
    }
    if cycles > 0 {
        // The counts may belong to any of the cycles: few page faults, or a context switch.
        let took = FAULT.saturating_mul(u32::try_from(counted.faults).unwrap_or(u32::MAX));
        if took < late / 2 {
            counted.faults = 0;
        }
        counted.switches = 0;
    }
    counted
}

fn parse(text: &[u8]) -> Option<Duration> {
    std::str::from_utf8(text).ok()?.split_ascii_whitespace().nth(1)?.parse().ok().map(Duration::from_nanos)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_quiet_cycles_may_have_counted_is_not_the_late_ones() {
        let micros = Duration::from_micros;
        // Faults, switches, delay; quiet cycles and their wake-up latency; the result; in µs, for a cycle 400 µs late.
        let cases = [
            ((1, 0, Some(0)), (0, 0), (1, 0, Some(0))),
            ((1, 0, Some(0)), (10, 50), (0, 0, Some(0))),
            ((99, 0, Some(0)), (1, 50), (0, 0, Some(0))),
            ((100, 0, Some(0)), (10, 50), (100, 0, Some(0))),
            ((0, 1, None), (0, 0), (0, 1, None)),
            ((0, 1, None), (10, 50), (0, 0, None)),
            ((0, 1, Some(390)), (10, 50), (0, 0, Some(390))),
            ((0, 0, Some(390)), (10, 50), (0, 0, Some(340))),
            ((0, 0, Some(40)), (10, 50), (0, 0, Some(0))),
        ];
        for (counted, (cycles, quiet), expected) in cases {
            let [counted, expected] = [counted, expected].map(|(faults, switches, delay)| Usage {
                faults,
                switches,
                delay: delay.map(micros),
            });
            let found = of_last(counted, micros(400), micros(quiet), cycles);
            assert_eq!(found, expected, "{counted:?} {cycles} {quiet}");
        }
    }

    #[test]
    fn the_delay_is_the_second_number() {
        for (text, expected) in
            [("0 51155 1\n", Some(51_155)), ("7 0 1", Some(0)), ("7", None), ("", None), ("7 x 1", None)]
        {
            assert_eq!(parse(text.as_bytes()), expected.map(Duration::from_nanos), "{text}");
        }
    }
}
