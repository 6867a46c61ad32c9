//! Tests of the virtual force/torque sensor: weight, frames, zeroing and motion of the tool.

use drive::wrench::RehearsedWrench;
use nalgebra::Vector3;
use servo::{Trail, latest};

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
        range: [65.0, 65.0, 130.0, 5.0, 5.0, 5.0],
        lag: Duration::ZERO,
        max_offset: [12.0, 12.0, 12.0, 1.0, 1.0, 1.0],
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
    let (mut publisher, robot) = latest(servo::MAX_AXES);
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
fn a_payload_is_compensated_beside_the_tool_and_keeps_the_zero() {
    let (mut publisher, robot) = latest(servo::MAX_AXES);
    let (mut device, link) = RehearsedWrench::new();
    let config = config();
    let sensor = ForceTorque::new(link.clone(), robot, config.clone());
    let law = sensor.payload();
    let (mass, centre) = (1.5, Vector3::new(0.02, 0.0, 0.18));
    let part = Load::of_weight(mass, centre).unwrap();
    let mut now = Instant::ZERO;
    let mut read = |device: &mut RehearsedWrench, load: Wrench| {
        now += Duration::from_millis(2);
        device.advance(now, load.components());
        sensor.read().unwrap().1.in_sensor().unwrap()
    };
    publisher.publish(&pitched(&config, -0.5));
    let offset = Wrench::from_components([3.0, -5.0, 8.0, 0.1, 0.2, -0.3]);
    let tool = sensor.weight().unwrap();
    read(&mut device, offset + tool);
    link.zero();
    assert!(read(&mut device, offset + tool).force.norm() < 1e-9);
    for pitch in [-0.5, 0.8] {
        publisher.publish(&pitched(&config, pitch));
        sensor.set_payload(0.0, centre).unwrap();
        let orientation = sensor.base_from_sensor(&sensor.robot.read()).unwrap().rotation;
        let weight = part.wrench(&SensorMotion::at_rest(orientation));
        let tool = sensor.weight().unwrap();
        let before = read(&mut device, offset + tool + weight);
        assert!(
            (before - weight).force.norm() < 1e-9 && (before.force.norm() - mass * 9.81).abs() < 1e-9,
            "{before:?}"
        );
        sensor.set_payload(mass, centre).unwrap();
        assert!((sensor.weight().unwrap() - tool - weight).force.norm() < 1e-9);
        let after = read(&mut device, offset + tool + weight);
        assert!(after.force.norm() < 1e-9 && after.torque.norm() < 1e-9, "{pitch}: {after:?}");
        // A law takes the same load.
        assert_eq!(law.take(&config.load), config.load.carrying(&part));
    }
    assert_eq!(sensor.payload_words().len(), 4);
}

#[test]
fn a_payload_out_of_bounds_or_in_motion_is_refused_and_changes_nothing() {
    let (mut publisher, robot) = latest(servo::MAX_AXES);
    let (_device, link) = RehearsedWrench::new();
    let config = config();
    let sensor = ForceTorque::new(link, robot, config.clone());
    publisher.publish(&pitched(&config, -0.5));
    let weight = sensor.weight().unwrap();
    let at = Vector3::new(0.0, 0.0, 0.1);
    let refused = [
        (f64::NAN, at, "mass of NaN kg"),
        (-1.0, at, "mass of -1 kg"),
        (f64::INFINITY, at, "mass of inf kg"),
        (1.0, Vector3::new(0.0, f64::NAN, 0.0), "coordinate of NaN m"),
        (1e3, at, "the weight of the tool with 1000 kg can load Fx by 9829.62 N, and its range is 65.00"),
        (1.0, Vector3::new(3.0, 0.0, 0.0), "can load Ty by "),
    ];
    for (mass, centre, expected) in refused {
        let error = sensor.set_payload(mass, centre).unwrap_err().to_string();
        assert!(error.starts_with("payload not changed, ") && error.contains(expected), "{error}");
    }
    for phase in [Phase::Moving, Phase::Stopping] {
        publisher.publish(&Snapshot { phase, ..pitched(&config, -0.5) });
        assert_eq!(sensor.set_payload(1.0, at), Err(ForceError::PayloadInMotion));
    }
    assert_eq!(sensor.weight().unwrap(), weight);
    publisher.publish(&Snapshot { phase: Phase::Standing, ..pitched(&config, -0.5) });
    assert_eq!(sensor.set_payload(1.0, at), Ok(()));
}

#[test]
fn the_wrench_on_a_turned_arm_is_that_of_the_base_and_of_any_frame_in_it() {
    let (mut publisher, robot) = latest(servo::MAX_AXES);
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
    let (mut publisher, robot) = latest(servo::MAX_AXES);
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
    let (mut publisher, robot) = latest(servo::MAX_AXES);
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

#[test]
fn an_accelerated_tool_reads_no_contact() {
    let (mut publisher, robot) = latest(servo::MAX_AXES);
    let (mut device, link) = RehearsedWrench::new();
    let config = config();
    let sensor = ForceTorque::new(link, robot, config.clone());
    let at = Instant::from_nanos(100_000_000);
    let mut snapshot = pitched(&config, 0.3);
    let joints = |after: f64| {
        let mut joints = [0.0; servo::MAX_AXES];
        joints[..5].copy_from_slice(&[0.2 + 5.0 * after * after, -1.571, 0.1, 0.3 + 3.0 * after * after, 0.4]);
        joints
    };
    (snapshot.at, snapshot.commanded_velocity[0]) = (at, 1.0);
    publisher.publish(&snapshot);
    publisher.publish_trail(&Trail::along(at, 0.002, 3, |after| config.arm.motors(&joints(after)).unwrap()));
    // A sample of the cycle before shows the set-points of 3 cycles before.
    let sampled = Instant::from_nanos(98_000_000);
    let contact = Wrench::from_components([1.0, -2.0, 3.0, 0.1, 0.2, -0.3]);
    device.advance(sampled, (contact + sensor.load(sampled).unwrap()).components());
    let off = sensor.read().unwrap().1.in_sensor().unwrap() - contact;
    assert!(off.force.amax() < 1e-9 && off.torque.amax() < 1e-9, "{off:?}");
    // 0.7 m from the axis of the column, 10 rad/s² accelerate 2 kg by some 7 m/s².
    let inertial = sensor.load(sampled).unwrap() - sensor.weight().unwrap();
    assert!((10.0..25.0).contains(&inertial.force.norm()) && inertial.torque.norm() > 1.0, "{inertial:?}");
    publisher.publish_trail(&Trail::along(at, 0.002, 3, |_| [f64::INFINITY; servo::MAX_AXES]));
    assert!(matches!(sensor.load(sampled), Err(ForceError::Acceleration(_))), "{:?}", sensor.load(sampled));
    publisher.publish_trail(&Trail::along(at, 0.002, 3, |after| [1.0 / after.abs(); servo::MAX_AXES]));
    assert!(matches!(sensor.load(at), Err(ForceError::Acceleration(_))), "{:?}", sensor.load(at));
}

#[test]
fn a_second_bring_up_ends_the_zero_also_if_a_zeroing_fails_with_it() {
    for interrupted in [false, true] {
        let (mut publisher, robot) = latest(servo::MAX_AXES);
        let (mut device, link) = RehearsedWrench::new();
        let config = config();
        let sensor = ForceTorque::new(link.clone(), robot, config.clone());
        publisher.publish(&pitched(&config, -0.5));
        let weight = sensor.weight().unwrap();
        link.zero();
        let read = |device: &mut RehearsedWrench, at: u64| {
            device.advance(Instant::from_nanos(at), weight.components());
            sensor.read().unwrap().1.in_sensor().unwrap()
        };
        let off = read(&mut device, 1);
        assert!(off.force.amax() < 1e-9, "{off:?}");
        assert_eq!(sensor.zeroed_weight().read().0, 1);
        if interrupted {
            link.zero();
        }
        device.restart();
        let off = read(&mut device, 2);
        assert!(off.force.amax() < 1e-9, "{interrupted}: {off:?}");
        assert_eq!(sensor.zeroed_weight().read(), (0, Wrench::default()));
    }
}

#[test]
fn a_contact_or_another_tool_is_not_zeroed() {
    let (mut publisher, robot) = latest(servo::MAX_AXES);
    let (mut device, link) = RehearsedWrench::new();
    let config = config();
    let sensor = ForceTorque::new(link.clone(), robot, config.clone());
    publisher.publish(&pitched(&config, -0.5));
    let weight = sensor.weight().unwrap();
    let can_be_zeroed = |device: &mut RehearsedWrench, contact: [f64; 6]| {
        device.advance(Instant::from_nanos(1), (weight + Wrench::from_components(contact)).components());
        sensor.can_be_zeroed(&sensor.read().unwrap().1.in_sensor().unwrap())
    };
    let offset = [3.0, -5.0, 11.9, 0.9, 0.0, 0.0];
    assert_eq!(can_be_zeroed(&mut device, offset), Ok(()));
    let refused = can_be_zeroed(&mut device, [3.0, -5.0, -25.5, 0.0, 0.0, 0.0]).unwrap_err();
    assert!(matches!(refused, ForceError::Offset { axis: WrenchAxis::Fz, limit: 12.0, .. }), "{refused:?}");
    let expected = "not zeroed, Fz reads -25.50 N besides the weight of the tool, at most 12.00: remove the contact, or check \
                    the mass of the tool";
    assert_eq!(refused.to_string(), expected);
    let twisted = can_be_zeroed(&mut device, [0.0, 0.0, 0.0, 0.0, -1.2, 0.0]).unwrap_err();
    assert!(matches!(twisted, ForceError::Offset { axis: WrenchAxis::Ty, .. }), "{twisted:?}");
    // Later, the change since the last zero counts.
    link.zero();
    assert_eq!(can_be_zeroed(&mut device, offset), Ok(()));
    assert!(can_be_zeroed(&mut device, [3.0, -5.0, 24.0, 0.9, 0.0, 0.0]).is_err());
}
