//! Position loops that the servo closes, over motors driven by torque.

use super::*;
use crate::regulator::IncrementalConfig;
use crate::{HostLoop, Law, PositionLoop, ServoState};

/// Both laws for the scripted motor. The incremental one is a lead filter with an integrator at 1 ms.
pub(super) fn laws(axes: usize) -> [ServoConfig; 2] {
    let cascade = scripted::host_config(axes);
    let mut incremental = scripted::host_config(axes);
    for axis in &mut incremental.effectors[0].axes {
        change(axis, |host| {
            host.law = Law::Incremental(IncrementalConfig {
                a: 0.4,
                b0: 0.060,
                b1: 0.0582,
                eps: 0.004,
                integral: true,
                gain: 1.0,
                limit: 2.0,
            });
        });
    }
    [cascade, incremental]
}

pub(super) fn change(axis: &mut crate::ServoAxisConfig, how: impl FnOnce(&mut HostLoop)) {
    let PositionLoop::Host(host) = &mut axis.position_loop else { unreachable!("made by host_config") };
    how(host);
}

impl Rig {
    /// Torques sent to axis `axis`, cycle by cycle.
    pub(super) fn torques(&self, axis: usize) -> Vec<f64> {
        let torque = |batch: &Vec<AxisCommand>| match batch[axis] {
            AxisCommand::Follow(Setpoint::Torque(torque)) => torque.get(),
            AxisCommand::Off | AxisCommand::Stand => 0.0,
            other => panic!("{other:?}"),
        };
        self.world().sent.iter().map(torque).collect()
    }

    /// Moving at a constant speed of 50 rad/s, with more macrosteps in the queue.
    fn cruising(config: &ServoConfig) -> Self {
        let mut rig = Self::with(config).stand();
        rig.accelerate(500.0, 10, 50);
        rig.run(150);
        assert_eq!(rig.phase(), Phase::Moving, "{:?}", rig.servo.fault(0));
        rig
    }
}

#[test]
fn an_axis_is_held_against_its_weight_from_its_first_power_to_its_last() {
    for config in laws(2) {
        let mut rig = Rig::with(&config);
        for drive in &mut rig.world().axes {
            drive.state.homing = Homing::Attained;
            drive.state.position = 3.0;
            drive.load = -0.5;
        }
        // One drive takes longer, while the other axis is held.
        rig.world().axes[1].dead = true;
        rig.order(Order::Enable);
        rig.run(50);
        rig.world().axes[1].dead = false;
        rig.run(600);
        assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
        for axis in 0..2 {
            let world = rig.world();
            let first = world.sent.iter().position(|batch| matches!(batch[axis], AxisCommand::Follow(_))).unwrap();
            assert!(
                world.sent[first..].iter().all(|batch| matches!(batch[axis], AxisCommand::Follow(_))),
                "axis {axis} was let go"
            );
            let held = world.axes[axis].state.position;
            assert!((held - 3.0).abs() < 0.05, "axis {axis} sank to {held}");
            let spin = world.axes[axis].spin;
            assert!(spin.abs() < 0.03, "{spin} rad/s");
            drop(world);
            let torque = *rig.torques(axis).last().unwrap();
            assert!((torque - 0.5).abs() < 0.01, "{torque}");
        }
    }
}

#[test]
fn both_laws_follow_macrosteps() {
    for config in laws(2) {
        let mut rig = Rig::cruising(&config);
        rig.run(300);
        let tracking = rig.servo.tracking(0).next().unwrap();
        assert!(tracking.peak < 0.3, "{tracking:?}");
        rig.order(Order::Disable);
        rig.run_until(Phase::Off);
        assert_eq!(rig.cause(), None);
        assert_eq!(rig.last_sent(), [AxisCommand::Off; 2]);
    }
}

#[test]
fn missing_answers_cost_no_kick_and_no_fault() {
    for config in laws(2) {
        let mut rig = Rig::cruising(&config);
        let steady = *rig.torques(0).last().unwrap();
        for missing in 1..=3 {
            rig.world().sent.clear();
            rig.world().axes[0].silent = true;
            rig.run(missing);
            rig.world().axes[0].silent = false;
            rig.run(20);
            let torques = rig.torques(0);
            let away = |torque: &f64| (torque - steady).abs();
            let worst = torques.iter().map(away).fold(0.0, f64::max);
            assert!(worst < 0.05, "{missing} missing: {worst} N·m of {torques:?}");
        }
        assert_eq!(rig.phase(), Phase::Moving, "{:?}", rig.cause());
    }
}

#[test]
fn a_motor_that_never_answers_again_gets_bounded_torque() {
    for config in laws(2) {
        let mut rig = Rig::cruising(&config);
        rig.world().axes[0].silent = true;
        rig.world().sent.clear();
        rig.run(200);
        let torques = rig.torques(0);
        assert!(torques.iter().all(|torque| torque.abs() < 0.3), "{torques:?}");
    }
}

#[test]
fn a_loop_of_the_wrong_sign_loses_power_at_once() {
    for mut config in laws(2) {
        config.effectors[0].axes[1].following_error = 500.0;
        let mut rig = Rig::with(&config).stand();
        rig.world().axes[1].backwards = true;
        rig.world().axes[1].load = 0.01;
        for _ in 0..2000 {
            rig.run(1);
            if rig.phase() != Phase::Standing {
                break;
            }
        }
        assert_eq!(rig.servo.state(0), Some(ServoState::Faulted), "no braking");
        let Some(StopCause::Runaway { velocity, limit }) = rig.cause() else {
            panic!("{:?}", rig.cause());
        };
        assert!(velocity.abs() > limit && limit == 120.0);
        assert!(velocity.abs() < 140.0, "seen late: {velocity} rad/s");
        assert_eq!(rig.servo.fault(0).unwrap().axis, Some(1));
        assert_eq!(rig.last_sent(), [AxisCommand::Off; 2]);
        let text = rig.servo.fault(0).unwrap().to_string();
        assert!(text.contains("axis 1: motor runs away at"), "{text}");
    }
}

#[test]
fn lost_feedback_takes_power_at_once_and_a_nan_does_too() {
    for config in laws(2) {
        for nan in [false, true] {
            let mut rig = Rig::cruising(&config);
            let here = rig.world().axes[0].state.position;
            rig.world().axes[0].frozen = Some(if nan { f64::NAN } else { here });
            for _ in 0..100 {
                rig.run(1);
                if rig.phase() != Phase::Moving {
                    break;
                }
            }
            assert_eq!(rig.servo.state(0), Some(ServoState::Faulted));
            assert_eq!(rig.last_sent(), [AxisCommand::Off; 2]);
            assert!(rig.torques(0).iter().all(|torque| torque.is_finite()));
        }
    }
}

#[test]
fn a_macrostep_cut_off_by_a_lost_loop_is_not_continued_after_the_reset() {
    for config in laws(1) {
        let mut rig = Rig::cruising(&config);
        rig.run(5);
        rig.world().axes[0].frozen = Some(f64::NAN);
        rig.run_until(Phase::Faulted);
        rig.world().axes[0].frozen = None;
        rig.order(Order::ResetFault);
        rig.run_until(Phase::Off);
        // The motor has come to rest without power, and has its reference again.
        rig.world().axes[0].spin = 0.0;
        rig.world().axes[0].state.homing = Homing::Attained;
        rig.order(Order::Enable);
        rig.run_until(Phase::Standing);
        rig.run(200);
        rig.reports();
        let here = rig.world().axes[0].state.position;
        rig.order(Order::Move(macrostep(900, 10, here, 0.0)));
        rig.run(30);
        assert_eq!((rig.cause(), rig.phase()), (None, Phase::Standing));
        assert_eq!(rig.reports().last().map(|report| report.snapshot.macrostep), Some(900));
    }
}

#[test]
fn a_missed_deadline_is_no_runaway() {
    let mut config = scripted::host_config(1);
    change(&mut config.effectors[0].axes[0], |host| {
        host.runaway_velocity = 101.0;
    });
    let mut rig = Rig::cruising(&config);
    // The motor continued for a period without a cycle.
    rig.servo.missed(1);
    rig.world().axes[0].state.position += 50.0 * DT;
    rig.run(50);
    assert_eq!(rig.phase(), Phase::Moving, "{:?}", rig.cause());
}

#[test]
fn one_sample_taken_late_is_no_runaway() {
    let mut config = scripted::host_config(1);
    config.effectors[0].axes[0].max_velocity = 55.0;
    change(&mut config.effectors[0].axes[0], |host| {
        host.runaway_velocity = 60.0;
    });
    let mut rig = Rig::cruising(&config);
    // A cycle half a period late, followed by a punctual one: 75 rad/s, then 25.
    let late = 50.0 * 0.5 * DT;
    rig.world().axes[0].state.position += late;
    rig.run(1);
    rig.world().axes[0].state.position -= late;
    rig.run(50);
    assert_eq!(rig.phase(), Phase::Moving, "{:?}", rig.cause());
}

#[test]
fn a_stop_after_an_overrun_begins_from_the_motion_measured() {
    for config in laws(2) {
        let mut rig = Rig::cruising(&config);
        rig.servo.missed(4);
        rig.world().axes[0].state.position += 50.0 * 4.0 * DT;
        rig.world().axes[1].state.position += 50.0 * 4.0 * DT;
        rig.world().sent.clear();
        rig.run_until(Phase::Faulted);
        assert_eq!(rig.cause(), Some(StopCause::Overrun { missed: 4 }));
        // 50 rad/s at 1000 rad/s² take some 50 ms, without a step of the torque.
        let torques = rig.torques(0);
        assert!((45..200).contains(&torques.len()), "{} cycles", torques.len());
        assert!(torques.iter().all(|torque| torque.abs() < 1.2), "{torques:?}");
    }
}

/// After missed deadlines, the commands continue from the measured position. The following error changes in one step,
/// without a motion of the set-points. The loop of a motor that an obstacle holds keeps its power and brakes.
#[test]
fn a_motor_that_an_obstacle_holds_keeps_its_power_after_missed_deadlines() {
    for config in laws(2) {
        let mut rig = Rig::with(&config).stand();
        rig.world().axes[1].blocked = true;
        for _ in 0..150 {
            rig.world().axes[1].ahead -= 0.002;
            rig.run(1);
        }
        rig.run(20);
        for mut step in accelerating(500.0, 10, 50) {
            (step.position[1], step.velocity[1]) = (0.0, 0.0);
            rig.order(Order::Move(step));
        }
        rig.run(150);
        assert_eq!((rig.phase(), rig.cause()), (Phase::Moving, None));
        rig.world().sent.clear();
        rig.servo.missed(4);
        rig.world().axes[0].state.position += 50.0 * 4.0 * DT;
        rig.run_until(Phase::Faulted);
        assert_eq!(rig.cause(), Some(StopCause::Overrun { missed: 4 }));
        let powered = |axis: usize| rig.world().sent.iter().filter(|sent| sent[axis] != AxisCommand::Off).count();
        assert!(powered(0) >= 45 && powered(1) == powered(0), "{} and {} cycles", powered(0), powered(1));
    }
}

#[test]
fn a_bus_that_refuses_its_batch_does_not_stop_the_loops_of_another() {
    let mut config = scripted::host_config(2);
    config.effectors[0].axes[0].position_loop = PositionLoop::Drive;
    let mut buses = TwoBuses::standing(config);
    buses.world(1).axes[0].load = -0.5;
    buses.world(0).refuses = 50;
    buses.run(50);
    assert_eq!(buses.servo.fault(0), None);
    let drive = buses.world(1).axes[0].clone();
    assert!(drive.spin.abs() < 2.0, "falls at {} rad/s", drive.spin);
    assert!(drive.state.position > -0.1, "{}", drive.state.position);
}

#[test]
fn an_axis_with_a_drive_fault_is_left_to_its_group_while_the_others_brake() {
    let mut rig = Rig::cruising(&scripted::host_config(2));
    rig.world().axes[0].state.fault = Some(FAULT);
    rig.run_until(Phase::Stopping);
    let sent = rig.last_sent();
    assert_eq!(sent[0], AxisCommand::Stand);
    assert!(matches!(sent[1], AxisCommand::Follow(Setpoint::Torque(_))));
    rig.run_until(Phase::Faulted);
    assert_eq!(rig.cause(), Some(StopCause::Drive(FAULT)));
    assert!(rig.world().axes[1].spin.abs() < 2.0, "braked");
}
