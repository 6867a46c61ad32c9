//! The wait for a deadline: sleep until a margin before the deadline, then spin.
//!
//! Late wake-ups come in clusters. A margin that always covers the clusters would take half a core. The margin
//! therefore covers a cluster only after its first late wake-up. Unused spin time is kept as credit, up to [`CREDIT`].
//! After a late wake-up, the credit is spent on wake-ups up to half a period early, for [`ALERT`] cycles.

use std::{hint, time::Duration};

use can::Instant;
use can::clock::{now, sleep_until};

use super::quantile::LearntQuantile;
use super::realtime::{Realtime, Wait};

/// Fraction of the period that work and spin together may take. The kernel freezes a thread under SCHED_FIFO that
/// takes more than 95 % of a second (`sched_rt_runtime_us`) for the rest of the second.
pub(super) const BUSY_SHARE: f64 = 0.9;
/// Greatest credit of unused spin time. Within any second, spins exceed their share by at most a twentieth.
const CREDIT: Duration = Duration::from_millis(50);

/// Number of cycles, after a wake-up later than its margin, in which another late wake-up is expected. On a virtual
/// machine of a busy host, a second late wake-up followed within 8 cycles in half of the cases. Only few more followed
/// within 64 cycles.
const ALERT: u32 = 16;

/// What waiting cost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WaitReport {
    /// Time by which the last wake-up was requested early; zero with [`Wait::Plain`].
    pub margin: Duration,
    /// Time from the start of preparing to the deadline, in the last cycle.
    pub preparation: Duration,
    /// Share of a core spent spinning.
    pub spin_share: f64,
}

/// Times of one wait.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Awake {
    /// When the thread began to wait.
    pub asked_at: Instant,
    /// Requested wake-up time; not before `asked_at` if the thread slept.
    pub wake_up: Instant,
    /// Time at which the thread ran again.
    pub woken: Instant,
    /// End of the wait.
    pub at: Instant,
    /// Longest time between two reads of the clock in the spin: time taken by an interrupt or another thread.
    pub gap: Duration,
}

impl Awake {
    /// Latency of the wake-up; `None` if there was no time left to sleep.
    pub fn wake_up_latency(&self) -> Option<Duration> {
        (self.asked_at < self.wake_up).then(|| self.woken.since(self.wake_up))
    }
}

/// Waits for the deadlines of one thread.
#[derive(Clone, Debug)]
pub struct Waiter {
    margin: Margin,
    /// Total time of the waits, and the time of their spins.
    elapsed: Duration,
    spun: Duration,
    /// End of the last wait, if deadlines followed each other.
    last: Option<Instant>,
    /// Begin of the last wait, under the same condition, and the spin time up to then.
    settled: Option<Instant>,
    settled_spun: Duration,
}

impl Waiter {
    /// For deadlines one `period` apart.
    pub fn new(realtime: &Realtime, period: Duration) -> Self {
        Self {
            margin: Margin::new(realtime, period),
            elapsed: Duration::ZERO,
            spun: Duration::ZERO,
            last: None,
            settled: None,
            settled_spun: Duration::ZERO,
        }
    }

    /// Waits for `due`, and keeps `reserved` of the spin share for a later spin. Returns at once if `due` has passed.
    pub fn wait(&mut self, due: Instant, reserved: Duration) -> Awake {
        let asked_at = now();
        let last = self.last.unwrap_or(asked_at);
        let passed = asked_at.since(self.settled.unwrap_or(asked_at));
        self.margin.settle(passed, self.spun - self.settled_spun);
        (self.settled, self.settled_spun) = (Some(asked_at), self.spun);
        let wake_up = due - self.margin.allowed(asked_at.since(last), reserved);
        sleep_until(wake_up);
        let woken = now();
        let mut awake = Awake { asked_at, wake_up, woken, at: woken, gap: Duration::ZERO };
        if let Some(latency) = awake.wake_up_latency() {
            self.margin.observe(latency);
        }
        (awake.at, awake.gap) = self.spin(woken, due);
        self.elapsed += awake.at.since(last);
        self.last = Some(awake.at);
        awake
    }

    /// Spins from `from`, which is now, to `due`. Returns the end time and the longest time between two reads of the
    /// clock.
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

    /// Notes an interruption of the deadlines. The time until the next wait is not accounted.
    pub fn pause(&mut self) {
        (self.last, self.settled) = (None, None);
    }

    /// Cost of the waits so far.
    pub fn report(&self) -> WaitReport {
        WaitReport {
            margin: self.margin.get(),
            preparation: Duration::ZERO,
            spin_share: if self.elapsed.is_zero() { 0.0 } else { self.spun.as_secs_f64() / self.elapsed.as_secs_f64() },
        }
    }
}

/// Time between wake-up and deadline.
#[derive(Clone, Copy, Debug)]
struct Margin {
    kind: Kind,
    share: f64,
    /// Limits in each period: for spins, for work and spins together, and for the longest margin.
    spin: Duration,
    busy: Duration,
    longest: Duration,
    /// Unused share of the spins, ns. A negative value was borrowed from later cycles.
    credit: i64,
    /// Remaining cycles in which a late wake-up is expected.
    alert: u32,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    Fixed(Duration),
    Learnt(LearntQuantile),
}

impl Margin {
    fn new(realtime: &Realtime, period: Duration) -> Self {
        let (margin, share) = match realtime.wait {
            Wait::Plain => (Some(Duration::ZERO), 0.0),
            Wait::Hybrid => (realtime.margin, realtime.spin_share()),
        };
        let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
        let spin = period.mul_f64(share);
        Self {
            // Starting from the greatest value makes the first wake-ups no worse than later ones.
            kind: margin
                .map_or_else(|| Kind::Learnt(LearntQuantile::new(spin, spin)), |margin| Kind::Fixed(margin.min(spin))),
            share,
            spin,
            busy: period.mul_f64(BUSY_SHARE),
            longest: spin.max(period / 2),
            credit: 0,
            alert: 0,
        }
    }

    fn get(&self) -> Duration {
        match self.kind {
            Kind::Fixed(margin) => margin,
            Kind::Learnt(margin) => margin.get(),
        }
    }

    /// Takes the latency of a wake-up. A latency beyond the learnt bound starts the alert, even if the deadline was
    /// met.
    fn observe(&mut self, latency: Duration) {
        if let Kind::Learnt(learnt) = &mut self.kind {
            let is_late = latency > learnt.get();
            learnt.observe(latency);
            self.alert = match is_late {
                true => ALERT,
                false => self.alert.saturating_sub(1),
            };
        }
    }

    /// Accounts for the time `passed`, of which spins took `spun`.
    fn settle(&mut self, passed: Duration, spun: Duration) {
        let share = |time: Duration| time.mul_f64(self.share).as_nanos() as i64;
        // A time longer than the greatest credit counts the same.
        let earned = share(passed.min(CREDIT + spun));
        let left = self.credit.saturating_add(earned) - spun.as_nanos() as i64;
        self.credit = left.min(share(CREDIT));
    }

    /// The margin of a cycle in which work took `busy`, with `reserved` of the spin share kept.
    fn allowed(&self, busy: Duration, reserved: Duration) -> Duration {
        let learnt = self.get();
        let spin = match self.kind {
            Kind::Fixed(_) => self.spin,
            Kind::Learnt(_) => {
                let spin = (self.spin.as_nanos() as i64).saturating_add(self.credit);
                Duration::from_nanos(spin.max(0) as u64)
            }
        };
        let wanted = if self.alert > 0 { self.longest } else { learnt };
        wanted.min(spin.saturating_sub(reserved)).min(self.busy.saturating_sub(busy))
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
        let fixed = |margin, spin_share| Realtime {
            margin: Some(micros(margin)),
            spin_share: Some(spin_share),
            ..Realtime::default()
        };
        let plain = Realtime { wait: Wait::Plain, ..Realtime::default() };
        // Wait, work so far, reserved spin time, expected margin; in µs of a period of 1000.
        let cases = [
            (plain, 0, 0, 0),
            (Realtime::default(), 0, 0, 200),
            (Realtime::default(), 0, 50, 150),
            (Realtime::default(), 0, 300, 0),
            (Realtime::default(), 750, 0, 150),
            (Realtime::default(), 2500, 0, 0),
            (fixed(100, 0.2), 0, 0, 100),
            (fixed(300, 0.2), 0, 0, 200),
            (fixed(100, 0.2), 850, 0, 50),
            (fixed(2000, 7.0), 0, 0, 900),
            (fixed(100, f64::NAN), 0, 0, 0),
            (fixed(100, -1.0), 0, 0, 0),
        ];
        for (wait, busy, reserved, expected) in cases {
            let margin = Margin::new(&wait, PERIOD);
            let found = margin.allowed(micros(busy), micros(reserved));
            assert_eq!(found, micros(expected), "{wait:?} {busy} {reserved}");
        }
    }

    /// One cycle of a learning wait whose wake-up is `latency` late after `work`. Returns the spin time, and whether
    /// the deadline was missed.
    fn cycle(margin: &mut Margin, latency: Duration, work: Duration) -> (Duration, bool) {
        let allowed = margin.allowed(work, Duration::ZERO);
        let spun = allowed.saturating_sub(latency);
        margin.observe(latency);
        margin.settle(PERIOD, spun);
        (spun, latency > allowed)
    }

    #[test]
    fn spins_of_a_learning_wait_stay_within_the_share_whatever_the_host_does() {
        let mut margin = Margin::new(&Realtime::default(), PERIOD);
        let (mut spun, mut late) = (Duration::ZERO, 0);
        // An idle host, a busy host, a host that needs more than the permitted share, and an idle host again.
        for latency in [40, 120, 900, 40] {
            for _ in 0..40_000 {
                let (spin, is_late) = cycle(&mut margin, micros(latency), micros(30));
                spun += spin;
                late += u32::from(is_late);
            }
        }
        assert!(spun < 160_000 * PERIOD / 5, "{spun:?}");
        assert!((40_000..40_200).contains(&late), "{late}");
        assert!(margin.get() < micros(60), "{margin:?}");
    }

    #[test]
    fn in_no_second_do_spins_take_more_than_their_share_and_a_twentieth_or_trip_throttling() {
        let cycles = 1000;
        for (spin_share, seed) in [(0.05, 1), (0.2, 2), (0.5, 3)] {
            let wait = Realtime { spin_share: Some(spin_share), ..Realtime::default() };
            let mut margin = Margin::new(&wait, PERIOD);
            let mut seed: u64 = seed;
            let mut random = |below: u64| {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (seed >> 33) % below
            };
            let mut second = std::collections::VecDeque::new();
            let (mut spun, mut busy) = (Duration::ZERO, Duration::ZERO);
            let (mut most, mut busiest) = (Duration::ZERO, Duration::ZERO);
            for _ in 0..60_000 {
                // Calm intervals fill the credit; then every third wake-up keeps the alert active.
                let stretch = random(3000) == 0;
                let restless = second.back().is_some_and(|&(_, _, restless)| restless) != stretch;
                let latency = match restless && random(3) == 0 {
                    true => micros(500 + random(400)),
                    false => micros(random(60)),
                };
                let work = micros(random(850));
                let (spin, _) = cycle(&mut margin, latency, work);
                second.push_back((spin, work + spin, restless));
                (spun, busy) = (spun + spin, busy + work + spin);
                if second.len() > cycles {
                    let (spin, worked, _) = second.pop_front().unwrap();
                    (spun, busy) = (spun - spin, busy - worked);
                }
                (most, busiest) = (most.max(spun), busiest.max(busy));
            }
            let bound = (Duration::from_secs(1) + CREDIT + PERIOD).mul_f64(spin_share);
            assert!(most <= bound, "{spin_share}: {most:?}");
            assert!(busiest <= Duration::from_secs(1).mul_f64(BUSY_SHARE), "{busiest:?}");
        }
    }

    #[test]
    fn of_a_cluster_of_late_wake_ups_the_first_alone_is_late() {
        let mut margin = Margin::new(&Realtime::default(), PERIOD);
        let (mut late, mut spun) = (0, Duration::ZERO);
        for number in 0..100_000 {
            // Four late wake-ups of 400 µs, 8 cycles apart, every 2 s.
            let clustered = (1000..1032).contains(&(number % 2000)) && number % 8 == 0;
            let latency = micros(if clustered { 400 } else { 40 });
            let (spin, is_late) = cycle(&mut margin, latency, micros(30));
            late += u32::from(clustered && is_late);
            spun += spin;
        }
        assert_eq!(late, 50);
        assert!(spun < 100_000 * PERIOD / 5, "{spun:?}");
    }

    #[test]
    fn an_alert_wait_spends_what_was_saved_and_no_more() {
        // Credit, reserved spin time, expected margin; in µs of a period of 1000 with a share of 0.2.
        for (saved, reserved, expected) in
            [(0, 0, 200), (100, 0, 300), (100, 50, 250), (10_000, 0, 500), (-150, 0, 50), (-300, 0, 0)]
        {
            let mut margin = Margin::new(&Realtime::default(), PERIOD);
            margin.observe(micros(900));
            margin.credit = 1000 * saved;
            let found = margin.allowed(Duration::ZERO, micros(reserved));
            assert_eq!(found, micros(expected), "{saved} {reserved}");
        }
        let mut margin = Margin::new(&Realtime::default(), PERIOD);
        margin.settle(Duration::MAX, Duration::ZERO);
        assert_eq!(margin.credit, 10_000_000);
        assert_eq!(margin.allowed(Duration::ZERO, Duration::ZERO), micros(200));
    }

    #[test]
    fn the_hybrid_wait_ends_at_its_deadline_and_not_before() {
        let mut waiter = Waiter::new(&Realtime::default(), PERIOD);
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
