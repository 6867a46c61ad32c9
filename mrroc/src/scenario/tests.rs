//! Refusals of scenario files.

use std::path::Path;

use super::*;
use crate::bench::emulation::Emulation;

fn lab() -> CellFile {
    CellFile::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/lab.toml")).unwrap()
}

/// The refusal of a scenario with this fault on the laboratory.
fn refusal(fault: &str) -> String {
    let file = lab();
    let (mut emulation, _ends) = Emulation::of(&file);
    let text = format!("seed = 1\n[[fault]]\n{fault}");
    let refused = Scenario::parse(Path::new("s.toml"), &text).and_then(|scenario| emulation.play(&scenario, &file));
    refused.map_or_else(|error| error.to_string(), |_| "accepted".to_owned())
}

#[test]
fn a_wrong_scenario_is_refused_with_file_line_key_and_name() {
    let cases = [
        ("at = 1.0\nkind = \"lost\"\naxis = \"rnt/leg-1\"", "accepted"),
        ("at = 1.0\nkind = \"lost\"\naxis = \"rnt.leg-1\"", "accepted"),
        ("at = 1.0\nkind = \"lost\"\nbus = \"rnt\"\nnode = 1\ncount = 3", "accepted"),
        ("when = \"cruising\"\nkind = \"torn\"\naxis = \"irb6/column\"\nduration = 0.1", "accepted"),
        (
            "kind = \"lost\"\nbus = \"rnt\"",
            "s.toml:2: fault[0].at: is missing: at, cycle or when gives the beginning of the fault",
        ),
        ("at = 1.0\ncycle = 2\nkind = \"lost\"\nbus = \"rnt\"", "s.toml:4: fault[0].cycle: stands alone"),
        ("when = \"idle\"\ncycle = 2\nkind = \"lost\"\nbus = \"rnt\"", "s.toml:4: fault[0].cycle: stands alone"),
        ("at = 1.0\nwhen = \"idle\"\nkind = \"lost\"\nbus = \"rnt\"", "accepted"),
        (
            "at = 1.0\nkind = \"node-reset\"\nbus = \"rnt\"\nnode = 77",
            "s.toml:6: fault[0].node: no drive on bus rnt has node 77; there are 1, 2, 3",
        ),
        (
            "at = 1.0\nkind = \"node-reset\"\nbus = \"rnt\"",
            "s.toml:4: fault[0].kind: is a fault of a drive: name the axis or the node of a drive",
        ),
        ("at = -1.0\nkind = \"lost\"\nbus = \"rnt\"", "s.toml:3: fault[0].at: must be 0 to 1000000 s"),
        ("at = 1.0\nkind = \"lots\"\nbus = \"rnt\"", "s.toml:4: fault[0].kind: "),
        (
            "at = 1.0\nkind = \"lost\"\nbus = \"rnd\"",
            "s.toml:5: fault[0].bus: no bus is called \"rnd\"; there are track-base, ",
        ),
        (
            "at = 1.0\nkind = \"lost\"\naxis = \"rnt/arm\"",
            "s.toml:5: fault[0].axis: no axis is called \"rnt/arm\"; there are ",
        ),
        ("at = 1.0\nkind = \"lost\"", "s.toml:4: fault[0].kind: has no place: name an axis or a bus"),
        ("at = 1.0\nkind = \"lost\"\nbus = \"rnt\"\nframe = 0x800", "s.toml:6: fault[0].frame: is a COB-ID of 11 bits"),
        ("at = 1.0\nkind = \"torn\"\nbus = \"rnt\"", "s.toml:4: fault[0].kind: is a fault of a serial line, "),
        ("at = 1.0\nkind = \"bus-off\"\naxis = \"irb6/column\"", "s.toml:4: fault[0].kind: is a fault of a CAN bus, "),
        (
            "at = 1.0\nkind = \"blocked\"\nbus = \"rnt\"",
            "s.toml:4: fault[0].kind: is a fault of an axis: name the axis",
        ),
        (
            "at = 1.0\nkind = \"lost\"\nbus = \"rnt\"\nprobability = 2",
            "s.toml:6: fault[0].probability: must be above 0, at most 1",
        ),
        ("at = 1.0\nkind = \"lost\"\nbus = \"rnt\"\nfor = 2", "s.toml:6: fault[0].for: "),
    ];
    for (fault, expected) in cases {
        let refused = refusal(fault);
        assert!(refused.starts_with(expected), "{fault}\n{refused}\n{expected}");
    }
}

#[test]
fn values_without_effect_are_refused() {
    let cases = [
        ("lost", "rnt/leg-1", "count = 0", "must be at least 1"),
        ("lost", "rnt/leg-1", "probability = 0.0", "must be above 0"),
        ("lost", "rnt/leg-1", "duration = 0.0", "must be above 0"),
        ("late", "rnt/leg-1", "late_ms = 0.0", "must be above 0"),
        ("encoder-jump", "rnt/leg-1", "increments = 0", "must not be 0"),
        ("sagging-supply", "rnt/leg-1", "share = 1.0", "must be 0 to less than 1"),
        ("collision", "rnt/leg-1", "stiffness = 0.0", "must be above 0"),
        ("encoder-frozen", "rnt/leg-1", "late_ms = 3.0", "is no parameter of encoder-frozen"),
        ("encoder-frozen", "rnt/leg-1", "count = 3", "is no parameter of encoder-frozen"),
        ("blocked", "rnt/leg-1", "probability = 0.5", "is no parameter of blocked"),
        ("bus-off", "rnt/leg-1", "seed = 3", "is no parameter of bus-off"),
        ("heartbeat-silent", "rnt/leg-1", "frame = 0x701", "is no parameter of heartbeat-silent"),
        ("node-reset", "rnt/leg-1", "duration = 1.0", "is no parameter of node-reset"),
        ("late", "irb6/column", "probability = 0.5", "is no parameter of late on a serial line"),
        ("lost", "irb6/column", "frame = 0x181", "is no parameter of lost on a serial line"),
    ];
    for (kind, axis, line, problem) in cases {
        let key = line.split(' ').next().unwrap();
        let refused = refusal(&format!("at = 1.0\nkind = \"{kind}\"\naxis = \"{axis}\"\n{line}"));
        let expected = format!("s.toml:6: fault[0].{key}: {problem}");
        assert!(refused.starts_with(&expected), "{refused}\n{expected}");
    }
    let refused = refusal("at = 1.0\nkind = \"bus-off\"\nbus = \"rnt\"\nnode = 1");
    assert!(refused.starts_with("s.toml:6: fault[0].node: is no parameter of bus-off"), "{refused}");
    for text in ["", "seed = 3\n"] {
        let error = Scenario::parse(Path::new("s.toml"), text).expect_err("it has no fault").to_string();
        assert_eq!(error, "s.toml:1: fault: is missing: a scenario has at least one fault");
    }
}

#[test]
fn a_fault_in_one_line_begins_at_once_and_ends() {
    let file = lab();
    let (mut emulation, _ends) = Emulation::of(&file);
    let ids = emulation.ids().clone();
    for (line, refused) in [
        ("lost axis=rnt/arm", "\"lost axis=rnt/arm\": axis: no axis is called"),
        ("lots axis=rnt/leg-1", "\"lots axis=rnt/leg-1\": kind: is \"lots\", must be \"lost\""),
        ("lost rnt", "\"lost rnt\": \"rnt\" is not KEY=VALUE"),
        ("lost axis=rnt/leg-1 at=3", "\"lost axis=rnt/leg-1 at=3\": at: a live fault begins at once and takes no at"),
        ("lost axis=rnt/leg-1 when=idle", "\"lost axis=rnt/leg-1 when=idle\": when: a live fault begins at once"),
        ("lost axis=rnt/leg-1 count=1 count=2", "\"lost axis=rnt/leg-1 count=1 count=2\": count: is given twice"),
        ("", "the kind of the fault is missing"),
    ] {
        let mut run = ScenarioRun::empty(&file);
        let error = Scenario::of_line(line).and_then(|it| run.add(&it, &file, &ids)).unwrap_err();
        assert!(error.to_string().starts_with(refused), "{line}: {error}");
    }
    let drive = ids.drives[&(0, 0)];
    let closed = |emulation: &Emulation| emulation.plant(drive).unwrap().feedback().positive_limit;
    let scenario = Scenario::of_line("limit-switch-closed axis=irb6/column duration=0.01").unwrap();
    emulation.play(&scenario, &file).unwrap();
    let states = [1, 9, 11].map(|milliseconds| {
        emulation.advance(can::Instant::ZERO + Duration::from_millis(milliseconds));
        closed(&emulation)
    });
    assert_eq!(states, [true, true, false]);
}

#[test]
fn the_kinds_have_unique_names_that_are_those_of_the_files() {
    let names: std::collections::BTreeSet<_> = FaultKind::ALL.iter().map(|kind| kind.name()).collect();
    assert_eq!(names.len(), FaultKind::ALL.len());
    assert!(names.contains("no-acknowledge"));
}

/// The labels of the faults of a scenario on the laboratory that have not acted within 3 s.
fn idle(faults: &str) -> Vec<String> {
    let file = lab();
    let (mut emulation, _ends) = Emulation::of(&file);
    let scenario = Scenario::parse(Path::new("s.toml"), faults).unwrap();
    let played = emulation.play(&scenario, &file).unwrap();
    emulation.advance(can::Instant::ZERO + Duration::from_secs(3));
    played.idle()
}

#[test]
fn faults_that_have_not_acted_are_named() {
    let fault = |beginning: &str, rest: &str| format!("[[fault]]\n{beginning}\n{rest}\n");
    let lost = "kind = \"lost\"\nbus = \"rnt\"";
    let faults = [
        fault("at = 5000.0", lost),
        // The boot-up messages of the nodes.
        fault("at = 0.0", "kind = \"lost\"\nbus = \"rnt\"\nduration = 2.0"),
        fault("at = 0.0", &format!("{lost}\nframe = 0x7FF")),
        fault("cycle = 1000000", lost),
        fault("when = \"cruising\"", lost),
        fault("at = 3.5\nwhen = \"idle\"", lost),
        fault("at = 0.01", "kind = \"blocked\"\naxis = \"rnt/leg-1\""),
        fault("at = 0.01", "kind = \"torn\"\naxis = \"irb6/column\""),
    ];
    let expected = [
        "scenario: fault[0] (lost, at 5000 s) has not acted",
        "scenario: fault[2] (lost, at 0 s) has not acted",
        "scenario: fault[3] (lost, at cycle 1000000) has not acted",
        "scenario: fault[4] (lost, when cruising) has not acted",
        "scenario: fault[5] (lost, when idle from 3.5 s on) has not acted",
        "scenario: fault[7] (torn, at 0.01 s) has not acted",
    ];
    assert_eq!(idle(&faults.concat()), expected);
}

#[test]
fn an_event_with_a_time_selects_the_first_occurrence_from_this_time_on() {
    let file = lab();
    let (mut emulation, _ends) = Emulation::of(&file);
    let drive = emulation.ids().drives[&(0, 0)];
    let text = "[[fault]]\nat = 0.3\nwhen = \"idle\"\nkind = \"limit-switch-closed\"\naxis = \"irb6/column\"";
    let scenario = Scenario::parse(Path::new("s.toml"), text).unwrap();
    emulation.play(&scenario, &file).unwrap();
    // Without the time, the fault begins after 100 ms at rest.
    let states = [150, 290, 310].map(|milliseconds| {
        emulation.advance(can::Instant::ZERO + Duration::from_millis(milliseconds));
        emulation.plant(drive).unwrap().feedback().positive_limit
    });
    assert_eq!(states, [false, false, true]);
}

#[cfg(feature = "schema")]
#[test]
fn the_descriptions_of_the_schema_have_the_defaults() {
    let usual = FaultNumbers::default();
    let schema = serde_json::to_value(Scenario::schema()).unwrap();
    let defaults = [
        ("late_ms", serde_json::json!(usual.late.as_secs_f64() * 1e3), "; 5 where absent"),
        ("increments", serde_json::json!(usual.increments), "; 20000 where absent"),
        ("share", serde_json::json!(usual.share), "; 0.05 where absent"),
        ("distance", serde_json::json!(usual.distance), "; 1 where absent"),
        ("stiffness", serde_json::json!(usual.stiffness), "; 20 where absent"),
        ("code", serde_json::json!(usual.code), "; 0x3210 where absent"),
        ("probability", serde_json::json!(usual.probability), "; 1 where absent"),
    ];
    for (key, value, words) in defaults {
        let property = &schema["$defs"]["FaultText"]["properties"][key];
        let number = words.trim_start_matches("; ").trim_end_matches(" where absent");
        let number = number
            .strip_prefix("0x")
            .map_or_else(|| number.parse().ok(), |hex| u16::from_str_radix(hex, 16).ok().map(f64::from));
        assert_eq!((property["default"].as_f64(), number), (value.as_f64(), value.as_f64()), "{key}");
        assert!(property["description"].as_str().unwrap().contains(words), "{key}: {property}");
    }
}
