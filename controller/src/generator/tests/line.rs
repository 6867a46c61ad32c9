//! Lines of the real robots.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::*;
use crate::robot::{Arm, Irb6, Irb6Parameters, Irp6, Irp6Parameters, KinematicsError};

const LIMITS: LineLimits = LineLimits {
    max_velocity: 0.25,
    max_acceleration: 1.0,
    max_jerk: 10.0,
    max_angular_velocity: 1.0,
    max_angular_acceleration: 4.0,
    max_angular_jerk: 40.0,
};

fn joint_limits() -> MotionLimits {
    MotionLimits::uniform(1.5, 7.0, 70.0)
}

fn irp6() -> Arm {
    let robot = Irp6::new(&Irp6Parameters::irp6p()).unwrap();
    Arm::new(Arc::new(robot), Pose::translation(0.0, 0.0, 0.25))
}

fn irb6() -> Arm {
    let robot = Irb6::new(&Irb6Parameters::irb6()).unwrap();
    Arm::new(Arc::new(robot), Pose::identity())
}

/// The arm at standstill with these joints.
fn standing(arm: &Arm, joints: Axes) -> Standing {
    Standing(AxesState::at_rest(joints), arm.forward(&joints).unwrap())
}

/// Joints in the middle of the IRp-6's workspace, the wrist bent.
const BENT: Axes = [0.2, -FRAC_PI_2, 0.1, 0.2, 1.2, 0.3, 0.0, 0.0];

fn beside(pose: &Pose, by: Vector3<f64>, turn: Vector3<f64>) -> Pose {
    let rotation = UnitQuaternion::from_scaled_axis(turn) * pose.rotation;
    Pose::from_parts(Translation3::from(pose.translation.vector + by), rotation)
}

/// Distance of the tool's origin from the line.
fn aside(arm: &Arm, joints: &Axes, from: &Pose, to: &Pose) -> f64 {
    let along = (to.translation.vector - from.translation.vector).normalize();
    let offset = arm.forward(joints).unwrap().translation.vector - from.translation.vector;
    (offset - along * along.dot(&offset)).norm()
}

/// Largest distance from the line while motors follow quintics between the macrostep ends.
fn chord_error(arm: &Arm, states: &[AxesState], from: &Pose, to: &Pose) -> f64 {
    const DT: f64 = 1e-4;
    let motors = |state: &AxesState| {
        let push = state.acceleration.unwrap_or_default();
        let joints = |t: f64| std::array::from_fn(|i| state.position[i] + t * (state.velocity[i] + t * push[i] / 2.0));
        let [behind, here, ahead] = [-DT, 0.0, DT].map(|t| arm.motors(&joints(t)).unwrap());
        let knot = |i: usize| Knot {
            position: here[i],
            velocity: (ahead[i] - behind[i]) / (2.0 * DT),
            acceleration: (ahead[i] - 2.0 * here[i] + behind[i]) / (DT * DT),
        };
        std::array::from_fn::<_, { MAX_AXES }, _>(knot)
    };
    let mut worst: f64 = 0.0;
    for pair in states.windows(2) {
        let (start, end) = (motors(&pair[0]), motors(&pair[1]));
        for period in 1..10 {
            let u = f64::from(period) / 10.0;
            let between = std::array::from_fn(|i| quintic(start[i], end[i], MC, u).position);
            worst = worst.max(aside(arm, &arm.joints(&between).unwrap(), from, to));
        }
    }
    worst
}

fn check_limits(states: &[AxesState], limits: &MotionLimits, seed: u64) {
    for pair in states.windows(2) {
        for axis in 0..6 {
            let (speed, push) = peaks(knot(&pair[0], axis), knot(&pair[1], axis));
            assert!(speed <= limits.max_velocity[axis] * 1.02, "seed {seed} axis {axis} {speed}");
            assert!(push <= limits.max_acceleration[axis] * 1.05, "seed {seed} axis {axis} {push}");
        }
    }
}

#[test]
fn a_line_is_straight_turns_the_shortest_way_and_ends_exactly() {
    let arm = irp6();
    let start = standing(&arm, BENT);
    let target = beside(&start.1, Vector3::new(0.1, -0.15, 0.05), Vector3::new(0.0, 0.0, 0.4));
    let states = walk(StraightLine::new(arm.clone(), target, LIMITS, joint_limits()).unwrap(), &start).unwrap();

    let length = (target.translation.vector - start.1.translation.vector).norm();
    let angle = start.1.rotation.angle_to(&target.rotation);
    assert!((angle - 0.4).abs() < 1e-9);
    for state in &states {
        let pose = arm.forward(&state.position).unwrap();
        assert!(aside(&arm, &state.position, &start.1, &target) < 1e-9);
        let s = (pose.translation.vector - start.1.translation.vector).norm() / length;
        assert!((start.1.rotation.angle_to(&pose.rotation) - s * angle).abs() < 1e-7, "turns along with the way");
        assert!((pose.rotation.angle_to(&target.rotation) - (1.0 - s) * angle).abs() < 1e-7);
    }
    let end = states.last().unwrap();
    assert_eq!(end.velocity, Axes::default());
    assert!((arm.forward(&end.position).unwrap().translation.vector - target.translation.vector).norm() < 1e-12);
    // D/v + v/a + a/j with both plateaus, rounded up.
    let time: f64 = length / 0.25 + 0.25 / 1.0 + 1.0 / 10.0;
    assert_eq!(states.len() - 1, (time / MC).ceil() as usize);
}

#[test]
fn joints_never_exceed_their_limits_on_a_line_and_motors_leave_it_by_nanometres() {
    let arm = irp6();
    let weak = MotionLimits::uniform(0.5, 1.0, 50.0);
    let mut walked = 0;
    let mut worst: f64 = 0.0;
    for seed in 0..400 {
        let mut random = Random(seed);
        let mut joints = BENT;
        for joint in joints.iter_mut().take(6) {
            *joint += random.within(-0.3, 0.3);
        }
        let start = standing(&arm, joints);
        let mut direction =
            || Vector3::new(random.within(-1.0, 1.0), random.within(-1.0, 1.0), random.within(-1.0, 1.0));
        let target = beside(&start.1, direction() * 0.3, direction() * 0.4);
        match walk(StraightLine::new(arm.clone(), target, LIMITS, weak).unwrap(), &start) {
            Ok(states) => {
                walked += 1;
                check_limits(&states, &weak, seed);
                worst = worst.max(chord_error(&arm, &states, &start.1, &target));
            }
            Err(GeneratorError::Path { .. } | GeneratorError::Jump { .. } | GeneratorError::Turn { .. }) => {}
            Err(error) => panic!("seed {seed}: {error}"),
        }
    }
    println!("{walked} of 400 walked, worst chord error {worst:.3e} m");
    assert!(walked > 200, "{walked}");
    assert!(worst < 100e-9, "{worst}");
}

#[test]
fn a_turn_beyond_the_range_of_a_motor_is_refused_as_such() {
    let robot = Irp6::new(&Irp6Parameters::irp6p()).unwrap();
    let arm = Arm::new(Arc::new(robot), Pose::identity());
    let rolled = |roll: f64| {
        let mut joints = BENT;
        joints[4] = roll;
        standing(&arm, joints)
    };
    // At this pitch, the motor of the roll ends at a roll of 6.37 rad. The turn back is another turn of the roll.
    let target = rolled(6.6 - std::f64::consts::TAU).1;
    let line = StraightLine::new(arm.clone(), target, LIMITS, joint_limits()).unwrap();
    let error = walk(line, &rolled(6.3)).unwrap_err();
    let GeneratorError::Turn { axis: 4, by, .. } = error else { panic!("{error:?}") };
    assert!((6.0..6.3).contains(&by), "{by}");
    let text = error.to_string();
    assert!(text.contains("axis 4 would turn back by 6.2") && text.contains("begin the path"), "{text}");
    // From the other turn, the line is walked.
    let line = StraightLine::new(arm.clone(), target, LIMITS, joint_limits()).unwrap();
    walk(line, &rolled(6.3 - std::f64::consts::TAU)).unwrap();
}

#[test]
fn a_line_past_a_singular_wrist_is_walked_slower() {
    let arm = irp6();
    let walk_up = |roll: f64| {
        let mut joints = BENT;
        joints[4] = roll;
        let start = standing(&arm, joints);
        let target = beside(&start.1, Vector3::new(0.0, 0.1, 0.05), Vector3::zeros());
        walk(StraightLine::new(arm.clone(), target, LIMITS, joint_limits()).unwrap(), &start).unwrap()
    };
    let (near, far) = (walk_up(0.1), walk_up(1.2));
    println!("{} macrosteps near, {} far from it", near.len(), far.len());
    assert!(near.len() > far.len() + 5);
    check_limits(&near, &joint_limits(), 0);
}

#[test]
fn what_lies_out_of_reach_is_found_before_the_motion_begins() {
    let arm = irp6();
    let start = standing(&arm, BENT);
    let plan = |target: Pose| walk(StraightLine::new(arm.clone(), target, LIMITS, joint_limits()).unwrap(), &start);
    let far = beside(&start.1, Vector3::new(2.0, 0.0, 0.0), Vector3::zeros());
    let Err(GeneratorError::Path { s, cause }) = plan(far) else { panic!("two metres further") };
    assert!(s > 0.05 && s < 0.5, "{s}");
    assert!(matches!(cause, KinematicsError::BeyondLimit { .. } | KinematicsError::Unreachable { .. }), "{cause}");
}

#[test]
fn five_axes_walk_a_line_with_the_tool_down_and_refuse_one_with_it_aslant() {
    let arm = irb6();
    let joints = [0.3, -FRAC_PI_2, 0.1, FRAC_PI_2, 0.5, 0.0, 0.0, 0.0];
    let start = standing(&arm, joints);
    let across = |start: &Standing| {
        let target = beside(&start.1, Vector3::new(-0.1, 0.2, 0.05), Vector3::zeros());
        walk(StraightLine::new(irb6(), target, LIMITS, joint_limits()).unwrap(), start)
    };
    let states = across(&start).unwrap();
    let target = beside(&start.1, Vector3::new(-0.1, 0.2, 0.05), Vector3::zeros());
    let chord = chord_error(&arm, &states, &start.1, &target);
    println!("IRb-6 chord error {chord:.3e} m");
    assert!(chord < 100e-9, "{chord}");

    let aslant = standing(&arm, [0.3, -FRAC_PI_2, 0.1, 0.8, 0.5, 0.0, 0.0, 0.0]);
    let Err(GeneratorError::Path { cause: KinematicsError::ToolPlane { .. }, .. }) = across(&aslant) else {
        panic!("the tool would leave the arm's plane")
    };
}

#[test]
fn a_line_to_where_the_tool_is_ends_at_once() {
    let arm = irp6();
    let start = standing(&arm, BENT);
    let states = walk(StraightLine::new(arm, start.1, LIMITS, joint_limits()).unwrap(), &start).unwrap();
    assert_eq!(states.len(), 1);
}

#[test]
fn lines_with_senseless_limits_are_refused() {
    let new = |target, limits| StraightLine::new(irp6(), target, limits, joint_limits()).map(|_| ());
    let still = LineLimits { max_velocity: 0.0, ..LIMITS };
    assert_eq!(new(Pose::identity(), still), Err(GeneratorError::PathLimit));
    let nowhere = Pose::translation(0.0, f64::NAN, 0.0);
    assert_eq!(new(nowhere, LIMITS), Err(GeneratorError::TargetNotFinite { coordinate: "y" }));
}
