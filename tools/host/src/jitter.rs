//! `mrroc jitter`: how punctual a thread is on this host that waits for deadlines as the servo's does.
//!
//! The measured time is the error of the wake-up: from a deadline to the time at which the thread runs, with the
//! servo's own wait and without a servo. With a cell, the time runs from a deadline to its SYNC. The peer, cyclictest
//! or a probe with its algorithm, takes turns within the run, so that both sides see the same host.
//!
//! **Both sides alike**: what keeps CPUs from deep idle states is held for both, or for neither where it is denied, and
//! cyclictest is told to leave it alone; the same priority under SCHED_FIFO (but for cyclictest, which knows no other,
//! where ours is under SCHED_DEADLINE) and the same CPU, or none; all memory locked; a timer slack of 1 ns; a first turn that counts for nothing. No two turns overlap. Ours is counted in ns and
//! cyclictest's own histogram in µs, so a ratio is no finer than that.
//!
//! **Files** of `--out` are in [`files`], what the verdict is made of is in [`verdict`].

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

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, bail};
use can::clock;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};
use hdrhistogram::serialization::V2DeflateSerializer;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde::de::value::{self, StringDeserializer};
use servo::thread::{CpuLatency, Denial, Scheduler, Wait, Waiter};

use bench::CellBench;
use cell::MeasuredCell;
use chart::Curve;
use files::{Files, IntervalLog};
use interval::{Ledger, recording};
use load::Load;
use plan::Plan;
use probe::{Turn, Wakeups};
use report::{Report, Setting, Side};

use crate::doctor::stolen_ticks;
use mrroc::cell_file::CellFile;
use mrroc::outputs::{Outputs, Replacement};
use mrroc::signals;
use mrroc::spikes::SpikeFile;

/// Options of `mrroc jitter`.
#[derive(Args)]
pub struct Options {
    /// Measure the whole cycle of this cell, its drives on and holding their position: from the deadline to SYNC.
    #[arg(long, value_name = "FILE")]
    cell: Option<PathBuf>,
    /// What to measure the cell on: emulated, unless given.
    #[arg(long, value_enum)]
    bench: Option<CellBench>,
    /// The virtual interface of a bus, IFACE or BUS=IFACE, with --bench vcan: never the cell's own.
    #[arg(long, value_name = "IFACE")]
    can: Vec<String>,
    /// Time from one deadline to the next, with its unit: 1ms, 250us; the cell's or 1ms, unless given.
    #[arg(long)]
    period: Option<String>,
    /// How long to measure, with its unit: 60s, 10m, 1h; the peer is measured as long.
    #[arg(long, default_value = "60s")]
    duration: String,
    /// What schedules the thread; the cell's or fifo, unless given.
    #[arg(long, value_parser = words::<Scheduler>(SCHEDULERS))]
    scheduler: Option<Scheduler>,
    /// Priority under SCHED_FIFO, 1 to 99; the cell's or 80, unless given.
    #[arg(long)]
    priority: Option<u32>,
    /// The CPU to stay on; the cell's, unless given.
    #[arg(long)]
    cpu: Option<usize>,
    /// How to wait; the cell's or hybrid, unless given.
    #[arg(long, value_parser = words::<Wait>(WAITS))]
    wait: Option<Wait>,
    /// How long before a deadline a hybrid wait asks to be woken, with its unit: 100us; the cell's or learnt, unless
    /// given.
    #[arg(long)]
    margin: Option<String>,
    /// Largest share of a core that a hybrid wait spins in, 0 to 0.5; the cell's or 0.2, unless given.
    #[arg(long)]
    spin_share: Option<f64>,
    /// What loads all CPUs meanwhile; several are separated by commas.
    #[arg(long, value_enum, value_delimiter = ',')]
    load: Vec<load::Kind>,
    /// Who is measured beside it, in turns.
    #[arg(long, value_enum)]
    against: Option<Peer>,
    /// Write ours.hgrm, peer.hgrm and ours.hlog, as the HdrHistogram tools read them, and jitter.svg into this
    /// directory.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Write the cycles of ours around the latest ones to this file, phase by phase, for ui.perfetto.dev.
    #[arg(long, value_name = "FILE")]
    spikes: Option<PathBuf>,
    #[command(flatten)]
    replacement: Replacement,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// The values of `--scheduler`.
const SCHEDULERS: [(&str, &str); 2] = [
    ("fifo", "SCHED_FIFO"),
    (
        "deadline",
        "SCHED_DEADLINE, with nine tenths of each period",
    ),
];

/// The values of `--wait`.
const WAITS: [(&str, &str); 2] = [
    ("plain", "Sleep until the deadline"),
    (
        "hybrid",
        "Sleep to a learnt margin before the deadline, then spin",
    ),
];

/// A parser of words that cell files have, each with its help.
fn words<T: DeserializeOwned + Clone + Send + Sync + 'static>(
    words: [(&'static str, &'static str); 2],
) -> impl TypedValueParser<Value = T> {
    let words = words.map(|(word, help)| PossibleValue::new(word).help(help));
    PossibleValuesParser::new(words)
        .try_map(|word| T::deserialize(StringDeserializer::<value::Error>::new(word)))
}

/// Whom to measure beside it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
enum Peer {
    /// The one of Debian's package rt-tests.
    Cyclictest,
    /// A thread with its algorithm: an absolute sleep, and one read of the clock.
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

/// What takes part in a measurement beside the sides.
struct Course<'a> {
    plan: &'a Plan,
    over: &'a Arc<AtomicBool>,
    progress: ProgressBar,
    /// The first failure to write the interval log; it ends the measurement.
    failed: Option<std::io::Error>,
}

impl Course<'_> {
    fn turn(&self, warm_up: bool) -> Turn<'_> {
        Turn {
            period: self.plan.period,
            time: if warm_up {
                self.plan.warm_up
            } else {
                self.plan.turn
            },
            over: self.over,
        }
    }

    /// Takes into `ledger` what there is, and shows it.
    fn look(&mut self, ledger: &mut Ledger, who: &str) {
        if let Err(error) = ledger.drain() {
            self.over.store(true, Ordering::Relaxed);
            self.failed.get_or_insert(error);
        }
        let late = report::percentiles(&ledger.total);
        self.progress.set_message(format!(
            "{who}: {} cycles, late by p50 {:.3} p99 {:.3} p99.9 {:.3} max {:.1} µs",
            ledger.total.len(),
            late.p50,
            late.p99,
            late.p999,
            late.max
        ));
    }

    /// One turn of a thread of ours, whose wake-ups come into `ledger`.
    fn thread(
        &mut self,
        wakeups: &mut Wakeups,
        ledger: &mut Ledger,
        who: &str,
        mut body: impl FnMut(&mut Wakeups) + Send,
    ) -> anyhow::Result<Vec<Denial>> {
        let Plan {
            realtime, period, ..
        } = *self.plan;
        let look = || self.look(ledger, who);
        let ((), denied) = probe::on_thread(&realtime, period, || body(wakeups), look)?;
        // The last interval of a turn; all others are free by now.
        self.look(ledger, who);
        wakeups.late.hand_over();
        self.look(ledger, who);
        Ok(denied)
    }
}

/// Measures and reports.
pub fn jitter(options: &Options) -> anyhow::Result<ExitCode> {
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
        bail!(
            "--load bus needs the virtual CAN bus of --cell with --bench emulated; `cangen` loads an interface"
        );
    }
    let mut cell = file
        .as_ref()
        .map(|file| MeasuredCell::new(file, bench, &options.can, traffic));
    if options.against == Some(Peer::Cyclictest) {
        cyclictest::find()?;
    }
    Load::find(&options.load)?;
    let ((), mut denied) = probe::on_thread(&plan.realtime, plan.period, || (), || ())?;
    if let Some(cpu) = denied.iter().find(|one| matches!(one, Denial::Cpu { .. })) {
        bail!("{cpu}");
    }
    let mut outputs = Outputs::new(options.replacement);
    file.iter().for_each(|cell| outputs.reads(cell));
    let files = options.out.as_deref();
    let files =
        files.map(|directory| Files::open(&mut outputs, directory, options.against.is_some()));
    let (files, mut log) = files.transpose()?.unzip();
    let spikes = outputs.open_if("--spikes", options.spikes.as_deref())?;
    let spikes = spikes.map(SpikeFile::new);
    outputs.begin()?;
    let mut serializer = V2DeflateSerializer::new();
    let log = (log.as_mut()).map(|log| IntervalLog::begin(log, &mut serializer));
    let log = log
        .transpose()
        .context("--out: ours.hlog cannot be written")?;
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
    let style = ProgressStyle::with_template("turn {pos}/{len}, {msg}")?;
    let mut course = Course {
        plan: &plan,
        over: &over,
        progress: ProgressBar::new(plan.rounds.into()).with_style(style),
        failed: None,
    };
    for round in 0..=plan.rounds {
        // The first turn of each side is there for caches, clocks and the margin, and counts for neither.
        let (recorder, mut unheard) = recording(began, None);
        let mut warming = Wakeups::new(recorder);
        let warm_up = round == 0;
        let (wakeups, into) = match warm_up {
            true => (&mut warming, &mut unheard),
            false => (&mut ours, &mut ledger),
        };
        let turn = Turn {
            over: &over,
            ..course.turn(warm_up)
        };
        denied = match &mut cell {
            None => course.thread(wakeups, into, "ours", |to| {
                probe::wait(&mut waiter, to, turn);
            })?,
            Some(cell) => {
                if round == 1 {
                    cell.forget();
                }
                cell.turn(plan.realtime, turn, into, |ledger| {
                    course.look(ledger, "ours");
                })?
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
        course.progress.set_position(round.into());
    }
    course.progress.finish_and_clear();
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
    let report = Report::of(
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
    let answered = mrroc::streams::answer(&report, options.json);
    let written = match (files, failed) {
        (_, Some(error)) => Err(error).context("ours.hlog cannot be written"),
        (None, None) => Ok(()),
        (Some(files), None) => {
            let curve = |name, ledger| Curve::of(name, ledger);
            let beside = options.against.map(|against| curve(against.name(), &peers));
            let chart = chart::chart(&said, &curve("mrroc", &ledger), beside.as_ref());
            files.write(&ledger.total, &peers.total, &chart)
        }
    };
    let written = written.and(spikes.map_or(Ok(()), |file| match cell {
        None => file.write("jitter", ours.spikes.finish()),
        Some(cell) => file.write("servo", cell.spikes),
    }));
    let failures = [answered.map(|_| ()), written];
    for error in failures.iter().filter_map(|it| it.as_ref().err()) {
        // Too late to refuse: it has been measured.
        mrroc::streams::warn(format_args!("mrroc: {error:#}"));
    }
    let failed = failures.iter().any(Result::is_err);
    Ok(ExitCode::from(u8::from(ended_early || failed)))
}

/// What a hypervisor took from all processors since the boot, ms.
fn stolen() -> u64 {
    10 * stolen_ticks(&std::fs::read_to_string("/proc/stat").unwrap_or_default())
}
