//! Descriptions of models and of robots of cells.

use std::collections::BTreeSet;
use std::path::PathBuf;

use mrroc::cell::Model;

use super::*;

/// The models with links.
const ARMS: [Model; 7] = [
    Model::Irb6,
    Model::Irp6,
    Model::Irp6Calibrated,
    Model::Irp6Track,
    Model::Irp6TrackCalibrated,
    Model::Rnt,
    Model::Polycrank,
];

fn of_cell(robot: &str, cell: Option<&str>) -> String {
    let cell = cell.map(|name| PathBuf::from(format!("{}/../../cells/{name}.toml", env!("CARGO_MANIFEST_DIR"))));
    urdf(&Which { robot: robot.into(), cell }).unwrap()
}

/// The values of this attribute, in order.
fn values(text: &str, attribute: &str) -> Vec<f64> {
    let begin = format!(" {attribute}=\"");
    let parts = text.split(&begin).skip(1);
    parts.map(|part| part.split('"').next().unwrap().parse().unwrap()).collect()
}

/// The names of links and joints.
fn names(text: &str) -> BTreeSet<&str> {
    let parts = text.split("  <link name=\"").skip(1).chain(text.split("  <joint name=\"").skip(1));
    parts.map(|part| part.split('"').next().unwrap()).collect()
}

#[track_caller]
fn near(found: f64, expected: f64) {
    assert!((found - expected).abs() < 1e-5 * expected.abs(), "{found} for {expected}");
}

#[test]
fn every_moving_joint_has_a_velocity_and_an_effort() {
    for model in ARMS {
        let text = of_cell(model.name(), None);
        for attribute in ["effort", "velocity"] {
            let values = values(&text, attribute);
            assert_eq!(values.len(), model.parameters().axes(), "{model:?}: {attribute}\n{text}");
            assert!(values.iter().all(|value| *value > 0.0), "{model:?}: {attribute} {values:?}");
        }
    }
}

#[test]
fn velocities_and_efforts_follow_from_the_motors_of_the_model_or_of_the_cell() {
    // The column has a gear of 158, a motor of 250 rad/s with 20 A at 0.105 N·m/A, and a drive of 0.42 N·m.
    for (cell, motor) in [(None, 2.1), (Some("irb6"), 0.42)] {
        let text = of_cell("irb6", cell);
        near(values(&text, "velocity")[0], 250.0 / 158.0);
        near(values(&text, "effort")[0], 158.0 * motor);
        // The roll motor before the pitch joint turns the pitch as well, in the robot one to one.
        near(values(&text, "velocity")[4], 250.0 / 76.8);
    }
    // An axis controller has a limit of current.
    near(values(&of_cell("irb6", Some("lab")), "effort")[0], 158.0 * 25.0 * 0.105);
}

#[test]
fn links_have_the_nominal_masses_of_the_model_an_inertia_and_a_collision_shape() {
    for model in ARMS {
        let text = of_cell(model.name(), None);
        let masses = text.split("<mass value=\"").skip(1);
        let masses: Vec<f64> = masses.map(|part| part.split('"').next().unwrap().parse().unwrap()).collect();
        let expected: Vec<_> = model.parameters().masses().iter().map(|mass| mass.mass.max(LEAST)).collect();
        assert_eq!(masses, expected, "{model:?}");
        assert!(text.contains("Masses are nominal"), "{model:?}");
        let [x, y, z] = ["ixx", "iyy", "izz"].map(|attribute| values(&text, attribute));
        assert_eq!(x.len(), masses.len(), "{model:?}");
        for ((x, y), z) in x.into_iter().zip(y).zip(z) {
            assert!(x > 0.0 && y > 0.0 && z > 0.0, "{model:?}: {x} {y} {z}");
            assert!(x + y >= z && y + z >= x && z + x >= y, "{model:?}: no body has {x} {y} {z}");
        }
        let count = |tag: &str| text.matches(tag).count();
        assert_eq!(count("<collision>"), count("<visual>"), "{model:?}");
    }
}

#[test]
fn two_robots_of_a_cell_have_no_link_and_no_joint_of_one_name() {
    for (cell, robots) in [("two-irb6-bar", ["left", "right"]), ("lab", ["irb6", "polycrank"])] {
        let [one, other] = robots.map(|robot| of_cell(robot, Some(cell)));
        let of_scene = |name: &str| ["world", "plane_", "bar_"].iter().any(|scene| name.starts_with(scene));
        let [names_of_one, names_of_other] = [names(&one), names(&other)];
        let common = names_of_one.intersection(&names_of_other).copied();
        let common: Vec<_> = common.filter(|name| !of_scene(name)).collect();
        assert!(common.is_empty(), "{cell}: {common:?}");
        let prefix = format!("{}_", robots[0]);
        assert!(names_of_one.iter().filter(|name| !of_scene(name)).all(|name| name.starts_with(&prefix)), "{one}");
    }
}
