//! Macrosteps, limits, following errors, reports and records.

use super::*;
use crate::Excitation;
use crate::{AxisRecord, Record};

#[test]
fn macrosteps_are_met_and_reported_and_end_in_standing() {
    let mut rig = Rig::standing(2);
    rig.order(Order::Move(Macrostep { report_at: 4, ..macrostep(1, 10, 0.01, 1.0) }));
    rig.order(Order::Move(macrostep(2, 10, 0.02, 0.0)));
    rig.run(25);
    let reports = rig.reports();
    let seen: Vec<_> = reports.iter().map(|report| (report.snapshot.phase, report.snapshot.macrostep)).collect();
    let moving = Phase::Moving;
    assert_eq!(seen, [(moving, 1), (moving, 1), (moving, 2), (Phase::Standing, 2)]);
    // The first report is that of the change of phase.
    assert_eq!(reports.iter().map(|report| report.reached).collect::<Vec<_>>(), [false, true, true, true]);
    let positions = rig.positions(0);
    assert_eq!((positions[9], positions[19], positions[24]), (0.01, 0.02, 0.02));
    assert_eq!(rig.servo.counters().macrosteps, 2);
    assert_eq!(rig.servo.tracking(0).map(|error| error.peak).collect::<Vec<_>>(), [0.0; 2]);
}

#[test]
fn a_queue_that_runs_dry_in_motion_brakes_and_faults() {
    let mut rig = Rig::standing(2);
    rig.accelerate(500.0, 3, 2);
    rig.run_until(Phase::Stopping);
    assert_eq!(rig.cause(), Some(StopCause::Starved { last: 5 }));
    rig.run_until(Phase::Faulted);
    let positions = rig.positions(0);
    keeps_limits(&positions).unwrap();
    // 15 rad/s at 1000 rad/s²: 15 periods, the last of them without motion.
    let end = positions.last().unwrap() - positions[49];
    assert!((end - 0.5 * 15.0 * 0.014).abs() < 1e-9, "{end}");
    assert_eq!(rig.last_sent(), [AxisCommand::Off; 2]);
}

#[test]
fn a_bad_macrostep_is_never_sent() {
    let good = macrostep(1, 10, 0.01, 0.0);
    let with = |change: fn(&mut Macrostep)| {
        let mut bad = good;
        change(&mut bad);
        bad
    };
    let cases = [
        (with(|m| m.position[1] = f64::NAN), "NotFinite"),
        (with(|m| m.velocity[1] = f64::INFINITY), "NotFinite"),
        (with(|m| m.torque[1] = f64::NAN), "NotFinite"),
        (Macrostep { velocity: [f64::NAN; MAX_AXES], ..macrostep(1, 1, 0.0, 0.0) }, "NotFinite"),
        (with(|m| m.velocity[1] = f64::MAX), "NotFinite"),
        (with(|m| m.position[1] = 0.3), "AccelerationLimit"),
        (with(|m| m.position[1] = -1e6), "PositionLimit"),
        (with(|m| m.position[1] = -1e3), "VelocityLimit"),
        (with(|m| m.steps = 0), "Malformed"),
        (with(|m| m.report_at = 0), "Malformed"),
        (with(|m| m.report_at = 11), "Malformed"),
    ];
    for (bad, expected) in cases {
        let mut rig = Rig::standing(2);
        rig.order(Order::Move(bad));
        rig.run(150);
        let cause = format!("{:?}", rig.cause().unwrap());
        assert!(cause.starts_with(expected), "{cause} instead of {expected} for {bad:?}");
        assert_eq!(rig.phase(), Phase::Faulted);
        for axis in 0..2 {
            assert!(rig.positions(axis).iter().all(|&position| position == 0.0), "{expected}");
        }
    }
}

#[test]
fn a_bad_macrostep_in_motion_brakes_from_the_last_good_set_point() {
    let mut rig = Rig::standing(1);
    let (position, velocity) = rig.accelerate(500.0, 4, 0);
    rig.order(Order::Move(macrostep(5, 10, position + 0.3, velocity)));
    rig.run_until(Phase::Faulted);
    assert!(matches!(rig.cause(), Some(StopCause::AccelerationLimit { .. })), "{:?}", rig.cause());
    keeps_limits(&rig.positions(0)).unwrap();
}

#[test]
fn a_macrostep_that_claims_rest_and_arrives_with_speed_brakes() {
    let mut rig = Rig::standing(1);
    let mut position = 0.0;
    for number in 1..=20 {
        position += DT * DT * 900.0 * number as f64;
        rig.order(Order::Move(macrostep(number, 1, position, 0.0)));
    }
    rig.run_until(Phase::Faulted);
    assert!(matches!(rig.cause(), Some(StopCause::AccelerationLimit { .. })));
    let positions = rig.positions(0);
    assert!(positions.contains(&position));
    keeps_limits(&positions).unwrap();
}

#[test]
fn an_effector_that_is_not_homed_does_not_move() {
    let mut rig = Rig::new(2);
    rig.world().axes[0].state.homing = Homing::Attained;
    rig.order(Order::Enable);
    rig.order(Order::Move(macrostep(1, 10, 0.01, 0.0)));
    rig.run(30);
    assert_eq!(rig.cause(), Some(StopCause::NotHomed));
    assert_eq!(rig.servo.fault(0).unwrap().axis, Some(1));
}

#[test]
fn the_following_error_is_that_of_the_command_the_drive_had_latched() {
    // At 20 rad/s, each period of error in the delay is an error of 0.02 rad.
    let mut config = scripted::config(1);
    config.effectors[0].axes[0].following_error = 0.019;
    let mut rig = Rig::with(&config).stand();
    rig.accelerate(500.0, 4, 2);
    rig.run(55);
    assert_eq!((rig.phase(), rig.cause()), (Phase::Moving, None));
    let tracking = rig.servo.tracking(0).next().unwrap();
    assert!(tracking.samples > 40 && tracking.peak < 1e-12, "{tracking:?}");

    let mut rig = Rig::with(&config).stand();
    rig.world().axes[0].lags = true;
    rig.accelerate(500.0, 4, 2);
    rig.run(55);
    let Some(StopCause::FollowingError { error, limit: 0.019 }) = rig.cause() else { panic!("{:?}", rig.cause()) };
    assert!(error > 0.019 && error < 0.0201, "{error}");
}

#[test]
fn a_missing_answer_is_compared_with_the_command_of_its_time() {
    let mut config = scripted::config(1);
    config.effectors[0].axes[0].following_error = 1e-6;
    let mut rig = Rig::with(&config).stand();
    rig.accelerate(500.0, 4, 2);
    rig.run(30);
    rig.world().axes[0].silent = true;
    rig.run(5);
    rig.world().axes[0].silent = false;
    rig.run(10);
    assert_eq!((rig.phase(), rig.cause()), (Phase::Moving, None));
}

#[test]
fn reports_that_nobody_collects_are_counted() {
    let mut rig = Rig::standing(1);
    for _ in 0..100 {
        rig.order(Order::Enable);
        rig.run(1);
    }
    assert_eq!(rig.servo.counters().dropped_reports, 100 - 80);
}

#[test]
fn every_cycle_is_recorded_and_what_does_not_fit_is_counted() {
    let mut rig = Rig::standing(2);
    let mut records = rig.servo.record(20);
    rig.order(Order::Move(macrostep(1, 10, 0.01, 0.0)));
    rig.run(30);
    let kept: Vec<_> = std::iter::from_fn(|| records.pop().ok()).collect();
    assert_eq!((kept.len(), rig.servo.counters().dropped_records), (20, 10));
    assert!(kept.windows(2).all(|two| two[1].cycle == two[0].cycle + 1));
    let last = kept[19];
    assert_eq!((last.axes, last.phase, last.axis[1].commanded), (2, Phase::Standing, 0.01));
    assert_eq!((last.axis[1].measured, last.axis[1].increments.0), (0.01, 10));
}

proptest! {
    /// Random sequences, most of them invalid, with stops in between. proptest prints the failing case and keeps its
    /// seed.
    #[test]
    fn whatever_is_asked_what_is_sent_keeps_the_limits_and_comes_to_rest(
        stream in prop::collection::vec((1u16..40, -1.0..1.0f64, -1.0..1.0f64), 1..20),
        gentleness in 0.001..1.0f64,
        stop_after in prop::option::of(0usize..400),
    ) {
        let mut rig = Rig::standing(2);
        let (mut position, mut velocity) = (0.0, 0.0);
        for (number, &(steps, speed, offset)) in (1..).zip(&stream) {
            let next = speed * MAX_VELOCITY * gentleness;
            position += 0.5 * (velocity + next) * f64::from(steps) * DT;
            velocity = next;
            let mut macrostep = macrostep(number, steps, position, velocity);
            macrostep.position[1] = position * offset;
            macrostep.velocity[1] = velocity * offset;
            rig.order(Order::Move(macrostep));
        }
        if let Some(cycles) = stop_after {
            rig.run(cycles);
            rig.order(Order::Stop);
        }
        rig.run(1000);
        let phase = rig.phase();
        prop_assert!(matches!(phase, Phase::Faulted | Phase::Standing), "{:?}", phase);
        for axis in 0..rig.axes {
            let mut positions = rig.positions(axis);
            positions.splice(0..0, [0.0, 0.0]);
            keeps_limits(&positions)?;
        }
    }
}

#[test]
fn a_record_has_the_command_that_its_sample_answers_wherever_the_error_counts() {
    let mut rig = Rig::standing(2);
    let mut records = rig.servo.record(100);
    rig.order(Order::Move(macrostep(1, 10, 0.01, 0.0)));
    rig.run(20);
    rig.order(Order::Disable);
    rig.run(10);
    let kept: Vec<_> = std::iter::from_fn(|| records.pop().ok()).collect();
    let moving = kept.iter().filter(|kept| kept.phase == Phase::Moving);
    let apart = |kept: &&Record| (kept.axis[0].commanded - kept.axis[0].measured).abs() > 1e-4;
    assert!(moving.filter(apart).count() > 5, "the sample is cycles behind");
    for record in &kept {
        if matches!(record.phase, Phase::Moving | Phase::Standing) {
            let AxisRecord { expected, measured, .. } = record.axis[0];
            assert_eq!(expected, Some(measured), "{record:?}");
        }
    }
    let last = kept.last().unwrap();
    assert_eq!((last.phase, last.axis[0].expected), (Phase::Off, None));
}

#[test]
fn an_excitation_acts_in_its_macrosteps_alone() {
    let mut rig = Rig::standing(1);
    rig.servo.excite(0, 0, Excitation { period: vec![1e-4], macrosteps: 2..=2 }).unwrap();
    let mut records = rig.servo.record(100);
    for number in 1..=3 {
        rig.order(Order::Move(macrostep(number, 10, 0.0, 0.0)));
    }
    rig.run(50);
    let excited = |record: &Record| record.axis[0].excitation != 0.0;
    let kept: Vec<_> = std::iter::from_fn(|| records.pop().ok()).collect();
    let begin = kept.iter().position(|record| record.phase == Phase::Moving).unwrap();
    let found: Vec<_> = (0..kept.len()).filter(|&index| excited(&kept[index])).collect();
    assert_eq!(found, Vec::from_iter(begin + 10..begin + 20));
}
