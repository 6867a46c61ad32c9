//! Tests of the keys of network cameras.

use super::*;

const CAMERA: &str = include_str!("../../../../cells/irb6-camera.toml");

#[test]
fn the_example_camera_is_no_drive_group_and_looks_along_y_of_the_base() {
    let cell = Cell::parse(CAMERA).unwrap();
    assert_eq!(cell.groups().collect::<Vec<_>>(), ["arm"]);
    let along = cell.camera[0].base_from_camera().rotation * nalgebra::Vector3::z();
    assert!((along - nalgebra::Vector3::y()).norm() < 1e-6, "{along}");
    assert_eq!(cell.camera[0].config().deadline(), std::time::Duration::from_millis(450));
}

#[test]
fn cameras_that_cannot_be_are_refused_with_line_key_and_reason() {
    let cases = [
        ("name = \"eye\"", "name = \"arm\"", "camera[0].name: the name \"arm\" is used twice"),
        ("robot = \"irb6\"\naddress", "robot = \"irb7\"\naddress", "camera[0].robot: no robot is called \"irb7\""),
        ("127.0.0.1:5600", "camera.local", "camera[0].address: is \"camera.local\", must be an IP address and a port"),
        ("127.0.0.1:5600", "127.0.0.1:0", "camera[0].address: is \"127.0.0.1:0\", must be an IP address and a port"),
        ("width = 160", "width = 2000", "camera[0].width: is 2000, must be between"),
        ("field_of_view = 0.80", "field_of_view = 3.2", "camera[0].field_of_view: is 3.2, must be between"),
        ("period_ms = 100", "period_ms = 5", "camera[0].period_ms: is 5, must be between"),
        (
            "period_ms = 100",
            "period_ms = 100\nemulator = { exposure_ms = 101.0 }",
            "camera[0].emulator.exposure_ms: is 101, must be between",
        ),
        (
            "quaternion = [0.70710678, -0.70710678, 0.0, 0.0]",
            "quaternion = [1.0, 1.0, 0.0, 0.0]",
            "camera[0].quaternion: has the length 1.414",
        ),
    ];
    for (good, bad, expected) in cases {
        assert!(CAMERA.contains(good), "{good:?} is not in the cell");
        let error = Cell::parse(&CAMERA.replacen(good, bad, 1)).unwrap_err().to_string();
        assert!(error.contains(expected), "{bad:?}: {error}");
    }
}
