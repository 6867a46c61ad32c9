//! Gravity torques of the links at their motors, and the place of the flange. The tests compare the controller's
//! kinematics with the mechanics of the emulated drives. The two are independent and have only their parameters in
//! common.

use ::mrroc::cell::{Model, Parameters};
use controller::robot::{Joints, Mass, Motors, PolycrankParameters, Robot, Weight};
use hil::plant::{Irp6Axis, Mechanism, MechanismConfig, PlantAxis};
use hil::{AxisConfig, Scene};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Joint positions in the middle of their ranges, different for each `number`. All are within the range of every
/// mechanism.
fn joints(robot: &dyn Robot, number: u32) -> Joints {
    let shares = robot.joint_limits().iter().enumerate().map(|(axis, limits)| {
        let share = 0.5 + 0.4 * (f64::from(number) * (1.3 + axis as f64)).sin();
        let (low, high) = if limits.is_continuous() { (-7.0, 7.0) } else { (limits.low, limits.high) };
        low + share * (high - low)
    });
    Joints::new(&shares.collect::<Vec<_>>()).unwrap()
}

/// A mechanism with its motors at `motors`. The motors are moved there in small steps, as the legs require. `zero` is
/// their position with the mechanism at its own home.
fn posed(config: &MechanismConfig, motors: &[f64], zero: &Motors) -> Mechanism {
    const STEPS: u32 = 20;
    let mechanism = Mechanism::new(config.clone());
    for step in 1..=STEPS {
        let share = f64::from(step) / f64::from(STEPS);
        for (number, (&angle, &zero)) in motors.iter().zip(zero.iter()).enumerate() {
            let axis = AxisConfig { start_angle: zero + share * (angle - zero), ..AxisConfig::wut(Irp6Axis::Column) };
            let mount = mechanism.mount(number, zero).unwrap();
            PlantAxis::mounted(&axis, 1, Some(&mount));
        }
    }
    mechanism
}

/// The mechanism of each robot, and its parameters if they differ from the parameters of the model.
fn mechanisms() -> [(Model, Option<Parameters>, MechanismConfig); 6] {
    let coupled = PolycrankParameters { coupled: true, ..PolycrankParameters::polycrank() };
    let rnt = MechanismConfig::Rnt { home_lengths: [AxisConfig::RNT_HOME_LENGTH; 3] };
    let cranks = |coupled| MechanismConfig::Polycrank { coupled, at_home: [0.0; 7] };
    [
        (Model::Irb6, None, MechanismConfig::Irb6),
        (Model::Irp6, None, MechanismConfig::Irp6),
        (Model::Irp6Track, None, MechanismConfig::Irp6OnTrack),
        (Model::Rnt, None, rnt),
        (Model::Polycrank, None, cranks(false)),
        (Model::Polycrank, Some(Parameters::Polycrank(coupled)), cranks(true)),
    ]
}

/// Motor positions with the mechanism at its own home.
fn home(robot: &dyn Robot, config: &MechanismConfig) -> Motors {
    match config {
        MechanismConfig::Polycrank { .. } => robot.motors_from_joints(&Joints::new(&[0.0; 7]).unwrap()).unwrap(),
        _ => robot.home(),
    }
}

#[test]
fn flange_in_a_scene_is_where_the_kinematics_has_it() {
    for (model, parameters, config) in mechanisms() {
        let robot = parameters.unwrap_or(model.parameters()).kinematics().unwrap();
        let zero = home(&*robot, &config);
        // The base frame of the emulated IRb-6 is at the shoulder, and the base frame of the controller is on the
        // floor. The emulated flange of the RNT is 100 mm beyond the centre of the wrist.
        let base = Translation3::new(0.0, 0.0, if model == Model::Irb6 { 0.7 } else { 0.0 });
        let flange = Translation3::new(0.0, 0.0, if model == Model::Rnt { 0.1 } else { 0.0 });
        let mut poses = 0;
        for number in 0..200 {
            let joints = joints(&*robot, number);
            let Ok(motors) = robot.motors_from_joints(&joints) else {
                continue;
            };
            poses += 1;
            let mechanism = posed(&config, &motors, &zero);
            let up = Vector3::from(mechanism.up());
            let stand = UnitQuaternion::rotation_between(&up, &Vector3::z())
                .unwrap_or(UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
            let stand = Isometry3::from_parts(Translation3::new(1.0, 2.0, 3.0), stand);
            let mut scene = Scene::new();
            let id = scene.add_robot(&mechanism, &stand).unwrap();
            let found = base * stand.inverse() * scene.flange(id);
            let expected = robot.forward(&joints).unwrap() * flange;
            let off = (found.translation.vector - expected.translation.vector).norm();
            let turned = (found.rotation.to_rotation_matrix().into_inner()
                - expected.rotation.to_rotation_matrix().into_inner())
            .norm();
            assert!(off < 1e-6 && turned < 1e-6, "{config:?} at {joints:?}: {found} for {expected}");
        }
        assert!(poses > 50, "{config:?}");
    }
}

#[test]
fn links_weigh_on_motors_what_they_weigh_in_the_emulators() {
    for (model, parameters, config) in mechanisms() {
        let numbers = parameters.unwrap_or(model.parameters());
        let robot = numbers.kinematics().unwrap();
        let zero = home(&*robot, &config);
        let load = Mass { mass: 3.0, centre: [0.02, -0.03, 0.1] };
        // The emulated flange of the RNT is 100 mm beyond the centre of the wrist. The robot's own flange is at the
        // centre.
        let mut carried = load.centre;
        if model == Model::Rnt {
            carried[2] -= 0.1;
        }
        for (load, of_load) in [(Mass::default(), 0.0), (load, load.mass)] {
            let weight = Weight::new(&*robot, &numbers.masses(), load, numbers.up()).unwrap();
            let (mut worst, mut poses) = (0.0_f64, 0);
            for number in 0..200 {
                let joints = joints(&*robot, number);
                let Ok(motors) = robot.motors_from_joints(&joints) else {
                    continue;
                };
                poses += 1;
                let mechanism = posed(&config, &motors, &zero);
                mechanism.set_payload(of_load, carried);
                let found = weight.torque(&*robot, &motors).unwrap();
                for (axis, found) in found.iter().take(robot.axes()).enumerate() {
                    let expected = -mechanism.load(axis).torque;
                    worst = worst.max((found - expected).abs());
                    assert!(
                        (found - expected).abs() < 1e-6,
                        "{config:?} axis {axis} at {joints:?}: {found} for {expected} N·m"
                    );
                }
            }
            println!("{config:?}, load of {of_load} kg: within {worst:.1e} N·m in {poses} poses");
            assert!(poses > 50, "{config:?}");
        }
    }
}
