//! Jog: joints or the tool move at the velocities that an operator commands, as long as commands are repeated.

use std::time::Duration;

use nalgebra::{Matrix6, Vector3, Vector6};

use super::{Axes, AxesState, EffectorImage, Generator, GeneratorError, MotionLimits, Next, Setpoint, V};
use crate::robot::{Arm, Joints};
use crate::sensor::{JogCommand, JogReading};

/// Damping of the inverse Jacobian, in m/s and rad/s per rad/s. A direction of the tool with this singular value
/// moves at half the commanded speed.
const DAMPING: f64 = 0.02;
/// Number of fractions of the commanded velocity that are tried near the end of a range.
const FRACTIONS: u32 = 8;

/// A motion at the velocities of the operator's latest command. Class 3: each step reads the effector and the
/// [`JogPanel`](crate::sensor::JogPanel), a virtual sensor of the agent.
///
/// If the reading is older than the dead-man time, the joints brake. The age is the time of the servo since the cycle in
/// which the panel found the command. The dead-man time must be longer than a macrostep, and longer than the time between
/// two commands. The motion continues with the next command, and ends at rest after [`JogCommand::End`]. A command from
/// before the motion has no effect.
///
/// Velocity and acceleration of each joint stay within the limits: a command beyond a limit is scaled down as a
/// whole. From each set-point, a stop within the ranges of joints and motors is possible: the joints slow down before the
/// end of a range.
///
/// A velocity of the tool is converted by the damped inverse of the Jacobian. Near a singularity the tool slows down,
/// and deviates from its direction where the mechanism cannot follow. No step allocates.
#[derive(Debug)]
pub struct Jog {
    arm: Arm,
    limits: MotionLimits,
    dead_man: Duration,
    /// Duration of a macrostep, s.
    macrostep: f64,
}

impl Jog {
    /// A jog of all joints of an arm. `limits.max_jerk` has no effect.
    pub fn new(arm: Arm, limits: MotionLimits, dead_man: Duration) -> Result<Self, GeneratorError> {
        limits.check(arm.axes())?;
        Ok(Self { arm, limits, dead_man, macrostep: 0.0 })
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
    /// The joints stop along a straight line, and the ranges are convex. After a macrostep of the stop, the bound lies on
    /// the same line and not further away. After a permitted state, a stop is therefore always permitted.
    fn stop_from(&self, state: &AxesState) -> Axes {
        let time = (self.braking_time(state) + self.macrostep) / 2.0;
        std::array::from_fn(|axis| state.position[axis] + state.velocity[axis] * time)
    }
}

impl Generator for Jog {
    type First = V<JogReading>;
    type Every = (EffectorImage, V<JogReading>);
    type Out = ();
    /// Number of the last command before the motion.
    type Memory = u64;

    fn first_step(&mut self, v: &V<JogReading>, macrostep: Duration) -> Result<Next<u64>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        Ok(Next::remember(v.0.sample().map_or(0, |reading| reading.value.number)))
    }

    fn terminal(&self, _: &u64, (e, v): &Self::Every) -> bool {
        let ended = v.0.sample().is_some_and(|reading| reading.value.command == JogCommand::End);
        ended && e.commanded.joints.velocity == Axes::default()
    }

    fn next_step(&self, before: &u64, (e, v): &Self::Every) -> Result<Next<u64>, GeneratorError> {
        let fresh = v.0.younger_than(self.dead_man).ok().filter(|reading| reading.number != *before);
        let velocity = fresh.map_or(Ok(Axes::default()), |reading| self.velocities(reading.command, e))?;
        let from = &e.commanded.joints;
        let state = if velocity == Axes::default() { self.braked(from) } else { self.towards(&velocity, from) };
        Ok(Next::command(Setpoint::Joints(state), *before))
    }
}
