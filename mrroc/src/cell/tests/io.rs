//! I/O nodes: configurations of the driver, names of lines, refusals.

use std::time::Duration;

use super::*;

const TOUCH: &str = include_str!("../../../../cells/irb6-touch.toml");

/// Further I/O node of the example cell, with one input.
const SECOND: &str = "[[io]]\nname = \"cabinet\"\nbus = \"arm\"\nnode = 41\nvendor = 0\n\n\
                      [[io.input]]\nname = \"stop\"\nline = 7\n\n[[robot]]\n";

#[test]
fn an_io_node_of_a_cell_is_configured_by_its_lines() {
    let cell = Cell::parse(TOUCH).unwrap();
    let config = &cell.io_configs(0)[0];
    assert_eq!((config.node.raw(), config.inputs, config.outputs), (40, 4, 1));
    assert_eq!((config.inverted_inputs, config.filtered_inputs), (0b0001, 0b1000));
    // The gripper keeps its level, and is off before the first command.
    assert_eq!((config.inverted_outputs, config.error_mode, config.error_value), (0, 0, 0));
    assert_eq!(config.inhibit_time, Duration::from_millis(2));
    assert_eq!(cell.frames_per_cycle(0), 5 + 1 + 3);
    let on = TOUCH.replacen("error_state = \"keep\"", "error_state = \"on\"\ninverted = true", 1);
    let config = &Cell::parse(&on).unwrap().io_configs(0)[0];
    assert_eq!((config.inverted_outputs, config.error_mode, config.error_value), (1, 1, 1));
    // Without a given time, inputs come once per servo period.
    let usual = TOUCH.replacen("inhibit_us = 2000\n", "", 1).replacen("period_us = 2000", "period_us = 5000", 1);
    assert_eq!(Cell::parse(&usual).unwrap().io_configs(0)[0].inhibit_time, Duration::from_millis(5));
}

#[test]
fn a_line_is_found_by_its_name() {
    let cell = Cell::parse(&TOUCH.replacen("[[robot]]\n", SECOND, 1)).unwrap();
    assert_eq!(cell.input_line("gate"), Some(LinePlace { node: 0, line: 3 }));
    assert_eq!(cell.input_line("stop"), Some(LinePlace { node: 1, line: 7 }));
    assert_eq!(cell.output_line("gripper"), Some(LinePlace { node: 0, line: 0 }));
    assert_eq!((cell.input_line("gripper"), cell.output_line("gate")), (None, None));
    assert_eq!(cell.io_on(0).collect::<Vec<_>>(), [0, 1]);
}

/// The I/O node of the example cell on a bus of its own.
fn cabinet() -> String {
    let bus = "[[bus]]\nname = \"cabinet\"\nbitrate_kbps = 1000\ninterface = \"can1\"\n\n[[io]]\n";
    let own = TOUCH.replacen("[[io]]\n", bus, 1);
    own.replacen("name = \"tool\"\nbus = \"arm\"", "name = \"tool\"\nbus = \"cabinet\"", 1)
}

#[test]
fn a_bus_may_have_io_nodes_alone_and_a_bus_without_a_node_is_refused() {
    let cell = Cell::parse(&cabinet()).unwrap();
    assert_eq!((cell.axes_on(1).count(), cell.io_on(1).collect::<Vec<_>>()), (0, vec![0]));
    assert_eq!((cell.frames_per_cycle(0), cell.frames_per_cycle(1)), (5 + 3, 1 + 3));
    let unused = cabinet().replacen("bus = \"cabinet\"", "bus = \"arm\"", 1);
    let shown = Cell::parse(&unused).unwrap_err().to_string();
    let expected = "bus[1]: no axis, no I/O node and no force sensor has bus = \"cabinet\": leave it out, or name it in one of them";
    assert!(shown.ends_with(expected), "{shown}");
}

#[test]
fn emulated_edges_alternate_from_low() {
    let cell = Cell::parse(TOUCH).unwrap();
    let seconds = Duration::from_secs_f64;
    let expected = [
        (seconds(0.0), 0, true),
        (seconds(20.0), 0, false),
        (seconds(20.5), 0, true),
        (seconds(15.0), 3, true),
        (seconds(25.0), 3, false),
    ];
    assert_eq!(cell.io[0].emulated_edges().collect::<Vec<_>>(), expected);
}

#[test]
fn an_io_node_that_cannot_be_is_refused_with_line_key_and_reason() {
    let two = TOUCH.replacen("[[robot]]\n", SECOND, 1);
    let cases = [
        (TOUCH, "name = \"tool\"", "name = \"to/ol\"", "io[0].name: is \"to/ol\", must be a name"),
        (&two, "name = \"cabinet\"", "name = \"tool\"", "io[1].name: I/O node \"tool\" is used twice, first by io[0]"),
        (TOUCH, "node = 40", "node = 0", "io[0].node: is 0, must be between 1 and 127"),
        (TOUCH, "node = 40", "node = 127", "io[0].node: node 127 of bus \"arm\" is used twice, first by the host"),
        (TOUCH, "node = 40", "node = 3", "io[0].node: node 3 of bus \"arm\" is used twice, first by robot[0].axis[2]"),
        (&two, "node = 41", "node = 40", "io[1].node: node 40 of bus \"arm\" is used twice, first by io[0]"),
        (
            TOUCH,
            "name = \"gate\"",
            "name = \"touch\"",
            "io[0].input[1].name: line \"touch\" is used twice, first by io[0].input[0]",
        ),
        (
            TOUCH,
            "name = \"gripper\"",
            "name = \"gate\"",
            "io[0].output[0].name: line \"gate\" is used twice, first by io[0].input[1]",
        ),
        (
            &two,
            "name = \"stop\"",
            "name = \"gate\"",
            "io[1].input[0].name: line \"gate\" is used twice, first by io[0].input[1]",
        ),
        (TOUCH, "line = 3", "line = 64", "io[0].input[1].line: is 64, must be between 0 and 63"),
        (TOUCH, "line = 3", "line = 0", "io[0].input[1].line: line 0 is used twice, first by io[0].input[0]"),
        (TOUCH, "inhibit_us = 2000", "inhibit_us = 150", "io[0].inhibit_us: node 40: inhibit time is not a multiple"),
        (
            TOUCH,
            "inhibit_us = 2000",
            "inhibit_us = 200000",
            "io[0].inhibit_us: node 40: inhibit time is not a multiple",
        ),
        (
            TOUCH,
            "event_timer_ms = 100",
            "event_timer_ms = 1",
            "io[0].event_timer_ms: is 1, must be between 2 and 65535 (ms; the servo period",
        ),
        (
            TOUCH,
            "emulated_edges_s = [15.0, 25.0]",
            "emulated_edges_s = [15.0, 15.0]",
            "io[0].input[1].emulated_edges_s[1]: is not later than the edge before",
        ),
        (
            TOUCH,
            "emulated_edges_s = [15.0, 25.0]",
            "emulated_edges_s = [-1.0]",
            "io[0].input[1].emulated_edges_s[0]: is -1, must be between 0 and",
        ),
        (TOUCH, "error_state = \"keep\"", "error_state = \"low\"", "io[0].output[0].error_state: is \"low\", must be"),
        (
            TOUCH,
            "0x1015, value",
            "0x6202, value",
            "io[0].parameter[0].index: 0x6202:00 belongs to the driver: the cell's",
        ),
        (
            TOUCH,
            "0x1015, value",
            "0x1016, value",
            "io[0].parameter[0].index: 0x1016:00 (number of heartbeat consumers) belongs",
        ),
        (TOUCH, "value = 100, bytes = 2", "value = 300, bytes = 1", "io[0].parameter[0].value: is 0x12c, more than 1"),
        (TOUCH, "vendor = 0\n", "vendor = 0\nvalve = 1\n", "io[0].valve: is an unknown key"),
    ];
    for (text, good, bad, expected) in cases {
        assert!(text.contains(good), "no {good:?}");
        let shown = Cell::parse(&text.replacen(good, bad, 1)).expect_err(bad).to_string();
        assert!(shown.contains(expected), "{bad}: {shown}");
        let line = line_of(text, good) + usize::from(bad.contains("valve"));
        assert!(shown.starts_with(&format!("{line}: ")), "{bad}: {shown}");
    }
    let bus =
        |name: &str| TOUCH.replacen("name = \"tool\"\nbus = \"arm\"", &format!("name = \"tool\"\nbus = {name:?}"), 1);
    let shown = Cell::parse(&bus("leg")).unwrap_err().to_string();
    assert!(shown.ends_with("io[0].bus: no bus is called \"leg\""), "{shown}");
    let lines = SERIAL.replacen("[[robot]]\n", SECOND, 1);
    let shown = Cell::parse(&lines).unwrap_err().to_string();
    let expected = "io[0].bus: \"arm\" is a bundle of serial lines: an I/O node is on a CAN bus";
    assert!(shown.ends_with(expected), "{shown}");
    let without = SECOND.replacen("[[io.input]]\nname = \"stop\"\nline = 7\n\n", "", 1);
    let shown = Cell::parse(&TOUCH.replacen("[[robot]]\n", &without, 1)).unwrap_err().to_string();
    assert!(shown.ends_with("io[1]: has no input and no output, must have one line at the least"), "{shown}");
}
