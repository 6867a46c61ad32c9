//! The IRp-6 on its track: golden values, and the choice of the carriage position.

use super::*;

#[test]
fn golden_vectors_of_the_pedestal_hold_on_the_carriage() {
    let (robot, arm) = (irp6ot(), irp6p());
    let th = [0.3, -1.7, 0.07079632679489656, -0.3292036732051034, 1.1, 0.6];
    let joints = Joints::from([0.4, th[0], th[1], th[2], th[3], th[4], th[5]]);
    let pose = robot.forward(&joints).unwrap();
    let origin = Vector3::new(0.75423282049035, 0.63331155202297, 0.46523858134258);
    assert!((pose.translation.vector - origin).norm() < 1e-13, "{pose}");
    assert_eq!(pose.rotation, arm.forward(&Joints::from(th)).unwrap().rotation);
    // Motor positions of the robot on the pedestal, each shifted by the difference of the two homes. The track
    // follows from its ratio.
    let motors = robot.motors_from_joints(&joints).unwrap();
    let expected = [
        628.3185307179587,
        -63.3 + 15.9 - 10.819,
        -27.601461824511 + 5.0 - 4.012,
        3.90437469094 + 8.527 - 6.219,
        193.448070170253 - 151.31 + 158.997,
        392.908070170253 - 435.25 + 479.5,
        964.3307 - 791.0 + 769.7,
    ];
    assert!(largest_difference(&motors, &expected) < 1e-9, "{motors:?}");
}

#[test]
fn inverse_finds_poses_of_the_workspace_on_one_branch() {
    let calibrated = Irp6Track::new(&Irp6TrackParameters::irp6ot_calibrated()).unwrap();
    for robot in [irp6ot(), calibrated] {
        let mut random = Random(SEED);
        let mut refused = 0;
        for _ in 0..20_000 {
            let joints = random.joints(&robot);
            let near = random.joints(&robot);
            let pose = robot.forward(&joints).unwrap();
            let own = robot.inverse_at(&pose, &near, joints[0]).unwrap();
            assert_eq!(own.len(), 1, "{joints:?}");
            let mut turned = *own.preferred();
            turned[5] -= TAU * ((turned[5] - joints[5]) / TAU).round();
            assert!(largest_difference(&turned, &joints) < 1e-8, "{joints:?}");

            let mut at_its_place = near;
            at_its_place[0] = joints[0];
            assert!(robot.inverse(&pose, &at_its_place).is_ok(), "{joints:?}");
            let Ok(solutions) = robot.inverse(&pose, &near) else {
                refused += 1;
                continue;
            };
            assert_eq!(solutions.len(), 1, "{joints:?}");
            let (distance, angle) = apart(&robot.forward(&solutions[0]).unwrap(), &pose);
            assert!(distance < 1e-9 && angle < 1e-9, "{joints:?}");
            assert!(robot.motors_from_joints(&solutions[0]).is_ok());
        }
        // The search may miss a position of the carriage that lies in a very short part of the track.
        assert!(refused < 60, "{refused}");
    }
}

#[test]
fn carriage_stays_while_the_arm_reaches_comfortably_and_moves_the_least_otherwise() {
    let robot = irp6ot();
    let near = Joints::from([0.4, 0.2, -1.6, 0.1, 0.2, 1.2, 0.3]);
    let at = robot.forward(&near).unwrap();
    for (x, y, expected) in [
        (0.8, 0.4, 0.4),
        (0.8, 0.6, 0.4),
        (0.0, 1.2, 0.4),
        // Beyond 0.95 m the carriage follows the flange. Below 0.6 m the carriage moves away.
        (0.0, 1.5, 0.55),
        (0.57, 1.5, 1.5 - 0.76),
        (0.36, 0.7, 0.22),
        (0.36, 0.1, 0.58),
        // The flange is beside and behind the column.
        (-0.5, 0.7, 0.7 - 0.5 * 40_f64.to_radians().tan()),
        // The end of the range of the track's motor.
        (0.0, 2.3, 1900.0 / (500.0 * std::f64::consts::PI)),
    ] {
        let pose = Isometry3::from_parts(
            Vector3::new(x, y, at.translation.z - 0.1).into(),
            nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), f64::atan2(y - expected, x))
                * irp6p().forward(&Joints::from([0.0, -1.6, 0.1, 0.2, 1.2, 0.3])).unwrap().rotation,
        );
        match robot.inverse(&pose, &near) {
            Ok(solutions) => {
                let carriage = solutions.preferred()[0];
                assert!((carriage - expected).abs() < 1e-9, "{x} {y}: {carriage}");
            }
            Err(error) => panic!("{x} {y}: {error}"),
        }
    }
    assert_eq!(robot.inverse(&at, &near).unwrap().preferred()[0], 0.4);
}

/// Whether an axis is closer than 0.03 rad or m to a limit.
fn at_limit(robot: &dyn Robot, joints: &Joints) -> bool {
    (0..robot.axes()).any(|axis| {
        [-0.03, 0.03].into_iter().any(|step| {
            let mut moved = *joints;
            moved[axis] += step;
            axis > 0 && robot.motors_from_joints(&moved).is_err()
        })
    })
}

#[test]
fn carriage_does_not_jump_along_straight_lines() {
    let robot = irp6ot();
    let mut random = Random(SEED);
    let (mut followed, mut broken) = (0, 0);
    for _ in 0..100 {
        let [start, end] = [(); 2].map(|()| random.joints(&robot));
        let [from, to] = [start, end].map(|joints| robot.forward(&joints).unwrap());
        let steps = 10_000;
        let mut near = start;
        for step in 1..=steps {
            let Some(pose) = from.try_lerp_slerp(&to, f64::from(step) / f64::from(steps), 1e-9) else {
                break;
            };
            let Ok(solutions) = robot.inverse(&pose, &near) else {
                break;
            };
            let next = *solutions.preferred();
            if near[5].sin().abs() < 0.1 || at_limit(&robot, &near) {
                break;
            }
            if largest_difference(&next, &near) > 0.02 {
                broken += 1;
                break;
            }
            near = next;
            followed += 1;
        }
    }
    assert_eq!(broken, 0);
    assert!(followed > 200_000, "{followed}");
}

#[test]
fn refusals_of_the_arm_name_the_axis_counted_from_the_track() {
    let robot = irp6ot();
    let near = Joints::from([0.4, 0.2, -1.6, 0.1, 0.2, 1.2, 0.3]);
    let pose = robot.forward(&near).unwrap();
    let mut over = pose;
    over.translation.vector.x = 0.0;
    over.translation.vector.y = 0.4;
    assert_eq!(robot.inverse_at(&over, &near, 0.4), Err(KinematicsError::Singular { axis: 1, margin: 0.0 }));
    let beyond = |axis, value, limit| KinematicsError::BeyondLimit { space: Space::Joint, axis, value, limit };
    for (axis, value, limit) in [(0, 1.3, 1.21), (0, -0.2, -0.125), (2, -2.5, -130_f64.to_radians()), (6, 3.0, 2.93)] {
        let mut joints = near;
        joints[axis] = value;
        let error = robot.motors_from_joints(&joints).unwrap_err();
        assert_eq!(error, beyond(axis as u8, value, limit));
    }
    let off = robot.inverse_at(&pose, &near, 1.5).unwrap_err();
    assert_eq!(off, beyond(0, 1.5, 1.21));
    let mut far = pose;
    far.translation.vector.x = 2.0;
    match robot.inverse(&far, &near) {
        Err(KinematicsError::Unreachable { margin }) => assert!(margin > 0.5, "{margin}"),
        other => panic!("{other:?}"),
    }
    let mut lost = pose;
    lost.translation.vector.z = f64::NAN;
    assert_eq!(robot.inverse(&lost, &near), Err(KinematicsError::NotFinite));
    let mut parameters = Irp6TrackParameters::irp6ot();
    parameters.track.ratio = 0.0;
    assert_eq!(Irp6Track::new(&parameters), Err(ParameterError::NoRatio { name: "track" }));
}
