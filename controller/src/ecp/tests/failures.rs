//! Failures of an instruction, and standstill after each failure.

use super::*;

#[test]
fn what_a_generator_must_not_ask_for_is_refused_with_everything_at_rest() {
    let there = |x: f64, v: f64| AxesState::new(axis_0(x), axis_0(v));
    let pose = |x: f64| Setpoint::Pose {
        pose: Pose::translation(x, 0.0, 0.0),
        linear: Vector3::x(),
        angular: Vector3::zeros(),
    };
    let limit = beyond(0, 6.0, 5.0);
    let cases = [
        (Setpoint::Joints(there(6.0, 0.0)), EcpError::OutOfReach { step: 0, error: limit }),
        (pose(6.0), EcpError::OutOfReach { step: 0, error: limit }),
        (Setpoint::Motors(there(f64::NAN, 0.0)), EcpError::NotFinite { step: 0, axis: 0 }),
        (Setpoint::Joints(there(0.0, f64::INFINITY)), EcpError::NotFinite { step: 0, axis: 0 }),
        (Setpoint::Joints(there(1.0, 1.0)), EcpError::Generator { step: 3, error: GeneratorError::User(7) }),
        (pose(1.0), EcpError::Generator { step: 3, error: GeneratorError::User(7) }),
    ];
    for (setpoint, error) in cases {
        let mut bench = Bench::ready();
        let task = Task::new().run(Ask(setpoint)).run(to(1.0, 0.0, 0.0));
        assert_eq!(bench.run(task), failed(error), "{setpoint:?}");
        assert_eq!(bench.servo.log.last(), Some(&Order::Stop), "{setpoint:?}");
        assert_eq!(bench.ecp.status().phase, Phase::Standing, "{setpoint:?}");
        assert_eq!(bench.run(Task::new().run(to(0.5, 0.0, 0.0))), finished(1), "{setpoint:?}");
    }
}

#[test]
fn a_servo_fault_ends_the_task_and_is_passed_on() {
    let fault = ServoFault::new(Some(1), StopCause::FollowingError { error: 2.0, limit: 1.5 });
    let mut bench = Bench::ready();
    bench.ecp.execute(Task::new().run(to(1.0, 0.0, 0.0)).run(to(0.0, 0.0, 0.0))).unwrap();
    let events = bench.go_on(|bench| {
        if bench.ecp.executed == 10 {
            bench.servo.fault.get_or_insert(fault);
        }
    });
    assert_eq!(events, failed(EcpError::Servo(fault)));
    bench.servo.fault = None;
    assert_eq!(bench.run(Task::new().enable()), failed(EcpError::Servo(fault)), "latched");
    assert_eq!(bench.run(Task::new().reset_fault().enable().run(to(0.0, 0.0, 0.0))), finished(3));
}

#[test]
fn a_failed_reset_ends_its_instruction_at_once_and_the_next_one_may_succeed() {
    let fault = ServoFault::new(Some(1), StopCause::FollowingError { error: 2.0, limit: 1.5 });
    let mut bench = Bench::ready();
    (bench.servo.fault, bench.servo.failing_resets) = (Some(fault), 2);
    assert_eq!(bench.run(Task::new().run(to(1.0, 0.0, 0.0))), failed(EcpError::Servo(fault)));
    for _ in 0..2 {
        let began = bench.now;
        assert_eq!(bench.run(Task::new().reset_fault().enable()), failed(EcpError::Servo(fault)));
        assert!(bench.now.since(began) < Duration::from_millis(100));
    }
    assert_eq!(bench.run(Task::new().reset_fault().enable()), finished(2));
}

#[test]
fn a_fault_keeps_the_number_of_its_macrostep_whatever_was_computed_after_it() {
    let fault = ServoFault::new(Some(1), StopCause::FollowingError { error: 2.0, limit: 1.5 });
    // Before the images of macrostep 10 are reported, after that, and in its first period.
    for period in [5, 9, 1] {
        let mut bench = Bench::ready();
        bench.ecp.execute(Task::new().run(to(1.0, 0.0, 0.0))).unwrap();
        let events = bench.go_on(|bench| {
            let Script { report, done, .. } = &bench.servo;
            if report.snapshot.macrostep == 10 && *done == period {
                bench.servo.fault = Some(fault);
            }
        });
        assert_eq!(events, failed(EcpError::Servo(fault)));
        assert!(bench.ecp.sent > 10, "{}", bench.ecp.sent);
        assert_eq!(bench.ecp.chart(), Some((ChartPhase::NextStep, Some(9))), "period {period}");
        assert_eq!(bench.ecp.fault_macrostep().map(u64::from), Some(10), "period {period}");
        assert_eq!(bench.run(Task::new().reset_fault()), finished(1));
        assert_eq!(bench.ecp.fault_macrostep(), None);
    }
}

#[test]
fn a_fault_in_a_macrostep_of_the_motion_before_has_no_step_in_the_next_one_and_a_fault_at_rest_no_macrostep() {
    let fault = ServoFault::new(Some(1), StopCause::FollowingError { error: 2.0, limit: 1.5 });
    let mut bench = Bench::ready();
    let through = JerkLimited::new(Space::Joint, 3, limits(), &[axis_0(0.3)]).unwrap().ending_at(axis_0(0.3)).unwrap();
    let back = JerkLimited::new(Space::Joint, 3, limits(), &[axis_0(0.0)]).unwrap();
    bench.ecp.execute(Task::new().run(through).run(back)).unwrap();
    let mut failed_at = 0;
    let events = bench.go_on(|bench| {
        if bench.ecp.status().instruction == Some(1) && failed_at == 0 {
            failed_at = bench.servo.report.snapshot.macrostep;
            bench.servo.fault = Some(fault);
        }
    });
    assert_eq!(events, [ended(0, Ok(())), ended(1, Err(EcpError::Servo(fault)))]);
    assert!(failed_at > 0 && failed_at <= bench.ecp.base, "{failed_at} of {}", bench.ecp.base);
    assert_eq!(bench.ecp.chart().unwrap().1, None);
    assert_eq!(bench.ecp.fault_macrostep().map(u64::from), Some(failed_at));
    assert_eq!(bench.run(Task::new().reset_fault().enable().run(to(0.5, 0.0, 0.0))), finished(3));
    bench.ecp.execute(Task::new().run(Wait { duration: Duration::from_secs(1) })).unwrap();
    bench.servo.fault = Some(fault);
    assert_eq!(bench.go_on(|_| {}), failed(EcpError::Servo(fault)));
    assert_eq!(bench.ecp.fault_macrostep(), None);
}

#[test]
fn a_stop_that_does_not_end_is_reported_by_the_fault_that_began_it() {
    let fault = ServoFault::new(Some(1), StopCause::Runaway { velocity: 300.0, limit: 250.0 });
    let mut bench = Bench::ready();
    let task = Task::new().run(to(1.0, 0.0, 0.0));
    bench.ecp.execute(task).unwrap();
    let mut told = false;
    let events = bench.go_on(|bench| {
        if bench.ecp.executed == 10 && !told {
            told = true;
            bench.servo.queue.clear();
            (bench.servo.moving, bench.servo.done) = ([0.0; MAX_AXES], 0);
            bench.servo.report.fault = Some(fault);
            bench.servo.phase(Phase::Stopping);
        }
    });
    assert_eq!(events, failed(EcpError::Servo(fault)));
}

#[test]
fn stop_brakes_and_drops_the_rest() {
    let mut bench = Bench::ready();
    bench.ecp.execute(Task::new().run(to(1.0, 0.0, 0.0)).run(to(0.0, 0.0, 0.0))).unwrap();
    let events = bench.go_on(|bench| {
        if bench.ecp.executed == 10 {
            bench.ecp.stop();
        }
    });
    assert_eq!(events, failed(EcpError::Stopped));
    assert_eq!(bench.servo.log.last(), Some(&Order::Stop));
    let stood = bench.servo.report.snapshot.commanded[0];
    assert!(stood > 0.0 && stood < 100.0);
    assert_eq!(bench.run(Task::new().run(to(1.0, 0.0, 0.0))), finished(1), "goes on from where it stands");
    let numbers: Vec<u64> = bench.servo.moves().map(|macrostep| macrostep.number).collect();
    assert_eq!(numbers, (1..=numbers.len() as u64).collect::<Vec<_>>(), "none is used twice");
    assert_eq!(bench.servo.report.snapshot.commanded[0], 100.0);
}

#[test]
fn a_stop_after_a_long_wait_for_a_partner_is_a_stop_and_no_silence_of_the_servo() {
    let mut bench = Bench::ready();
    bench.ecp.config.meeting = CONFIG.switching * 4;
    bench.ecp.execute(Task::new().meet(0).run(to(0.1, 0.0, 0.0))).unwrap();
    let end = bench.now + CONFIG.switching * 2;
    let events = bench.go_on(|bench| {
        if bench.now > end {
            bench.ecp.stop();
        }
    });
    assert_eq!(events, failed(EcpError::Stopped));
}

#[test]
fn a_motion_needs_drives_on_and_homed_axes() {
    let mut bench = Bench::new(16);
    assert_eq!(bench.run(Task::new().run(to(1.0, 0.0, 0.0))), failed(EcpError::NotStanding { phase: Phase::Off }));
    assert_eq!(bench.run(Task::new().home()), failed(EcpError::NotStanding { phase: Phase::Off }));
    assert_eq!(bench.run(Task::new().enable()), finished(1));
    assert_eq!(bench.run(Task::new().run(to(1.0, 0.0, 0.0))), failed(EcpError::NotHomed));
    assert_eq!(bench.servo.moves().count(), 0);
}

#[test]
fn a_servo_that_takes_no_orders_is_reported_in_time() {
    let mut bench = Bench::new(16);
    bench.servo.deaf = true;
    let waited = CONFIG.switching + PERIOD;
    assert_eq!(bench.run(Task::new().enable()), failed(EcpError::TimedOut { phase: Phase::Off, waited }));

    let mut bench = Bench::ready();
    bench.servo.deaf = true;
    let events = bench.run(Task::new().run(to(1.0, 0.0, 0.0)));
    assert!(
        matches!(events[..], [EcpEvent { instruction: 0, outcome: Err(EcpError::Silent { .. }), .. }]),
        "{events:?}"
    );
}

#[test]
fn homing_that_takes_too_long_is_stopped() {
    let mut bench = Bench::new(16);
    bench.servo.lost = true;
    let events = bench.run(Task::new().enable().home().run(to(1.0, 0.0, 0.0)));
    let waited = CONFIG.homing + PERIOD;
    let outcome = Err(EcpError::TimedOut { phase: Phase::Homing, waited });
    assert_eq!(events, [ended(0, Ok(())), ended(1, outcome)]);
    assert_eq!(bench.servo.log.last(), Some(&Order::Stop));
    assert_eq!(bench.ecp.status().phase, Phase::Standing);
}

#[test]
fn homing_that_the_servo_broke_off_is_not_waited_for() {
    let mut bench = Bench::new(16);
    bench.servo.lost = true;
    let task = Task::new().enable().home().run(to(1.0, 0.0, 0.0));
    bench.ecp.execute(task).unwrap();
    let events = bench.go_on(|bench| {
        if bench.ecp.status().phase == Phase::Homing {
            bench.servo.phase(Phase::Off);
        }
    });
    let outcome = Err(EcpError::BrokenOff { phase: Phase::Off });
    assert_eq!(events.last().copied(), Some(ended(1, outcome)));
    let took = bench.now.since(Instant::ZERO);
    assert!(took < CONFIG.homing, "{took:?}");
}
