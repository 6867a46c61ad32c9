//! Brakes that do not hold after a power-off.

use drive::EmergencyStop;

use super::*;
use crate::{CellState, StopCategory};

/// An effector that `order` switches off, and whose second motor falls by `fall`, rad, after `cycles` more.
fn fallen(order: Order, cycles: usize, fall: f64) -> Rig {
    let mut rig = Rig::standing(2);
    rig.order(order);
    rig.run_until(Phase::Off);
    rig.run(cycles);
    rig.world().axes[1].state.position += fall;
    rig.world().axes[1].state.increments.0 += (fall * 1000.0) as i32;
    rig
}

#[test]
fn a_brake_that_slips_after_an_orderly_power_off_gives_the_motors_their_power_again() {
    for fall in [0.6, -0.6] {
        let mut rig = fallen(Order::Disable, 20, fall);
        rig.run_until(Phase::Standing);
        let fault = rig.servo.fault(0).unwrap();
        assert!(matches!(fault.cause, StopCause::BrakeSlips { .. }), "{fault}");
        assert_eq!((fault.axis, fault.category), (Some(1), StopCategory::Two));
        let place = rig.world().axes[1].state.position;
        rig.run(10);
        assert_eq!(rig.world().axes[1].state.position, place, "the motor holds, and moves nothing back");
        // Motion waits for an acknowledgement.
        rig.order(Order::Move(macrostep(1, 10, 0.0, 0.0)));
        rig.run(5);
        assert_eq!(rig.phase(), Phase::Standing);
        rig.order(Order::Disable);
        rig.run_until(Phase::Off);
        assert_eq!(rig.cause(), None);
    }
}

#[test]
fn a_request_to_stop_leaves_the_power_on_while_a_brake_slips() {
    let mut rig = Rig::standing(2);
    rig.servo.stop_request().request();
    rig.run_until(Phase::Off);
    rig.run(5);
    rig.world().axes[1].state.position += 0.6;
    rig.run_until(Phase::Standing);
    rig.run(50);
    assert_eq!((rig.phase(), rig.servo.is_off()), (Phase::Standing, false));
    assert_eq!(rig.servo.cell_state(), CellState::Held);
}

#[test]
fn no_power_returns_after_a_small_motion_a_second_a_fault_or_an_emergency_stop() {
    let off = |mut rig: Rig, expected| {
        rig.run(200);
        assert_eq!(rig.phase(), expected, "{:?}", rig.cause());
        assert_eq!(rig.last_sent(), [AxisCommand::Off; 2]);
    };
    off(fallen(Order::Disable, 20, 0.4), Phase::Off);
    off(fallen(Order::Disable, 1001, 0.6), Phase::Off);
    let mut config = scripted::config(2);
    config.effectors[0].axes[1].brake_watch = false;
    let mut rig = Rig::with(&config).stand();
    rig.order(Order::Disable);
    rig.run_until(Phase::Off);
    rig.run(5);
    rig.world().axes[1].state.position += 0.6;
    off(rig, Phase::Off);
    for emergency in [false, true] {
        let mut rig = Rig::standing(2);
        if emergency {
            rig.order(Order::Disable);
            rig.run_until(Phase::Off);
            rig.world().emergency = Some(EmergencyStop { node: 40, input: 5, known: true });
        } else {
            rig.world().axes[0].state.fault = Some(FAULT);
        }
        rig.run_until(Phase::Faulted);
        rig.run(20);
        rig.world().axes[1].state.position += 0.6;
        off(rig, Phase::Faulted);
    }
}

#[test]
fn no_power_returns_after_a_reset() {
    let mut rig = Rig::standing(2);
    rig.world().axes[0].state.fault = Some(FAULT);
    rig.run_until(Phase::Faulted);
    rig.world().axes[0].state.fault = None;
    rig.order(Order::ResetFault);
    rig.run_until(Phase::Off);
    rig.world().axes[1].state.position += 0.6;
    rig.run(200);
    assert_eq!((rig.phase(), rig.cause()), (Phase::Off, None));
}
