//! Faults and refusals of the law, and the weight of the tool.

use std::f64::consts::PI;

use servo::{LawFault, LawParameters};

use super::*;
use crate::force::{Load, SensorMotion};
use crate::law::directions::Behaviour;
use crate::law::{Guard, PositionForceError};
use crate::robot::{Irb6, Irb6Parameters};
use crate::sensor::ZeroedWeight;

#[test]
fn a_task_is_the_same_after_its_way_through_parameters() {
    let compliance = Compliance { inertia: 3.0, reciprocal_damping: 0.25 };
    let directions = [
        Direction::Unguarded { velocity: 0.5 },
        Direction::Guarded { velocity: -0.5, compliance },
        Direction::Contact { force: 12.0, compliance },
        Direction::Admittance { stiffness: 900.0, compliance },
        Direction::HELD,
        Direction::Contact { force: 0.0, compliance: Compliance::ROTARY },
    ];
    let rotation = Vector3::new(0.1, -0.2, 0.3);
    let guard = Some(Guard { force: 5.0, torque: 0.5, samples: 2 });
    let task = ForceTask { directions, axes: TaskAxes::Base, rotation, guard };
    let read = Behaviour::read(&task.into()).unwrap();
    assert_eq!(read.gains, directions.map(Direction::gains));
    assert_eq!(read.guard, guard);
    let turned = read.frame.base_from_task(&UnitQuaternion::from_euler_angles(1.0, 2.0, 3.0));
    assert!(turned.angle_to(&UnitQuaternion::from_scaled_axis(rotation)) < 1e-12);
    assert_eq!(Behaviour::read(&LawParameters::default()), Behaviour::read(&ForceTask::default().into()));
}

#[test]
fn parameters_out_of_range_are_refused_by_their_number() {
    // Parameter and value.
    let cases = [(0, -1.0), (1, -0.1), (4, -5.0), (6, -0.1), (20, 1.0), (22, 3.0), (30, 1.0), (32, 1.5), (33, 2.0)];
    for (index, value) in cases {
        let mut parameters = LawParameters::from(press(10.0));
        parameters.0[index] = value;
        let found = Behaviour::read(&parameters);
        assert_eq!(found, Err(LawFault::Parameter { index: index as u8, value }), "{index}");
    }
    // A guard needs both thresholds.
    let mut parameters = LawParameters::from(press(10.0));
    parameters.0[32] = 1.0;
    assert_eq!(Behaviour::read(&parameters), Err(LawFault::Parameter { index: 30, value: 0.0 }));
}

#[test]
fn a_law_without_limits_is_refused() {
    type Case = (fn(&mut ForceLimits), &'static str);
    let changes: [Case; 4] = [
        (|limits| limits.wrench[4] = f64::INFINITY, "greatest wrench 4 of the force law is inf"),
        (|limits| limits.age = Duration::ZERO, "greatest age 0 of the force law is 0"),
        (|limits| limits.speed[5] = f64::NAN, "greatest speed 5 of the force law is NaN"),
        (|limits| limits.acceleration[0] = 0.0, "greatest acceleration 0 of the force law is 0"),
    ];
    for (change, expected) in changes {
        let mut limits = WIDE;
        change(&mut limits);
        let flange_from_sensor = flange_from_sensor();
        let config = PositionForceConfig {
            arm: irp6(),
            upright_from_base: UnitQuaternion::identity(),
            flange_from_sensor,
            load: None,
            lag: Duration::ZERO,
            zeroed: None,
            payload: None,
            limits,
        };
        let error: PositionForceError = PositionForce::new(config, RehearsedWrench::new().1).unwrap_err();
        assert_eq!(error.to_string(), format!("{expected}, it must be above 0 and finite"));
    }
}

#[test]
fn a_silent_sensor_ends_the_law_with_the_age_of_its_sample() {
    let mut rig = Rig::new(irp6(), &START, 0.0, 0, WIDE);
    assert_eq!(rig.cycle(&press(10.0), &|_| Vector3::zeros()), None);
    for cycle in 1..=4 {
        let expected = LawFault::Silent { age: 0.008, limit: 0.006 };
        match rig.shift(&press(10.0), T) {
            LawOutput::Displacement(_) => assert!(cycle < 4),
            output => assert_eq!((cycle, output), (4, LawOutput::Fault(expected))),
        }
        rig.cycle += 1;
    }
}

#[test]
fn a_force_beyond_its_limit_ends_the_law_in_its_cycle() {
    let limits = ForceLimits { wrench: [65.0, 65.0, 130.0, 100.0, 100.0, 100.0], ..WIDE };
    let mut rig = Rig::new(irp6(), &START, 0.0, 0, limits);
    let along_x = |rig: &Rig| {
        let flange = rig.tool() * rig.arm.flange_from_tool().inverse();
        (flange * flange_from_sensor()).rotation * Vector3::x()
    };
    for (force, ends) in [(60.0, false), (70.0, true)] {
        rig.forces.push(along_x(&rig) * force);
        rig.sense();
        match rig.shift(&ForceTask::default(), T) {
            LawOutput::Fault(LawFault::Exceeded { channel: 0, value, limit: 65.0 }) => {
                assert!(ends && (value - 70.0).abs() < 1e-9, "{value}");
            }
            output => assert!(!ends, "{output:?}"),
        }
    }
}

#[test]
fn a_direction_that_the_arm_lacks_is_a_fault() {
    // With its tool down, the IRb-6 cannot turn it about the radial direction.
    let arm = Arm::new(Arc::new(Irb6::new(&Irb6Parameters::irb6()).unwrap()), Pose::identity());
    let mut task = ForceTask { axes: TaskAxes::Base, ..ForceTask::default() };
    task.directions[3] = Direction::Contact { force: 1.0, compliance: Compliance::ROTARY };
    let mut rig = Rig::new(arm, &[0.0, -FRAC_PI_2, 0.1, FRAC_PI_2, 0.4, 0.0, 0.0, 0.0], 0.0, 0, WIDE);
    let end = (0..200).find_map(|_| rig.cycle(&task, &|_| Vector3::zeros()));
    assert_eq!(end, Some(LawOutput::Fault(LawFault::Unreachable)));
}

#[test]
fn the_weight_of_the_tool_is_no_contact() {
    let arm = irp6();
    let load = Load::of_weight(1.5, Vector3::new(0.0, 0.01, 0.1)).unwrap();
    let base_from_sensor = arm.forward(&START).unwrap() * arm.flange_from_tool().inverse() * flange_from_sensor();
    let standing = UnitQuaternion::identity();
    let hanging = UnitQuaternion::from_euler_angles(PI, 0.0, 0.0);
    let other = UnitQuaternion::from_euler_angles(0.5, 0.1, 0.0);
    for (upright, zeroed_at) in [(standing, None), (standing, Some(other)), (hanging, None), (hanging, Some(other))] {
        let at_rest = SensorMotion::at_rest(upright * base_from_sensor.rotation);
        let mut rig = Rig::new(arm.clone(), &START, 0.0, 0, WIDE);
        let at_zero = |rotation| load.wrench(&SensorMotion::at_rest(upright * rotation));
        rig.law = {
            let (sensor, link) = RehearsedWrench::new();
            rig.sensor = sensor;
            let zeroed = zeroed_at.map(|rotation| {
                link.zero();
                rig.sensor.advance(rig.now(), at_zero(rotation).components());
                ZeroedWeight::of(1, &at_zero(rotation))
            });
            let flange_from_sensor = flange_from_sensor();
            let config = PositionForceConfig {
                arm: arm.clone(),
                upright_from_base: upright,
                flange_from_sensor,
                load: Some(load),
                lag: Duration::ZERO,
                zeroed,
                payload: None,
                limits: WIDE,
            };
            PositionForce::new(config, link).unwrap()
        };
        rig.sensor.advance(rig.now(), load.wrench(&at_rest).components());
        let directions = [Direction::Contact { force: 0.0, compliance: Compliance::LINEAR }; 6];
        let task = ForceTask { directions, ..ForceTask::default() };
        let LawOutput::Displacement(displacement) = rig.shift(&task, T) else { panic!("no end") };
        assert!(displacement.iter().all(|it| it.abs() < 1e-9), "{displacement:?}");
    }
}

#[test]
fn a_sensor_that_was_not_zeroed_and_a_weight_that_was_not_noted_are_faults() {
    let zeroed_by = |requests: u64, noted: u64| {
        let mut rig = Rig::new(irp6(), &START, 0.0, 0, WIDE);
        let (sensor, link) = RehearsedWrench::new();
        rig.sensor = sensor;
        let config = PositionForceConfig {
            arm: irp6(),
            upright_from_base: UnitQuaternion::identity(),
            flange_from_sensor: flange_from_sensor(),
            load: None,
            lag: Duration::ZERO,
            zeroed: Some(ZeroedWeight::of(noted, &Wrench::default())),
            payload: None,
            limits: WIDE,
        };
        for _ in 0..requests {
            link.zero();
            rig.sensor.advance(rig.now(), [0.0; 6]);
        }
        rig.sensor.advance(rig.now(), [0.0; 6]);
        rig.law = PositionForce::new(config, link).unwrap();
        rig.shift(&ForceTask::default(), T)
    };
    assert_eq!(zeroed_by(0, 0), LawOutput::Fault(LawFault::NotZeroed));
    assert_eq!(zeroed_by(2, 1), LawOutput::Fault(LawFault::NoWeight { request: 2 }));
    assert!(matches!(zeroed_by(2, 2), LawOutput::Displacement(_)));
}
