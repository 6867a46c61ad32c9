//! Keys of the emulated surroundings, of bases, and of trips.

use super::*;

const BAR: &str = include_str!("../../../../cells/two-irb6-bar.toml");

#[test]
fn wrong_keys_of_the_scene_are_refused_with_line_and_key() {
    let cases = [
        ("mass = 4.0", "mass = 0.0", "scene.bar[0].mass: is 0, must be between"),
        ("length = 0.9", "length = -0.9", "scene.bar[0].length: is -0.9, must be between"),
        ("place = { position = [1.1, 0.0, 0.8] }", "", "scene.bar[0].place: is missing"),
        ("output = \"left-gripper\"", "output = \"claw\"", "no digital output is called \"claw\": add it as"),
        (
            "[[scene.gripper]]\nrobot = \"right\"",
            "[[scene.gripper]]\nrobot = \"left\"",
            "scene.gripper[1].robot: robot \"left\" is used twice, first by scene.gripper[0]",
        ),
        ("[[scene.gripper]]\nrobot = \"left\"", "[[scene.gripper]]\nrobot = \"arm\"", "no robot is called \"arm\""),
        (
            "base = { position = [2.2, 0.0, 0.0], yaw = 3.14",
            "base = { position = [2e3, 0.0, 0.0], yaw = 3.14",
            "robot[1].base.position[0]: is 2000, must be between",
        ),
        ("yaw = 0.008", "yaw = 80.0", "robot[1].emulated_base_error.yaw: is 80, must be between"),
        (
            "[[scene.plane]]",
            "[[scene.tip]]\nrobot = \"left\"\nradius = -1.0\n\n[[scene.plane]]",
            "scene.tip[0].radius: is -1, must be between",
        ),
        (
            "[[scene.plane]]",
            "[scene]\ntip_radius = 0.1\n\n[[scene.plane]]",
            "scene.tip_radius: has no effect without robot",
        ),
        (
            "node = 1\ndrive",
            "node = 1\nemulator = { trips_at_s = -1.0 }\ndrive",
            "robot[0].axis[0].emulator.trips_at_s: is -1, must be between",
        ),
    ];
    for (good, bad, expected) in cases {
        assert!(BAR.contains(good), "{good:?} is not in the cell");
        let error = Cell::parse(&BAR.replacen(good, bad, 1)).unwrap_err().to_string();
        assert!(error.contains(expected), "{bad:?}: {error}");
    }
}

#[test]
fn a_robot_without_a_base_stands_upright_at_the_origin_of_the_cell() {
    let cell = Cell::parse(BAR).unwrap();
    assert_eq!(cell.robot[0].cell_from_base(), Pose::identity());
    let facing = cell.robot[1].cell_from_base() * nalgebra::Point3::new(0.7, 0.1, 0.8);
    assert!((facing - nalgebra::Point3::new(1.5, -0.1, 0.8)).norm() < 1e-12, "{facing}");
}
