//! Chains: against the built-in robots, tables of Denavit and Hartenberg, and themselves.

mod arms;
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

/// How often and how well inverse kinematics succeeds.
fn solve(name: &str, parameters: &ChainParameters, poses: usize) -> (usize, usize) {
    let chain = made(parameters);
    let mut random = Random(SEED);
    let (mut failures, mut steps, mut starts, mut worst) = (0, 0, 0, (0.0_f64, 0.0_f64));
    for _ in 0..poses {
        let joints = random.joints(&chain);
        let near = random.joints(&chain);
        let pose = chain.forward(&joints).unwrap();
        let (found, started, stepped) = chain.costly(&pose, &near);
        (starts, steps) = (starts + started, steps + stepped);
        match found {
            Ok(solutions) => {
                for solution in solutions.iter() {
                    let (distance, angle) = apart(&chain.forward(solution).unwrap(), &pose);
                    worst = (worst.0.max(distance), worst.1.max(angle));
                    assert!(distance < 1e-9 && angle < 1e-9, "{name} {joints:?} near {near:?}: {distance} {angle}");
                    assert!(chain.motors_from_joints(solution).is_ok(), "{name} {solution:?}");
                }
            }
            Err(error) => {
                failures += 1;
                println!("{name} {joints:?} near {near:?}: {error}");
            }
        }
    }
    println!(
        "{name:16} {failures:5} failed, starts {:6.2}, steps {:7.2}, worst {:.1e} m {:.1e} rad",
        starts as f64 / poses as f64,
        steps as f64 / poses as f64,
        worst.0,
        worst.1
    );
    (failures, steps)
}

#[test]
fn inverse_finds_reachable_poses_of_public_arms() {
    for (name, parameters) in arms::public() {
        let (failures, _) = solve(name, &parameters, 1_000);
        assert!(failures <= 1, "{name}: {failures}");
    }
}

#[test]
fn inverse_finds_reachable_poses_of_random_chains() {
    let mut random = Random(SEED);
    let mut failed = 0;
    for number in 0..80 {
        let axes = 1 + number % 8;
        let parameters = arms::random(&mut random, axes);
        failed += solve(&format!("random of {axes}"), &parameters, 100).0;
    }
    assert!(failed <= 8, "{failed}");
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
