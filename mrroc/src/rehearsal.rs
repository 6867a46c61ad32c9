//! The programs of a cell, run through the real servo and the real generators on ideal drives.
//!
//! Whatever the servo or a generator would refuse on the robot they refuse here, in virtual time and before anything
//! moves: a pose out of reach, a motion beyond a limit, a line through a singularity.

use std::task::Poll;
use std::time::Duration;

use crate::cell::{Path, instruction_path};
use can::Instant;
use controller::ecp::Ecp;
use drive::{
    AxisCommand, AxisState, BringUpError, DriveGroup, GroupCounters, Homing, Power, Setpoint,
};
use servo::{PositionLoop, Servo, lockstep};

use crate::cell_file::CellFile;
use crate::setup;

/// No program is longer than this.
const LONGEST: Duration = Duration::from_secs(24 * 3600);

/// Rehearses every program and returns how long the longest takes after homing.
pub fn rehearse(file: &CellFile) -> anyhow::Result<Duration> {
    let groups = (0..file.cell.groups().count())
        .map(|bus| Box::new(IdealDrives::of(file, bus)) as Box<dyn DriveGroup>);
    let mut config = setup::servo_config(file);
    // Ideal drives follow positions, and are where they should be from the start.
    for axis in config.effectors.iter_mut().flat_map(|it| &mut it.axes) {
        axis.position_loop = PositionLoop::Drive;
        axis.homing = None;
    }
    let (mut servo, links) = Servo::new(&config, groups.collect())?;
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
    let mut meetings = setup::meetings(file, servo.gates());
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
                    let Err(error) = event.outcome else { continue };
                    let place = file.cell.robot[robot].instruction_of(event.instruction);
                    let key = place.map_or_else(
                        || Path::default().then("robot").then(robot),
                        |index| instruction_path(robot, index),
                    );
                    failure.get_or_insert_with(|| file.refuse(&key, error));
                }
            }
            meetings.poll(&mut ecps);
            if failure.is_some() || ecps.iter().all(|ecp| ecp.status().instruction.is_none()) {
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
