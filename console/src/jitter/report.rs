//! What `mrroc jitter` says at its end: one JSON object, or tables for a person.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;
use servo::Histogram;
use servo::thread::WaitReport;

use super::probe::Wakeups;
use super::{Peer, Wait, load};
use crate::report::{Percentiles, WaitCost, microseconds};

/// What was measured, and how.
#[derive(Debug, Serialize)]
pub(super) struct Setting {
    /// Time from one deadline to the next, µs.
    pub(super) period_us: f64,
    /// Time measured, of each side.
    pub(super) seconds: f64,
    /// Turns of each side.
    pub(super) rounds: u32,
    /// Priority under SCHED_FIFO.
    pub(super) priority: u8,
    /// The CPU both sides stayed on.
    pub(super) cpu: Option<usize>,
    /// How ours waited.
    pub(super) wait: Wait,
    /// What loaded the host.
    pub(super) load: Vec<load::Kind>,
    /// Who the peer was.
    pub(super) against: Option<Peer>,
    /// Whether deep idle states were kept away, for both.
    pub(super) cpu_latency_held: bool,
    /// What the host denied.
    pub(super) denied: Vec<String>,
}

/// The report.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    #[serde(flatten)]
    setting: Setting,
    /// Our thread.
    ours: Side,
    /// The peer.
    peer: Option<Side>,
    /// Ours over the peer's; null where the peer's is zero.
    ratio: Option<Ratio>,
    /// How many wake-ups of ours were more than a hundredth of the period late, by cause.
    causes: BTreeMap<&'static str, u64>,
    /// The latest wake-ups of ours.
    worst: Vec<Late>,
    /// What it means for this period.
    verdict: String,
}

/// One side: the error of its wake-ups, µs.
#[derive(Debug, Serialize)]
pub(super) struct Side {
    #[serde(flatten)]
    late: Percentiles,
    /// Wake-ups.
    cycles: u64,
    /// Deadlines skipped; null for cyclictest, which does not tell.
    #[serde(skip_serializing_if = "Option::is_none")]
    missed: Option<u64>,
    #[serde(flatten)]
    cost: Option<WaitCost>,
}

impl Side {
    pub(super) fn of(late: &Histogram) -> Self {
        Self {
            late: Percentiles::from(late),
            cycles: late.count(),
            missed: None,
            cost: None,
        }
    }

    pub(super) fn ours(wakeups: &Wakeups, cost: &WaitReport) -> Self {
        Self {
            missed: Some(wakeups.missed),
            cost: Some(WaitCost::from(*cost)),
            ..Self::of(&wakeups.late)
        }
    }
}

/// Ours over the peer's.
#[derive(Debug, Serialize)]
pub(super) struct Ratio {
    p50: Option<f64>,
    p99: Option<f64>,
    p999: Option<f64>,
    max: Option<f64>,
}

/// One late wake-up.
#[derive(Debug, Serialize)]
pub(super) struct Late {
    late_us: f64,
    cause: &'static str,
}

impl Report {
    /// What follows from what was measured.
    pub(super) fn of(setting: Setting, ours: Side, peer: Option<Side>, wakeups: &Wakeups) -> Self {
        let over = |ours: f64, peer: f64| (peer > 0.0).then(|| ours / peer);
        let ratio = peer.as_ref().map(|peer| Ratio {
            p50: over(ours.late.p50, peer.late.p50),
            p99: over(ours.late.p99, peer.late.p99),
            p999: over(ours.late.p999, peer.late.p999),
            max: over(ours.late.max, peer.late.max),
        });
        let peer_late = peer.as_ref().map(|peer| peer.late);
        let causes = wakeups.causes.causes();
        let worst = wakeups.causes.worst().map(|worst| Late {
            late_us: microseconds(worst.late),
            cause: worst.cause.name(),
        });
        Self {
            verdict: verdict(&ours.late, peer_late.as_ref(), setting.period_us),
            setting,
            ours,
            peer,
            ratio,
            causes: causes.map(|(cause, count)| (cause.name(), count)).collect(),
            worst: worst.collect(),
        }
    }
}

/// Whether this host is good for a period, µs, and whose the tail is.
fn verdict(ours: &Percentiles, peer: Option<&Percentiles>, period: f64) -> String {
    let near = period / 20.0;
    let fit = if ours.max <= near {
        format!("good for {period} µs: every wake-up within a twentieth of the period")
    } else if ours.p999 <= near && ours.max <= period / 2.0 {
        format!(
            "good enough for {period} µs: 999 of 1000 wake-ups within a twentieth of the period, all within half"
        )
    } else if ours.p999 <= period / 2.0 {
        format!(
            "fit for {period} µs only where a late cycle does no harm: the worst was {:.0} µs late",
            ours.max
        )
    } else {
        format!(
            "not fit for {period} µs: one wake-up in 1000 is {:.0} µs late or later",
            ours.p999
        )
    };
    let tail = match peer {
        _ if ours.max <= near => "",
        Some(peer) if peer.max >= ours.max / 2.0 => {
            "; the peer's worst is as bad, so the tail is the host's"
        }
        Some(_) => {
            "; the peer's worst is less than half of it, so measure longer before the host is blamed"
        }
        None => "; measure --against cyclictest or plain to see whether the tail is the host's",
    };
    fit + tail
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:11} {:>10} {:>10} {:>10} {:>10} {:>10} {:>8}",
            "late by, µs", "p50", "p99", "p99.9", "max", "cycles", "missed"
        )?;
        let mut side = |name: &str, side: &Side| {
            let missed = side
                .missed
                .map_or("-".to_owned(), |missed| missed.to_string());
            let Percentiles {
                p50,
                p99,
                p999,
                max,
            } = side.late;
            writeln!(
                f,
                "{name:11} {p50:>10.3} {p99:>10.3} {p999:>10.3} {max:>10.3} {:>10} {missed:>8}",
                side.cycles
            )
        };
        side("ours", &self.ours)?;
        if let (Some(peer), Some(against)) = (&self.peer, self.setting.against) {
            side(
                match against {
                    Peer::Cyclictest => "cyclictest",
                    Peer::Plain => "plain probe",
                },
                peer,
            )?;
        }
        if let Some(Ratio {
            p50,
            p99,
            p999,
            max,
        }) = &self.ratio
        {
            let [p50, p99, p999, max] = [p50, p99, p999, max]
                .map(|ratio| ratio.map_or("-".to_owned(), |ratio| format!("{ratio:.4}")));
            writeln!(f, "{:11} {p50:>10} {p99:>10} {p999:>10} {max:>10}", "ratio")?;
        }
        writeln!(f)?;
        if let Some(cost) = self.ours.cost.filter(|cost| cost.spin_percent > 0.0) {
            writeln!(
                f,
                "woken {:.0} µs early, {:.1} % of a core spent spinning",
                cost.margin_us, cost.spin_percent
            )?;
        }
        let causes = self.causes.iter().filter(|(_, count)| **count > 0);
        let causes: Vec<_> = causes
            .map(|(cause, count)| format!("{cause} {count}"))
            .collect();
        if !causes.is_empty() {
            writeln!(
                f,
                "more than {} µs late: {}",
                self.setting.period_us / 100.0,
                causes.join(", ")
            )?;
            let worst = self.worst.iter();
            let worst: Vec<_> = worst
                .map(|late| format!("{:.0} µs {}", late.late_us, late.cause))
                .collect();
            writeln!(f, "the worst: {}", worst.join(", "))?;
        }
        for denied in &self.setting.denied {
            writeln!(f, "denied: {denied}")?;
        }
        write!(f, "{}", self.verdict)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn late(p50: f64, p99: f64, p999: f64, max: f64) -> Percentiles {
        Percentiles {
            p50,
            p99,
            p999,
            max,
        }
    }

    #[test]
    fn a_verdict_says_how_far_the_period_is_kept_and_whose_the_tail_is() {
        let calm = late(0.1, 0.2, 10.0, 40.0);
        let tail = late(0.1, 0.2, 40.0, 400.0);
        let spikes = late(0.1, 0.2, 300.0, 5000.0);
        let broken = late(30.0, 100.0, 600.0, 5000.0);
        for (ours, peer, needles) in [
            (calm, Some(spikes), ["good for 1000 µs", "every"]),
            (calm, None, ["good for 1000 µs", "every"]),
            (tail, Some(spikes), ["good enough", "the host's"]),
            (tail, Some(calm), ["good enough", "measure longer"]),
            (tail, None, ["good enough", "--against"]),
            (spikes, Some(spikes), ["5000 µs late", "the host's"]),
            (broken, Some(calm), ["not fit", "600 µs"]),
        ] {
            let said = verdict(&ours, peer.as_ref(), 1000.0);
            for needle in needles {
                assert!(said.contains(needle), "{ours:?} {peer:?}: {said}");
            }
        }
    }
}
