//! `mrroc check`, `mrroc schema` and the help of every command, as seen by a user.

use std::fs;

use ::mrroc::cell::{Bus, Cell, Robot};
use kit::mrroc::{CELLS, Directory, Output, example, mrroc, root, text};
use serde_json::{Value, json};

#[test]
fn check_accepts_the_example_cells_and_says_what_their_buses_carry() {
    for name in CELLS {
        let cell = example(name);
        let check = mrroc(["check".as_ref(), cell.as_os_str()]);
        assert_eq!(check.status.code(), Some(0), "{check:?}");
        for needle in ["bus arm: load ", "response µs", "SYNC", "set-point", "is ready"] {
            assert!(check.stdout.contains(needle), "{needle}: {check:?}");
        }
        let json = mrroc(["check".as_ref(), cell.as_os_str(), "--json".as_ref()]);
        assert_eq!(json.stdout.lines().count(), 1, "{json:?}");
        let bus = &json.json()["buses"][0];
        assert_eq!(bus["name"], "arm");
        let load = bus["load_percent"].as_f64().unwrap();
        let busy = bus["worst_case_percent"].as_f64().unwrap();
        assert!(load > 50.0 && load < busy && busy < 100.0, "{bus}");
        for message in bus["messages"].as_array().unwrap() {
            let cyclic = message["period_us"] == 2000 && message["what"] != "service request";
            if let Some(response) = message["response_us"].as_u64() {
                assert!(cyclic && response > 0 && response <= 2000, "{message}");
            }
        }
        assert!(bus["messages"].as_array().unwrap().len() > 10, "{bus}");
        assert_eq!(bus["serial"], Value::Null);
    }
}

#[test]
fn check_says_what_a_bundle_speaks_and_which_line_each_axis_has() {
    for (name, bundle, axis) in [
        (
            "irb6-serial",
            "serial bundle arm: nfv2 at 921600 bit/s, load 11.3 % of each line",
            json!({"axis": "wrist-roll", "line": "/dev/ttyMI12", "address": 4}),
        ),
        (
            "irb6-hi-moxa",
            "serial bundle arm: hi-moxa at 921600 bit/s, load 7.2 % of each line",
            json!({"axis": "wrist-roll", "line": "/dev/ttyMI12", "address": null}),
        ),
    ] {
        let cell = example(name);
        let check = mrroc(["check".as_ref(), cell.as_os_str()]);
        assert_eq!(check.status.code(), Some(0), "{check:?}");
        assert!(check.stdout.contains(bundle), "{check:?}");
        let address = axis["address"].as_u64();
        let address = address.map_or(String::new(), |address| format!(", address {address}"));
        let line = format!("\n  axis wrist-roll: /dev/ttyMI12{address}\n");
        assert!(check.stdout.contains(&line), "{check:?}");
        let json = mrroc(["check".as_ref(), cell.as_os_str(), "--json".as_ref()]).json();
        let serial = &json["buses"][0]["serial"];
        assert_eq!(serial["lines"].as_array().unwrap().len(), 5);
        assert_eq!(serial["lines"][4], axis);
        assert_eq!(serial["baud"], 921_600);
        assert!(bundle.contains(serial["protocol"].as_str().unwrap()));
    }
}

#[test]
fn check_says_which_lines_an_io_node_has_and_counts_its_frames() {
    let cell = example("irb6-touch");
    let check = mrroc(["check".as_ref(), cell.as_os_str()]);
    assert_eq!(check.status.code(), Some(0), "{check:?}");
    let node = "\nI/O node tool: node 40 of bus arm; inputs touch, gate; outputs gripper\n";
    assert!(check.stdout.contains(node), "{check:?}");
    let json = mrroc(["check".as_ref(), cell.as_os_str(), "--json".as_ref()]).json();
    assert_eq!(json["io"][0]["inputs"], json!(["touch", "gate"]));
    let without = mrroc(["check".as_ref(), example("irb6").as_os_str(), "--json".as_ref()]).json();
    let load = |json: &Value| json["buses"][0]["load_percent"].as_f64().unwrap();
    // Outputs and inputs of one byte, once per 2 ms each, of at most 65 bits, and a heartbeat in 100 ms.
    let added = load(&json) - load(&without);
    assert!(added > 2.0 * 100.0 * 60e-6 / 2e-3 && added < 2.1 * 100.0 * 65e-6 / 2e-3, "{added} %");
    let messages = json["buses"][0]["messages"].as_array().unwrap();
    let of_node = messages.iter().filter(|message| message["cob_id"].as_u64().is_some_and(|id| id & 0x7F == 40));
    let of_node: Vec<_> = of_node.map(|it| (it["what"].clone(), it["response_us"].is_number())).collect();
    // None of them must have left within its cycle.
    assert_eq!(of_node, [(json!("outputs"), false), (json!("inputs"), false), (json!("heartbeat"), false)]);
}

/// Check of a cell with two IRb-6, on one bus or on a bus each.
fn two_arms(period_us: u32, buses: usize) -> Output {
    let directory = Directory::new();
    let cell = directory.cell("irb6", |cell| {
        cell.period_us = period_us;
        let (robot, bus) = (cell.robot[0].clone(), cell.bus[0].clone());
        let second = if buses == 1 { bus.name.clone() } else { "second".into() };
        let mut axes = robot.axis.clone();
        for axis in &mut axes {
            axis.node += 10;
            axis.bus.clone_from(&second);
        }
        cell.robot.push(Robot { name: "other".into(), axis: axes, ..robot });
        if buses > 1 {
            cell.bus.push(Bus { name: second, interface: "can1".into(), ..bus });
        }
    });
    mrroc(["check".as_ref(), cell.as_os_str()])
}

/// The integer before `words`.
fn number_before(line: &str, words: &str) -> u32 {
    let before = line.split(words).next().filter(|before| before.len() < line.len());
    let number = before.and_then(|before| before.split_whitespace().next_back());
    let number = number.unwrap_or_else(|| panic!("nothing before {words:?} in {line:?}"));
    let number = number.trim_start_matches('(');
    number.parse().unwrap_or_else(|_| panic!("{number:?} is no number: {line:?}"))
}

#[test]
fn ten_axes_at_1_khz_on_one_bus_are_refused_with_what_would_fit() {
    let check = two_arms(1000, 1);
    assert_eq!(check.status.code(), Some(2), "{check:?}");
    assert_eq!((check.stdout.as_str(), check.stderr.lines().count()), ("", 1));
    let line = check.stderr.as_str();
    for needle in ["mrroc: ", "cell.toml:", "bus[0]: ", "10 axes", "\"arm\"", "of each 1000 µs", "at most 100 %"] {
        assert!(line.contains(needle), "{needle}: {line}");
    }
    assert!(number_before(line, " %, at most") > 100, "{line}");
    let axes = number_before(line, " axes would fit");
    assert!((1..7).contains(&axes), "{line}");
    // The period that the command proposes is accepted. A period that is 1 ms shorter is refused.
    let period: String = line.split("a period of ").nth(1).unwrap().chars().take_while(char::is_ascii_digit).collect();
    let period = 1000 * period.parse::<u32>().unwrap();
    let fits = two_arms(period, 1);
    assert_eq!(fits.status.code(), Some(0), "{fits:?}");
    let tight = two_arms(period - 1000, 1);
    assert_eq!(tight.status.code(), Some(2), "{tight:?}");
}

#[test]
fn two_buses_carry_what_one_cannot() {
    assert_eq!(two_arms(2000, 1).status.code(), Some(2));
    let check = two_arms(2000, 2);
    assert_eq!(check.status.code(), Some(0), "{check:?}");
    for bus in ["bus arm: ", "bus second: "] {
        assert!(check.stdout.contains(bus), "{check:?}");
    }
}

#[test]
fn a_run_refuses_the_overloaded_bus_as_well() {
    let directory = Directory::new();
    let cell = directory.cell("irp6", |cell| cell.period_us = 1000);
    let run = mrroc(["run".as_ref(), cell.as_os_str(), "--bench=lockstep".as_ref()]);
    assert_eq!(run.status.code(), Some(2), "{run:?}");
    assert!(run.stderr.contains("axes would fit"), "{run:?}");
}

#[test]
fn the_published_schema_is_the_one_the_command_prints() {
    let printed = mrroc(["schema"]);
    assert_eq!(printed.status.code(), Some(0));
    let published = fs::read_to_string(root().join("cells/cell.schema.json")).unwrap();
    assert!(
        printed.stdout == published,
        "cells/cell.schema.json is not what the command reads: `mrroc schema > cells/cell.schema.json`"
    );
}

#[test]
fn the_published_schema_of_scenarios_is_the_one_the_command_prints() {
    let printed = mrroc(["schema", "--scenario"]);
    assert_eq!(printed.status.code(), Some(0));
    let published = fs::read_to_string(root().join("cells/scenario.schema.json")).unwrap();
    assert!(
        printed.stdout == published,
        "cells/scenario.schema.json is not what the command reads: `mrroc schema --scenario > cells/scenario.schema.json`"
    );
}

#[test]
fn the_published_reference_is_the_one_the_command_prints() {
    let printed = mrroc(["schema", "--reference"]);
    assert_eq!(printed.status.code(), Some(0));
    let published = fs::read_to_string(root().join("book/src/cell-file.md")).unwrap();
    assert!(
        printed.stdout == published,
        "book/src/cell-file.md is not what the command prints: `mrroc schema --reference > book/src/cell-file.md`"
    );
}

/// Keys of `value` that are not in `schema`, and required keys that are missing.
fn strangers(root: &Value, schema: &Value, value: &Value, place: &str) -> Vec<String> {
    let schema = match schema["$ref"].as_str() {
        Some(reference) => root.pointer(&reference[1..]).expect("a reference leads somewhere"),
        None => schema,
    };
    for either in ["anyOf", "oneOf"] {
        if let Some(options) = schema[either].as_array() {
            let found = options.iter().map(|option| strangers(root, option, value, place));
            return found.min_by_key(Vec::len).unwrap_or_default();
        }
    }
    match value {
        Value::Object(table) => {
            let inner = table.iter().flat_map(|(key, value)| {
                let place = format!("{place}.{key}");
                match schema["properties"].get(key) {
                    Some(schema) => strangers(root, schema, value, &place),
                    None if schema["additionalProperties"] == true => Vec::new(),
                    None => vec![place],
                }
            });
            let required = schema["required"].as_array().into_iter().flatten();
            let missing = required
                .filter_map(Value::as_str)
                .filter(|key| !table.contains_key(*key))
                .map(|key| format!("{place}.{key} is missing"));
            inner.chain(missing).collect()
        }
        Value::Array(items) => {
            items.iter().flat_map(|item| strangers(root, &schema["items"], item, &format!("{place}[]"))).collect()
        }
        _ => Vec::new(),
    }
}

#[test]
fn every_key_of_the_example_cells_is_in_the_schema() {
    let schema = mrroc(["schema"]).json();
    for name in CELLS {
        let text = text(name);
        let check = |text: &str| {
            let cell: Value = toml::from_str(text).unwrap();
            strangers(&schema, &schema, &cell, name)
        };
        assert_eq!(check(&text), Vec::<String>::new());
        let wrong = text.replacen("search_velocity", "serch_velocity", 1);
        let place = format!("{name}.robot[].axis[].homing");
        assert_eq!(check(&wrong), [format!("{place}.serch_velocity"), format!("{place}.search_velocity is missing")]);
        let wrong = text.replacen("line = { position", "line = { posture", 1);
        assert!(!check(&wrong).is_empty());
        Cell::parse(&text).unwrap();
    }
}

#[test]
fn every_command_explains_itself() {
    let commands: [&[&str]; 9] =
        [&[], &["check"], &["doctor"], &["run"], &["emulate"], &["eds"], &["vm"], &["vm", "uml"], &["schema"]];
    for command in commands {
        let help = mrroc(command.iter().chain(&["--help"]));
        assert_eq!(help.status.code(), Some(0), "{help:?}");
        assert!(help.stdout.contains("Usage: mrroc"), "{help:?}");
        assert_eq!(help.stderr, "", "{command:?}");
    }
    let run = mrroc(["run", "--help"]).stdout;
    for option in [
        "--bench",
        "--can",
        "--set-bitrate",
        "--json",
        "--trace",
        "--record",
        "--force",
        "lockstep",
        "emulated",
        "vcan",
        "card",
    ] {
        assert!(run.contains(option), "{option}: {run}");
    }
}

#[test]
fn the_version_is_that_of_the_workspace() {
    let version = mrroc(["--version"]);
    assert_eq!(version.status.code(), Some(0));
    assert_eq!(version.stdout, format!("mrroc {}\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn an_unknown_command_or_bench_is_refused_with_the_known_ones() {
    for (arguments, needle) in [(&["fly"][..], "--help"), (&["run", "x.toml", "--bench", "moon"], "lockstep")] {
        let run = mrroc(arguments);
        assert_eq!(run.status.code(), Some(2), "{run:?}");
        assert!(run.stderr.contains(needle), "{run:?}");
        assert_eq!(run.stdout, "");
    }
}
