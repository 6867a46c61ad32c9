//! Rehearsal of a task: the same task on the real servo and generators with ideal drives.
//!
//! In the rehearsal, servo and generators make the same refusals as on the robot, but in virtual time and before any
//! motion. Examples are a pose out of reach, a motion beyond a limit, and a line through a singularity.
//!
//! Ideal drives come up without a reference, at the home position of their robot, and attain the reference when they
//! are homed. The rehearsal before a run therefore covers all motions after homing, and ends at the first motion
//! without homing.
//!
//! Real drives may have kept their reference from an earlier run. Their robot may then stand anywhere. During a run, a
//! robot waits before its first motion if no rehearsal had it at its present position. The task is then rehearsed again
//! from there. The same holds after each switching-on at a new position, and after each fault.
//!
//! In a rehearsal, a force sensor carries the weight of its tool and has no contact. [`rehearse_with_scene`] rehearses
//! the task on the emulated cell, which has contact and sensors.
//!
//! An error that the task handles is no refusal. A task can leave out its side effects
//! ([`Cell::rehearsing`](crate::tasks::Cell::rehearsing)) or end the rehearsal
//! ([`Cell::end_rehearsal`](crate::tasks::Cell::end_rehearsal)).

mod scene;

use std::cell::Cell;
use std::fmt::Display;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::Poll;
use std::time::Duration;

use anyhow::anyhow;
use can::Instant;
use controller::ecp::EcpError;
use controller::executor::{Ended, InstructionError, News, SystemError, Turns};
use controller::generator::{Axes, GeneratorError, PlannedStart};
use drive::{AxisCommand, AxisState, BringUpError, DriveGroup, Fault, GroupCounters, Homing, Power, Setpoint};
use servo::{PositionLoop, Servo, lockstep};

use crate::cell::{CellFile, FileError, Path, instruction_path};
use crate::demand::{self, Demand, RobotDemand};
use crate::lag::{self, Lag};
use crate::run::{returned, returned_after};
use crate::tasks::{Equipment, Figures, Program, TaskError};
use crate::{setup, streams};
pub use scene::rehearse_with_scene;

/// Greatest duration of a task.
const LONGEST: Duration = Duration::from_secs(24 * 3600);

/// Greatest duration of a first motion in a rehearsal from beside the home position.
const BEGINNING: Duration = Duration::from_secs(600);

/// The fault of an ideal drive: a generic error (CiA 402-2 §7.1).
const FAULT: Fault = Fault::Drive { node: 0, code: 0x1000 };

/// Least duration of one turn of a task that counts as blocking. A busy host can interrupt a turn for shorter times.
const BLOCKED: Duration = Duration::from_millis(500);

/// Text for refusals: the rehearsal lacks contact and objects, and the task may depend on them. The scene of the cell
/// may provide some of these.
fn lacks(file: &CellFile, extent: Extent) -> &'static str {
    match extent {
        Extent::Task if file.cell.scene.is_some() => {
            "in the rehearsal, which has ideal drives, no contact, and no objects before the sensors; \
             --rehearse-with-scene has those of the emulated scene"
        }
        _ => "in the rehearsal, which has ideal drives, no contact, and no objects before the sensors",
    }
}

/// Number of rehearsed start positions beside the home position.
const STARTS: usize = 16;

/// A rehearsal from the home positions.
#[derive(Clone, Debug)]
pub struct Rehearsed {
    /// Duration without homing; `None` if only the rehearsal with the scene came to the end of the task.
    pub duration: Option<Duration>,
    /// Duration of the rehearsal with the scene, with homing.
    pub with_scene: Option<Duration>,
    /// Number of instructions of all robots.
    pub instructions: u64,
    /// Whether a generator commanded each robot.
    pub(crate) moved: Vec<bool>,
    /// A torque that cannot be had, by numbers that the user gave.
    pub(crate) refused: Option<Demand>,
    /// The greatest torque of each axis beyond its limit.
    pub(crate) overloads: Vec<Demand>,
    /// Axes that may lag behind their set-points.
    pub(crate) lags: Vec<Lag>,
    /// Longest observed duration of one turn of the task.
    pub blocked: Duration,
}

impl Rehearsed {
    /// Warnings of axes that the task overloads, or that may lag behind, according to nominal numbers. An overload
    /// according to numbers that the user gave is an error. Both concern emulated robots, with their payloads and their
    /// surroundings.
    pub fn overloads(&self, file: &CellFile) -> anyhow::Result<Vec<String>> {
        let mut warnings = demand::judge(file, self.refused.as_ref(), &self.overloads)?;
        warnings.extend(lag::warnings(file, &self.lags));
        Ok(warnings)
    }
}

/// The part of a robot's course in a run that a rehearsal repeats.
#[derive(Clone, Debug)]
pub(crate) struct Course {
    /// Motor positions, rad, at the start, without a reference.
    pub(crate) start: Axes,
    /// Switchings-on of the drives, numbered from 0, at which the robot had a reference and stood elsewhere: motor
    /// positions, rad.
    pub(crate) found: Vec<(usize, Axes)>,
    /// Numbers of the robot's instructions that had ended before each fault.
    pub(crate) faults: Vec<u64>,
}

impl Course {
    /// A robot at these motor positions, rad, without a reference and without faults.
    pub(crate) fn from(start: Axes) -> Self {
        Self { start, found: Vec::new(), faults: Vec::new() }
    }
}

/// Rehearses a task.
///
/// The task is first rehearsed from the home positions. The first motion of each robot is then rehearsed from `STARTS`
/// positions beside its home position, where homing may leave the arm. The first motion of a robot is its first
/// generator that commands the effector. Each first motion ends at its programmed position, so all later motions are
/// the same in every run.
///
/// A task that hangs in a turn is refused, and so is a generator that hangs in a step. Their thread is left behind.
pub fn rehearse(file: &CellFile, program: &Program) -> anyhow::Result<Rehearsed> {
    aside(file, program, |file, program, turns| {
        let rehearsed = from_home(file, program, turns)?;
        beside_home(file, program, &rehearsed.moved, turns)?;
        Ok(rehearsed)
    })
}

/// Runs rehearsals on a separate thread, and warns of a task that blocks.
fn aside(
    file: &CellFile,
    program: &Program,
    work: impl FnOnce(&Arc<CellFile>, &Program, &Turns) -> anyhow::Result<Rehearsed> + Send + 'static,
) -> anyhow::Result<Rehearsed> {
    let (file, program, turns) = (Arc::new(file.clone()), program.clone(), Turns::default());
    let counted = turns.clone();
    let work = move || work(&file, &program, &counted);
    let (rehearsed, blocked) = returned_after("rehearsal", &turns, work)?;
    let rehearsed = Rehearsed { blocked, ..rehearsed? };
    if let Some(told) = told_of_blocking(blocked) {
        streams::warn(format_args!("mrroc: {told}"));
    }
    Ok(rehearsed)
}

/// The warning of a task that blocks for a time.
pub(crate) fn told_of_blocking(blocked: Duration) -> Option<String> {
    (blocked >= BLOCKED).then(|| {
        format!(
            "the task blocked for {blocked:.1?} in the rehearsal, between two awaits: for this time in a run, it takes no \
             reading and begins no motion, and after 10 s all robots stop: await cell.sleep, or work on a thread"
        )
    })
}

/// The courses of all robots, which begin at the positions `start`.
fn courses(file: &CellFile, start: &dyn Fn(&PlannedStart) -> Axes) -> Vec<Course> {
    homes(file).iter().map(|home| Course::from(start(home))).collect()
}

fn from_home(file: &Arc<CellFile>, program: &Program, turns: &Turns) -> anyhow::Result<Rehearsed> {
    let at_home = courses(file, &|home| home.motors);
    run(file, program, &at_home, Extent::Task, &AtomicBool::new(false), turns)
}

/// Rehearses the first motions of the robots that move, from places beside their home positions.
fn beside_home(file: &Arc<CellFile>, program: &Program, moved: &[bool], turns: &Turns) -> anyhow::Result<()> {
    for number in 0..STARTS {
        let beside = courses(file, &|home| beside(home, number));
        run(file, program, &beside, Extent::FirstMotions(moved), &AtomicBool::new(false), turns)?;
    }
    Ok(())
}

/// Rehearses a task again with the present courses of the robots. Ends early, without a refusal, once the rehearsal is
/// `cancelled`. A rehearsal that panics or hangs is refused.
pub(crate) fn rehearse_again(
    file: &Arc<CellFile>,
    program: &Program,
    courses: Vec<Course>,
    cancelled: &Arc<AtomicBool>,
) -> anyhow::Result<()> {
    let (file, program, cancelled) = (Arc::clone(file), program.clone(), Arc::clone(cancelled));
    let turns = Turns::default();
    let counted = turns.clone();
    let work = move || run(&file, &program, &courses, Extent::Again, &cancelled, &counted);
    returned("rehearsal", &turns, work)?.map(|_| ())
}

/// The home position of each robot.
pub(crate) fn homes(file: &CellFile) -> Vec<PlannedStart> {
    file.arms.iter().enumerate().map(|(robot, arm)| file.cell.home(robot, arm)).collect()
}

/// The motor positions of start `number` of [`STARTS`].
///
/// The distance of each motor from its home position is its tolerance. Any three motors occur in all eight
/// combinations of signs: an orthogonal array of strength 3. To first order, a quantity has its extremes at such
/// corners.
fn beside(home: &PlannedStart, number: usize) -> Axes {
    std::array::from_fn(|axis| {
        let odd = (number & (STARTS / 2 + axis)).count_ones() % 2 == 1;
        let distance = home.tolerance[axis];
        home.motors[axis] + if odd { -distance } else { distance }
    })
}

/// The rehearsed part of a task.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Extent<'a> {
    Task,
    /// The whole task again, from where the robots stand in a run.
    Again,
    /// The first motion of each robot that moves, for at most [`BEGINNING`].
    FirstMotions(&'a [bool]),
}

impl Extent<'_> {
    fn is_whole(self) -> bool {
        !matches!(self, Self::FirstMotions(_))
    }
}

/// Rehearses a task on ideal drives, with the course of each robot.
fn run(
    file: &Arc<CellFile>,
    program: &Program,
    courses: &[Course],
    extent: Extent,
    cancelled: &AtomicBool,
    turns: &Turns,
) -> anyhow::Result<Rehearsed> {
    let faults: Vec<Arc<AtomicBool>> = courses.iter().map(|_| Arc::default()).collect();
    let drives = |bus| Box::new(IdealDrives::of(file, bus, courses, &faults)) as Box<dyn DriveGroup>;
    let groups = (0..file.cell.groups().count()).map(drives);
    let mut config = setup::servo_config(file);
    // Ideal drives follow positions, and stand at the commanded position from the start.
    for axis in config.effectors.iter_mut().flat_map(|it| &mut it.axes) {
        axis.position_loop = PositionLoop::Drive;
        axis.homing = None;
    }
    let (mut servo, links) = Servo::new(&config, groups.collect())?;
    let states: Vec<_> = links.iter().map(|link| link.latest.clone()).collect();
    let judged = 0..if extent.is_whole() { courses.len() } else { 0 };
    let mut demands: Vec<_> = judged.map(|robot| RobotDemand::of(file, robot, program.of_file)).collect();
    let dt = servo.period().as_secs_f64();
    let (mut rehearsed_sensors, sensor_links) = setup::rehearsed_sensors(file);
    let (mut rehearsed_matrices, matrices) = setup::rehearsed_matrices(file);
    let sensors = setup::force_sensors(file, &sensor_links, &links);
    setup::install_rehearsed_laws(file, &mut servo)?;
    let subcontrollers = setup::subcontrollers(file, links);
    let (mut nodes, io) = setup::rehearsed_io(file);
    let equipment = Equipment {
        subcontrollers,
        io,
        sensors: sensors.clone(),
        matrices,
        cameras: setup::rehearsed_cameras(file),
        speed: servo.speed_override(),
        figures: Figures::default(),
    };
    let mut executor = program.begin(file, equipment, true, turns.clone());
    let (mut moved, mut ended) = (vec![false; courses.len()], vec![0; courses.len()]);
    let mut faults_left: Vec<_> = courses.iter().map(|course| course.faults.iter().peekable()).collect();
    let start = lockstep::bring_up(&mut servo, Instant::ZERO, |_| {}).expect("ideal drives come up");
    let over = Cell::new(false);
    let longest = if extent.is_whole() { LONGEST } else { BEGINNING };
    lockstep::run(
        &mut servo,
        start,
        |now| {
            for (demand, state) in demands.iter_mut().zip(&states) {
                demand.observe(file, &state.read(), now.since(start), dt);
            }
            nodes.iter_mut().for_each(|node| node.advance(now));
            rehearsed_matrices.iter_mut().for_each(|matrix| matrix.advance(now));
            for (rehearsed, sensor) in rehearsed_sensors.iter_mut().zip(&sensors) {
                // A robot that is not homed has no known orientation.
                rehearsed.advance(now, sensor.load(now).unwrap_or_default().components());
            }
            let busy = executor.poll(now, |_, news| {
                if let News::Ended { robot, moved: commanded } = news {
                    ended[robot] += 1;
                    moved[robot] |= commanded;
                }
            });
            for (robot, left) in faults_left.iter_mut().enumerate() {
                if left.next_if(|&&before| ended[robot] >= before).is_some() {
                    faults[robot].store(true, Ordering::Relaxed);
                }
            }
            let far_enough = matches!(extent, Extent::FirstMotions(wanted) if wanted == moved);
            over.set(!busy || far_enough);
        },
        |_| {},
        |_, now| over.get() || now.since(start) > longest || cancelled.load(Ordering::Relaxed),
    );
    let duration = Duration::from_nanos(servo.counters().cycles) * servo.period().as_nanos() as u32;
    let up_to_here = |why: &dyn Display| {
        if extent.is_whole() {
            let seconds = duration.as_secs_f64();
            streams::warn(format_args!("mrroc: the task is rehearsed up to {seconds:.1} s: {why}"));
        }
    };
    match executor.finish().0 {
        Some(Ended::Task(Err(TaskError::NotRehearsed { why }))) => up_to_here(&why),
        Some(Ended::Task(Err(TaskError::Instruction { robot, error }))) if error.cause == EcpError::NotHomed => {
            up_to_here(&format_args!(
                "robot {robot} moves without homing. A run rehearses the task again before this motion, from where the \
                 robot stands"
            ));
        }
        Some(Ended::Task(Ok(()))) => {}
        Some(Ended::Task(Err(TaskError::Instruction { error, .. })))
        | Some(Ended::System(SystemError::Instruction(error))) => {
            return Err(refuse_instruction(file, program, &error, extent));
        }
        Some(Ended::Task(Err(TaskError::Refused(error)))) if error.is::<FileError>() => return Err(error),
        Some(Ended::Task(Err(TaskError::Refused(error)))) => {
            return Err(anyhow!("{error:#} ({})", lacks(file, extent)));
        }
        Some(Ended::Task(Err(error))) => return Err(error.into()),
        Some(Ended::System(error)) => return Err(error.into()),
        None if extent.is_whole() && !over.get() && !cancelled.load(Ordering::Relaxed) => {
            let problem = format!("a program takes longer than {} h", LONGEST.as_secs() / 3600);
            return Err(file.refuse(&Path::to("robot"), problem));
        }
        None => {}
    }
    let lags = demands.iter().flat_map(|demand| demand.lags(file)).collect();
    let (refused, overloads): (Vec<_>, Vec<_>) = demands.into_iter().map(RobotDemand::found).unzip();
    let (refused, overloads) = (refused.into_iter().flatten().next(), overloads.into_iter().flatten().collect());
    let (instructions, blocked) = (ended.iter().sum(), Duration::ZERO);
    let duration = Some(duration);
    Ok(Rehearsed { duration, with_scene: None, instructions, moved, refused, overloads, lags, blocked })
}

/// The refusal of an instruction.
fn refuse_instruction(
    file: &CellFile,
    program: &Program,
    &InstructionError { robot, instruction, cause, .. }: &InstructionError,
    extent: Extent,
) -> anyhow::Error {
    let why = match extent {
        Extent::Task | Extent::Again => cause.to_string(),
        Extent::FirstMotions(_) => {
            format!("{cause}; from beside the home position, where homing may leave the robot")
        }
    };
    match program.of_file {
        true => of_program(file, robot, instruction, &cause, why),
        false => of_task(file, robot, instruction, why, extent),
    }
}

/// The refusal of an instruction of the cell file's program. The key is that of the number where the cause has one.
fn of_program(file: &CellFile, robot: usize, instruction: usize, cause: &EcpError, why: String) -> anyhow::Error {
    let place = file.cell.robot[robot].instruction_of(instruction).map(|index| instruction_path(robot, index));
    let key = match (place, cause) {
        // Joint motions alone have a duration.
        (Some(place), EcpError::Generator { error: GeneratorError::TooShort { .. }, .. }) => {
            place.then("joints").then("duration")
        }
        (Some(place), _) => place,
        (None, _) => Path::to("robot").then(robot),
    };
    file.refuse(&key, why)
}

/// The refusal of an instruction of a task outside a cell file.
fn of_task(file: &CellFile, robot: usize, instruction: usize, why: String, extent: Extent) -> anyhow::Error {
    let robot = &file.cell.robot[robot];
    let (name, why, number) = (&robot.name, robot.naming_axes(why), instruction + 1);
    anyhow!("robot {name}: instruction {number} of its task: {why} ({})", lacks(file, extent))
}

/// Ideal drives, which reach a commanded position at the SYNC that latches it.
pub(crate) struct IdealDrives {
    axes: Vec<IdealAxis>,
    now: Instant,
}

struct IdealAxis {
    /// The command of this cycle, the command sent, which the next SYNC latches, and the latched command.
    written: AxisCommand,
    sent: AxisCommand,
    latched: AxisCommand,
    /// Motor position sampled by the last SYNC, rad.
    position: f64,
    /// Whether the position counter has its reference.
    homed: bool,
    /// Number of times that the drive was switched on.
    switched_on: usize,
    /// The motor positions of [`Course::found`], rad.
    found: Vec<(usize, f64)>,
    /// Whether the drive has a fault. All axes of a robot share the fault.
    faulted: Arc<AtomicBool>,
}

impl IdealDrives {
    /// The drives of bus `bus`, with the course of each robot. `faults` has one flag per robot, which gives all its
    /// drives a fault.
    pub(crate) fn of(file: &CellFile, bus: usize, courses: &[Course], faults: &[Arc<AtomicBool>]) -> Self {
        let off = AxisCommand::Off;
        let axis = |(robot, axis): (usize, usize)| IdealAxis {
            written: off,
            sent: off,
            latched: off,
            position: courses[robot].start[axis],
            homed: false,
            switched_on: 0,
            found: courses[robot].found.iter().map(|(number, motors)| (*number, motors[axis])).collect(),
            faulted: Arc::clone(&faults[robot]),
        };
        Self { axes: file.cell.axes_on(bus).map(axis).collect(), now: Instant::ZERO }
    }
}

impl IdealAxis {
    /// Whether the latched command gives the motor a torque.
    fn is_on(&self) -> bool {
        !matches!(self.latched, AxisCommand::Off | AxisCommand::ResetFault)
    }

    /// A SYNC: latches the command that was sent.
    fn latch(&mut self) {
        let was_on = self.is_on();
        self.latched = std::mem::replace(&mut self.sent, self.written);
        if !was_on && self.is_on() {
            if let Some((_, position)) = self.found.iter().find(|(number, _)| *number == self.switched_on) {
                (self.position, self.homed) = (*position, true);
            }
            self.switched_on += 1;
        }
        match self.latched {
            AxisCommand::Follow(Setpoint::Position(position)) => self.position = position.get(),
            AxisCommand::Home => self.homed = true,
            AxisCommand::ResetFault => self.faulted.store(false, Ordering::Relaxed),
            _ => {}
        }
    }
}

impl DriveGroup for IdealDrives {
    fn axes(&self) -> usize {
        self.axes.len()
    }

    fn delay(&self) -> usize {
        2
    }

    fn bring_up(&mut self, _: Instant) -> Poll<Result<(), BringUpError>> {
        Poll::Ready(Ok(()))
    }

    fn read(&mut self, _: Instant, states: &mut [AxisState]) {
        for (axis, state) in self.axes.iter().zip(states) {
            let on = axis.is_on();
            *state = AxisState {
                at: self.now,
                sampled: self.now,
                position: axis.position,
                power: if on { Power::On } else { Power::Off },
                homing: if axis.homed { Homing::Attained } else { Homing::NotHomed },
                fault: axis.faulted.load(Ordering::Relaxed).then_some(FAULT),
                following: on,
                ..AxisState::default()
            };
        }
    }

    fn write(&mut self, _: Instant, commands: &[AxisCommand]) {
        for (axis, command) in self.axes.iter_mut().zip(commands) {
            axis.written = *command;
        }
    }

    fn send(&mut self, now: Instant) -> bool {
        self.now = now;
        self.axes.iter_mut().for_each(IdealAxis::latch);
        true
    }

    fn counters(&self) -> GroupCounters {
        GroupCounters::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tasks::CarriedTask;

    const IRB6: &str = include_str!("../../cells/irb6.toml");

    #[test]
    fn a_refused_duration_is_refused_with_its_key() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("cell.toml");
        let jerk_limited = "generator = \"jerk-limited\", ";
        let refused = |text: &str| {
            std::fs::write(&path, text).unwrap();
            let file = CellFile::read(&path).unwrap();
            rehearse(&file, &CarriedTask::Programs.program()).unwrap_err().to_string()
        };
        let said = refused(&IRB6.replace(jerk_limited, &format!("{jerk_limited}duration = 0.01, ")));
        assert!(said.contains(": robot[0].program[2].joints.duration: step 0: takes "), "{said}");
        // Another cause is refused with the key of the instruction.
        let said = refused(&IRB6.replace("position = [0.85, 0.0, 0.85]", "position = [0.85, 0.0, 9.0]"));
        assert!(!said.contains("duration"), "{said}");
    }
}
