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
    refused.map_or_else(|error| error.to_string(), |()| "accepted".to_owned())
}

#[test]
fn a_wrong_scenario_is_refused_with_file_line_key_and_name() {
    let cases = [
        ("at = 1.0\nkind = \"lost\"\naxis = \"rnt/leg-1\"", "accepted"),
        ("at = 1.0\nkind = \"lost\"\nbus = \"rnt\"\nnode = 1\ncount = 3", "accepted"),
        ("when = \"cruising\"\nkind = \"torn\"\naxis = \"irb6/column\"\nduration = 0.1", "accepted"),
        (
            "kind = \"lost\"\nbus = \"rnt\"",
            "s.toml:2: fault[0].at: one of at, when and cycle is needed, and 0 are given",
        ),
        ("at = 1.0\ncycle = 2\nkind = \"lost\"\nbus = \"rnt\"", "s.toml:3: fault[0].at: one of at, when and cycle"),
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
        ("at = 1.0\nkind = \"lost\"\nbus = \"rnt\"\nprobability = 2", "s.toml:6: fault[0].probability: must be 0 to 1"),
        ("at = 1.0\nkind = \"lost\"\nbus = \"rnt\"\nfor = 2", "s.toml:6: fault[0].for: "),
    ];
    for (fault, expected) in cases {
        let refused = refusal(fault);
        assert!(refused.starts_with(expected), "{fault}\n{refused}\n{expected}");
    }
}

#[test]
fn a_fault_in_one_line_begins_at_once_and_ends() {
    let file = lab();
    let (mut emulation, _ends) = Emulation::of(&file);
    let ids = emulation.ids().clone();
    for (line, refused) in [
        ("lost axis=rnt/arm", "fault:4: fault[0].axis: no axis is called"),
        ("lots axis=rnt/leg-1", "fault:3: fault[0].kind: is \"lots\", must be \"lost\""),
        ("lost rnt", "\"rnt\" is not KEY=VALUE"),
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
