//! Homing by the drive finds the same reference from every start position.

use std::f64::consts::TAU;

use hil::AxisConfig;
use hil::plant::Switch;
use kit::cell::Setup;

/// Upper edge of the home switch, rad below the home position.
const EDGE: f64 = 2.0;

/// Homes the first axis of the IRb-6 from `start`, with the index pulse at `index`, both in rad above the home
/// position. Returns the final position according to the driver and the true one, both in rad above the home position.
fn home(start: f64, index: f64) -> (f64, f64) {
    let mut setup = Setup::one_axis(0);
    let robot = &mut setup.cell.robot[0];
    let home = robot.arm().expect("parameters are sound").robot().home()[0];
    robot.axis[0].emulator.start = Some(home + start);
    let mut rig = setup
        .with_plant(move |_, plant| {
            plant.index_angle = home + index;
            plant.home_switch = Some(Switch { from: home - 20.0, to: home - EDGE, bounce: 5 });
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
fn the_first_index_pulse_above_the_switch_is_the_reference_at_every_angle_of_the_pulse() {
    let count = TAU / 4000.0;
    for index in [-EDGE + 0.05, -1.0, 0.5, 3.0, TAU - EDGE - 0.05] {
        for start in [-30.0, -10.0, 20.0] {
            let (reported, angle) = home(start, index);
            let error = (reported - (angle - index)) / count;
            assert!(error.abs() <= 1.0, "from {start}, index at {index}: off by {error:.2} counts");
        }
    }
}

/// An index pulse exactly at the edge of the switch may pass before the drive waits for it. The next pulse is then the
/// reference.
#[test]
fn an_index_at_the_edge_of_the_switch_leads_to_one_of_two_references() {
    let count = TAU / 4000.0;
    for offset in [-2.0, -1.0, 0.0, 1.0, 2.0, 5.0] {
        let index = -EDGE + offset * count;
        let (reported, angle) = home(10.0, index);
        let error = (reported - (angle - index)) / count;
        let least = error.abs().min((error + 4000.0).abs());
        assert!(least <= 1.0, "index {offset} counts above the edge: off by {error:.2} counts");
    }
}

/// Motor, load, sensors and switches of an axis. `None` keeps the plant of the IRb-6 on its pedestal.
type Preset = fn(usize) -> Option<AxisConfig>;

/// The robots of the laboratory with axes that are homed by a switch, the number of these axes, and their plants.
const ROBOTS: [(&str, usize, Preset); 5] = [
    ("irb6", 5, |_| None),
    ("irp6-track", 7, AxisConfig::irp6_track),
    ("rnt", 6, AxisConfig::rnt),
    ("polycrank", 7, AxisConfig::polycrank),
    ("gripper", 1, |_| Some(AxisConfig::gripper())),
];

/// A single axis of the laboratory with bouncing contacts, its plant and its home position, rad.
fn of_laboratory(robot: &str, axis: usize, preset: Preset) -> (Setup, AxisConfig, f64) {
    let setup = Setup::axis_of("lab", robot, axis);
    let arm = setup.cell.robot[0].arm().expect("parameters are sound");
    let home = arm.robot().home()[axis];
    let plant = preset(axis).map_or_else(|| setup.plant(&arm, axis), |it| it.with_home(home));
    let chattering = |switch: Option<Switch>| switch.map(|it| Switch { bounce: 20, ..it });
    let plant = AxisConfig {
        home_switch: chattering(plant.home_switch),
        negative_limit: chattering(plant.negative_limit),
        positive_limit: chattering(plant.positive_limit),
        ..plant
    };
    (setup, plant, home)
}

/// Motor positions at the start of a search, rad, one for each combination of sensor states.
fn starts(plant: &AxisConfig) -> Vec<(&'static str, f64)> {
    let switch = plant.home_switch.expect("it is homed against a switch");
    let mut starts = vec![
        ("above the switch", plant.index_angle + 20.0),
        ("at the index", plant.index_angle),
        ("just above the switch", switch.to + 0.02),
        ("at the edge of the switch", switch.to),
        ("just on the switch", switch.to - 0.02),
        ("well on the switch", switch.to - 15.0),
    ];
    // The Polycrank turns without limits. Its switch opens again only after ten downward turns of the joint.
    if let (Some(lower), Some(upper)) = (plant.negative_limit, plant.positive_limit) {
        starts.extend([("at the lower end", lower.to - 2.0), ("at the upper end", upper.from + 2.0)]);
        if switch.from.is_finite() {
            starts.push(("beyond the switch", switch.from - 3.0));
        }
    }
    starts
}

/// Angles of the index pulse within the motor's turn, rad, and whether the first pulse above the switch must be the
/// reference. A pulse that occurs before the search has detected the open switch is ignored, and the next pulse is the
/// reference.
fn indices(plant: &AxisConfig, zero_velocity: f64) -> [(&'static str, f64, bool); 5] {
    let edge = plant.home_switch.expect("it is homed against a switch").to;
    let count = TAU / f64::from(plant.counts_per_revolution);
    // The contact bounces for 2 ms. A host requires three open samples at intervals of 2 ms.
    let seen = edge + 2.0 * count + 20e-3 * zero_velocity;
    [
        ("index after the edge", seen, true),
        ("index before the edge", edge - 2.0 * count, true),
        ("index at the edge", edge, false),
        ("index a count above the edge", edge + count, false),
        ("index five counts above the edge", edge + 5.0 * count, false),
    ]
}

/// Error of the axis after homing, in counts, relative to the true position of `reference`, rad.
fn off(setup: Setup, plant: AxisConfig, reference: f64, home: f64) -> f64 {
    let counts = f64::from(plant.counts_per_revolution) / TAU;
    let mut rig = setup.with_plant(move |_, given| *given = plant).bring_up();
    rig.home();
    for _ in 0..500 {
        rig.cycle();
    }
    ((rig.last.axis[0].measured - home) - (rig.angle(0) - reference)) * counts
}

#[test]
fn every_axis_of_the_laboratory_finds_its_reference_past_chattering_switches_from_any_start_wherever_its_index_is() {
    for (robot, axes, preset) in ROBOTS {
        for axis in 0..axes {
            let (_, plant, _) = of_laboratory(robot, axis, preset);
            for (what, start) in starts(&plant) {
                let (setup, plant, home) = of_laboratory(robot, axis, preset);
                let plant = AxisConfig { start_angle: start, ..plant };
                let error = off(setup, plant, home, home);
                assert!(error.abs() <= 1.0, "{robot}, axis {axis}, {what}: off by {error:.2} counts");
            }
            let (setup, ..) = of_laboratory(robot, axis, preset);
            let zero_velocity = setup.cell.robot[0].axis[axis].homing.zero_velocity;
            for (what, index, unique) in indices(&plant, zero_velocity) {
                let (setup, plant, home) = of_laboratory(robot, axis, preset);
                let edge = plant.home_switch.expect("it is homed against a switch").to;
                let turns = ((edge - index) / TAU).ceil();
                let plant = AxisConfig { index_angle: index, ..plant };
                let counts = f64::from(plant.counts_per_revolution);
                let error = off(setup, plant, index + turns * TAU, home);
                let next = if unique { error } else { error + counts };
                assert!(error.abs().min(next.abs()) <= 1.0, "{robot}, axis {axis}, {what}: off by {error:.2} counts");
            }
        }
    }
}

#[test]
fn a_belt_takes_for_home_where_it_stands() {
    for start in [-1000.3, -2.0, 0.0, 0.02, 20.0, 3e5] {
        let (setup, plant, home) = of_laboratory("conveyor", 0, |_| Some(AxisConfig::conveyor()));
        let plant = AxisConfig { start_angle: start, index_angle: start + 1.0, ..plant };
        let error = off(setup, plant, start, home);
        assert!(error.abs() <= 1.0, "from {start}: off by {error:.2} counts");
    }
}
