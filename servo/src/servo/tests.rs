use std::sync::{Arc, Mutex, MutexGuard};
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use drive::{AxisCommand, Homing, Power, Setpoint};
use proptest::prelude::*;

use crate::scripted::{self, FAULT, MAX_ACCELERATION, MAX_VELOCITY, PERIOD, World};
use crate::{
    EffectorLink, MAX_AXES, Macrostep, Order, Phase, Report, Servo, ServoConfig, StopCause,
};

const DT: f64 = 1e-3;

struct Rig {
    servo: Servo,
    link: EffectorLink,
    world: Arc<Mutex<World>>,
    now: Instant,
    axes: usize,
}

impl Rig {
    fn new(axes: usize) -> Self {
        Self::with(&scripted::config(axes))
    }

    fn with(config: &ServoConfig) -> Self {
        let axes = config.effectors[0].axes.len();
        let (group, world) = scripted::group(axes);
        let (servo, mut links) = Servo::new(config, vec![group]).unwrap();
        Self {
            servo,
            link: links.remove(0),
            world,
            now: Instant::ZERO,
            axes,
        }
    }

    /// Homed and standing at zero, with an empty log.
    fn standing(axes: usize) -> Self {
        Self::new(axes).stand()
    }

    fn stand(mut self) -> Self {
        for drive in &mut self.world().axes {
            drive.state.homing = Homing::Attained;
        }
        self.order(Order::Enable);
        self.run(20);
        assert_eq!(self.phase(), Phase::Standing, "{:?}", self.servo.fault(0));
        self.reports();
        self.world().sent.clear();
        self
    }

    fn world(&self) -> MutexGuard<'_, World> {
        self.world.lock().unwrap()
    }

    fn order(&mut self, order: Order) {
        self.link.orders.push(order).unwrap();
    }

    fn run(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.servo.step(self.now);
            self.now += PERIOD;
        }
    }

    fn run_until(&mut self, phase: Phase) {
        for _ in 0..1000 {
            if self.phase() == phase {
                return;
            }
            self.run(1);
        }
        panic!("never {phase:?}, but {:?}", self.servo.state(0));
    }

    fn phase(&self) -> Phase {
        self.servo.state(0).unwrap().phase()
    }

    fn cause(&self) -> Option<StopCause> {
        self.servo.fault(0).map(|fault| fault.cause)
    }

    fn reports(&mut self) -> Vec<Report> {
        std::iter::from_fn(|| self.link.reports.pop().ok()).collect()
    }

    fn phases(&mut self) -> Vec<Phase> {
        self.reports().iter().map(|report| report.phase).collect()
    }

    /// Positions that axis `axis` was told to follow, cycle by cycle.
    fn positions(&self, axis: usize) -> Vec<f64> {
        let position = |batch: &Vec<AxisCommand>| match batch[axis] {
            AxisCommand::Follow(Setpoint::Position(position)) => Some(position.get()),
            _ => None,
        };
        self.world().sent.iter().filter_map(position).collect()
    }

    fn last_sent(&self) -> Vec<AxisCommand> {
        self.world().sent.last().unwrap().clone()
    }

    /// Queues constant acceleration over `ramp` macrosteps of 10 periods, then as many of constant
    /// speed as `cruise` says; ends in motion. Position and velocity at the end.
    fn accelerate(&mut self, acceleration: f64, ramp: u64, cruise: u64) -> (f64, f64) {
        let (mut position, mut velocity) = (0.0, 0.0);
        for number in 1..=ramp + cruise {
            let a = if number <= ramp { acceleration } else { 0.0 };
            position += velocity * 10.0 * DT + 0.5 * a * (10.0 * DT).powi(2);
            velocity += a * 10.0 * DT;
            self.order(Order::Move(macrostep(number, 10, position, velocity)));
        }
        (position, velocity)
    }
}

fn macrostep(number: u64, steps: u16, position: f64, velocity: f64) -> Macrostep {
    let (position, velocity) = ([position; MAX_AXES], [velocity; MAX_AXES]);
    Macrostep {
        number,
        steps,
        report_at: steps,
        position,
        velocity,
    }
}

/// First and second difference of a sequence never exceed the limits by more than a thousandth.
fn keeps_limits(positions: &[f64]) -> Result<(), TestCaseError> {
    for (at, three) in positions.windows(3).enumerate() {
        let velocity = (three[2] - three[1]) / DT;
        let acceleration = (three[2] - 2.0 * three[1] + three[0]) / (DT * DT);
        prop_assert!(
            velocity.abs() <= MAX_VELOCITY * 1.0011,
            "{velocity} rad/s at {at}"
        );
        prop_assert!(
            acceleration.abs() <= MAX_ACCELERATION * 1.0011,
            "{acceleration} at {at}"
        );
    }
    Ok(())
}

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
    let error = Err((1, scripted::NEVER_BOOTED));
    assert_eq!(servo.bring_up(Instant::ZERO), Poll::Ready(error));
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
    assert!(
        matches!(rig.cause(), Some(StopCause::NotReady { .. })),
        "{:?}",
        rig.cause()
    );
    assert_eq!(rig.servo.fault(0).unwrap().axis, 0);
    assert_eq!(rig.last_sent(), [AxisCommand::Off; 2]);
}

#[test]
fn a_drive_that_ignores_set_points_is_not_ready() {
    let mut rig = Rig::new(2);
    rig.world().axes[1].deaf = true;
    rig.order(Order::Enable);
    rig.run_until(Phase::Faulted);
    assert!(matches!(rig.cause(), Some(StopCause::NotReady { .. })));
    assert_eq!(rig.servo.fault(0).unwrap().axis, 1);
}

#[test]
fn axes_home_in_ascending_order_and_homed_ones_are_skipped() {
    let mut rig = Rig::new(3);
    rig.world().axes[1].state.homing = Homing::Attained;
    rig.world().axes[0].state.position = 7.0;
    rig.order(Order::Enable);
    rig.order(Order::Home);
    rig.run(60);
    assert_eq!(
        rig.phases(),
        [
            Phase::Enabling,
            Phase::Standing,
            Phase::Homing,
            Phase::Standing
        ]
    );
    let homing: Vec<usize> = rig
        .world()
        .sent
        .iter()
        .flat_map(|batch| {
            batch
                .iter()
                .position(|command| *command == AxisCommand::Home)
        })
        .collect();
    assert!(homing.is_sorted_by(|a, b| a >= b), "{homing:?}");
    assert!(homing.contains(&2) && homing.contains(&0) && !homing.contains(&1));
    // The counter jumped to zero; the command went with it.
    assert_eq!(*rig.positions(0).last().unwrap(), 0.0);
}

#[test]
fn homing_that_has_nothing_to_do_is_answered() {
    let mut rig = Rig::standing(2);
    rig.order(Order::Home);
    rig.run(2);
    let reports = rig.reports();
    assert_eq!(reports.len(), 1);
    assert!(reports[0].homed && reports[0].phase == Phase::Standing);
}

#[test]
fn homing_fails_by_the_drive_and_by_time_and_halts_first() {
    for (fails, takes) in [(true, 10), (false, 0)] {
        let mut rig = Rig::new(2);
        rig.world().axes[1].homing_fails = fails;
        rig.world().axes[1].homing_takes = takes;
        rig.order(Order::Enable);
        rig.order(Order::Home);
        rig.run_until(Phase::Stopping);
        assert_eq!(rig.last_sent(), [AxisCommand::Stand; 2]);
        rig.run_until(Phase::Faulted);
        assert_eq!(rig.cause(), Some(StopCause::HomingFailed));
        assert_eq!(rig.servo.fault(0).unwrap().axis, 1);
        assert_eq!(rig.last_sent(), [AxisCommand::Off; 2]);
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
    assert!(rig.reports().last().unwrap().homed);
}

#[test]
fn homing_can_be_stopped_and_begun_again() {
    let mut rig = Rig::new(2);
    rig.order(Order::Enable);
    rig.order(Order::Home);
    rig.run_until(Phase::Homing);
    rig.run(5);
    rig.order(Order::Stop);
    rig.run(1);
    rig.run(90);
    assert_eq!(rig.phase(), Phase::Stopping);
    assert_eq!(rig.last_sent(), [AxisCommand::Stand; 2]);
    rig.run_until(Phase::Standing);
    assert!(!rig.reports().last().unwrap().homed);
    rig.order(Order::Home);
    rig.run(1);
    rig.run_until(Phase::Standing);
    assert!(rig.reports().last().unwrap().homed);
}

#[test]
fn macrosteps_are_met_and_reported_and_end_in_standing() {
    let mut rig = Rig::standing(2);
    rig.order(Order::Move(Macrostep {
        report_at: 4,
        ..macrostep(1, 10, 0.01, 1.0)
    }));
    rig.order(Order::Move(macrostep(2, 10, 0.02, 0.0)));
    rig.run(25);
    let reports = rig.reports();
    let seen: Vec<_> = reports
        .iter()
        .map(|report| (report.phase, report.macrostep))
        .collect();
    let moving = Phase::Moving;
    assert_eq!(
        seen,
        [(moving, 1), (moving, 1), (moving, 2), (Phase::Standing, 2)]
    );
    let positions = rig.positions(0);
    assert_eq!(
        (positions[9], positions[19], positions[24]),
        (0.01, 0.02, 0.02)
    );
    assert_eq!(rig.servo.counters().macrosteps, 2);
    assert_eq!(
        rig.servo
            .tracking(0)
            .map(|error| error.peak())
            .collect::<Vec<_>>(),
        [0.0; 2]
    );
}

#[test]
fn a_queue_that_runs_dry_in_motion_brakes_and_faults() {
    let mut rig = Rig::standing(2);
    rig.accelerate(500.0, 3, 1);
    rig.run_until(Phase::Stopping);
    assert_eq!(rig.cause(), Some(StopCause::Starved { last: 4 }));
    rig.run_until(Phase::Faulted);
    let positions = rig.positions(0);
    keeps_limits(&positions).unwrap();
    // 15 rad/s at 1000 rad/s²: 15 periods, of which the last does not move.
    let end = positions.last().unwrap() - positions[39];
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
        (
            Macrostep {
                velocity: [f64::NAN; MAX_AXES],
                ..macrostep(1, 1, 0.0, 0.0)
            },
            "NotFinite",
        ),
        (with(|m| m.velocity[1] = f64::MAX), "PositionLimit"),
        (with(|m| m.position[1] = 0.1), "AccelerationLimit"),
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
        assert!(
            cause.starts_with(expected),
            "{cause} instead of {expected} for {bad:?}"
        );
        assert_eq!(rig.phase(), Phase::Faulted);
        for axis in 0..2 {
            assert!(
                rig.positions(axis).iter().all(|&position| position == 0.0),
                "{expected}"
            );
        }
    }
}

#[test]
fn a_bad_macrostep_in_motion_brakes_from_the_last_good_set_point() {
    let mut rig = Rig::standing(1);
    let (position, velocity) = rig.accelerate(500.0, 4, 0);
    rig.order(Order::Move(macrostep(5, 10, position + 0.3, velocity)));
    rig.run_until(Phase::Faulted);
    assert!(
        matches!(rig.cause(), Some(StopCause::AccelerationLimit { .. })),
        "{:?}",
        rig.cause()
    );
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
    assert!(matches!(
        rig.cause(),
        Some(StopCause::AccelerationLimit { .. })
    ));
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
    assert_eq!(rig.servo.fault(0).unwrap().axis, 1);
}

#[test]
fn stop_and_disable_overtake_the_queue_and_brake() {
    // After 31 cycles a macrostep has just been taken since the queue was last looked through.
    let cases = [
        (Order::Stop, 30, Phase::Standing),
        (Order::Disable, 30, Phase::Off),
        (Order::Stop, 31, Phase::Standing),
    ];
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
fn the_following_error_is_that_of_the_command_the_drive_had_latched() {
    // At 20 rad/s each period of wrong delay shows as 0.02 rad.
    let mut config = scripted::config(1);
    config.effectors[0].axes[0].following_error = 0.019;
    let mut rig = Rig::with(&config).stand();
    rig.accelerate(500.0, 4, 2);
    rig.run(55);
    assert_eq!((rig.phase(), rig.cause()), (Phase::Moving, None));
    let tracking = rig.servo.tracking(0).next().unwrap();
    assert!(
        tracking.samples() > 40 && tracking.peak() < 1e-12,
        "{tracking:?}"
    );

    let mut rig = Rig::with(&config).stand();
    rig.world().axes[0].lags = true;
    rig.accelerate(500.0, 4, 2);
    rig.run(55);
    let Some(StopCause::FollowingError {
        error,
        limit: 0.019,
    }) = rig.cause()
    else {
        panic!("{:?}", rig.cause())
    };
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
fn a_drive_that_stops_following_stops_the_effector() {
    let mut rig = Rig::standing(2);
    rig.accelerate(500.0, 4, 50);
    rig.run(50);
    rig.world().axes[1].deaf = true;
    rig.run_until(Phase::Faulted);
    assert!(matches!(
        rig.cause(),
        Some(StopCause::FollowingError { .. })
    ));
    assert_eq!(rig.servo.fault(0).unwrap().axis, 1);
}

#[test]
fn power_stays_on_until_the_motors_are_still_or_have_had_their_time() {
    for (velocity, cycles) in [(0.5, 1..=3), (50.0, 100..=104)] {
        let mut rig = Rig::standing(1);
        rig.accelerate(500.0, 2, 20);
        rig.run(30);
        rig.order(Order::Disable);
        // 10 rad/s at 1000 rad/s²: ten set-points, then the drive goes on by itself.
        rig.run(10);
        rig.world().axes[0].drifts_at = Some(velocity);
        let before = rig.now;
        rig.run_until(Phase::Off);
        let waited = rig.now.since(before).as_millis();
        assert!(
            cycles.contains(&waited),
            "{waited} periods at {velocity} rad/s"
        );
    }
}

#[test]
fn effectors_stop_each_for_itself_and_for_overruns_together() {
    let mut config = scripted::config(2);
    config
        .effectors
        .push(scripted::config(2).effectors.remove(0));
    for (group, axes) in [(1, 0), (0, 1)] {
        // Each effector has one axis on either group.
        config.effectors[0].axes[axes].group = group;
        config.effectors[1].axes[axes].group = 1 - group;
    }
    let (groups, worlds): (Vec<_>, Vec<_>) = (0..2).map(|_| scripted::group(2)).unzip();
    for world in &worlds {
        let mut world = world.lock().unwrap();
        world
            .axes
            .iter_mut()
            .for_each(|drive| drive.state.homing = Homing::Attained);
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
            link.orders
                .push(Order::Move(macrostep(number, 10, position, 0.0)))
                .unwrap();
        });
    }
    let phases = |servo: &Servo| [0, 1].map(|index| servo.state(index).unwrap().phase());
    run(&mut servo, 50);
    assert_eq!(phases(&servo), [Phase::Moving; 2]);
    // Axis 0 of the first effector is on the second group.
    worlds[1].lock().unwrap().axes[0].state.fault = Some(FAULT);
    run(&mut servo, 50);
    assert_eq!(phases(&servo), [Phase::Faulted, Phase::Moving]);
    assert_eq!(servo.fault(0).unwrap().axis, 0);
    servo.missed(3);
    run(&mut servo, 50);
    assert_eq!(phases(&servo), [Phase::Faulted; 2]);
    assert_eq!(servo.fault(0).unwrap().cause, StopCause::Drive(FAULT));
    assert_eq!(
        servo.fault(1).unwrap().cause,
        StopCause::Overrun { missed: 3 }
    );
}

#[test]
fn a_blocked_motor_stops_the_effector() {
    let mut rig = Rig::standing(2);
    rig.accelerate(500.0, 4, 50);
    rig.run(50);
    rig.world().axes[1].blocked = true;
    rig.run_until(Phase::Faulted);
    assert!(matches!(
        rig.cause(),
        Some(StopCause::FollowingError { .. })
    ));
    assert_eq!(rig.servo.fault(0).unwrap().axis, 1);
    keeps_limits(&rig.positions(0)).unwrap();
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
    assert!(
        [0, 2]
            .iter()
            .all(|&axis| matches!(sent[axis], AxisCommand::Follow(_)))
    );
    rig.run_until(Phase::Faulted);
    assert_eq!(rig.cause(), Some(StopCause::Drive(FAULT)));
    assert_eq!(rig.last_sent(), [AxisCommand::Off; 3]);
    keeps_limits(&rig.positions(0)).unwrap();
    assert_eq!(rig.positions(0), rig.positions(2));

    // Nothing but a reset leads out of it.
    rig.order(Order::Enable);
    rig.order(Order::Home);
    rig.run(5);
    assert_eq!(
        (rig.phase(), rig.last_sent()),
        (Phase::Faulted, vec![AxisCommand::Off; 3])
    );
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
    rig.servo.stop_request().request();
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
    assert_eq!(
        (rig.phase(), rig.last_sent()),
        (Phase::Off, vec![AxisCommand::Off; 2])
    );
    assert!(rig.servo.is_off());
    assert!(
        rig.world()
            .axes
            .iter()
            .all(|drive| drive.state.power == Power::Off)
    );
}

#[test]
fn missed_cycles_stop_the_effector_only_beyond_the_allowed_row() {
    // How many deadlines are missed before each of some cycles, and whether that is an overrun.
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
        assert_eq!(
            rig.phase() == Phase::Stopping,
            expected.is_some(),
            "{missed:?}"
        );
        assert_eq!(
            rig.servo.counters().missed_cycles,
            u64::from(missed.iter().sum::<u32>())
        );
        keeps_limits(&rig.positions(0)).unwrap();
    }
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
    assert_eq!(
        (last.axes, last.phase, last.axis[1].commanded),
        (2, Phase::Standing, 0.01)
    );
    assert_eq!(
        (last.axis[1].measured, last.axis[1].increments.0),
        (0.01, 10)
    );
}

#[test]
fn the_slowest_stop_is_known() {
    let rig = Rig::new(1);
    assert_eq!(rig.servo.longest_stop(), Duration::from_millis(400));
}

proptest! {
    /// Random streams, most of them nonsense, with stops in between. proptest prints the failing
    /// case and keeps its seed.
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
