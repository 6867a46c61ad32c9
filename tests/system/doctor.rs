//! `mrroc doctor` on this host: its findings and its refusals.

use std::fs;

use can::{OpenError, SocketCanOptions, SocketCanPort};
use kit::doctor::{check, examined, finding};
use kit::mrroc::{Directory, mrroc};
use serde_json::Value;

#[test]
fn a_cell_on_an_interface_that_is_not_there_cannot_run() {
    let (words, json) = examined("irb6", |cell| cell.bus[0].interface = "nocan9".into());
    let found = finding(&json, "bus arm, nocan9", "interface");
    assert_eq!(found["verdict"], "not-usable");
    let read = found["read"].as_str().unwrap();
    match SocketCanPort::open("nocan9", &SocketCanOptions::default()).err() {
        Some(OpenError::NoCan(_)) => assert_eq!(read, "this kernel has no CAN"),
        _ => assert!(read.starts_with("not there; "), "{read}"),
    }
    assert!(words.stdout.contains("\nnot usable for irb6: 1 in the way"), "{words:?}");
}

#[test]
fn lines_that_are_not_there_are_named_with_their_axes() {
    let (words, json) = examined("irb6-serial", |cell| {
        for axis in &mut cell.robot[0].axis {
            axis.controller.as_mut().unwrap().line = format!("/dev/no-{}", axis.name);
        }
    });
    for axis in ["column", "lower-arm", "upper-arm", "wrist-pitch", "wrist-roll"] {
        let of = format!("axis irb6.{axis}, /dev/no-{axis}");
        let found = finding(&json, &of, "tty");
        assert_eq!(found["verdict"], "not-usable");
        assert!(found["read"].as_str().unwrap().starts_with("not there"), "{found}");
    }
    assert!(words.stdout.contains("\nnot usable for irb6-serial: 5 in the way"), "{words:?}");
}

#[test]
fn the_tty_of_an_slcan_adapter_is_examined_as_a_line() {
    let (_, json) = examined("irb6", |cell| {
        cell.bus[0].interface = "slcan:/dev/no-tty@1000000".into();
    });
    assert_eq!(finding(&json, "bus arm, /dev/no-tty", "tty")["verdict"], "not-usable");
}

#[test]
fn undo_neither_deletes_nor_writes_what_no_fix_sets_and_shows_no_escape_codes() {
    let directory = Directory::new();
    let victim = directory.write("victim\u{1b}[2J", "precious\n");
    let path = serde_json::to_string(&victim).unwrap();
    for before in ["null", "\"evil\"", "\"\u{9b}2J\""] {
        let change = format!(r#"[{{"knob": {{"file": {path}}}, "before": {before}, "after": "precious\n"}}]"#);
        for record in [change.clone(), change.replace("file", "\u{9b}2J")] {
            let state = directory.write("state.json", &record);
            let undone = mrroc(["doctor".as_ref(), "--undo".as_ref(), "--state".as_ref(), state.as_os_str()]);
            assert_eq!(undone.status.code(), Some(2), "{undone:?}");
            assert_eq!(fs::read_to_string(&victim).unwrap(), "precious\n");
            let said = undone.stdout + &undone.stderr;
            let shown = said.chars().filter(|c| *c != '\n').all(|c| !c.is_control());
            assert!(shown, "{said:?}");
            assert!(said.contains("state.json: no record of changes"), "{said}");
            assert!(said.contains(" at line 1 "), "{said}");
        }
    }
    // No directory is created if there is nothing to undo.
    let none = directory.path("none/state.json");
    let undone = mrroc(["doctor".as_ref(), "--undo".as_ref(), "--state".as_ref(), none.as_os_str()]);
    assert_eq!(undone.status.code(), Some(0), "{undone:?}");
    assert!(!directory.path("none").exists());
}

#[test]
fn a_host_is_examined_without_a_cell_and_a_cell_that_is_not_there_is_refused() {
    let (words, json) = (mrroc(["doctor"]), mrroc(["doctor", "--json"]));
    check(&words, &json.json());
    assert_eq!(json.json()["cell"], Value::Null);
    let refused = mrroc(["doctor", "no-such-cell.toml"]);
    assert_eq!(refused.status.code(), Some(2), "{refused:?}");
    assert_eq!(refused.stderr.lines().count(), 1, "{refused:?}");
    assert!(refused.stdout.is_empty(), "{refused:?}");
}

#[test]
fn nothing_is_set_without_an_answer_and_nothing_put_back_without_a_record() {
    let directory = Directory::new();
    let state = directory.path("undo.json");
    let cell = directory.cell("irb6", |_| {});
    let state_of = |more: &[&str]| {
        let state = ["doctor".as_ref(), "--state".as_ref(), state.as_os_str()];
        mrroc(state.into_iter().chain(more.iter().map(AsRef::as_ref)))
    };
    let refused = |more: &[&str], line: &str| {
        let output = state_of(more);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        assert!(output.stdout.is_empty(), "{output:?}");
        assert!(output.stderr.contains(line), "{output:?}");
    };
    // The input is not a terminal.
    refused(&["--fix"], "mrroc: --fix asks on a terminal");
    refused(&["--fix", cell.to_str().unwrap()], "--yes answers for it");
    refused(&["--yes"], "--fix");
    refused(&["--undo", "--fix"], "cannot be used with");
    refused(&["--undo", cell.to_str().unwrap()], "cannot be used with");
    assert!(!state.exists());
    let nothing = state_of(&["--undo"]);
    assert_eq!(nothing.status.code(), Some(0), "{nothing:?}");
    assert!(nothing.stdout.ends_with("undo.json: nothing to put back\n"));
    fs::write(&state, "[{]").unwrap();
    refused(&["--undo"], "undo.json: no record of changes: ");
    refused(&["--fix", "--yes"], "undo.json: no record of changes: ");
    assert_eq!(fs::read_to_string(&state).unwrap(), "[{]");
}

#[test]
fn a_broken_cell_is_refused_in_one_line() {
    let directory = Directory::new();
    for text in ["", "name = 1", "\u{0}", "[[bus]]\nname = \"x\""] {
        let cell = directory.write("cell.toml", text);
        let refused = mrroc(["doctor".as_ref(), cell.as_os_str()]);
        assert_eq!(refused.status.code(), Some(2), "{refused:?}");
        assert!(refused.stdout.is_empty(), "{refused:?}");
        assert_eq!(refused.stderr.trim_end().lines().count(), 1, "{refused:?}");
    }
}
