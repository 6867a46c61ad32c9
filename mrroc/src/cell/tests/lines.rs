//! Random lines of the robots of the example cells, judged as the servo judges each set-point.

use std::time::Duration;

use controller::generator::{
    Axes, AxesState, EffectorImage, EffectorState, Generator, LineLimits, MotionLimits, Pose, Setpoint, StraightLine,
};
use controller::robot::Arm;
use nalgebra::Vector3;

use super::*;

/// Lines per cell.
const LINES: u64 = 120;
/// Excess over a limit that the servo accepts.
const TOLERANCE: f64 = 1e-3;

/// SplitMix64, from `low` to `high`.
fn within(state: &mut u64, low: f64, high: f64) -> f64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut mixed = *state;
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    low + (high - low) * ((mixed ^ (mixed >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Joints of a random posture. Every second posture of an arm with endless elbows is near a fold.
fn posture(arm: &Arm, state: &mut u64, number: u64) -> Axes {
    let mut joints = Axes::default();
    for (joint, limits) in joints.iter_mut().zip(arm.robot().joint_limits()) {
        let (low, high) = if limits.is_continuous() { (-2.0, 2.0) } else { (limits.low, limits.high) };
        *joint = within(state, 0.9 * low + 0.1 * high, 0.1 * low + 0.9 * high);
    }
    if arm.robot().joint_limits().iter().all(Limits::is_continuous) && number.is_multiple_of(2) {
        let turn = if number.is_multiple_of(4) { 0.0 } else { std::f64::consts::PI };
        joints[if number.is_multiple_of(3) { 1 } else { 4 }] = turn + within(state, -0.3, 0.3);
    }
    if arm.axes() == 5 {
        // The tool points downward, so that all lines without a turn stay in the plane of the arm.
        joints[3] = std::f64::consts::FRAC_PI_2;
    }
    joints
}

/// Motor positions at all set-points of a line, with the standstills before and after; `None` for a line that the arm
/// cannot follow.
fn motors(
    arm: &Arm,
    start: &Axes,
    to: Pose,
    limits: LineLimits,
    joints: MotionLimits,
    dt: Duration,
) -> Option<Vec<Axes>> {
    let first = arm.motors(start).ok()?;
    let state = EffectorState {
        motors: AxesState::at_rest(first),
        joints: AxesState::at_rest(*start),
        pose: arm.forward(start).ok()?,
    };
    let mut line = StraightLine::new(arm.clone(), to, limits, joints).unwrap();
    let mut memory = line.first_step(&EffectorImage::standing(state), dt).ok()?.memory;
    let mut motors = vec![first; 2];
    while !line.terminal(&memory, &()) {
        let next = line.next_step(&memory, &()).unwrap();
        let Some(Setpoint::Joints(state)) = next.effector else { panic!("a line commands joints") };
        motors.push(arm.motors(&state.position).unwrap());
        memory = next.memory;
    }
    motors.push(motors[motors.len() - 1]);
    Some(motors)
}

#[test]
fn no_set_point_of_a_random_line_is_beyond_the_limits_of_the_servo() {
    for text in [IRB6, IRP6, TRACK, RNT, POLYCRANK] {
        let cell = Cell::parse(text).unwrap();
        let (robot, dt) = (&cell.robot[0], cell.period());
        let arm = robot.arm().unwrap();
        let joint_limits = robot.motion_limits(&arm);
        let (mut lines, mut worst) = (0, [0.0_f64; 2]);
        for number in 0..LINES {
            let mut state = number;
            let start = posture(&arm, &mut state, number);
            let Ok(mut target) = arm.forward(&start) else { continue };
            target.translation.vector += Vector3::from_fn(|_, _| within(&mut state, -0.17, 0.17));
            // From a careful line to limits that no arm reaches.
            let faster = 10_f64.powf(within(&mut state, -1.0, 2.5));
            let limits = LineLimits {
                max_velocity: 0.2 * faster,
                max_acceleration: 0.5 * faster,
                max_jerk: 5.0 * faster,
                max_angular_velocity: faster,
                max_angular_acceleration: 2.5 * faster,
                max_angular_jerk: 25.0 * faster,
            };
            let Some(motors) = motors(&arm, &start, target, limits, joint_limits, dt) else { continue };
            lines += 1;
            let dt = dt.as_secs_f64();
            for three in motors.windows(3) {
                for (motor, axis) in robot.axis.iter().enumerate() {
                    let [before_last, last, next] = [three[0][motor], three[1][motor], three[2][motor]];
                    let velocity = (next - last).abs() / dt / axis.max_velocity;
                    let acceleration = (next - 2.0 * last + before_last).abs() / (dt * dt) / axis.max_acceleration;
                    assert!(
                        velocity.max(acceleration) <= 1.0 + TOLERANCE,
                        "{}, line {number}, motor {motor}: {velocity} and {acceleration} of the limits",
                        robot.name
                    );
                    worst = [worst[0].max(velocity), worst[1].max(acceleration)];
                }
            }
        }
        println!("{}: {lines} lines, at most {worst:.3?} of the limits", robot.name);
        assert!(lines >= 30, "{}: {lines} lines", robot.name);
    }
}
