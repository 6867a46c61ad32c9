//! The structure of a file: every element is used, or refused with its line, its key and the permitted values.

use super::*;

/// Checks the refusal after the first `good` was replaced by `bad`. After the line, the message must begin with
/// `expected`.
fn refused(text: &str, good: &str, bad: &str, expected: &str) {
    assert!(text.contains(good), "no {good:?}");
    let error = Cell::parse(&text.replacen(good, bad, 1)).expect_err(bad);
    let shown = error.to_string();
    let line = format!("{}: ", line_of(text, good));
    let said = shown.strip_prefix(&line).unwrap_or_else(|| panic!("{bad}: {shown}"));
    assert!(said.starts_with(expected), "{bad}: {shown}");
}

#[test]
fn surplus_elements_are_refused_at_their_array() {
    let position = "position = [0.85, 0.0, 0.85]";
    let line = "robot[0].program[1].line";
    let surplus = [
        "position = [0.85, 0, 0.85, 99.0]",
        "position = [0.85, 0, 0.85, \"up\"]",
        "position = [0.85, 0, 0.85, { x = 1 }]",
        "position = [0.85, 0, 0.85, []]",
    ];
    for bad in surplus {
        let expected = format!("{line}.position: has 4 elements, must have 3");
        refused(IRB6, position, bad, &expected);
    }
    refused(IRB6, position, "position = [0.85, 0.0]", &format!("{line}.position: has 2 elements, must have 3"));
    refused(
        IRB6,
        position,
        "position = [0.85, 0.0, 0.85], quaternion = [1.0, 0.0, 0.0, 0.0, 0.0]",
        &format!("{line}.quaternion: has 5 elements, must have 4"),
    );
    let robot = "model = \"irb6\"";
    let key = "robot[0]";
    let arrays = [
        ("tool = [0, 0, 0, 0]", ".tool: has 4 elements, must have 3"),
        (
            "emulated_payload = [{ at_s = 1.0, mass = 1.0, centre = [0, 0, 0, 0] }]",
            ".emulated_payload[0].centre: has 4 elements, must have 3",
        ),
        ("weight = { up = [0, 0, 1, 0] }", ".weight.up: has 4 elements, must have 3"),
        (
            "weight = { load = { mass = 1.0, centre = [0, 0, 0, 0] } }",
            ".weight.load.centre: has 4 elements, must have 3",
        ),
    ];
    for (bad, expected) in arrays {
        refused(IRB6, robot, &format!("{bad}\n{robot}"), &format!("{key}{expected}"));
    }
}

#[test]
fn a_choice_of_two_is_refused() {
    let law = "law = { cascade = {";
    let two = "law = { incremental = { a = 0.1, b0 = 1.0, b1 = 1.0, eps = 0.1, gain = 1.0, limit = 1.0 }, cascade = {";
    refused(
        SERIAL,
        law,
        two,
        "robot[0].axis[0].controller.loop.law: has 2 keys, must have one: \"incremental\", \"cascade\" or \"proportional\"",
    );
    let error = Cell::parse(&IRB6.replacen("line = {", "meet = \"x\"\nline = {", 1)).unwrap_err();
    // The error belongs to the table, which begins a line before.
    assert_eq!(error.line, line_of(IRB6, "line = {") - 1);
    let expected = "robot[0].program[1]: has 2 keys, must have one: \"joints\", \"line\" or \"meet\"";
    assert!(error.to_string().ends_with(expected), "{error}");
}

#[test]
fn a_value_of_the_wrong_type_says_what_it_must_be() {
    let axis = "robot[0].axis[0]";
    let cases = [
        ("node = 1", "node = 256", ".node: is 256, must be a whole number from 0 to 255"),
        ("node = 1", "node = -1", ".node: is -1, must be a whole number from 0 to 255"),
        ("node = 1", "node = 1.0", ".node: is 1.0, must be a whole number from 0 to 255"),
        ("node = 1", "node = \"1\"", ".node: is \"1\", must be a whole number from 0 to 255"),
        ("node = 1", "node = 1979-05-27", ".node: is a date or time, must be a whole"),
        ("name = \"column\"", "name = 7", ".name: is 7, must be a string in quotes"),
        ("name = \"column\"", "name = [\"column\"]", ".name: is an array, must be a string"),
        ("max_velocity = 250.0", "max_velocity = \"250\"", ".max_velocity: is \"250\", must be a number"),
        ("max_velocity = 250.0", "max_velocity = 1e300", ".max_velocity: is 1e300, must be between -1e12 and 1e12"),
        ("max_velocity = 250.0", "max_velocity = 1e400", ".max_velocity: must be a finite number"),
        ("homing = {", "homing = 3 #{", ".homing: is 3, must be a table"),
        ("homing = {", "homing = [11, 4] #{", ".homing: is an array, must be a table"),
        (
            "homing = { method = 11",
            "homing = { method = 200",
            ".homing.method: is 200, must be a whole number from -128 to 127",
        ),
        (
            "drive = { vendor = 0xFB",
            "drive = { vendor = 0x1_0000_0000",
            ".drive.vendor: is 0x100000000, must be a whole number from 0 to 4294967295",
        ),
        (
            "drive = { vendor = 0xFB",
            "drive = { reversed = 1, vendor = 0xFB",
            ".drive.reversed: is 1, must be true or false",
        ),
        (
            "drive = { vendor = 0xFB",
            "drive = { control = \"speed\", vendor = 0xFB",
            ".drive.control: is \"speed\", must be \"position\", \"velocity\" or \"torque\"",
        ),
    ];
    for (good, bad, expected) in cases {
        refused(IRB6, good, bad, &format!("{axis}{expected}"));
    }
    refused(
        IRB6,
        "poses = [[0.4,",
        "poses = [[\"0.4\",",
        "robot[0].program[0].joints.poses[0][0]: is \"0.4\", must be a number",
    );
    refused(
        IRB6,
        "generator = \"jerk-limited\"",
        "generator = { smooth = 1 }",
        "robot[0].program[2].joints.generator.smooth: is an unknown key, must be \"newsmooth\" or \"jerk-limited\"",
    );
}

#[test]
fn keys_that_are_unknown_missing_or_given_twice_are_named() {
    refused(
        IRB6,
        "homing = { method",
        "homing = { mehtod",
        "robot[0].axis[0].homing.mehtod: is an unknown key, must be \"method\", \"direction\"",
    );
    refused(
        IRB6,
        "homing = { method = 11, order = 4, search_velocity = 15.0,",
        "homing = { method = 11, order = 4,",
        "robot[0].axis[0].homing.search_velocity: is missing",
    );
    refused(IRB6, "max_velocity = 250.0", "node = 2", "node: is given twice");
    refused(IRB6, "homing = { method = 11", "homing = { method = 11, method = 12", "method: is given twice");
    refused(IRB6, "period_us = 2000", "name = \"a\"", "name: is given twice");
    let text = IRB6.replacen("name = \"irb6\"\nperiod", "period", 1);
    let error = Cell::parse(&text).unwrap_err().to_string();
    assert_eq!(error, "1: name: is missing");
}

#[test]
fn what_a_message_quotes_is_short_and_does_nothing_to_a_terminal() {
    let long = "9".repeat(300);
    let red = "\\u001b[31m";
    let cases = [
        ("node = 1", format!("node = {long}")),
        ("max_velocity = 250.0", format!("max_velocity = {long}")),
        ("max_velocity = 250.0", format!("max_velocity = 0.{long}e200")),
        ("name = \"column\"", format!("name = \"{long}\"")),
        ("bus = \"arm\"", format!("bus = \"{long}\"")),
        ("model = \"irb6\"", format!("model = \"{long}\"")),
        ("node = 1", format!("node{long} = 1")),
        ("node = 1", format!("\"{long}\" = 1")),
        ("name = \"column\"", format!("name = \"{red}\"")),
        ("bus = \"arm\"", format!("bus = \"{red}\"")),
        ("interface = \"can0\"", format!("interface = \"{red}\"")),
        ("model = \"irb6\"", format!("model = \"{red}\"")),
        ("node = 1", format!("\"{red}\" = 1")),
        ("node = 1", format!("\"{red}\" = 1\n\"{red}\" = 1")),
        ("node = 1", "node = \u{1b}[31m1".to_owned()),
        ("node = 1", format!("node = \"{red}\"")),
        ("line = {", format!("meet = \"{red}\" #")),
        ("line = {", format!("\"{red}\" = {{")),
    ];
    for (good, bad) in cases {
        let error = Cell::parse(&IRB6.replacen(good, &bad, 1)).expect_err(&bad);
        let shown = error.to_string();
        assert_eq!(error.line, line_of(IRB6, good) + bad.matches('\n').count(), "{shown}");
        assert!(shown.len() < 400, "{shown}");
        assert!(!shown.contains(&"9".repeat(100)), "{shown}");
        assert!(!shown.chars().any(char::is_control), "{shown:?}");
    }
}

#[test]
fn bytes_that_are_no_text_are_refused_at_their_line() {
    let at = IRB6.find("node = 2").unwrap();
    let mut bytes = IRB6.as_bytes().to_vec();
    bytes[at] = 0xFF;
    let error = Cell::text(&bytes).unwrap_err();
    assert_eq!(error.line, line_of(IRB6, "node = 2"));
    let shown = error.to_string();
    assert!(shown.contains("byte 0xff is no UTF-8"), "{shown}");
    assert_eq!(Cell::text(IRB6.as_bytes()).unwrap(), IRB6);
}

#[test]
fn a_file_beyond_any_cell_is_refused_before_it_is_parsed() {
    let cases = [
        (" ".repeat(LARGEST + 1), "1: the file has 1048577 bytes, a cell file may have 1048576"),
        (format!("x = [\n{}]", "1,".repeat(70_000)), "2: the file has too many elements"),
        (format!("x = {}{}", "[".repeat(70_000), "]".repeat(70_000)), "1: the file has too many"),
        (format!("x{} = 1", ".x".repeat(70_000)), "1: the file has too many elements"),
        (format!("x = {}{}", "[".repeat(1000), "]".repeat(1000)), "1: cannot recurse further"),
        (format!("x{} = 1", ".x".repeat(1000)), "1: "),
        (format!("[x{}]", ".x".repeat(1000)), "1: "),
    ];
    for (text, expected) in cases {
        let error = Cell::parse(&text).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{error}");
    }
    let commented = format!("# {}\n{IRB6}", "x".repeat(100_000));
    assert!(Cell::parse(&commented).is_ok());
}
