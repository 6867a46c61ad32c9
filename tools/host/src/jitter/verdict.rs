//! Evaluation of a measurement: the periods that this host can keep, and the cause of the latency tail.
//!
//! A period is *kept well* if every wake-up was within a twentieth of it. The answers of the drives have then arrived,
//! and no drive receives a set-point late. A period is *kept* if 999 of 1000 wake-ups were within a twentieth and all
//! within half of it. Beyond half of its period, the servo skips a cycle. A period is *kept with skipped cycles* if 999
//! of 1000 are within half of it, and otherwise *not kept*. A verdict is provisional with fewer than [`ENOUGH`] cycles,
//! or without load on the host.
//!
//! Latency that the peer suffered in the same run is attributed to the host. Only the excess of our thread over the
//! peer may be caused by the thread.

use std::fmt::Write as _;

use serde::Serialize;

use mrroc::report::{Percentiles, counted};

/// Minimum number of cycles for a statement about 999 of 1000: the latest thousandth has then a hundred cycles.
const ENOUGH: u64 = 100_000;

/// Usual periods of laboratories, µs, evaluated in addition to the measured period.
const USUAL: [f64; 2] = [1000.0, 2000.0];

/// Grade of a period.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Grade {
    /// All wake-ups within a twentieth of the period.
    Good,
    /// 999 of 1000 within a twentieth, all within half of the period.
    GoodEnough,
    /// 999 of 1000 within half of the period.
    SkipsCycles,
    /// Fewer than 999 of 1000 within half of the period.
    NotFit,
}

impl Grade {
    /// The `skipped` cycles are not contained in the percentiles.
    fn of(late: &Percentiles, period: f64, cycles: u64, skipped: u64) -> Self {
        let (near, half) = (period / 20.0, period / 2.0);
        if 1000 * skipped > cycles + skipped {
            return Self::NotFit;
        }
        if skipped == 0 && late.max <= near {
            Self::Good
        } else if skipped == 0 && late.p999 <= near && late.max <= half {
            Self::GoodEnough
        } else if late.p999 <= half {
            Self::SkipsCycles
        } else {
            Self::NotFit
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Good => "good, every wake-up within a twentieth of it",
            Self::GoodEnough => "good enough, 999 of 1000 within a twentieth of it and all within half",
            Self::SkipsCycles => "only where a late cycle does no harm, some are later than half of it",
            Self::NotFit => "not fit, more than one in 1000 is later than half of it",
        }
    }
}

/// Grade of one period.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct Fit {
    period_us: f64,
    grade: Grade,
}

/// Shares in the latency tail, µs.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct Tail {
    /// Latency that the peer suffered as well.
    host: Percentiles,
    /// Latency of our thread beyond the peer's.
    own: Percentiles,
}

/// Grades of the usual periods and of `period`.
///
/// `skipped` is the number of cycles that the servo of a cell skipped; it counts against every period.
pub(super) fn fits(late: &Percentiles, period: f64, cycles: u64, skipped: u64) -> Vec<Fit> {
    if cycles == 0 {
        return Vec::new();
    }
    let own = Some(period).filter(|own| !USUAL.contains(own));
    let periods = USUAL.into_iter().chain(own);
    let fit = |period_us| Fit { period_us, grade: Grade::of(late, period_us, cycles, skipped) };
    periods.map(fit).collect()
}

/// Splits the latency tail into the share that the peer suffered in the same run and the share of our thread.
pub(super) fn tail(ours: &Percentiles, peer: &Percentiles) -> Tail {
    Tail { host: each(ours, peer, f64::min), own: each(ours, peer, |ours, peer| (ours - peer).max(0.0)) }
}

/// Combines our percentiles with those of the peer, one by one.
pub(super) fn each(ours: &Percentiles, peer: &Percentiles, of: fn(f64, f64) -> f64) -> Percentiles {
    Percentiles {
        p50: of(ours.p50, peer.p50),
        p99: of(ours.p99, peer.p99),
        p999: of(ours.p999, peer.p999),
        max: of(ours.max, peer.max),
    }
}

/// Text of the verdict.
pub(super) fn words(fits: &[Fit], tail: Option<&Tail>, cycles: u64, loaded: bool) -> String {
    if cycles == 0 {
        return "nothing was measured".into();
    }
    let mut said = String::new();
    for Fit { period_us, grade } in fits {
        let _ = write!(said, "{period_us} µs: {}; ", grade.words());
    }
    match tail {
        None => said += "--against plain or cyclictest shows which part of the tail is the host's",
        Some(Tail { host, own }) => {
            let _ = write!(
                said,
                "of the tail the host's are {:.1} µs at p99.9 and {:.1} µs at the worst, ours beyond it {:.1} and {:.1} µs",
                host.p999, host.max, own.p999, own.max
            );
        }
    }
    match (cycles < ENOUGH, loaded) {
        (true, _) => {
            let _ = write!(said, "; provisional: {}, {ENOUGH} say something of p99.9", counted(cycles, "cycle"));
        }
        (false, false) => said += "; provisional: the host was not loaded (--load)",
        (false, true) => {}
    }
    said
}

#[cfg(test)]
mod tests {
    use super::*;

    fn late(p50: f64, p99: f64, p999: f64, max: f64) -> Percentiles {
        Percentiles { p50, p99, p999, max }
    }

    #[test]
    fn a_period_is_graded_by_what_the_cycle_does_with_lateness() {
        for (late, grades) in [
            (late(0.1, 0.2, 10.0, 50.0), [Grade::Good, Grade::Good]),
            (late(0.1, 0.2, 10.0, 90.0), [Grade::GoodEnough, Grade::Good]),
            (late(0.1, 0.2, 50.0, 500.0), [Grade::GoodEnough; 2]),
            (late(0.1, 0.2, 51.0, 900.0), [Grade::SkipsCycles, Grade::GoodEnough]),
            (late(0.1, 0.2, 50.0, 1001.0), [Grade::SkipsCycles; 2]),
            (late(0.1, 9.0, 501.0, 502.0), [Grade::NotFit, Grade::SkipsCycles]),
            (late(0.1, 9.0, 1001.0, 5000.0), [Grade::NotFit; 2]),
        ] {
            let found: Vec<_> = fits(&late, 1000.0, ENOUGH, 0).iter().map(|fit| fit.grade).collect();
            assert_eq!(found, grades, "{late:?}");
        }
        let periods: Vec<_> =
            (fits(&late(0.0, 0.0, 0.0, 0.0), 250.0, ENOUGH, 0).iter()).map(|fit| fit.period_us).collect();
        assert_eq!(periods, [1000.0, 2000.0, 250.0]);
    }

    #[test]
    fn skipped_cycles_spoil_the_grade_and_nothing_measured_has_none() {
        let calm = late(0.1, 0.2, 1.0, 2.0);
        for (cycles, skipped, expected) in [
            (100_000, 0, Some(Grade::Good)),
            (100_000, 1, Some(Grade::SkipsCycles)),
            (99_900, 100, Some(Grade::SkipsCycles)),
            (99_899, 101, Some(Grade::NotFit)),
            (0, 5, None),
        ] {
            let fits = fits(&calm, 1000.0, cycles, skipped);
            assert_eq!(fits.first().map(|fit| fit.grade), expected, "{cycles} {skipped}");
        }
        assert_eq!(words(&[], None, 0, true), "nothing was measured");
    }

    #[test]
    fn the_tail_is_the_hosts_as_far_as_the_peer_suffered_it_too() {
        let ours = late(0.1, 2.0, 300.0, 5000.0);
        let tail = tail(&ours, &late(20.0, 80.0, 280.0, 7000.0));
        assert_eq!((tail.host.p999, tail.own.p999), (280.0, 20.0));
        assert_eq!((tail.host.max, tail.own.max), (5000.0, 0.0));
        let said = words(&fits(&ours, 1000.0, ENOUGH, 0), Some(&tail), ENOUGH, true);
        for needle in ["1000 µs: only where", "2000 µs:", "280.0 µs at p99.9", "20.0 and 0.0"] {
            assert!(said.contains(needle), "{said}");
        }
        assert!(!said.contains("provisional"));
    }

    #[test]
    fn a_short_or_an_idle_run_is_provisional_and_says_why() {
        for (cycles, loaded, needle) in
            [(ENOUGH - 1, true, "provisional: 99999 cycles"), (ENOUGH, false, "provisional: the host was not loaded")]
        {
            let said = words(&[], None, cycles, loaded);
            assert!(said.contains(needle) && said.contains("--against"), "{said}");
        }
    }
}
