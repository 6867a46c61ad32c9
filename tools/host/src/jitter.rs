//! `mrroc jitter`: measures the punctuality of a thread on this host that waits for deadlines as the servo thread does.
//!
//! The measured latency is the time from a deadline to the time at which the thread runs. The thread uses the wait of
//! the servo, without a servo. With a cell, the latency is the time from a deadline to its SYNC. The peer is cyclictest
//! or a probe with the same algorithm. Both sides take turns within the run, so that they see the same host.
//!
//! **Same conditions for both sides**: deep idle states are disabled for both, or for neither if the host denies it;
//! cyclictest is told not to change them. Both have the same priority under SCHED_FIFO. cyclictest also runs under
//! SCHED_FIFO if our thread runs under SCHED_DEADLINE. Both run on the same CPU, or are not pinned. All memory is
//! locked, the timer slack is 1 ns, and the first turn is not counted. No two turns overlap. Our latency is counted in
//! ns and the histogram of cyclictest in µs. The resolution of a ratio is therefore 1 µs.
//!
//! The output files of `--out` are described in `files`, the evaluation in `verdict`.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

mod bench;
mod cell;
mod chart;
mod cyclictest;
mod files;
mod interval;
mod load;
mod plan;
mod probe;
mod report;
mod verdict;

pub use report::JitterReport;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, anyhow, bail};
use can::clock;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};
use hdrhistogram::serialization::V2DeflateSerializer;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde::de::value::{self, StringDeserializer};
use servo::thread::{CpuLatency, Denial, Scheduler, Wait, Waiter};

use bench::CellBench;
use cell::{MeasuredCell, Unmeasured};
use files::{Files, IntervalLog};
use interval::{Ledger, recording};
use load::Load;
use plan::Plan;
use probe::{Turn, Wakeups};
use report::{Setting, Side};

use crate::doctor::stolen_ticks;
use mrroc::cell::CellFile;
use mrroc::outputs::{Measured, Outputs, Replacement};
use mrroc::signals;
use mrroc::spikes;

/// Options of `mrroc jitter`.
#[derive(Args)]
pub struct Options {
    /// Measure the whole cycle of this cell, from the deadline to SYNC. The drives are switched on and hold their
    /// position.
    #[arg(long, value_name = "FILE")]
    cell: Option<PathBuf>,
    /// The bench for the cell. [default: emulated]
    #[arg(long, value_enum)]
    bench: Option<CellBench>,
    /// The virtual interface of a bus, IFACE or BUS=IFACE, for --bench vcan. The interfaces of the cell file are never
    /// used.
    #[arg(long, value_name = "IFACE")]
    can: Vec<String>,
    /// Time from one deadline to the next, with its unit: 1ms, 250us. [default: the cell's, or 1ms]
    #[arg(long)]
    period: Option<String>,
    /// Duration of the measurement, with its unit: 60s, 10m, 1h. The peer is measured for the same time.
    #[arg(long, default_value = "60s")]
    duration: String,
    /// What schedules the thread; the cell's or fifo, unless given.
    #[arg(long, value_parser = words::<Scheduler>(SCHEDULERS))]
    scheduler: Option<Scheduler>,
    /// Priority under SCHED_FIFO, 1 to 99. [default: the cell's, or 80]
    #[arg(long)]
    priority: Option<u32>,
    /// The CPU to which the thread is pinned. [default: the cell's]
    #[arg(long)]
    cpu: Option<usize>,
    /// How to wait; the cell's or hybrid, unless given.
    #[arg(long, value_parser = words::<Wait>(WAITS))]
    wait: Option<Wait>,
    /// Time before a deadline at which a hybrid wait wakes up, with its unit: 100us. [default: the cell's, or learnt]
    #[arg(long)]
    margin: Option<String>,
    /// Largest share of a core that a hybrid wait spends spinning, 0 to 0.5. [default: the cell's, or 0.2]
    #[arg(long)]
    spin_share: Option<f64>,
    /// Load of all CPUs during the measurement; several kinds are separated by commas.
    #[arg(long, value_enum, value_delimiter = ',')]
    load: Vec<load::Kind>,
    /// The peer that is measured in turns with the thread.
    #[arg(long, value_enum)]
    against: Option<Peer>,
    /// Write ours.hgrm, peer.hgrm and ours.hlog in the format of the HdrHistogram tools, and jitter.svg, into this
    /// directory.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Write the cycles around the latest ones of our thread to this file, phase by phase, for ui.perfetto.dev.
    #[arg(long, value_name = "FILE")]
    spikes: Option<PathBuf>,
    #[command(flatten)]
    replacement: Replacement,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

/// The values of `--scheduler`.
const SCHEDULERS: [(&str, &str); 2] =
    [("fifo", "SCHED_FIFO"), ("deadline", "SCHED_DEADLINE, with nine tenths of each period")];

/// The values of `--wait`.
const WAITS: [(&str, &str); 2] =
    [("plain", "Sleep until the deadline"), ("hybrid", "Sleep to a learnt margin before the deadline, then spin")];

/// A parser of words that cell files have, each with its help.
fn words<T: DeserializeOwned + Clone + Send + Sync + 'static>(
    words: [(&'static str, &'static str); 2],
) -> impl TypedValueParser<Value = T> {
    let words = words.map(|(word, help)| PossibleValue::new(word).help(help));
    PossibleValuesParser::new(words).try_map(|word| T::deserialize(StringDeserializer::<value::Error>::new(word)))
}

/// The peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
enum Peer {
    /// cyclictest of Debian's package rt-tests.
    Cyclictest,
    /// A thread with the algorithm of cyclictest: an absolute sleep, and one reading of the clock.
    Plain,
}

impl Peer {
    fn name(self) -> &'static str {
        match self {
            Self::Cyclictest => "cyclictest",
            Self::Plain => "plain probe",
        }
    }
}

/// Progress of a measurement.
pub struct Progress {
    /// Number of rounds that have ended, without the warm-up.
    pub turn: u32,
    /// Number of rounds of the whole measurement.
    pub turns: u32,
    /// Results so far of the side whose turn it is.
    pub results: String,
}

/// Plan, progress and state of a measurement.
struct Course<'a> {
    plan: &'a Plan,
    over: &'a Arc<AtomicBool>,
    show: &'a dyn Fn(Progress),
    turn: u32,
    /// The first failure to write the interval log. The failure ends the measurement.
    failed: Option<std::io::Error>,
}

impl Course<'_> {
    /// Adds the new intervals to `ledger` and shows intermediate results.
    fn look(&mut self, ledger: &mut Ledger, who: &str) {
        if let Err(error) = ledger.drain() {
            self.over.store(true, Ordering::Relaxed);
            self.failed.get_or_insert(error);
        }
        let late = report::percentiles(&ledger.total);
        let results = format!(
            "{who}: {}, late by p50 {:.3} p99 {:.3} p99.9 {:.3} max {:.1} µs",
            mrroc::report::counted(ledger.total.len(), "cycle"),
            late.p50,
            late.p99,
            late.p999,
            late.max
        );
        (self.show)(Progress { turn: self.turn, turns: self.plan.rounds, results });
    }

    /// One turn of a thread of this process, whose wake-ups are recorded in `ledger`.
    fn thread(
        &mut self,
        wakeups: &mut Wakeups,
        ledger: &mut Ledger,
        who: &str,
        mut body: impl FnMut(&mut Wakeups) + Send,
    ) -> anyhow::Result<Vec<Denial>> {
        let Plan { realtime, period, .. } = self.plan;
        let look = || self.look(ledger, who);
        let denied = probe::on_thread(realtime, *period, || body(wakeups), look)?;
        // The last interval of a turn; all others are free by now.
        self.look(ledger, who);
        wakeups.late.hand_over();
        self.look(ledger, who);
        Ok(denied)
    }
}

/// Measures, and writes the files of the options. `show` receives intermediate results.
pub fn jitter(options: &Options, show: &dyn Fn(Progress)) -> anyhow::Result<Measured<JitterReport>> {
    let mut file = options.cell.as_deref().map(CellFile::read).transpose()?;
    let plan = Plan::of(options, file.as_ref().map(|file| &file.cell))?;
    if let Some(file) = &mut file {
        file.cell.period_us = plan.period.as_micros() as u32;
        mrroc::budget::check(file)?;
    }
    let bench = options.bench.unwrap_or(CellBench::Emulated);
    bench::check(file.as_ref(), bench, &options.can)?;
    let traffic = options.load.contains(&load::Kind::Bus);
    let buses = file.as_ref().map_or(0, |file| file.cell.bus.len());
    if traffic && (buses == 0 || bench != CellBench::Emulated) {
        bail!("--load bus needs the virtual CAN bus of --cell with --bench emulated; `cangen` loads an interface");
    }
    let mut cell = file.as_ref().map(|file| MeasuredCell::new(file, bench, &options.can, traffic));
    if options.against == Some(Peer::Cyclictest) {
        cyclictest::find()?;
    }
    Load::find(&options.load)?;
    let mut denied = probe::on_thread(&plan.realtime, plan.period, || (), || ())?;
    if let Some(cpu) = denied.iter().find(|one| matches!(one, Denial::Cpu { .. })) {
        bail!("{cpu}");
    }
    let mut outputs = Outputs::new(options.replacement);
    file.iter().for_each(|cell| outputs.reads(cell));
    let files = options.out.as_deref();
    let files = files.map(|directory| Files::open(&mut outputs, directory, options.against.is_some()));
    let (files, mut log) = files.transpose()?.unzip();
    let spikes = outputs.open_if("--spikes", options.spikes.as_deref())?;
    outputs.begin()?;
    let mut serializer = V2DeflateSerializer::new();
    let log = (log.as_mut()).map(|log| IntervalLog::begin(log, &mut serializer));
    let log = log.transpose().context("--out: ours.hlog cannot be written")?;
    let over = signals::ending_flag()?;
    let _load = Load::start(&options.load)?;
    let latency = CpuLatency::hold();

    let stolen_before = stolen();
    let began = clock::now();
    let (recorder, mut ledger) = recording(began, log);
    let mut ours = Wakeups::new(recorder);
    let (recorder, mut peers) = recording(began, None);
    let mut peer = Wakeups::new(recorder);
    let mut waiter = Waiter::new(&plan.realtime, plan.period);
    let mut course = Course { plan: &plan, over: &over, show, turn: 0, failed: None };
    let mut failure = None;
    for round in 0..=plan.rounds {
        // The first turn of each side warms up caches, clocks and the margin, and is not counted.
        let (recorder, mut unheard) = recording(began, None);
        let mut warming = Wakeups::new(recorder);
        let warm_up = round == 0;
        let (wakeups, into) = match warm_up {
            true => (&mut warming, &mut unheard),
            false => (&mut ours, &mut ledger),
        };
        let turn = Turn { period: plan.period, time: if warm_up { plan.warm_up } else { plan.turn }, over: &over };
        denied = match &mut cell {
            None => course.thread(wakeups, into, "ours", |to| {
                probe::wait(&mut waiter, to, turn);
            })?,
            Some(cell) => {
                if round == 1 {
                    cell.forget();
                }
                match cell.turn(plan.realtime, turn, into, |ledger| course.look(ledger, "ours")) {
                    Ok(denied) => denied,
                    Err(Unmeasured::Refused(why)) => return Err(why),
                    Err(Unmeasured::Hung(hang)) => {
                        // What was measured before is reported.
                        failure = Some(anyhow!("{hang}: {}", hang.remedy()));
                        over.store(true, Ordering::Relaxed);
                        break;
                    }
                }
            }
        };
        if turn.is_over() {
            break;
        }
        let (wakeups, into) = match warm_up {
            true => (&mut warming, &mut unheard),
            false => (&mut peer, &mut peers),
        };
        match options.against {
            None => {}
            Some(Peer::Plain) => {
                course.thread(wakeups, into, "plain probe", |to| probe::probe(to, turn))?;
            }
            Some(Peer::Cyclictest) => {
                let realtime = &plan.realtime;
                let interval = cyclictest::measure(turn, realtime.priority, realtime.cpu)?;
                into.add(&interval)?;
                course.look(into, "cyclictest");
            }
        }
        if turn.is_over() {
            break;
        }
        course.turn = round;
    }
    let failed = course.failed.take();

    let setting = Setting {
        period_us: mrroc::report::microseconds(plan.period),
        seconds: (plan.turn * plan.rounds).as_secs_f64(),
        rounds: plan.rounds,
        warm_up_s: plan.warm_up.as_secs_f64(),
        scheduler: plan.realtime.scheduler,
        priority: plan.realtime.priority,
        cpu: plan.realtime.cpu,
        wait: plan.realtime.wait,
        load: options.load.clone(),
        against: options.against,
        cpu_latency_held: latency.is_ok(),
        stolen_ms: stolen().saturating_sub(stolen_before),
        ended_early: over.load(Ordering::Relaxed),
        denied: denied.iter().map(ToString::to_string).collect(),
    };
    let ended_early = setting.ended_early;
    let said = setting.to_string();
    let report = JitterReport::of(
        setting,
        match &cell {
            None => Side::of(&ledger.total, Some(ours.missed), Some(waiter.report())),
            Some(cell) => Side::of(&ledger.total, Some(cell.missed), Some(cell.wait)),
        },
        options.against.map(|against| match against {
            Peer::Cyclictest => Side::of(&peers.total, None, None),
            Peer::Plain => Side::of(&peers.total, Some(peer.missed), None),
        }),
        cell.as_ref().map_or(&ours.causes, |cell| &cell.late),
        cell.as_ref().map(MeasuredCell::report),
    );
    let beside = options.against.map(|against| (against.name(), &peers));
    let chart = files.as_ref().map(|_| chart::chart(&said, ("mrroc", &ledger), beside));
    let (ours_total, peers_total) = (ledger.total.clone(), peers.total.clone());
    let (thread, late) = match cell {
        None => ("jitter", ours.spikes.finish()),
        Some(cell) => ("servo", cell.spikes),
    };
    let nothing = failure.is_some() && ours_total.is_empty();
    let write = move || {
        let written = match (files.zip(chart), failed) {
            (_, Some(error)) => Err(error).context("ours.hlog cannot be written"),
            (None, None) => Ok(()),
            (Some(_), None) if nothing => Ok(()),
            (Some((files, chart)), None) => {
                let chart = chart.context("jitter.svg cannot be drawn");
                chart.and_then(|chart| files.write(&ours_total, &peers_total, &chart))
            }
        };
        let spikes = spikes.map_or(Ok(()), |file| spikes::write(file, thread, late));
        written.and(spikes.context("the spikes cannot be written"))
    };
    let report = Some(report).filter(|_| !nothing);
    Ok(Measured { report, complete: !ended_early, failure, write: Box::new(write) })
}

/// Time that a hypervisor took from all processors since the boot, ms.
fn stolen() -> u64 {
    10 * stolen_ticks(&std::fs::read_to_string("/proc/stat").unwrap_or_default())
}
