//! The wait for a deadline: sleep to a margin before it, then spin to it.

use std::hint;
use std::time::Duration;

use can::Instant;
use can::clock::{now, sleep_until};

use super::quantile::LearntQuantile;

/// Share of the period that work and spin together may take: a thread under SCHED_FIFO that takes more than
/// 95 % of a second (`sched_rt_runtime_us`) is frozen for the rest of it.
pub(super) const BUSY_SHARE: f64 = 0.9;

/// How a thread waits for a deadline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wait {
    /// It sleeps until the deadline, and runs as late as the host wakes it.
    Plain,
    /// It sleeps to a margin before the deadline, then spins.
    Hybrid {
        /// The margin; `None` learns it: all but about one in 1000 wake-ups come within it.
        margin: Option<Duration>,
        /// Largest share of the period, 0 ..= 1, to spin in; it bounds the margin, learnt or not.
        spin_share: f64,
    },
}

impl Wait {
    /// The hybrid wait that learns its margin, in at most a fifth of a core.
    pub const HYBRID: Self = Self::Hybrid {
        margin: None,
        spin_share: 0.2,
    };
}

/// What waiting cost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WaitReport {
    /// How long before the time it waits for the thread asks to be woken, as of last; zero with [`Wait::Plain`].
    pub margin: Duration,
    /// How long before the deadline the thread prepares the cycle, as of last.
    pub lead: Duration,
    /// Share of a core spent spinning.
    pub spin_share: f64,
}

/// When a wait ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Awake {
    /// When the thread began to wait.
    pub asked_at: Instant,
    /// When it asked to be woken; not before `asked_at` if it slept.
    pub wake_up: Instant,
    /// When it ran again.
    pub woken: Instant,
    /// When the wait was over.
    pub at: Instant,
    /// Longest time between two reads of the clock in the spin: what somebody else took.
    pub gap: Duration,
}

impl Awake {
    /// How late the thread was woken; `None` if there was no time left to sleep.
    pub fn wake_up_latency(&self) -> Option<Duration> {
        (self.asked_at < self.wake_up).then(|| self.woken.since(self.wake_up))
    }
}

/// Waits for the deadlines of one thread.
#[derive(Clone, Debug)]
pub struct Waiter {
    margin: Margin,
    /// From wait to wait, and in spins of it.
    elapsed: Duration,
    spun: Duration,
    /// End of the wait before, if deadlines followed each other.
    last: Option<Instant>,
}

impl Waiter {
    /// For deadlines one `period` apart.
    pub fn new(wait: Wait, period: Duration) -> Self {
        Self {
            margin: Margin::new(wait, period),
            elapsed: Duration::ZERO,
            spun: Duration::ZERO,
            last: None,
        }
    }

    /// Waits for `due`, keeping `reserved` of the share for a spin to come; returns at once if it has passed.
    pub fn wait(&mut self, due: Instant, reserved: Duration) -> Awake {
        let asked_at = now();
        let last = self.last.unwrap_or(asked_at);
        let wake_up = due - self.margin.allowed(asked_at.since(last), reserved);
        sleep_until(wake_up);
        let woken = now();
        let mut awake = Awake {
            asked_at,
            wake_up,
            woken,
            at: woken,
            gap: Duration::ZERO,
        };
        if let Some(latency) = awake.wake_up_latency() {
            self.margin.observe(latency);
        }
        (awake.at, awake.gap) = self.spin(woken, due);
        self.elapsed += awake.at.since(last);
        self.last = Some(awake.at);
        awake
    }

    /// Spins from `from`, which is now, to `due`; returns when that was over, and the longest time between two
    /// reads of the clock.
    pub(super) fn spin(&mut self, from: Instant, due: Instant) -> (Instant, Duration) {
        let (mut at, mut gap) = (from, Duration::ZERO);
        while at < due {
            hint::spin_loop();
            let read = now();
            gap = gap.max(read.since(at));
            at = read;
        }
        self.spun += at.since(from);
        (at, gap)
    }

    /// There are no deadlines for a while; what passes until the next wait is nobody's.
    pub fn pause(&mut self) {
        self.last = None;
    }

    /// What the waits cost so far.
    pub fn report(&self) -> WaitReport {
        WaitReport {
            margin: self.margin.get(),
            lead: Duration::ZERO,
            spin_share: if self.elapsed.is_zero() {
                0.0
            } else {
                self.spun.as_secs_f64() / self.elapsed.as_secs_f64()
            },
        }
    }
}

/// How long before a deadline to wake.
#[derive(Clone, Copy, Debug)]
struct Margin {
    kind: Kind,
    /// Of a period: for spins, and for work and spins.
    spin: Duration,
    busy: Duration,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    Fixed(Duration),
    Learnt(LearntQuantile),
}

impl Margin {
    fn new(wait: Wait, period: Duration) -> Self {
        let (margin, share) = match wait {
            Wait::Plain => (Some(Duration::ZERO), 0.0),
            Wait::Hybrid { margin, spin_share } => (margin, spin_share),
        };
        let share = if share.is_finite() {
            share.clamp(0.0, 1.0)
        } else {
            0.0
        };
        let spin = period.mul_f64(share);
        Self {
            // The first wake-ups are no worse than later ones if it comes down from above.
            kind: margin.map_or_else(
                || Kind::Learnt(LearntQuantile::new(spin, spin)),
                |margin| Kind::Fixed(margin.min(spin)),
            ),
            spin,
            busy: period.mul_f64(BUSY_SHARE),
        }
    }

    fn get(&self) -> Duration {
        match self.kind {
            Kind::Fixed(margin) => margin,
            Kind::Learnt(margin) => margin.get(),
        }
    }

    fn observe(&mut self, latency: Duration) {
        if let Kind::Learnt(margin) = &mut self.kind {
            margin.observe(latency);
        }
    }

    /// The margin of a cycle of which work has taken `busy`, with `reserved` of the share of spins kept.
    fn allowed(&self, busy: Duration, reserved: Duration) -> Duration {
        self.get()
            .min(self.spin.saturating_sub(reserved))
            .min(self.busy.saturating_sub(busy))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_millis(1);

    fn micros(micros: u64) -> Duration {
        Duration::from_micros(micros)
    }

    #[test]
    fn a_margin_is_within_the_share_and_leaves_throttling_its_room() {
        let fixed = |margin, spin_share| Wait::Hybrid {
            margin: Some(micros(margin)),
            spin_share,
        };
        // Wait, work so far, kept for a spin to come, margin; µs of a period of 1000.
        let cases = [
            (Wait::Plain, 0, 0, 0),
            (Wait::HYBRID, 0, 0, 200),
            (Wait::HYBRID, 0, 50, 150),
            (Wait::HYBRID, 0, 300, 0),
            (Wait::HYBRID, 750, 0, 150),
            (Wait::HYBRID, 2500, 0, 0),
            (fixed(100, 0.2), 0, 0, 100),
            (fixed(300, 0.2), 0, 0, 200),
            (fixed(100, 0.2), 850, 0, 50),
            (fixed(2000, 7.0), 0, 0, 900),
            (fixed(100, f64::NAN), 0, 0, 0),
            (fixed(100, -1.0), 0, 0, 0),
        ];
        for (wait, busy, reserved, expected) in cases {
            let margin = Margin::new(wait, PERIOD);
            let found = margin.allowed(micros(busy), micros(reserved));
            assert_eq!(found, micros(expected), "{wait:?} {busy} {reserved}");
        }
    }

    #[test]
    fn spins_of_a_learning_wait_stay_within_the_share_whatever_the_host_does() {
        let mut margin = Margin::new(Wait::HYBRID, PERIOD);
        let (mut spun, mut late) = (Duration::ZERO, 0);
        // An idle host, a busy one, one that needs longer than the share allows, and an idle one again.
        for latency in [40, 120, 900, 40] {
            for _ in 0..40_000 {
                let allowed = margin.allowed(micros(30), Duration::ZERO);
                spun += allowed.saturating_sub(micros(latency));
                late += u32::from(micros(latency) > allowed);
                margin.observe(micros(latency));
            }
        }
        assert!(spun < 160_000 * PERIOD / 5, "{spun:?}");
        assert!((40_000..40_200).contains(&late), "{late}");
        assert!(margin.get() < micros(60), "{margin:?}");
    }

    #[test]
    fn the_hybrid_wait_ends_at_its_deadline_and_not_before() {
        let mut waiter = Waiter::new(Wait::HYBRID, PERIOD);
        let mut due = now();
        let mut spun = 0;
        for _ in 0..100 {
            due += PERIOD;
            let awake = waiter.wait(due, Duration::ZERO);
            assert!(awake.at >= due && awake.woken >= awake.wake_up);
            spun += u32::from(awake.woken < due);
            if awake.woken < due {
                assert!(awake.at.since(due) <= awake.gap);
            }
        }
        let report = waiter.report();
        assert!(spun == 0 || report.spin_share > 0.0, "{report:?}");
    }
}
