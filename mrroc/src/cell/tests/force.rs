//! Tests of the keys of force sensors and of the emulated scene.

use super::*;
use std::time::Duration;

use drive::wrench::{Content, SerialWrenchConfig, Trigger, WrenchAxis, WrenchConfig};

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
            "force_sensor[0].force_range[1]: is 10 N, and the tool with the emulated offset, drift and noise alone can load",
        ),
        (
            WRIST,
            "torque_range = [5.0, 5.0, 5.0]",
            "torque_range = [1.6, 5.0, 5.0]",
            "force_sensor[0].torque_range[0]: is 1.6 N·m, and the tool",
        ),
        (WRIST, "position = ", "rate_hz = 499\nposition = ", "force_sensor[0].rate_hz: is 499, must be 500 (Hz)"),
        (WRIST, "position = ", "baud = 57600\nposition = ", "force_sensor[0].baud: a period of 2ms is too short"),
        (WRIST, "position = ", "tool_lag_s = 0.1\nposition = ", "force_sensor[0].tool_lag_s: is 0.1, must be between"),
        (
            WRIST,
            "position = ",
            "tool_inertia = [0.01, 0.01, 0.03]\nposition = ",
            "force_sensor[0].tool_inertia: the inertia about the centre of mass is not that of a body",
        ),
        (
            WRIST,
            "position = ",
            "max_offset = [66.0, 10.0, 10.0, 1.0, 1.0, 1.0]\nposition = ",
            "force_sensor[0].max_offset[0]: is 66, must be between",
        ),
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

const CAN_WRIST: &str = include_str!("../../../../cells/irb6-can-wrist.toml");

#[test]
fn a_drift_without_a_change_of_temperature_or_beyond_the_range_is_refused() {
    let course = |end: f64| format!("temperature = {{ start = 20, end = {end}, time_constant_s = 60 }}");
    let with = |keys: &str| WRIST.replacen("[scene]", &format!("[force_sensor.emulator]\n{keys}\n\n[scene]"), 1);
    let drift = "drift = [0.1, 0, 0, 0, 0, 0]\n";
    assert!(Cell::parse(&with(&format!("{drift}{}", course(60.0)))).is_ok());
    let cases = [
        (drift.to_owned(), "force_sensor[0].emulator.drift: has no effect without temperature"),
        (format!("{drift}{}", course(-300.0)), "force_sensor[0].emulator.temperature.end: is -300, must be between"),
        (format!("{drift}{}", course(620.0)), "force_sensor[0].force_range[0]: is 65 N, and the tool"),
    ];
    for (keys, expected) in cases {
        let error = Cell::parse(&with(&keys)).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn a_sensor_on_a_bus_has_its_process_data_and_no_group_of_its_own() {
    let cell = Cell::parse(CAN_WRIST).unwrap();
    assert_eq!(cell.groups().collect::<Vec<_>>(), ["arm"]);
    assert_eq!((cell.sensors_on(0).collect::<Vec<_>>(), cell.serial_sensors().count()), (vec![0], 0));
    let config = &cell.sensor_configs(0)[0];
    assert_eq!((config.node.raw(), config.trigger), (16, Trigger::Sync { every: 1 }));
    let ids: Vec<_> = config.pdos.iter().map(|pdo| pdo.cob_id.raw()).collect();
    assert_eq!(ids, [0x190, 0x290]);
    assert_eq!(config.pdos[1].fields[2].content, Content::I16(WrenchAxis::Tz));
    assert_eq!(config.sensor.channels.map(|channel| channel.range), [3250, 3250, 6500, 5000, 5000, 5000]);
    // A list of frames whose COB-ID, width and timer are not the usual ones.
    let other = CAN_WRIST.replacen("number = 1\n", "number = 3\ncob_id = 0x1F0\nfixed_mapping = true\n", 1);
    let other = other.replacen("product = 0xF76\n", "event_timer_ms = 4\ndevice_type = 7\n", 1);
    let other = other.replace("content = \"fx\", bytes = 2 },", "content = \"fx\", bytes = 4 },");
    let config = Cell::parse(&other).unwrap().sensor_configs(0)[0].clone();
    assert_eq!((config.trigger, config.device_type), (Trigger::EventTimer(Duration::from_millis(4)), Some(7)));
    let pdo = &config.pdos[0];
    assert_eq!((pdo.number.offset(), pdo.cob_id.raw(), pdo.mapped), (2, 0x1F0, false));
    assert_eq!(pdo.fields[0].content, Content::I32(WrenchAxis::Fx));
}

#[test]
fn a_sensor_on_a_bus_that_cannot_be_is_refused_with_line_key_and_reason() {
    let fx = "{ index = 0x2000, subindex = 1, content = \"fx\", bytes = 2 }";
    let cases = [
        ("[force_sensor.can]\nbus = \"arm\"", "[force_sensor.can]\nbus = \"leg\"", "can.bus: no bus is called \"leg\""),
        ("node = 16", "node = 0", "can.node: is 0, must be between 1 and 127"),
        ("node = 16", "node = 3", "can.node: node 3 of bus \"arm\" is used twice, first by robot[0].axis[2]"),
        ("node = 16", "node = 16\nevery_syncs = 0", "can.every_syncs: is 0, must be between 1"),
        ("node = 16", "node = 16\nevery_syncs = 2\nevent_timer_ms = 2", "can.every_syncs: has no effect"),
        ("node = 16", "node = 16\nevent_timer_ms = 0", "can.event_timer_ms: is 0, must be between 1"),
        ("number = 2", "number = 5", "can.pdo[1].number: is 5, must be between 1 and 4"),
        ("number = 2", "number = 1", "can.pdo: node 16: a sample takes 1 to 4 PDOs, each with a number of its own"),
        ("number = 2", "number = 2\ncob_id = 0x181", "can.pdo: node 16: COB-ID 0x181 is reserved"),
        (fx, "{ index = 0x2000, content = \"fx\", bytes = 3 }", "can.pdo[0].field[0].bytes: is 3, must be 2 or 4"),
        (fx, "{ index = 0x2000, content = \"status\", bytes = 5 }", "can.pdo[0].field[0].bytes: is 5, must be 1 to 4"),
        (fx, "{ index = 0x2002, content = \"status\", bytes = 1 }", "can.pdo: node 16: Fx must be in one field"),
        (
            fx,
            "{ index = 0x2000, subindex = 2, content = \"fx\", bytes = 2 }",
            "can.pdo: node 16: object 0x2000:02 is mapped for Fx and for Fy: each component needs an object of its own",
        ),
        (
            fx,
            "{ index = 0x2000, content = \"fx\", bytes = 2, errors = 1 }",
            "can.pdo[0].field[0].errors: has no effect",
        ),
        ("node = 16", "node = 16\nparameter = [{ index = 0x1800, value = 1, bytes = 4 }]", "can.parameter[0].index: "),
        ("force_per_count = 0.02\n", "", "force_per_count: is missing: a sensor on a CAN bus needs the scale"),
        ("force_per_count = 0.02\n", "force_per_count = 0.001\n", "force_range[0]: is 65, must be between"),
        ("force_per_count", "baud = 115200\nforce_per_count", "baud: has no effect for a sensor on a CAN bus"),
        ("force_per_count", "line = \"/dev/ttyS0\"\nforce_per_count", "line: is given beside can"),
    ];
    for (from, to, expected) in cases {
        let text = CAN_WRIST.replacen(from, to, 1);
        assert_ne!(text, CAN_WRIST, "{from}");
        let error = Cell::parse(&text).unwrap_err().to_string();
        assert!(error.contains(&format!("force_sensor[0].{expected}")), "{error}");
    }
    let without = WRIST.replacen("line = \"/dev/serial/by-id/usb-wrist\"\n", "", 1);
    let error = Cell::parse(&without).unwrap_err().to_string();
    assert!(error.contains("force_sensor[0].line: is missing: give the tty as line, or the node"), "{error}");
}
