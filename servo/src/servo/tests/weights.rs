//! Torques that hold the weight, from the macrosteps to the drives.

use super::host_loops::{change, laws};
use super::*;

const WEIGHT: f64 = 0.5;

/// Position of the motors.
const AT: f64 = 3.0;

/// Enabled and standing, with a weight on axis 0 that the servo does not know.
fn loaded(config: &ServoConfig, stiction: f64) -> Rig {
    under(config, stiction, WEIGHT)
}

fn under(config: &ServoConfig, stiction: f64, weight: f64) -> Rig {
    let mut config = config.clone();
    change(&mut config.effectors[0].axes[0], |host| {
        host.feed_forward.weight = Some(1.0);
        host.feed_forward.coulomb = stiction;
    });
    let mut rig = Rig::with(&config);
    for drive in &mut rig.world().axes {
        drive.state.homing = Homing::Attained;
        drive.state.position = AT;
    }
    rig.world().axes[0].load = -weight;
    rig.order(Order::Enable);
    rig.run(1500);
    assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
    rig.world().sent.clear();
    rig
}

/// Macrosteps without motion, each with the torque of the weight.
fn told(rig: &mut Rig, torque: f64, numbers: std::ops::RangeInclusive<u64>) {
    for number in numbers {
        let mut step = macrostep(number, 10, AT, 0.0);
        step.torque[0] = torque;
        rig.order(Order::Move(step));
    }
    rig.run(100);
    assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
}

#[test]
fn what_the_loop_has_come_to_hold_changes_hands_without_a_step() {
    for config in laws(1) {
        let mut rig = loaded(&config, 0.0);
        told(&mut rig, WEIGHT, 1..=3);
        let torques = rig.torques(0);
        assert!(torques.iter().all(|torque| (torque - WEIGHT).abs() < 0.01), "{torques:?}");
    }
}

#[test]
fn what_the_loop_does_not_hold_yet_comes_in_over_a_macrostep() {
    for config in laws(1) {
        let mut rig = loaded(&config, 0.0);
        rig.world().axes[0].load = 0.0;
        // In the opposite direction, nothing can be transferred.
        rig.run(1500);
        rig.world().sent.clear();
        told(&mut rig, -0.2, 1..=1);
        let torques = rig.torques(0);
        // The loop then acts against the feed-forward torque, because no weight acts.
        for (cycle, torque) in torques.iter().take(4).enumerate() {
            let expected = -0.02 * (cycle + 1) as f64;
            assert!((torque - expected).abs() < 0.02, "{torques:?}");
        }
    }
}

#[test]
fn dry_friction_that_an_axis_stuck_in_is_forgotten_as_it_begins_to_move() {
    for config in laws(1) {
        for sense in [1.0, -1.0] {
            let mut rig = under(&config, 0.3, sense * WEIGHT);
            // 0.2 N·m less than the loop holds: the difference is dry friction.
            let told_of = sense * (WEIGHT - 0.2);
            told(&mut rig, told_of, 1..=1);
            let first = rig.torques(0)[0];
            assert!((first - told_of).abs() < 0.01, "{first} N·m");
        }
    }
}

#[test]
fn a_stop_keeps_the_torque_and_the_next_power_begins_with_it() {
    // Off, with the brake on; then on again at the same position, there with a load that is forgotten, or after the arm was
    // moved by hand.
    let cases = [(0.0, false, WEIGHT), (0.0, true, WEIGHT), (10.0, false, 0.0)];
    for (config, (moved, forgotten, expected)) in laws(1).iter().flat_map(|law| cases.map(|case| (law, case))) {
        let mut rig = loaded(config, 0.0);
        told(&mut rig, WEIGHT, 1..=1);
        rig.order(Order::Stop);
        rig.run(50);
        let torques = rig.torques(0);
        assert!(torques.iter().all(|torque| (torque - WEIGHT).abs() < 0.01), "{torques:?}");
        rig.order(Order::Disable);
        rig.run_until(Phase::Off);
        rig.world().axes[0].load = 0.0;
        rig.world().axes[0].spin = 0.0;
        rig.world().axes[0].state.position = AT + moved;
        if forgotten {
            rig.world().axes[0].state.homing = Homing::NotHomed;
            rig.run(3);
            rig.world().axes[0].state.homing = Homing::Attained;
        }
        rig.run(5);
        rig.world().sent.clear();
        rig.order(Order::Enable);
        rig.world().axes[0].load = -WEIGHT;
        let begun = |batch: &Vec<AxisCommand>| match batch[0] {
            AxisCommand::Follow(Setpoint::Torque(torque)) => Some(torque.get()),
            _ => None,
        };
        rig.run(100);
        let first = rig.world().sent.iter().find_map(begun).unwrap();
        assert!((first - expected).abs() < 0.02, "{first} for {expected} N·m");
        rig.run_until(Phase::Standing);
    }
}

type Change = fn(&mut Rig);

/// Events after which the load of axis 0 may have changed, and whether the motor has power at the event.
const CHANGES: [(&str, bool, Change); 4] = [
    ("nothing", false, |_| {}),
    ("axis 1 is moved", false, |rig| rig.world().axes[1].state.position += 10.0),
    ("the reference of axis 1 is lost for a time", false, |rig| {
        rig.world().axes[1].state.homing = Homing::NotHomed;
        rig.run(3);
        rig.world().axes[1].state.homing = Homing::Attained;
    }),
    // An eighth of the range of positions is 125 rad.
    ("axis 0 ends far from its rest", true, |rig| rig.world().axes[0].state.position += 130.0),
];

#[test]
fn what_held_a_load_is_forgotten_where_the_load_may_be_another() {
    for config in laws(2) {
        for (what, powered, change) in CHANGES {
            let mut rig = loaded(&config, 0.0);
            if powered {
                change(&mut rig);
                rig.run_until(Phase::Faulted);
                rig.order(Order::ResetFault);
            } else {
                rig.order(Order::Disable);
            }
            rig.run_until(Phase::Off);
            if !powered {
                change(&mut rig);
            }
            rig.world().axes[0].load = 0.0;
            rig.world().axes[0].spin = 0.0;
            rig.run(5);
            rig.world().sent.clear();
            rig.order(Order::Enable);
            rig.run(100);
            let begun = |batch: &Vec<AxisCommand>| match batch[0] {
                AxisCommand::Follow(Setpoint::Torque(torque)) => Some(torque.get()),
                _ => None,
            };
            let first = rig.world().sent.iter().find_map(begun).unwrap();
            let expected = if what == "nothing" { WEIGHT } else { 0.0 };
            assert!((first - expected).abs() < 0.02, "{what}: {first} for {expected} N·m");
        }
    }
}
