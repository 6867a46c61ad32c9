//! Rehearsal of a task: the same task on the real servo and generators with ideal drives.
//!
//! In the rehearsal, servo and generators make the same refusals as on the robot, but in virtual time and before any
//! motion. Examples are a pose out of reach, a motion beyond a limit, and a line through a singularity.
//!
//! A rehearsal covers a whole run for robots that are homed first. Drives that kept their reference from an earlier
//! run are not homed, and their robot may stand anywhere. `mrroc run` then rehearses the task again from the actual
//! position.
//!
//! An error that the task handles is no refusal. A task can leave out its side effects
//! ([`Cell::rehearsing`](crate::tasks::Cell::rehearsing)) or end the rehearsal
//! ([`Cell::end_rehearsal`](crate::tasks::Cell::end_rehearsal)).

use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::Poll;
use std::time::Duration;

use anyhow::anyhow;
use can::Instant;
use controller::executor::{Ended, InstructionError, SystemError, Turns};
use controller::generator::{Axes, PlannedStart};
use drive::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters, Homing, Power, Setpoint};
use servo::{PositionLoop, Servo, lockstep};

use crate::cell::{CellFile, Path, instruction_path};
use crate::tasks::{Equipment, Figures, Program, TaskError};
use crate::{run::returned, setup, streams};

/// Greatest duration of a task.
const LONGEST: Duration = Duration::from_secs(24 * 3600);

/// Greatest duration of a first motion in a rehearsal from beside the home position.
const BEGINNING: Duration = Duration::from_secs(600);

/// Number of rehearsed start positions beside the home position.
const STARTS: usize = 16;

/// A rehearsal from the home positions.
#[derive(Clone, Debug)]
pub struct Rehearsed {
    /// Duration without homing.
    pub duration: Duration,
    /// Number of instructions of all robots.
    pub instructions: u64,
    /// Whether each robot moved.
    moved: Vec<bool>,
}

/// Rehearses a task.
///
/// The task is first rehearsed from the home positions. The first motion of each robot is then rehearsed from
/// `STARTS` positions beside its home position, where homing may leave the arm. Each first motion ends at its
/// programmed position, so all later motions are the same in every run.
///
/// A task that hangs in a turn is refused, and its thread is left behind.
pub fn rehearse(file: &CellFile, program: &Program) -> anyhow::Result<Rehearsed> {
    let (file, program, turns) = (Arc::new(file.clone()), program.clone(), Turns::default());
    let counted = turns.clone();
    returned("rehearsal", &turns, move || rehearse_all(&file, &program, &counted))?
}

fn rehearse_all(file: &Arc<CellFile>, program: &Program, turns: &Turns) -> anyhow::Result<Rehearsed> {
    let homes = homes(file);
    let motors: Vec<_> = homes.iter().map(|home| home.motors).collect();
    let never = AtomicBool::new(false);
    let rehearsed = run(file, program, &motors, Extent::Task, &never, turns)?;
    for number in 0..STARTS {
        let starts: Vec<_> = homes.iter().map(|home| beside(home, number)).collect();
        run(file, program, &starts, Extent::FirstMotions(&rehearsed.moved), &never, turns)?;
    }
    Ok(rehearsed)
}

/// Rehearses a task with robot `robot` at these motor positions, rad, and the other robots at home. Ends early, without a
/// refusal, once the rehearsal is `cancelled`.
pub(crate) fn rehearse_from(
    file: &Arc<CellFile>,
    program: &Program,
    robot: usize,
    motors: Axes,
    cancelled: &AtomicBool,
) -> anyhow::Result<()> {
    let mut starts: Vec<_> = homes(file).iter().map(|home| home.motors).collect();
    starts[robot] = motors;
    run(file, program, &starts, Extent::Task, cancelled, &Turns::default()).map(|_| ())
}

fn homes(file: &CellFile) -> Vec<PlannedStart> {
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
    /// The first motion of each robot that moves, for at most [`BEGINNING`].
    FirstMotions(&'a [bool]),
}

/// Rehearses a task on ideal drives, from the initial motor positions, rad, of each robot.
fn run(
    file: &Arc<CellFile>,
    program: &Program,
    starts: &[Axes],
    extent: Extent,
    cancelled: &AtomicBool,
    turns: &Turns,
) -> anyhow::Result<Rehearsed> {
    let drives = |bus| Box::new(IdealDrives::of(file, bus, starts)) as Box<dyn DriveGroup>;
    let groups = (0..file.cell.groups().count()).map(drives);
    let mut config = setup::servo_config(file);
    // Ideal drives follow positions, and stand at the commanded position from the start.
    for axis in config.effectors.iter_mut().flat_map(|it| &mut it.axes) {
        axis.position_loop = PositionLoop::Drive;
        axis.homing = None;
    }
    let (mut servo, links) = Servo::new(&config, groups.collect())?;
    let subcontrollers = setup::subcontrollers(file, links);
    let (mut nodes, io) = setup::rehearsed_io(file);
    let equipment = Equipment { subcontrollers, io, speed: servo.speed_override(), figures: Figures::default() };
    let mut executor = program.begin(file, equipment, true, turns.clone());
    let (mut moved, mut instructions) = (vec![false; starts.len()], 0);
    let start = lockstep::bring_up(&mut servo, Instant::ZERO, |_| {}).expect("ideal drives come up");
    let over = Cell::new(false);
    let longest = if extent == Extent::Task { LONGEST } else { BEGINNING };
    lockstep::run(
        &mut servo,
        start,
        |now| {
            nodes.iter_mut().for_each(|node| node.advance(now));
            let busy = executor.poll(now, |_, ended| {
                instructions += 1;
                moved[ended.robot] |= ended.moved;
            });
            let far_enough = matches!(extent, Extent::FirstMotions(wanted) if wanted == moved);
            over.set(!busy || far_enough);
        },
        |_| {},
        |_, now| over.get() || now.since(start) > longest || cancelled.load(Ordering::Relaxed),
    );
    let duration = Duration::from_nanos(servo.counters().cycles) * servo.period().as_nanos() as u32;
    match executor.finish().0 {
        Some(Ended::Task(Err(TaskError::NotRehearsed { why }))) if extent == Extent::Task => {
            let seconds = duration.as_secs_f64();
            streams::warn(format_args!("mrroc: the task is rehearsed up to {seconds:.1} s: {why}"));
        }
        Some(Ended::Task(Ok(()) | Err(TaskError::NotRehearsed { .. }))) => {}
        Some(Ended::Task(Err(TaskError::Instruction { error, .. })))
        | Some(Ended::System(SystemError::Instruction(error))) => {
            return Err(refuse_instruction(file, program, &error, extent));
        }
        Some(Ended::Task(Err(TaskError::Refused(error)))) => return Err(error),
        Some(Ended::Task(Err(error))) => return Err(error.into()),
        Some(Ended::System(error)) => return Err(error.into()),
        None if extent == Extent::Task && !over.get() && !cancelled.load(Ordering::Relaxed) => {
            let problem = format!("a program takes longer than {} h", LONGEST.as_secs() / 3600);
            return Err(file.refuse(&Path::to("robot"), problem));
        }
        None => {}
    }
    Ok(Rehearsed { duration, instructions, moved })
}

/// The refusal of an instruction.
fn refuse_instruction(
    file: &CellFile,
    program: &Program,
    &InstructionError { robot, instruction, cause, .. }: &InstructionError,
    extent: Extent,
) -> anyhow::Error {
    let why = match extent {
        Extent::Task => cause.to_string(),
        Extent::FirstMotions(_) => {
            format!("{cause}; from beside the home position, where homing may leave the robot")
        }
    };
    if program.of_file { of_program(file, robot, instruction, why) } else { of_task(file, robot, instruction, why) }
}

/// The refusal of an instruction of the cell file's program.
fn of_program(file: &CellFile, robot: usize, instruction: usize, why: String) -> anyhow::Error {
    let place = file.cell.robot[robot].instruction_of(instruction).map(|index| instruction_path(robot, index));
    file.refuse(&place.unwrap_or(Path::to("robot").then(robot)), why)
}

/// The refusal of an instruction of a task outside a cell file.
fn of_task(file: &CellFile, robot: usize, instruction: usize, why: String) -> anyhow::Error {
    let robot = &file.cell.robot[robot];
    let (name, why, number) = (&robot.name, robot.naming_axes(why), instruction + 1);
    anyhow!("robot {name}: instruction {number} of its task: {why}")
}

/// Ideal drives, which reach a commanded position at the SYNC that latches it.
pub(crate) struct IdealDrives {
    axes: Vec<IdealAxis>,
    now: Instant,
}

#[derive(Clone, Copy)]
struct IdealAxis {
    /// The command of this cycle, the command sent, which the next SYNC latches, and the latched command.
    written: AxisCommand,
    sent: AxisCommand,
    latched: AxisCommand,
    /// Motor position sampled by the last SYNC.
    position: f64,
}

impl IdealDrives {
    /// The drives of bus `bus`, with each robot at its motor positions of `starts`, rad.
    pub(crate) fn of(file: &CellFile, bus: usize, starts: &[Axes]) -> Self {
        let off = AxisCommand::Off;
        let axis = |(robot, axis): (usize, usize)| IdealAxis {
            written: off,
            sent: off,
            latched: off,
            position: starts[robot][axis],
        };
        Self { axes: file.cell.axes_on(bus).map(axis).collect(), now: Instant::ZERO }
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
            let on = !matches!(axis.latched, AxisCommand::Off | AxisCommand::ResetFault);
            *state = AxisState {
                at: self.now,
                sampled: self.now,
                position: axis.position,
                power: if on { Power::On } else { Power::Off },
                homing: Homing::Attained,
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
        for axis in &mut self.axes {
            axis.latched = std::mem::replace(&mut axis.sent, axis.written);
            if let AxisCommand::Follow(Setpoint::Position(position)) = axis.latched {
                axis.position = position.get();
            }
        }
        true
    }

    fn counters(&self) -> GroupCounters {
        GroupCounters::default()
    }
}
