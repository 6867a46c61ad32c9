//! `mrroc doctor` on this host, and on a kernel with CAN. The command changes settings in test machines only.

use std::fs;
use std::process::{Child, Command, Stdio};

use ::mrroc::cell::Cell;
use can::card;
use can::{OpenError, SocketCanOptions, SocketCanPort};
use serde_json::Value;

use crate::bench::on_vcan;
use crate::mrroc::{self, Directory, Output, mrroc};
use crate::slcan::Adapters;
use crate::socketcan::sh;
use crate::vcan::{Recorder, started};

/// Examines an example cell that `change` has modified. Returns the output as text and as JSON, which have the same
/// exit status.
fn examined(example: &str, change: impl FnOnce(&mut Cell)) -> (Output, Value) {
    let directory = Directory::new();
    let cell = directory.cell(example, change);
    let words = mrroc(["doctor".as_ref(), cell.as_os_str()]);
    let json = mrroc(["doctor".as_ref(), cell.as_os_str(), "--json".as_ref()]);
    assert_eq!(json.stdout.lines().count(), 1, "{json:?}");
    assert_eq!(words.status, json.status, "{words:?} {json:?}");
    let json = json.json();
    check(&words, &json);
    (words, json)
}

/// Checks that apply to every examination.
fn check(words: &Output, json: &Value) {
    let findings = json["findings"].as_array().unwrap();
    let is = |verdict| move |finding: &&Value| finding["verdict"] == verdict;
    let count = |verdict| findings.iter().filter(is(verdict)).count();
    let (verdict, status) = match (count("not-usable"), count("warning")) {
        (0, 0) => ("ok", 0),
        (0, _) => ("warning", 1),
        _ => ("not-usable", 2),
    };
    assert_eq!(json["verdict"], verdict);
    assert_eq!(words.status.code(), Some(status), "{words:?}");
    for finding in findings {
        assert!(finding["why"].as_str().unwrap().len() > 20, "{finding}");
        assert!(!finding["read"].as_str().unwrap().is_empty(), "{finding}");
        let mend = finding["mend"].as_str();
        assert_eq!(mend.is_none(), finding["verdict"] == "ok", "{finding}");
        if let Some(mend) = mend {
            assert!(words.stdout.contains(mend), "{finding} {words:?}");
        }
    }
    for (of, what) in [
        ("kernel", "preemption"),
        ("kernel", "timers"),
        ("kernel", "real-time group scheduling"),
        ("limits", "rtprio"),
        ("limits", "memlock"),
        ("cpu", "governor"),
        ("cpu", "idle states"),
        ("cpu", "CPU latency"),
        ("cpu", "isolated CPUs"),
        ("cpu", "steal time"),
    ] {
        let read = &finding(json, of, what)["read"];
        assert!(read.is_string(), "{of}: {what}: {read}");
    }
}

/// The finding about property `what` of subject `of`.
fn finding<'a>(json: &'a Value, of: &str, what: &str) -> &'a Value {
    let findings = json["findings"].as_array().unwrap().iter();
    let mut found = findings.filter(|found| found["of"] == of && found["what"] == what);
    let first = found.next();
    assert!(found.next().is_none(), "{of}: {what} comes twice in {json}");
    first.unwrap_or_else(|| panic!("{of}: {what} is not in {json}"))
}

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
fn a_virtual_interface_is_found_up_and_down() {
    mrroc::binary();
    on_vcan("doctor::a_virtual_interface_is_found_up_and_down", |interface| {
        let judged = || {
            let (_, json) = examined("irb6", |cell| cell.bus[0].interface = interface.into());
            let of = format!("bus arm, {interface}");
            let found = finding(&json, &of, "up");
            let what = ["interface", "txqueuelen"].map(|what| finding(&json, &of, what)["read"].clone());
            (found["verdict"].clone(), json["verdict"].clone(), what)
        };
        let (up, cell, [kind, queue]) = judged();
        assert_eq!((up, kind), ("ok".into(), "present, vcan without a device".into()));
        assert_ne!(cell, "not-usable");
        assert!(queue.as_str().unwrap().contains("noqueue"), "{queue}");

        sh(&format!("ip link set {interface} down"));
        let (up, cell, _) = judged();
        sh(&format!("ip link set {interface} up"));
        assert_eq!((up, cell), ("not-usable".into(), "not-usable".into()));
    });
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

/// Asserts that the kernel is reported as PREEMPT_RT with verdict ok.
pub(crate) fn preempts(interface: &str) {
    let (_, json) = examined("irb6", |cell| cell.bus[0].interface = interface.into());
    let found = finding(&json, "kernel", "preemption");
    let read = found["read"].as_str().unwrap();
    assert!(found["verdict"] == "ok" && read.contains("PREEMPT_RT"), "{found}");
}

/// Runs `--fix` for an interface on which `knobs`, given as `(of, what)`, are not set, and then `--undo`. Asserts that
/// all settings are restored. `standing` reads the present settings.
pub(crate) fn mended_and_put_back(interface: &str, knobs: &[(&str, &str)], standing: impl Fn() -> String) {
    let directory = Directory::new();
    let state = directory.path("undo.json");
    let cell = directory.cell("irb6", |cell| cell.bus[0].interface = interface.into());
    let doctor = |more: &[&str]| {
        let paths = ["doctor".as_ref(), "--state".as_ref(), state.as_os_str()];
        mrroc(paths.into_iter().chain(more.iter().map(AsRef::as_ref)))
    };
    let cell = cell.to_str().unwrap();
    let mendable = |output: &Output| {
        let json = output.json();
        let fixes = |(of, what): &(&str, &str)| finding(&json, of, what)["fixes"].is_array();
        knobs.iter().copied().filter(fixes).collect::<Vec<_>>()
    };

    let before = standing();
    assert_eq!(mendable(&doctor(&[cell, "--json"])), knobs, "{before}");
    assert_eq!(standing(), before, "looking changes nothing");

    // An interface is not changed while another process receives on it, whether the interface is down or up.
    let mut candump = Command::new("candump");
    candump.args(["-D", interface]);
    candump.stdout(Stdio::null()).stderr(Stdio::null());
    let listener = Recorder(started(|| candump.spawn().unwrap()));
    let refused = doctor(&[cell, "--fix", "--yes"]);
    let why = format!("somebody receives on {interface} and would lose the bus");
    assert!(refused.stderr.contains(&why), "{refused:?}");
    let put_back = doctor(&["--undo"]);
    assert_eq!(put_back.status.code(), Some(0), "{put_back:?}");
    drop(listener);
    assert_eq!(standing(), before, "{refused:?}");

    let fixed = doctor(&[cell, "--json", "--fix", "--yes"]);
    assert_eq!(mendable(&fixed), [], "{fixed:?}");
    for (of, what) in knobs {
        let found = finding(&fixed.json(), of, what).clone();
        assert_eq!(found["verdict"], "ok", "{found} {fixed:?}");
    }
    assert!(fixed.stderr.contains("--undo --state"), "{fixed:?}");
    let mended = standing();
    assert_ne!(mended, before);

    // A value that another process set is kept.
    let queue = format!("/sys/class/net/{interface}/tx_queue_len");
    let set = fs::read_to_string(&queue).unwrap();
    fs::write(&queue, "77").unwrap();
    let undone = doctor(&["--undo"]);
    assert_eq!(undone.status.code(), Some(1), "{undone:?}");
    let left = format!("left {queue}, which was ");
    let since = ": changed by somebody since, to 77";
    assert!(undone.stdout.contains(&left) && undone.stdout.contains(since), "{undone:?}");
    fs::write(&queue, &set).unwrap();
    let undone = doctor(&["--undo"]);
    assert_eq!(undone.status.code(), Some(0), "{undone:?}");
    assert_eq!(standing(), before, "{undone:?}");
    assert!(!state.exists());
}

/// Present settings of the test machine. The settings of the interface come from netlink.
pub(crate) fn standing(interface: &str) -> String {
    let said = |command: &mut Command| {
        let output = command.output().unwrap();
        assert!(output.status.success(), "{command:?}");
        String::from_utf8(output.stdout).unwrap()
    };
    let json = said(Command::new("ip").args(["-d", "-j", "link", "show", "dev", interface]));
    let link: Value = serde_json::from_str(&json).unwrap();
    let (link, data) = (&link[0], &link[0]["linkinfo"]["info_data"]);
    let runtime = fs::read_to_string("/proc/sys/kernel/sched_rt_runtime_us").unwrap();
    format!("{} {} {} {} {}", link["flags"], link["txqlen"], data["bittiming"], data["restart_ms"], runtime)
}

#[test]
fn what_a_virtual_bus_lacks_is_set_and_put_back() {
    mrroc::binary();
    on_vcan("doctor::what_a_virtual_bus_lacks_is_set_and_put_back", |interface| {
        sh(&format!("tc qdisc add dev {interface} root pfifo; ip link set {interface} txqueuelen 3 down"));
        let of = format!("bus arm, {interface}");
        // This kernel schedules groups of real-time threads. Their share of the run time prevents a smaller value.
        let knobs = [(&*of, "up"), (&of, "txqueuelen")];
        mended_and_put_back(interface, &knobs, || standing(interface));
    });
}

/// `slcand` in the foreground, which provides an interface on a tty.
pub(crate) struct Attached(Child);

impl Attached {
    /// Makes the first of `adapters` a card of the kernel, which is down and has no bit rate.
    pub(crate) fn card(adapters: &Adapters, name: &str) -> Self {
        let tty = adapters.interfaces[0].strip_prefix("slcan:").unwrap();
        let slcand = Command::new("slcand").args(["-F", tty, name]).stdout(Stdio::null()).spawn();
        let attached = Self(slcand.unwrap());
        sh(&format!("for i in $(seq 100); do ip link show {name} >/dev/null 2>&1 && exit; sleep 0.05; done; exit 1"));
        attached
    }
}

impl Drop for Attached {
    fn drop(&mut self) {
        // Both calls fail if the process has ended, which does no harm.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn the_bit_rate_of_a_card_is_held_against_the_cells() {
    mrroc::binary();
    on_vcan("doctor::the_bit_rate_of_a_card_is_held_against_the_cells", |_| {
        let adapters = Adapters::with(1, &[]);
        let _attached = Attached::card(&adapters, "doctor0");
        let of = "bus arm, doctor0";
        let judged = |what: &str| {
            let (_, json) = examined("irb6", |cell| cell.bus[0].interface = "doctor0".into());
            let found = finding(&json, of, what);
            (found["verdict"].clone(), found["read"].clone())
        };
        assert_eq!(judged("bit rate"), ("not-usable".into(), "not set, the cell says 1000 kbit/s".into()));
        sh("ip link set doctor0 type can bitrate 500000");
        assert_eq!(judged("bit rate"), ("not-usable".into(), "500 kbit/s, the cell says 1000 kbit/s".into()));
        sh("ip link set doctor0 type can bitrate 1000000 && ip link set doctor0 up");
        assert_eq!(judged("bit rate"), ("ok".into(), "1000 kbit/s, the cell says 1000 kbit/s".into()));
        let (verdict, state) = judged("bus state");
        assert_eq!(verdict, "ok");
        assert!(state.as_str().unwrap().starts_with("ERROR-ACTIVE"), "{state}");
        sh("ip link set doctor0 down");
    });
}

#[test]
fn a_card_that_had_no_bit_rate_is_put_back_down() {
    mrroc::binary();
    on_vcan("doctor::a_card_that_had_no_bit_rate_is_put_back_down", |_| {
        let adapters = Adapters::with(1, &[]);
        let _attached = Attached::card(&adapters, "fresh0");
        let directory = Directory::new();
        let state = directory.path("undo.json");
        let cell = directory.cell("irb6", |cell| cell.bus[0].interface = "fresh0".into());
        let doctor = |more: &[&str]| {
            let paths = ["doctor".as_ref(), "--state".as_ref(), state.as_os_str()];
            mrroc(paths.into_iter().chain(more.iter().map(AsRef::as_ref)))
        };
        let fixed = doctor(&[cell.to_str().unwrap(), "--fix", "--yes"]);
        let card = card::read("fresh0").unwrap();
        assert_eq!((card.up, card.bitrate), (true, Some(1_000_000)), "{fixed:?}");
        // The second case brings the interface up by hand, so that the record contains no change of its state.
        for by_hand in [false, true] {
            if by_hand {
                let text = r#"[{"knob":{"bit-timing":"fresh0"},"before":null,"after":"1000000 0.000"}]"#;
                fs::write(&state, text).unwrap();
                sh("ip link set fresh0 up");
            }
            let undone = doctor(&["--undo"]);
            assert_eq!(undone.status.code(), Some(0), "{undone:?}");
            let said = "put back bit rate of fresh0 = nothing: the card is down, and keeps its bit rate";
            assert!(undone.stdout.contains(said), "{undone:?}");
            assert!(!card::read("fresh0").unwrap().up && !state.exists());
        }
    });
}
