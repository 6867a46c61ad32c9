//! Categories of stops, and motors that leave the envelope of a stop.

use drive::axis_controller::AxisControllerFault;
use drive::{EmergencyStop, Fault};

use super::*;
use crate::{After, CellState, FrozenWatch, ServoState, StopCategory};

/// An effector that moves at 10 rad/s, whose second motor then runs at `speed`, and `order` stops it.
fn stopping(order: Order, speed: Option<f64>) -> Rig {
    let mut rig = Rig::standing(2);
    rig.accelerate(500.0, 2, 20);
    rig.run(40);
    rig.order(order);
    rig.world().axes[1].runs_at = speed;
    rig
}

fn category(rig: &Rig) -> Option<StopCategory> {
    rig.servo.fault(0).map(|fault| fault.category)
}

#[test]
fn a_motor_that_runs_on_makes_a_stop_of_category_2_one_of_1_and_then_of_0() {
    let mut rig = stopping(Order::Stop, Some(200.0));
    let start = rig.world().axes[1].state.position;
    let following_error = scripted::config(2).effectors[0].axes[1].following_error;
    let mut seen = Vec::new();
    for _ in 0..50 {
        rig.run(1);
        let now = (rig.servo.state(0).unwrap(), category(&rig));
        if seen.last() != Some(&now) {
            seen.push(now);
        }
    }
    let expected = [
        (ServoState::Braking(After::Stand), None),
        (ServoState::Braking(After::Fault), Some(StopCategory::One)),
        (ServoState::Faulted, Some(StopCategory::Zero)),
    ];
    assert_eq!(seen, expected);
    assert!(matches!(rig.cause(), Some(StopCause::FollowingError { .. })));
    // The way of the stop, two following errors, and the way during the delay of two periods and the switching off.
    let way = rig.world().axes[1].state.position - start;
    assert!(way < 0.5 * 10.0 * 0.01 + 2.0 * following_error + 200.0 * 6.0 * DT, "{way} rad");
}

#[test]
fn a_motor_that_does_not_brake_loses_its_power_in_a_stop_of_category_1() {
    let mut rig = stopping(Order::Disable, Some(200.0));
    rig.run_until(Phase::Faulted);
    assert_eq!(category(&rig), Some(StopCategory::Zero));
    assert_eq!(rig.last_sent(), [AxisCommand::Off; 2]);
}

/// The first period of a stop of 60 periods from 60 rad/s in which the stop becomes stricter. The second motor goes on at 60
/// rad/s from the third period on, and gives no answer in the periods `silent`.
fn escalation(order: Order, silent: std::ops::Range<u32>) -> (Rig, u32) {
    let mut rig = Rig::standing(2);
    rig.accelerate(500.0, 12, 20);
    rig.run(125);
    rig.order(order);
    rig.run(3);
    assert_eq!(rig.phase(), Phase::Stopping);
    rig.world().axes[1].runs_at = Some(60.0);
    let before = rig.servo.state(0);
    let mut period = 3;
    while rig.servo.state(0) == before {
        period += 1;
        rig.world().axes[1].silent = silent.contains(&period);
        rig.run(1);
    }
    (rig, period)
}

/// At 60 rad/s and 1000 rad/s², the following error of 0.5 rad is reached after √(2 · 0.5 / 1000) s = 32 periods. The motor
/// can no longer come to rest within the envelope after 0.5 / 60 s = 8 periods.
#[test]
fn a_motor_that_does_not_brake_is_found_by_its_velocity_before_its_following_error() {
    let (rig, period) = escalation(Order::Disable, 0..0);
    assert_eq!((rig.phase(), category(&rig)), (Phase::Faulted, Some(StopCategory::Zero)));
    let (mut rig, same) = escalation(Order::Stop, 0..0);
    assert_eq!((rig.phase(), category(&rig)), (Phase::Stopping, Some(StopCategory::One)));
    // 8 periods, two further samples, and the delay from set-point to sample.
    assert_eq!((period, same), (12, 12));
    let Some(StopCause::NotBraking { velocity, limit }) = rig.cause() else {
        panic!("{:?}", rig.cause());
    };
    let measured = rig.link.latest.read().measured[1];
    rig.world().axes[1].runs_at = None;
    rig.run(70);
    let end = rig.link.latest.read().commanded[1];
    let error = scripted::config(2).effectors[0].axes[1].following_error;
    let expected = (2.0 * 1000.0 * (end + error - measured)).sqrt();
    assert!((velocity - 60.0).abs() < 1e-6 && (limit - expected).abs() < 1e-6, "{velocity} {limit} {expected}");
    // Missing answers are no samples.
    assert_eq!(escalation(Order::Stop, period - 1..period + 4).1, period + 5);
}

/// Cycles until the robot is off, and the way of the second motor until then, in a stop of category 1 from now on.
fn until_off(rig: &mut Rig) -> (u32, f64) {
    rig.order(Order::Disable);
    let start = rig.world().axes[1].state.position;
    let mut cycles = 0;
    while !matches!(rig.phase(), Phase::Faulted | Phase::Off) {
        rig.run(1);
        cycles += 1;
    }
    (cycles, rig.world().axes[1].state.position - start)
}

#[test]
fn a_motor_that_runs_backwards_in_a_stop_loses_its_power() {
    // The stop of the second motor from 10 rad/s, from rest, and from creeping by a rounding error.
    for (velocity, speed, expected) in
        [(10.0, 100.0, 4), (10.0, 20.0, 19), (0.0, 100.0, 4), (1e-12, 100.0, 4), (-1e-12, 100.0, 4)]
    {
        let mut config = scripted::config(2);
        // The scripted motor is at its speed at once.
        config.effectors[0].axes[1].frozen = FrozenWatch::Off;
        let mut rig = Rig::with(&config).stand();
        for mut step in accelerating(500.0, 2, 20) {
            let share = velocity / 10.0;
            (step.position[1], step.velocity[1]) = (share * step.position[1], share * step.velocity[1]);
            rig.order(Order::Move(step));
        }
        rig.run(40);
        rig.world().axes[1].runs_at = Some(-speed);
        let (cycles, way) = until_off(&mut rig);
        assert_eq!(category(&rig), Some(StopCategory::Zero), "{velocity} rad/s");
        assert_eq!(cycles, expected, "{velocity} rad/s");
        // The following error, three samples, and the delay of two periods and the switching off.
        assert!(way > -(0.5 + speed * 9.0 * DT), "{way} rad from {velocity} rad/s");
    }
}

#[test]
fn a_motor_may_move_backwards_by_its_following_error_in_a_stop() {
    let mut rig = Rig::standing(2);
    rig.accelerate(500.0, 12, 20);
    rig.run(125);
    rig.order(Order::Disable);
    rig.run(58);
    let start = rig.world().axes[1].state.position;
    // Towards 0.08 rad behind, from where 20 rad/s need 0.2 rad.
    for speed in [-20.0, 20.0] {
        rig.world().axes[1].runs_at = Some(speed);
        rig.run(4);
    }
    assert!((rig.world().axes[1].state.position - start).abs() < 0.1);
    rig.world().axes[1].runs_at = None;
    rig.run_until(Phase::Off);
    assert_eq!(category(&rig), None);
}

#[test]
fn a_closed_limit_switch_does_not_hide_a_motor_that_does_not_brake() {
    let cycles = [None, Some(0.3)].map(|switch| {
        let mut rig = Rig::standing(2);
        rig.accelerate(500.0, 12, 20);
        rig.run(125);
        rig.world().axes[1].runs_at = Some(60.0);
        let start = rig.world().axes[1].state.position;
        rig.world().axes[1].limit_above = switch.map(|ahead| start + ahead);
        let (cycles, _) = until_off(&mut rig);
        assert_eq!(category(&rig), Some(StopCategory::Zero));
        cycles
    });
    assert_eq!(cycles[0], cycles[1]);
}

#[test]
fn a_cell_is_off_or_held_only_as_long_as_its_drives_report_so() {
    for slips in [false, true] {
        let mut rig = Rig::standing(2);
        rig.servo.stop_request().request();
        rig.run_until(Phase::Off);
        rig.run(5);
        assert_eq!(rig.servo.cell_state(), CellState::Off);
        if slips {
            rig.world().axes[1].state.position += 0.6;
            rig.run_until(Phase::Standing);
            assert_eq!(rig.servo.cell_state(), CellState::Held);
            rig.world().emergency = Some(EmergencyStop { node: 40, input: 5, known: true });
        }
        rig.world().shows_power = true;
        rig.run(50);
        let end = if slips { Phase::Faulted } else { Phase::Off };
        assert_eq!((rig.phase(), rig.servo.cell_state()), (end, CellState::Stopping));
        rig.world().shows_power = false;
        rig.run(5);
        assert_eq!(rig.servo.cell_state(), CellState::Off);
    }
}

#[test]
fn a_motor_at_its_following_error_is_within_it() {
    for sign in [1.0, -1.0] {
        let mut config = scripted::config(1);
        // The scripted motor jumps.
        config.effectors[0].axes[0].frozen = FrozenWatch::Off;
        let mut rig = Rig::with(&config).stand();
        let limit = scripted::config(1).effectors[0].axes[0].following_error;
        rig.world().axes[0].ahead = sign * limit;
        rig.run(20);
        assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
        assert_eq!(rig.world().axes[0].state.homing, Homing::Attained);
        rig.world().axes[0].ahead = 1.001 * sign * limit;
        rig.run(20);
        assert!(matches!(rig.cause(), Some(StopCause::FollowingError { .. })));
        assert_eq!(rig.world().axes[0].state.homing, Homing::NotHomed, "the counter may be wrong");
    }
}

/// The encoder failed while the loop of the drive was at work, and counts again in a motor that ran away.
#[test]
fn a_counter_that_starts_at_once_has_no_reference() {
    let mut rig = Rig::standing(1);
    rig.run(20);
    let limit = scripted::config(1).effectors[0].axes[0].following_error;
    rig.world().axes[0].ahead = 0.01 * limit;
    rig.run(20);
    assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
    rig.world().axes[0].ahead = 0.9 * limit;
    rig.run(20);
    assert!(matches!(rig.cause(), Some(StopCause::Frozen { .. })), "{:?}", rig.cause());
    assert_eq!(rig.world().axes[0].state.homing, Homing::NotHomed);
    assert_eq!(rig.last_sent(), [AxisCommand::Off]);
}

/// The envelope of a motor that is already ahead begins there.
#[test]
fn a_motor_that_keeps_its_distance_ahead_in_a_stop_is_within_the_envelope() {
    let limit = scripted::config(2).effectors[0].axes[1].following_error;
    for sign in [1.0, -1.0] {
        for (later, expected, periods) in [(2.4, StopCategory::One, 8), (2.6, StopCategory::Zero, 2)] {
            let mut rig = Rig::standing(2);
            rig.accelerate(500.0 * sign, 2, 20);
            rig.run(40);
            rig.world().axes[1].ahead = 1.5 * limit * sign;
            rig.run_until(Phase::Stopping);
            assert!(matches!(rig.cause(), Some(StopCause::FollowingError { .. })), "{:?}", rig.cause());
            rig.run(3);
            assert_eq!((rig.phase(), category(&rig)), (Phase::Stopping, Some(StopCategory::One)));
            rig.world().axes[1].ahead = later * limit * sign;
            let mut cycles = 0;
            while rig.phase() == Phase::Stopping {
                rig.run(1);
                cycles += 1;
            }
            // The first sample decides about the position.
            assert_eq!(cycles, periods, "{later}");
            assert_eq!(category(&rig), Some(expected), "{later} following errors ahead, {sign}");
        }
    }
}

#[test]
fn motors_that_lag_or_stand_still_stay_within_the_envelope() {
    for (order, end) in [(Order::Stop, Phase::Standing), (Order::Disable, Phase::Off)] {
        let mut rig = stopping(order, None);
        rig.run_until(end);
        assert_eq!(category(&rig), None);
        keeps_limits(&rig.positions(0)).unwrap();
        // A blocked motor does not reach its set-points, and stands at once.
        let mut rig = stopping(order, Some(0.0));
        rig.run_until(Phase::Faulted);
        assert!(matches!(rig.cause(), Some(StopCause::Frozen { .. })), "{:?}", rig.cause());
        assert_eq!(category(&rig), Some(StopCategory::One));
        keeps_limits(&rig.positions(0)).unwrap();
    }
    // Blocked in motion until this stops it: the other motor brakes on, although the error remains.
    let mut rig = stopping(Order::Enable, Some(0.0));
    rig.run_until(Phase::Stopping);
    assert!(matches!(rig.cause(), Some(StopCause::Frozen { .. })), "{:?}", rig.cause());
    assert_eq!(rig.last_sent()[1], AxisCommand::Off);
    let references: Vec<_> = rig.world().axes.iter().map(|drive| drive.state.homing).collect();
    assert_eq!(references, [Homing::Attained, Homing::NotHomed], "the counter may have lost counts");
    rig.run_until(Phase::Faulted);
    assert_eq!(category(&rig), Some(StopCategory::One));
    keeps_limits(&rig.positions(0)).unwrap();
    // A reset gives the axis its power again.
    rig.world().axes[1].runs_at = None;
    rig.order(Order::ResetFault);
    rig.run_until(Phase::Off);
    rig.order(Order::Enable);
    rig.run_until(Phase::Standing);
    assert!(matches!(rig.last_sent()[1], AxisCommand::Follow(_)));
}

#[test]
fn each_state_after_a_stop_has_its_category() {
    let table = [(After::Stand, 2), (After::Off, 1), (After::Fault, 1)];
    for (after, number) in table {
        assert_eq!(u8::from(after.category()), number, "{after:?}");
    }
    assert!(StopCategory::Zero > StopCategory::One && StopCategory::One > StopCategory::Two);
    let of_controller = |fault| StopCause::Drive(Fault::AxisController { line: 0, fault });
    let causes = [
        (StopCause::Partner { effector: 1 }, StopCategory::Two),
        (StopCause::Touched, StopCategory::Two),
        (StopCause::Runaway { velocity: 1.0, limit: 0.5 }, StopCategory::Zero),
        (StopCause::Overrun { missed: 4 }, StopCategory::One),
        (StopCause::Drive(FAULT), StopCategory::One),
        (of_controller(AxisControllerFault::Frozen { cycles: 7 }), StopCategory::Zero),
        (of_controller(AxisControllerFault::Cabinet { line: 1 }), StopCategory::Zero),
        (of_controller(AxisControllerFault::Overcurrent), StopCategory::One),
    ];
    for (cause, expected) in causes {
        assert_eq!(cause.category(), expected, "{cause}");
        assert_eq!(cause.needs_acknowledgement(), expected == StopCategory::Two);
    }
}

#[test]
fn an_emergency_stop_brakes_and_holds_the_effector_off_until_it_is_released_and_reset() {
    let emergency = EmergencyStop { node: 40, input: 5, known: true };
    let mut rig = Rig::standing(2);
    rig.accelerate(500.0, 2, 20);
    rig.run(40);
    rig.world().emergency = Some(emergency);
    rig.run(1);
    assert_eq!(rig.phase(), Phase::Stopping);
    rig.run_until(Phase::Faulted);
    keeps_limits(&rig.positions(0)).unwrap();
    let fault = rig.servo.fault(0).unwrap();
    assert_eq!(rig.servo.cell_state(), CellState::Locked);
    assert_eq!((fault.axis, fault.cause), (None, StopCause::EmergencyStop { group: 0, contact: emergency }));
    assert_eq!(fault.category, StopCategory::One);
    assert_eq!(fault.to_string(), "emergency stop by input 5 of node 40: the contact is open");
    // A reset fails while the contact is open, and no power returns before a reset.
    rig.reports();
    rig.order(Order::ResetFault);
    rig.run(2);
    assert_eq!(rig.servo.state(0), Some(ServoState::Faulted));
    assert_eq!(rig.reports().iter().map(|report| report.resetting).collect::<Vec<_>>(), [true, false]);
    assert_eq!(rig.servo.fault(0), Some(fault));
    rig.world().emergency = None;
    rig.order(Order::Enable);
    rig.run(10);
    assert_eq!((rig.phase(), rig.last_sent()), (Phase::Faulted, vec![AxisCommand::Off; 2]));
    rig.order(Order::ResetFault);
    rig.run_until(Phase::Off);
    assert_eq!(rig.cause(), None);
    rig.order(Order::Enable);
    rig.run_until(Phase::Standing);
    // At rest the power goes at once.
    rig.world().emergency = Some(EmergencyStop { known: false, ..emergency });
    rig.run(1);
    assert_eq!((rig.phase(), rig.last_sent()), (Phase::Faulted, vec![AxisCommand::Off; 2]));
}
