//! Names, which are used for files, columns, options and terminal output.

use super::*;

const NAMES: [(&str, &str, &str, &str); 14] = [
    ("cell", "name = \"lab\"", "name = NAME", "name"),
    ("bus", "name = \"track-base\"", "name = NAME", "bus[0].name"),
    ("bundle", "name = \"irb6\"\nprotocol", "name = NAME\nprotocol", "serial[0].name"),
    ("robot", "name = \"irb6\"\nmodel", "name = NAME\nmodel", "robot[0].name"),
    ("axis", "name = \"column\"", "name = NAME", "robot[0].axis[0].name"),
    ("meeting", "meet = \"start\"", "meet = NAME", "robot[0].program[0].meet"),
    (
        "I/O node",
        "period_us = 2000",
        "io = [{ name = NAME, bus = \"rnt\", node = 40, vendor = 0 }]\nperiod_us = 2000",
        "io[0].name",
    ),
    (
        "input",
        "period_us = 2000",
        "io = [{ name = \"a\", bus = \"rnt\", node = 40, vendor = 0, input = [{ name = NAME, line = 0 }] }]\n\
         period_us = 2000",
        "io[0].input[0].name",
    ),
    (
        "output",
        "period_us = 2000",
        "io = [{ name = \"a\", bus = \"rnt\", node = 40, vendor = 0, output = [{ name = NAME, line = 0 }] }]\n\
         period_us = 2000",
        "io[0].output[0].name",
    ),
    (
        "force sensor",
        "period_us = 2000",
        "force_sensor = [{ name = NAME, robot = \"a\", line = \"a\", force_range = [1, 1, 1], torque_range = [1, 1, 1] }]\n\
         period_us = 2000",
        "force_sensor[0].name",
    ),
    (
        "camera",
        "period_us = 2000",
        "camera = [{ name = NAME, robot = \"a\", address = \"127.0.0.1:5600\", field_of_view = 0.8, \
         position = [0.0, 0.0, 1.0], quaternion = [1.0, 0.0, 0.0, 0.0] }]\n\
         period_us = 2000",
        "camera[0].name",
    ),
    (
        "ultrasonic matrix",
        "period_us = 2000",
        "ultrasonic = [{ name = NAME, robot = \"a\", line = \"a\", size = 12, pitch = 0.02, half_cone = 0.14, \
         position = [0, 0, 0], quaternion = [1, 0, 0, 0] }]\nperiod_us = 2000",
        "ultrasonic[0].name",
    ),
    (
        "bar",
        "period_us = 2000",
        "scene = { bar = [{ name = NAME, mass = 1, length = 1, width = 0.1, place = { position = [0, 0, 0] } }] }\n\
         period_us = 2000",
        "scene.bar[0].name",
    ),
    (
        "workpiece",
        "period_us = 2000",
        "scene = { workpiece = [{ name = NAME, size = [1, 1, 1], place = { position = [0, 0, 0] } }] }\nperiod_us = 2000",
        "scene.workpiece[0].name",
    ),
];

#[test]
fn a_name_that_a_path_a_table_or_an_option_would_misread_is_refused() {
    let bad = [
        "",
        "../../evil",
        "/evil",
        ".",
        ".hidden",
        "a.b",
        "a\\nb",
        "a,b",
        "a b",
        "a=b",
        "-a",
        "é",
        "a\\u0000",
        "\\u001b[31m",
        "a/b",
        "a\\\"b",
        "a;b",
    ];
    let long = "a".repeat(65);
    for (what, good, given, key) in NAMES {
        for name in bad.into_iter().chain([long.as_str()]) {
            let given = given.replace("NAME", &format!("\"{name}\""));
            let error = Cell::parse(&LAB.replacen(good, &given, 1)).expect_err(&given);
            assert_eq!(error.key, key, "{what} {name}: {error}");
            assert_eq!(error.line, line_of(LAB, good), "{error}");
            let shown = error.to_string();
            assert!(shown.contains("must be a name: 1 to 64 letters"), "{shown}");
            assert!(!shown.chars().any(char::is_control), "{shown:?}");
        }
    }
}

#[cfg(feature = "schema")]
#[test]
fn the_names_of_the_schema_are_those_that_are_read() {
    let schema = serde_json::to_string(&Cell::schema()).unwrap();
    let pattern = "\"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$\"";
    assert_eq!(schema.matches(pattern).count(), NAMES.len());
    for name in ["a", "7", "A-b_C", &"x".repeat(64)] {
        let text = IRB6.replacen("name = \"column\"", &format!("name = \"{name}\""), 1);
        assert_eq!(Cell::parse(&text).unwrap().robot[0].axis[0].name, name);
    }
}

#[test]
fn an_interface_or_a_line_is_a_text_without_control_characters() {
    let cases = [
        (IRB6, "interface = \"can0\"", "interface = ", "bus[0].interface"),
        (SERIAL, "line = \"/dev/ttyMI8\"", "line = ", "robot[0].axis[0].controller.line"),
        (IRB6, "drive = { vendor", "drive = { revision = 1, dcf = ", "robot[0].axis[0].drive.dcf"),
    ];
    for (text, good, key, path) in cases {
        for (bad, expected) in [
            ("\"\"", "is empty"),
            ("\"a\\u0000b\"", "is \"a\\0b\", must have no control characters"),
            ("\"a\\nb\"", "is \"a\\nb\", must have no control characters"),
            ("\"\\u001b[2J\"", "must have no control characters"),
        ] {
            let given = match good.ends_with("vendor") {
                true => format!("{key}{bad}, vendor"),
                false => format!("{key}{bad}"),
            };
            let error = Cell::parse(&text.replacen(good, &given, 1)).expect_err(&given);
            assert_eq!((error.key.as_str(), error.line), (path, line_of(text, good)), "{error}");
            assert!(error.to_string().contains(expected), "{error}");
        }
    }
}

#[test]
fn an_error_of_an_axis_says_its_name() {
    let cell = Cell::parse(IRB6).unwrap();
    let robot = &cell.robot[0];
    let table = [
        ("step 3: axis 4: set-point", "step 3: axis wrist-roll: set-point"),
        ("axis 1: joint at 3", "axis lower-arm: joint at 3"),
        ("lower-arm, axis 1: joint at 3", "axis lower-arm: joint at 3"),
        ("irb6.lower-arm, axis 1: joint at 3", "axis lower-arm: joint at 3"),
        ("axis 14: none of these", "axis 14: none of these"),
        ("leg 1 of none", "leg 1 of none"),
    ];
    for (error, said) in table {
        assert_eq!(robot.naming_axes(error), said);
    }
}

#[test]
fn an_axis_is_found_by_the_names_that_are_unique_among_those_meant() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/lab.toml");
    let file = CellFile::read(&path).unwrap();
    let find = |name: &str, on_can| file.find_axis(name, on_can).map_err(|error| error.to_string());
    // The IRb-6 of this cell, which has a column too, has axis controllers on serial lines.
    for name in ["column", "irp6-track.column", "irp6-track/column"] {
        assert_eq!(find(name, true), Ok((1, 1)), "{name}");
    }
    let both = "more than one axis is called \"column\": irb6.column, irp6-track.column";
    assert_eq!(find("column", false), Err(both.to_owned()));
    let rolls = "more than one axis is called \"wrist-roll\" with a drive on CAN: irp6-track.wrist-roll (node 2), \
                 rnt.wrist-roll (node 4)";
    assert_eq!(find("wrist-roll", true), Err(rolls.to_owned()));
    for name in ["irb6.column", "elbow"] {
        let none = format!("no axis is called {name:?} with a drive on CAN; there are irp6-track.track (node 1), ");
        assert!(find(name, true).is_err_and(|error| error.starts_with(&none)), "{name}");
    }
}
