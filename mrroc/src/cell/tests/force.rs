//! Tests of the keys of force sensors and of the emulated scene.

use super::*;
use drive::wrench::{SerialWrenchConfig, WrenchConfig};

const WRIST: &str = include_str!("../../../../cells/irb6-wrist.toml");

#[test]
fn the_example_sensor_is_the_ati_sensor_of_the_driver() {
    let cell = Cell::parse(WRIST).unwrap();
    assert_eq!(cell.force_sensor[0].config(cell.period()), SerialWrenchConfig::new(cell.period()));
    assert_eq!(WrenchConfig::ATI.channels[2].range, 1_495);
    assert_eq!(cell.groups().collect::<Vec<_>>(), ["arm", "wrist"]);
    assert_eq!(cell.sensor_of_group(0).map(|sensor| &*sensor.name), None);
    assert_eq!(cell.sensor_of_group(1).map(|sensor| &*sensor.name), Some("wrist"));
    assert_eq!(cell.axes_on(1).count(), 0);
}

#[test]
fn a_sensor_that_cannot_be_is_refused_with_line_key_and_reason() {
    let second = "[[force_sensor]]\nname = \"second\"\nrobot = \"irb6\"\nline = \"/dev/ttyS9\"\n\
                  force_range = [65, 65, 130]\ntorque_range = [5, 5, 5]\n\n[scene]\n";
    let two = WRIST.replacen("[scene]\n", second, 1);
    let slcan = WRIST.replacen("interface = \"can0\"", "interface = \"slcan:/dev/ttyUSB0\"", 1);
    let cases = [
        (
            WRIST,
            "robot = \"irb6\"\nline",
            "robot = \"irb7\"\nline",
            "force_sensor[0].robot: no robot is called \"irb7\"",
        ),
        (WRIST, "force_range = [65.0, 65.0, 130.0]\n", "\n", "force_sensor[0].force_range: is missing"),
        (WRIST, "torque_range = [5.0, 5.0, 5.0]\n", "\n", "force_sensor[0].torque_range: is missing"),
        (
            WRIST,
            "force_range = [65.0, 65.0, 130.0]",
            "force_range = [65.0, 0.0, 130.0]",
            "force_sensor[0].force_range[1]: is 0, must be between",
        ),
        (
            WRIST,
            "force_range = [65.0, 65.0, 130.0]",
            "force_range = [65.0, 10.0, 130.0]",
            "force_sensor[0].force_range[1]: is 10 N, and the tool with the emulated offset and noise alone can load",
        ),
        (
            WRIST,
            "torque_range = [5.0, 5.0, 5.0]",
            "torque_range = [1.6, 5.0, 5.0]",
            "force_sensor[0].torque_range[0]: is 1.6 N·m, and the tool",
        ),
        (WRIST, "position = ", "rate_hz = 499\nposition = ", "force_sensor[0].rate_hz: is 499, must be 500 (Hz)"),
        (WRIST, "position = ", "baud = 57600\nposition = ", "force_sensor[0].baud: a period of 2ms is too short"),
        (WRIST, "position = ", "zero_samples = 0\nposition = ", "force_sensor[0].zero_samples: is 0, must be between"),
        (
            WRIST,
            "position = ",
            "quaternion = [1.0, 1.0, 0.0, 0.0]\nposition = ",
            "force_sensor[0].quaternion: has the length 1.414, must be a unit quaternion",
        ),
        (
            WRIST,
            "name = \"wrist\"",
            "name = \"arm\"",
            "force_sensor[0].name: the name \"arm\" is used twice, first by bus[0]",
        ),
        (
            WRIST,
            "name = \"wrist\"",
            "name = \"column\"",
            "force_sensor[0].name: the name \"column\" is used twice, first by robot[0].axis[0]",
        ),
        (
            &two,
            "name = \"second\"",
            "name = \"wrist\"",
            "force_sensor[1].name: force sensor \"wrist\" is used twice, first by force_sensor[0]",
        ),
        (
            &two,
            "line = \"/dev/ttyS9\"",
            "line = \"/dev/serial/by-id/usb-wrist\"",
            "force_sensor[1].line: line \"/dev/serial/by-id/usb-wrist\" is used twice, first by force_sensor[0]",
        ),
        (
            &slcan,
            "line = \"/dev/serial/by-id/usb-wrist\"",
            "line = \"/dev/ttyUSB0\"",
            "force_sensor[0].line: line \"/dev/ttyUSB0\" is used twice, first by bus[0]",
        ),
        (WRIST, "robot = \"irb6\"\ntip", "robot = \"arm\"\ntip", "scene.robot: no robot is called \"arm\", only irb6"),
        (WRIST, "stiffness = 1e4", "stiffness = 0.0", "scene.plane[0].stiffness: is 0, must be between"),
        (WRIST, "height = 0.78", "normal = [0, 0, 0]\nheight = 0.78", "scene.plane[0].normal: has no direction"),
    ];
    for (text, good, bad, expected) in cases {
        assert!(text.contains(good), "{good:?} is not in the cell");
        let error = Cell::parse(&text.replacen(good, bad, 1)).unwrap_err();
        assert!(error.to_string().contains(expected), "{bad:?}: {error}");
        if !bad.trim().is_empty() {
            let within = line_of(text, good)..=line_of(text, good) + bad.matches('\n').count();
            assert!(within.contains(&error.line), "{bad:?}: {error}");
        }
    }
}

#[test]
fn a_sensor_does_not_share_the_line_of_an_axis_controller() {
    let sensor = "[[force_sensor]]\nname = \"wrist\"\nrobot = \"irb6\"\nline = \"LINE\"\n\
                  force_range = [65, 65, 130]\ntorque_range = [5, 5, 5]\n\n[[robot]]\n";
    let cell = Cell::parse(SERIAL).unwrap();
    let taken = &cell.robot[0].axis[1].axis_controller().line;
    let with = |line: &str| Cell::parse(&SERIAL.replacen("[[robot]]\n", &sensor.replace("LINE", line), 1));
    assert!(with("/dev/ttyS99").is_ok());
    let error = with(taken).unwrap_err().to_string();
    let expected = "is used twice, first by robot[0].axis[1].controller: a force sensor needs a line of its own";
    assert!(error.contains("force_sensor[0].line: ") && error.contains(expected), "{error}");
}
