//! Causes and course of stops.

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::*;
use crate::CellState;

#[test]
fn stop_and_disable_overtake_the_queue_and_brake() {
    // After 31 cycles, a macrostep was taken since the last search of the queue.
    let cases =
        [(Order::Stop, 30, Phase::Standing), (Order::Disable, 30, Phase::Off), (Order::Stop, 31, Phase::Standing)];
    for (order, cycles, end) in cases {
        let mut rig = Rig::standing(2);
        rig.accelerate(500.0, 2, 20);
        rig.run(cycles);
        rig.order(order);
        rig.run(1);
        assert_eq!(rig.phase(), Phase::Stopping);
        rig.run_until(end);
        assert_eq!(rig.cause(), None);
        let begun = (cycles as u64).div_ceil(10);
        assert_eq!(rig.servo.counters().refused_orders, 22 - begun);
        keeps_limits(&rig.positions(0)).unwrap();
    }
}

#[test]
fn a_drive_that_stops_following_stops_the_effector() {
    let mut rig = Rig::standing(2);
    rig.accelerate(500.0, 4, 50);
    rig.run(50);
    rig.world().axes[1].deaf = true;
    rig.run_until(Phase::Faulted);
    assert!(matches!(rig.cause(), Some(StopCause::FollowingError { .. })));
    assert_eq!(rig.servo.fault(0).unwrap().axis, Some(1));
}

#[test]
fn power_stays_on_until_the_motors_are_still_or_have_had_their_time() {
    // From 30 rad/s, a motor at 1000 rad/s² rests within the following error of 0.5 rad, and from 50 rad/s it does not.
    for (velocity, cycles, end) in
        [(0.5, 1..=3, Phase::Off), (30.0, 100..=104, Phase::Off), (50.0, 3..=6, Phase::Faulted)]
    {
        let mut rig = Rig::standing(1);
        rig.accelerate(500.0, 2, 20);
        rig.run(40);
        rig.order(Order::Disable);
        // 10 rad/s at 1000 rad/s²: ten set-points, after which the drive continues by itself.
        rig.run(10);
        rig.world().axes[0].drifts_at = Some(velocity);
        let before = rig.now;
        rig.run_until(end);
        let waited = rig.now.since(before).as_millis();
        assert!(cycles.contains(&waited), "{waited} periods at {velocity} rad/s");
        let cut = rig.servo.fault(0).map(|fault| fault.category);
        assert_eq!(cut, (end == Phase::Faulted).then_some(crate::StopCategory::Zero));
    }
}

#[test]
fn effectors_stop_each_for_itself_and_for_overruns_together() {
    let mut config = scripted::config(2);
    config.effectors.push(scripted::config(2).effectors.remove(0));
    for (group, axes) in [(1, 0), (0, 1)] {
        // Each effector has one axis on either group.
        config.effectors[0].axes[axes].group = group;
        config.effectors[1].axes[axes].group = 1 - group;
    }
    let (groups, worlds): (Vec<_>, Vec<_>) = (0..2).map(|_| scripted::group(2)).unzip();
    for world in &worlds {
        let mut world = world.lock().unwrap();
        world.axes.iter_mut().for_each(|drive| drive.state.homing = Homing::Attained);
    }
    let (mut servo, mut links) = Servo::new(&config, groups).unwrap();
    let mut now = Instant::ZERO;
    let mut run = |servo: &mut Servo, cycles| {
        for _ in 0..cycles {
            servo.step(now);
            now += PERIOD;
        }
    };
    for link in &mut links {
        link.orders.push(Order::Enable).unwrap();
        (0..20).for_each(|number| {
            let position = 0.01 * (number % 2) as f64;
            link.orders.push(Order::Move(macrostep(number, 10, position, 0.0))).unwrap();
        });
    }
    let phases = |servo: &Servo| [0, 1].map(|index| servo.state(index).unwrap().phase());
    run(&mut servo, 50);
    assert_eq!(phases(&servo), [Phase::Moving; 2]);
    // Axis 0 of the first effector is on the second group.
    worlds[1].lock().unwrap().axes[0].state.fault = Some(FAULT);
    run(&mut servo, 50);
    assert_eq!(phases(&servo), [Phase::Faulted, Phase::Moving]);
    assert_eq!(servo.fault(0).unwrap().axis, Some(0));
    servo.missed(3);
    run(&mut servo, 50);
    assert_eq!(phases(&servo), [Phase::Faulted; 2]);
    assert_eq!(servo.fault(0).unwrap().cause, StopCause::Drive(FAULT));
    assert_eq!(servo.fault(1).unwrap().cause, StopCause::Overrun { missed: 3 });
}

#[test]
fn after_a_cycle_that_panics_in_motion_a_stop_keeps_the_limits() {
    let mut rig = Rig::standing(2);
    rig.accelerate(500.0, 4, 50);
    rig.run(60);
    rig.world().panics = 1;
    let panic = catch_unwind(AssertUnwindSafe(|| rig.run(1)));
    assert!(panic.is_err());
    rig.servo.cycle_panicked();
    rig.servo.stop_request().request();
    rig.run(1);
    assert_eq!(rig.phase(), Phase::Stopping);
    rig.run_until(Phase::Off);
    keeps_limits(&rig.positions(0)).unwrap();
}

#[test]
fn a_blocked_motor_stops_the_effector() {
    let mut rig = Rig::standing(2);
    rig.accelerate(500.0, 4, 50);
    rig.run(50);
    rig.world().axes[1].blocked = true;
    rig.run_until(Phase::Faulted);
    assert!(matches!(rig.cause(), Some(StopCause::Frozen { .. })));
    assert_eq!(rig.servo.fault(0).unwrap().axis, Some(1));
    keeps_limits(&rig.positions(0)).unwrap();
}

/// A motor that an obstacle slowed stands far behind its set-point until its power is off. Enabling takes its position as
/// the set-point. The following error changes in one step, without a motion of the set-points.
#[test]
fn a_motor_that_stood_behind_its_set_point_is_enabled_again_without_a_fault() {
    for fails in [true, false] {
        let mut rig = Rig::standing(2);
        rig.accelerate(500.0, 2, 50);
        rig.run(20);
        rig.world().axes[1].runs_at = Some(2.0);
        if fails {
            rig.run_until(Phase::Stopping);
            assert!(matches!(rig.cause(), Some(StopCause::FollowingError { .. })), "{:?}", rig.cause());
        } else {
            rig.run(45);
            rig.order(Order::Disable);
        }
        rig.world().axes[1].runs_at = None;
        rig.world().axes[1].blocked = true;
        rig.run_until(if fails { Phase::Faulted } else { Phase::Off });
        rig.world().axes[1].blocked = false;
        if fails {
            rig.order(Order::ResetFault);
            rig.run_until(Phase::Off);
            rig.world().axes[1].state.homing = Homing::Attained;
        }
        rig.order(Order::Enable);
        rig.run(50);
        assert_eq!((rig.phase(), rig.cause()), (Phase::Standing, None), "{fails}");
        // The monitoring starts again.
        let at = rig.world().axes[1].state.position;
        rig.world().axes[1].blocked = true;
        let here = rig.world().axes[0].state.position;
        let mut step = macrostep(900, 100, here, 0.0);
        (step.position[1], step.velocity[1]) = (at + 1.0, 20.0);
        rig.order(Order::Move(step));
        rig.run(200);
        assert!(matches!(rig.cause(), Some(StopCause::Frozen { .. })), "{:?}", rig.cause());
    }
}

/// The torque of a motor, its limit, N·m, and whether the drive reports a limit.
fn load(rig: &Rig, axis: usize, torque: f64, torque_limit: f64, torque_limited: bool) {
    let state = &mut rig.world().axes[axis].state;
    (state.torque, state.torque_limit, state.torque_limited) = (torque, torque_limit, torque_limited);
}

#[test]
fn a_motor_that_stands_still_with_its_torque_at_the_limit_is_blocked_or_overloaded() {
    for (torque, limit, limited, blocked) in [
        (2.1, 0.42, false, true),
        (0.4, 0.42, false, true),
        // The motor does not push towards its set-point.
        (-2.1, 0.42, false, false),
        (0.25, 0.42, true, true),
        (0.25, 0.42, false, false),
        (2.1, 0.0, true, false),
    ] {
        let mut rig = Rig::standing(2);
        rig.accelerate(500.0, 4, 50);
        rig.run(50);
        load(&rig, 1, torque, limit, limited);
        rig.world().axes[1].blocked = true;
        rig.run_until(Phase::Faulted);
        let fault = rig.servo.fault(0).unwrap();
        assert_eq!(fault.axis, Some(1));
        match fault.cause {
            StopCause::Blocked { torque: found, limit: of, behind, stands: true } if blocked => {
                assert_eq!((found, of), (torque, limit));
                assert!(behind > 0.0, "{behind}");
            }
            StopCause::Frozen { .. } if !blocked => {}
            other => panic!("{torque} of {limit}: {other}"),
        }
        assert_eq!(fault.to_string().contains("axis 1: blocked or overloaded: torque "), blocked, "{fault}");
    }
}

#[test]
fn a_following_error_with_the_torque_at_its_limit_is_that_of_a_blocked_or_overloaded_axis() {
    let mut config = scripted::config(1);
    config.effectors[0].axes[0].following_error = 0.019;
    // Torque, N·m, and whether the motor moves away from its set-point.
    for (torque, leaves, blocked) in [(0.1, false, false), (0.42, false, true), (0.42, true, false)] {
        let mut rig = Rig::with(&config).stand();
        load(&rig, 0, torque, 0.42, false);
        rig.world().axes[0].lags = true;
        rig.world().axes[0].drifts_at = leaves.then_some(-20.0);
        rig.accelerate(500.0, 4, 2);
        rig.run(55);
        let text = rig.servo.fault(0).unwrap().to_string();
        match rig.cause() {
            Some(StopCause::Blocked { behind, stands: false, .. }) if blocked => {
                assert!(behind > 0.019, "{behind}");
                assert_eq!(text, "axis 0: blocked or overloaded: torque 100 % of 0.42 N·m, 0.019 rad behind");
            }
            Some(StopCause::FollowingError { .. }) if !blocked => {}
            other => panic!("{torque} {leaves}: {other:?}"),
        }
    }
}

#[test]
fn a_drive_fault_brakes_the_other_axes_before_power_goes() {
    let mut rig = Rig::standing(3);
    rig.accelerate(500.0, 4, 20);
    rig.run(60);
    rig.world().axes[1].state.fault = Some(FAULT);
    rig.run_until(Phase::Stopping);
    let sent = rig.last_sent();
    assert_eq!(sent[1], AxisCommand::Stand, "its group brakes it");
    assert!([0, 2].iter().all(|&axis| matches!(sent[axis], AxisCommand::Follow(_))));
    rig.run_until(Phase::Faulted);
    assert_eq!(rig.cause(), Some(StopCause::Drive(FAULT)));
    assert_eq!(rig.last_sent(), [AxisCommand::Off; 3]);
    keeps_limits(&rig.positions(0)).unwrap();
    assert_eq!(rig.positions(0), rig.positions(2));

    // Only a reset leaves this state.
    rig.order(Order::Enable);
    rig.order(Order::Home);
    rig.run(5);
    assert_eq!((rig.phase(), rig.last_sent()), (Phase::Faulted, vec![AxisCommand::Off; 3]));
    rig.order(Order::ResetFault);
    rig.order(Order::Enable);
    rig.run(30);
    assert_eq!((rig.phase(), rig.cause()), (Phase::Standing, None));
}

#[test]
fn a_drive_that_brakes_by_itself_keeps_its_power_until_it_is_still() {
    for (still_after, waited) in [(150, 150..=160), (1000, 210..=220)] {
        let mut rig = Rig::standing(2);
        rig.accelerate(500.0, 2, 20);
        rig.run(30);
        rig.world().axes[1].drifts_at = Some(10.0);
        rig.world().axes[1].state.fault = Some(FAULT);
        let before = rig.now;
        rig.run(still_after.min(200));
        assert_eq!(rig.phase(), Phase::Stopping);
        if still_after < 200 {
            rig.world().axes[1].drifts_at = None;
        }
        rig.run_until(Phase::Faulted);
        let took = rig.now.since(before).as_millis();
        assert!(waited.contains(&took), "{took} periods");
    }
}

#[test]
fn a_stop_request_brakes_switches_off_and_holds() {
    let mut rig = Rig::standing(2);
    rig.accelerate(500.0, 4, 20);
    rig.run(60);
    assert_eq!(rig.servo.cell_state(), CellState::Running);
    rig.servo.stop_request().request();
    rig.run(1);
    assert_eq!(rig.servo.cell_state(), CellState::Stopping);
    rig.run_until(Phase::Off);
    assert_eq!(rig.cause(), None);
    keeps_limits(&rig.positions(0)).unwrap();
    rig.world().sent.clear();
    rig.order(Order::Enable);
    rig.run(5);
    rig.order(Order::Enable);
    rig.order(Order::Stop);
    rig.run(5);
    let off = |command: &AxisCommand| *command == AxisCommand::Off;
    assert!(rig.world().sent.iter().flatten().all(off));
    assert_eq!((rig.phase(), rig.last_sent()), (Phase::Off, vec![AxisCommand::Off; 2]));
    assert!(rig.servo.is_off());
    assert_eq!(rig.servo.cell_state(), CellState::Off);
    assert!(rig.world().axes.iter().all(|drive| drive.state.power == Power::Off));
}

#[test]
fn missed_cycles_stop_the_effector_only_beyond_the_allowed_row() {
    // Number of missed deadlines before each cycle, and whether the row is an overrun.
    let cases: [(&[u32], Option<u32>); 5] = [
        (&[2, 0, 2, 0, 2], None),
        (&[1, 1, 0, 1, 1], None),
        (&[3], Some(3)),
        (&[1, 1, 1], Some(3)),
        (&[2, 0, 2, 1], Some(3)),
    ];
    for (missed, expected) in cases {
        let mut rig = Rig::standing(1);
        rig.accelerate(500.0, 4, 20);
        rig.run(50);
        for &count in missed {
            rig.servo.missed(count);
            rig.run(1);
        }
        let cause = expected.map(|missed| StopCause::Overrun { missed });
        assert_eq!(rig.cause(), cause, "{missed:?}");
        assert_eq!(rig.phase() == Phase::Stopping, expected.is_some(), "{missed:?}");
        assert_eq!(rig.servo.counters().missed_cycles, u64::from(missed.iter().sum::<u32>()));
        if expected.is_none() {
            keeps_limits(&rig.positions(0)).unwrap();
        }
    }
}

#[test]
fn missed_cycles_in_short_rows_stop_the_effector_beyond_a_quarter_of_the_deadlines() {
    // Missed deadlines before each cycle in turn, and whether they stop the effector after 1000 deadlines.
    let cases: [(&[u32], bool); 3] = [(&[1, 0, 0], false), (&[1, 0, 1, 0, 0], true), (&[2, 0], true)];
    for (missed, stops) in cases {
        let mut rig = Rig::standing(1);
        let mut deadlines = 0;
        for &count in missed.iter().cycle() {
            assert_eq!(rig.cause(), None, "{missed:?} at {deadlines}");
            rig.servo.missed(count);
            rig.run(1);
            deadlines += count + 1;
            if rig.cause().is_some() || deadlines > 3000 {
                break;
            }
        }
        let overloaded = matches!(rig.cause(), Some(StopCause::Overloaded { missed, deadlines: 1000..=1002 })
            if (251..=502).contains(&missed));
        assert_eq!((overloaded, rig.cause().is_some()), (stops, stops), "{missed:?}: {:?}", rig.cause());
    }
}

#[test]
fn the_slowest_stop_is_known() {
    let rig = Rig::new(1);
    assert_eq!(rig.servo.longest_stop(), Duration::from_millis(400));
}

#[test]
fn no_drive_is_handed_two_steps_at_once_after_a_batch_was_refused() {
    for refused in [1, 2, 8] {
        let mut rig = Rig::standing(2);
        rig.accelerate(500.0, 4, 50);
        rig.run(60);
        rig.world().refuses = refused;
        rig.run(100);
        assert_eq!(rig.world().refuses, 0);
        assert_eq!(rig.phase(), Phase::Moving, "{refused} refused: {:?}", rig.cause());
        keeps_limits(&rig.positions(0)).unwrap();
    }
}

#[test]
fn no_drive_is_handed_two_steps_at_once_after_a_batch_of_a_stop_was_refused() {
    for refused in [1, 3, 4, 8] {
        let mut rig = Rig::standing(2);
        rig.accelerate(500.0, 8, 50);
        rig.run(100);
        rig.order(Order::Stop);
        rig.run(5);
        let before = rig.positions(0).len();
        rig.world().refuses = refused;
        rig.run(60);
        assert_eq!((rig.world().refuses, rig.phase(), rig.cause()), (0, Phase::Standing, None), "{refused} refused");
        // The motor stands at the last set-point that was sent, so it stops there or goes on from there.
        let sent = rig.positions(0);
        let steps: Vec<_> = sent[before - 2..].windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(steps.iter().all(|step| (-1e-12..=steps[0]).contains(step)), "{refused} refused: {steps:?}");
    }
}

#[test]
fn a_motor_that_stands_because_the_other_bus_of_its_robot_refused_a_batch_is_not_frozen() {
    let mut buses = TwoBuses::standing(scripted::config(2));
    accelerating(500.0, 4, 36).into_iter().for_each(|step| buses.order(Order::Move(step)));
    buses.run(60);
    // The drive on bus 1 gets the same set-point again in each cycle, and answers each SYNC. Its motor starts late.
    buses.world(0).refuses = 8;
    buses.run(8);
    let here = buses.world(1).axes[0].state.position;
    buses.world(1).axes[0].frozen = Some(here);
    buses.run(3);
    buses.world(1).axes[0].frozen = None;
    buses.run(50);
    assert_eq!(buses.world(0).refuses, 0);
    assert_eq!(buses.servo.state(0).unwrap().phase(), Phase::Moving, "{:?}", buses.servo.fault(0));
}

#[test]
fn an_overrun_stops_where_the_drives_already_stand() {
    let mut rig = Rig::standing(2);
    rig.accelerate(500.0, 4, 50);
    rig.run(60);
    let stood = *rig.positions(0).last().unwrap();
    rig.servo.missed(3);
    rig.run_until(Phase::Faulted);
    assert_eq!(rig.cause(), Some(StopCause::Overrun { missed: 3 }));
    assert_eq!(rig.servo.fault(0).unwrap().axis, None);
    assert_eq!(*rig.positions(0).last().unwrap(), stood);
}

#[test]
fn a_bus_that_takes_nothing_does_not_hold_up_a_stop() {
    let mut rig = Rig::standing(2);
    rig.accelerate(500.0, 4, 50);
    rig.run(60);
    rig.world().refuses = u32::MAX;
    rig.order(Order::Disable);
    rig.run(200);
    assert_eq!(rig.phase(), Phase::Off);
}

/// Two effectors of one axis each, each on its own group, at 10 rad/s.
fn two_in_motion(config: &ServoConfig) -> (Servo, Vec<EffectorLink>, Vec<Arc<Mutex<World>>>) {
    let mut config = config.clone();
    let mut other = config.effectors[0].clone();
    other.axes[0].group = 1;
    config.effectors.push(other);
    let (groups, worlds): (Vec<_>, Vec<_>) = (0..2).map(|_| scripted::group(1)).unzip();
    for world in &worlds {
        world.lock().unwrap().axes[0].state.homing = Homing::Attained;
    }
    let (mut servo, mut links) = Servo::new(&config, groups).unwrap();
    for link in &mut links {
        link.orders.push(Order::Enable).unwrap();
    }
    for cycle in 0..60 {
        if cycle == 20 {
            for link in &mut links {
                for number in 1..=50 {
                    // Acceleration to 10 rad/s in 20 ms, then constant speed.
                    let time = 0.01 * number as f64;
                    let velocity = (500.0 * time).min(10.0);
                    let position = if number <= 2 { 250.0 * time * time } else { 0.1 + 10.0 * (time - 0.02) };
                    let next = macrostep(number, 10, position, velocity);
                    link.orders.push(Order::Move(next)).unwrap();
                }
            }
        }
        servo.step(Instant::ZERO + PERIOD * cycle);
    }
    for (index, world) in worlds.iter().enumerate() {
        let phase = servo.state(index).unwrap().phase();
        assert_eq!(phase, Phase::Moving, "{:?}", servo.fault(index));
        world.lock().unwrap().sent.clear();
    }
    (servo, links, worlds)
}

#[test]
fn a_bus_that_is_gone_or_full_holds_up_no_effector_of_another() {
    for gone in [true, false] {
        let (mut servo, _links, worlds) = two_in_motion(&scripted::config(1));
        {
            let mut lost = worlds[0].lock().unwrap();
            lost.gone = gone;
            lost.refuses = u32::MAX;
        }
        for cycle in 60..360 {
            servo.step(Instant::ZERO + PERIOD * cycle);
        }
        let stopped = if gone { Phase::Faulted } else { Phase::Moving };
        let phases = [0, 1].map(|index| servo.state(index).unwrap().phase());
        assert_eq!(phases, [stopped, Phase::Moving], "gone: {gone}");
        let other = worlds[1].lock().unwrap();
        let positions: Vec<f64> = other.sent.iter().map(|batch| set_point(batch)).collect();
        assert_eq!(positions.len(), 300);
        let way = positions[299] - positions[0];
        assert!((way - 2.99).abs() < 1e-9, "gone: {gone}: {way} rad in 299 periods");
        keeps_limits(&positions).unwrap();
    }
}

fn set_point(batch: &[AxisCommand]) -> f64 {
    match batch[0] {
        AxisCommand::Follow(Setpoint::Position(position)) => position.get(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_stop_ends_in_time_though_its_bus_is_gone_or_takes_nothing() {
    for config in [scripted::config(2), scripted::host_config(2)] {
        for gone in [true, false] {
            let mut rig = Rig::with(&config).stand();
            let mut records = rig.servo.record(2000);
            rig.accelerate(500.0, 4, 50);
            rig.run(100);
            assert_eq!(rig.phase(), Phase::Moving, "{:?}", rig.cause());
            {
                let mut world = rig.world();
                world.gone = gone;
                world.refuses = u32::MAX;
            }
            rig.order(Order::Disable);
            let before = rig.now;
            rig.run_until(if gone { Phase::Faulted } else { Phase::Off });
            // From 20 rad/s at 1000 rad/s², and the standstill wait.
            let took = rig.now.since(before);
            let wait = if gone { 100 + 100 } else { 100 };
            let longest = Duration::from_millis(20 + wait + 10);
            assert!(took <= longest, "gone: {gone}: {took:?}");
            if gone {
                assert_eq!(rig.cause(), Some(StopCause::Drive(FAULT)));
            }
            let records: Vec<_> = std::iter::from_fn(|| records.pop().ok()).collect();
            let lost = &records[101..];
            for record in lost {
                for axis in 0..2 {
                    let way = (record.axis[axis].commanded - records[100].axis[axis].commanded).abs();
                    // Full speed until the stop begins, and the stop itself.
                    let most = if gone { 0.0 } else { 20.0 * 0.03 };
                    assert!(way <= most, "gone: {gone}: commanded {way} rad on");
                }
            }
        }
    }
}

#[test]
fn an_enable_order_before_a_stop_order_gives_power() {
    let mut rig = Rig::new(1);
    rig.world().axes[0].state.homing = Homing::Attained;
    rig.order(Order::Enable);
    rig.order(Order::Stop);
    rig.run(20);
    assert_eq!((rig.phase(), rig.servo.counters().refused_orders), (Phase::Standing, 0));
}
