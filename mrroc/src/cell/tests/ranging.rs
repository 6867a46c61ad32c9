//! Tests of the keys of ultrasonic matrices and of touch probes.

use super::*;

const SONAR: &str = include_str!("../../../../cells/irb6-sonar.toml");
const PROBE: &str = include_str!("../../../../cells/irb6-probe.toml");

#[test]
fn the_example_matrix_is_a_group_after_the_buses() {
    let cell = Cell::parse(SONAR).unwrap();
    assert_eq!(cell.groups().collect::<Vec<_>>(), ["arm", "matrix"]);
    assert_eq!(cell.matrix_of_group(1).map(|matrix| &*matrix.name), Some("matrix"));
    assert!(cell.matrix_of_group(0).is_none() && cell.sensor_of_group(1).is_none());
    // Columns along x of the base, rows downward, and the view along y.
    let pose = cell.ultrasonic[0].base_from_matrix();
    let axes = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]].map(nalgebra::Vector3::from);
    for (column, axis) in axes.into_iter().enumerate() {
        let unit = nalgebra::Vector3::ith(column, 1.0);
        assert!((pose.rotation * unit - axis).norm() < 1e-6, "axis {column}");
    }
}

#[test]
fn matrices_and_touch_probes_that_cannot_be_are_refused_with_line_key_and_reason() {
    let cases = [
        (SONAR, "name = \"matrix\"", "name = \"arm\"", "ultrasonic[0].name: the name \"arm\" is used twice"),
        (SONAR, "robot = \"irb6\"\nline", "robot = \"irb7\"\nline", "ultrasonic[0].robot: no robot is called \"irb7\""),
        (SONAR, "size = 12", "size = 17", "ultrasonic[0].size: 17 elements per row, must be 1 to 16"),
        (
            SONAR,
            "size = 12",
            "size = 12\nscan = \"pairs\"",
            "ultrasonic[0].size: 12 elements per row, must be 1 to 4 for this kind of scan",
        ),
        (
            SONAR,
            "size = 12",
            "size = 4\nscan = \"columns\"",
            "ultrasonic[0].scan: is \"columns\", must be \"rows\" or \"pairs\"",
        ),
        (SONAR, "pitch = 0.02", "pitch = 0.0", "ultrasonic[0].pitch: a pitch of 0 m"),
        (SONAR, "half_cone = 0.1396", "half_cone = 8.0", "ultrasonic[0].half_cone: is 8, must be between"),
        (SONAR, "slot_us = 3500", "slot_us = 0", "ultrasonic[0].slot_us: a firing slot of 0ns"),
        (
            SONAR,
            "quaternion = [0.70710678, -0.70710678, 0.0, 0.0]",
            "quaternion = [1.0, 1.0, 0.0, 0.0]",
            "ultrasonic[0].quaternion: has the length 1.414",
        ),
        (
            SONAR,
            "lost_echoes = 0.1",
            "lost_echoes = 1.5",
            "ultrasonic[0].emulator.lost_echoes: is 1.5, must be between",
        ),
        (PROBE, "input = \"touch\"", "input = \"tuch\"", "scene.touch_probe[0].input: no input is called \"tuch\""),
        (PROBE, "force = 2.0", "force = 0.0", "scene.touch_probe[0].force: is 0, must be between"),
        (
            PROBE,
            "inverted = true",
            "inverted = true\nemulated_edges_s = [1.0]",
            "scene.touch_probe[0].input: is \"touch\", whose levels are scheduled",
        ),
        (
            PROBE,
            "[[scene.block]]",
            "[[scene.touch_probe]]\ninput = \"touch\"\n\n[[scene.block]]",
            "scene.touch_probe[1].input: is \"touch\", which has a touch probe already",
        ),
    ];
    for (text, good, bad, expected) in cases {
        assert!(text.contains(good), "{good:?} is not in the cell");
        let error = Cell::parse(&text.replacen(good, bad, 1)).unwrap_err().to_string();
        assert!(error.contains(expected), "{bad:?}: {error}");
    }
}
