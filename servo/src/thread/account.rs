//! The kernel's account of the calling thread, read in the slack of a cycle.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::time::Duration;

use super::Usage;

/// Quiet cycles after which the account is read all the same: being woken costs a little delay each time, and what
/// has added up must not be taken for that of one cycle.
const STALE: u32 = 16;

/// How often the kernel's account of the thread was read, each time with two system calls, and why.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AccountReads {
    /// After a cycle that was late or otherwise out of the ordinary.
    pub disturbed: u64,
    /// After the last of 16 quiet cycles.
    pub quiet: u64,
    /// Before the wait, since what followed a cycle took more than a hundredth of the period.
    pub slack: u64,
}

/// What the kernel counted for one thread since it was read last.
#[derive(Debug)]
pub struct Account {
    /// `/proc/thread-self/schedstat`, opened before the first cycle; none where the kernel has none.
    schedstat: Option<File>,
    last: Usage,
    /// Wake-up latencies of the quiet cycles since: their delays at most.
    quiet: Duration,
    cycles: u32,
    reads: AccountReads,
}

impl Account {
    /// Of the calling thread, from now on.
    pub fn open() -> Self {
        let mut account = Self {
            schedstat: File::open("/proc/thread-self/schedstat").ok(),
            last: Usage::default(),
            quiet: Duration::ZERO,
            cycles: 0,
            reads: AccountReads::default(),
        };
        account.begin();
        account
    }

    /// How often it was read in cycles.
    pub(super) fn reads(&self) -> AccountReads {
        self.reads
    }

    /// What was counted until now is nobody's.
    pub(super) fn skip(&mut self) {
        self.begin();
        self.reads.slack += 1;
    }

    /// Counts from now on: two system calls.
    fn begin(&mut self) {
        self.last = Usage {
            delay: self.delay(),
            ..Usage::of_this_thread()
        };
        (self.quiet, self.cycles) = (Duration::ZERO, 0);
    }

    /// What was counted for a disturbed cycle; counts anew.
    pub fn settle(&mut self) -> Usage {
        let (before, quiet) = (self.last, self.quiet);
        self.begin();
        self.reads.disturbed += 1;
        let counted = self.last.since(before);
        if counted.switches > 0 {
            return counted;
        }
        // Nobody took the CPU while it ran, so its delays were at wake-ups, of which the quiet ones did no harm.
        Usage {
            delay: counted.delay.map(|delay| delay.saturating_sub(quiet)),
            ..counted
        }
    }

    /// A cycle was quiet, and the thread was woken this late for it.
    pub fn pass(&mut self, latency: Duration) {
        self.quiet += latency;
        self.cycles += 1;
        if self.cycles >= STALE {
            self.begin();
            self.reads.quiet += 1;
        }
    }

    /// Time that the thread was runnable and did not run: the second field, ns (Documentation/scheduler/sched-stats.rst).
    fn delay(&self) -> Option<Duration> {
        let mut text = [0; 64];
        let read = self.schedstat.as_ref()?.read_at(&mut text, 0).ok()?;
        parse(text.get(..read)?)
    }
}

/// The second of the numbers in `text`.
fn parse(text: &[u8]) -> Option<Duration> {
    let field = std::str::from_utf8(text)
        .ok()?
        .split_ascii_whitespace()
        .nth(1)?;
    field.parse().ok().map(Duration::from_nanos)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_delay_is_the_second_number() {
        for (text, expected) in [
            ("0 51155 1\n", Some(51_155)),
            ("7 0 1", Some(0)),
            ("7", None),
            ("", None),
            ("7 x 1", None),
        ] {
            assert_eq!(
                parse(text.as_bytes()),
                expected.map(Duration::from_nanos),
                "{text}"
            );
        }
    }
}
