//! A run: brings a cell up, executes a task on its robots, switches it off and reports.
//!
//! Threads of a run by the wall clock:
//!
//! - the servo;
//! - the controller, below the servo: executes the task;
//! - planning, one per robot: computes first steps of generators;
//! - rehearsal: rehearses the task from new positions of the robots;
//! - files: reads the records of the servo and writes the files;
//! - wire: listens to the buses;
//! - camera, one per camera: receives pictures;
//! - the caller: receives the progress and watches the task.
//!
//! A cell with axis controllers on ttys, a guarded bus or a hardware watchdog has a second process, the
//! [guardian](crate::guardian).
//!
//! A run in lockstep has the caller and one thread for everything else. With `--threads`, helpers of this second thread
//! also advance emulated robots. A run by the wall clock does not wait for planning and rehearsal. However a run ends,
//! the run waits until the servo has braked the arms and switched them off. A run ends with its task, on a signal, when
//! the task hangs, and by a panic of any of its threads. A file that cannot be written, for example on a full disk, ends
//! with a warning and does not end the run. The run waits only for a limited time for a file that accepts no data, and
//! for a servo thread that hangs. A drive that may still have power afterwards is a fault of the run.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

mod background;
pub(crate) mod crew;
mod descriptions;
mod ending;
#[cfg(test)]
mod fault_lines;
#[cfg(test)]
#[cfg(feature = "recording")]
mod file_tests;
mod files;
mod not_up;
mod options;
mod page_file;
#[cfg(test)]
#[cfg(feature = "command-line")]
mod panic_tests;
#[cfg(feature = "recording")]
mod recorded;
#[cfg(not(feature = "recording"))]
#[path = "unrecorded.rs"]
mod recorded;
mod running_task;
#[cfg(test)]
mod tests;
mod tick;
mod watch;
mod worker;

use std::cell::Cell as Shared;
use std::mem::take;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::{Builder, available_parallelism};
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use can::{Instant, clock};
use servo::thread::{self, Finished};
use servo::{NotUp, Servo, Timing, lockstep};

use crate::bench::camera_wire::Cameras;
use crate::bench::carving::{self, Carving};
use crate::bench::clockwork;
use crate::bench::emulation::Emulation;
use crate::bench::truth::TruthLog;
use crate::bench::{Bench, BenchKind};
use crate::cell::CellFile;
use crate::guardian::{Guardian, GuardianFault, Pulse};
use crate::outputs::Outputs;
use crate::rehearsal::Rehearsed;
use crate::report::{FaultReport, IncompleteFile, RunEnd, RunOutcome, RunReport, Tracks, counted_as};
use crate::scenario::{Scenario, ScenarioProbe};
use crate::tasks::Program;
use crate::trace::{AxisLog, FrameLog, StepFile, log_names};
use crate::wire::Wire;
use crate::{budget, rehearsal, setup, spikes, streams};
pub(crate) use background::Background;
use ending::Over;
use files::{Logs, Writing, Written, begun, named};

use descriptions::{of_guardian, of_power, of_servo_hang, of_servo_thread, servo_faults};
pub use ending::{Requests, Turning, stopped_once};
pub use not_up::{diagnosed, why_not_up};
pub use options::RunOptions;
use page_file::PageFile;
use recorded::Recording;
pub use running_task::Progress;
pub(crate) use running_task::RunningTask;
use running_task::{Rehearsals, TaskErrors};
use tick::tick;
pub use watch::{ServoHang, hang_limit};
use watch::{Watch, watched};
pub(crate) use watch::{returned, returned_after};
use worker::no_thread;

/// Least `--speed`, percent: at lower speeds, a program of minutes lasts for days.
const LEAST_SPEED: f64 = 0.1;
/// Records that the evaluation may lag behind the servo, per effector: some seconds.
const RECORDS: usize = 1 << 11;

/// Records of a run in lockstep, per effector. Each cycle takes the records of the cycle before, and a short ring stays in
/// the cache of the processor.
const LOCKSTEP_RECORDS: usize = 4;

/// Records that an axis log may lag behind the servo, per effector.
const LOGGED_RECORDS: usize = 1 << 13;

/// Events that a file of steps may lag behind the controller, per robot.
const STEPS: usize = 1 << 14;

/// How far the controller's priority is below the servo's.
const BELOW_SERVO: u8 = 10;

/// News of the controller that the progress may lag behind; what does not fit is not shown.
const NEWS: usize = 64;

/// Longest wait for the times on the wire at the end of a run.
const LAST_LOOK: Duration = Duration::from_secs(2);

/// Bytes of the stack of a thread that reads queues and writes files; once memory is locked, all of it is.
pub const SMALL_STACK: usize = 128 * 1024;

/// Rehearses a task, then runs it.
///
/// `program` begins anew for every rehearsal on ideal drives and for the run. `progress` receives news on the caller's
/// thread. An error means that nothing real has moved; a fault during the run is in the report. A task that hangs in
/// lockstep is an error, since the run cannot go on without the thread of the task.
pub fn run(
    file: &CellFile,
    options: &RunOptions,
    requests: &Requests,
    program: &Program,
    progress: &mut dyn FnMut(Progress),
) -> anyhow::Result<RunReport> {
    options.check()?;
    let file = &file.for_one_run();
    let scenario = options.scenario.as_deref().map(Scenario::read).transpose()?;
    if let Some(path) = &options.scenario {
        file.inputs().protect("the scenario", path);
    }
    if let Some(percent) = options.speed {
        let fraction = if percent >= LEAST_SPEED { percent / 100.0 } else { f64::NAN };
        let set = requests.speed.set(fraction);
        set.map_err(|_| anyhow!("--speed is a percentage, at least {LEAST_SPEED} and at most 100, not {percent}"))?;
    }
    let rehearsed = match options.rehearse_with_scene {
        true => rehearsal::rehearse_with_scene(file, program, &requests.stop)?,
        false => rehearsal::rehearse(file, program)?,
    };
    file.configuration_warnings().for_each(|warning| streams::warn(format_args!("mrroc: {warning}")));
    // Payloads and surroundings of the cell file are those of emulated robots.
    if matches!(options.bench, BenchKind::Lockstep | BenchKind::Emulated) {
        rehearsed.overloads(file)?.iter().for_each(|warning| streams::warn(format_args!("mrroc: {warning}")));
    }
    if options.trace.is_some() && file.cell.bus.is_empty() {
        bail!(
            "--trace writes the frames of CAN buses, and the cell has none: --record FILE.mcap keeps the telegrams of its \
             lines"
        );
    }
    run_rehearsed(file, options, requests, program, (&rehearsed, scenario.as_ref()), progress)
}

/// Runs a task that was rehearsed.
pub(crate) fn run_rehearsed(
    file: &CellFile,
    options: &RunOptions,
    requests: &Requests,
    program: &Program,
    (rehearsed, scenario): (&Rehearsed, Option<&Scenario>),
    progress: &mut dyn FnMut(Progress),
) -> anyhow::Result<RunReport> {
    let budget = budget::check(file)?;
    let mut outputs = Outputs::new(options.replacement);
    outputs.reads(file);
    let trace = outputs.open_if("--trace", options.trace.as_deref())?;
    let _member = requests.crew.join();
    let rows = options.record.as_deref().filter(|_| options.recording().is_none());
    let record = outputs.open_if("--record", rows)?;
    let mut recording = Recording::open(&mut outputs, options, file)?;
    let steps = outputs.open_if("--steps", options.steps.as_deref())?;
    let spikes = outputs.open_if("--spikes", options.spikes.as_deref())?;
    let truth = outputs.open_if("--truth", options.truth.as_deref())?;
    let carved = carving::open(&mut outputs, file, options.carved.as_deref())?;
    let page = PageFile::open(&mut outputs, options)?;
    recording.find_flights(file, options)?;
    let is_recorded = recording.is_wanted();
    let mut bench = Bench::open(file, options.bench, &options.places, options.trace.is_some() || is_recorded)?;
    let lines = if is_recorded { bench.trace_lines() } else { Vec::new() };
    let cameras = Cameras::open(file, options.bench, bench.emulation.as_mut())?;
    let played = match (scenario, &mut bench.emulation) {
        (Some(scenario), Some(emulation)) => emulation.play(scenario, file)?,
        _ => ScenarioProbe::default(),
    };
    let mut devices = setup::devices(file, bench.ports, bench.lines, bench.sensors, None)?;
    let (mut servo, links) = Servo::new(&setup::servo_config(file), take(&mut devices.groups))?;
    let sensors = setup::force_sensors(file, &devices.sensors, &links);
    setup::install_laws(file, &mut servo, &sensors)?;
    servo.follow_override(requests.speed.clone());
    outputs.begin()?;
    let lag = match options.bench {
        BenchKind::Lockstep => LOCKSTEP_RECORDS,
        _ if record.is_some() || recording.is_streamed() => LOGGED_RECORDS,
        _ => RECORDS,
    };
    let axes = record.map(|sink| AxisLog::new(named("--record", &options.record, "rows"), sink, file)).transpose();
    let names = log_names(&bench.interfaces)?;
    let cell = Arc::new(file.clone());
    let zero = match options.bench {
        BenchKind::Lockstep => None,
        BenchKind::Emulated => Some(clock::now()),
        BenchKind::Vcan | BenchKind::Card => Some(Instant::ZERO),
    };
    let recorder =
        recording.begin(&cell, (options, requests, zero.map(clock::utc_of)), &mut servo, (&devices, &sensors), &names);
    let recorder = recorder.context("--record")?;
    let frames = trace.map(|sink| FrameLog::new(named("--trace", &options.trace, "frames"), sink, names)).transpose();
    let mut task = RunningTask::new(
        &cell,
        program,
        links,
        (devices.io, sensors, devices.matrices, devices.own, cameras.links()),
        &servo,
        rehearsed,
    );
    let step_file = named("--steps", &options.steps, "events");
    let steps = steps.map(|sink| StepFile::new(step_file, sink, file, task.keep_steps(STEPS))).transpose();
    let logs = Logs {
        records: servo.record(lag * file.cell.robot.len()),
        buses: bench.traces,
        lines,
        samples: devices.samples,
        recorder,
        faulted: Arc::default(),
        tracks: Tracks::new(file, page.is_wanted()),
        axes: axes.with_context(|| begun("--record", &options.record))?,
        steps: steps.with_context(|| begun("--steps", &options.steps))?,
        frames: frames.with_context(|| begun("--trace", &options.trace))?,
    };
    let mut truth_written = None;
    if let (Some(sink), Some(emulation)) = (truth, &mut bench.emulation) {
        let log = TruthLog::new(named("--truth", &options.truth, "rows"), sink, file);
        let (log, written) = log.with_context(|| begun("--truth", &options.truth))?;
        emulation.log_truth(log);
        truth_written = Some(written);
    }
    let carving = bench.emulation.as_ref().map(|emulation| Carving::new(emulation.workpieces(), carved));
    let figures = task.figures();
    requests.stop_through(servo.stop_request());
    requests.crew.stop_through(servo.stop_request());

    let began = clock::now();
    let unsolved = bench.emulation.as_ref().and_then(Emulation::unsolved);
    let mut buses = Buses { wire: bench.wire, emulation: bench.emulation };
    let mut end = match options.bench {
        BenchKind::Lockstep => {
            let (turns, stop) = (task.turns.clone(), requests.stop.clone());
            let processors = available_parallelism().map_or(1, usize::from);
            let threads = options.threads.map_or(1, usize::from).min(processors).min(file.cell.robot.len());
            let work = move |tell: &mut dyn FnMut(Progress)| {
                if let Some(emulation) = buses.emulation.as_mut().filter(|_| threads > 1) {
                    emulation.add_helpers(threads - 1).context("--threads")?;
                }
                in_lockstep(servo, task, logs, buses, &stop, tell)
            };
            watched("lockstep", &turns, progress, work)?.0?
        }
        _ => by_the_clock(file, servo, task, logs, (buses, bench.guardian), requests, progress)?,
    };
    let interrupted = requests.is_stopped();
    let unwound = requests.crew.faults(file, end.faults.iter_mut().chain(&mut end.recovered));
    end.faults.splice(..0, unwound);
    let of_servo = match &end.servo {
        Ok(servo) => servo_faults(file, servo, &end.received),
        Err(_) => vec![of_power(file)],
    };
    for fault in of_servo {
        if !end.faults.iter().any(|known| known.is_same(&fault)) {
            end.faults.push(fault);
        }
    }
    end.faults.extend(unsolved.and_then(|unsolved| of_contacts(unsolved.count())));
    for fault in end.faults.iter_mut().chain(&mut end.recovered) {
        fault.add_cycles(&end.tracks);
    }
    // Every instruction that a fault refuses names the fault again.
    end.recovered.dedup_by(|next, first| first.number.is_some() && first.number == next.number && first.is_same(next));
    if let Some(Err(error)) = spikes.map(|file| spikes::write(file, "servo", take(&mut end.spikes))) {
        let name = named("--spikes", &options.spikes, "trace");
        end.incomplete.push(IncompleteFile { lost: 1, ..name.fails(&error) });
    }
    end.incomplete.extend(truth_written.and_then(|written| written.try_recv().ok().flatten()));
    // A servo thread that hangs in the emulation may hold the workpieces.
    end.incomplete.extend(carving.filter(|_| end.servo.is_ok()).map(Carving::write).unwrap_or_default());
    let outcome = match (interrupted, end.faults.is_empty()) {
        (_, false) => RunOutcome::Faulted,
        (true, true) => RunOutcome::Stopped,
        (false, true) => RunOutcome::Completed,
    };
    let (bench, wall) = (options.bench.name(), clock::now().since(began));
    let mut report = RunReport::of(file, bench, &mut end, &budget, wall, outcome);
    report.figures = figures.all();
    report.idle_faults = played.idle();
    page.write(&mut report, &end.tracks, &end.timing);
    Ok(report)
}

/// The fault of a run in which the equations of `unsolved` parts of steps of the emulated contacts were not solved.
fn of_contacts(unsolved: u64) -> Option<FaultReport> {
    (unsolved > 0).then(|| {
        FaultReport::of_run(format_args!(
            "emulated contacts are wrong in {}: reduce stiffness and damping of surfaces and grips, or use heavier bodies",
            counted_as(unsolved, "part of a step", "parts of steps")
        ))
    })
}

/// What is beyond the ports of a run.
struct Buses {
    wire: Wire,
    emulation: Option<Emulation>,
}

/// What a run ends in whose drives did not come up: the refusal of a bus, in the words of the cell, or a stop on
/// request. The files keep what led to it.
fn not_up(
    file: &CellFile,
    servo: Servo,
    cell_time: Duration,
    Written { incomplete, late, tracks }: Written,
    why: NotUp,
) -> anyhow::Result<RunEnd> {
    late.map_or(Ok(()), Err)?;
    if why == NotUp::Stopped {
        return Ok(RunEnd {
            servo: Ok(servo),
            tracks,
            incomplete,
            timing: Timing::default(),
            spikes: Vec::new(),
            denied: Vec::new(),
            faults: Vec::new(),
            recovered: Vec::new(),
            slowed: Default::default(),
            received: Vec::new(),
            wire: Vec::new(),
            cell_time,
        });
    }
    Err(diagnosed(file, &servo, why))
}

fn in_lockstep(
    mut servo: Servo,
    task: RunningTask,
    mut logs: Logs,
    Buses { mut wire, emulation }: Buses,
    interrupted: &AtomicBool,
    progress: &mut dyn FnMut(Progress),
) -> anyhow::Result<RunEnd> {
    let (file, _) = task.rehearsed();
    let mut emulation = emulation.expect("lockstep has emulated drives");
    let mut reached = Instant::ZERO;
    let up = lockstep::bring_up(&mut servo, Instant::ZERO, |next| {
        reached = next;
        emulation.advance(next);
        wire.look();
    });
    let start = match up {
        Ok(start) => start,
        Err(error) => {
            return not_up(&file, servo, reached.since(Instant::ZERO), logs.finish(), error);
        }
    };
    let done = Shared::new(false);
    let mut is_over = stopped_once(|| done.get());
    let mut timing = Timing::default();
    let mut carrying = task.begin(Rehearsals::AtOnce);
    let period = servo.period();
    // The controller has no access to the wires, so it may work while helpers advance the emulated robots. The listeners
    // then have at least the frames of the cycle before.
    let mut control = |now| {
        wire.look();
        logs.drain();
        let going = carrying.poll(now, &mut *progress);
        done.set(!going || interrupted.load(Ordering::Relaxed));
    };
    let end = lockstep::run(
        &mut servo,
        start,
        |_| {},
        |next| emulation.advance_beside(next, || control(next - period)),
        |servo, now| {
            timing.record_bus(servo);
            is_over(servo, now)
        },
    );
    wire.look();
    let TaskErrors { mut faults, recovered, received, slowed } = carrying.finish();
    logs.faulted.store(!faults.is_empty(), Ordering::Relaxed);
    let Written { incomplete, tracks, .. } = logs.finish();
    if interrupted.load(Ordering::Relaxed) {
        // The request broke off the instructions of the task.
        faults.retain(|fault| fault.robot.is_none());
    }
    Ok(RunEnd {
        servo: Ok(servo),
        tracks,
        incomplete,
        timing,
        spikes: Vec::new(),
        denied: Vec::new(),
        faults,
        recovered,
        slowed,
        received,
        wire: wire.reports(),
        cell_time: end.since(Instant::ZERO),
    })
}

fn by_the_clock(
    file: &CellFile,
    mut servo: Servo,
    mut task: RunningTask,
    logs: Logs,
    (Buses { wire, mut emulation }, mut guardian): (Buses, Option<Guardian>),
    requests: &Requests,
    progress: &mut dyn FnMut(Progress),
) -> anyhow::Result<RunEnd> {
    let began = clock::now();
    let done = Arc::new(AtomicBool::new(false));
    let faulted = logs.faulted.clone();
    let writing = Writing::start(logs)?;
    let listening = wire.listen()?;
    let finished = done.clone();
    let crew = requests.crew.clone();
    let until = move |_: &Servo| finished.load(Ordering::Relaxed) || crew.has_unwound();
    let since = match clockwork::bring_up(&mut servo, &mut emulation) {
        Ok(first) => first,
        Err(error) => {
            return not_up(file, servo, clock::now().since(began), writing.finish(file), error);
        }
    };
    task.plan_aside().context("a thread for planning cannot be made")?;
    let trace = requests.spikes.clone();
    let realtime = file.cell.realtime;
    let (ticking, mut tick) = tick(file.cell.period());
    let stop_all = servo.stop_request();
    let mut pulse = guardian.as_ref().map(|guardian| guardian.pulse(servo.stop_request()));
    let (crew, mut member) = (requests.crew.clone(), None);
    let sent = move || {
        // The servo thread catches its panics.
        member.get_or_insert_with(|| crew::attach(&crew));
        crew.cycle();
        crew::point("servo");
        ticking.sent();
        pulse.iter_mut().for_each(Pulse::beat);
    };
    let running = clockwork::start(servo, emulation, since, realtime, trace, sent, until)?;
    let limit = hang_limit(&file.cell, since.is_some());
    let mut turning = Turning::of(running, done.clone(), stop_all.clone(), limit);
    let (tell, told) = sync_channel(NEWS);
    let (ask, asked) = sync_channel(file.cell.robot.len());
    let (answer, verdicts) = sync_channel(file.cell.robot.len());
    // A panic of this thread must end the other threads too.
    let _over = Over(done.clone());
    let (rehearsed, over) = (task.rehearsed(), done.clone());
    let crew = requests.crew.clone();
    let rehearse = move || {
        let _member = crew.join();
        crew::point("rehearsal");
        rehearse_aside(&rehearsed, asked, &answer, &over);
    };
    Builder::new()
        .name("rehearsal".into())
        .spawn(rehearse)
        .with_context(|| no_thread("rehearsals", realtime.lock_memory))?;
    let rounds = Arc::new(AtomicU64::new(0));
    let mut watch = Watch::of(&task.turns, true).of_rounds(rounds.clone());
    let crew = requests.crew.clone();
    let (over, stop) = (done.clone(), requests.stop.clone());
    let control = move || {
        let _member = crew.join();
        // Below the servo and above everything else; a host that denies this was named by the servo thread.
        let _ = thread::set_fifo(realtime.priority.saturating_sub(BELOW_SERVO).max(1));
        let show = |seen| _ = tell.try_send(seen);
        let mut carrying = task.begin(Rehearsals::Aside { ask, verdicts });
        while !over.load(Ordering::Relaxed) && carrying.poll(clock::now(), show) && !stop.load(Ordering::Relaxed) {
            tick.wait();
            rounds.fetch_add(1, Ordering::Relaxed);
            crew::point("controller");
        }
        carrying.finish()
    };
    let controller = Builder::new().name("controller".into()).spawn(control);
    let controller = controller.with_context(|| no_thread("the controller", realtime.lock_memory))?;
    // Number of cycles at which a fault of the guardian was noticed.
    let mut noticed = None;
    let hung = loop {
        if guardian.as_mut().is_some_and(|guardian| guardian.look(&stop_all).is_some()) {
            done.store(true, Ordering::Relaxed);
            noticed.get_or_insert(requests.crew.cycles());
        }
        done.fetch_or(turning.is_over(), Ordering::Relaxed);
        match told.recv_timeout(watch::LOOK) {
            Ok(seen) => progress(seen),
            Err(RecvTimeoutError::Disconnected) => break None,
            Err(RecvTimeoutError::Timeout) => {
                if let Err(hung) = watch.look() {
                    break Some(hung);
                }
            }
        }
    };
    let TaskErrors { mut faults, recovered, received, slowed } = match hung {
        // The crew has the message of a panic.
        None => controller.join().unwrap_or_default(),
        // The thread is left behind.
        Some(hung) => TaskErrors { faults: vec![FaultReport::of_run(hung)], ..TaskErrors::default() },
    };
    let ended = turning.end();
    let cycles = ended.as_ref().map_or_else(|hang| hang.cycles, |ended| ended.servo.counters().cycles);
    // An emulated cell's time stands still while the host misses deadlines.
    let cell_time = match since {
        Some(first) => (first + file.cell.period() * cycles as u32).since(Instant::ZERO),
        None => clock::now().since(began),
    };
    let hang = ended.as_ref().err().copied();
    let guarded = guardian.as_mut().and_then(|guardian| match hang {
        Some(_) => guardian.look(&stop_all),
        None => guardian.fault(),
    });
    if let (Some(guardian), Ok(ended)) = (&mut guardian, &ended)
        && ended.servo.is_off()
    {
        guardian.all_off();
    }
    drop(guardian);
    if requests.is_stopped() || guarded.is_some() || hang.is_some() {
        // The request, the guardian or the hang broke off the instructions of the task.
        faults.retain(|fault| fault.robot.is_none());
    }
    let panicked = ended.as_ref().ok().and_then(|ended| ended.panicked);
    let stopped = matches!(guarded, Some(GuardianFault::Stopped { .. }));
    let time = noticed.map(|cycles| crew::time_of(file, cycles));
    // The stop by the guardian is part of the fault of a hang.
    let guarded = guarded.filter(|_| hang.is_none() || !stopped).map(|fault| of_guardian(file, fault, time));
    let hang = hang.map(|hang| of_servo_hang(file, &hang, stopped));
    faults.splice(..0, guarded.into_iter().chain(hang));
    faulted.store(!faults.is_empty() || panicked.is_some() || requests.crew.has_unwound(), Ordering::Relaxed);
    let Written { incomplete, late, tracks } = writing.finish(file);
    faults.extend(late.map(FaultReport::of_run));
    faults.splice(..0, panicked.map(|panicked| of_servo_thread(file, panicked, requests.crew.cycles())));
    let (servo, timing, spikes, denied) = match ended {
        Ok(Finished { servo, timing, spikes, denied, .. }) => (Ok(servo), timing, spikes, denied),
        Err(hang) => (Err(hang), Timing::default(), Vec::new(), Vec::new()),
    };
    Ok(RunEnd {
        servo,
        tracks,
        incomplete,
        timing,
        spikes,
        denied: denied.iter().map(ToString::to_string).collect(),
        faults,
        recovered,
        slowed,
        received,
        wire: listening.finish(LAST_LOOK).unwrap_or_default(),
        cell_time,
    })
}

/// Rehearses a task with each set of courses that is asked for, until no more can be asked for. A rehearsal ends early
/// once the run is `over`.
fn rehearse_aside(
    (file, program): &(Arc<CellFile>, Program),
    asked: Receiver<running_task::Question>,
    answer: &SyncSender<running_task::Verdict>,
    over: &Arc<AtomicBool>,
) {
    for (robot, courses) in asked {
        let verdict = rehearsal::rehearse_again(file, program, courses, over);
        if answer.send((robot, verdict)).is_err() {
            return;
        }
    }
}
