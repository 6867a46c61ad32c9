//! A force/torque sensor between flange and tool as a virtual sensor.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use can::Instant;
use drive::Word;
use drive::wrench::{WrenchAxis, WrenchFault, WrenchLink, WrenchState, ZeroRequest, Zeroing};
use nalgebra::UnitQuaternion;
use servo::{Latest, Snapshot};
use thiserror::Error;

use super::zeroed_weight::{WeightPublisher, ZeroedWeight, zeroed_weight};
use super::{VirtualSensor, try_lock};
use crate::force::{Load, SensorMotion, Wrench};
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
    /// Another thread reads the sensor at this moment.
    #[error("another thread reads the sensor: read again")]
    Busy,
    /// The robot moves during a zeroing.
    #[error("not zeroed, the robot moves: zero the sensor while the robot stands still")]
    Moving,
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
    /// The driver did not complete a zeroing.
    #[error("not zeroed within {waited:?}: read the fault of the sensor")]
    NotZeroed {
        /// Time since the request.
        waited: Duration,
    },
}

/// Commanded velocity of a motor up to which the motor stands still, rad/s.
const STANDSTILL: f64 = 1e-6;

/// Reading of a force/torque sensor: the contact wrench on the tool, without the weight of the tool.
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
}

/// A force/torque sensor at the flange of a robot. Clones read the same sensor and have the same zero.
///
/// A reading is the wrench of the last sample minus the weight of the tool in the orientation of the last servo cycle. The
/// time of the reading is that of the sample, one servo period or more before. The inertia of the tool is not compensated:
/// an acceleration *a* of the tool reads as a force of its mass times *a*.
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
        Self { link, robot, config: Arc::new(config), tool_from_sensor, zero, zeroed_weight }
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
        let weight = self.weight_in(base_from_sensor)?;
        match state.zeroing {
            // The robot stands still until the zeroing is done.
            Zeroing::Done { request, .. } if zero.request < Some(request) => {
                zero.note(Some(request), weight);
            }
            // A bring-up ends the zero of the driver.
            Zeroing::None if zero.request.is_some() => zero.note(None, Wrench::default()),
            Zeroing::None => {}
            Zeroing::Done { .. } | Zeroing::UnderWay { .. } | Zeroing::Failed { .. } => {}
        }
        Ok(Wrench::from_components(state.wrench) + zero.weight - weight)
    }

    fn weight_in(&self, base_from_sensor: &Result<Pose, ForceError>) -> Result<Wrench, ForceError> {
        let ForceSensorConfig { upright_from_base, load, .. } = &*self.config;
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
mod tests {
    use drive::wrench::RehearsedWrench;
    use nalgebra::Vector3;
    use servo::latest;

    use super::*;
    use crate::robot::{Irb6Parameters, RobotParameters};

    /// Weight of the tool, N.
    const WEIGHT: f64 = 2.0 * 9.81;

    /// A sensor 90 mm beyond the flange of an IRb-6, whose tool points 250 mm further.
    fn config() -> ForceSensorConfig {
        let along_z = |length| Pose::translation(0.0, 0.0, length);
        ForceSensorConfig {
            arm: Arm::new(Irb6Parameters::irb6().robot().unwrap(), along_z(0.25)),
            upright_from_base: UnitQuaternion::identity(),
            flange_from_sensor: along_z(0.09),
            load: Load::of_weight(2.0, Vector3::new(0.0, 0.0, 0.1)).unwrap(),
        }
    }

    /// A homed IRb-6 with this pitch of the wrist, rad.
    fn pitched(config: &ForceSensorConfig, pitch: f64) -> Snapshot {
        let mut joints = [0.0; servo::MAX_AXES];
        joints[..5].copy_from_slice(&[0.2, -1.571, 0.1, pitch, 0.4]);
        Snapshot { homed: true, axes: 5, measured: config.arm.motors(&joints).unwrap(), ..Snapshot::default() }
    }

    fn sum(parts: [[f64; 6]; 3]) -> [f64; 6] {
        std::array::from_fn(|axis| parts.iter().map(|part| part[axis]).sum())
    }

    #[test]
    fn contact_is_read_without_the_weight_of_the_tool_and_the_zero_in_every_orientation() {
        let (mut publisher, robot) = latest();
        let (mut device, link) = RehearsedWrench::new();
        let config = config();
        let sensor = ForceTorque::new(link.clone(), robot, config.clone());
        publisher.publish(&pitched(&config, -0.5));
        let offset = [3.0, -5.0, 8.0, 0.1, 0.2, -0.3];
        let weight = || sensor.weight().unwrap().components();
        assert!((Vector3::from_column_slice(&weight()[..3]).norm() - WEIGHT).abs() < 1e-9);
        let mut now = Instant::ZERO;
        let mut read = |load: [f64; 6]| {
            now += Duration::from_millis(2);
            device.advance(now, load);
            let (at, reading) = sensor.read().unwrap();
            assert_eq!(at, now);
            reading
        };
        // Before the zeroing the offset remains.
        let found = read(sum([offset, weight(), [0.0; 6]])).in_sensor().unwrap().components();
        assert!(found.iter().zip(offset).all(|(found, offset)| (found - offset).abs() < 1e-9), "{found:?}");
        link.zero();
        let contact = [1.0, 2.0, -30.0, 0.4, 0.5, 0.6];
        for (pitch, contact) in [(-0.5, [0.0; 6]), (-0.5, contact), (0.8, [0.0; 6]), (1.2, contact)] {
            publisher.publish(&pitched(&config, pitch));
            let reading = read(sum([offset, weight(), contact]));
            let found = reading.in_sensor().unwrap();
            let off = found - Wrench::from_components(contact);
            assert!(off.force.amax() < 1e-9 && off.torque.amax() < 1e-9, "{pitch}: {found:?}");
            // The origin of the tool is 160 mm beyond that of the sensor.
            let in_tool = reading.in_tool().unwrap();
            let arm = Vector3::new(0.0, 0.0, -0.16);
            assert!((in_tool.force - found.force).amax() < 1e-12);
            assert!((in_tool.torque - found.torque - arm.cross(&found.force)).amax() < 1e-12, "{in_tool:?}");
        }
    }

    #[test]
    fn the_wrench_on_a_turned_arm_is_that_of_the_base_and_of_any_frame_in_it() {
        let (mut publisher, robot) = latest();
        let (mut device, link) = RehearsedWrench::new();
        let config = ForceSensorConfig { load: Load::of_weight(0.0, Vector3::zeros()).unwrap(), ..config() };
        let sensor = ForceTorque::new(link, robot, config.clone());
        // A force of the table on the tip of the tool, upward and sideways, without a torque about the tip.
        let force = Vector3::new(4.0, -1.0, 20.0);
        let mut found = Vec::new();
        for turn in [0.0, 0.7, -1.9] {
            let mut joints = [0.0; servo::MAX_AXES];
            joints[..5].copy_from_slice(&[turn, -1.571, 0.1, 0.9, 0.4]);
            let measured = config.arm.motors(&joints).unwrap();
            let snapshot = Snapshot { homed: true, axes: 5, measured, ..Snapshot::default() };
            publisher.publish(&snapshot);
            let base_from_tool = config.arm.forward(&joints).unwrap();
            let at_tip = Wrench { force: base_from_tool.rotation.inverse() * force, torque: Vector3::zeros() };
            // The tip is 160 mm beyond the sensor.
            let at_sensor = at_tip.seen_from(&Pose::translation(0.0, 0.0, 0.16));
            device.advance(Instant::from_nanos(1), at_sensor.components());
            let (_, reading) = sensor.read().unwrap();
            let tip = base_from_tool.translation.vector;
            let expected = Wrench { force, torque: tip.cross(&force) };
            let in_base = reading.in_base().unwrap();
            let off = in_base - expected;
            assert!(off.force.amax() < 1e-9 && off.torque.amax() < 1e-9, "{turn}: {in_base:?}");
            // About the tip there is no torque, in axes turned by a right angle about z.
            let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
            let at_tip = reading.in_frame(&Pose::from_parts(tip.into(), quarter)).unwrap();
            let turned = Vector3::new(-1.0, -4.0, 20.0);
            assert!((at_tip.force - turned).amax() < 1e-9 && at_tip.torque.amax() < 1e-9, "{turn}: {at_tip:?}");
            found.push(reading.in_tool().unwrap().force);
            publisher.publish(&Snapshot { homed: false, ..snapshot });
            let lost = sensor.read().unwrap().1;
            assert_eq!(lost.in_base(), Err(GeneratorError::Force(ForceError::NotHomed)));
            assert!(lost.in_sensor().is_ok());
        }
        // The same force has other components in the frame of the turned tool.
        assert!((found[0] - found[1]).norm() > 1.0, "{found:?}");
    }

    #[test]
    fn a_moving_robot_does_not_stand_still() {
        let (mut publisher, robot) = latest();
        let (_device, link) = RehearsedWrench::new();
        let config = config();
        let sensor = ForceTorque::new(link, robot, config.clone());
        let mut snapshot = pitched(&config, 0.0);
        publisher.publish(&snapshot);
        assert_eq!(sensor.stands_still(), Ok(()));
        snapshot.commanded_velocity[4] = -0.01;
        publisher.publish(&snapshot);
        assert_eq!(sensor.stands_still(), Err(ForceError::Moving));
    }

    #[test]
    fn a_reading_of_a_robot_that_is_not_homed_is_an_error() {
        let (mut publisher, robot) = latest();
        let (mut device, link) = RehearsedWrench::new();
        let config = config();
        device.advance(Instant::from_nanos(1), [0.0; 6]);
        let sensor = ForceTorque::new(link, robot, config.clone());
        let read = || sensor.read().unwrap().1.in_sensor();
        publisher.publish(&Snapshot { homed: false, ..pitched(&config, 0.0) });
        assert_eq!(read(), Err(GeneratorError::Force(ForceError::NotHomed)));
        publisher.publish(&pitched(&config, 0.0));
        assert!(read().is_ok());
    }
}
