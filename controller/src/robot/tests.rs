//! Properties of all robots, and golden values of each robot.

use std::f64::consts::{FRAC_PI_2, TAU};

use nalgebra::{DMatrix, Isometry3, Matrix3, Matrix4, Vector3};

use super::*;
use crate::random::Random;

mod chain;
mod irp6_track;
mod polycrank;
mod refusals;
mod rnt;
mod weight;

const SEED: u64 = 0x6d72_726f;

fn irp6p() -> Irp6 {
    Irp6::new(&Irp6Parameters::irp6p()).unwrap()
}

fn irb6() -> Irb6 {
    Irb6::new(&Irb6Parameters::irb6()).unwrap()
}

fn irp6ot() -> Irp6Track {
    Irp6Track::new(&Irp6TrackParameters::irp6ot()).unwrap()
}

fn polycrank() -> Polycrank {
    Polycrank::new(&PolycrankParameters::polycrank()).unwrap()
}

/// The robots whose poses leave no parameter open.
fn determined() -> [(&'static str, Box<dyn Robot>); 3] {
    let calibrated = Irp6::new(&Irp6Parameters::irp6p_calibrated()).unwrap();
    [("irp6p", Box::new(irp6p())), ("calibrated", Box::new(calibrated)), ("irb6", Box::new(irb6()))]
}

fn robots() -> Vec<(&'static str, Box<dyn Robot>)> {
    let calibrated = Irp6Track::new(&Irp6TrackParameters::irp6ot_calibrated()).unwrap();
    let coupled = PolycrankParameters { coupled: true, ..PolycrankParameters::polycrank() };
    let mut robots = Vec::from(determined());
    robots.push(("irp6ot", Box::new(irp6ot())));
    robots.push(("irp6ot calibrated", Box::new(calibrated)));
    robots.push(("polycrank", Box::new(polycrank())));
    robots.push(("coupled", Box::new(Polycrank::new(&coupled).unwrap())));
    robots.push(("rnt", Box::new(rnt::rnt())));
    robots
}

impl Random {
    /// Random joints within the limits of the robot.
    fn joints(&mut self, robot: &dyn Robot) -> Joints {
        loop {
            let mut joints = Joints::new(&[0.0; MAX_AXES][..robot.axes()]).unwrap();
            for (joint, limits) in joints.iter_mut().zip(robot.joint_limits()) {
                *joint =
                    if limits.is_continuous() { self.within(-9.0, 9.0) } else { self.within(limits.low, limits.high) };
            }
            if robot.motors_from_joints(&joints).is_ok() {
                return joints;
            }
        }
    }
}

fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Distance, m, and angle, rad, between two poses.
fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> (f64, f64) {
    let turn = a.rotation.inverse() * b.rotation;
    let angle = 2.0 * turn.imag().norm().atan2(turn.w.abs());
    ((a.translation.vector - b.translation.vector).norm(), angle)
}

/// Standard Denavit-Hartenberg step: theta, d, a, alpha.
fn dh([theta, d, a, alpha]: [f64; 4]) -> Matrix4<f64> {
    Matrix4::new_rotation(Vector3::z() * theta)
        * Matrix4::new_translation(&Vector3::new(a, 0.0, d))
        * Matrix4::new_rotation(Vector3::x() * alpha)
}

/// The arm of the published table, from joints converted to its relative angles.
fn dh_product(d1: f64, [a2, a3, d5]: [f64; 3], th: &[f64]) -> Matrix4<f64> {
    let q3 = th[2] - th[1] - FRAC_PI_2;
    let q4 = th[3] - th[2];
    let arm = dh([th[0], d1, 0.0, -FRAC_PI_2])
        * dh([th[1], 0.0, a2, 0.0])
        * dh([q3 + FRAC_PI_2, 0.0, a3, 0.0])
        * dh([q4 - FRAC_PI_2, 0.0, 0.0, -FRAC_PI_2]);
    match th.get(5) {
        Some(&th6) => arm * dh([th[4], d5, 0.0, FRAC_PI_2]) * dh([th6, 0.0, 0.0, 0.0]),
        None => arm * dh([th[4], d5, 0.0, 0.0]),
    }
}

#[test]
fn irp6p_golden_vectors_hold() {
    let relative = [0.3, -1.7, 0.2, -0.4, 1.1, 0.6];
    let th3 = relative[2] + relative[1] + FRAC_PI_2;
    let cases = [
        (
            [0.0, -FRAC_PI_2, 0.0, 0.0, FRAC_PI_2, 0.0],
            [-15.9, -4.999999540205, -8.526944258538, 151.31, 314.612842102152, 791.0],
            [0.86, 0.0, 0.455],
            [0.0, 1.0, 0.0],
        ),
        (
            [0.3, -1.7, th3, th3 - 0.4, 1.1, 0.6],
            [-63.3, -27.601461824511, 3.90437469094, 193.448070170253, 392.908070170253, 964.3307],
            [0.75423282049035, 0.23331155202297, 0.46523858134258],
            [0.61220102655464, 0.67652515109609, -0.40929649768823],
        ),
    ];
    let robot = irp6p();
    for (joints, motors, origin, first_row) in cases {
        let joints = Joints::from(joints);
        let driven = robot.motors_from_joints(&joints).unwrap();
        assert!(largest_difference(&driven, &motors) < 1e-9, "{driven:?}");
        let back = robot.joints_from_motors(&Motors::from(motors)).unwrap();
        assert!(largest_difference(&back, &joints) < 1e-11, "{back:?}");

        let pose = robot.forward(&joints).unwrap();
        assert!((pose.translation.vector - Vector3::from(origin)).norm() < 1e-13, "{pose}");
        let rotation = pose.rotation.to_rotation_matrix();
        let row = rotation.matrix().row(0).transpose();
        assert!((row - Vector3::from(first_row)).norm() < 1e-13, "{pose}");

        let near = robot.joints_from_motors(&robot.home()).unwrap();
        let solutions = robot.inverse(&pose, &near).unwrap();
        assert_eq!(solutions.len(), 1);
        assert!(largest_difference(solutions.preferred(), &joints) < 1e-9, "{solutions:?}");
    }
}

#[test]
fn home_is_where_homing_leaves_the_robot() {
    let upright = [0.0, -FRAC_PI_2, 0.0, 0.0, 0.0, 0.0];
    let calibrated = [0.0111, -1.588573912192473, -0.005679824080331, 0.0, 0.0903, 0.0209];
    let carriage = [0.0, 0.0, -FRAC_PI_2, 0.0, 0.0, 0.0, 0.0];
    let off = [0.0, 0.004989, -1.680291789180402, 0.011874705954631, 0.0, 0.000898, 0.005605];
    let bent = [0.0, FRAC_PI_2, -FRAC_PI_2, 0.0, FRAC_PI_2, 0.0, 0.0];
    let level = [0.0, 0.0, f64::sqrt(0.75 * 0.75 - 0.19 * 0.19), 0.0, 0.0, 0.0];
    // The nominal screw lengths at home are published to 0.1 µm.
    let cases: [(&[f64], &[f64], f64); 8] = [
        (&[-15.9, -5.0, -8.527, 151.31, 435.25, 791.0], &upright, 1e-6),
        (&[-7.7597, -8.7537, -7.5355, 153.1366, 309.5910, 796.0265], &calibrated, 1e-12),
        (&[-15.9, -5.0, -8.527, 151.31, 314.665], &upright[..5], 1e-6),
        (&[0.0, -10.819, -4.012, -6.219, 158.997, 479.5, 769.7], &carriage, 1e-6),
        (&[-0.0117, -7.185, -23.7333, -4.0065, 153.6764, 356.0929, 791.4409], &off, 1e-12),
        (&[0.0; 7], &bent, 1e-12),
        (&[0.0; 7], &bent, 1e-12),
        (&[0.0; 6], &level, 1e-12),
    ];
    let robots = robots();
    assert_eq!(robots.len(), cases.len());
    for ((name, robot), (home, joints, tolerance)) in robots.iter().zip(cases) {
        assert_eq!(&robot.home()[..], home, "{name}");
        let stood = robot.joints_from_motors(&robot.home()).unwrap();
        let difference = largest_difference(&stood, joints);
        assert!(difference < tolerance, "{name} {stood:?}");
    }
}

#[test]
fn forward_kinematics_is_the_denavit_hartenberg_product() {
    let mut random = Random(SEED);
    let (six, five) = (Irp6Parameters::irp6p().arm, Irb6Parameters::irb6().arm);
    for (robot, arm) in [(&irp6p() as &dyn Robot, six), (&irb6(), five)] {
        let lengths = [arm.lower_arm_length, arm.upper_arm_length, arm.wrist_length];
        for _ in 0..2_000 {
            let joints = random.joints(robot);
            let pose = robot.forward(&joints).unwrap().to_homogeneous();
            let product = dh_product(arm.shoulder_height, lengths, &joints);
            assert!((pose - product).amax() < 1e-12, "{joints:?}");
        }
    }
}

#[test]
fn inverse_finds_every_pose_of_the_workspace_on_its_only_branch() {
    for (name, robot) in determined() {
        let mut random = Random(SEED);
        for _ in 0..20_000 {
            let joints = random.joints(&*robot);
            let near = random.joints(&*robot);
            let pose = robot.forward(&joints).unwrap();
            let solutions =
                robot.inverse(&pose, &near).unwrap_or_else(|error| panic!("{name} {joints:?} near {near:?}: {error}"));
            assert_eq!(solutions.len(), 1, "{name} {joints:?}: {solutions:?}");
            let solved = solutions.preferred();
            let (distance, angle) = apart(&robot.forward(solved).unwrap(), &pose);
            assert!(distance < 1e-9 && angle < 1e-9, "{name} {joints:?} {distance} {angle}");
            let mut turned = *solved;
            turned[4] -= TAU * ((turned[4] - joints[4]) / TAU).round();
            assert!(largest_difference(&turned, &joints) < 1e-8, "{name} {joints:?} {solved:?}");
        }
    }
}

#[test]
fn roll_stays_in_the_turn_of_the_robot_unless_a_limit_forbids_it() {
    let robot = irp6p();
    let at = |th5| Joints::from([0.1, -1.5, 0.1, 0.2, th5, 0.3]);
    for (asked, near, expected) in [
        (5.0, 5.1, 5.0),
        (5.0, 4.0, 5.0),
        (-1.0, -0.9, -1.0),
        (-1.0, 5.0, TAU - 1.0),
        // At this pitch motor 5 ends at th5 = 6.37, so that the next turn is out of its range.
        (0.2, 6.3, 0.2),
    ] {
        let pose = robot.forward(&at(asked)).unwrap();
        let solved = *robot.inverse(&pose, &at(near)).unwrap().preferred();
        assert!((solved[4] - expected).abs() < 1e-9, "{asked} near {near}: {solved:?}");
    }
}

#[test]
fn a_wrist_singularity_keeps_the_pitch_of_the_robot() {
    let robot = irp6p();
    for th5 in [0.0, 1e-12, std::f64::consts::PI] {
        let joints = Joints::from([0.4, -1.4, 0.2, 0.3, th5, -0.5]);
        let near = Joints::from([0.4, -1.4, 0.2, 0.25, th5, -0.4]);
        let pose = robot.forward(&joints).unwrap();
        let solved = *robot.inverse(&pose, &near).unwrap().preferred();
        assert_eq!(solved[3], 0.25);
        let (distance, angle) = apart(&robot.forward(&solved).unwrap(), &pose);
        assert!(distance < 1e-9 && angle < 1e-9, "{distance} {angle}");
    }
}

/// The pose with each number rounded to nine digits, as in a file.
fn rounded(pose: &Isometry3<f64>) -> Isometry3<f64> {
    let round = |value: f64| (value * 1e9).round() / 1e9;
    let rotation = nalgebra::Quaternion::from(pose.rotation.coords.map(round));
    let translation = pose.translation.vector.map(round);
    Isometry3::from_parts(translation.into(), nalgebra::UnitQuaternion::from_quaternion(rotation))
}

#[test]
fn a_singular_pose_of_nine_digits_is_answered_near_the_posture() {
    let mut random = Random(SEED);
    let (irp6, rnt, polycrank) = (irp6p(), rnt::rnt(), polycrank());
    let arms: [(&str, &dyn Robot, &[f64]); 4] = [
        ("irp6", &irp6, &[0.4, -1.4, 0.2, 0.3, 0.0, -0.5]),
        ("rnt", &rnt, &[0.1, -0.2, 1.0, 0.4, 0.0, 0.3]),
        ("polycrank", &polycrank, &[0.3, 1.0, 0.2, 0.4, 1.0, -1.4, 0.0]),
        ("polycrank, tool the other way", &polycrank, &[0.3, 1.0, 0.2, 0.4, 1.0, std::f64::consts::PI - 1.4, 0.0]),
    ];
    for (name, robot, singular) in arms {
        for _ in 0..200 {
            let offset: Vec<f64> = singular.iter().map(|_| random.within(-0.02, 0.02)).collect();
            let mut joints: Vec<f64> = singular.iter().zip(&offset).map(|(at, by)| at + by).collect();
            // The joint that makes the posture singular.
            match name {
                "irp6" | "rnt" => joints[4] = 0.0,
                _ => joints[5] += singular[3] + singular[4] - joints[3] - joints[4] - offset[5],
            }
            let joints = Joints::new(&joints).unwrap();
            let pose = rounded(&robot.forward(&joints).unwrap());
            let solved = *robot.inverse(&pose, &joints).unwrap().preferred();
            assert!(largest_difference(&solved, &joints) < 1e-6, "{name}: {solved:?} near {joints:?}");
            let (distance, angle) = apart(&robot.forward(&solved).unwrap(), &pose);
            assert!(distance < 1e-9 && angle < 1.5e-8, "{name}: {distance} {angle}");
        }
    }
}

#[test]
fn orientation_stays_exact_beside_the_wrist_singularity() {
    let robot = irp6p();
    for exponent in 1..14 {
        let joints = Joints::from([0.4, -1.4, 0.2, 0.3, 10_f64.powi(-exponent), -0.5]);
        let near = Joints::from([0.4, -1.4, 0.2, 0.25, 0.0, -0.4]);
        let pose = robot.forward(&joints).unwrap();
        let solved = *robot.inverse(&pose, &near).unwrap().preferred();
        let (distance, angle) = apart(&robot.forward(&solved).unwrap(), &pose);
        // Nearer than 1e-8, the pitch is that of the posture, and the orientation is met within the same bound.
        let bound = if exponent < 8 { 2e-10 } else { 1.5e-8 };
        assert!(distance < 1e-12 && angle < bound, "1e-{exponent}: {distance} {angle}");
    }
}

#[test]
fn solutions_come_nearest_first() {
    // Without the limits of the real robot all eight branches remain.
    let mut parameters = Irp6Parameters::irp6p();
    let wide = Limits { low: -1e6, high: 1e6 };
    parameters.arm.column.joint_limits = wide;
    parameters.arm.column.motor_limits = wide;
    parameters.arm.pitch.joint_limits = wide;
    parameters.arm.pitch.motor_limits = wide;
    parameters.arm.roll.motor_limits = wide;
    parameters.hand.joint_limits = wide;
    let robot = Irp6::new(&parameters).unwrap();
    let mut random = Random(SEED);
    let mut most = 0;
    for _ in 0..500 {
        let joints = random.joints(&irp6p());
        let pose = robot.forward(&joints).unwrap();
        let solutions = robot.inverse(&pose, &joints).unwrap();
        most = most.max(solutions.len());
        assert!(largest_difference(solutions.preferred(), &joints) < 1e-8, "{joints:?}");
        let travels = solutions.iter().map(|solution| largest_difference(solution, &joints));
        assert!(travels.is_sorted(), "{solutions:?}");
        for solution in solutions.iter() {
            let (distance, angle) = apart(&robot.forward(solution).unwrap(), &pose);
            assert!(distance < 1e-9 && angle < 1e-9, "{solution:?}");
        }
    }
    assert!(most > 1, "the case offers no choice");
}

#[test]
fn motors_and_joints_are_each_others_inverse() {
    for (name, robot) in robots() {
        let mut random = Random(SEED);
        for _ in 0..5_000 {
            let joints = random.joints(&*robot);
            let motors = robot.motors_from_joints(&joints).unwrap();
            let back = robot.joints_from_motors(&motors).unwrap();
            assert!(largest_difference(&back, &joints) < 1e-11, "{name} {joints:?} {back:?}");
        }
    }
}

#[test]
fn pitch_motor_carries_the_roll_motor() {
    let robot = irb6();
    let level = robot.motors_from_joints(&Joints::from([0.0, -1.5, 0.0, 0.0, 1.0])).unwrap();
    let pitched = robot.motors_from_joints(&Joints::from([0.0, -1.5, 0.0, 0.5, 1.0])).unwrap();
    assert!((pitched[3] - level[3] + 64.0).abs() < 1e-9);
    assert!((pitched[4] - level[4] + 64.0).abs() < 1e-9);
    assert_eq!(pitched[..3], level[..3]);
}

#[test]
fn ball_screw_constants_are_one_rigid_geometry() {
    let (crank, near, far) = (0.140, 0.1575, 0.183);
    let ArmParameters { lower_arm, upper_arm, .. } = Irp6Parameters::irp6p().arm;
    for screw in [lower_arm, upper_arm] {
        assert!((screw.squared - (crank * crank + near * near + far * far)).abs() < 1e-15);
    }
    assert!((upper_arm.cosine + 2.0 * crank * near).abs() < 1e-15);
    assert!((upper_arm.sine - 2.0 * crank * far).abs() < 1e-15);
    // The lower arm has the same triangle. Its crank is offset by 75.01° from the upper arm's crank.
    let swing = 2.0 * crank * f64::hypot(near, far);
    assert!((lower_arm.cosine.hypot(lower_arm.sine) - swing).abs() < 1e-8);
    let phase = |screw: ScrewAxis| f64::atan2(screw.sine, screw.cosine).to_degrees();
    let set = 180.0 - (phase(upper_arm) - phase(lower_arm));
    assert!((set - 75.01).abs() < 0.005, "{set}");
}

/// Compares the Jacobian with central differences of forward kinematics.
fn derivative(name: &str, robot: &dyn Robot, postures: usize) {
    let step = 1e-6;
    let mut random = Random(SEED);
    for _ in 0..postures {
        let joints = random.joints(robot);
        let jacobian = robot.jacobian(&joints).unwrap();
        for axis in 0..MAX_AXES {
            let column = jacobian.column(axis).into_owned();
            if axis >= robot.axes() {
                assert_eq!(column.amax(), 0.0);
                continue;
            }
            let [before, after] = [-step, step].map(|delta| {
                let mut moved = joints;
                moved[axis] += delta;
                robot.forward(&moved).unwrap()
            });
            let linear = after.translation.vector - before.translation.vector;
            let angular = (after.rotation * before.rotation.inverse()).scaled_axis();
            let measured =
                nalgebra::Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z) / (2.0 * step);
            assert!((measured - column).amax() < 1e-8, "{name} {joints:?} axis {axis}");
        }
    }
}

#[test]
fn jacobian_is_the_derivative_of_forward_kinematics() {
    for (name, robot) in robots() {
        derivative(name, &*robot, 500);
    }
}

#[test]
fn product_of_the_links_is_forward_kinematics() {
    for (name, robot) in robots() {
        let mut random = Random(SEED);
        let links = robot.links();
        assert_eq!(links.len(), robot.axes(), "{name}");
        for _ in 0..2_000 {
            let joints = random.joints(&*robot);
            let placed = links.iter().map(|link| link.placed(&joints));
            let product = placed.fold(Isometry3::identity(), |base, link| base * link);
            let (distance, angle) = apart(&product, &robot.forward(&joints).unwrap());
            assert!(distance < 1e-12 && angle < 1e-12, "{name} {joints:?} {distance} {angle}");
            for link in &links {
                let sum = joints.iter().zip(link.coupling).map(|(q, k)| q * k).sum();
                assert_eq!(link.limits.exceeded_by(sum), None, "{name} {}", link.name);
            }
        }
    }
}

#[test]
fn singularity_is_the_smallest_singular_value_and_the_axis_that_moves_the_flange_least() {
    let robot = irp6p();
    let at = |th5| Joints::from([0.4, -1.4, 0.2, 0.3, th5, -0.5]);
    let straight = robot.singularity(&at(0.0)).unwrap();
    assert_eq!(straight.axis, 3);
    assert!(straight.margin < 1e-12, "{straight:?}");
    let beside = robot.singularity(&at(0.01)).unwrap();
    assert!(beside.margin > 1e-3 && beside.margin < 1e-2, "{beside:?}");
    for (name, robot) in robots() {
        let mut random = Random(SEED);
        let count = robot.axes().min(6);
        for _ in 0..200 {
            let joints = random.joints(&*robot);
            let found = robot.singularity(&joints).unwrap();
            let jacobian = robot.jacobian(&joints).unwrap();
            let matrix = DMatrix::from_fn(6, robot.axes(), |row, column| jacobian[(row, column)]);
            let expected = matrix.singular_values()[count - 1];
            assert!((found.margin - expected).abs() < 1e-12, "{name} {joints:?}");
        }
    }
}

#[test]
fn only_the_wrist_makes_the_jacobian_singular() {
    let robot = irp6p();
    let arm = Irp6Parameters::irp6p().arm;
    let mut random = Random(SEED);
    for _ in 0..500 {
        let joints = random.joints(&robot);
        let jacobian = robot.jacobian(&joints).unwrap();
        let square = DMatrix::from_fn(6, 6, |row, column| jacobian[(row, column)]);
        let reach = arm.lower_arm_length * joints[1].cos()
            + arm.upper_arm_length * joints[2].cos()
            + arm.wrist_length * joints[3].cos();
        let elbow = (joints[2] - joints[1]).sin();
        let expected = arm.lower_arm_length * arm.upper_arm_length * elbow * reach * joints[4].sin();
        assert!((square.determinant().abs() - expected.abs()).abs() < 1e-12, "{joints:?}");
        assert!(reach > 0.2 && elbow > 0.17, "{joints:?}");
    }
}

#[test]
fn flange_frame_of_the_five_axis_arm_points_ahead() {
    let pose = irb6().forward(&Joints::from([0.0, -FRAC_PI_2, 0.0, 0.0, 0.0])).unwrap();
    let expected = Matrix3::new(0.0, 0.0, 1.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0);
    assert!((pose.rotation.to_rotation_matrix().matrix() - expected).amax() < 1e-15);
    assert!((pose.translation.vector - Vector3::new(0.765, 0.0, 1.155)).norm() < 1e-15);
}
