//! Chains, compared with the built-in robots, with tables of Denavit and Hartenberg, and with themselves.

mod arms;
mod golden;
mod refusals;

use super::*;

fn made(parameters: &ChainParameters) -> Chain {
    Chain::new(parameters).unwrap()
}

#[test]
fn built_in_robots_as_chains_have_the_same_flange() {
    for (name, robot) in robots() {
        let chain = made(&arms::built_in(&*robot));
        let mut random = Random(SEED);
        for _ in 0..1_000 {
            let joints = random.joints(&*robot);
            let relative = chain.joints_from_motors(&Motors::new(&joints).unwrap()).unwrap();
            let (distance, angle) = apart(&chain.forward(&relative).unwrap(), &robot.forward(&joints).unwrap());
            assert!(distance < 1e-12 && angle < 1e-12, "{name} {joints:?} {distance} {angle}");
        }
    }
}

/// The postures of a pose.
type Solved = Result<Solutions, KinematicsError>;

/// Number of random reachable poses without a solution from a random posture. Every solution is checked.
fn unsolved(
    name: &str,
    chain: &Chain,
    poses: usize,
    mut solve: impl FnMut(&Isometry3<f64>, &Joints) -> Solved,
) -> usize {
    let mut random = Random(SEED);
    let mut failures = 0;
    for _ in 0..poses {
        let (joints, near) = (random.joints(chain), random.joints(chain));
        let pose = chain.forward(&joints).unwrap();
        match solve(&pose, &near) {
            Ok(solutions) => check(name, chain, &pose, &near, &solutions),
            Err(error) => {
                failures += 1;
                println!("{name} {joints:?} near {near:?}: {error}");
            }
        }
    }
    failures
}

/// Checks that solutions reach the pose within the limits, and come nearest first.
fn check(name: &str, chain: &Chain, pose: &Isometry3<f64>, near: &Joints, solutions: &Solutions) {
    for solution in solutions.iter() {
        let (distance, angle) = apart(&chain.forward(solution).unwrap(), pose);
        assert!(distance < 1e-9 && angle < 1e-9, "{name} {solution:?}: {distance} {angle}");
        assert!(chain.motors_from_joints(solution).is_ok(), "{name} {solution:?}");
    }
    let travels = solutions.iter().map(|solution| largest_difference(solution, near));
    assert!(travels.is_sorted(), "{name} near {near:?}: {solutions:?}");
}

#[test]
fn inverse_finds_reachable_poses_of_public_arms() {
    for (name, parameters) in arms::public() {
        let chain = made(&parameters);
        let failures = unsolved(name, &chain, 1_000, |pose, near| chain.inverse(pose, near));
        assert!(failures <= 1, "{name}: {failures}");
    }
}

#[test]
fn the_numerical_solver_finds_reachable_poses_of_public_arms() {
    for (name, parameters) in arms::public() {
        let chain = made(&parameters);
        let (mut starts, mut steps) = (0, 0);
        let failures = unsolved(name, &chain, 1_000, |pose, near| {
            let (found, started, stepped) = chain.numerical(pose, near);
            (starts, steps) = (starts + started, steps + stepped);
            found
        });
        println!("{name:16} {:6.3} starts, {:6.2} steps a pose", starts as f64 / 1e3, steps as f64 / 1e3);
        assert!(failures <= 1, "{name}: {failures}");
        assert!(steps < 120_000, "{name}: {steps}");
    }
}

#[test]
fn inverse_finds_reachable_poses_of_random_chains() {
    let mut random = Random(SEED);
    let mut failed = 0;
    for number in 0..80 {
        let chain = made(&arms::random(&mut random, 1 + number % 8));
        failed += unsolved("random", &chain, 100, |pose, near| chain.inverse(pose, near));
    }
    assert!(failed <= 8, "{failed}");
}

#[test]
fn closed_forms_are_found_from_the_numbers() {
    use ClosedForm::{Cartesian, PlanarFiveAxis, Scara, SphericalWrist, ThreeParallelAxes};
    let expected = |name| match name {
        "ur3" | "ur5" | "ur10" | "irp6" => Some(ThreeParallelAxes),
        "puma560" | "kr16" | "irb140" | "crossing" | "upright" | "crossing elbow" => Some(SphericalWrist),
        "scara" => Some(Scara),
        "irb6" => Some(PlanarFiveAxis),
        "panda" | "iiwa14" | "jaco" | "polycrank" | "irp6-track" => None,
        _ => Some(Cartesian),
    };
    for (name, parameters) in arms::public() {
        assert_eq!(made(&parameters).closed_form(), expected(name), "{name}");
        let mut rounded = parameters.clone();
        for joint in &mut rounded.joints {
            let round = |number: f64| (number * 1e6).round() / 1e6;
            let (roll, pitch, yaw) = joint.parent_from_joint.rotation.euler_angles();
            joint.parent_from_joint.rotation =
                nalgebra::UnitQuaternion::from_euler_angles(round(roll), round(pitch), round(yaw));
        }
        let chain = made(&rounded);
        assert_eq!(chain.closed_form(), expected(name), "{name} with six digits");
        let failures = unsolved(name, &chain, 200, |pose, near| chain.inverse(pose, near));
        assert_eq!(failures, 0, "{name} with six digits");
    }
}

#[test]
fn closed_forms_have_the_posture_of_the_pose_among_all_branches() {
    for (name, mut parameters) in arms::public() {
        if made(&parameters).closed_form().is_none() {
            continue;
        }
        for joint in &mut parameters.joints {
            if joint.kind == LinkKind::Revolute {
                joint.limits = Limits { low: -TAU, high: TAU };
            }
        }
        let chain = made(&parameters);
        let (mut random, mut most) = (Random(SEED), 0);
        for _ in 0..500 {
            let (joints, near) = (random.joints(&chain), random.joints(&chain));
            let pose = chain.forward(&joints).unwrap();
            let solutions = chain.inverse(&pose, &near).unwrap();
            check(name, &chain, &pose, &near, &solutions);
            let is_posture = |solution: &&Joints| {
                let turns = |(a, b): (&f64, &f64)| ((a - b) / TAU - ((a - b) / TAU).round()).abs() < 1e-6;
                solution.iter().zip(joints.iter()).all(turns)
            };
            assert!(solutions.iter().any(|solution| is_posture(&solution)), "{name} {joints:?}: {solutions:?}");
            let here = *chain.inverse(&pose, &joints).unwrap().preferred();
            assert!(largest_difference(&here, &joints) < 1e-7, "{name} {joints:?} {here:?}");
            most = most.max(solutions.len());
        }
        let branches = match name {
            "ur3" | "ur5" | "ur10" | "irp6" | "puma560" | "kr16" | "irb140" => 8,
            "crossing" | "upright" | "crossing elbow" => 8,
            "irb6" => 4,
            "scara" | "gantry and wrist" => 2,
            _ => 1,
        };
        assert_eq!(most, branches, "{name}");
    }
}

#[test]
fn joints_do_not_jump_along_paths() {
    for (name, parameters) in arms::public() {
        let chain = made(&parameters);
        let mut random = Random(SEED);
        let mut jumps = 0;
        for _ in 0..20 {
            let (from, to) = (random.joints(&chain), random.joints(&chain));
            let mut near = from;
            for part in 1..=100 {
                let share = f64::from(part) / 100.0;
                let between: Vec<f64> = from.iter().zip(to.iter()).map(|(a, b)| a + share * 0.2 * (b - a)).collect();
                let pose = chain.forward(&Joints::new(&between).unwrap()).unwrap();
                let next = *chain.inverse(&pose, &near).unwrap().preferred();
                let (distance, angle) = apart(&chain.forward(&next).unwrap(), &pose);
                assert!(distance < 1e-9 && angle < 1e-9, "{name} {distance} {angle}");
                // A redundant arm may come to a dead end at a limit, which only a jump leaves.
                let stands_at_a_limit = near
                    .iter()
                    .zip(chain.joint_limits())
                    .any(|(joint, limits)| (joint - limits.low).min(limits.high - joint) < 1e-6);
                if largest_difference(&next, &near) > 0.1 && !(chain.axes() > 6 && stands_at_a_limit) {
                    jumps += 1;
                    println!("{name} {near:?} {next:?}");
                }
                near = next;
            }
        }
        assert_eq!(jumps, 0, "{name}");
    }
}

#[test]
fn singular_poses_and_limits_are_reached() {
    for (name, parameters) in arms::public() {
        let chain = made(&parameters);
        let mut random = Random(SEED);
        let mut failures = 0;
        for number in 0..400 {
            let (mut joints, mut near) = (random.joints(&chain), random.joints(&chain));
            for (joint, limits) in joints.iter_mut().zip(chain.joint_limits()) {
                let choice = random.next() % 4;
                let place = [0.0, FRAC_PI_2, -FRAC_PI_2, limits.low, limits.high][(random.next() % 5) as usize];
                if choice < 2 && place.is_finite() && limits.exceeded_by(place).is_none() {
                    *joint = place;
                }
            }
            if number % 2 == 0 {
                near = joints;
                near.iter_mut().for_each(|joint| *joint += random.within(-0.05, 0.05));
            }
            let pose = chain.forward(&joints).unwrap();
            match chain.inverse(&pose, &near) {
                Ok(solutions) => check(name, &chain, &pose, &near, &solutions),
                Err(error) => {
                    failures += 1;
                    println!("{name} {joints:?} near {near:?}: {error}");
                }
            }
        }
        println!("{name:16} {failures} of 400 singular poses");
        assert!(failures <= 2, "{name}: {failures}");
    }
}

#[test]
fn a_free_axis_of_the_tool_leaves_its_rotation_open() {
    let mut random = Random(SEED);
    let mut failures = 0;
    for number in 0..20 {
        let mut parameters = arms::random(&mut random, 5 + number % 3);
        let axis = Vector3::new(0.2, -0.5, 1.0).normalize();
        parameters.free_axis = Some((axis * 2.0).into());
        let chain = made(&parameters);
        assert_eq!(chain.closed_form(), None);
        for _ in 0..50 {
            let (joints, near) = (random.joints(&chain), random.joints(&chain));
            let flange = chain.forward(&joints).unwrap();
            let pose = flange * Isometry3::rotation(axis * random.within(-3.0, 3.0));
            let Ok(solutions) = chain.inverse(&pose, &near) else {
                failures += 1;
                continue;
            };
            let reached = chain.forward(solutions.preferred()).unwrap();
            let distance = (reached.translation.vector - pose.translation.vector).norm();
            let lean = (reached.rotation * axis).cross(&(pose.rotation * axis)).norm();
            assert!(distance < 1e-9 && lean < 1e-9, "{joints:?} {distance} {lean}");
        }
    }
    assert!(failures <= 1, "{failures}");
}

#[test]
fn the_jacobian_is_the_derivative_of_forward_kinematics_and_the_sum_of_screws() {
    let mut random = Random(SEED);
    let chains = (0..40).map(|number| arms::random(&mut random, 1 + number % 8));
    let chains: Vec<_> = chains.chain(arms::public().into_iter().map(|(_, parameters)| parameters)).collect();
    for parameters in chains {
        let chain = made(&parameters);
        for _ in 0..20 {
            let joints = random.joints(&chain);
            let jacobian = chain.jacobian(&joints).unwrap();
            let flange = chain.forward(&joints).unwrap();
            let mut frame = Isometry3::identity();
            for (axis, link) in chain.links().iter().enumerate() {
                frame *= link.placed(&joints);
                let along = frame.rotation * link.axis.into_inner();
                let lever = flange.translation.vector - frame.translation.vector;
                let prismatic = link.kind == LinkKind::Prismatic;
                let (linear, angular) =
                    if prismatic { (along, Vector3::zeros()) } else { (along.cross(&lever), along) };
                let column = jacobian.column(axis);
                let apart =
                    (column.fixed_rows::<3>(0) - linear).amax().max((column.fixed_rows::<3>(3) - angular).amax());
                assert!(apart < 1e-12, "{joints:?} axis {axis}: {apart}");
            }
        }
        derivative("chain", &chain, 10);
    }
}

#[test]
fn motors_follow_from_joints_by_ratios_homes_and_couplings() {
    let mut parameters = arms::panda();
    parameters.joints.truncate(2);
    for (joint, (ratio, at_home, motor)) in parameters.joints.iter_mut().zip([(100.0, 0.1, -20.0), (-50.0, -0.2, 30.0)])
    {
        (joint.ratio, joint.joint_at_home, joint.motor_at_home) = (ratio, at_home, motor);
    }
    let joints = Joints::from([0.6, 0.3]);
    let motors = made(&parameters).motors_from_joints(&joints).unwrap();
    assert!(largest_difference(&motors, &[30.0, 5.0]) < 1e-12, "{motors:?}");
    assert_eq!(&made(&parameters).home()[..], [-20.0, 30.0]);
    parameters.motors_from_joints = Some(vec![vec![100.0, 10.0], vec![0.0, -50.0]]);
    let chain = made(&parameters);
    let motors = chain.motors_from_joints(&joints).unwrap();
    assert!(largest_difference(&motors, &[35.0, 5.0]) < 1e-12, "{motors:?}");
    assert!(largest_difference(&chain.joints_from_motors(&motors).unwrap(), &joints) < 1e-14);
    // Every corner of the joint ranges lies within the motor ranges, and two corners are their ends.
    let (low, high) = (chain.motor_limits()[0].low, chain.motor_limits()[0].high);
    assert!((low - (-20.0 - 289.73 - 10.0 - 17.628 + 2.0)).abs() < 1e-9, "{low}");
    assert!((high - (-20.0 + 289.73 - 10.0 + 17.628 + 2.0)).abs() < 1e-9, "{high}");
    for first in [-2.8973, 2.8973] {
        for second in [-1.7628, 1.7628] {
            chain.motors_from_joints(&Joints::from([first, second])).unwrap();
        }
    }
}

#[test]
fn a_load_weighs_at_the_flange_and_not_at_the_last_link() {
    let mut parameters = arms::panda();
    parameters.joints.truncate(1);
    let tilted = Isometry3::rotation(Vector3::x() * -FRAC_PI_2);
    (parameters.joints[0].parent_from_joint, parameters.joints[0].ratio) = (tilted, 10.0);
    parameters.link_from_flange = Isometry3::translation(0.5, 0.0, 0.0) * tilted;
    let chain = made(&parameters);
    let load = Mass { mass: 2.0, centre: [0.1, 0.0, 0.0] };
    let weight = Weight::new(&chain, &[Mass::default()], load, parameters.up).unwrap();
    // A positive angle lowers the load.
    let torque = weight.torque(&chain, &chain.home()).unwrap()[0];
    assert!((torque + 2.0 * 9.81 * 0.6 / 10.0).abs() < 1e-6, "{torque}");
    let placed = chain.links()[0].placed(&Joints::from([0.7])) * chain.link_from_flange();
    let (distance, angle) = apart(&placed, &chain.forward(&Joints::from([0.7])).unwrap());
    assert!(distance < 1e-15 && angle < 1e-15);
}
