//! Jog: joints or the tool move at velocities that an operator commands, as long as the commands are repeated.

use std::time::Duration;

use can::Instant;
use drive::latest::{Latest, Publisher, latest};
use nalgebra::{Matrix6, Vector3, Vector6};
use servo::MAX_AXES;

use super::{Axes, AxesState, EffectorImage, Generator, GeneratorError, MotionLimits, Next, Setpoint};
use crate::robot::{Arm, Joints};

/// Damping of the inverse Jacobian, in m/s and rad/s per rad/s. A direction of the tool with this singular value
/// moves at half the commanded speed.
const DAMPING: f64 = 0.02;
/// Number of fractions of the commanded velocity that are tried near the end of a range.
const FRACTIONS: u32 = 8;
/// Number, kind and values of a command.
const WORDS: usize = 2 + MAX_AXES;

/// Command of an operator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JogCommand {
    /// Velocities of the joints, rad/s, or m/s for a linear joint.
    Joints(Axes),
    /// Velocity of the tool in its own frame.
    Tool {
        /// Velocity of the tool's origin, m/s.
        linear: Vector3<f64>,
        /// Angular velocity, rad/s.
        angular: Vector3<f64>,
    },
    /// Brakes, and ends the motion.
    End,
}

/// The operator's end of a [`Jog`]. Dropping the handle commands [`JogCommand::End`].
#[derive(Debug)]
pub struct JogHandle {
    publisher: Publisher<WORDS>,
    number: u64,
}

impl JogHandle {
    /// Replaces the present command. The command is valid for the dead-man time, and is repeated to continue the
    /// motion. Refuses values that are not finite. The call neither waits nor allocates.
    pub fn command(&mut self, command: JogCommand) -> Result<(), GeneratorError> {
        let (kind, values) = match command {
            JogCommand::Joints(velocity) => (JOINTS, velocity),
            JogCommand::Tool { linear, angular } => {
                (TOOL, [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z, 0.0, 0.0])
            }
            JogCommand::End => (END, Axes::default()),
        };
        if let Some(axis) = values.iter().position(|value| !value.is_finite()) {
            return Err(GeneratorError::NotFinite { pose: 0, axis: axis as u8 });
        }
        self.number += 1;
        let mut words = [self.number, kind, 0, 0, 0, 0, 0, 0, 0, 0];
        for (word, value) in words[2..].iter_mut().zip(values) {
            *word = value.to_bits();
        }
        self.publisher.publish(&words);
        Ok(())
    }
}

impl Drop for JogHandle {
    fn drop(&mut self) {
        let _ = self.command(JogCommand::End);
    }
}

/// Kinds of a command. Any other number is read as the end.
const JOINTS: u64 = 1;
const TOOL: u64 = 2;
const END: u64 = 3;

/// A motion at the velocities of the operator's latest command. Class 1, continuous feedback.
///
/// Without a new command for the dead-man time, counted in the time of the servo from the image in which the last
/// command was found, the joints brake. The motion continues with the next command, and ends at rest after
/// [`JogCommand::End`].
///
/// Velocity and acceleration of each joint stay within the limits: a command beyond a limit is scaled down as a
/// whole. Each set-point leaves room for a stop within the ranges of joints and motors, and the joints therefore slow
/// down before the end of a range.
///
/// A velocity of the tool is converted by the damped inverse of the Jacobian. Near a singularity the tool slows down,
/// and leaves its direction where the mechanism cannot follow. No step allocates.
#[derive(Debug)]
pub struct Jog {
    arm: Arm,
    limits: MotionLimits,
    dead_man: Duration,
    commands: Latest<WORDS>,
    /// Duration of a macrostep, s.
    macrostep: f64,
}

/// Progress of a [`Jog`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JogMemory {
    /// Number of the last command.
    number: u64,
    /// Time of the image in which the last command was found; `None` before the first one of the motion.
    found: Option<Instant>,
}

impl Jog {
    /// A jog of all joints of an arm, and the handle of its operator. `limits.max_jerk` has no effect.
    pub fn new(arm: Arm, limits: MotionLimits, dead_man: Duration) -> Result<(Self, JogHandle), GeneratorError> {
        limits.check(arm.axes())?;
        let (publisher, commands) = latest([0; WORDS]);
        Ok((Self { arm, limits, dead_man, commands, macrostep: 0.0 }, JogHandle { publisher, number: 0 }))
    }

    fn command(&self) -> (u64, JogCommand) {
        let [number, kind, values @ ..] = self.commands.read();
        let values = values.map(f64::from_bits);
        let command = match kind {
            JOINTS => JogCommand::Joints(values),
            TOOL => {
                let [x, y, z, around_x, around_y, around_z, ..] = values;
                let angular = Vector3::new(around_x, around_y, around_z);
                JogCommand::Tool { linear: Vector3::new(x, y, z), angular }
            }
            // Before the first command the joints stand.
            _ if number == 0 => JogCommand::Joints(Axes::default()),
            _ => JogCommand::End,
        };
        (number, command)
    }

    /// Velocities of the joints for a command, within their limits.
    fn velocities(&self, command: JogCommand, e: &EffectorImage) -> Result<Axes, GeneratorError> {
        let velocity = match command {
            JogCommand::Joints(velocity) => velocity,
            JogCommand::Tool { linear, angular } => self.following(linear, angular, e)?,
            JogCommand::End => Axes::default(),
        };
        let axes = self.arm.axes();
        let times = (0..axes).map(|axis| velocity[axis].abs() / self.limits.max_velocity[axis]).fold(1.0, f64::max);
        Ok(std::array::from_fn(|axis| if axis < axes { velocity[axis] / times } else { 0.0 }))
    }

    /// Velocities of the joints for a velocity of the tool in its own frame.
    fn following(
        &self,
        linear: Vector3<f64>,
        angular: Vector3<f64>,
        e: &EffectorImage,
    ) -> Result<Axes, GeneratorError> {
        let tool = &e.commanded.pose;
        let (linear, angular) = (tool.rotation * linear, tool.rotation * angular);
        let robot = self.arm.robot();
        let joints = Joints::new(&e.commanded.joints.position[..self.arm.axes()]).expect("at most eight axes");
        let flange = robot.forward(&joints).map_err(GeneratorError::Image)?;
        let linear = linear - angular.cross(&(tool.translation.vector - flange.translation.vector));
        let twist = Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z);
        let jacobian = robot.jacobian(&joints).map_err(GeneratorError::Image)?;
        let damped = jacobian * jacobian.transpose() + Matrix6::identity() * DAMPING.powi(2);
        // The damped matrix is positive definite if the Jacobian is finite.
        let solved = damped.cholesky().ok_or(GeneratorError::NoProfile)?.solve(&twist);
        Ok((jacobian.transpose() * solved).into())
    }

    /// State after one macrostep towards the greatest fraction of a velocity from which a stop stays within all ranges.
    fn towards(&self, velocity: &Axes, from: &AxesState) -> AxesState {
        let fractions = (1..=FRACTIONS).rev().map(|parts| f64::from(parts) / f64::from(FRACTIONS));
        let mut states = fractions.map(|fraction| self.accelerated(&velocity.map(|v| v * fraction), from));
        let permitted = states.find(|state| self.arm.motors(&self.stop_from(state)).is_ok());
        permitted.unwrap_or_else(|| self.braked(from))
    }

    /// State after one macrostep of constant acceleration towards a velocity.
    fn accelerated(&self, velocity: &Axes, from: &AxesState) -> AxesState {
        let change = |axis: usize| {
            let most = self.limits.max_acceleration[axis] * self.macrostep;
            from.velocity[axis] + (velocity[axis] - from.velocity[axis]).clamp(-most, most)
        };
        let axes = self.arm.axes();
        self.after(from, std::array::from_fn(|axis| if axis < axes { change(axis) } else { 0.0 }))
    }

    /// State after one macrostep of a stop in which all joints keep their proportion, and come to rest together.
    fn braked(&self, from: &AxesState) -> AxesState {
        let left = (1.0 - self.macrostep / self.braking_time(from)).max(0.0);
        self.after(from, from.velocity.map(|velocity| velocity * left))
    }

    /// State after one macrostep of constant acceleration to a velocity.
    fn after(&self, from: &AxesState, velocity: Axes) -> AxesState {
        let mean = |axis: usize| (from.velocity[axis] + velocity[axis]) / 2.0;
        AxesState::new(std::array::from_fn(|axis| from.position[axis] + mean(axis) * self.macrostep), velocity)
    }

    /// Shortest time of a stop, s.
    fn braking_time(&self, from: &AxesState) -> f64 {
        let times = (0..self.arm.axes()).map(|axis| from.velocity[axis].abs() / self.limits.max_acceleration[axis]);
        times.fold(0.0, f64::max)
    }

    /// Bound of the position at rest after a stop in whole macrosteps.
    ///
    /// The joints move straight there, with ranges that are convex. After a macrostep of the stop, the bound lies on
    /// the same line and not further away: after a permitted state, a stop is always permitted.
    fn stop_from(&self, state: &AxesState) -> Axes {
        let time = (self.braking_time(state) + self.macrostep) / 2.0;
        std::array::from_fn(|axis| state.position[axis] + state.velocity[axis] * time)
    }
}

impl Generator for Jog {
    type First = ();
    type Every = EffectorImage;
    type Out = ();
    type Memory = JogMemory;

    fn first_step(&mut self, (): &(), macrostep: Duration) -> Result<Next<JogMemory>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        let (number, _) = self.command();
        Ok(Next::remember(JogMemory { number, found: None }))
    }

    fn terminal(&self, _: &JogMemory, e: &EffectorImage) -> bool {
        let (_, command) = self.command();
        command == JogCommand::End && e.commanded.joints.velocity == Axes::default()
    }

    fn next_step(&self, memory: &JogMemory, e: &EffectorImage) -> Result<Next<JogMemory>, GeneratorError> {
        let (number, command) = self.command();
        let found = if number == memory.number { memory.found } else { Some(e.read_at) };
        let held = found.is_some_and(|found| e.read_at.since(found) <= self.dead_man);
        let from = &e.commanded.joints;
        let velocity = if held { self.velocities(command, e)? } else { Axes::default() };
        let state = if velocity == Axes::default() { self.braked(from) } else { self.towards(&velocity, from) };
        Ok(Next::command(Setpoint::Joints(state), JogMemory { number, found }))
    }
}
