//! `mrroc doctor`: on this host, and on a kernel that has CAN.

use std::process::{Child, Command, Stdio};

use can::{OpenError, SocketCanOptions, SocketCanPort};
use controller::cell::Cell;
use serde_json::Value;

use crate::bench::on_vcan;
use crate::mrroc::{self, Directory, Output, mrroc};
use crate::slcan::Adapters;
use crate::socketcan::sh;

/// What it says of an example cell that `change` has changed, in words and as JSON; both with the same exit status.
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

/// What holds for every examination.
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
        ("cpu", "isolated CPUs"),
        ("cpu", "steal time"),
    ] {
        let read = &finding(json, of, what)["read"];
        assert!(read.is_string(), "{of}: {what}: {read}");
    }
}

/// The one finding about `what` of `of`.
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
    assert!(
        words.stdout.contains("\nnot usable for irb6: 1 in the way"),
        "{words:?}"
    );
}

#[test]
fn lines_that_are_not_there_are_named_with_their_axes() {
    let (words, json) = examined("irb6-serial", |cell| {
        for axis in &mut cell.robot[0].axis {
            axis.controller.as_mut().unwrap().line = format!("/dev/no-{}", axis.name);
        }
    });
    for axis in [
        "column",
        "lower-arm",
        "upper-arm",
        "wrist-pitch",
        "wrist-roll",
    ] {
        let of = format!("axis irb6.{axis}, /dev/no-{axis}");
        let found = finding(&json, &of, "tty");
        assert_eq!(found["verdict"], "not-usable");
        assert!(
            found["read"].as_str().unwrap().starts_with("not there"),
            "{found}"
        );
    }
    assert!(
        words
            .stdout
            .contains("\nnot usable for irb6-serial: 5 in the way"),
        "{words:?}"
    );
}

#[test]
fn the_tty_of_an_slcan_adapter_is_examined_as_a_line() {
    let (_, json) = examined("irb6", |cell| {
        cell.bus[0].interface = "slcan:/dev/no-tty@1000000".into();
    });
    assert_eq!(
        finding(&json, "bus arm, /dev/no-tty", "tty")["verdict"],
        "not-usable"
    );
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
    on_vcan(
        "doctor::a_virtual_interface_is_found_up_and_down",
        |interface| {
            let judged = || {
                let (_, json) = examined("irb6", |cell| cell.bus[0].interface = interface.into());
                let of = format!("bus arm, {interface}");
                let found = finding(&json, &of, "up");
                let what = ["interface", "txqueuelen"]
                    .map(|what| finding(&json, &of, what)["read"].clone());
                (found["verdict"].clone(), json["verdict"].clone(), what)
            };
            let (up, cell, [kind, queue]) = judged();
            assert_eq!(
                (up, kind),
                ("ok".into(), "present, vcan without a device".into())
            );
            assert_ne!(cell, "not-usable");
            assert!(queue.as_str().unwrap().contains("noqueue"), "{queue}");

            sh(&format!("ip link set {interface} down"));
            let (up, cell, _) = judged();
            sh(&format!("ip link set {interface} up"));
            assert_eq!((up, cell), ("not-usable".into(), "not-usable".into()));
        },
    );
}

/// `slcand` in the foreground, which keeps an interface on a tty.
struct Attached(Child);

impl Drop for Attached {
    fn drop(&mut self) {
        // Both fail if it has ended, which is as well.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn the_bit_rate_of_a_card_is_held_against_the_cells() {
    mrroc::binary();
    on_vcan(
        "doctor::the_bit_rate_of_a_card_is_held_against_the_cells",
        |_| {
            let adapters = Adapters::with(1, &[]);
            let tty = adapters.interfaces[0].strip_prefix("slcan:").unwrap();
            let slcand = Command::new("slcand")
                .args(["-F", tty, "doctor0"])
                .stdout(Stdio::null())
                .spawn();
            let _attached = Attached(slcand.unwrap());
            sh(
                "for i in $(seq 100); do ip link show doctor0 >/dev/null 2>&1 && exit; sleep 0.05; done; exit 1",
            );
            let of = "bus arm, doctor0";
            let judged = |what: &str| {
                let (_, json) = examined("irb6", |cell| cell.bus[0].interface = "doctor0".into());
                let found = finding(&json, of, what);
                (found["verdict"].clone(), found["read"].clone())
            };
            assert_eq!(
                judged("bit rate"),
                (
                    "not-usable".into(),
                    "not set, the cell says 1000 kbit/s".into()
                )
            );
            sh("ip link set doctor0 type can bitrate 500000");
            assert_eq!(
                judged("bit rate"),
                (
                    "not-usable".into(),
                    "500 kbit/s, the cell says 1000 kbit/s".into()
                )
            );
            sh("ip link set doctor0 type can bitrate 1000000 && ip link set doctor0 up");
            assert_eq!(
                judged("bit rate"),
                ("ok".into(), "1000 kbit/s, the cell says 1000 kbit/s".into())
            );
            let (verdict, state) = judged("bus state");
            assert_eq!(verdict, "ok");
            assert!(
                state.as_str().unwrap().starts_with("ERROR-ACTIVE"),
                "{state}"
            );
            sh("ip link set doctor0 down");
        },
    );
}
