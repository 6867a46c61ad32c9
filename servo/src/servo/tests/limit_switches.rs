//! Limit switches outside homing, with drives that block torque towards a closed switch.

use super::host_loops::laws;
use super::*;
use crate::ServoState;

/// Two axes at 50 rad/s in `sense`. A limit switch of axis 1 is 2 rad ahead.
fn cruising(config: &ServoConfig, sense: f64) -> Rig {
    let mut rig = Rig::with(config).stand();
    rig.accelerate(500.0 * sense, 10, 30);
    rig.run(150);
    assert_eq!(rig.phase(), Phase::Moving, "{:?}", rig.cause());
    {
        let drive = &mut rig.world().axes[1];
        drive.guards = true;
        let at = Some(drive.state.position + 2.0 * sense);
        if sense > 0.0 {
            drive.limit_above = at;
        } else {
            drive.limit_below = at;
        }
    }
    rig.world().sent.clear();
    rig
}

/// One macrostep of a second, from rest to rest, for axis 1.
fn go(rig: &mut Rig, to: f64) {
    let mut step = macrostep(100, 1000, 0.0, 0.0);
    let here = rig.world().axes.iter().map(|drive| drive.state.position).collect::<Vec<_>>();
    step.position[0] = here[0];
    step.position[1] = to;
    rig.order(Order::Move(step));
    rig.run(1100);
}

#[test]
fn a_limit_switch_brakes_the_effector_and_is_named_and_can_be_left() {
    for config in laws(2) {
        for upper in [true, false] {
            let sense = if upper { 1.0 } else { -1.0 };
            let mut rig = cruising(&config, sense);
            rig.run_until(Phase::Stopping);
            assert_eq!(rig.cause(), Some(StopCause::LimitSwitch { upper }));
            assert_eq!(rig.servo.fault(0).unwrap().axis, Some(1));
            // The other axis brakes under its loop, 50 rad/s at 1000 rad/s². The power is switched off only
            // afterwards.
            let mut cycles = 0;
            while rig.servo.state(0) != Some(ServoState::Faulted) {
                assert!(matches!(rig.last_sent()[0], AxisCommand::Follow(_)));
                rig.run(1);
                cycles += 1;
            }
            assert!((45..200).contains(&cycles), "{cycles} cycles");
            assert!(rig.world().axes[0].spin.abs() < 2.0, "not braked");
            assert_eq!(rig.last_sent(), [AxisCommand::Off; 2]);
            let name = if upper { "upper" } else { "lower" };
            let text = rig.servo.fault(0).unwrap().to_string();
            assert_eq!(text, format!("axis 1: ran onto the {name} limit switch"));

            // The axis rests on the switch and holds. Motion away from the switch is allowed, motion towards it is
            // not.
            rig.world().axes.iter_mut().for_each(|drive| drive.spin = 0.0);
            rig.order(Order::ResetFault);
            rig.order(Order::Enable);
            rig.run(500);
            assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
            let there = rig.world().axes[1].state.position;
            go(&mut rig, there - 0.1 * sense);
            assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
            let switches = rig.world().axes[1].state.switches;
            assert!(switches.upper_limit || switches.lower_limit, "left already");
            go(&mut rig, there + 1.0 * sense);
            assert_eq!(rig.cause(), Some(StopCause::LimitSwitch { upper }));
            rig.order(Order::ResetFault);
            rig.order(Order::Enable);
            rig.run(500);
            go(&mut rig, there - 10.0 * sense);
            assert_eq!(rig.phase(), Phase::Standing, "{:?}", rig.cause());
            let switches = rig.world().axes[1].state.switches;
            assert!(!switches.upper_limit && !switches.lower_limit);
        }
    }
}

#[test]
fn a_counter_that_falls_has_its_upper_switch_below() {
    let [mut config, _] = laws(2);
    config.effectors[0].axes[1].increments_per_radian = -1000.0;
    let mut rig = cruising(&config, -1.0);
    rig.world().axes[1].limit_below = None;
    let here = rig.world().axes[1].state.position;
    // The drive's upper switch lies beyond the whole motion.
    rig.world().axes[1].limit_above = Some(here - 100.0);
    rig.world().axes[1].guards = false;
    rig.run_until(Phase::Stopping);
    assert_eq!(rig.cause(), Some(StopCause::LimitSwitch { upper: true }));
}

#[test]
fn an_axis_that_its_switch_does_not_hold_is_named_with_it() {
    for config in laws(2) {
        let mut rig = Rig::with(&config).stand();
        {
            let drive = &mut rig.world().axes[1];
            drive.guards = true;
            drive.limit_above = Some(-10.0);
            // The weight pulls the axis off the switch, and the drive blocks the opposing torque.
            drive.load = -0.5;
        }
        rig.run_until(Phase::Faulted);
        assert_eq!(rig.cause(), Some(StopCause::LimitSwitch { upper: true }));
        assert_eq!(rig.servo.fault(0).unwrap().axis, Some(1));
    }
}

#[test]
fn an_axis_without_a_reference_is_not_judged_by_its_switches() {
    let mut rig = Rig::with(&laws(1)[0]).stand();
    {
        let drive = &mut rig.world().axes[0];
        drive.state.homing = Homing::NotHomed;
        drive.guards = true;
        drive.limit_above = Some(-10.0);
        drive.load = -0.5;
    }
    rig.run_until(Phase::Faulted);
    let cause = rig.cause();
    assert!(matches!(cause, Some(StopCause::FollowingError { .. })), "{cause:?}");
}

#[test]
fn what_a_generator_rounds_is_no_motion_towards_a_switch() {
    let mut rig = Rig::with(&laws(1)[0]).stand();
    rig.world().axes[0].limit_above = Some(-10.0);
    for (number, to, ends) in [(1, 1e-9, Phase::Standing), (2, 0.1, Phase::Faulted)] {
        rig.order(Order::Move(macrostep(number, 100, to, 0.0)));
        rig.run(300);
        assert_eq!(rig.phase(), ends, "to {to}: {:?}", rig.cause());
    }
}
