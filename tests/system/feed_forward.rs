//! Effect of feed-forward of the robot's weight and of its motors' break-away friction.

use ::mrroc::cell::{Cell, EmulatedPayload, Weights};
use controller::robot::Mass;
use kit::mrroc::{Directory, mrroc};
use serde_json::Value;

/// Payload at the flange, known to the controller and to the emulator.
const LOAD: (f64, [f64; 3]) = (4.0, [0.0, 0.0, 0.1]);

/// Makes all parameters known to the controller: masses, payload, and dry friction with break-away.
fn know(cell: &mut Cell) {
    let robot = &mut cell.robot[0];
    robot.weight = Some(Weights { load: Mass { mass: LOAD.0, centre: LOAD.1 }, ..Weights::default() });
    for axis in &mut robot.axis {
        let controller = axis.controller.as_mut().unwrap();
        let feed = &mut controller.r#loop.feed_forward;
        // As in the emulated motors: break-away friction is 1.5 times the dry friction, and decays within a few rad/s.
        feed.stiction = Some(1.5 * feed.coulomb);
        feed.stribeck_velocity = Some(5.0);
        // The last axis is commanded by pulse width: 1.2 ohm, 0.105 N·m/A, 48 V.
        let by_pulse_width = controller.control == ::mrroc::cell::Control::Pwm;
        feed.weight = by_pulse_width.then_some(1.2 / (0.105 * 48.0));
    }
}

/// Root mean square of the following error of each axis, rad, in the program of the example with a payload.
fn errors(change: impl FnOnce(&mut Cell)) -> Vec<f64> {
    let directory = Directory::new();
    let cell = directory.cell("irb6-serial", |cell| {
        let (mass, centre) = LOAD;
        cell.robot[0].emulated_payload = vec![EmulatedPayload { at_s: 0.0, mass, centre }];
        change(cell);
    });
    let run = mrroc(["run".as_ref(), cell.as_os_str(), "--bench=lockstep".as_ref(), "--json".as_ref()]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let report: Value = run.json();
    let axes = report["axes"].as_array().unwrap();
    let error = |axis: &Value| axis["tracking_rms_rad"].as_f64().unwrap();
    axes.iter().map(error).collect()
}

#[test]
fn a_loaded_arm_whose_weight_is_known_follows_several_times_as_well() {
    let unknown = errors(|_| {});
    let weighed = errors(|cell| {
        know(cell);
        for axis in &mut cell.robot[0].axis {
            let controller = axis.controller.as_mut().unwrap();
            let feed = &mut controller.r#loop.feed_forward;
            (feed.stiction, feed.stribeck_velocity) = (None, None);
        }
    });
    let known = errors(know);
    println!("following errors, rms, mrad at the motors: column, lower arm, upper arm, pitch, roll");
    for (name, errors) in [("nothing known", &unknown), ("weight", &weighed), ("weight and break-away", &known)] {
        let errors: Vec<_> = errors.iter().map(|error| error * 1e3).collect();
        println!("{name}: {errors:.1?}");
    }
    for (axis, name) in [(1, "lower arm"), (2, "upper arm"), (3, "pitch")] {
        assert!(weighed[axis] < 0.7 * unknown[axis], "{name} weighed");
        assert!(known[axis] < unknown[axis] / 3.0, "{name} known");
    }
    for axis in [0, 4] {
        assert!(known[axis] < unknown[axis], "axis {axis}");
    }
}
