//! Axes that oscillate about their set-points.

use super::host_loops::change;
use super::*;
use crate::{Law, StopCategory};

impl Rig {
    /// Runs for `cycles`, in which the measured position of axis 0 oscillates about the set-points.
    fn shaken(&mut self, cycles: u32, frequency: f64, amplitude: f64) {
        for cycle in 0..cycles {
            let angle = std::f64::consts::TAU * frequency * DT * f64::from(cycle);
            self.world().axes[0].ahead = amplitude * angle.sin();
            self.run(1);
        }
    }
}

#[test]
fn an_axis_that_oscillates_at_rest_or_in_motion_is_noted_and_goes_on() {
    for moving in [false, true] {
        let mut rig = Rig::standing(2);
        assert!(rig.servo.oscillations(0).all(|found| found.is_none()));
        if moving {
            rig.accelerate(500.0, 10, 50);
            rig.run(150);
        }
        rig.shaken(400, 20.0, 0.05);
        assert_eq!(rig.cause(), None);
        let found: Vec<_> = rig.servo.oscillations(0).collect();
        let (it, after) = found[0].unwrap();
        assert!((it.frequency - 20.0).abs() < 1.0 && (it.amplitude - 0.05).abs() < 0.01, "{it:?}");
        assert_eq!(it.at_rest, !moving);
        assert!(after > Duration::from_millis(200), "{after:?}");
        assert_eq!(found[1], None);
    }
}

#[test]
fn a_loop_closed_by_the_servo_loses_power_when_its_oscillation_grows() {
    let mut config = scripted::host_config(1);
    config.effectors[0].axes[0].following_error = 0.6;
    change(&mut config.effectors[0].axes[0], |host| {
        let Law::Cascade(law) = &mut host.law else { unreachable!("made by host_config") };
        (law.velocity_gain, law.position_gain) = (0.2 * law.velocity_gain, 6.0 * law.position_gain);
        law.integral_rate *= 12.0;
    });
    let mut rig = Rig::with(&config).stand();
    rig.world().axes[0].load = 0.02;
    rig.run_until(Phase::Faulted);
    let Some(StopCause::Oscillates(it)) = rig.cause() else { panic!("{:?}", rig.cause()) };
    assert!((0.3..0.6).contains(&it.amplitude), "{it:?}");
    assert_eq!(rig.servo.fault(0).unwrap().category, StopCategory::Zero);
    assert_eq!(rig.last_sent(), [AxisCommand::Off]);
    let text = rig.servo.fault(0).unwrap().to_string();
    assert!(text.contains("axis 0: unstable loop swings up: "), "{text}");
}

#[test]
fn a_sound_loop_that_moves_and_stands_never_oscillates() {
    for config in host_loops::laws(1) {
        let mut rig = Rig::with(&config).stand();
        rig.world().axes[0].load = 0.3;
        rig.run(1000);
        rig.accelerate(500.0, 10, 20);
        rig.run(300);
        rig.order(Order::Stop);
        rig.run(500);
        assert_eq!(rig.servo.oscillations(0).next().unwrap(), None);
    }
}
