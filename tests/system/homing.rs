//! Homing by the drive finds the same reference wherever the axis starts.

use std::f64::consts::TAU;

use hil::plant::Switch;
use hil::{AxisConfig, Irp6TrackAxis};

use crate::cell::Setup;

/// Upper edge of the home switch, rad below the home position.
const EDGE: f64 = 2.0;

/// Homes the first axis of the IRb-6 from `start`, with the index of the motor's turn at `index`, both in
/// rad above the home position. Where it ends by the driver and in truth, in rad above the home position.
fn home(start: f64, index: f64) -> (f64, f64) {
    let mut setup = Setup::one_axis(0);
    let robot = &mut setup.cell.robot[0];
    let home = robot.arm().expect("parameters are sound").robot().home()[0];
    robot.axis[0].emulator.start = Some(home + start);
    let mut rig = setup
        .with_plant(move |_, plant| {
            plant.index_angle = home + index;
            plant.home_switch = Some(Switch {
                from: home - 20.0,
                to: home - EDGE,
                bounce: 5,
            });
        })
        .bring_up();
    rig.home();
    for _ in 0..100 {
        rig.cycle();
    }
    let reported = rig.last.axis[0].measured;
    (reported - home, rig.angle(0) - home)
}

#[test]
fn the_reference_is_found_from_any_start() {
    let count = TAU / 4000.0;
    // The limit switches of this axis close 454.1 rad below and 465.9 rad above its home position.
    let starts = [
        -453.0, -100.0, -21.0, -20.0, -19.9, -10.0, -2.01, -2.0, -1.99, -0.5, 0.0, 0.001, 3.0,
        20.0, 465.0,
    ];
    for start in starts {
        let (reported, angle) = home(start, 0.0);
        let error = (reported - angle) / count;
        assert!(error.abs() <= 1.0, "from {start}: off by {error:.2} counts");
    }
    // Wherever the index is: the first one above the switch is the reference.
    for index in [-EDGE + 0.05, -1.0, 0.5, 3.0, TAU - EDGE - 0.05] {
        for start in [-30.0, -10.0, 20.0] {
            let (reported, angle) = home(start, index);
            let error = (reported - (angle - index)) / count;
            assert!(
                error.abs() <= 1.0,
                "from {start}, index at {index}: off by {error:.2} counts"
            );
        }
    }
}

/// An index on the very edge may be passed before the drive looks for it; then it is the next one.
#[test]
fn an_index_at_the_edge_of_the_switch_leads_to_one_of_two_references() {
    let count = TAU / 4000.0;
    for offset in [-2.0, -1.0, 0.0, 1.0, 2.0, 5.0] {
        let index = -EDGE + offset * count;
        let (reported, angle) = home(10.0, index);
        let error = (reported - (angle - index)) / count;
        let least = error.abs().min((error + 4000.0).abs());
        assert!(
            least <= 1.0,
            "index {offset} counts above the edge: off by {error:.2} counts"
        );
    }
}

type Preset = fn(usize) -> AxisConfig;

/// The robots whose axes are all homed against a switch, each with its axes and their plants.
const ROBOTS: [(&str, usize, Preset); 3] = [
    ("irp6-track", 7, |axis| {
        AxisConfig::irp6_track(Irp6TrackAxis::ALL[axis])
    }),
    ("rnt", 6, |axis| {
        AxisConfig::rnt(axis).expect("it has six axes")
    }),
    ("polycrank", 7, |axis| {
        AxisConfig::polycrank(axis).expect("it has seven axes")
    }),
];

#[test]
fn every_axis_of_the_laboratory_finds_its_reference_past_a_chattering_switch_wherever_its_index_is()
{
    for (robot, axes, preset) in ROBOTS {
        for axis in 0..axes {
            for (start, index) in [
                (20.0, 0.0),
                (-19.0, 0.0),
                (-3.2, 0.0),
                (40.0, 2.0),
                (20.0, -1.5),
            ] {
                let mut setup = Setup::of(robot);
                setup.axes = vec![axis];
                let robot = &mut setup.cell.robot[0];
                let home = robot.arm().expect("parameters are sound").robot().home()[axis];
                let counts = f64::from(robot.axis[axis].counts_per_revolution()) / TAU;
                let mut rig = setup
                    .with_plant(move |axis, plant| {
                        let preset = preset(axis).with_home(home);
                        *plant = AxisConfig {
                            start_angle: home + start,
                            index_angle: home + index,
                            home_switch: preset.home_switch.map(|switch| Switch {
                                bounce: 20,
                                ..switch
                            }),
                            ..preset
                        };
                    })
                    .bring_up();
                rig.home();
                for _ in 0..500 {
                    rig.cycle();
                }
                let error = (rig.last.axis[0].measured - (rig.angle(0) - index)) * counts;
                assert!(
                    error.abs() <= 1.0,
                    "{}, axis {axis} from {start}, index at {index}: off by {error:.2} counts",
                    rig.cell.name
                );
            }
        }
    }
}
