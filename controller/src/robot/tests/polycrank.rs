//! The Polycrank: golden values, branches and turns.

use std::f64::consts::PI;

use nalgebra::{Rotation3, Translation3, UnitQuaternion};

use super::*;

/// Values of counters with 4000 counts per revolution.
fn counts(robot: &dyn Robot, joints: &Joints) -> Vec<i32> {
    let motors = robot.motors_from_joints(joints).unwrap();
    motors.iter().map(|motor| (motor * 4000.0 / TAU).round() as i32).collect()
}

/// The arm by its published table.
fn table(q: &[f64], d6: f64) -> Matrix4<f64> {
    dh([q[0], 0.220, -0.299, 0.0])
        * dh([q[1], 0.152, 0.180, 0.0])
        * dh([q[2], 0.335, 0.0, FRAC_PI_2])
        * dh([q[3], 0.120, 0.151, 0.0])
        * dh([q[4], 0.116, 0.151, 0.0])
        * dh([q[5], d6, 0.0, FRAC_PI_2])
        * dh([q[6], 0.043, 0.0, 0.0])
}

#[test]
fn golden_pose_and_the_published_table_hold() {
    let pose = polycrank().forward(&Joints::from([0.0; 7])).unwrap();
    let origin = Vector3::new(0.183, -0.296, 0.664);
    assert!((pose.translation.vector - origin).norm() < 1e-15, "{pose}");
    let axes = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    assert!((pose.rotation.to_rotation_matrix().matrix() - axes).amax() < 1e-15);

    let mut other = PolycrankParameters::polycrank();
    other.forearm_offsets[2] = 0.062;
    let mut random = Random(SEED);
    for (parameters, d6) in [(PolycrankParameters::polycrank(), 0.060), (other, 0.062)] {
        let robot = Polycrank::new(&parameters).unwrap();
        for _ in 0..2_000 {
            let joints = random.joints(&robot);
            let pose = robot.forward(&joints).unwrap().to_homogeneous();
            assert!((pose - table(&joints, d6)).amax() < 1e-12, "{joints:?}");
        }
    }
}

#[test]
fn inverse_with_the_robots_own_reach_has_its_joints_among_four_or_eight_branches() {
    let robot = polycrank();
    let mut random = Random(SEED);
    let mut eight = 0;
    for _ in 0..20_000 {
        let joints = random.joints(&robot);
        let near = random.joints(&robot);
        let pose = robot.forward(&joints).unwrap();
        let reach = robot.reach(&joints).unwrap();
        let solutions = robot.inverse_at(&pose, &near, reach).unwrap();
        assert!(matches!(solutions.len(), 4 | 8), "{joints:?}");
        eight += usize::from(solutions.len() == 8);
        let turned = |solution: &Joints| {
            let turns = solution.iter().zip(joints.iter());
            let off = turns.map(|(a, b)| (a - b - TAU * ((a - b) / TAU).round()).abs());
            off.fold(0.0, f64::max)
        };
        let nearest = solutions.iter().map(turned).fold(f64::INFINITY, f64::min);
        assert!(nearest < 1e-6, "{joints:?} {nearest}");
        for solution in solutions.iter() {
            let (distance, angle) = apart(&robot.forward(solution).unwrap(), &pose);
            assert!(distance < 1e-9 && angle < 1e-9, "{joints:?} {solution:?}");
            assert!((robot.reach(solution).unwrap() - reach).abs() < 1e-9);
            let far = largest_difference(solution, &near);
            assert!(far < PI + 1e-9, "{solution:?} is turns away from {near:?}");
        }
        let travels = solutions.iter().map(|s| largest_difference(s, &near));
        assert!(travels.is_sorted(), "{solutions:?}");
    }
    assert!(eight > 2_000 && eight < 8_000, "{eight}");
}

#[test]
fn inverse_chooses_a_reach_for_every_pose_of_the_workspace() {
    let robot = polycrank();
    let mut random = Random(SEED);
    for _ in 0..20_000 {
        let joints = random.joints(&robot);
        let near = random.joints(&robot);
        let pose = robot.forward(&joints).unwrap();
        for solution in robot.inverse(&pose, &near).unwrap().iter() {
            let (distance, angle) = apart(&robot.forward(solution).unwrap(), &pose);
            assert!(distance < 1e-9 && angle < 1e-9, "{joints:?} {solution:?}");
        }
    }
}

#[test]
fn a_robot_asked_for_where_it_stands_does_not_move() {
    let robot = polycrank();
    let mut random = Random(SEED);
    let mut stretched = [0.3, 0.0, 0.4, 0.2, 0.0, 0.5, 0.0];
    stretched[1] = 1.0;
    let mut cases: Vec<Joints> = (0..5_000).map(|_| random.joints(&robot)).collect();
    cases.push(Joints::from(stretched));
    for joints in cases {
        let pose = robot.forward(&joints).unwrap();
        let solutions = robot.inverse(&pose, &joints).unwrap();
        let off = largest_difference(solutions.preferred(), &joints);
        assert!(off < 1e-6, "{joints:?} {off}");
    }
}

#[test]
fn joints_do_not_jump_along_straight_lines() {
    let robot = polycrank();
    let mut random = Random(SEED);
    let mut followed = 0;
    for _ in 0..100 {
        let start = random.joints(&robot);
        let end = random.joints(&robot);
        let [from, to] = [start, end].map(|joints| robot.forward(&joints).unwrap());
        // From a distant posture, the inverse chooses a start with its reach well inside the range.
        let mut near = *robot.inverse(&from, &end).unwrap().preferred();
        let steps = 20_000;
        for step in 1..=steps {
            let Some(pose) = from.try_lerp_slerp(&to, f64::from(step) / f64::from(steps), 1e-9) else {
                break;
            };
            let Ok(solutions) = robot.inverse(&pose, &near) else {
                break;
            };
            let next = *solutions.preferred();
            let moved = largest_difference(&next, &near);
            // Near a singularity joints move fast on any path.
            if (step % 20 == 0 || moved > 0.05) && robot.singularity(&near).unwrap().margin < 0.02 {
                break;
            }
            assert!(moved < 0.05, "{moved} at {step} of {start:?} {end:?}");
            near = next;
            followed += 1;
        }
    }
    assert!(followed > 1_000_000, "{followed}");
}

#[test]
fn twenty_turns_there_and_back_return_every_count() {
    let coupled = PolycrankParameters { coupled: true, ..PolycrankParameters::polycrank() };
    for parameters in [PolycrankParameters::polycrank(), coupled] {
        let robot = Polycrank::new(&parameters).unwrap();
        let start = robot.joints_from_motors(&robot.home()).unwrap();
        let begin = counts(&robot, &start);
        for axis in [0, 6] {
            let mut near = start;
            let there = (0..=20_000).map(|step| TAU * f64::from(step) / 1_000.0);
            let back = (0..20_000).rev().map(|step| TAU * f64::from(step) / 1_000.0);
            let mut most = 0.0_f64;
            for angle in there.chain(back) {
                let mut joints = start;
                joints[axis] += angle;
                let pose = robot.forward(&joints).unwrap();
                near = *robot.inverse(&pose, &near).unwrap().preferred();
                most = most.max(near[axis] - start[axis]);
                let off = largest_difference(&near, &joints);
                assert!(off < 1e-6, "{angle} {off}");
            }
            assert!((most - 20.0 * TAU).abs() < 1e-6, "{most}");
            assert_eq!(counts(&robot, &near), begin);
        }
    }
}

#[test]
fn cumulative_cranks_add_the_motors_of_their_group() {
    let coupled = PolycrankParameters { coupled: true, ..PolycrankParameters::polycrank() };
    let robot = Polycrank::new(&coupled).unwrap();
    let home = robot.joints_from_motors(&robot.home()).unwrap();
    for (axis, expected) in [
        (0, [50.0, 50.0, 50.0, 0.0, 0.0, 0.0, 0.0]),
        (1, [0.0, 50.0, 50.0, 0.0, 0.0, 0.0, 0.0]),
        (3, [0.0, 0.0, 0.0, 50.0, 50.0, 50.0, 0.0]),
        (5, [0.0, 0.0, 0.0, 0.0, 0.0, 50.0, 0.0]),
        (6, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 50.0]),
    ] {
        let mut joints = home;
        joints[axis] += 1.0;
        let motors = robot.motors_from_joints(&joints).unwrap();
        assert!(largest_difference(&motors, &expected) < 1e-11, "{axis}");
    }
}

#[test]
fn the_most_dexterous_reach_is_no_worse_than_any_other() {
    let robot = polycrank();
    let mut random = Random(SEED);
    let best = |solutions: &Solutions| {
        let margins = solutions.iter().map(|s| robot.singularity(s).unwrap().margin);
        margins.fold(0.0, f64::max)
    };
    for _ in 0..20 {
        let joints = random.joints(&robot);
        let near = random.joints(&robot);
        let pose = robot.forward(&joints).unwrap();
        let found = best(&robot.most_dexterous(&pose, &near).unwrap());
        for sample in -300..=300 {
            let reach = 0.001 * f64::from(sample);
            let Ok(other) = robot.inverse_at(&pose, &near, reach) else {
                continue;
            };
            assert!(best(&other) < 1.02 * found, "{joints:?} {reach}");
        }
    }
}

#[test]
fn what_no_branch_reaches_and_what_every_branch_leaves_open_is_refused() {
    let robot = polycrank();
    let near = robot.joints_from_motors(&robot.home()).unwrap();
    let level = robot.forward(&near).unwrap();
    let mut far = level;
    far.translation.vector.z += 0.5;
    match robot.inverse(&far, &near) {
        Err(KinematicsError::Unreachable { margin }) => {
            let height = robot.forward(&near).unwrap().translation.vector.z - 0.707;
            assert!((margin - (height + 0.5 - 0.302)).abs() < 1e-12, "{margin}");
        }
        other => panic!("{other:?}"),
    }
    let reach = robot.reach(&near).unwrap();
    match robot.inverse_at(&level, &near, 0.4) {
        Err(KinematicsError::Unreachable { margin }) => assert!(margin > 0.05, "{margin}"),
        other => panic!("{other:?}"),
    }
    assert!(robot.inverse_at(&level, &near, reach).is_ok());
    let spoilt = robot.inverse_at(&level, &near, f64::NAN);
    assert_eq!(spoilt, Err(KinematicsError::NotFinite));

    // Both pairs of cranks stretched; one pair folded.
    for (joints, axis, within) in
        [([0.3, 0.0, 0.9, 0.4, 0.0, 1.0, 0.0], 4, 1e-5), ([0.3, PI, 0.9, 0.4, 0.0, 1.0, 0.0], 4, 1e-5)]
    {
        let joints = Joints::from(joints);
        let pose = robot.forward(&joints).unwrap();
        let measured = robot.singularity(&joints).unwrap();
        assert!(measured.margin < 1e-9, "{joints:?} {measured:?}");
        match robot.inverse_at(&pose, &joints, robot.reach(&joints).unwrap()) {
            Err(KinematicsError::Singular { axis: named, margin }) => {
                assert_eq!(named, axis, "{joints:?}");
                assert!(margin < within, "{margin}");
            }
            other => panic!("{joints:?}: {other:?}"),
        }
    }
    // A single stretched pair of cranks leaves six directions of motion.
    for axis in [1, 4] {
        let mut joints = Joints::from([0.3, 1.0, 0.2, 0.4, 1.0, 0.0, 0.0]);
        joints[axis] = 0.0;
        assert!(robot.singularity(&joints).unwrap().margin > 1e-3);
    }
}

/// The 24 orientations whose axes are parallel to the axes of the base frame.
fn axis_aligned() -> Vec<UnitQuaternion<f64>> {
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    let signed: Vec<_> = axes.into_iter().flat_map(|axis| [axis, -axis]).collect();
    let mut found = Vec::new();
    for z in &signed {
        for x in signed.iter().filter(|x| x.dot(z) == 0.0) {
            let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[*x, z.cross(x), *z]));
            found.push(UnitQuaternion::from_rotation_matrix(&axes));
        }
    }
    found
}

#[test]
fn all_axis_aligned_orientations_are_reached() {
    let robot = polycrank();
    let home = robot.joints_from_motors(&robot.home()).unwrap();
    let orientations = axis_aligned();
    assert_eq!(orientations.len(), 24);
    for position in [[0.2, 0.2, 0.8], [-0.25, 0.1, 0.7], [0.3, -0.1, 0.6]] {
        for rotation in &orientations {
            let pose = Isometry3::from_parts(Translation3::from(Vector3::from(position)), *rotation);
            let solved = *robot.inverse(&pose, &home).unwrap_or_else(|error| panic!("{pose}: {error}")).preferred();
            let (distance, angle) = apart(&robot.forward(&solved).unwrap(), &pose);
            assert!(distance < 1e-9 && angle < 1.5e-8, "{pose}: {distance} {angle}");
            // A robot that is told to stand does not move.
            let again = *robot.inverse(&pose, &solved).unwrap().preferred();
            assert!(largest_difference(&again, &solved) < 1e-7, "{pose}: {again:?} near {solved:?}");
        }
    }
}

#[test]
fn parameters_come_through_the_cell_file_and_unsound_ones_are_refused() {
    let parameters = PolycrankParameters::polycrank();
    let text = toml::to_string(&parameters).unwrap();
    assert_eq!(toml::from_str(&text), Ok(parameters));
    type Change = fn(&mut PolycrankParameters);
    let cases: [(Change, ParameterError); 4] = [
        (|p| p.upper_cranks[1] = 0.0, ParameterError::NotPositive { name: "upper_cranks", value: 0.0 }),
        (|p| p.forearm_offsets[1] = f64::NAN, ParameterError::NotFinite { name: "forearm_offsets" }),
        (|p| p.axes[3].ratio = 0.0, ParameterError::NoRatio { name: "q4" }),
        (|p| p.axes[2].joint_limits.high = 1.0, ParameterError::NotFinite { name: "q3" }),
    ];
    for (change, error) in cases {
        let mut parameters = PolycrankParameters::polycrank();
        change(&mut parameters);
        assert_eq!(Polycrank::new(&parameters), Err(error));
    }
    let links = polycrank().links();
    assert!(links.iter().all(|link| link.kind == LinkKind::Continuous));
}

#[test]
fn a_turn_is_chosen_within_the_range_of_a_motor_that_two_cranks_carry() {
    let mut parameters = PolycrankParameters { coupled: true, ..PolycrankParameters::polycrank() };
    parameters.axes[2].motor_limits = Limits { low: -500.0, high: 500.0 };
    let robot = Polycrank::new(&parameters).unwrap();
    let mut joints = robot.joints_from_motors(&robot.home()).unwrap();
    joints[0] += 8.0;
    let mut near = joints;
    near[2] += TAU;
    let pose = robot.forward(&joints).unwrap();
    let solutions = robot.inverse(&pose, &near).unwrap();
    let off = solutions.iter().map(|s| largest_difference(s, &joints));
    assert!(off.fold(f64::INFINITY, f64::min) < 1e-6, "{solutions:?}");
}
