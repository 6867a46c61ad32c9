//! Keys without effect for the family of an axis, and homing with a reference away from home.

use super::*;

const HI_MOXA: &str = include_str!("../../../../cells/irb6-hi-moxa.toml");

/// The cell with `key = value` at the beginning of the first axis's table `table`; `None` means the axis itself.
fn with(text: &str, table: Option<&str>, given: &str) -> (String, usize) {
    let begin = match table {
        Some(table) => format!("{table} = {{ "),
        None => "max_velocity".to_owned(),
    };
    let line = line_of(text, &begin);
    let given = match table {
        Some(_) => format!("{begin}{given}, "),
        None => format!("{given}\n{begin}"),
    };
    (text.replacen(&begin, &given, 1), line)
}

#[test]
fn a_key_without_effect_on_its_family_is_refused() {
    let homing = Some("homing");
    let cases = [
        (IRB6, homing, "direction = \"positive\"", "homing.direction"),
        (IRB6, homing, "direction = \"negative\"", "homing.direction"),
        (IRB6, homing, "reverse_at_limit = true", "homing.reverse_at_limit"),
        (IRB6, homing, "reverse_at_limit = false", "homing.reverse_at_limit"),
        (SERIAL, homing, "start_timeout_ms = 500", "homing.start_timeout_ms"),
        (IRB6, None, "emulator = { address = 1 }", "emulator.address"),
        (IRB6, None, "emulator = { protocol = \"nfv2\" }", "emulator.protocol"),
        (SERIAL, None, "emulator = { vendor = 1 }", "emulator.vendor"),
        (SERIAL, None, "emulator = { revision = 1 }", "emulator.revision"),
        (SERIAL, None, "emulator = { counts_per_revolution = 4000 }", "emulator.counts_per_revolution"),
        (SERIAL, None, "emulator = { rated_torque = 1.0 }", "emulator.rated_torque"),
        (HI_MOXA, None, "emulator = { address = 1 }", "emulator.address"),
        (HI_MOXA, None, "node = 1", "node"),
    ];
    for (text, table, given, key) in cases {
        let (spoilt, line) = with(text, table, given);
        let error = Cell::parse(&spoilt).expect_err(given);
        assert_eq!((error.key, error.line), (format!("robot[0].axis[0].{key}"), line), "{given}");
        let shown = error.problem.to_string();
        assert!(shown.starts_with("has no effect "), "{given}: {shown}");
        assert!(shown.ends_with(": leave it out"), "{given}: {shown}");
    }
    let taken = [
        (SERIAL, homing, "direction = \"positive\""),
        (SERIAL, homing, "reverse_at_limit = false"),
        (SERIAL, None, "emulator = { address = 1 }"),
        (SERIAL, None, "emulator = { protocol = \"hi-moxa\" }"),
        (HI_MOXA, None, "emulator = { protocol = \"nfv2\", address = 1 }"),
        (IRB6, homing, "start_timeout_ms = 500"),
        (IRB6, None, "emulator = { vendor = 1, revision = 1, rated_torque = 1.0 }"),
    ];
    for (text, table, given) in taken {
        let (text, _) = with(text, table, given);
        assert!(Cell::parse(&text).is_ok(), "{given}");
    }
}

#[test]
fn a_wait_that_does_not_spin_takes_no_margin_and_no_share() {
    for given in ["spin_share = 0.1", "margin_us = 10"] {
        let text = format!("wait = \"plain\"\n{given}\npriority = 80");
        let error = Cell::parse(&IRB6.replacen("priority = 80", &text, 1)).unwrap_err();
        assert_eq!(error.line, line_of(IRB6, "priority = 80") + 1, "{error}");
        assert!(error.to_string().contains("has no effect with wait = \"plain\""), "{error}");
    }
}

#[test]
fn a_cell_that_was_written_by_the_program_is_read_again() {
    for text in [IRB6, IRP6, TRACK, RNT, POLYCRANK, LAB, SERIAL, HI_MOXA] {
        let cell = Cell::parse(text).unwrap();
        let written = toml::to_string(&cell).unwrap();
        Cell::parse(&written).unwrap_or_else(|error| panic!("{}: {error}", cell.name));
    }
}

#[test]
fn parameters_of_another_robot_are_refused() {
    let rnt = toml::Value::try_from(Model::Rnt.parameters()).unwrap();
    let parameters = format!("model = \"irp6\"\nparameters = {rnt}\n");
    let text = IRP6.replacen("model = \"irp6\"\n", &parameters, 1);
    let error = Cell::parse(&text).unwrap_err();
    assert_eq!(error.key, "robot[0].parameters");
    let shown = error.to_string();
    assert!(shown.contains("is of an rnt, must be { irp6 = … }"), "{shown}");
    let own = toml::Value::try_from(Model::Irp6Calibrated.parameters()).unwrap();
    let parameters = format!("model = \"irp6\"\nparameters = {own}\n");
    let text = IRP6.replacen("model = \"irp6\"\n", &parameters, 1);
    assert!(Cell::parse(&text).is_ok());
}

#[test]
fn a_homing_method_that_finds_an_end_of_the_travel_needs_home_to_be_there() {
    let method = |text: &str, method: i8| {
        let text = text.replacen("method = 11", &format!("method = {method}"), 1);
        Cell::parse(&text).map_err(|error| error.to_string())
    };
    for given in [37, 34, 33, 27, 23, 11, 7] {
        assert!(method(IRB6, given).is_ok(), "{given}");
    }
    for (given, by, end) in [
        (1, "limit switch", "lower"),
        (17, "limit switch", "lower"),
        (2, "limit switch", "upper"),
        (18, "limit switch", "upper"),
        (-1, "mechanical stop", "upper"),
        (-2, "mechanical stop", "lower"),
        (-3, "mechanical stop", "upper"),
        (-4, "mechanical stop", "lower"),
    ] {
        let error = method(IRB6, given).unwrap_err();
        let expected = format!("robot[0].axis[0].homing.method: is {given}, which takes the {by} at the {end} end");
        assert!(error.contains(&expected), "{error}");
        assert!(error.contains("use a method with a home switch (7, 11, 23, 27)"), "{error}");
        assert!(method(POLYCRANK, given).is_err(), "{given}");
    }
    // The column of a robot whose home position is the lower end of its travel, -15.9 rad.
    let parameters = toml::Value::try_from(Model::Irb6.parameters()).unwrap().to_string();
    let parameters = parameters.replacen("low = -470.0", "low = -20.0", 1);
    let given = format!("model = \"irb6\"\nparameters = {parameters}\n");
    let at_end = IRB6.replacen("model = \"irb6\"\n", &given, 1);
    assert_ne!(parameters.matches("low = -20.0").count(), 0, "{parameters}");
    for (given, possible) in [(1, true), (17, true), (-4, true), (2, false), (18, false), (-3, false)] {
        assert_eq!(method(&at_end, given).is_ok(), possible, "{given}");
        // The counter of a reversed drive falls towards the upper end.
        let reversed = at_end.replacen("drive = { vendor", "drive = { reversed = true, vendor", 1);
        assert_eq!(method(&reversed, given).is_ok(), !possible, "{given}, reversed");
    }
}

#[test]
fn an_axis_has_the_watches_of_its_cell() {
    use servo::FrozenWatch::{Always, Following, Off};
    let cases = [
        ("", 11, (Always, true)),
        ("brake = true\nfrozen_watch = true", 11, (Always, true)),
        ("brake = false", 11, (Always, false)),
        ("frozen_watch = false", 11, (Off, true)),
        ("", -1, (Following, true)),
        ("frozen_watch = false", -1, (Off, true)),
    ];
    for (given, method, expected) in cases {
        let mut cell = Cell::parse(&with(IRB6, None, given).0).unwrap();
        cell.robot[0].axis[0].homing.method = Some(method);
        let config = cell.robot[0].servo_config(0, 0, 0, Limits { low: -1000.0, high: 1000.0 });
        assert_eq!((config.frozen, config.brake_watch), expected, "{given} {method}");
    }
    let lab = Cell::parse(LAB).unwrap();
    for robot in &lab.robot {
        let held = !["gripper", "conveyor"].contains(&robot.name.as_str());
        assert!(robot.axis.iter().all(|axis| axis.brake == held), "{}", robot.name);
    }
}

/// Protection currents of the axes, A: those of the cells, and those of the main line of MRROC++.
const PROTECTION: ([f64; 5], &str) = ([25.0, 18.0, 15.0, 17.0, 10.0], "15, 18, 10, 10 and 10 A");

#[test]
fn protection_currents_are_those_of_one_source_and_cells_and_book_say_which_and_why() {
    let (currents, other) = PROTECTION;
    let lab = include_str!("../../../../cells/lab.toml");
    for text in [SERIAL, HI_MOXA, lab] {
        let axes = &Cell::parse(text).unwrap().robot[0].axis;
        let of_cell: Vec<_> = axes.iter().filter_map(|axis| Some(axis.controller.as_ref()?.max_current)).collect();
        assert_eq!(of_cell, currents);
        assert!(text.contains(other));
    }
    let book = include_str!("../../../../book/src/serial.md");
    assert!(book.contains("25, 18, 15, 17 and 10 A") && book.contains(other));
    // With those of the main line, the loops of the cells may ask for more than the protection permits.
    let spoilt = SERIAL.replacen("max_current = 25.0", "max_current = 15.0", 1);
    let error = Cell::parse(&spoilt).unwrap_err();
    assert!(error.to_string().contains("max_current * torque_constant"), "{error}");
}
