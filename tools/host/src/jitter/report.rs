//! Report of `mrroc jitter`: one JSON object, or tables for a person.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;
use servo::thread::{LateCycles, Scheduler, Wait, WaitReport};

use super::cell::CellReport;
use super::interval::Latencies;
use super::verdict::{self, Fit, Tail};
use super::{Peer, load};
use mrroc::report::{Percentiles, WaitCost, microseconds};

/// Subject and conditions of a measurement.
#[derive(Debug, Serialize)]
pub(super) struct Setting {
    /// Time from one deadline to the next, µs.
    pub(super) period_us: f64,
    /// Duration of the measurement of each side, s.
    pub(super) seconds: f64,
    /// Number of turns of each side.
    pub(super) rounds: u32,
    /// Duration of the first turn of each side, which is not counted, s.
    pub(super) warm_up_s: f64,
    /// Scheduling policy of our thread.
    pub(super) scheduler: Scheduler,
    /// Priority of the threads under SCHED_FIFO.
    pub(super) priority: u8,
    /// The CPU to which both sides were pinned.
    pub(super) cpu: Option<usize>,
    /// Kind of wait of our thread.
    pub(super) wait: Wait,
    /// Load of the host.
    pub(super) load: Vec<load::Kind>,
    /// The peer.
    pub(super) against: Option<Peer>,
    /// Whether deep idle states were disabled, for both sides.
    pub(super) cpu_latency_held: bool,
    /// Time that a hypervisor took from all processors during the measurement, according to the kernel, ms.
    pub(super) stolen_ms: u64,
    /// Whether Ctrl-C or a failed write ended the measurement early.
    pub(super) ended_early: bool,
    /// Requests that the host denied.
    pub(super) denied: Vec<String>,
}

/// The setting in one line, without the denied requests.
impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let wait = match self.wait {
            Wait::Plain => "plain",
            Wait::Hybrid => "hybrid",
        };
        let Self { period_us, priority, .. } = self;
        write!(f, "period {period_us} µs, {wait} wait, ")?;
        match self.scheduler {
            Scheduler::Fifo => write!(f, "SCHED_FIFO {priority}, ")?,
            Scheduler::Deadline => f.write_str("SCHED_DEADLINE, ")?,
        }
        match self.cpu {
            Some(cpu) => write!(f, "CPU {cpu}, ")?,
            None => f.write_str("any CPU, ")?,
        }
        let loads = self.load.iter().map(|load| load.name());
        match loads.collect::<Vec<_>>().join(", ") {
            none if none.is_empty() => f.write_str("no load"),
            loads => write!(f, "load {loads}"),
        }
    }
}

/// The report.
#[derive(Debug, Serialize)]
pub struct JitterReport {
    #[serde(flatten)]
    setting: Setting,
    /// Measurements of the cycle of the cell, if a cell was measured. The latency of our side then runs from the
    /// deadline to SYNC.
    cell: Option<CellReport>,
    /// Our thread.
    ours: Side,
    /// The peer.
    peer: Option<Side>,
    /// Latency of our thread divided by the peer's, without unit; not a number, which is null in JSON, if the peer's is zero.
    ratio: Option<Percentiles>,
    /// Number of our wake-ups, or SYNCs of the cell, that were late by more than a hundredth of the period, by cause.
    causes: BTreeMap<&'static str, u64>,
    /// The latest of these wake-ups.
    worst: Vec<Late>,
    /// How well this period and the usual periods are kept.
    fits: Vec<Fit>,
    /// Shares of host and thread in the latency tail; null without a peer.
    tail: Option<Tail>,
    /// The verdict as text.
    verdict: String,
}

/// Latencies of one side, µs.
#[derive(Debug, Serialize)]
pub(super) struct Side {
    #[serde(flatten)]
    late: Percentiles,
    /// Number of wake-ups.
    cycles: u64,
    /// Number of wake-ups that were late by more than 10 s. Percentiles take them for 10 s.
    beyond_10_s: u64,
    /// Number of skipped deadlines; null for cyclictest, which does not report it.
    #[serde(skip_serializing_if = "Option::is_none")]
    missed: Option<u64>,
    #[serde(flatten)]
    cost: Option<WaitCost>,
}

impl Side {
    pub(super) fn of(late: &Latencies, missed: Option<u64>, cost: Option<WaitReport>) -> Self {
        let (cycles, beyond_10_s) = (late.len(), late.beyond);
        Self { late: percentiles(late), cycles, beyond_10_s, missed, cost: cost.map(WaitCost::from) }
    }
}

pub(super) fn percentiles(late: &Latencies) -> Percentiles {
    let micros = |nanos: u64| nanos as f64 / 1e3;
    let quantile = |share| micros(late.counts.value_at_quantile(share));
    Percentiles::of(quantile, micros(late.max()))
}

/// One late wake-up.
#[derive(Debug, Serialize)]
pub(super) struct Late {
    /// Time from the deadline to the wake-up, µs.
    late_us: f64,
    cause: &'static str,
}

impl JitterReport {
    /// Evaluates the measurements.
    pub(super) fn of(
        setting: Setting,
        ours: Side,
        peer: Option<Side>,
        late: &LateCycles,
        cell: Option<CellReport>,
    ) -> Self {
        let over = |ours, peer| if peer > 0.0 { ours / peer } else { f64::NAN };
        let ratio = (peer.as_ref()).map(|peer| verdict::each(&ours.late, &peer.late, over));
        // The percentiles of a thread without a cell already contain the delay of skipped deadlines.
        let skipped = (cell.as_ref()).and(ours.missed).unwrap_or(0);
        let fits = verdict::fits(&ours.late, setting.period_us, ours.cycles, skipped);
        let tail = (peer.as_ref()).map(|peer| verdict::tail(&ours.late, &peer.late));
        let causes = late.causes();
        let worst = late.worst().map(|worst| Late { late_us: microseconds(worst.late), cause: worst.cause.name() });
        Self {
            verdict: verdict::words(&fits, tail.as_ref(), ours.cycles, !setting.load.is_empty()),
            fits,
            tail,
            setting,
            cell,
            ours,
            peer,
            ratio,
            causes: causes.map(|(cause, count)| (cause.name(), count)).collect(),
            worst: worst.collect(),
        }
    }
}

/// Columns of the table.
fn columns(late: &Percentiles) -> [f64; 4] {
    [late.p50, late.p99, late.p999, late.max]
}

impl fmt::Display for JitterReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:11} {:>10} {:>10} {:>10} {:>10} {:>10} {:>8}",
            "late by, µs", "p50", "p99", "p99.9", "max", "cycles", "missed"
        )?;
        let mut side = |name: &str, side: &Side| {
            let missed = side.missed.map_or("-".to_owned(), |missed| missed.to_string());
            let late = columns(&side.late).map(|late| format!("{late:>10.3}")).join(" ");
            write!(f, "{name:11} {late} {:>10} {missed:>8}", side.cycles)?;
            match side.beyond_10_s {
                0 => writeln!(f),
                count => writeln!(f, "   {count} beyond 10 s, which the percentiles take for 10 s"),
            }
        };
        side("ours", &self.ours)?;
        if let (Some(peer), Some(against)) = (&self.peer, self.setting.against) {
            side(against.name(), peer)?;
        }
        if let Some(ratio) = &self.ratio {
            let shown = |ratio: f64| match ratio.is_nan() {
                true => "-".to_owned(),
                false => format!("{ratio:.4}"),
            };
            let ratio = columns(ratio).map(|ratio| format!("{:>10}", shown(ratio)));
            writeln!(f, "{:11} {}", "ratio", ratio.join(" "))?;
        }
        if let Some(cell) = &self.cell {
            let times = [("wake-up", cell.wake_us), ("step", cell.step_us), ("bus", cell.bus_us)];
            // The time of an answer is unknown for a tty.
            for (name, times) in times.into_iter().filter(|(_, times)| times.max > 0.0) {
                let times = columns(&times).map(|time| format!("{time:>10.3}"));
                writeln!(f, "{name:11} {}", times.join(" "))?;
            }
            writeln!(f, "\nours is from deadline to SYNC; cell {}: {}", cell.name, cell.state)?;
            for wire in &cell.wire {
                write!(f, "{wire}")?;
            }
        }
        writeln!(f)?;
        if let Some(cost) = self.ours.cost.filter(|cost| cost.spin_percent > 0.0) {
            writeln!(f, "woken {:.0} µs early, {:.1} % of a core spent spinning", cost.margin_us, cost.spin_percent)?;
        }
        let causes = self.causes.iter().filter(|(_, count)| **count > 0);
        let causes: Vec<_> = causes.map(|(cause, count)| format!("{cause} {count}")).collect();
        if !causes.is_empty() {
            writeln!(f, "more than {} µs late: {}", self.setting.period_us / 100.0, causes.join(", "))?;
            let worst = self.worst.iter();
            let worst: Vec<_> = worst.map(|late| format!("{:.0} µs {}", late.late_us, late.cause)).collect();
            writeln!(f, "the worst: {}", worst.join(", "))?;
        }
        if self.setting.stolen_ms > 0 {
            let stolen = self.setting.stolen_ms;
            writeln!(f, "the hypervisor took {stolen} ms from all processors meanwhile")?;
        }
        for denied in &self.setting.denied {
            writeln!(f, "denied: {denied}")?;
        }
        f.write_str(&self.verdict.replace("; ", "\n"))
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use servo::thread::{Cause, LateCycle};

    use super::*;

    /// A measurement of `late`, s, all of them among the worst.
    fn report(late: &[u64]) -> JitterReport {
        let (mut latencies, mut worst) = (Latencies::empty(), LateCycles::default());
        for (cycle, &seconds) in (0..).zip(late) {
            let late = Duration::from_secs(seconds);
            latencies.record(late.as_nanos() as u64, 1);
            worst.record(LateCycle { cycle, due: Duration::from_secs(20 * cycle), late, cause: Cause::Host });
        }
        let setting = Setting {
            period_us: 1000.0,
            seconds: 1.0,
            rounds: 1,
            warm_up_s: 0.0,
            scheduler: Scheduler::Fifo,
            priority: 80,
            cpu: None,
            wait: Wait::Hybrid,
            load: Vec::new(),
            against: None,
            cpu_latency_held: true,
            stolen_ms: 0,
            ended_early: false,
            denied: Vec::new(),
        };
        JitterReport::of(setting, Side::of(&latencies, Some(0), None), None, &worst, None)
    }

    #[test]
    fn the_table_and_the_worst_agree_beyond_the_bound_of_the_histogram() {
        let report = report(&[1, 14, 11]);
        let printed = report.to_string();
        let row = printed.lines().find(|line| line.starts_with("ours")).unwrap();
        let columns: Vec<_> = row.split_whitespace().collect();
        assert_eq!(columns[4], "14000000.000", "{printed}");
        assert!(row.ends_with("2 beyond 10 s, which the percentiles take for 10 s"), "{printed}");
        assert!(printed.contains("the worst: 14000000 µs host"), "{printed}");
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["ours"]["beyond_10_s"], 2);
        assert_eq!(json["ours"]["max"], 14e6);
    }

    #[test]
    fn a_row_within_the_bound_has_no_note() {
        assert!(!report(&[1, 2]).to_string().contains("beyond"));
    }
}
