//! The RNT: golden values, legs, wrist and refusals.

use std::f64::consts::PI;

use super::*;

pub(super) fn rnt() -> Rnt {
    Rnt::new(&RntParameters::nominal()).unwrap()
}

#[test]
fn rnt_golden_vector_holds() {
    let robot = rnt();
    let joints = Joints::from([0.2, -0.1, 0.9, 0.0, 0.5, 0.0]);
    let lengths = robot.leg_lengths(&joints).unwrap();
    let expected = [0.953705712, 0.960914436, 0.842363921];
    assert!(largest_difference(&lengths, &expected) < 1e-9, "{lengths:?}");
    let centre = robot.forward(&joints).unwrap().translation.vector;
    let expected = Vector3::new(-0.109816758, -0.217444493, 1.072687360);
    assert!((centre - expected).amax() < 1e-9, "{centre}");

    let motors = robot.motors_from_joints(&joints).unwrap();
    for (leg, length) in lengths.into_iter().enumerate() {
        let turns = (length - 0.75) / 0.005;
        assert!((motors[leg] - TAU * turns).abs() < 1e-9, "{motors:?}");
    }
    assert!(largest_difference(&motors[3..], &[0.0, 50.0, 0.0]) < 1e-12);
}

#[test]
fn the_flange_leans_by_tilts_and_wrist_in_their_order() {
    let joints = [0.3, -0.2, 1.0, 0.7, -1.1, 2.5];
    let about = |axis: Vector3<f64>, angle| Matrix4::new_rotation(axis * angle);
    let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
    let expected = about(x, joints[0])
        * about(y, joints[1])
        * Matrix4::new_translation(&(z * (joints[2] + 0.2)))
        * about(z, joints[3])
        * about(y, joints[4])
        * about(z, joints[5]);
    let pose = rnt().forward(&Joints::from(joints)).unwrap();
    assert!((pose.to_homogeneous() - expected).amax() < 1e-15, "{pose}");
}

#[test]
fn every_pose_of_the_workspace_is_found_on_both_sides_of_the_wrist() {
    let robot = rnt();
    let mut random = Random(SEED);
    for _ in 0..20_000 {
        let (joints, near) = (random.joints(&robot), random.joints(&robot));
        let pose = robot.forward(&joints).unwrap();
        let solutions = robot.inverse(&pose, &near).unwrap();
        assert_eq!(solutions.len(), 2, "{joints:?}");
        for solution in solutions.iter() {
            let (distance, angle) = apart(&robot.forward(solution).unwrap(), &pose);
            assert!(distance < 1e-9 && angle < 1e-9, "{joints:?} {solution:?}: {distance} {angle}");
            robot.motors_from_joints(solution).unwrap();
        }
        let from_joints = |solution: &Joints| largest_difference(solution, &joints);
        let nearest = solutions.iter().map(from_joints).fold(PI, f64::min);
        assert!(nearest < 1e-9, "{joints:?} {solutions:?}");
        let from_near = |solution: &Joints| largest_difference(solution, &near);
        assert!(solutions.iter().map(from_near).is_sorted(), "{near:?} {solutions:?}");
        let [one, other] = [&solutions[0], &solutions[1]];
        assert!((one[4] + other[4]).abs() < 1e-9, "{solutions:?}");
    }
}

#[test]
fn legs_close_within_six_steps_all_over_the_workspace() {
    let robot = rnt();
    let mut random = Random(SEED);
    let (mut most, mut warm) = (0, 0);
    for _ in 0..20_000 {
        let joints = random.joints(&robot);
        let posture = [joints[0], joints[1], joints[2]];
        let lengths = robot.legs.lengths(&posture);
        let (found, steps) = robot.legs.close(&lengths, &[0.0, 0.0, 0.95]).unwrap();
        assert!(largest_difference(&found, &posture) < 1e-12, "{joints:?} {found:?}");
        most = most.max(steps);
        let near = posture.map(|value| value + random.within(-0.01, 0.01));
        warm = warm.max(robot.legs.close(&lengths, &near).unwrap().1);

        let motors = robot.motors_from_joints(&joints).unwrap();
        let back = robot.joints_from_motors(&motors).unwrap();
        assert!(largest_difference(&back, &joints) < 1e-12, "{joints:?} {back:?}");
    }
    assert!(most <= 6 && warm <= 3, "{most} steps, {warm} from beside");
}

#[test]
fn legs_have_a_firm_hold_all_over_the_workspace() {
    let robot = rnt();
    let mut random = Random(SEED);
    let mut worst: f64 = 0.0;
    for _ in 0..5_000 {
        let joints = random.joints(&robot);
        let (jacobian, _) = robot.legs.jacobian(&[joints[0], joints[1], joints[2]]);
        let values = jacobian.singular_values();
        worst = worst.max(values.max() / values.min());
    }
    assert!((5.5..6.5).contains(&worst), "{worst}");
}

#[test]
fn only_a_straight_wrist_makes_its_jacobian_singular() {
    let robot = rnt();
    let mut random = Random(SEED);
    for _ in 0..500 {
        let joints = random.joints(&robot);
        let jacobian = robot.jacobian(&joints).unwrap();
        let square = DMatrix::from_fn(6, 6, |row, column| jacobian[(row, column)]);
        let reach = joints[2] + 0.2;
        let expected = reach * reach * joints[1].cos() * joints[4].sin();
        assert!((square.determinant().abs() - expected.abs()).abs() < 1e-12, "{joints:?}");
    }
}

#[test]
fn a_straight_wrist_keeps_the_roll_of_the_robot_and_is_met_beside_it() {
    let robot = rnt();
    let lean = |pitch| Joints::from([0.1, -0.2, 1.0, 0.4, pitch, 0.3]);
    for pitch in [0.0, 9e-9, -9e-9] {
        let pose = robot.forward(&lean(pitch)).unwrap();
        for roll in [0.4, -1.3, 2.9] {
            let near = Joints::from([0.1, -0.2, 1.0, roll, 0.0, 0.7 - roll]);
            let solved = *robot.inverse(&pose, &near).unwrap().preferred();
            assert!(largest_difference(&solved, &near) < 2e-8, "{pitch}: {solved:?} near {near:?}");
            let (distance, angle) = apart(&robot.forward(&solved).unwrap(), &pose);
            assert!(distance < 1e-12 && angle < 1.5e-8, "{pitch}: {distance} {angle}");
        }
    }
    for exponent in 1..8 {
        let joints = lean(10_f64.powi(-exponent));
        let pose = robot.forward(&joints).unwrap();
        let solved = *robot.inverse(&pose, &joints).unwrap().preferred();
        let (distance, angle) = apart(&robot.forward(&solved).unwrap(), &pose);
        assert!(distance < 1e-12 && angle < 1e-12, "{exponent}: {angle}");
        assert!(largest_difference(&solved, &joints) < 1e-6, "{exponent}: {solved:?}");
    }
}

#[test]
fn poses_past_tilts_extension_and_legs_are_refused_by_name() {
    let robot = rnt();
    let at = |joints: [f64; 6]| robot.forward(&Joints::from(joints)).unwrap();
    let near = Joints::from([0.0, 0.0, 0.9, 0.0, 0.5, 0.0]);
    for (axis, value) in [(0, 0.6), (0, -0.6), (1, 0.6), (1, -0.6), (2, 1.3), (2, 0.6)] {
        let mut joints = [0.0, 0.0, 0.9, 0.1, 0.5, 0.2];
        joints[axis] = value;
        let gate = robot.motors_from_joints(&Joints::from(joints)).unwrap_err();
        for refusal in [gate, robot.inverse(&at(joints), &near).unwrap_err()] {
            match refusal {
                KinematicsError::BeyondLimit { space: Space::Joint, axis: named, value: told, .. } => {
                    assert_eq!(usize::from(named), axis);
                    assert!((told - value).abs() < 1e-12, "{told} instead of {value}");
                }
                other => panic!("axis {axis} at {value}: {other}"),
            }
        }
    }
    // For a distant and tilted platform the opposite leg exceeds its largest length, though every joint is within its
    // limits.
    let tilted = [0.0, -0.52, 1.2, 0.1, 0.5, 0.2];
    let gate = robot.motors_from_joints(&Joints::from(tilted)).unwrap_err();
    for refusal in [gate, robot.inverse(&at(tilted), &near).unwrap_err()] {
        match refusal {
            KinematicsError::LegLimit { leg: 0, length, limit: 1.38 } => {
                assert!((1.38..1.42).contains(&length), "{length}");
            }
            other => panic!("{other}"),
        }
        assert_eq!(refusal.axis(), Some(0));
    }
    let origin = Isometry3::identity();
    assert_eq!(robot.inverse(&origin, &near), Err(KinematicsError::Singular { axis: 0, margin: 0.0 }));
}

#[test]
fn legs_that_cannot_close_are_named_with_what_they_miss() {
    let robot = rnt();
    let ratio = TAU / 0.005;
    let motors = |lengths: [f64; 3]| {
        let [a, b, c] = lengths.map(|length| ratio * (length - 0.75));
        Motors::from([a, b, c, 0.0, 0.0, 0.0])
    };
    // The platform's joints are at most 0.28 m apart, so one leg cannot be half a metre longer than the others.
    for leg in 0..3 {
        let mut lengths = [0.55; 3];
        lengths[leg] = 1.38;
        match robot.joints_from_motors(&motors(lengths)) {
            Err(KinematicsError::Open { leg: named, residual }) => {
                assert!(residual.abs() > 0.01, "{residual}");
                assert!(usize::from(named) < 3);
            }
            other => panic!("{lengths:?}: {other:?}"),
        }
    }
    for lengths in [[0.1; 3], [-1.0; 3], [1e-9, 0.9, 0.9], [1e12, 0.9, 0.9]] {
        let refusal = robot.joints_from_motors(&motors(lengths)).unwrap_err();
        assert!(matches!(refusal, KinematicsError::Open { .. }), "{refusal}");
    }
    // Lengths outside the range of the legs, but possible for the mechanism: a measured position is converted.
    for rho in [0.45, 1.6] {
        let lengths = robot.legs.lengths(&[0.7, -0.7, rho]);
        let joints = robot.joints_from_motors(&motors(lengths)).unwrap();
        assert!(largest_difference(&joints[..3], &[0.7, -0.7, rho]) < 1e-9, "{joints:?}");
    }
}

#[test]
fn numbers_that_place_no_rnt_are_refused() {
    use KinematicsError::{AxisCount, NotFinite};
    let robot = rnt();
    let home = robot.joints_from_motors(&robot.home()).unwrap();
    let pose = robot.forward(&Joints::from([0.1, 0.1, 0.9, 0.0, 0.5, 0.0])).unwrap();
    let mut spoilt = home;
    spoilt[1] = f64::NAN;
    let count = AxisCount { axes: 6, given: 3 };
    for (joints, error) in [(spoilt, NotFinite), (Joints::from([0.0; 3]), count)] {
        let motors = Motors::new(&joints).unwrap();
        assert_eq!(robot.forward(&joints).unwrap_err(), error);
        assert_eq!(robot.jacobian(&joints).unwrap_err(), error);
        assert_eq!(robot.leg_lengths(&joints).unwrap_err(), error);
        assert_eq!(robot.motors_from_joints(&joints).unwrap_err(), error);
        assert_eq!(robot.joints_from_motors(&motors).unwrap_err(), error);
        assert_eq!(robot.inverse(&pose, &joints).unwrap_err(), error);
    }
}

#[test]
fn a_geometry_that_cannot_close_is_refused_with_its_numbers() {
    fn limits(low: f64, high: f64) -> Limits {
        Limits { low, high }
    }
    type Case = (fn(&mut RntParameters), &'static str);
    let cases: [Case; 13] = [
        (|p| p.base_radius = 0.0, "base_radius is 0, not above zero"),
        (|p| p.platform_radius = -0.1, "platform_radius is -0.1, not above zero"),
        (|p| p.wrist_offset = f64::NAN, "wrist_offset has a number that is not finite"),
        (|p| p.wrist_offset = -0.8, "extension with wrist_offset is -0.1"),
        (|p| p.extension = limits(0.9, 0.9), "extension has limits 0.9 .. 0.9"),
        (|p| p.extension.low = 0.0, "extension is 0, not above zero"),
        (|p| p.alpha = limits(-1.6, 0.5), "alpha tilts by 1.600000 rad, more than 1.5 rad"),
        (|p| p.beta.high = 1.51, "beta tilts by 1.510000 rad"),
        (|p| p.legs[1].lead = 0.0, "legs has a ratio of zero"),
        (
            |p| p.legs[2].length_limits = limits(0.1, 0.5),
            "leg 2 is 0.968814 m long amid the workspace, outside its range 0.1 .. 0.5 m",
        ),
        (|p| p.base_radius = 3.0, "leg 0 is 2.994679 m long"),
        (|p| p.legs[0].length_at_home = 1.38, "the legs do not close at home: leg 0 misses its length by"),
        (|p| p.extension.low = 0.05, "the legs lose hold of the platform before alpha"),
    ];
    for (number, (spoil, expected)) in cases.into_iter().enumerate() {
        let mut parameters = RntParameters::nominal();
        spoil(&mut parameters);
        let refusal = Rnt::new(&parameters).expect_err(expected).to_string();
        assert!(refusal.contains(expected), "{number}: {refusal}");
    }
}

#[test]
fn rnt_parameters_survive_the_cell_file() {
    let nominal = RntParameters::nominal();
    let text = toml::to_string(&nominal).unwrap();
    assert_eq!(toml::from_str(&text), Ok(nominal));
    let text = text.replace("base_radius", "base_radios");
    assert!(toml::from_str::<RntParameters>(&text).is_err());
}
