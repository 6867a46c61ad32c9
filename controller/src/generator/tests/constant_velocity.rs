//! Motions at a constant velocity: limits, times, ends, starts in motion and refusals.

use std::sync::Arc;

use super::*;
use crate::robot::{Arm, Irb6, Irb6Parameters, KinematicsError, Polycrank, PolycrankParameters};

/// An arm of seven endless joints.
fn endless() -> Arm {
    Arm::new(Arc::new(Polycrank::new(&PolycrankParameters::polycrank()).unwrap()), Pose::identity())
}

/// An image of a moving effector.
struct Moving(AxesState);

impl Partners for Moving {
    fn effector(&self) -> Result<EffectorImage, GeneratorError> {
        let state = EffectorState { motors: self.0, joints: self.0, pose: Pose::identity() };
        let joints = self.0.acceleration.unwrap_or_default();
        let commanded_acceleration = Accelerations { motors: joints, joints };
        Ok(EffectorImage { commanded_acceleration, ..EffectorImage::standing(state) })
    }
}

/// The states at all macrostep ends, beginning with the start.
fn moved(generator: ConstantVelocity, start: AxesState) -> Result<Vec<AxesState>, GeneratorError> {
    let (mut run, mut partners) = (Run::new(generator), Moving(start));
    begin(&mut run, &mut partners, MACROSTEP)?;
    let mut states = vec![start];
    while let Step::Continue(EffectorCommand { setpoint: Some(Setpoint::Joints(state)), .. }) =
        run.next_step(&mut partners)?
    {
        states.push(state);
    }
    Ok(states)
}

/// Velocities of seven joints within the limits, of which some are zero.
fn random_velocity(random: &mut Random, limits: &MotionLimits) -> Axes {
    std::array::from_fn(|axis| match random.below(4) {
        0 => 0.0,
        _ if axis >= 7 => 0.0,
        _ => random.within(-1.0, 1.0) * limits.max_velocity[axis],
    })
}

#[test]
fn a_motion_at_constant_velocity_keeps_its_limits_and_ends_at_rest_on_a_straight_line() {
    let arm = endless();
    for seed in 0..5_000 {
        let mut random = Random(seed);
        let limits = random_limits(&mut random);
        let velocity = random_velocity(&mut random, &limits);
        let held = random.below(30);
        let motion = ConstantVelocity::new(arm.clone(), limits, velocity).unwrap().lasting(MACROSTEP * held as u32);
        let start = AxesState::at_rest(std::array::from_fn(|axis| if axis < 7 { 0.1 * axis as f64 } else { 0.0 }));
        let states = moved(motion, start).unwrap();
        let cruising = states.iter().filter(|state| state.velocity == velocity).count();
        assert!(cruising > held, "seed {seed}: {cruising} for {held}");
        for pair in states.windows(2) {
            for axis in 0..7 {
                let (from, to) = (knot(&pair[0], axis), knot(&pair[1], axis));
                let (speed, push) = peaks(from, to);
                assert!(speed <= limits.max_velocity[axis] * (1.0 + 1e-9), "seed {seed}: {speed}");
                assert!(push <= limits.max_acceleration[axis] * 1.7, "seed {seed}: {push}");
                assert!(to.acceleration.abs() <= limits.max_acceleration[axis] * (1.0 + 1e-9), "seed {seed}");
            }
        }
        let end = states[states.len() - 1];
        assert_eq!((end.velocity, end.acceleration), (Axes::default(), Some(Axes::default())), "seed {seed}");
        // All joints move for the same time at the mean velocity.
        let times = (0..7).filter(|axis| velocity[*axis] != 0.0);
        let times: Vec<f64> = times.map(|axis| (end.position[axis] - start.position[axis]) / velocity[axis]).collect();
        assert!(times.iter().all(|time| (time - times[0]).abs() < 1e-9), "seed {seed}: {times:?}");
    }
}

#[test]
fn a_motion_at_constant_velocity_takes_the_known_times() {
    // Velocity, and time of acceleration at 7 rad/s² and 70 rad/s³, whose ramps take 0.1 s.
    for (speed, time) in [(1.4, 0.3), (0.7, 0.2), (0.35, 0.141_421)] {
        let mut velocity = Axes::default();
        (velocity[2], velocity[4]) = (-speed, speed / 3.0);
        let limits = MotionLimits::uniform(1.5, 7.0, 70.0);
        let motion = ConstantVelocity::new(endless(), limits, velocity).unwrap();
        let steps = (time / MC - 1e-9_f64).ceil() as usize;
        let at_rest = AxesState::at_rest(Axes::default());
        let whole = moved(motion.clone().over(0.1).unwrap(), at_rest).unwrap();
        let held = (0.1 / speed / MC - 1e-9).ceil() as usize;
        assert_eq!(whole.len() - 1, 2 * steps + held, "{speed}");
        assert_eq!(whole[steps].velocity, velocity);
        assert_eq!(whole[steps + held].velocity, velocity);
        let ends_in_motion = moved(motion.ending_in_motion(), at_rest).unwrap();
        assert_eq!(ends_in_motion.len() - 1, steps);
        assert_eq!(ends_in_motion[steps].velocity, velocity);
        assert_eq!(ends_in_motion[steps].acceleration, Some(Axes::default()));
    }
}

#[test]
fn a_motion_at_constant_velocity_begins_in_motion_without_a_jump() {
    let arm = endless();
    for seed in 0..5_000 {
        let mut random = Random(seed);
        let limits = random_limits(&mut random);
        let velocity = random_velocity(&mut random, &limits);
        let accelerates = random.below(2) == 1;
        let start = AxesState::new(Axes::default(), random_velocity(&mut random, &limits)).accelerating(
            std::array::from_fn(|axis| match axis {
                0..7 if accelerates => random.within(-1.0, 1.0) * limits.max_acceleration[axis],
                _ => 0.0,
            }),
        );
        let motion = ConstantVelocity::new(arm.clone(), limits, velocity).unwrap().lasting(MACROSTEP);
        assert!(motion.begins_in_motion());
        let states = moved(motion, start).unwrap();
        for pair in states.windows(2) {
            for axis in 0..7 {
                let (a, j) = (limits.max_acceleration[axis], limits.max_jerk[axis]);
                let (from, to) = (knot(&pair[0], axis), knot(&pair[1], axis));
                let (speed, push) = peaks(from, to);
                // The velocity that the acceleration at the start still adds. All joints take the longest time of all.
                let longest = (0..7).map(|axis| limits.max_acceleration[axis] / limits.max_jerk[axis]);
                let added = a * longest.fold(a / j, f64::max) / 2.0;
                assert!(speed <= limits.max_velocity[axis] + added, "seed {seed}: {speed}");
                assert!(push <= a * 1.7 + 1e-9, "seed {seed}: {push}");
                // Velocity is the derivative of the position, and acceleration that of the velocity.
                let way = MC * (from.velocity + to.velocity) / 2.0;
                assert!((to.position - from.position - way).abs() <= a * MC * MC, "seed {seed}: {from:?} {to:?}");
                assert!((to.velocity - from.velocity).abs() <= a * MC * (1.0 + 1e-9), "seed {seed}: {from:?} {to:?}");
                assert!(
                    (to.acceleration - from.acceleration).abs() <= 1.1 * j * MC + 1e-6,
                    "seed {seed}: {from:?} {to:?}"
                );
            }
        }
        assert!(states.iter().any(|state| state.velocity == velocity), "seed {seed}");
        assert_eq!(states[states.len() - 1].velocity, Axes::default(), "seed {seed}");
    }
}

#[test]
fn a_motion_at_zero_velocity_stops_a_moving_effector() {
    let limits = MotionLimits::uniform(1.0, 5.0, 50.0);
    let stop = || ConstantVelocity::new(endless(), limits, Axes::default()).unwrap();
    let moving = AxesState::new(Axes::default(), [0.5, -0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(moved(stop(), moving).unwrap().last().unwrap().velocity, Axes::default());
    let standing = AxesState::at_rest([0.3; 8]);
    assert_eq!(moved(stop(), standing).unwrap(), [standing]);
}

#[test]
fn a_velocity_or_a_distance_that_cannot_be_kept_and_a_motion_out_of_range_are_refused() {
    let limits = MotionLimits::uniform(1.0, 5.0, 50.0);
    let column = |velocity: f64| [velocity, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let motion = |velocity| ConstantVelocity::new(endless(), limits, column(velocity));
    assert_eq!(motion(f64::NAN).unwrap_err(), GeneratorError::NotFinite { pose: 0, axis: 0 });
    assert_eq!(motion(-1.1).unwrap_err(), GeneratorError::Velocity { axis: 0, value: -1.1, limit: 1.0 });
    for (velocity, distance) in [(0.0, 1.0), (0.5, -1.0), (0.5, f64::INFINITY), (0.5, f64::NAN)] {
        let refused = motion(velocity).unwrap().over(distance).unwrap_err();
        assert!(matches!(refused, GeneratorError::Distance { .. }), "{refused}");
    }
    let long = motion(0.5).unwrap().lasting(Duration::from_secs(1_000_000));
    assert_eq!(moved(long, AxesState::at_rest([0.0; 8])), Err(GeneratorError::TooLong { limit: 1 << 24 }));

    let arm = Arm::new(Arc::new(Irb6::new(&Irb6Parameters::irb6()).unwrap()), Pose::identity());
    let home = arm.joints(&arm.robot().home().padded()).unwrap();
    let range = arm.robot().joint_limits()[0].high - home[0];
    let turned = |over| {
        let motion = ConstantVelocity::new(arm.clone(), limits, column(0.5)).unwrap();
        moved(motion.over(over).unwrap(), AxesState::at_rest(home))
    };
    assert!(turned(range - 0.3).is_ok());
    let refused = turned(range).unwrap_err();
    assert!(matches!(refused, GeneratorError::Path { cause: KinematicsError::BeyondLimit { .. }, .. }), "{refused}");
}
