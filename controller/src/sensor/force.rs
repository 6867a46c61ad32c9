//! A force/torque sensor between flange and tool as a virtual sensor.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use can::Instant;
use drive::Word;
use drive::wrench::{WrenchAxis, WrenchFault, WrenchLink, WrenchState, ZeroRequest};
use nalgebra::{UnitQuaternion, Vector3};
use servo::{Latest, Phase, Snapshot};
use thiserror::Error;

use super::payload::{Payload, PayloadPublisher, payload};
use super::zeroed_weight::{WeightPublisher, ZeroedWeight, zeroed_weight};
use super::{VirtualSensor, try_lock};
use crate::force::{Load, LoadError, SensorMotion, Wrench};
use crate::generator::{GeneratorError, SensorReading};
use crate::robot::{Arm, KinematicsError, Pose};

/// Why a force sensor has no contact wrench.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ForceError {
    /// The sensor, its line or its bus has a fault.
    #[error("{0}")]
    Sensor(WrenchFault),
    /// The orientation of the sensor is unknown, and with it the weight of the tool.
    #[error("the weight of the tool and other frames need a homed robot: home the robot first")]
    NotHomed,
    /// The robot measures positions that its mechanism cannot take.
    #[error("the orientation of the sensor is unknown: {0}")]
    Orientation(KinematicsError),
    /// The set-points of the robot give no acceleration of the tool.
    #[error("the acceleration of the tool is unknown: {0}")]
    Acceleration(KinematicsError),
    /// Another thread reads the sensor at this moment.
    #[error("another thread reads the sensor: read again")]
    Busy,
    /// The robot moves during a zeroing.
    #[error("not zeroed, the robot moves: zero the sensor while the robot stands still")]
    Moving,
    /// The reading before a zeroing is not that of an unloaded tool.
    #[error(
        "not zeroed, {axis} reads {value:.2} {} besides the weight of the tool, at most {limit:.2}: remove the contact, or check \
         the mass of the tool",
        unit(*.axis)
    )]
    Offset {
        /// Channel of the sensor.
        axis: WrenchAxis,
        /// Reading without the load of the tool, N or N·m.
        value: f64,
        /// Greatest reading of an unloaded tool, N or N·m.
        limit: f64,
    },
    /// The reading changed during a zeroing.
    #[error("not zeroed, {axis} changed: let the robot stand still and without contact")]
    Unsteady {
        /// Channel of the sensor.
        axis: WrenchAxis,
    },
    /// The sensor still reads a load after its bias command.
    #[error("not zeroed, {axis} is loaded after the bias command: unload the tool, check the sensor")]
    NotBiased {
        /// Channel of the sensor.
        axis: WrenchAxis,
    },
    /// The robot moves while its payload is to change.
    #[error("payload not changed, the robot moves: change the payload between two motions")]
    PayloadInMotion,
    /// A mass or a centre that no load has.
    #[error("payload not changed, {0}: give a mass from 0 on, and its centre in the frame of the sensor")]
    Payload(LoadError),
    /// The weight of tool and payload saturates a channel.
    #[error(
        "payload not changed, the weight of the tool with {mass} kg can load {axis} by {value:.2} {}, and its range is \
         {limit:.2}: check mass and centre of the payload",
        unit(*.axis)
    )]
    PayloadRange {
        /// Mass of the payload, kg.
        mass: f64,
        /// Channel of the sensor.
        axis: WrenchAxis,
        /// Greatest reading by the weight, N or N·m.
        value: f64,
        /// Range of the channel, N or N·m.
        limit: f64,
    },
    /// The driver did not complete a zeroing.
    #[error("not zeroed within {waited:?}: read the fault of the sensor")]
    NotZeroed {
        /// Time since the request.
        waited: Duration,
    },
}

fn unit(axis: WrenchAxis) -> &'static str {
    match axis {
        WrenchAxis::Fx | WrenchAxis::Fy | WrenchAxis::Fz => "N",
        WrenchAxis::Tx | WrenchAxis::Ty | WrenchAxis::Tz => "N·m",
    }
}

/// Commanded velocity of a motor up to which the motor stands still, rad/s.
const STANDSTILL: f64 = 1e-6;

/// Reading of a force/torque sensor: the contact wrench on the tool, without weight and inertia of the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForceReading {
    contact: Result<Wrench, ForceError>,
    tool_from_sensor: Pose,
    /// Frame of the sensor in the frame of the robot's base at the last servo cycle.
    base_from_sensor: Result<Pose, ForceError>,
}

impl SensorReading for ForceReading {}

impl ForceReading {
    /// The contact wrench in the frame of the sensor.
    pub fn in_sensor(&self) -> Result<Wrench, GeneratorError> {
        self.contact.map_err(GeneratorError::Force)
    }

    /// The contact wrench in the frame of the tool: the torques are about the origin of the tool.
    pub fn in_tool(&self) -> Result<Wrench, GeneratorError> {
        Ok(self.in_sensor()?.seen_from(&self.tool_from_sensor))
    }

    /// The contact wrench in the frame of the robot's base: the torques are about the origin of the base. Fails on a robot
    /// that is not homed.
    pub fn in_base(&self) -> Result<Wrench, GeneratorError> {
        self.in_frame(&Pose::identity())
    }

    /// The contact wrench in a frame at rest, given in the frame of the robot's base: the torques are about the origin of
    /// the given frame. Fails on a robot that is not homed.
    pub fn in_frame(&self, base_from_frame: &Pose) -> Result<Wrench, GeneratorError> {
        let base_from_sensor = self.base_from_sensor.map_err(GeneratorError::Force)?;
        Ok(self.in_sensor()?.seen_from(&(base_from_frame.inverse() * base_from_sensor)))
    }
}

/// Place and load of a force/torque sensor at a robot.
#[derive(Clone, Debug)]
pub struct ForceSensorConfig {
    /// The robot and its tool.
    pub arm: Arm,
    /// Rotation from the axes of the robot's base to axes whose z points upward.
    pub upright_from_base: UnitQuaternion<f64>,
    /// Frame of the sensor in the frame of the flange.
    pub flange_from_sensor: Pose,
    /// Load of all parts that are mounted on the tool side of the sensor.
    pub load: Load,
    /// Ranges of all channels, N and N·m, which bound the weight of tool and payload.
    pub range: [f64; 6],
    /// Time by which the tool follows its set-points later than by the delay of the drive group.
    pub lag: Duration,
    /// Greatest absolute reading of each channel before a zeroing, without the load of the tool, N and N·m
    /// ([`ForceTorque::can_be_zeroed`]).
    pub max_offset: [f64; 6],
}

/// A force/torque sensor at the flange of a robot. Clones read the same sensor and have the same zero.
///
/// A reading is the wrench of the last sample, minus the weight of the tool in the orientation of the last servo cycle, and
/// minus the inertial wrench of the tool. The time of the reading is that of the sample, one servo period or more before.
///
/// # Inertia
/// The accelerations are those of the set-points that the drives execute at the time of the sample
/// ([`SensorMotion::commanded`]). The drives execute a set-point later than the servo sends it, by the delay of the drive
/// group plus [`ForceSensorConfig::lag`]. A jerk *j* of the tool leaves an error of mass times *j* times the error of the lag. Vibrations of the arm, and motions
/// that are not commanded, for example a collision, read as forces of the tool. A sample older than 14 periods is compensated
/// with the set-points of 14 periods before the last cycle. A load of [`Load::of_weight`] is a point mass: its angular
/// acceleration has no moment of its own.
///
/// A reading of a sensor with a fault is an error ([`ForceReading::in_sensor`]).
#[derive(Clone, Debug)]
pub struct ForceTorque {
    link: WrenchLink,
    robot: Latest,
    config: Arc<ForceSensorConfig>,
    tool_from_sensor: Pose,
    zero: Arc<Mutex<Zero>>,
    zeroed_weight: ZeroedWeight,
    payload_publisher: Arc<Mutex<PayloadPublisher>>,
    payload: Payload,
}

/// Weight of the tool at the last zeroing, which the readings of the driver no longer contain.
#[derive(Debug)]
struct Zero {
    request: Option<ZeroRequest>,
    weight: Wrench,
    publisher: WeightPublisher,
}

impl Zero {
    fn note(&mut self, request: Option<ZeroRequest>, weight: Wrench) {
        (self.request, self.weight) = (request, weight);
        self.publisher.publish(request.map_or(0, ZeroRequest::number), &weight);
    }
}

impl ForceTorque {
    /// The sensor of `link` at the robot whose states `robot` reads.
    pub fn new(link: WrenchLink, robot: Latest, config: ForceSensorConfig) -> Self {
        let tool_from_sensor = config.arm.flange_from_tool().inverse() * config.flange_from_sensor;
        let (publisher, zeroed_weight) = zeroed_weight();
        let zero = Zero { request: None, weight: Wrench::default(), publisher };
        let zero = Arc::new(Mutex::new(zero));
        let (publisher, payload) = payload();
        let payload_publisher = Arc::new(Mutex::new(publisher));
        let config = Arc::new(config);
        Self { link, robot, config, tool_from_sensor, zero, zeroed_weight, payload_publisher, payload }
    }

    /// The words that a cycle law takes from this sensor.
    pub fn words(&self) -> Vec<Word> {
        let word = |(index, taken): (usize, &Arc<AtomicU64>)| {
            let (zero, all) = (Arc::clone(&self.zero), self.zeroed_weight.taken().clone());
            let repeat = move |value| {
                let mut words = all.each_ref().map(|word| word.load(Ordering::Relaxed));
                words[index] = value;
                // The law takes the words in the next cycle; the words set before are kept until then.
                all[index].store(value, Ordering::Relaxed);
                zero.lock().unwrap_or_else(PoisonError::into_inner).publisher.repeat(&words);
            };
            Word { taken: Arc::clone(taken), repeat: Box::new(repeat) }
        };
        self.zeroed_weight.taken().iter().enumerate().map(word).collect()
    }

    /// The words of the payload that a cycle law takes from this sensor.
    pub fn payload_words(&self) -> Vec<Word> {
        let word = |(index, taken): (usize, &Arc<AtomicU64>)| {
            let (publisher, all) = (Arc::clone(&self.payload_publisher), self.payload.taken().clone());
            let repeat = move |value| {
                let mut words = all.each_ref().map(|word| word.load(Ordering::Relaxed));
                words[index] = value;
                all[index].store(value, Ordering::Relaxed);
                publisher.lock().unwrap_or_else(PoisonError::into_inner).repeat(&words);
            };
            Word { taken: Arc::clone(taken), repeat: Box::new(repeat) }
        };
        self.payload.taken().iter().enumerate().map(word).collect()
    }

    /// The payload, for a [cycle law](crate::law::PositionForce).
    pub fn payload(&self) -> Payload {
        self.payload.clone()
    }

    /// Changes the part that the tool carries in addition to the load of the [configuration](ForceSensorConfig::load):
    /// a point mass, kg, with its centre in the frame of the sensor, m. A mass of 0 removes the part. The robot must
    /// not be in motion. Readings follow at once, and a cycle law follows at the beginning of its next motion. A
    /// zeroing stays valid.
    pub fn set_payload(&self, mass: f64, centre: Vector3<f64>) -> Result<(), ForceError> {
        let part = Load::of_weight(mass, centre).map_err(ForceError::Payload)?;
        let whole = self.config.load.carrying(&part).greatest_weight();
        for ((axis, value), limit) in WrenchAxis::ALL.into_iter().zip(whole).zip(self.config.range) {
            if mass > 0.0 && (value.is_nan() || value >= limit) {
                return Err(ForceError::PayloadRange { mass, axis, value, limit });
            }
        }
        if matches!(self.robot.read().phase, Phase::Moving | Phase::Stopping) {
            return Err(ForceError::PayloadInMotion);
        }
        let centre = if mass > 0.0 { centre } else { Vector3::zeros() };
        self.payload_publisher.lock().unwrap_or_else(PoisonError::into_inner).publish(mass, &centre);
        Ok(())
    }

    /// The weight of the tool at the last zeroing that this sensor or a clone has read, for a
    /// [cycle law](crate::law::PositionForce).
    pub fn zeroed_weight(&self) -> ZeroedWeight {
        self.zeroed_weight.clone()
    }

    /// The link to the driver.
    pub fn link(&self) -> &WrenchLink {
        &self.link
    }

    /// The wrench that the weight of the tool puts on the sensor in the orientation of the last servo cycle, in the frame
    /// of the sensor.
    pub fn weight(&self) -> Result<Wrench, ForceError> {
        self.weight_in(&self.base_from_sensor(&self.robot.read()))
    }

    /// The wrench that weight and inertia of the tool put on the sensor, in the frame of the sensor: orientation of the
    /// last servo cycle, accelerations of the set-points at `time`.
    pub fn load(&self, time: Instant) -> Result<Wrench, ForceError> {
        self.load_at(time, &self.base_from_sensor(&self.robot.read()))
    }

    /// Whether a reading may become the zero. `contact` is the contact wrench before the zeroing, averaged over a time in which
    /// the arm vibrates at rest, and relative to the last zero if there is one. The wrench is at most the greatest offset of
    /// an unloaded sensor ([`ForceError::Offset`]). A greater wrench is a contact, or the weight of another tool.
    pub fn can_be_zeroed(&self, contact: &Wrench) -> Result<(), ForceError> {
        let channels = WrenchAxis::ALL.into_iter().zip(contact.components()).zip(self.config.max_offset);
        for ((axis, value), limit) in channels {
            if value.is_nan() || value.abs() > limit {
                return Err(ForceError::Offset { axis, value, limit });
            }
        }
        Ok(())
    }

    /// Whether a zeroing can begin or go on: the robot stands still.
    pub fn stands_still(&self) -> Result<(), ForceError> {
        let robot = self.robot.read();
        let moves = robot.commanded_velocity.iter().any(|velocity| velocity.abs() > STANDSTILL);
        if moves { Err(ForceError::Moving) } else { Ok(()) }
    }

    /// The present reading and the time of its sample; `None` while another thread notes a zero.
    pub fn read(&self) -> Option<(Instant, ForceReading)> {
        let state = self.link.read();
        let mut zero = try_lock(&self.zero)?;
        let robot = self.robot.read();
        let base_from_sensor = self.base_from_sensor(&robot);
        let contact = self.contact(&state, &base_from_sensor, &mut zero);
        Some((state.sampled, ForceReading { contact, tool_from_sensor: self.tool_from_sensor, base_from_sensor }))
    }

    fn contact(
        &self,
        state: &WrenchState,
        base_from_sensor: &Result<Pose, ForceError>,
        zero: &mut Zero,
    ) -> Result<Wrench, ForceError> {
        if let Some(fault) = state.fault {
            return Err(ForceError::Sensor(fault));
        }
        if state.zeroed != zero.request {
            // The robot stands still until the zeroing is done. A bring-up ends the zero of the driver.
            let weight = state.zeroed.map_or(Ok(Wrench::default()), |_| self.weight_in(base_from_sensor))?;
            zero.note(state.zeroed, weight);
        }
        Ok(Wrench::from_components(state.wrench) + zero.weight - self.load_at(state.sampled, base_from_sensor)?)
    }

    fn load_at(&self, time: Instant, base_from_sensor: &Result<Pose, ForceError>) -> Result<Wrench, ForceError> {
        let ForceSensorConfig { arm, flange_from_sensor, upright_from_base, load, lag, .. } = &*self.config;
        let load = self.payload.added_to(load);
        if load.is_none() {
            return Ok(Wrench::default());
        }
        let orientation = upright_from_base * (*base_from_sensor)?.rotation;
        let motion = SensorMotion::commanded(arm, flange_from_sensor, orientation, &self.robot.trail(), time, *lag);
        Ok(load.wrench(&motion.map_err(ForceError::Acceleration)?))
    }

    fn weight_in(&self, base_from_sensor: &Result<Pose, ForceError>) -> Result<Wrench, ForceError> {
        let ForceSensorConfig { upright_from_base, load, .. } = &*self.config;
        let load = self.payload.added_to(load);
        if load.is_none() {
            return Ok(Wrench::default());
        }
        let orientation = upright_from_base * (*base_from_sensor)?.rotation;
        Ok(load.wrench(&SensorMotion::at_rest(orientation)))
    }

    fn base_from_sensor(&self, robot: &Snapshot) -> Result<Pose, ForceError> {
        let ForceSensorConfig { arm, flange_from_sensor, .. } = &*self.config;
        if !robot.homed {
            return Err(ForceError::NotHomed);
        }
        let joints = arm.joints(&robot.measured).map_err(ForceError::Orientation)?;
        let base_from_tool = arm.forward(&joints).map_err(ForceError::Orientation)?;
        Ok(base_from_tool * arm.flange_from_tool().inverse() * flange_from_sensor)
    }
}

impl VirtualSensor for ForceTorque {
    type Reading = ForceReading;
    type Command = ();

    fn poll(&mut self, _: Instant) -> Option<(Instant, ForceReading)> {
        self.read()
    }
}

#[cfg(test)]
mod tests;
