//! `mrroc identify`: excites one axis while it moves, and reports the frequency response of its loop.
//!
//! Only the robot of this axis is switched on, and only this axis moves. It moves in one direction at constant
//! velocity. The distance is printed before the motion. All safety checks of a run stay active.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

mod bode;
mod report;
mod session;

pub use report::{IdentifyReport, PointReport};

use std::cell::RefCell;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use can::{Instant, clock};
use clap::{Args, ValueEnum};
use servo::identify::{self as measure, Run};
use servo::{ExcitationError, MAX_AXES, NotUp, Output, PositionLoop, Servo, ServoAxisConfig, lockstep};

use mrroc::bench::clockwork;
use mrroc::bench::emulation::Emulation;
use mrroc::bench::{Bench, BenchKind, Places};
use mrroc::cell::CellFile;
use mrroc::guardian::{Guardian, Pulse};
use mrroc::outputs::{Measured, Outputs, Replacement};
use mrroc::run::{Turning, hang_limit};
use mrroc::signals::Motion;
use mrroc::{setup, signals};
use session::Session;

/// Capacity of the queue of records from the servo, per effector: some seconds.
const RECORDS: usize = 1 << 13;

/// Longest time between two updates of the session.
const POLL: Duration = Duration::from_millis(2);

/// Length of one period of the excitation, s. The spectral lines are therefore multiples of 1 Hz.
const PERIOD: f64 = 1.0;

/// Cycle time of the control loops of a drive, s: of the emulated drive, and of an EPOS4 (its hardware references).
const EMULATED_DRIVE: f64 = 1e-3;
const EPOS4: f64 = 400e-6;

/// Number of spectral lines.
const LINES: usize = 40;

/// Default velocity, rad/s.
const VELOCITY: f64 = 10.0;

/// Acceleration and deceleration, rad/s², limited by the axis.
const ACCELERATION: f64 = 100.0;

/// Distance kept from the end of the axis's range, rad of the motor.
const ROOM: f64 = 5.0;

/// Options of `mrroc identify`.
#[derive(Args)]
pub struct Options {
    /// The cell file.
    cell: PathBuf,
    /// The axis: ROBOT.AXIS, or the axis's name if no other has it.
    #[arg(long)]
    axis: String,
    /// Form of the excitation.
    #[arg(long, value_enum, default_value = "multisine")]
    excitation: Excitation,
    /// Point at which the excitation is added, if the drive closes the position loop.
    #[arg(long, value_enum, default_value = "torque")]
    at: At,
    /// Cycle time of the drive's control loops, µs, if the drive closes the position loop. The reported torque is half
    /// a cycle old. [default: that of an EPOS4, or of the emulated drive]
    #[arg(long, value_name = "US")]
    drive_period: Option<f64>,
    /// The bench to measure on.
    #[arg(long, value_enum, default_value = "lockstep")]
    bench: BenchKind,
    #[command(flatten)]
    places: Places,
    /// Allow motion on a bench that may be hardware. The axis has to be homed, clear of its surroundings, and watched.
    #[arg(long)]
    moves_hardware: bool,
    /// Amplitude of the excitation. The unit is that of the loop's output if the host closes the loop: rad/s, N·m or
    /// duty. If the drive closes the loop, the unit is N·m at its torque, or rad of the motor at its command. [default:
    /// a small amplitude]
    #[arg(long)]
    amplitude: Option<f64>,
    /// Motor velocity during the measurement, rad/s. At standstill, dry friction would hold the axis. For an excitation
    /// at the torque of a drive, the velocity is rounded to a whole number of counts per cycle. [default: 10 rad/s, or
    /// four counts per cycle at the torque of a drive, if that is faster]
    #[arg(long)]
    velocity: Option<f64>,
    /// Lowest frequency, Hz.
    #[arg(long, default_value_t = 2.0)]
    from: f64,
    /// Highest frequency, Hz, below half the servo's rate.
    #[arg(long, default_value_t = 120.0)]
    to: f64,
    /// Number of measured periods of the excitation, one second each.
    #[arg(long, default_value_t = 4)]
    periods: u8,
    /// Write bode.svg and bode.csv into this directory.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    replacement: Replacement,
    /// Print one JSON object.
    #[arg(long)]
    pub json: bool,
}

/// Form of the excitation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Excitation {
    /// A sine with rising frequency, from the lowest to the highest.
    Chirp,
    /// A sum of sines.
    Multisine,
}

/// Point of excitation for a drive that closes the position loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum At {
    /// At the torque that the drive's loops demand (object 0x60B2). Measures the open loop with its crossover and phase
    /// margin.
    Torque,
    /// At the commanded position. Measures the response of the sampled position. For drives without object 0x60B2.
    Command,
}

/// Measures one axis, and writes the files of the options.
pub fn identify(options: &Options) -> anyhow::Result<Measured<IdentifyReport>> {
    signals::block_signals_of_writes()?;
    let file = CellFile::read(&options.cell)?;
    let place = file.find_axis(&options.axis, false)?;
    let mut config = setup::servo_config(&file);
    let axis = &mut config.effectors[place.0].axes[place.1];
    let by_drive = axis.position_loop == PositionLoop::Drive;
    if !by_drive && options.at == At::Command {
        bail!("--at command: the host closes the position loop of {}, and is excited there", options.axis);
    }
    let with_torque = Some(place).filter(|_| by_drive && options.at == At::Torque);
    if with_torque.is_some() {
        let drive = file.cell.robot[place.0].axis[place.1].cia402();
        axis.torque_offset = Some(drive.rated_torque);
    }
    let axis = *axis;
    let lines = lines(options, &file)?;
    options.places.check(&file, options.bench)?;
    let hardware = options.bench == BenchKind::Card;
    let plan = plan(options, &file, place, &axis, &lines, hardware)?;
    if hardware && !options.moves_hardware {
        bail!(
            "the {} bench moves {} by up to {:.0} rad of its motor: --moves-hardware says that it may",
            options.bench.name(),
            options.axis,
            plan.travel().abs()
        );
    }
    let mut outputs = Outputs::new(options.replacement);
    outputs.reads(&file);
    let files = options.out.as_deref();
    let files = files.map(|directory| open(&mut outputs, directory));
    let files = files.transpose()?;
    let Bench { ports, lines: ttys, sensors, emulation, guardian, .. } =
        Bench::open(&file, options.bench, &options.places, false)?;
    let groups = setup::devices(&file, ports, ttys, sensors, with_torque)?.groups;
    let delay = groups[axis.group].delay();
    let (mut servo, mut links) = Servo::new(&config, groups)?;
    let plan = excite(&mut servo, place, plan, options.amplitude.is_some())?;
    let records = servo.record(RECORDS * file.cell.robot.len());
    let session = Session::new(place.0, plan, axis, links.swap_remove(place.0), records, !hardware);
    let motion = Motion::on(options.bench);
    let stop = servo.stop_request();
    signals::on_ending_of_motion(motion.clone(), move |_| stop.request())?;
    outputs.begin()?;
    let ended = match options.bench {
        BenchKind::Lockstep => in_lockstep(&file, servo, session, emulation),
        _ => by_the_clock(&file, servo, session, emulation, guardian),
    };
    motion.is_over();
    let robot = &file.cell.robot[place.0];
    let name = format!("{}.{}", robot.name, robot.axis[place.1].name);
    let report = ended.and_then(Session::finish).and_then(|(run, trace)| {
        let (kind, points) = trace
            .response(&run, &axis, delay, &lines)
            .ok_or_else(|| Unmeasured::Stopped("the measurement was broken off".into()))?;
        let bench = options.bench.name();
        Ok(IdentifyReport::of(name.clone(), bench, &axis, &run, kind, &points))
    });
    let (report, failure) = match report {
        Err(Unmeasured::Refused(why)) => return Err(why.context(name)),
        Err(Unmeasured::Stopped(why)) => (None, Some(anyhow!("{name}: {why}"))),
        Ok(report) => (Some(report), None),
    };
    let texts = report.as_ref().map(|report| (bode::chart(report), report.csv()));
    let write = move || match files.zip(texts) {
        None => Ok(()),
        Some((files, (chart, table))) => write(files, &chart.context("bode.svg")?, &table),
    };
    Ok(Measured { complete: report.is_some(), report, failure, write: Box::new(write) })
}

/// Reason why there is no measurement.
enum Unmeasured {
    /// Nothing has moved.
    Refused(anyhow::Error),
    /// An axis may have moved.
    Stopped(String),
}

/// Opens the files of `--out`, before any motion: the chart and the table.
fn open(outputs: &mut Outputs, directory: &Path) -> anyhow::Result<[File; 2]> {
    let mut open = |name| outputs.open_in("--out", directory, name);
    Ok([open("bode.svg")?, open("bode.csv")?])
}

fn write([mut bode, mut csv]: [File; 2], chart: &str, table: &str) -> anyhow::Result<()> {
    bode.write_all(chart.as_bytes()).context("bode.svg cannot be written")?;
    csv.write_all(table.as_bytes()).context("bode.csv cannot be written")
}

/// Number of cycles in one period of the excitation, in whole macrosteps.
fn length(file: &CellFile) -> usize {
    let steps = usize::from(file.cell.macrostep);
    let cycles = PERIOD / file.cell.period().as_secs_f64();
    (cycles / steps as f64).round().max(1.0) as usize * steps
}

fn lines(options: &Options, file: &CellFile) -> anyhow::Result<Vec<usize>> {
    let dt = file.cell.period().as_secs_f64();
    let (from, to) = (options.from, options.to);
    if !(from >= 2.0 / PERIOD && to > 2.0 * from && to < 0.5 / dt) {
        bail!(
            "from {from} to {to} Hz: the lowest frequency is 2 Hz, the highest below {} Hz, half the servo's rate, and \
             more than an octave apart",
            0.5 / dt
        );
    }
    Ok(measure::lines(length(file), dt, [from, to], LINES))
}

/// Plans motion and excitation, or refuses.
fn plan(
    options: &Options,
    file: &CellFile,
    (robot, number): (usize, usize),
    axis: &ServoAxisConfig,
    lines: &[usize],
    hardware: bool,
) -> anyhow::Result<Run> {
    let dt = file.cell.period().as_secs_f64();
    let known = if hardware { EPOS4 } else { EMULATED_DRIVE };
    let drive_period = options.drive_period.map_or(known.min(dt), |it| 1e-6 * it);
    if !(drive_period > 0.0 && drive_period <= dt) {
        let given = options.drive_period.unwrap_or(1e6 * drive_period);
        bail!("--drive-period {given}: it is above 0 and at most the {:.0} µs of the servo", 1e6 * dt);
    }
    let count = 1.0 / (axis.increments_per_radian.abs() * dt);
    let usual = match axis.torque_offset {
        Some(_) => VELOCITY.max(4.0 * count).min(axis.max_velocity),
        None => VELOCITY,
    };
    let velocity = in_counts(options.velocity.unwrap_or(usual), count, axis);
    if !(velocity > 0.0 && velocity <= axis.max_velocity) {
        bail!("--velocity {velocity}: it is above 0 and at most the {} rad/s of the axis", axis.max_velocity);
    }
    if options.periods < 2 {
        bail!("--periods {}: two at least are measured", options.periods);
    }
    let most = servo::greatest_excitation(axis);
    let amplitude = options.amplitude.unwrap_or(match axis.position_loop {
        PositionLoop::Host(host) if host.output == Output::Velocity => most.min(0.2 * velocity),
        PositionLoop::Drive if axis.torque_offset.is_some() => most,
        _ => 0.5 * most,
    });
    if !(amplitude > 0.0 && amplitude <= most) {
        bail!("--amplitude {amplitude}: it is above 0 and at most {most:.4} at this axis");
    }
    let excite = match options.excitation {
        Excitation::Chirp => measure::chirp,
        Excitation::Multisine => measure::multisine,
    };
    let mut run = Run {
        axis: number,
        start: [0.0; MAX_AXES],
        velocity,
        acceleration: ACCELERATION.min(axis.max_acceleration),
        excitation: excite(length(file), lines, amplitude),
        periods: usize::from(options.periods),
        steps: file.cell.macrostep,
        dt,
        drive_period,
    };
    // Homing ends at this position. On the card bench, the session reads the position again.
    let home = file.arms[robot].robot().home()[number];
    run.velocity = direct(&run, axis, home).map_err(|why| anyhow!("{}: {why}", options.axis))?;
    Ok(run)
}

/// Velocity near `velocity` at which a drive that closes the position loop advances by a whole number of counts per
/// cycle. `count` is the velocity of one count per cycle, rad/s. At any other velocity, the rounding of positions would
/// add noise of up to this size. An excitation of the position needs that noise: an amplitude below one count would
/// otherwise be rounded away.
fn in_counts(velocity: f64, count: f64, axis: &ServoAxisConfig) -> f64 {
    let whole = (velocity / count).round().max(1.0) * count;
    if axis.torque_offset.is_some() && velocity > 0.0 && whole <= axis.max_velocity { whole } else { velocity }
}

/// Velocity of a run from `position` towards the farther end of the range; an error if the distance is too short.
fn direct(run: &Run, axis: &ServoAxisConfig, position: f64) -> Result<f64, String> {
    let (below, above) = (position - axis.min_position, axis.max_position - position);
    let sense = if above >= below { 1.0 } else { -1.0 };
    let (room, travel) = (above.max(below) - ROOM, run.travel().abs());
    if travel > room {
        return Err(format!(
            "a run of {travel:.0} rad of the motor, and the axis has room for {room:.0}: lower --velocity or --periods"
        ));
    }
    Ok(sense * run.velocity.abs())
}

/// Starts the excitation. A default amplitude is reduced if it exceeds the acceleration limit of the axis.
fn excite(servo: &mut Servo, (robot, axis): (usize, usize), mut run: Run, given: bool) -> anyhow::Result<Run> {
    match servo.excite(robot, axis, run.excitation()) {
        Err(ExcitationError::Acceleration { acceleration, limit }) if !given => {
            let share = 0.5 * limit / acceleration;
            run.excitation.iter_mut().for_each(|it| *it *= share);
            servo.excite(robot, axis, run.excitation())?;
        }
        result => result?,
    }
    Ok(run)
}

fn not_up(file: &CellFile, servo: &Servo, error: NotUp) -> Unmeasured {
    match error {
        NotUp::Group(..) => Unmeasured::Refused(mrroc::run::diagnosed(file, servo, error)),
        NotUp::Stopped => Unmeasured::Stopped("stopped before the drives were up".into()),
    }
}

fn in_lockstep(
    file: &CellFile,
    mut servo: Servo,
    session: Session,
    emulation: Option<Emulation>,
) -> Result<Session, Unmeasured> {
    let emulation = RefCell::new(emulation.expect("lockstep has emulated drives"));
    let between = |next| emulation.borrow_mut().advance(next);
    let start = lockstep::bring_up(&mut servo, Instant::ZERO, between);
    let start = start.map_err(|error| not_up(file, &servo, error))?;
    let session = RefCell::new(session);
    lockstep::run(
        &mut servo,
        start,
        |_| session.borrow_mut().poll(),
        between,
        mrroc::run::stopped_once(|| session.borrow().is_over()),
    );
    Ok(session.into_inner())
}

fn by_the_clock(
    file: &CellFile,
    mut servo: Servo,
    mut session: Session,
    mut emulation: Option<Emulation>,
    mut guardian: Option<Guardian>,
) -> Result<Session, Unmeasured> {
    let done = Arc::new(AtomicBool::new(false));
    let finished = done.clone();
    let since = clockwork::bring_up(&mut servo, &mut emulation).map_err(|error| not_up(file, &servo, error))?;
    let realtime = file.cell.realtime;
    let until = move |_: &Servo| finished.load(Ordering::Relaxed);
    let stop = servo.stop_request();
    let mut pulse = guardian.as_ref().map(|guardian| guardian.pulse(stop.clone()));
    let sent = move || pulse.iter_mut().for_each(Pulse::beat);
    let running = clockwork::start(servo, emulation, since, realtime, Arc::default(), sent, until);
    let running = running.map_err(|error| Unmeasured::Refused(error.into()))?;
    let limit = hang_limit(&file.cell, since.is_some());
    let mut turning = Turning::of(running, done, stop.clone(), limit);
    let mut guarded = None;
    while !session.is_over() && !turning.is_over() && guarded.is_none() {
        session.poll();
        guarded = guardian.as_mut().and_then(|guardian| guardian.look(&stop));
        clock::sleep_until(clock::now() + POLL);
    }
    let ended = turning.end();
    if let (Some(guardian), Ok(ended)) = (&mut guardian, &ended)
        && ended.servo.is_off()
    {
        guardian.all_off();
    }
    let ended = ended.map_err(|hang| Unmeasured::Stopped(format!("{hang}: {}", hang.remedy())))?;
    if let Some(fault) = guardian.and_then(|guardian| guardian.fault()) {
        return Err(Unmeasured::Stopped(fault.to_string()));
    }
    match ended.panicked {
        Some(panicked) => Err(Unmeasured::Stopped(format!("the servo thread panicked: {panicked:?}"))),
        None => Ok(session),
    }
}
