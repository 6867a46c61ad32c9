//! Bring-up, enabling, homing and reset.

use drive::{EmergencyStop, Fault};

use super::scripted::AtIndex;
use super::*;
use crate::{FrozenWatch, NotUp, ServoState, StopCategory};

#[test]
fn bring_up_is_ready_when_every_group_is_and_an_error_names_its_group() {
    let (groups, worlds): (Vec<_>, Vec<_>) = (0..2).map(|_| scripted::group(2)).unzip();
    worlds[0].lock().unwrap().coming_up = 1;
    worlds[1].lock().unwrap().coming_up = 2;
    let (mut servo, _links) = Servo::new(&scripted::config(2), groups).unwrap();
    assert_eq!(servo.bring_up(Instant::ZERO), Poll::Pending);
    assert_eq!(servo.bring_up(Instant::ZERO), Poll::Pending);
    assert_eq!(servo.bring_up(Instant::ZERO), Poll::Ready(Ok(())));

    let (groups, worlds): (Vec<_>, Vec<_>) = (0..2).map(|_| scripted::group(2)).unzip();
    worlds[1].lock().unwrap().absent = true;
    let (mut servo, _links) = Servo::new(&scripted::config(2), groups).unwrap();
    let error = Err(NotUp::Group(1, scripted::NEVER_BOOTED));
    assert_eq!(servo.bring_up(Instant::ZERO), Poll::Ready(error));
}

#[test]
fn a_group_that_is_up_is_called_until_the_others_are() {
    let (groups, worlds): (Vec<_>, Vec<_>) = (0..2).map(|_| scripted::group(2)).unzip();
    worlds[1].lock().unwrap().coming_up = 5;
    let (mut servo, _links) = Servo::new(&scripted::config(2), groups).unwrap();
    let mut now = Instant::ZERO;
    let mut polls = 0;
    while servo.bring_up(now).is_pending() {
        now += PERIOD;
        polls += 1;
    }
    assert_eq!(polls, 5);
    assert_eq!(worlds[0].lock().unwrap().waited, 5);
    assert_eq!(worlds[1].lock().unwrap().waited, 0);
}

#[test]
fn a_stop_request_ends_bring_up_with_nothing_sent() {
    use crate::{lockstep, thread};
    let coming_up = || {
        let (group, world) = scripted::group(1);
        world.lock().unwrap().coming_up = 20;
        let (servo, _links) = Servo::new(&scripted::config(1), vec![group]).unwrap();
        (servo, world)
    };
    for by_the_clock in [false, true] {
        let (mut servo, world) = coming_up();
        let stop = servo.stop_request();
        let mut polls = 0;
        let between = |_| {
            polls += 1;
            if polls == 3 {
                stop.request();
            }
        };
        let up = if by_the_clock {
            thread::bring_up(&mut servo, between)
        } else {
            lockstep::bring_up(&mut servo, Instant::ZERO, between).map(drop)
        };
        assert_eq!(up, Err(NotUp::Stopped));
        assert_eq!(world.lock().unwrap().coming_up, 17);
        assert!(world.lock().unwrap().sent.is_empty());
    }
}

#[test]
fn a_fault_that_cannot_be_reset_is_reported_as_such_and_stays() {
    let mut rig = Rig::standing(1);
    rig.world().axes[0].stubborn = true;
    rig.world().axes[0].state.fault = Some(FAULT);
    rig.run_until(Phase::Faulted);
    rig.reports();
    rig.order(Order::ResetFault);
    rig.run(150);
    assert_eq!(rig.last_sent(), [AxisCommand::Off]);
    let reports = rig.reports();
    assert_eq!(reports.len(), 2, "the order and its failure");
    let cause = reports[1].fault.map(|fault| fault.cause);
    assert_eq!(cause, Some(StopCause::Drive(FAULT)));
}

#[test]
fn a_failed_reset_ends_after_a_second_and_reports_the_fault_that_persists() {
    let mut config = scripted::config(2);
    config.effectors[0].enabling_timeout = Duration::from_secs(5);
    let mut rig = Rig::with(&config).stand();
    rig.world().axes[1].stubborn = true;
    rig.world().axes[1].state.fault = Some(FAULT);
    rig.run_until(Phase::Faulted);
    rig.reports();
    rig.order(Order::ResetFault);
    rig.run(1);
    let other = Fault::LeftOperational { node: 2 };
    rig.world().axes[1].state.fault = Some(other);
    rig.run(1_010);
    let reports = rig.reports();
    assert_eq!(reports.iter().map(|report| report.resetting).collect::<Vec<_>>(), [true, false]);
    assert_eq!(reports[1].fault.map(|fault| (fault.axis, fault.cause)), Some((Some(1), StopCause::Drive(other))));
    assert_eq!(reports[1].snapshot.phase, Phase::Faulted);
}

/// The first cycle after the time-out, also where the time-out is no multiple of the period.
#[test]
fn a_failed_reset_ends_in_the_first_cycle_after_its_time_out_and_keeps_the_category_of_the_stop() {
    for timeout in [Duration::from_micros(50_000), Duration::from_micros(50_500)] {
        let mut config = scripted::config(1);
        config.effectors[0].enabling_timeout = timeout;
        let mut rig = stopping_at_once(&config);
        rig.world().axes[0].stubborn = true;
        rig.world().axes[0].state.fault = Some(FAULT);
        rig.run(5);
        rig.order(Order::ResetFault);
        rig.run(51);
        assert_eq!(rig.servo.state(0), Some(ServoState::Resetting), "{timeout:?}");
        rig.run(1);
        assert_eq!(rig.servo.state(0), Some(ServoState::Faulted), "{timeout:?}");
        let found = rig.servo.fault(0).map(|fault| (fault.cause, fault.category));
        assert_eq!(found, Some((StopCause::Drive(FAULT), StopCategory::Zero)));
    }
}

/// An effector that was stopped by category 0.
fn stopping_at_once(config: &ServoConfig) -> Rig {
    let mut rig = Rig::with(config).stand();
    rig.accelerate(500.0, 2, 20);
    rig.run(40);
    rig.order(Order::Disable);
    rig.world().axes[0].runs_at = Some(200.0);
    rig.run_until(Phase::Faulted);
    rig.world().axes[0].runs_at = None;
    assert_eq!(rig.servo.fault(0).map(|fault| fault.category), Some(StopCategory::Zero));
    rig
}

#[test]
fn a_reset_waits_for_a_drive_that_is_brought_up_again() {
    for comes_back in [true, false] {
        let mut rig = Rig::standing(2);
        rig.world().axes[1].stubborn = true;
        rig.world().axes[1].state.fault = Some(FAULT);
        rig.run_until(Phase::Faulted);
        rig.reports();
        rig.order(Order::ResetFault);
        rig.world().axes[1].state.recovering = true;
        rig.run(2_000);
        assert_eq!(rig.last_sent(), [AxisCommand::ResetFault; 2], "the reset goes on beyond the time-out of a reset");
        rig.world().axes[1].state.recovering = false;
        if comes_back {
            rig.world().axes[1].stubborn = false;
            rig.world().axes[1].state.homing = Homing::NotHomed;
        }
        rig.run(150);
        let report = rig.reports().last().copied().unwrap();
        let expected = if comes_back { (Phase::Off, false) } else { (Phase::Faulted, true) };
        assert_eq!((report.snapshot.phase, report.fault.is_some()), expected);
        assert_eq!(report.snapshot.homed, !comes_back, "the axis must home again");
    }
}

#[test]
fn a_reset_brings_back_a_drive_that_carries_the_contact_of_the_emergency_stop() {
    let not_back = Fault::NotBack { error: scripted::NEVER_BOOTED };
    for comes_back in [true, false] {
        let mut rig = Rig::standing(2);
        // The drive booted, so the level of its contact is not known.
        rig.world().axes[1].stubborn = true;
        rig.world().axes[1].state.fault = Some(Fault::LeftOperational { node: 2 });
        rig.world().emergency = Some(EmergencyStop { node: 2, input: 16, known: false });
        rig.run_until(Phase::Faulted);
        rig.reports();
        rig.order(Order::ResetFault);
        rig.world().axes[1].state.recovering = true;
        rig.run(2_000);
        assert_eq!(rig.last_sent(), [AxisCommand::ResetFault; 2]);
        rig.world().axes[1].state.recovering = false;
        if comes_back {
            rig.world().axes[1].stubborn = false;
            rig.world().emergency = None;
        } else {
            rig.world().axes[1].state.fault = Some(not_back);
        }
        rig.run(150);
        let report = rig.reports().last().copied().unwrap();
        let fault = report.fault.map(|fault| (fault.axis, fault.cause));
        let failed = (Phase::Faulted, Some((Some(1), StopCause::Drive(not_back))));
        assert_eq!((report.snapshot.phase, fault), if comes_back { (Phase::Off, None) } else { failed });
    }
}

#[test]
fn an_emergency_stop_that_is_pressed_and_released_during_a_reset_ends_the_reset() {
    let emergency = EmergencyStop { node: 40, input: 5, known: true };
    let mut rig = Rig::standing(2);
    rig.world().axes[1].stubborn = true;
    rig.world().axes[1].state.fault = Some(FAULT);
    rig.run_until(Phase::Faulted);
    rig.order(Order::ResetFault);
    rig.world().axes[1].state.recovering = true;
    rig.order(Order::Enable);
    rig.run(50);
    rig.world().emergency = Some(emergency);
    rig.run(1);
    rig.world().emergency = None;
    rig.world().axes[1].state.recovering = false;
    rig.world().axes[1].stubborn = false;
    rig.run(200);
    assert_eq!((rig.phase(), rig.last_sent()), (Phase::Faulted, vec![AxisCommand::Off; 2]));
    assert_eq!(rig.cause(), Some(StopCause::EmergencyStop { group: 0, contact: emergency }));
}

#[test]
fn enabling_starts_from_where_the_motor_is() {
    let mut rig = Rig::new(1);
    rig.world().axes[0].state.position = 3.25;
    rig.order(Order::Enable);
    rig.run(20);
    assert_eq!(rig.phases(), [Phase::Enabling, Phase::Standing]);
    let positions = rig.positions(0);
    assert!(!positions.is_empty() && positions.iter().all(|&position| position == 3.25));
}

#[test]
fn following_begins_only_after_every_drive_has_power() {
    let mut rig = Rig::new(2);
    rig.world().axes[1].dead = true;
    rig.order(Order::Enable);
    rig.run(90);
    assert!(rig.positions(0).is_empty());
    assert_eq!(rig.last_sent(), [AxisCommand::Stand; 2]);
    rig.run(20);
    assert!(matches!(rig.cause(), Some(StopCause::NotReady { .. })), "{:?}", rig.cause());
    assert_eq!(rig.servo.fault(0).unwrap().axis, Some(0));
    assert_eq!(rig.last_sent(), [AxisCommand::Off; 2]);
}

/// The first cycle after the time-out, also where the time-out is no multiple of the period.
#[test]
fn a_drive_is_not_ready_in_the_first_cycle_after_the_time_out() {
    for timeout in [Duration::from_micros(100_000), Duration::from_micros(100_500)] {
        let mut config = scripted::config(1);
        config.effectors[0].enabling_timeout = timeout;
        let after = |rig: &mut Rig| {
            rig.run_until(Phase::Faulted);
            let Some(StopCause::NotReady { waited }) = rig.cause() else { panic!("{:?}", rig.cause()) };
            waited
        };
        let mut rig = Rig::with(&config);
        rig.world().axes[0].dead = true;
        rig.order(Order::Enable);
        assert_eq!(after(&mut rig), Duration::from_millis(101));
        // In a stop of homing.
        let mut rig = Rig::with(&config);
        rig.order(Order::Enable);
        rig.order(Order::Home);
        rig.run_until(Phase::Homing);
        rig.world().axes[0].deaf = true;
        rig.order(Order::Stop);
        assert_eq!(after(&mut rig), rig.servo.effectors[0].longest_stop() + Duration::from_millis(101));
    }
}

#[test]
fn a_drive_that_ignores_set_points_is_not_ready() {
    let mut rig = Rig::new(2);
    rig.world().axes[1].deaf = true;
    rig.order(Order::Enable);
    rig.run_until(Phase::Faulted);
    assert!(matches!(rig.cause(), Some(StopCause::NotReady { .. })));
    assert_eq!(rig.servo.fault(0).unwrap().axis, Some(1));
}

#[test]
fn axes_home_in_ascending_order_and_homed_ones_are_skipped() {
    let mut rig = Rig::new(3);
    rig.world().axes[1].state.homing = Homing::Attained;
    rig.world().axes[0].state.position = 7.0;
    rig.order(Order::Enable);
    rig.order(Order::Home);
    rig.run(60);
    assert_eq!(rig.phases(), [Phase::Enabling, Phase::Standing, Phase::Homing, Phase::Standing]);
    let homing: Vec<usize> = rig
        .world()
        .sent
        .iter()
        .flat_map(|batch| batch.iter().position(|command| *command == AxisCommand::Home))
        .collect();
    assert!(homing.is_sorted_by(|a, b| a >= b), "{homing:?}");
    assert!(homing.contains(&2) && homing.contains(&0) && !homing.contains(&1));
    // The counter jumped to zero, and the command followed.
    assert_eq!(*rig.positions(0).last().unwrap(), 0.0);
}

#[test]
fn homing_that_has_nothing_to_do_is_answered() {
    let mut rig = Rig::standing(2);
    rig.order(Order::Home);
    rig.run(2);
    let reports = rig.reports();
    assert_eq!(reports.len(), 1);
    assert!(reports[0].snapshot.homed && reports[0].snapshot.phase == Phase::Standing);
}

#[test]
fn homing_fails_by_the_drive_and_by_time_and_halts_first() {
    for (fails, takes) in [(true, 10), (false, 0)] {
        let mut config = scripted::config(2);
        if fails {
            config.effectors[0].homing_timeout = Duration::from_secs(3_600);
        }
        let mut rig = Rig::with(&config);
        rig.world().axes[1].homing_fails = fails;
        rig.world().axes[1].homing_takes = takes;
        rig.order(Order::Enable);
        rig.order(Order::Home);
        rig.run_until(Phase::Stopping);
        assert_eq!(rig.last_sent(), [AxisCommand::Stand; 2]);
        rig.run_until(Phase::Faulted);
        assert_eq!(rig.cause(), Some(StopCause::HomingFailed));
        assert_eq!(rig.servo.fault(0).unwrap().axis, Some(1));
        assert_eq!(rig.last_sent(), [AxisCommand::Off; 2]);
    }
}

/// The first cycle after the time-out, also where the time-out is no multiple of the period.
#[test]
fn homing_fails_in_the_first_cycle_after_its_time_out() {
    for timeout in [Duration::from_micros(50_000), Duration::from_micros(50_500)] {
        let mut config = scripted::config(1);
        config.effectors[0].homing_timeout = timeout;
        let mut rig = Rig::with(&config);
        rig.world().axes[0].homing_takes = 0;
        rig.order(Order::Enable);
        rig.order(Order::Home);
        rig.run_until(Phase::Homing);
        rig.run(50);
        assert_eq!(rig.phase(), Phase::Homing, "{timeout:?}");
        rig.run(1);
        assert_eq!((rig.phase(), rig.cause()), (Phase::Stopping, Some(StopCause::HomingFailed)), "{timeout:?}");
    }
}

#[test]
fn a_failure_of_an_earlier_homing_does_not_fail_the_next() {
    let mut rig = Rig::new(1);
    rig.world().axes[0].homing_fails = true;
    rig.order(Order::Enable);
    rig.order(Order::Home);
    rig.run_until(Phase::Faulted);
    rig.world().axes[0].homing_fails = false;
    for order in [Order::ResetFault, Order::Enable, Order::Home] {
        rig.order(order);
    }
    rig.run(60);
    assert_eq!((rig.phase(), rig.cause()), (Phase::Standing, None));
    assert!(rig.reports().last().unwrap().snapshot.homed);
}

#[test]
fn homing_can_be_stopped_and_begun_again() {
    let mut rig = Rig::new(2);
    rig.world().axes[1].homing_takes = 30;
    rig.order(Order::Enable);
    for _ in 0..2 {
        rig.order(Order::Home);
        rig.run_until(Phase::Homing);
        rig.run(5);
        rig.order(Order::Stop);
        rig.run(1);
        rig.run(90);
        assert_eq!(rig.phase(), Phase::Stopping);
        assert_eq!(rig.last_sent(), [AxisCommand::Stand; 2]);
        rig.run_until(Phase::Standing);
        assert!(!rig.reports().last().unwrap().snapshot.homed);
    }
    rig.order(Order::Home);
    rig.run(1);
    rig.run_until(Phase::Standing);
    assert!(rig.reports().last().unwrap().snapshot.homed);
}

#[test]
fn a_stricter_stop_of_homing_is_not_longer() {
    let mut rig = Rig::new(2);
    rig.order(Order::Enable);
    rig.order(Order::Home);
    rig.run_until(Phase::Homing);
    rig.run(5);
    rig.order(Order::Stop);
    rig.run(60);
    rig.order(Order::Disable);
    rig.run(60);
    assert_eq!(rig.phase(), Phase::Off);
}

/// An effector whose second drive searches for its reference at `speed`, rad/s.
fn searching(speed: f64) -> Rig {
    let mut rig = Rig::new(2);
    rig.world().axes[1].homing_takes = 500;
    rig.order(Order::Enable);
    rig.order(Order::Home);
    rig.run_until(Phase::Homing);
    rig.world().axes[1].drifts_at = Some(speed);
    rig.run(5);
    rig
}

#[test]
fn a_motor_that_does_not_brake_in_a_stop_of_homing_loses_its_power() {
    // Share of the speed before the stop in a period of the stop, which takes at most 200 ms.
    type Share = fn(u32) -> f64;
    let cases: [(Order, Share, Option<u32>); 5] = [
        (Order::Stop, |period| 1.0 - 0.005 * f64::from(period), None),
        (Order::Stop, |_| 0.49, None),
        (Order::Stop, |_| 0.51, Some(200)),
        (Order::Stop, |_| 1.0, Some(200)),
        (Order::Disable, |_| 1.0, Some(200)),
    ];
    for (order, share, lost_in) in cases {
        let mut rig = searching(20.0);
        assert_eq!(rig.servo.longest_stop(), 2 * Duration::from_millis(200));
        rig.order(order);
        let mut lost = None;
        for period in 0..=200 {
            rig.world().axes[1].drifts_at = Some(20.0 * share(period));
            rig.run(1);
            lost = lost.or((rig.phase() == Phase::Faulted).then_some(period));
        }
        assert_eq!(lost, lost_in, "{order:?}");
        let fault = rig.servo.fault(0);
        assert_eq!(fault.map(|it| (it.axis, it.category)), lost.map(|_| (Some(1), StopCategory::Zero)));
        assert_eq!(matches!(rig.cause(), Some(StopCause::NotBraking { .. })), lost.is_some(), "{fault:?}");
        if lost.is_none() {
            rig.world().axes[1].drifts_at = None;
            rig.run_until(Phase::Standing);
        }
    }
}

#[test]
fn a_motor_that_its_drive_does_not_brake_or_show_is_not_judged_in_a_stop_of_homing() {
    // A drive with a fault, and one that gives no answers.
    for (fault, silent) in [(Some(FAULT), false), (None, true)] {
        let mut rig = searching(20.0);
        rig.order(Order::Stop);
        rig.run(10);
        rig.world().axes[1].state.fault = fault;
        rig.world().axes[1].silent = silent;
        // The stop may take less than this, and a silent drive is not ready only after 300 periods.
        rig.run(240);
        let found = rig.servo.fault(0).map(|fault| (fault.cause, fault.category));
        assert_eq!(found, fault.map(|fault| (StopCause::Drive(fault), StopCategory::One)));
    }
}

/// A drive accelerates in its search, and hears of the stop some periods late.
#[test]
fn a_stop_while_a_drive_accelerates_in_its_search_is_no_fault() {
    for late in [2, 6] {
        let mut rig = searching(2.0);
        rig.order(Order::Stop);
        let mut velocity: f64 = 2.0;
        for period in 0..300 {
            velocity = (velocity + if period < late { 0.5 } else { -0.5 }).max(0.0);
            rig.world().axes[1].drifts_at = Some(velocity);
            rig.run(1);
        }
        assert_eq!((rig.phase(), rig.cause()), (Phase::Standing, None));
    }
}

#[test]
fn a_drive_that_does_not_follow_after_a_stop_of_homing_is_not_ready() {
    let mut rig = Rig::new(2);
    rig.order(Order::Enable);
    rig.order(Order::Home);
    rig.run_until(Phase::Homing);
    rig.run(5);
    rig.world().axes[1].deaf = true;
    rig.order(Order::Stop);
    let timeout = rig.servo.longest_stop() + scripted::config(2).effectors[0].enabling_timeout;
    rig.run(timeout.as_millis() as usize + 10);
    assert_eq!(rig.phase(), Phase::Faulted);
    assert_eq!((rig.servo.fault(0).unwrap().axis, rig.last_sent()), (Some(1), vec![AxisCommand::Off; 2]));
    assert!(matches!(rig.cause(), Some(StopCause::NotReady { .. })), "{:?}", rig.cause());
}

#[test]
fn a_position_that_stands_at_once_while_the_drive_homes_stops_the_effector() {
    for (watch, found) in [(FrozenWatch::Always, true), (FrozenWatch::Following, false), (FrozenWatch::Off, false)] {
        let mut config = scripted::config(1);
        config.effectors[0].axes[0].frozen = watch;
        config.effectors[0].homing_timeout = Duration::from_secs(1);
        let mut rig = Rig::with(&config);
        rig.world().axes[0].homing_takes = 500;
        rig.order(Order::Enable);
        rig.order(Order::Home);
        rig.world().axes[0].runs_at = Some(15.0);
        rig.run(100);
        assert_eq!(rig.phase(), Phase::Homing, "{:?}", rig.cause());
        rig.world().axes[0].runs_at = None;
        rig.run(10);
        assert_eq!(matches!(rig.cause(), Some(StopCause::Frozen { .. })), found, "{watch:?}: {:?}", rig.cause());
        assert_eq!(rig.last_sent()[0] == AxisCommand::Off, found);
    }
}

/// An encoder that failed at standstill: the search of the drive begins without a motion of the counter.
#[test]
fn a_counter_that_stands_still_in_the_search_of_a_drive_stops_the_effector() {
    for (watch, found) in [(FrozenWatch::Always, true), (FrozenWatch::Following, false), (FrozenWatch::Off, false)] {
        let mut config = scripted::config(1);
        config.effectors[0].axes[0].frozen = watch;
        let mut rig = Rig::with(&config);
        rig.world().axes[0].homing_takes = 500;
        rig.order(Order::Enable);
        rig.order(Order::Home);
        rig.run(100);
        assert_eq!(rig.phase(), Phase::Homing, "{:?}", rig.cause());
        rig.world().axes[0].state.stalled = Some(0.3);
        rig.run(10);
        assert_eq!(rig.cause() == Some(StopCause::Frozen { travel: 0.3 }), found, "{watch:?}: {:?}", rig.cause());
        assert_eq!(rig.last_sent()[0] == AxisCommand::Off, found);
    }
}

#[test]
fn a_count_that_comes_after_the_end_of_its_search_makes_no_motor_that_sticks_a_frozen_one() {
    let mut rig = Rig::new(1);
    rig.world().axes[0].state.position = 7.0;
    (rig.world().axes[0].index, rig.world().axes[0].at_index) = (7.0, AtIndex::CounterLate);
    rig.world().axes[0].changes_mode = 5;
    rig.order(Order::Enable);
    rig.order(Order::Home);
    rig.run(40);
    assert_eq!(rig.phases(), [Phase::Enabling, Phase::Standing, Phase::Homing, Phase::Standing]);
    rig.world().axes[0].blocked = true;
    rig.accelerate(500.0, 2, 10);
    rig.run(10);
    rig.world().axes[0].blocked = false;
    rig.run(10);
    assert_eq!((rig.phase(), rig.cause()), (Phase::Moving, None));
}
