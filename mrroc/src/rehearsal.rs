//! The programs of a cell, run through the real servo and the real generators on ideal drives.
//!
//! Whatever the servo or a generator would refuse on the robot they refuse here, in virtual time and before anything
//! moves: a pose out of reach, a motion beyond a limit, a line through a singularity.

use std::task::Poll;
use std::time::Duration;

use crate::cell::{Path, instruction_path};
use anyhow::anyhow;
use can::Instant;
use drive::{
    AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters, Homing, Power, Setpoint,
};
use servo::{PositionLoop, Servo, lockstep};

use crate::cell_file::CellFile;
use crate::setup;
use crate::tasks::Tasks;

/// No program is longer than this.
const LONGEST: Duration = Duration::from_secs(24 * 3600);

/// Rehearses the tasks of a cell and returns how long the longest takes after homing.
pub fn rehearse(
    file: &CellFile,
    tasks: &dyn Fn(&CellFile) -> anyhow::Result<Tasks>,
) -> anyhow::Result<Duration> {
    let groups = (0..file.cell.groups().count())
        .map(|bus| Box::new(IdealDrives::of(file, bus)) as Box<dyn DriveGroup>);
    let mut config = setup::servo_config(file);
    // Ideal drives follow positions, and are where they should be from the start.
    for axis in config.effectors.iter_mut().flat_map(|it| &mut it.axes) {
        axis.position_loop = PositionLoop::Drive;
        axis.homing = None;
    }
    let (mut servo, links) = Servo::new(&config, groups.collect())?;
    let tasks = tasks(file)?;
    let from_cell = tasks.are_programs();
    let mut subcontrollers = setup::subcontrollers(file, links, servo.gates(), tasks);
    let mut failure = None;
    let start =
        lockstep::bring_up(&mut servo, Instant::ZERO, |_| {}).expect("ideal drives come up");
    let end = std::cell::Cell::new(start);
    lockstep::run(
        &mut servo,
        start,
        |now| {
            end.set(now);
            let busy = subcontrollers.poll(now, |robot, event| {
                let Err(error) = event.outcome else { return };
                failure.get_or_insert_with(|| {
                    let name = &file.cell.robot[robot].name;
                    if !from_cell {
                        return anyhow!(
                            "robot {name}: instruction {} of the task: {error}",
                            event.instruction
                        );
                    }
                    let place = file.cell.robot[robot].instruction_of(event.instruction);
                    let key = place.map_or_else(
                        || Path::default().then("robot").then(robot),
                        |index| instruction_path(robot, index),
                    );
                    file.refuse(&key, error)
                });
            });
            if failure.is_some() || !busy {
                end.set(Instant::FAR_FUTURE);
            }
        },
        |_| {},
        |_, now| end.get() == Instant::FAR_FUTURE || now.since(start) > LONGEST,
    );
    match failure {
        Some(failure) => Err(failure),
        None if end.get() != Instant::FAR_FUTURE => Err(file.refuse(
            &Path::default().then("robot"),
            format!("a program takes longer than {} h", LONGEST.as_secs() / 3600),
        )),
        None => {
            Ok(Duration::from_nanos(servo.counters().cycles) * servo.period().as_nanos() as u32)
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
    fn of(file: &CellFile, bus: usize) -> Self {
        let home = |(robot, axis): (usize, usize)| file.arms[robot].robot().home()[axis];
        let off = AxisCommand::Off;
        let axis = |place| IdealAxis {
            written: off,
            sent: off,
            latched: off,
            position: home(place),
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
