//! Paths and grips of carried objects, by hand and by differences.

use std::f64::consts::PI;

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::*;
use crate::robot::{Irb6Parameters, RobotParameters};

const LIMITS: ObjectLimits = ObjectLimits { velocity: 0.1, acceleration: 0.4, radius: 0.4 };

fn pose(x: f64, y: f64, z: f64, [roll, yaw]: [f64; 2]) -> Pose {
    Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(roll, 0.0, yaw))
}

/// Two arms that face each other at 2.2 m, and hold a bar by grips 0.8 m apart with vertical tools.
fn grips() -> Grips {
    Grips {
        cell_from_base: [Pose::identity(), pose(2.2, 0.0, 0.0, [0.0, PI])],
        object_from_tool: [pose(-0.4, 0.0, 0.0, [PI, 0.0]), pose(0.4, 0.0, 0.0, [PI, PI])],
    }
}

fn arm() -> Arm {
    Arm::new(Irb6Parameters::irb6().robot().unwrap(), Pose::translation(0.0, 0.0, 0.25))
}

const BENT: Axes = [0.0, -1.571, 0.0, 1.571, 0.0, 0.0, 0.0, 0.0];

fn path(places: &[[f64; 4]]) -> ObjectPath {
    ObjectPath::through(places, &LIMITS).unwrap()
}

const ROUND: [[f64; 4]; 4] =
    [[1.1, 0.0, 0.8, 0.0], [1.1, 0.0, 0.86, 0.0], [1.13, 0.1, 0.86, 0.1], [1.1, 0.0, 0.8, 0.0]];

#[test]
fn motion_of_object_and_grips_is_the_derivative_of_their_poses() {
    let (path, grips) = (path(&ROUND), grips());
    let step = 1e-4;
    let mut time = 0.013;
    while time < path.duration() - 0.01 {
        for member in 0..2 {
            let at = |time: f64| grips.tool(member, &path.at(time));
            let (before, now, after) = (at(time - step), at(time), at(time + step));
            let position = |state: &PoseState| state.pose.translation.vector;
            let velocity = (position(&after) - position(&before)) / (2.0 * step);
            assert!((velocity - now.linear).norm() < 1e-6, "{time} s: {velocity} {}", now.linear);
            let acceleration = (after.linear - before.linear) / (2.0 * step);
            assert!((acceleration - now.linear_acceleration).norm() < 2e-3, "{time} s");
            let turned = (after.pose.rotation * before.pose.rotation.inverse()).scaled_axis() / (2.0 * step);
            assert!((turned - now.angular).norm() < 1e-6, "{time} s");
            let change = (after.angular - before.angular) / (2.0 * step);
            assert!((change - now.angular_acceleration).norm() < 5e-3, "{time} s");
        }
        time += 0.01;
    }
}

#[test]
fn path_keeps_its_limits_and_reaches_them() {
    let path = path(&ROUND);
    let (mut fastest, mut hardest) = (0.0_f64, 0.0_f64);
    for step in 0..=(path.duration() * 1e3) as u32 {
        let state = path.at(f64::from(step) * 1e-3);
        fastest = fastest.max(state.linear.norm()).max(0.4 * state.angular.norm());
        hardest = hardest.max(state.linear_acceleration.norm());
        assert!(path.distance(&state.pose.translation.vector) < 1e-9);
    }
    assert!((fastest - 0.1).abs() < 1e-6, "{fastest}");
    assert!((0.35..0.4 + 1e-9).contains(&hardest), "{hardest}");
    let end = path.at(path.duration() + 1.0);
    assert_eq!((end.pose.translation.vector, end.linear), (Vector3::new(1.1, 0.0, 0.8), Vector3::zeros()));
    assert!((path.distance(&Vector3::new(1.1, 0.002, 0.83)) - 0.002).abs() < 1e-9);
}

#[test]
fn paths_without_length_or_limits_are_refused() {
    let through = |places: &[[f64; 4]], limits| ObjectPath::through(places, limits).unwrap_err();
    assert_eq!(through(&[[0.0; 4]], &LIMITS), CarryError::Places { given: 1 });
    assert_eq!(through(&[[0.0; 4], [0.0; 4]], &LIMITS), CarryError::Leg { number: 0 });
    let places = [[0.0; 4], [1.0; 4], [f64::NAN; 4]];
    assert_eq!(through(&places, &LIMITS), CarryError::Leg { number: 1 });
    let limits = ObjectLimits { velocity: 0.0, ..LIMITS };
    assert_eq!(through(&ROUND, &limits), CarryError::Limit { limit: "velocity", value: 0.0 });
}

#[test]
fn a_bar_within_reach_is_accepted_and_one_that_does_not_reach_is_refused_with_its_place() {
    let arm = arm();
    let check = |places: &[[f64; 4]]| grips().check(&path(places), [&arm, &arm], [BENT; 2], [[1.0; 8]; 2]);
    assert_eq!(check(&ROUND), Ok(()));
    // Too close to the left arm.
    let far = check(&[[1.1, 0.0, 0.8, 0.0], [0.6, 0.0, 0.8, 0.0]]).unwrap_err();
    let CarryError::Unreachable { member: 0, time, at: [x, y, z], .. } = far else { panic!("{far}") };
    assert!(time > 1.0 && x > 0.2 && x < 0.5 && y.abs() < 1e-12 && (z - 0.8).abs() < 1e-12, "{far}");
    let said = far.to_string();
    assert!(said.starts_with("the grip of member 0 does not reach (") && !said.contains('\n'), "{said}");
    // A bar that leans needs a sixth axis.
    let mut leaning = grips();
    leaning.object_from_tool[0] = pose(-0.4, 0.0, 0.0, [PI - 0.1, 0.0]);
    let refused = leaning.check(&path(&ROUND), [&arm, &arm], [BENT; 2], [[1.0; 8]; 2]).unwrap_err();
    assert!(
        matches!(refused, CarryError::Unreachable { member: 0, cause: KinematicsError::ToolPlane { .. }, .. }),
        "{refused}"
    );
}

#[test]
fn a_path_on_which_a_joint_is_too_fast_is_refused_with_arm_and_axis() {
    let arm = arm();
    let check = |fastest| grips().check(&path(&ROUND), [&arm, &arm], [BENT; 2], fastest);
    // The tool of each arm is 0.7 m from its column, and moves at up to 0.1 m/s.
    let mut fastest = [[1.0; 8]; 2];
    fastest[1][0] = 0.05;
    let refused = check(fastest).unwrap_err();
    let CarryError::TooFast { member: 1, axis: 0, time, velocity, limit: 0.05 } = refused else { panic!("{refused}") };
    // The second leg, after 0.06 m upward, moves the bar sideways.
    assert!(time > 0.6 && (0.05..0.16).contains(&velocity), "{refused}");
    let said = refused.to_string();
    assert!(said.starts_with("joint 0 of member 1 would move at 0.0") && !said.contains('\n'), "{said}");
    fastest[1][0] = 0.2;
    assert_eq!(check(fastest), Ok(()));
    for none in [f64::NAN, 0.0] {
        fastest[0][2] = none;
        assert!(matches!(check(fastest), Err(CarryError::TooFast { member: 0, axis: 2, .. })), "{none}");
    }
}

#[test]
fn internal_force_is_half_the_difference_of_the_forces_on_the_object() {
    let grips = grips();
    // The grips press with 20 N, and share a weight of 40 N. The base of the second arm is turned by half a turn.
    let on_tools = [Vector3::new(-20.0, 0.0, -20.0), Vector3::new(-20.0, 0.0, -20.0)];
    let internal = grips.internal(on_tools);
    assert!((internal - Vector3::new(20.0, 0.0, 0.0)).norm() < 1e-9, "{internal}");
    let [first, second] = grips.on_object(on_tools);
    assert!((first + second - Vector3::new(0.0, 0.0, 40.0)).norm() < 1e-9);
    let object = pose(1.1, 0.0, 0.8, [0.0, 0.3]);
    let tools = [0, 1].map(|member| grips.tool(member, &PoseState { pose: object, ..PoseState::default() }).pose);
    let found = grips.object([&tools[0], &tools[1]]);
    assert!((found.translation.vector - object.translation.vector).norm() < 1e-12);
    assert!(found.rotation.angle_to(&object.rotation) < 1e-7);
    assert!((grips.line(&object) - Vector3::new(0.3_f64.cos(), 0.3_f64.sin(), 0.0)).norm() < 1e-12);
}

/// Runs the coordinator against a spring between two grips whose distance is wrong by `error`, m, and returns the force at
/// each macrostep, N.
fn squeeze(regulation: Regulation, error: f64) -> Vec<f64> {
    let at_rest = path(&[[1.1, 0.0, 0.8, 0.0], [1.1, 0.0, 0.8, 0.5]]);
    let mut carry = Carry::new(grips(), at_rest, regulation, 1e3);
    let mut next = carry.first_step(&(), Duration::from_millis(20)).unwrap();
    let mut forces = Vec::new();
    let mut last = 0.0;
    for _ in 0..200 {
        // Two grips of 1e5 N/m in series.
        let force = 5e4 * (error - 2.0 * next.memory.opening);
        forces.push(force);
        let object = carry.path.at(f64::from(next.memory.step) * 0.02).pose;
        let line = grips().line(&object);
        // The answers are of the macrostep before.
        let on_tools = [0, 1].map(|member| {
            let toward = grips().cell_from_base[member].rotation.inverse() * line * [-1.0, 1.0][member];
            let value = GripForce { on_tool: toward * last };
            Sample { at: can::Instant::ZERO, age: Duration::ZERO, value }
        });
        last = force;
        next = carry.next_step(&next.memory, &on_tools, &()).unwrap();
    }
    forces
}

#[test]
fn regulation_in_the_coordinator_relaxes_a_bar_of_the_wrong_length() {
    let kept = squeeze(Regulation::None, 1e-3);
    assert!(kept.iter().all(|force| (force - 50.0).abs() < 1e-9));
    let relaxed = squeeze(Regulation::MACROSTEP, 1e-3);
    assert!(relaxed[150..].iter().all(|force| force.abs() < 0.5), "{relaxed:?}");
    assert!(relaxed.iter().all(|force| force.abs() <= 50.0 + 1e-9), "{relaxed:?}");
}

#[test]
fn a_force_above_the_limit_ends_the_motion() {
    let mut carry = Carry::new(grips(), path(&ROUND), Regulation::None, 30.0);
    let first = carry.first_step(&(), Duration::from_millis(20)).unwrap();
    let answers = |force: f64| {
        let value = GripForce { on_tool: Vector3::new(-force, 0.0, 0.0) };
        [Sample { at: can::Instant::ZERO, age: Duration::ZERO, value }; 2]
    };
    assert!(carry.next_step(&first.memory, &answers(29.0), &()).is_ok());
    assert_eq!(carry.next_step(&first.memory, &answers(31.0), &()), Err(Carry::TOO_GREAT));
    assert_eq!(carry.next_step(&first.memory, &answers(f64::NAN), &()), Err(Carry::TOO_GREAT));
}

#[test]
fn the_law_of_each_arm_gets_the_mean_force_along_the_line_between_the_grips() {
    let compliance = Compliance { inertia: 80.0, reciprocal_damping: 1.25e-3 };
    let mut carry = Carry::new(grips(), path(&ROUND), Regulation::CYCLE, 1e3);
    let first = carry.first_step(&(), Duration::from_millis(20)).unwrap();
    // The first grip pushes with 30 N, and the second with 10 N against it: 10 N accelerate half of the object each.
    let on_tools = [Vector3::new(-30.0, 0.0, 0.0), Vector3::new(-10.0, 0.0, 0.0)];
    let answers = on_tools.map(|on_tool| {
        let value = GripForce { on_tool };
        Sample { at: can::Instant::ZERO, age: Duration::ZERO, value }
    });
    let next = carry.next_step(&first.memory, &answers, &()).unwrap();
    assert!((next.memory.pressed - 20.0).abs() < 1e-9 && (next.memory.mean - 10.0).abs() < 1e-9, "{:?}", next.memory);
    for (order, x) in next.orders.iter().zip([1.0, -1.0]) {
        let law = order.law.unwrap();
        assert!((law.line - Vector3::new(x, 0.0, 0.0)).norm() < 1e-9);
        let task = law.task();
        let turned = UnitQuaternion::from_scaled_axis(task.rotation) * Vector3::x();
        assert!((turned - law.line).norm() < 1e-9, "{turned}");
        assert_eq!(task.directions[0], Direction::Contact { force: next.memory.mean, compliance });
        assert_eq!(task.directions[1..], [Direction::HELD; 5]);
    }
}

#[test]
fn an_arm_keeps_its_displacement_from_the_start_and_refuses_a_great_one() {
    let mut hold = Hold::new(Duration::from_millis(20));
    let begin = pose(0.7, 0.0, 0.8, [PI, 0.0]);
    hold.start = Pose::translation(1e-3, 0.0, 2e-3) * begin;
    let displacement = hold.displacement(&begin).unwrap();
    assert!((displacement - Vector3::new(1e-3, 0.0, -2e-3)).norm() < 1e-12, "{displacement}");
    hold.start = Pose::translation(0.01, 0.0, 0.0) * begin;
    assert!(matches!(hold.displacement(&begin), Err(GeneratorError::NotAtStart { .. })));
}
