//! Lines of arms that stand slightly beside the planned start of the line.

use std::sync::Arc;

use nalgebra::Vector3;

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

/// Distance of each motor from its home position after homing, rad. Behind a gear of 158 the distance of the joint is
/// half a mrad.
const BESIDE: f64 = 0.08;

/// An arm at standstill with these motor positions.
struct AtMotors(EffectorState);

impl AtMotors {
    fn of(arm: &Arm, motors: Axes) -> Self {
        let joints = arm.joints(&motors).unwrap();
        Self(EffectorState {
            motors: AxesState::at_rest(motors),
            joints: AxesState::at_rest(joints),
            pose: arm.forward(&joints).unwrap(),
        })
    }

    /// Each motor beside its home position. The bits of `signs` give the sides.
    fn beside_home(arm: &Arm, signs: usize, distance: f64) -> Self {
        let mut motors: Axes = arm.robot().home().padded();
        for (axis, motor) in motors.iter_mut().enumerate().take(arm.axes()) {
            *motor += if signs >> axis & 1 == 1 { -distance } else { distance };
        }
        Self::of(arm, motors)
    }
}

impl Partners for AtMotors {
    fn effector(&self) -> Result<EffectorImage, GeneratorError> {
        Ok(EffectorImage::standing(self.0))
    }
}

fn irb6() -> Arm {
    let robot = Irb6::new(&Irb6Parameters::irb6()).unwrap();
    Arm::new(Arc::new(robot), Pose::identity())
}

fn irp6() -> Arm {
    let robot = Irp6::new(&Irp6Parameters::irp6p()).unwrap();
    Arm::new(Arc::new(robot), Pose::identity())
}

fn home(arm: &Arm) -> PlannedStart {
    let mut tolerance = Axes::default();
    tolerance[..arm.axes()].fill(BESIDE);
    PlannedStart { motors: arm.robot().home().padded(), tolerance }
}

/// The pose of the arm at home, displaced by `by`, m.
fn from_home(arm: &Arm, by: [f64; 3]) -> Pose {
    let mut pose = arm.forward(&arm.joints(&home(arm).motors).unwrap()).unwrap();
    pose.translation.vector += Vector3::from(by);
    pose
}

fn line(arm: &Arm, target: Pose) -> StraightLine {
    let joint_limits = MotionLimits::uniform(1.5, 7.0, 70.0);
    StraightLine::new(arm.clone(), target, LIMITS, joint_limits).unwrap()
}

/// The joints at all macrostep ends, beginning with the start.
fn walk(line: StraightLine, start: &AtMotors) -> Result<Vec<AxesState>, GeneratorError> {
    let mut run = Run::new(line);
    let mut states = vec![start.0.joints];
    let mut start = AtMotors(start.0);
    begin(&mut run, &mut start, MACROSTEP)?;
    while let Step::Continue(EffectorCommand { setpoint, .. }) = run.next_step(&mut start)? {
        let Some(Setpoint::Joints(state)) = setpoint else { panic!("{setpoint:?} from a line") };
        states.push(state);
    }
    Ok(states)
}

/// Largest distance of the tool from the straight line between its first and its last position, m.
fn bow(arm: &Arm, states: &[AxesState]) -> f64 {
    let at = |state: &AxesState| arm.forward(&state.position).unwrap().translation.vector;
    let (from, to) = (at(&states[0]), at(states.last().unwrap()));
    let along = (to - from).normalize();
    let aside = |state| {
        let offset = at(state) - from;
        (offset - along * along.dot(&offset)).norm()
    };
    states.iter().map(aside).fold(0.0, f64::max)
}

/// Checks that no joint position or joint velocity jumps, and that every motor stays within its range.
fn is_smooth(arm: &Arm, states: &[AxesState]) {
    for (number, pair) in states.windows(2).enumerate() {
        for axis in 0..arm.axes() {
            let (_, most) = peaks(knot(&pair[0], axis), knot(&pair[1], axis));
            assert!(most < 7.0 * 1.05, "step {number}, axis {axis}: {most}");
        }
        arm.motors(&pair[1].position).unwrap();
    }
}

#[test]
fn five_axes_beside_their_planned_start_follow_the_line_of_that_start() {
    let arm = irb6();
    let target = from_home(&arm, [-0.1, 0.0, -0.05]);
    let end = walk(line(&arm, target), &AtMotors::of(&arm, home(&arm).motors));
    let end = *end.unwrap().last().unwrap();
    let mut worst: f64 = 0.0;
    for signs in 0..32 {
        let start = AtMotors::beside_home(&arm, signs, BESIDE);
        let straight = walk(line(&arm, target), &start);
        let Err(GeneratorError::Path { cause, .. }) = straight else {
            panic!("the arm reaches no pose beside its plane")
        };
        assert!(matches!(cause, KinematicsError::ToolPlane { .. }), "{cause}");
        let states = walk(line(&arm, target).beginning_at(home(&arm)), &start).unwrap();
        is_smooth(&arm, &states);
        assert_eq!(*states.last().unwrap(), end, "the end does not depend on the start");
        worst = worst.max(bow(&arm, &states));
    }
    println!("{worst:.2e} m off the straight line");
    // 0.5 mrad of the column times a quarter of 0.11 m, and the same amount for the inclinations of the arm.
    assert!(worst < 30e-6, "{worst}");
}

#[test]
fn an_arm_beside_a_singular_start_keeps_to_the_branch_of_the_line() {
    let arm = irp6();
    let target = from_home(&arm, [-0.1, 0.0, -0.1]);
    let end = walk(line(&arm, target), &AtMotors::of(&arm, home(&arm).motors));
    let end = *end.unwrap().last().unwrap();
    let mut jumps = 0;
    for signs in 0..64 {
        let start = AtMotors::beside_home(&arm, signs, BESIDE);
        let straight = walk(line(&arm, target), &start);
        jumps += u32::from(matches!(straight, Err(GeneratorError::Jump { .. } | GeneratorError::Turn { .. })));
        let states = walk(line(&arm, target).beginning_at(home(&arm)), &start).unwrap();
        is_smooth(&arm, &states);
        assert_eq!(*states.last().unwrap(), end);
    }
    assert!(jumps > 10, "a straight line from beside a singular pose: {jumps} jumps");
}

#[test]
fn an_arm_at_its_planned_start_goes_as_without_one() {
    let arm = irp6();
    let target = from_home(&arm, [-0.1, 0.0, -0.1]);
    let start = AtMotors::of(&arm, home(&arm).motors);
    let states = walk(line(&arm, target).beginning_at(home(&arm)), &start).unwrap();
    assert_eq!(states, walk(line(&arm, target), &start).unwrap());
}

#[test]
fn an_arm_elsewhere_goes_straight_from_where_it_stands() {
    let arm = irb6();
    let target = from_home(&arm, [-0.1, 0.0, -0.05]);
    // All axes except the column.
    let mut motors = AtMotors::beside_home(&arm, 0, 2.0 * BESIDE).0.motors.position;
    motors[0] = arm.robot().home()[0];
    let start = AtMotors::of(&arm, motors);
    let states = walk(line(&arm, target).beginning_at(home(&arm)), &start).unwrap();
    assert_eq!(states, walk(line(&arm, target), &start).unwrap());
    assert!(bow(&arm, &states) < 1e-9);
}

#[test]
fn a_line_to_the_planned_start_takes_the_remainder_away() {
    let arm = irb6();
    let planned = arm.joints(&home(&arm).motors).unwrap();
    for signs in 0..32 {
        let start = AtMotors::beside_home(&arm, signs, BESIDE);
        let there = line(&arm, from_home(&arm, [0.0; 3])).beginning_at(home(&arm));
        let states = walk(there, &start).unwrap();
        assert!(states.len() > 2);
        is_smooth(&arm, &states);
        let end = states.last().unwrap();
        for (there, planned) in end.position.iter().zip(planned) {
            assert!((there - planned).abs() < 1e-9);
        }
        assert_eq!(end.velocity, Axes::default());
    }
}

#[test]
fn a_start_beyond_a_limit_is_refused_before_the_motion_begins() {
    let mut parameters = Irb6Parameters::irb6();
    parameters.arm.column.joint_limits.low = 0.0;
    let arm = Arm::new(Arc::new(Irb6::new(&parameters).unwrap()), Pose::identity());
    let target = from_home(&arm, [-0.1, 0.0, -0.05]);
    // The joint turns in the opposite direction to the motor.
    for (signs, beyond) in [(0, true), (1, false)] {
        let start = AtMotors::beside_home(&arm, signs, BESIDE);
        let states = walk(line(&arm, target).beginning_at(home(&arm)), &start);
        let refused = matches!(states, Err(GeneratorError::Path { s: 0.0, .. }));
        assert_eq!((refused, states.is_err()), (beyond, beyond), "{states:?}");
    }
}
