//! Position-force control of an arm in each servo cycle.

use std::time::Duration;

use drive::wrench::{WrenchLink, WrenchState, Zeroing};
use nalgebra::{Isometry3, UnitQuaternion, Vector3, Vector6};
use servo::{CycleLaw, LawAxis, LawFault, LawInput, LawOutput, LawParameters, MAX_AXES};
use thiserror::Error;

use super::directions::{Behaviour, Frame, Guard};
use super::resolve;
use crate::force::{Load, SensorMotion, Wrench};
use crate::robot::{Arm, Axes, Joints, KinematicsError, Motors, Pose};
use crate::sensor::{Payload, ZeroedWeight};

/// Speeds from which a compliant direction must move as the law requires: m/s and rad/s. Below, rounding of the
/// mechanism's singular directions is of no effect.
const NOTICEABLE: [f64; 2] = [1e-3, 1e-2];

/// Largest part of the velocity of a compliant direction that the mechanism may lack.
const LACKING: f64 = 0.5;

/// Position-force control of one arm: the law of the [module](super).
///
/// The law keeps the velocity of each direction from cycle to cycle. If the task frame of the next macrostep has other
/// axes, the velocity is expressed in these axes.
///
/// Motors of the arm accelerate and move within the limits of the law. Beyond them, the change of the whole velocity is
/// reduced by one factor, so that the direction of the change stays.
///
/// At a rate of motion time below 1, the approach of a direction in free space is slower by this factor, and a pause
/// stops the approach. Yielding and the force in contact do not depend on the rate
/// ([`velocity_at_rate`](super::velocity_at_rate)).
///
/// The law ends with a fault if the sensor has a fault or no new sample, if a force exceeds its limit, and if the arm
/// cannot make the motion.
#[derive(Debug)]
pub struct PositionForce {
    config: PositionForceConfig,
    sensor: WrenchLink,
    /// Velocity of each direction in the last cycle, m/s and rad/s.
    velocity: Vector6<f64>,
    /// Displacement of the tool from the path in the task frame, m and rad. The first value is the displacement of the
    /// set-points. The integral of the velocity is then added.
    displacement: Vector6<f64>,
    /// Motor velocities of the last cycle, rad/s.
    motor_velocity: Axes,
    frame: Frame,
    touch: Touch,
    /// The load behind the sensor in this motion, including the payload.
    load: Option<Load>,
}

/// Samples in a row beyond the guard.
#[derive(Clone, Copy, Debug, Default)]
struct Touch {
    /// Number of the last sample.
    sample: u64,
    count: u8,
}

/// An arm with its sensor, and the limits of a law.
#[derive(Clone, Debug)]
pub struct PositionForceConfig {
    /// The arm and its tool.
    pub arm: Arm,
    /// Rotation from the axes of the robot's base to axes whose z points upward.
    pub upright_from_base: UnitQuaternion<f64>,
    /// Pose of the sensor's frame at the flange.
    pub flange_from_sensor: Pose,
    /// The load behind the sensor. Its weight, and its inertia by the set-points at the time of the sample
    /// ([`SensorMotion::commanded`]), are subtracted. `None`: the measured wrench is the wrench of the contact.
    pub load: Option<Load>,
    /// Time by which the tool follows its set-points later than by the delay of the drive group.
    pub lag: Duration,
    /// Weight of the load at the last zeroing of the sensor ([`ForceTorque::zeroed_weight`]). The law ends with a fault if
    /// the sensor was not zeroed, or if the weight was not noted. `None`: the sensor is not zeroed, and has no offset.
    ///
    /// [`ForceTorque::zeroed_weight`]: crate::sensor::ForceTorque::zeroed_weight
    pub zeroed: Option<ZeroedWeight>,
    /// The part that the tool carries in addition to `load` ([`ForceTorque::payload`]). A change takes effect at the
    /// beginning of a motion. `None`: no part.
    ///
    /// [`ForceTorque::payload`]: crate::sensor::ForceTorque::payload
    pub payload: Option<Payload>,
    /// Limits of the law.
    pub limits: ForceLimits,
}

/// Limits of a law. All are finite and above 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForceLimits {
    /// Greatest forces along x, y and z, N, and torques about x, y and z, N·m, of the contact in the sensor's frame. A
    /// greater force is a fault.
    pub wrench: [f64; 6],
    /// Greatest age of a sample.
    pub age: Duration,
    /// Greatest speed of each motor beside the planned path, rad/s.
    pub speed: Axes,
    /// Greatest acceleration of each motor beside the planned path, rad/s².
    pub acceleration: Axes,
}

/// Why a law is refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the message says it")]
pub enum PositionForceError {
    /// A limit that is not finite or not above 0. Indices count from 0.
    #[error("{limit} {index} of the force law is {value}, it must be above 0 and finite")]
    Limit { limit: &'static str, index: usize, value: f64 },
}

impl PositionForce {
    /// A law that reads `sensor`.
    pub fn new(config: PositionForceConfig, sensor: WrenchLink) -> Result<Self, PositionForceError> {
        let axes = config.arm.axes();
        let ForceLimits { wrench, age, speed, acceleration } = &config.limits;
        let limits: [(&str, &[f64]); 4] = [
            ("greatest wrench", wrench),
            ("greatest age", &[age.as_secs_f64()]),
            ("greatest speed", &speed[..axes]),
            ("greatest acceleration", &acceleration[..axes]),
        ];
        for (limit, values) in limits {
            if let Some((index, &value)) = values.iter().enumerate().find(|(_, it)| !(it.is_finite() && **it > 0.0)) {
                return Err(PositionForceError::Limit { limit, index, value });
            }
        }
        let load = config.load;
        Ok(Self {
            config,
            sensor,
            velocity: Vector6::zeros(),
            displacement: Vector6::zeros(),
            motor_velocity: [0.0; MAX_AXES],
            frame: Frame::default(),
            touch: Touch::default(),
            load,
        })
    }

    fn step(&mut self, input: &LawInput<'_>, parameters: &LawParameters) -> Result<LawOutput, LawFault> {
        let behaviour = Behaviour::read(parameters)?;
        let axes = self.config.arm.axes();
        let Some(given) = input.axes.get(..axes) else { return Err(LawFault::Unreachable) };
        let robot = self.config.arm.robot();
        let mut here = [0.0; MAX_AXES];
        let places = here.iter_mut().zip(given);
        places.for_each(|(place, axis)| *place = axis.planned.position + axis.displacement);
        let joints = Motors::new(&here[..axes]).ok_or(LawFault::Unreachable)?;
        let joints = robot.joints_from_motors(&joints).map_err(refused)?;
        let base_from_flange = robot.forward(&joints).map_err(refused)?;
        let base_from_tool = base_from_flange * self.config.arm.flange_from_tool();
        let to_base = behaviour.frame.base_from_task(&base_from_tool.rotation);
        if behaviour.frame != self.frame {
            let turn = to_base.inverse() * self.frame.base_from_task(&base_from_tool.rotation);
            (self.velocity, self.displacement) = (turned(&turn, &self.velocity), turned(&turn, &self.displacement));
            self.frame = behaviour.frame;
        }
        let base_from_task = Isometry3::from_parts(base_from_tool.translation, to_base);
        let state = self.sensor.read();
        let force = self.contact(&state, input, &base_from_flange, &base_from_task)?;
        if behaviour.guard.is_some_and(|guard| self.touch.counts(&guard, state.samples, &force)) {
            return Ok(LawOutput::Touched);
        }

        let wanted = Vector6::from_fn(|i, _| {
            behaviour.gains[i].velocity(self.velocity[i], self.displacement[i], force[i], input.rate, input.period)
        });
        let jacobian = robot.jacobian(&joints).map_err(refused)?;
        let lever = base_from_tool.translation.vector - base_from_flange.translation.vector;
        let jacobian = resolve::at_tool(&jacobian, &lever);
        let rates = resolve::joint_velocities(&jacobian, &turned(&to_base, &wanted)).ok_or(LawFault::NotFinite)?;
        let made = turned(&to_base.inverse(), &(jacobian * rates));
        for i in 0..6 {
            let noticeable = wanted[i].abs() > NOTICEABLE[i / 3];
            if noticeable && (made[i] - wanted[i]).abs() > LACKING * wanted[i].abs() {
                return Err(LawFault::Unreachable);
            }
        }
        let mut next = joints;
        next.iter_mut().zip(&rates).for_each(|(joint, rate)| *joint += rate * input.period);
        let motors = motors_at(&self.config.arm, &next)?;
        let motor_wanted: Axes =
            std::array::from_fn(|axis| if axis < axes { (motors[axis] - here[axis]) / input.period } else { 0.0 });
        let share = self.share(&motor_wanted, input.period);

        self.velocity += share * (wanted - self.velocity);
        self.displacement += self.velocity * input.period;
        let mut displacements = [0.0; MAX_AXES];
        for axis in 0..axes {
            let last = self.motor_velocity[axis];
            self.motor_velocity[axis] += share * (motor_wanted[axis] - last);
            displacements[axis] = given[axis].displacement + self.motor_velocity[axis] * input.period;
        }
        Ok(LawOutput::Displacement(displacements))
    }

    /// Force and torque that the tool applies to its environment, in the task frame.
    fn contact(
        &self,
        state: &WrenchState,
        input: &LawInput<'_>,
        base_from_flange: &Pose,
        base_from_task: &Pose,
    ) -> Result<[f64; 6], LawFault> {
        if let Some(fault) = state.fault {
            return Err(LawFault::Sensor(fault));
        }
        let (age, limit) = (input.now.since(state.sampled), self.config.limits.age);
        if age > limit {
            return Err(LawFault::Silent { age: age.as_secs_f64(), limit: limit.as_secs_f64() });
        }
        let base_from_sensor = base_from_flange * self.config.flange_from_sensor;
        let measured = Wrench::from_components(state.wrench);
        let zero = self.config.zeroed.as_ref().map_or(Ok(Wrench::default()), |weight| noted(weight, state.zeroing))?;
        let orientation = self.config.upright_from_base * base_from_sensor.rotation;
        let of_load = match &self.load {
            None => Wrench::default(),
            Some(load) => {
                let PositionForceConfig { arm, flange_from_sensor, lag, .. } = &self.config;
                let time = state.sampled;
                let motion = SensorMotion::commanded(arm, flange_from_sensor, orientation, input.trail, time, *lag);
                load.wrench(&motion.map_err(refused)?)
            }
        };
        let contact = measured + zero - of_load;
        let components = contact.components();
        for (channel, (value, limit)) in components.into_iter().zip(self.config.limits.wrench).enumerate() {
            if value.is_nan() || value.abs() > limit {
                return Err(LawFault::Exceeded { channel: channel as u8, value, limit });
            }
        }
        // The sensor measures what the environment does to the tool.
        Ok(contact.seen_from(&(base_from_task.inverse() * base_from_sensor)).components().map(|component| -component))
    }

    /// Displacement of the tool from the path that follows from the displacements of the motors, in the task frame, m
    /// and rad.
    fn kept_displacement(&self, input: &LawInput<'_>) -> Result<Vector6<f64>, LawFault> {
        let axes = self.config.arm.axes();
        let Some(given) = input.axes.get(..axes) else { return Err(LawFault::Unreachable) };
        if given.iter().all(|axis| axis.displacement == 0.0) {
            return Ok(Vector6::zeros());
        }
        let tool = |place: fn(&LawAxis) -> f64| {
            let mut motors = [0.0; MAX_AXES];
            motors.iter_mut().zip(given).for_each(|(motor, axis)| *motor = place(axis));
            let arm = &self.config.arm;
            arm.joints(&motors).and_then(|joints| arm.forward(&joints)).map_err(refused)
        };
        let path = tool(|axis| axis.planned.position)?;
        let here = tool(|axis| axis.planned.position + axis.displacement)?;
        let shift = here.translation.vector - path.translation.vector;
        let turn = (here.rotation * path.rotation.inverse()).scaled_axis();
        let in_base = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
        Ok(turned(&self.frame.base_from_task(&here.rotation).inverse(), &in_base))
    }

    /// Part of the change to the motor velocities `wanted` that keeps all limits, 0 to 1.
    fn share(&self, wanted: &Axes, dt: f64) -> f64 {
        let mut share = 1.0_f64;
        let limits = &self.config.limits;
        for (axis, (wanted, last)) in wanted.iter().zip(self.motor_velocity).enumerate().take(self.config.arm.axes()) {
            let change = wanted - last;
            let room = (limits.speed[axis] - last * change.signum()).max(0.0);
            let most = (limits.acceleration[axis] * dt).min(room);
            if change.abs() > most {
                share = share.min(most / change.abs());
            }
        }
        share
    }
}

impl CycleLaw for PositionForce {
    fn check(&self, parameters: &LawParameters) -> Result<(), LawFault> {
        Behaviour::read(parameters).map(drop)
    }

    fn keeps(&self, parameters: &LawParameters) -> bool {
        Behaviour::read(parameters).is_ok_and(|behaviour| behaviour.has_spring())
    }

    fn begin(&mut self, input: &LawInput<'_>, parameters: &LawParameters) {
        self.velocity = Vector6::zeros();
        self.motor_velocity = [0.0; MAX_AXES];
        self.frame = Behaviour::read(parameters).map(|behaviour| behaviour.frame).unwrap_or_default();
        self.touch = Touch::default();
        if let Some(payload) = &self.config.payload {
            let load = payload.take(&self.config.load.unwrap_or_default());
            self.load = (!load.is_none()).then_some(load);
        }
        // A posture without a pose of the tool ends the motion in `shift`.
        self.displacement = self.kept_displacement(input).unwrap_or_else(|_| Vector6::zeros());
    }

    fn shift(&mut self, input: &LawInput<'_>, parameters: &LawParameters) -> LawOutput {
        self.step(input, parameters).unwrap_or_else(LawOutput::Fault)
    }
}

impl Touch {
    /// Whether the force, in sample number `sample`, is beyond the guard in enough samples in a row.
    fn counts(&mut self, guard: &Guard, sample: u64, force: &[f64; 6]) -> bool {
        if sample != self.sample {
            let [fx, fy, fz, tx, ty, tz] = *force;
            let (force, torque) = (Vector3::new(fx, fy, fz).norm(), Vector3::new(tx, ty, tz).norm());
            let beyond = force > guard.force || torque > guard.torque;
            (self.sample, self.count) = (sample, if beyond { self.count.saturating_add(1) } else { 0 });
        }
        self.count >= guard.samples
    }
}

/// The weight at the last zeroing, whose zero is still valid.
fn noted(weight: &ZeroedWeight, zeroing: Zeroing) -> Result<Wrench, LawFault> {
    let Zeroing::Done { request, .. } = zeroing else {
        return Err(LawFault::NotZeroed);
    };
    let (noted, weight) = weight.read();
    if noted == request.number() { Ok(weight) } else { Err(LawFault::NoWeight { request: request.number() }) }
}

/// Linear and angular part, both turned.
fn turned(rotation: &UnitQuaternion<f64>, twist: &Vector6<f64>) -> Vector6<f64> {
    let linear = rotation * Vector3::from(twist.fixed_rows::<3>(0));
    let angular = rotation * Vector3::from(twist.fixed_rows::<3>(3));
    Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
}

fn motors_at(arm: &Arm, joints: &Joints) -> Result<Motors, LawFault> {
    arm.robot().motors_from_joints(joints).map_err(refused)
}

fn refused(error: KinematicsError) -> LawFault {
    match error {
        KinematicsError::NotFinite => LawFault::NotFinite,
        _ => LawFault::Unreachable,
    }
}
