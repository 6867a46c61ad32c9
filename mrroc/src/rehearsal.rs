//! Rehearsal of the programs of a cell: the real servo and generators with ideal drives.
//!
//! In the rehearsal, servo and generators make the same refusals as on the robot, but in virtual time and before any
//! motion. Examples are a pose out of reach, a motion beyond a limit, and a line through a singularity.
//!
//! A rehearsal covers a whole run for robots that are homed first. Drives that kept their reference from an earlier
//! run are not homed, and their robot may stand anywhere. `mrroc run` then rehearses the program again from the actual
//! position.

use std::cell::Cell;
use std::task::Poll;
use std::time::Duration;

use anyhow::anyhow;
use can::Instant;
use controller::ecp::{EcpError, Task};
use controller::generator::{Axes, PlannedStart};
use drive::{AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters, Homing, Power, Setpoint};
use servo::{PositionLoop, Servo, lockstep};

use crate::cell::{CellFile, Path, instruction_path};
use crate::setup;
use crate::tasks::{MakeTasks, Tasks};

/// Greatest duration of a task.
const LONGEST: Duration = Duration::from_secs(24 * 3600);

/// Greatest duration of a first motion in a rehearsal from beside the home position.
const BEGINNING: Duration = Duration::from_secs(600);

/// Number of rehearsed start positions beside the home position.
const STARTS: usize = 16;

/// Rehearses every task and returns the duration of the longest one after homing.
///
/// The tasks are first rehearsed from the home positions. The first motion of each robot is then rehearsed from
/// `STARTS` positions beside its home position, where homing may leave the arm. Each first motion ends at its
/// programmed position, so all later motions are the same in every run.
pub fn rehearse(file: &CellFile, tasks: &MakeTasks) -> anyhow::Result<Duration> {
    let homes = homes(file);
    let motors: Vec<_> = homes.iter().map(|home| home.motors).collect();
    let duration = run(file, tasks(file)?, &motors, Extent::Tasks)?;
    for number in 0..STARTS {
        let starts: Vec<_> = homes.iter().map(|home| beside(home, number)).collect();
        run(file, tasks(file)?, &starts, Extent::FirstMotions)?;
    }
    Ok(duration)
}

/// Rehearses every task with robot `robot` at these motor positions, rad, and the other robots at home.
pub(crate) fn rehearse_from(file: &CellFile, tasks: &MakeTasks, robot: usize, motors: Axes) -> anyhow::Result<()> {
    let mut starts: Vec<_> = homes(file).iter().map(|home| home.motors).collect();
    starts[robot] = motors;
    run(file, tasks(file)?, &starts, Extent::Tasks).map(|_| ())
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

/// The rehearsed part of the tasks.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Extent {
    Tasks,
    /// The first motion of each robot, for at most [`BEGINNING`].
    FirstMotions,
}

/// Rehearses tasks on ideal drives, from the initial motor positions, rad, of each robot. Returns the duration.
fn run(file: &CellFile, tasks: Tasks, starts: &[Axes], extent: Extent) -> anyhow::Result<Duration> {
    let drives = |bus| Box::new(IdealDrives::of(file, bus, starts)) as Box<dyn DriveGroup>;
    let groups = (0..file.cell.groups().count()).map(drives);
    let mut config = setup::servo_config(file);
    // Ideal drives follow positions, and stand at the commanded position from the start.
    for axis in config.effectors.iter_mut().flat_map(|it| &mut it.axes) {
        axis.position_loop = PositionLoop::Drive;
        axis.homing = None;
    }
    let (mut servo, links) = Servo::new(&config, groups.collect())?;
    let needed = |task: &Option<Task>| match (task, extent) {
        (None, _) => 0,
        (Some(task), Extent::Tasks) => task.len(),
        (Some(task), Extent::FirstMotions) => task.first_motion().map_or(0, |first| first + 1),
    };
    let needed: Vec<_> = tasks.tasks.iter().map(needed).collect();
    let refuse = if tasks.programs { of_program } else { of_task };
    let mut subcontrollers = setup::subcontrollers(file, links, servo.gates(), tasks);
    let mut ended = vec![0; needed.len()];
    let mut failure = None;
    let start = lockstep::bring_up(&mut servo, Instant::ZERO, |_| {}).expect("ideal drives come up");
    let over = Cell::new(false);
    let longest = if extent == Extent::Tasks { LONGEST } else { BEGINNING };
    lockstep::run(
        &mut servo,
        start,
        |now| {
            subcontrollers.poll(now, |robot, _, event| {
                ended[robot] = event.instruction + 1;
                if let Err(error) = event.outcome {
                    failure.get_or_insert_with(|| refuse(file, robot, event.instruction, extent.refusal(&error)));
                }
            });
            let all_ended = ended.iter().zip(&needed).all(|(ended, needed)| ended >= needed);
            over.set(failure.is_some() || all_ended);
        },
        |_| {},
        |_, now| over.get() || now.since(start) > longest,
    );
    match failure {
        Some(failure) => Err(failure),
        None if extent == Extent::Tasks && !over.get() => {
            let problem = format!("a program takes longer than {} h", LONGEST.as_secs() / 3600);
            Err(file.refuse(&Path::to("robot"), problem))
        }
        None => Ok(Duration::from_nanos(servo.counters().cycles) * servo.period().as_nanos() as u32),
    }
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

impl Extent {
    fn refusal(self, error: &EcpError) -> String {
        match self {
            Self::Tasks => error.to_string(),
            Self::FirstMotions => {
                format!("{error}; from beside the home position, where homing may leave the robot")
            }
        }
    }
}

/// Ideal drives, which reach a commanded position at the SYNC that latches it.
struct IdealDrives {
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
    fn of(file: &CellFile, bus: usize, starts: &[Axes]) -> Self {
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
