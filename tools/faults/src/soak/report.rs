//! Report of a soak: one table, and JSON.

use std::fmt;
use std::sync::atomic::Ordering;

use can::Instant;
use mrroc::cell::CellFile;
use serde::Serialize;

use super::stage::Stage;
use super::{SoakOptions, names};

/// Greatest number of failures and notes that a report keeps.
const MOST: usize = 1000;

/// Greatest growth of the memory of the process from the first quarter of a soak to its end, KiB.
///
/// The lists of the report are bounded, and have 1 MiB at most. Each controller allocates its queues anew, some 4 MiB for
/// the records of the servo, and the memory of the queues before may remain free between other blocks. The rest is room for
/// smaller blocks. One byte in five cycles that is never freed exceeds the limit within 24 h at a period of 2 ms.
pub const MOST_GROWTH_KIB: u64 = 8 * 1024;

/// What became of the faults of one kind.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SoakKind {
    /// Name of the fault in the fault table.
    pub fault: &'static str,
    /// Faults that struck.
    pub injected: u64,
    /// Faults that stopped no robot.
    pub tolerated: u64,
    /// Faults that stopped a robot.
    pub detected: u64,
    /// Slowest detection, s after the beginning of the fault.
    pub slowest_detection: f64,
    /// Detected faults after which the task brought all robots back.
    pub recovered: u64,
    /// Faults after which a new controller was started.
    pub restarted: u64,
    /// Faults after which the supply of the drives was switched off and on.
    pub power_switched: u64,
    /// Faults after which a reference was wrong and no robot had stopped for it.
    pub drifted: u64,
    /// Faults after which the robots did not work again.
    pub failed: u64,
}

/// A failure, or a note, with its time.
#[derive(Clone, Debug, Serialize)]
pub struct SoakNote {
    /// Virtual time, s.
    pub at_s: f64,
    /// What happened.
    pub what: String,
}

/// Report of a soak.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SoakReport {
    /// Name of the cell.
    pub cell: String,
    /// Seed of the faults.
    pub seed: u64,
    /// Virtual time, s.
    pub time_s: f64,
    /// Servo cycles.
    pub cycles: u64,
    /// Rounds of all robots: to a pose and back.
    pub rounds: u64,
    /// Errors that the task received.
    pub errors: u64,
    /// What became of the faults, by kinds.
    pub kinds: Vec<SoakKind>,
    /// Times at which a robot took its reference.
    pub references: u64,
    /// Comparisons of true and measured positions at rest, for each robot.
    pub comparisons: Vec<u64>,
    /// Least and greatest difference of true and measured position of any axis, increments of the encoder. An axis that
    /// homes at its present position (CiA 402 method 37), such as a belt, can have any difference.
    pub reference_increments: (f64, f64),
    /// Greatest change of such a difference without homing, increments.
    pub greatest_drift: f64,
    /// Controllers that were started after the first one.
    pub restarts: u64,
    /// Starts of a controller that were refused.
    pub failed_starts: u64,
    /// Records of the servo that were lost.
    pub lost_records: u64,
    /// Events of steps that were lost.
    pub lost_steps: u64,
    /// Frames that were lost in traces.
    pub lost_frames: u64,
    /// References that changed, with their times.
    pub drifts: Vec<SoakNote>,
    /// Failures, with their times.
    pub failures: Vec<SoakNote>,
    /// Other events.
    pub notes: Vec<SoakNote>,
    /// Memory of the process, KiB, after the first quarter of the time and at the end, where the caller measured them.
    pub memory_kib: Option<(u64, u64)>,
    /// Duration on the clock, s, where the caller measured it.
    pub wall_s: Option<f64>,
}

impl SoakReport {
    pub(super) fn new(file: &CellFile, options: &SoakOptions) -> Self {
        let kinds = names().map(|fault| SoakKind { fault, ..SoakKind::default() });
        Self {
            cell: file.cell.name.clone(),
            seed: options.seed,
            kinds: kinds.collect(),
            comparisons: vec![0; file.cell.robot.len()],
            reference_increments: (f64::INFINITY, f64::NEG_INFINITY),
            ..Self::default()
        }
    }

    pub(super) fn kind(&mut self, name: &str) -> &mut SoakKind {
        self.kinds.iter_mut().find(|kind| kind.fault == name).expect("the report has all faults")
    }

    pub(super) fn note_reference(&mut self, increments: f64) {
        let (least, most) = self.reference_increments;
        self.reference_increments = (least.min(increments), most.max(increments));
    }

    pub(super) fn note_drift(&mut self, drift: f64) {
        self.greatest_drift = self.greatest_drift.max(drift);
    }

    /// Notes the memory of the process, KiB, after the first quarter of the soak.
    pub(super) fn note_memory(&mut self, now: u64) {
        let (early, _) = self.memory_kib.unwrap_or((now, now));
        self.memory_kib = Some((early, now));
    }

    pub(super) fn drift(&mut self, at: Instant, what: String) {
        keep(&mut self.drifts, at, what);
    }

    pub(super) fn note(&mut self, at: Instant, what: String) {
        keep(&mut self.notes, at, what);
    }

    pub(super) fn fail(&mut self, at: Instant, what: String) {
        keep(&mut self.failures, at, what);
    }

    /// Whether a reference changed at or after this time.
    pub(super) fn drifted_since(&self, at: Instant) -> bool {
        let since = at.since(Instant::ZERO).as_secs_f64();
        self.drifts.last().is_some_and(|drift| drift.at_s >= since)
    }

    pub(super) fn complete(&mut self, stage: &Stage) {
        let sum = |counts: fn(&super::work::Counts) -> u64| stage.counts.iter().map(counts).sum();
        self.time_s = stage.now.since(Instant::ZERO).as_secs_f64();
        self.cycles = stage.cycles;
        self.rounds = sum(|counts| counts.rounds.load(Ordering::Relaxed));
        self.errors = sum(|counts| counts.errors.load(Ordering::Relaxed));
        (self.lost_records, self.lost_steps, self.lost_frames) =
            (stage.lost.records, stage.lost.steps, stage.lost.frames);
    }

    /// Sum of a count over all kinds.
    pub fn sum(&self, count: fn(&SoakKind) -> u64) -> u64 {
        self.kinds.iter().map(count).sum()
    }

    /// Whether no entry was lost, no reference changed, no failure occurred, the memory grew by at most
    /// [`MOST_GROWTH_KIB`], and the positions of each robot were compared more than once.
    pub fn is_good(&self) -> bool {
        let lost = self.lost_records + self.lost_steps + self.lost_frames;
        let grew = self.memory_kib.map_or(0, |(early, late)| late.saturating_sub(early));
        lost == 0
            && grew <= MOST_GROWTH_KIB
            && self.failures.is_empty()
            && self.drifts.is_empty()
            && self.comparisons.iter().all(|&count| count > 1)
    }
}

fn keep(list: &mut Vec<SoakNote>, at: Instant, what: String) {
    if list.len() < MOST {
        list.push(SoakNote { at_s: at.since(Instant::ZERO).as_secs_f64(), what });
    }
}

/// The tables, in Markdown.
impl fmt::Display for SoakReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "| {} | |\n|---|---|", self.cell)?;
        let mut row = |name: &str, value: String| writeln!(f, "| {name} | {value} |");
        row("simulated time", format!("{:.2} h", self.time_s / 3600.0))?;
        row("servo cycles", self.cycles.to_string())?;
        row("rounds of all robots", self.rounds.to_string())?;
        row("faults", self.sum(|kind| kind.injected).to_string())?;
        row("tolerated", self.sum(|kind| kind.tolerated).to_string())?;
        row("detected", self.sum(|kind| kind.detected).to_string())?;
        row("recovered without restart", self.sum(|kind| kind.recovered).to_string())?;
        row("recovered by a restart", self.sum(|kind| kind.restarted).to_string())?;
        row("recovered by switching the supply", self.sum(|kind| kind.power_switched).to_string())?;
        row("not recovered", self.sum(|kind| kind.failed).to_string())?;
        row("other failures", (self.failures.len() as u64 - self.sum(|kind| kind.failed)).to_string())?;
        row("references taken", self.references.to_string())?;
        row("comparisons at rest", self.comparisons.iter().sum::<u64>().to_string())?;
        row("references that changed", self.drifts.len().to_string())?;
        row("greatest drift", format!("{:.2} increments", self.greatest_drift))?;
        let (least, most) = self.reference_increments;
        row("true less measured position", format!("{least:.2} to {most:.2} increments"))?;
        row(
            "lost records, steps, frames",
            format!("{}, {}, {}", self.lost_records, self.lost_steps, self.lost_frames),
        )?;
        if let Some((early, late)) = self.memory_kib {
            row("memory after a quarter and at the end", format!("{early} KiB, {late} KiB"))?;
            row("greatest permitted growth of the memory", format!("{MOST_GROWTH_KIB} KiB"))?;
        }
        if let Some(wall) = self.wall_s {
            row("duration, times real time", format!("{wall:.0} s, {:.0}", self.time_s / wall))?;
        }
        writeln!(
            f,
            "\n| fault | strikes | tolerated | detected | slowest | task | restart | supply | drift | failed |"
        )?;
        writeln!(f, "|---|---|---|---|---|---|---|---|---|---|")?;
        for kind in self.kinds.iter().filter(|kind| kind.injected + kind.failed > 0) {
            let SoakKind { fault, injected, tolerated, detected, recovered, restarted, .. } = kind;
            let slowest = match detected {
                0 => "—".to_owned(),
                _ => format!("{:.0} ms", 1e3 * kind.slowest_detection),
            };
            let SoakKind { power_switched, drifted, failed, .. } = kind;
            writeln!(
                f,
                "| {fault} | {injected} | {tolerated} | {detected} | {slowest} | {recovered} | {restarted} | \
                 {power_switched} | {drifted} | {failed} |"
            )?;
        }
        for (title, list) in
            [("Failures", &self.failures), ("Changed references", &self.drifts), ("Notes", &self.notes)]
        {
            if !list.is_empty() {
                writeln!(f, "\n{title}:\n")?;
            }
            for SoakNote { at_s, what } in list.iter().take(20) {
                writeln!(f, "- {at_s:.1} s: {what}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_that_grows_beyond_its_bound_is_not_good() {
        let start = 20_000;
        for (grown, good) in [(0, true), (MOST_GROWTH_KIB, true), (MOST_GROWTH_KIB + 1, false)] {
            let mut report = SoakReport { comparisons: vec![2], ..SoakReport::default() };
            report.note_memory(start);
            // Growth before the end that is freed again does not count.
            report.note_memory(start + 100_000);
            report.note_memory(start + grown);
            assert_eq!((report.memory_kib, report.is_good()), (Some((start, start + grown)), good));
        }
        let mut report = SoakReport { comparisons: vec![2], ..SoakReport::default() };
        assert!(report.is_good(), "a caller that does not measure");
        report.note_memory(start);
        report.note_memory(1_000);
        assert!(report.is_good(), "the memory became less");
    }
}
