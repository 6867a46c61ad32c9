//! Refusals of descriptions, and the text of a description.

use super::super::*;
use super::arms;

/// Why a description of seven axes is refused after a change.
fn refusal(change: impl Fn(&mut ChainParameters)) -> ChainError {
    let mut parameters = arms::panda();
    change(&mut parameters);
    match Chain::new(&parameters) {
        Err(ParameterError::Chain(error)) => error,
        other => panic!("{other:?}"),
    }
}

#[test]
fn numbers_that_are_no_arm_are_refused() {
    use ChainError::*;
    let body = LinkBody { mass: 2.0, centre: [0.0; 3], inertia: [0.1, 0.1, 0.1, 0.0, 0.0, 0.0] };
    type Change = fn(&mut ChainParameters);
    let cases: Vec<(Change, ChainError)> = vec![
        (|p| p.joints.clear(), JointCount { given: 0 }),
        (|p| p.joints.extend(p.clone().joints), JointCount { given: 14 }),
        (|p| p.joints[2].name.clear(), NoName { joint: 2 }),
        (|p| p.joints[5].name = "j1".into(), SameName { joint: 5, other: 1 }),
        (|p| p.joints[1].axis = [0.0; 3], NoAxis { joint: 1 }),
        (|p| p.joints[1].axis = [f64::NAN, 0.0, 1.0], NoAxis { joint: 1 }),
        (|p| p.joints[1].ratio = 0.0, NoRatio { joint: 1 }),
        (|p| p.joints[1].ratio = f64::NAN, NotFinite { joint: 1, number: "the ratio" }),
        (|p| p.joints[3].limits.low = f64::NEG_INFINITY, NotFinite { joint: 3, number: "the lower limit" }),
        (|p| p.joints[3].limits = Limits { low: 1.0, high: 1.0 }, EmptyRange { joint: 3, low: 1.0, high: 1.0 }),
        (
            |p| p.joints[4].parent_from_joint.translation.y = f64::NAN,
            NotFinite { joint: 4, number: "parent_from_joint" },
        ),
        (|p| p.joints[4].parent_from_joint.translation.y = -2e3, TooFar { joint: 4, coordinate: 2e3 }),
        (|p| p.joints[4].velocity = Some(0.0), NotPositive { joint: 4, number: "velocity", value: 0.0 }),
        (|p| p.joints[4].effort = Some(f64::INFINITY), NotFinite { joint: 4, number: "effort" }),
        (|p| p.link_from_flange.translation.x = f64::INFINITY, Flange),
        (|p| p.up = [0.0; 3], NoUp),
        (|p| p.free_axis = Some([0.0; 3]), NoFreeAxis),
        (|p| p.motors_from_joints = Some(Vec::new()), RowCount { rows: 0, joints: 7 }),
        (|p| p.motors_from_joints = Some(vec![vec![1.0; 6]; 7]), RowLength { row: 0, columns: 6, joints: 7 }),
        (|p| p.motors_from_joints = Some(vec![vec![1.0; 7]; 7]), NotInvertible),
        (|p| p.motors_from_joints = Some(vec![vec![f64::NAN; 7]; 7]), MatrixNotFinite { row: 0 }),
    ];
    for (change, error) in cases {
        assert_eq!(refusal(change), error);
    }
    let heavy = LinkBody { mass: -1.0, ..body };
    let error = WeightError::Mass { link: 6, mass: -1.0 };
    assert_eq!(refusal(|p| p.joints[6].body = Some(heavy)), Mass { joint: 6, error });
    let far = LinkBody { centre: [0.0, 11.0, 0.0], ..body };
    let error = WeightError::Centre { link: 6, coordinate: 11.0 };
    assert_eq!(refusal(|p| p.joints[6].body = Some(far)), Mass { joint: 6, error });
    let twisted = LinkBody { inertia: [0.1, 0.1, 0.1, 0.2, 0.0, 0.0], ..body };
    assert_eq!(refusal(|p| p.joints[6].body = Some(twisted)), Inertia { joint: 6 });
}

#[test]
fn descriptions_survive_the_cell_file_and_refuse_unknown_names() {
    let mut parameters = arms::panda();
    parameters.joints[2].velocity = Some(2.0);
    parameters.joints[2].body = Some(LinkBody { mass: 2.0, centre: [0.1; 3], inertia: [0.1; 6] });
    parameters.free_axis = Some([0.0, 0.0, 1.0]);
    let text = toml::to_string(&parameters).unwrap();
    assert_eq!(toml::from_str::<ChainParameters>(&text).as_ref(), Ok(&parameters));
    assert!(toml::from_str::<ChainParameters>(&text.replace("velocity", "velocities")).is_err());
    let least = "joints = [{ name = 'a', kind = 'continuous', axis = [0, 0, 2], ratio = 100 }]";
    let chain = Chain::new(&toml::from_str(least).unwrap()).unwrap();
    assert_eq!(chain.joint_limits(), [Limits::CONTINUOUS]);
    assert_eq!(chain.motor_limits(), [Limits { low: -3.35e6, high: 3.35e6 }]);
    assert_eq!(chain.links()[0].axis, Vector3::z_axis());
    let bent = "joints = [{ name = 'a', kind = 'continuous', axis = [0, 0, 2], ratio = 100, \
                parent_from_joint = { quaternion = [1, 1, 0, 0] } }]";
    let error = toml::from_str::<ChainParameters>(bent).unwrap_err().to_string();
    assert!(error.contains("quaternion has the length 1.414, must be a unit quaternion"), "{error}");
}

#[test]
fn numbers_that_place_no_chain_are_refused() {
    let chain = Chain::new(&arms::panda()).unwrap();
    let home = Joints::from([0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0]);
    let pose = chain.forward(&home).unwrap();
    let mut spoilt = home;
    spoilt[1] = f64::NAN;
    let count = KinematicsError::AxisCount { axes: 7, given: 3 };
    for (joints, error) in [(spoilt, KinematicsError::NotFinite), (Joints::from([0.0; 3]), count)] {
        assert_eq!(chain.forward(&joints).unwrap_err(), error);
        assert_eq!(chain.jacobian(&joints).unwrap_err(), error);
        assert_eq!(chain.motors_from_joints(&joints).unwrap_err(), error);
        assert_eq!(chain.joints_from_motors(&Motors::new(&joints).unwrap()).unwrap_err(), error);
        assert_eq!(chain.inverse(&pose, &joints).unwrap_err(), error);
    }
    let mut lost = pose;
    lost.translation.vector.y = f64::NAN;
    assert_eq!(chain.inverse(&lost, &home), Err(KinematicsError::NotFinite));
}

#[test]
fn poses_out_of_reach_are_refused_with_what_is_missing() {
    for (name, parameters) in arms::public() {
        let chain = Chain::new(&parameters).unwrap();
        let mut random = Random(SEED);
        let near = random.joints(&chain);
        let mut pose = chain.forward(&near).unwrap();
        let away = Vector3::new(0.3, 0.4, 1.2).normalize() * 100.0;
        pose.translation.vector += away;
        match chain.inverse(&pose, &near) {
            Err(KinematicsError::Unreachable { margin }) => {
                assert!(margin > 90.0 && margin < 110.0, "{name}: {margin}");
            }
            // The closed form tells where the linear axis would be.
            Err(KinematicsError::BeyondLimit { value, .. }) => assert!(value.abs() > 10.0, "{name}: {value}"),
            other => panic!("{name}: {other:?}"),
        }
    }
    // 1 mm beyond the stretched arm.
    let chain = Chain::new(&arms::named("scara")).unwrap();
    let stretched = Joints::from([0.0, 0.0, 0.1, 0.3]);
    let mut pose = chain.forward(&stretched).unwrap();
    pose.translation.vector.x += 1e-3;
    let refused = chain.inverse(&pose, &stretched);
    // The nearest posture also turns a little, because the flange lies beside the axis of the roll.
    let Err(KinematicsError::Missed { distance, angle }) = refused else { panic!("{refused:?}") };
    assert!((distance - 1e-3).abs() < 1e-5 && angle < 1e-3, "{distance} {angle}");
}

#[test]
fn a_pose_past_a_limit_names_the_joint() {
    for name in ["ur5", "puma560", "kr16", "jaco", "irb6", "scara", "gantry and wrist"] {
        let mut parameters = arms::named(name);
        for (number, joint) in parameters.joints.iter_mut().enumerate() {
            let middle = if joint.kind == LinkKind::Prismatic { 0.2 } else { 0.6 + 0.1 * number as f64 };
            joint.limits = Limits { low: middle - 0.1, high: middle + 0.1 };
            if joint.kind == LinkKind::Continuous {
                joint.kind = LinkKind::Revolute;
            }
        }
        let chain = Chain::new(&parameters).unwrap();
        let middle: Vec<f64> = parameters.joints.iter().map(|joint| joint.limits.low + 0.1).collect();
        for axis in 0..chain.axes() {
            let mut joints = Joints::new(&middle).unwrap();
            joints[axis] += 0.15;
            let pose = chain.forward(&joints).unwrap();
            match chain.inverse(&pose, &joints) {
                Err(KinematicsError::BeyondLimit { space: Space::Joint, axis: named, value, limit }) => {
                    assert_eq!(usize::from(named), axis, "{name}");
                    assert!((value - joints[axis]).abs() < 1e-6 && (limit - value + 0.05).abs() < 1e-6, "{name}");
                }
                other => panic!("{name} axis {axis}: {other:?}"),
            }
        }
    }
}

#[test]
fn an_arm_with_few_axes_tells_how_far_it_misses_a_pose() {
    let chain = Chain::new(&arms::named("irb6")).unwrap();
    let near = Joints::from([0.0, -1.5, 1.5, 0.2, 0.0]);
    let pose = chain.forward(&near).unwrap();
    let lean = |angle: f64| nalgebra::UnitQuaternion::from_scaled_axis(Vector3::z() * angle);
    let leaning = Isometry3::from_parts(pose.translation, lean(0.1) * pose.rotation);
    let Err(KinematicsError::Missed { distance, angle }) = chain.inverse(&leaning, &near) else { panic!() };
    assert!(distance < 0.1 && angle > 0.01 && angle < 0.1, "{distance} {angle}");
    // A pose with eight digits.
    let rounded = Isometry3::from_parts(pose.translation, lean(1e-8) * pose.rotation);
    let solutions = chain.inverse(&rounded, &near).unwrap();
    assert!(largest_difference(solutions.preferred(), &near) < 1e-6, "{solutions:?}");
}

#[test]
fn room_at_home_is_that_of_the_motors() {
    let mut parameters = arms::panda();
    parameters.joints.truncate(2);
    parameters.motors_from_joints = Some(vec![vec![100.0, 0.0], vec![50.0, 50.0]]);
    parameters.joints[0].joint_at_home = 2.8973;
    let roomy = parameters.clone().with_room_at_home(&[0.5, 0.5]);
    assert!((roomy.joints[0].limits.high - 2.8973 - 0.005).abs() < 1e-12);
    assert_eq!(roomy.joints[1], parameters.joints[1]);
}
