//! `mrroc run`: brings a cell up, homes it, runs its programs, switches it off and reports.
//!
//! By the wall clock five threads take part: the servo's, the controller's below it, one that writes the
//! files, one that listens to the buses, and the main thread, which shows the progress. However a run ends,
//! the servo thread is waited for until it has braked the arms and switched them off: at the programs' end,
//! on a signal, when a file cannot be written, and by a panic of the main thread or the controller's. A file
//! that takes nothing is not waited for. Whatever may still have power afterwards is a fault of the run.

use std::cell::{Cell as Shared, RefCell};
use std::mem::take;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::Builder;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use can::{Instant, clock};
use clap::Args;
use servo::thread::{self, Finished, Running};
use servo::{NotUp, Servo, Timing, lockstep};
use signal_hook::consts::SIGUSR1;
use signal_hook::flag;

use crate::bench::{Bench, BenchKind, Places};
use crate::cell_file::CellFile;
use crate::emulation::Emulation;
use crate::outputs::{Outputs, Replacement};
use crate::programs::{Programs, Progress, servo_faults};
use crate::report::{FaultReport, Outcome, Ran, Report};
use crate::signals::Motion;
use crate::spikes::SpikeFile;
use crate::trace::{AxisLog, FrameLog};
use crate::wire::Wire;
use crate::{clockwork, rehearsal, setup, signals, streams};

/// Records that an axis log may lag behind the servo, per effector: some seconds.
const RECORDS: usize = 1 << 13;

/// How often the controller looks at its effectors: this is a tenth of the usual macrostep, and a tenth of a longer one is.
const POLL: Duration = Duration::from_millis(2);

/// How far the controller's priority is below the servo's.
const BELOW_SERVO: u8 = 10;

/// News of the controller that the progress bar may lag behind; what does not fit is not shown.
const SEEN: usize = 64;

/// Longest time in the cell for the drives to report that they have no power, once they are told.
const POWER_OFF_WAIT: Duration = Duration::from_millis(500);

/// Longest wait for the files of a run once it has ended.
const FILES_WAIT: Duration = Duration::from_secs(2);

/// Bytes of the stack of a thread that reads queues and writes files; once memory is locked, all of it is.
pub(crate) const SMALL_STACK: usize = 128 * 1024;

/// How often the files of a run are written, at the least.
const DRAIN: Duration = Duration::from_millis(20);

/// Options of `mrroc run`.
#[derive(Args)]
pub(crate) struct Options {
    /// The cell file.
    cell: PathBuf,
    /// What to run it on.
    #[arg(long, value_enum, default_value = "emulated")]
    bench: BenchKind,
    #[command(flatten)]
    places: Places,
    /// Print one JSON object at the end.
    #[arg(long)]
    json: bool,
    /// Write every frame to this file, as candump does.
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Write every axis in every cycle to this file, as CSV.
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Write the servo cycles around the latest ones to this file, phase by phase, for ui.perfetto.dev; SIGUSR1 adds
    /// those around a moment of yours.
    #[arg(long, value_name = "FILE")]
    spikes: Option<PathBuf>,
    #[command(flatten)]
    replacement: Replacement,
}

/// Runs a cell.
pub(crate) fn run(options: &Options) -> anyhow::Result<ExitCode> {
    if options.spikes.is_some() && options.bench == BenchKind::Lockstep {
        bail!("--spikes needs cycles by the clock, which --bench lockstep has none of");
    }
    signals::block_suspension()?;
    let asked = Asked::default();
    flag::register(SIGUSR1, asked.trace.clone()).context("SIGUSR1 cannot be caught")?;
    let file = CellFile::read(&options.cell)?;
    rehearsal::rehearse(&file)?;
    if options.trace.is_some() && file.cell.bus.is_empty() {
        streams::warn("--trace stays empty: it has the frames of CAN buses, and the cell has none");
    }
    let budget = crate::budget::check(&file)?;
    let mut outputs = Outputs::new(options.replacement);
    outputs.reads(&file);
    let trace = outputs.open_if("--trace", options.trace.as_deref())?;
    let record = outputs.open_if("--record", options.record.as_deref())?;
    let spikes = outputs.open_if("--spikes", options.spikes.as_deref())?;
    let Bench {
        ports,
        lines,
        interfaces,
        traces,
        wire,
        emulation,
    } = Bench::open(
        &file,
        options.bench,
        &options.places,
        options.trace.is_some(),
    )?;
    let (mut servo, links) = Servo::new(
        &setup::servo_config(&file),
        setup::drive_groups(&file, ports, lines, None)?,
    )?;
    outputs.begin()?;
    let mut axes = |sink| {
        let records = servo.record(RECORDS * file.cell.robot.len());
        AxisLog::new(sink, &file, records)
    };
    let logs = Logs {
        axes: record.map(&mut axes).transpose().context("--record")?,
        frames: trace
            .map(|sink| FrameLog::new(sink, &interfaces, traces))
            .transpose()?,
    };
    let spikes = spikes.map(SpikeFile::new);
    let programs = Programs::of(&file, links, &servo)?;
    let progress = Progress::new(&file, !options.json)?;
    let (stop, flag) = (servo.stop_request(), asked.stop.clone());
    let motion = Motion::on(options.bench);
    signals::on_ending_of_motion(motion.clone(), move |_| {
        flag.store(true, Ordering::Relaxed);
        stop.request();
    })?;

    let began = clock::now();
    let mut ran = match options.bench {
        BenchKind::Lockstep => in_lockstep(
            &file,
            servo,
            programs,
            logs,
            Buses { wire, emulation },
            &asked.stop,
            progress,
        )?,
        _ => by_the_clock(
            &file,
            servo,
            programs,
            logs,
            Buses { wire, emulation },
            &asked,
            progress,
        )?,
    };
    motion.is_over();
    let interrupted = asked.stop.load(Ordering::Relaxed);
    if interrupted {
        // What the programs say of it is that they were broken off; what the servo latched meanwhile is a fault.
        ran.faults.retain(|fault| fault.robot.is_none());
    }
    for fault in servo_faults(&file, &ran.servo) {
        if !ran.faults.contains(&fault) {
            ran.faults.push(fault);
        }
    }
    let written = spikes.map(|file| file.write("servo", take(&mut ran.spikes)));
    if let Some(Err(error)) = written {
        ran.faults.push(FaultReport::of_run(error));
    }
    let outcome = match (interrupted, ran.faults.is_empty()) {
        (_, false) => Outcome::Faulted,
        (true, true) => Outcome::Stopped,
        (false, true) => Outcome::Completed,
    };
    let report = Report::of(
        &file,
        options.bench.name(),
        ran,
        &budget,
        clock::now().since(began),
        outcome,
    );
    if let Err(error) = streams::answer(&report, options.json) {
        // Too late to refuse: everything has moved.
        streams::warn(format_args!(
            "mrroc: the report cannot be printed: {error:#}"
        ));
        return Ok(ExitCode::from(1));
    }
    Ok(ExitCode::from(if outcome == Outcome::Completed {
        0
    } else {
        1
    }))
}

/// What signals ask for.
#[derive(Default)]
struct Asked {
    /// The end of the run.
    stop: Arc<AtomicBool>,
    /// The cycles around this moment.
    trace: Arc<AtomicBool>,
}

/// What is beyond the ports of a run.
struct Buses {
    wire: Wire,
    emulation: Option<Emulation>,
}

/// The files of a run.
struct Logs {
    frames: Option<FrameLog>,
    axes: Option<AxisLog>,
}

impl Logs {
    fn drain(&mut self) -> anyhow::Result<()> {
        if let Some(frames) = &mut self.frames {
            frames.drain().context("the trace cannot be written")?;
        }
        if let Some(axes) = &mut self.axes {
            axes.drain().context("the record cannot be written")?;
        }
        Ok(())
    }

    fn finish(mut self) -> anyhow::Result<()> {
        self.drain()?;
        match self
            .frames
            .map(FrameLog::finish)
            .transpose()
            .context("the trace cannot be written")?
        {
            Some(lost @ 1..) => Err(anyhow!(
                "the trace lacks {lost} frames: the file was too slow"
            )),
            _ => Ok(()),
        }
    }
}

/// The files of a run, written by a thread of its own: a file that takes nothing any more holds up nothing else.
struct Writing {
    what: &'static str,
    over: Arc<AtomicBool>,
    told: Receiver<anyhow::Result<()>>,
}

impl Writing {
    /// Begins. A file that cannot be written raises `failed`.
    fn start(mut logs: Logs, failed: Arc<AtomicBool>) -> anyhow::Result<Self> {
        let what = match (&logs.frames, &logs.axes) {
            (_, None) => "trace",
            (None, Some(_)) => "record",
            (Some(_), Some(_)) => "trace or the record",
        };
        let over = Arc::new(AtomicBool::new(false));
        let (tell, told) = sync_channel(1);
        let last = over.clone();
        let thread = Builder::new().name("files".into()).stack_size(SMALL_STACK);
        let body = move || {
            let mut written = Ok(());
            while written.is_ok() && !last.load(Ordering::Relaxed) {
                std::thread::park_timeout(DRAIN);
                written = logs.drain();
            }
            failed.fetch_or(written.is_err(), Ordering::Relaxed);
            // Nobody listens any more if it took too long.
            let _ = tell.send(written.and_then(|()| logs.finish()));
        };
        thread
            .spawn(body)
            .context("no thread to write the files can be made")?;
        Ok(Self { what, over, told })
    }

    /// Writes the rest, unless that takes too long.
    fn finish(self) -> anyhow::Result<()> {
        self.over.store(true, Ordering::Relaxed);
        self.told
            .recv_timeout(FILES_WAIT)
            .unwrap_or_else(|_| Err(anyhow!("the {} cannot be written in time", self.what)))
    }
}

/// A servo thread that is stopped in order and waited for when this is dropped, by a panic too.
pub(crate) struct Turning {
    running: Option<Running>,
    over: Over,
}

impl Turning {
    /// A servo thread that ends once `over` is set.
    pub(crate) fn of(running: Running, over: Arc<AtomicBool>) -> Self {
        Self {
            running: Some(running),
            over: Over(over),
        }
    }

    pub(crate) fn is_finished(&self) -> bool {
        self.running.as_ref().is_none_or(Running::is_finished)
    }

    pub(crate) fn end(mut self) -> Finished {
        self.over.raise();
        let running = self.running.take();
        running.expect("taken at its end alone").join()
    }
}

impl Drop for Turning {
    fn drop(&mut self) {
        self.over.raise();
        if let Some(running) = self.running.take() {
            let _ = running.join();
        }
    }
}

/// Ends the cycles when it is raised or dropped: the servo thread brakes the arms and switches them off.
struct Over(Arc<AtomicBool>);

impl Over {
    fn raise(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Drop for Over {
    fn drop(&mut self) {
        self.raise();
    }
}

/// What a run ends in whose drives did not come up: the refusal of a bus, in the words of the cell, or a stop on
/// request. The files keep what led to it.
fn not_up(
    file: &CellFile,
    servo: Servo,
    cell_time: Duration,
    written: anyhow::Result<()>,
    why: NotUp,
) -> anyhow::Result<Ran> {
    written?;
    if why == NotUp::Stopped {
        return Ok(Ran {
            servo,
            timing: Timing::default(),
            spikes: Vec::new(),
            denied: Vec::new(),
            faults: Vec::new(),
            wire: Vec::new(),
            cell_time,
        });
    }
    Err(why_not_up(file, why))
}

/// Why the drives of a cell did not come up, in the words of the cell.
pub(crate) fn why_not_up(file: &CellFile, why: NotUp) -> anyhow::Error {
    let NotUp::Group(bus, error) = why else {
        return anyhow!("stopped on request");
    };
    let axis = file
        .cell
        .axes_on(bus)
        .enumerate()
        .find(|&(index, (robot, axis))| match error.line() {
            Some(line) => index == line,
            None => error.node() == Some(file.cell.robot[robot].axis[axis].node),
        })
        .map(|(_, (robot, axis))| format!(", axis {}", file.axis_name(robot, axis)))
        .unwrap_or_default();
    let name = file
        .cell
        .groups()
        .nth(bus)
        .expect("the servo has the groups of the cell");
    anyhow!("bus {name}{axis}: {error}")
}

fn in_lockstep(
    file: &CellFile,
    mut servo: Servo,
    mut programs: Programs,
    logs: Logs,
    Buses { wire, emulation }: Buses,
    interrupted: &AtomicBool,
    mut progress: Progress,
) -> anyhow::Result<Ran> {
    let emulation = RefCell::new(emulation.expect("lockstep has emulated drives"));
    let wire = RefCell::new(wire);
    let between = |next| {
        emulation.borrow_mut().advance(next);
        wire.borrow_mut().look();
    };
    let mut reached = Instant::ZERO;
    let up = lockstep::bring_up(&mut servo, Instant::ZERO, |next| {
        reached = next;
        between(next);
    });
    let start = match up {
        Ok(start) => start,
        Err(error) => {
            let cell_time = reached.since(Instant::ZERO);
            return not_up(file, servo, cell_time, logs.finish(), error);
        }
    };
    let (done, failed) = (Shared::new(false), RefCell::new(None));
    let mut over = None;
    let logs = RefCell::new(logs);
    let mut timing = Timing::default();
    let end = lockstep::run(
        &mut servo,
        start,
        |now| {
            if failed.borrow().is_some() {
                return;
            }
            let busy = programs.poll(file, now, |seen| progress.show(seen));
            let drained = logs.borrow_mut().drain();
            done.set(!busy || interrupted.load(Ordering::Relaxed) || drained.is_err());
            failed.replace(drained.err());
        },
        between,
        |servo, now| {
            timing.record_bus(servo);
            if !done.get() {
                return false;
            }
            let over = *over.get_or_insert_with(|| {
                servo.stop_request().request();
                now + servo.longest_stop() + POWER_OFF_WAIT
            });
            servo.is_off() || now >= over
        },
    );
    progress.finish();
    let written = failed
        .take()
        .map_or_else(|| logs.into_inner().finish(), Err);
    let mut faults = programs.faults;
    faults.extend(written.err().map(FaultReport::of_run));
    Ok(Ran {
        servo,
        timing,
        spikes: Vec::new(),
        denied: Vec::new(),
        faults,
        wire: wire.into_inner().reports(),
        cell_time: end.since(Instant::ZERO),
    })
}

fn by_the_clock(
    file: &CellFile,
    mut servo: Servo,
    mut programs: Programs,
    logs: Logs,
    Buses {
        wire,
        mut emulation,
    }: Buses,
    asked: &Asked,
    mut progress: Progress,
) -> anyhow::Result<Ran> {
    let began = clock::now();
    let policy = |time| setup::realtime_policy(&file.cell, time);
    let done = Arc::new(AtomicBool::new(false));
    let writing = Writing::start(logs, done.clone())?;
    let listening = wire.listen()?;
    let finished = done.clone();
    let until = move |_: &Servo| finished.load(Ordering::Relaxed);
    let emulated_since = match clockwork::bring_up(&mut servo, &mut emulation) {
        Ok(first) => first,
        Err(error) => {
            let cell_time = clock::now().since(began);
            return not_up(file, servo, cell_time, writing.finish(), error);
        }
    };
    let trace = asked.trace.clone();
    let running = clockwork::start(servo, emulation, emulated_since, policy, trace, until)?;
    let turning = Turning::of(running, done.clone());
    let poll = POLL.max(file.cell.period() * u32::from(file.cell.macrostep) / 10);
    let (tell, told) = sync_channel(SEEN);
    std::thread::scope(|scope| {
        // The scope waits for the controller: a panic of this thread must end that too.
        let _over = Over(done.clone());
        scope.spawn(|| {
            // Below the servo and above everything else; a host that denies this was named by the servo thread.
            let _ = thread::set_fifo(
                file.cell
                    .realtime
                    .priority
                    .saturating_sub(BELOW_SERVO)
                    .max(1),
            );
            let show = |seen| _ = tell.try_send(seen);
            while !done.load(Ordering::Relaxed)
                && programs.poll(file, clock::now(), show)
                && !asked.stop.load(Ordering::Relaxed)
                && !turning.is_finished()
            {
                clock::sleep_until(clock::now() + poll);
            }
            drop(tell);
        });
        told.iter().for_each(|seen| progress.show(seen));
    });
    let ended = turning.end();
    // An emulated cell's time stands still while the host misses deadlines.
    let cycles =
        |first: Instant| first + ended.servo.period() * ended.servo.counters().cycles as u32;
    let cell_time = match emulated_since {
        Some(first) => cycles(first).since(Instant::ZERO),
        None => clock::now().since(began),
    };
    progress.finish();
    let mut faults = programs.faults;
    faults.extend(writing.finish().err().map(FaultReport::of_run));
    if let Some(panicked) = ended.panicked {
        let what = format!("the servo thread panicked: {panicked:?}");
        faults.push(FaultReport::of_run(what));
    }
    Ok(Ran {
        servo: ended.servo,
        timing: ended.timing,
        spikes: ended.spikes,
        denied: ended.denied.iter().map(ToString::to_string).collect(),
        faults,
        wire: listening.finish(),
        cell_time,
    })
}
