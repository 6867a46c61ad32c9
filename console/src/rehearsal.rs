//! The programs of a cell, run through the real servo and the real generators on ideal drives.
//!
//! The servo and the generators refuse here what they would refuse on the robot, in virtual time and before anything
//! moves: a pose out of reach, a motion beyond a limit, a line through a singularity.
//!
//! A rehearsal promises a run to its end for robots that are homed first. Drives that kept their reference from an earlier
//! run are not homed, and their robot stands anywhere: `mrroc run` then rehearses its program again from there.

use std::task::Poll;
use std::time::Duration;

use can::Instant;
use controller::cell::{Instruction, Path, Robot, instruction_path};
use controller::ecp::{Ecp, EcpError, Meetings};
use controller::generator::{Axes, PlannedStart};
use drive::{
    AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters, Homing, Power, Setpoint,
};
use servo::{PositionLoop, Servo, lockstep};

use crate::cell_file::CellFile;
use crate::setup;

/// No program is longer than this.
const LONGEST: Duration = Duration::from_secs(24 * 3600);

/// Time of a first motion that is rehearsed from beside the home position.
const BEGINNING: Duration = Duration::from_secs(600);

/// Starts beside the home position that are rehearsed.
const STARTS: usize = 16;

/// Rehearses every program and returns how long the longest takes after homing.
///
/// The programs are rehearsed from the home positions first. Then the first motion of each robot is rehearsed from
/// [`STARTS`] places beside its home position, where homing may leave the arm. Each first motion ends at the place that it
/// names, so that all motions after it are the same in every run.
pub(crate) fn rehearse(file: &CellFile) -> anyhow::Result<Duration> {
    let homes = homes(file);
    let motors: Vec<_> = homes.iter().map(|home| home.motors).collect();
    let duration = Rehearsal::of(file, &motors)?.run(Extent::Programs)?;
    for number in 0..STARTS {
        let starts: Vec<_> = homes.iter().map(|home| beside(home, number)).collect();
        Rehearsal::of(file, &starts)?.run(Extent::FirstMotions)?;
    }
    Ok(duration)
}

/// Rehearses every program with robot `robot` at these motor positions, rad, and the others at home.
pub(crate) fn rehearse_from(file: &CellFile, robot: usize, motors: Axes) -> anyhow::Result<()> {
    let mut starts: Vec<_> = homes(file).iter().map(|home| home.motors).collect();
    starts[robot] = motors;
    Rehearsal::of(file, &starts)?.run(Extent::Programs)?;
    Ok(())
}

/// The home positions of the robots.
fn homes(file: &CellFile) -> Vec<PlannedStart> {
    let robots = file.arms.iter().enumerate();
    robots
        .map(|(robot, arm)| file.cell.home(robot, arm))
        .collect()
}

/// The motor positions of start `number` of [`STARTS`].
///
/// Each motor is beside its home position by its tolerance. Any three motors are so in all eight combinations of signs:
/// an orthogonal array of strength 3. To first order a quantity has its extremes at such corners.
fn beside(home: &PlannedStart, number: usize) -> Axes {
    std::array::from_fn(|axis| {
        let odd = (number & (STARTS / 2 + axis)).count_ones() % 2 == 1;
        let distance = home.tolerance[axis];
        home.motors[axis] + if odd { -distance } else { distance }
    })
}

/// How much of the programs is rehearsed.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Extent {
    /// All.
    Programs,
    /// The first motion of each robot, or [`BEGINNING`] of it.
    FirstMotions,
}

/// A rehearsal that has not begun.
struct Rehearsal<'a> {
    file: &'a CellFile,
    servo: Servo,
    ecps: Vec<Ecp>,
    meetings: Meetings,
}

impl<'a> Rehearsal<'a> {
    /// On ideal drives at these motor positions, rad, of one robot after the other.
    fn of(file: &'a CellFile, starts: &[Axes]) -> anyhow::Result<Self> {
        let groups = (0..file.cell.groups().count())
            .map(|bus| Box::new(IdealDrives::of(file, bus, starts)) as Box<dyn DriveGroup>);
        let mut config = setup::servo_config(file);
        // Ideal drives follow positions, and are where they should be from the start.
        for axis in config.effectors.iter_mut().flat_map(|it| &mut it.axes) {
            axis.position_loop = PositionLoop::Drive;
            axis.homing = None;
        }
        let (servo, links) = Servo::new(&config, groups.collect())?;
        let mut ecps = Vec::new();
        for (robot, link) in links.into_iter().enumerate() {
            let arm = file.arms[robot].clone();
            let task = file.cell.task(robot, &arm);
            let task = task.map_err(|(key, error)| {
                let axis = error.axis().map(|axis| file.axis_name(robot, axis));
                let axis = axis.map_or(String::new(), |name| name + ", ");
                file.refuse(&key, format_args!("{axis}{error}"))
            })?;
            let mut ecp = Ecp::new(arm, link, setup::ecp_config(file, robot));
            ecp.execute(task).expect("a new ECP has nothing under way");
            ecps.push(ecp);
        }
        let meetings = setup::meetings(file, servo.gates());
        Ok(Self {
            file,
            servo,
            ecps,
            meetings,
        })
    }

    /// Runs the programs, all of them or their first motions, and returns how long that takes.
    fn run(self, extent: Extent) -> anyhow::Result<Duration> {
        let Self {
            file,
            mut servo,
            mut ecps,
            mut meetings,
        } = self;
        let robots = &file.cell.robot;
        let mut ended = vec![0; ecps.len()];
        let needed: Vec<_> = robots
            .iter()
            .map(|robot| extent.instructions(robot))
            .collect();
        let mut failure = None;
        let start =
            lockstep::bring_up(&mut servo, Instant::ZERO, |_| {}).expect("ideal drives come up");
        let end = std::cell::Cell::new(start);
        lockstep::run(
            &mut servo,
            start,
            |now| {
                end.set(now);
                for (robot, ecp) in ecps.iter_mut().enumerate() {
                    while let Some(event) = ecp.poll(now) {
                        ended[robot] = event.instruction + 1;
                        let Err(error) = event.outcome else { continue };
                        let place = robots[robot].instruction_of(event.instruction);
                        let key = place.map_or_else(
                            || Path::default().then("robot").then(robot),
                            |index| instruction_path(robot, index),
                        );
                        failure.get_or_insert_with(|| extent.refuse(file, &key, &error));
                    }
                }
                meetings.poll(&mut ecps);
                let over = ended
                    .iter()
                    .zip(&needed)
                    .all(|(ended, needed)| ended >= needed);
                if failure.is_some() || over {
                    end.set(Instant::FAR_FUTURE);
                }
            },
            |_| {},
            |_, now| end.get() == Instant::FAR_FUTURE || now.since(start) > extent.longest(),
        );
        match failure {
            Some(failure) => Err(failure),
            None if extent == Extent::Programs && end.get() != Instant::FAR_FUTURE => {
                let problem = format!("a program takes longer than {} h", LONGEST.as_secs() / 3600);
                Err(file.refuse(&Path::default().then("robot"), problem))
            }
            None => Ok(
                Duration::from_nanos(servo.counters().cycles) * servo.period().as_nanos() as u32
            ),
        }
    }
}

impl Extent {
    /// How many instructions of a robot's task have to end.
    fn instructions(self, robot: &Robot) -> usize {
        let moves = |index: &usize| {
            let instruction = robot.instruction_of(*index);
            let instruction = instruction.map(|index| &robot.program[index]);
            instruction.is_some_and(|it| !matches!(it, Instruction::Meet(_)))
        };
        let all = robot.task_len();
        match self {
            Self::Programs => all,
            Self::FirstMotions => (0..all).find(moves).map_or(0, |first| first + 1),
        }
    }

    fn longest(self) -> Duration {
        match self {
            Self::Programs => LONGEST,
            Self::FirstMotions => BEGINNING,
        }
    }

    /// The refusal of the instruction at `key`.
    fn refuse(self, file: &CellFile, key: &Path, error: &EcpError) -> anyhow::Error {
        match self {
            Self::Programs => file.refuse(key, error),
            Self::FirstMotions => {
                let whence = "from beside the home position, where homing may leave the robot";
                file.refuse(key, format_args!("{error}; {whence}"))
            }
        }
    }
}

/// Drives that are where they were told to be at the SYNC that told them.
struct IdealDrives {
    axes: Vec<IdealAxis>,
    now: Instant,
}

#[derive(Clone, Copy)]
struct IdealAxis {
    /// The command of this cycle, the one that was sent and the next SYNC latches, and the one latched.
    written: AxisCommand,
    sent: AxisCommand,
    latched: AxisCommand,
    /// Where the motor was when the last SYNC sampled it.
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
        Self {
            axes: file.cell.axes_on(bus).map(axis).collect(),
            now: Instant::ZERO,
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
            let on = !matches!(axis.latched, AxisCommand::Off | AxisCommand::ResetFault);
            *state = AxisState {
                at: self.now,
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
