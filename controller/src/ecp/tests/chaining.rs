//! Instructions that continue one another at speed, and generators that are replaced in motion.

use servo::{Knot, quintic};

use super::*;

/// The events of a motion that is replaced, and of its replacement.
fn replaced() -> [EcpEvent; 2] {
    [EcpEvent { replaced: true, ..ended(0, Ok(())) }, ended(1, Ok(()))]
}

fn jerk_limited(x: f64) -> JerkLimited {
    JerkLimited::new(Space::Joint, 3, limits(), &[axis_0(x)]).unwrap()
}

/// A motion of joint 0 to `x`, m, that ends at `velocity`, m/s.
fn through(x: f64, velocity: f64) -> JerkLimited {
    jerk_limited(x).ending_at(axis_0(velocity)).unwrap()
}

/// Greatest velocity, acceleration and jerk of joint 0 on the interpolated macrosteps, m and s, from rest at zero.
fn peaks(bench: &Bench) -> [f64; 3] {
    const GEAR: f64 = 100.0;
    let mut from = Knot::default();
    let mut most = [0.0_f64; 3];
    for macrostep in bench.servo.moves() {
        let duration = PERIOD.as_secs_f64() * f64::from(macrostep.steps);
        let acceleration = macrostep.acceleration.expect("an ECP states accelerations")[0];
        let to = Knot { acceleration, ..Knot::new(macrostep.position[0], macrostep.velocity[0]) };
        let mut last = from.acceleration;
        for period in 1..=macrostep.steps {
            let knot = quintic(from, to, duration, f64::from(period) / f64::from(macrostep.steps));
            let jerk = (knot.acceleration - last) / PERIOD.as_secs_f64();
            last = knot.acceleration;
            for (most, value) in most.iter_mut().zip([knot.velocity, knot.acceleration, jerk]) {
                *most = most.max(value.abs() / GEAR);
            }
        }
        from = to;
    }
    most
}

fn stopped(bench: &Bench) -> bool {
    bench.servo.log.contains(&Order::Stop)
}

fn at_end(bench: &Bench) -> f64 {
    bench.servo.report.snapshot.commanded[0]
}

#[test]
fn instructions_chain_at_speed() {
    let mut bench = Bench::ready();
    let task = Task::new().run(through(0.5, 0.6)).run(through(0.8, -0.2)).run(jerk_limited(0.0));
    assert_eq!(bench.run(task), finished(3));
    assert!(!stopped(&bench));
    let moves: Vec<Macrostep> = bench.servo.moves().copied().collect();
    assert!(moves.windows(2).all(|pair| pair[1].number == pair[0].number + 1));
    for (position, velocity) in [(50.0, 60.0), (80.0, -20.0)] {
        let met =
            |it: &&Macrostep| (it.position[0] - position).abs() < 1e-6 && (it.velocity[0] - velocity).abs() < 1e-6;
        assert!(moves.iter().find(met).is_some(), "passes {position} at {velocity}");
    }
    assert!(at_end(&bench).abs() < 1e-9);
    let [velocity, acceleration, jerk] = peaks(&bench);
    assert!(velocity < 1.02 && acceleration < 5.0 * 1.1 && jerk < 50.0 * 2.0, "{velocity} {acceleration} {jerk}");
}

#[test]
fn a_generator_that_begins_at_rest_follows_after_a_stop() {
    let mut bench = Bench::ready();
    assert_eq!(bench.run(Task::new().run(through(0.5, 0.6)).run(to(1.0, 0.0, 0.0))), finished(2));
    assert!(stopped(&bench));
    assert!((at_end(&bench) - 100.0).abs() < 1e-6);
}

#[test]
fn a_motion_is_replaced_without_a_stop_and_within_its_limits() {
    for period in [1, 57, 200, 333, 450, 520] {
        let mut bench = Bench::ready();
        bench.ecp.execute(Task::new().run(jerk_limited(1.0))).unwrap();
        let mut count = 0;
        let events = bench.go_on(|bench| {
            count += 1;
            if count == period {
                bench.ecp.replace(jerk_limited(0.2)).unwrap();
            }
        });
        assert_eq!(events, replaced(), "{period}");
        assert!(!stopped(&bench), "{period}");
        assert!((at_end(&bench) - 20.0).abs() < 1e-6, "{period}: {}", at_end(&bench));
        let [velocity, acceleration, jerk] = peaks(&bench);
        assert!(velocity < 1.02 && acceleration < 5.0 * 1.1 && jerk < 50.0 * 2.0, "{velocity} {acceleration} {jerk}");
    }
}

#[test]
fn without_a_running_generator_there_is_nothing_to_replace() {
    let mut bench = Bench::ready();
    assert_eq!(bench.ecp.replace(jerk_limited(0.2)), Err(ReplaceRefused::NotRunning));
}

#[test]
fn a_first_step_that_refuses_in_motion_brakes_the_effector() {
    let mut bench = Bench::ready();
    let mut refused = jerk_limited(1.0).lasting(Duration::from_millis(1));
    refused = refused.ending_at(axis_0(0.0)).unwrap();
    let events = bench.run(Task::new().run(through(0.5, 0.6)).run(refused).run(jerk_limited(0.0)));
    let [first, EcpEvent { instruction: 1, outcome: Err(EcpError::Generator { step: 0, error }), .. }] = events[..]
    else {
        panic!("{events:?}");
    };
    assert_eq!(first, ended(0, Ok(())));
    assert!(matches!(error, GeneratorError::TooShort { .. }), "{error}");
    assert!(stopped(&bench));
    assert_eq!(bench.ecp.status().phase, Phase::Standing);
}

#[test]
fn a_plan_that_comes_after_the_last_macrostep_brakes_the_effector() {
    let mut bench = Bench::ready();
    let held = planning::Held::on(&mut bench);
    bench.ecp.execute(Task::new().run(through(0.5, 0.6)).run(jerk_limited(1.0))).unwrap();
    let mut first = true;
    let events = bench.go_on(|_| {
        if std::mem::take(&mut first) {
            held.compute();
        }
    });
    let [EcpEvent { outcome: Ok(()), .. }, EcpEvent { outcome: Err(EcpError::Unplanned { waited }), .. }] = events[..]
    else {
        panic!("{events:?}");
    };
    // Four macrosteps ahead were left.
    assert!(waited <= PERIOD * 40, "{waited:?}");
    assert_eq!(bench.servo.log.last(), Some(&Order::Stop));
    assert_eq!(bench.ecp.status().phase, Phase::Standing);
}

#[test]
fn a_velocity_that_no_end_may_have_is_refused() {
    let error = |velocity| jerk_limited(1.0).ending_at(axis_0(velocity)).unwrap_err();
    assert_eq!(error(1.5), GeneratorError::EndVelocity { axis: 0, value: 1.5, limit: 1.0 });
    assert_eq!(error(f64::NAN), GeneratorError::NotFinite { pose: 0, axis: 0 });
    let passing = JerkLimited::new(Space::Joint, 3, limits(), &[axis_0(0.5), axis_0(1.0)]).unwrap();
    assert_eq!(passing.ending_at(axis_0(0.1)).unwrap_err(), GeneratorError::PassesPoses);
}

#[test]
fn a_generator_that_is_sent_less_far_ahead_is_replaced_sooner() {
    let turned_back = |ahead: u16| {
        let mut bench = Bench::ready();
        bench.ecp.execute(Task::new().run(jerk_limited(1.0).sent_ahead(ahead))).unwrap();
        let mut count = 0;
        let events = bench.go_on(|bench| {
            count += 1;
            if count == 200 {
                bench.ecp.replace(jerk_limited(0.0)).unwrap();
            }
        });
        assert_eq!(events, replaced());
        bench.servo.moves().map(|it| it.position[0]).fold(0.0, f64::max)
    };
    assert!(turned_back(1) < turned_back(4));
    // The number of the cell is the most.
    assert_eq!(turned_back(4), turned_back(50));
}

#[test]
fn a_chain_with_one_macrostep_ahead_allows_a_plan_that_comes_one_poll_later() {
    let mut bench = Bench::ready();
    let held = planning::Held::on(&mut bench);
    bench.ecp.execute(Task::new().run(through(0.5, 0.6).sent_ahead(1)).run(jerk_limited(1.0))).unwrap();
    let events = bench.go_on(|_| held.compute_all());
    assert_eq!(events, finished(2));
    assert!(!stopped(&bench));
}

#[test]
fn a_fault_while_a_motion_is_planned_in_motion_leaves_nothing_for_the_next_motion() {
    let fault = ServoFault::new(Some(0), StopCause::FollowingError { error: 2.0, limit: 1.5 });
    let mut bench = Bench::ready();
    let held = planning::Held::on(&mut bench);
    bench.ecp.execute(Task::new().run(through(0.5, 0.6)).run(jerk_limited(1.0))).unwrap();
    let mut period = 0;
    let events = bench.go_on(|bench| {
        period += 1;
        match period {
            1 => held.compute_all(),
            _ if bench.ecp.in_motion => _ = bench.servo.fault.get_or_insert(fault),
            _ => {}
        }
    });
    assert_eq!(events.last().unwrap().outcome, Err(EcpError::Servo(fault)));
    bench.servo.fault = None;
    bench.ecp.plan_with(Box::new(AtOnce::default()));
    assert_eq!(
        bench.run(Task::new().reset_fault().run(jerk_limited(0.0))).last().unwrap().outcome,
        Err(EcpError::NotStanding { phase: Phase::Off })
    );
    assert_eq!(bench.run(Task::new().enable().run(jerk_limited(0.0))), finished(2));
    assert_eq!(at_end(&bench), 0.0);
}

/// Moves joint 0 by two macrosteps, and ends in motion.
struct Nudge;

impl Generator for Nudge {
    type First = ();
    type Every = ();
    type Out = ();
    type Memory = u32;

    fn first_step(&mut self, _: &(), _: Duration) -> Result<Next<u32>, GeneratorError> {
        Ok(Next::remember(0))
    }
    fn terminal(&self, steps: &u32, _: &()) -> bool {
        *steps == 2
    }
    fn next_step(&self, steps: &u32, _: &()) -> Result<Next<u32>, GeneratorError> {
        Ok(Next::command(Setpoint::JointsBy(AxesState::new(axis_0(0.002), axis_0(0.1))), steps + 1))
    }
}

#[test]
fn a_hold_does_not_part_a_chain_whose_macrosteps_are_sent() {
    let mut bench = Bench::ready();
    let held = planning::Held::on(&mut bench);
    bench.ecp.execute(Task::new().run(Nudge).run(jerk_limited(0.0))).unwrap();
    let events = bench.go_on(|bench| {
        // The first motion is sent in the poll that takes its plan.
        held.compute_all();
        bench.ecp.hold(true);
        assert!(!bench.ecp.is_held());
    });
    assert_eq!(events, finished(2));
    assert!(!stopped(&bench));
}

/// Begins in motion, and continues at the same velocity. Class 1.
struct Slide;

impl Generator for Slide {
    type First = EffectorImage;
    type Every = EffectorImage;
    type Out = ();
    type Memory = ();

    fn begins_in_motion(&self) -> bool {
        true
    }
    fn first_step(&mut self, _: &EffectorImage, _: Duration) -> Result<Next<()>, GeneratorError> {
        Ok(Next::remember(()))
    }
    fn terminal(&self, (): &(), _: &EffectorImage) -> bool {
        false
    }
    fn next_step(&self, (): &(), e: &EffectorImage) -> Result<Next<()>, GeneratorError> {
        let velocity = e.commanded.joints.velocity;
        let by = velocity.map(|velocity| velocity * (10 * PERIOD).as_secs_f64());
        Ok(Next::command(Setpoint::JointsBy(AxesState::new(by, velocity)), ()))
    }
}

#[test]
fn a_late_plan_brakes_the_effector_also_if_the_motion_before_has_sent_nothing() {
    let mut bench = Bench::ready();
    let held = planning::Held::on(&mut bench);
    bench.ecp.execute(Task::new().run(jerk_limited(1.0))).unwrap();
    let (mut count, mut replacements) = (0, 0);
    let events = bench.go_on(|bench| {
        count += 1;
        if replacements < 2 {
            held.compute_all();
        }
        // The macrosteps of the first motion have one period. The second motion reads its images after the last of them.
        let due = [count == 200, replacements == 1 && count > 205 && bench.ecp.outstanding() == 1][replacements.min(1)];
        if due && replacements < 2 {
            replacements += 1;
            bench.ecp.replace(Slide).unwrap();
        }
    });
    let Some(EcpEvent { outcome: Err(EcpError::Unplanned { .. }), .. }) = events.last() else {
        panic!("{events:?}");
    };
    assert_eq!((bench.ecp.status().phase, bench.servo.log.last()), (Phase::Standing, Some(&Order::Stop)));
}
