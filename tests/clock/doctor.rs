//! `mrroc doctor` on kernels with CAN: its findings, and the settings that it changes and puts back.

use std::fs;
use std::process::{Child, Command, Stdio};

use can::card;
use kit::bench::{Body, bodies_on_vcan};
use kit::doctor::{examined, finding};
use kit::mrroc::{Directory, Output, mrroc};
use serde_json::Value;

use crate::card::a_card_that_was_up_comes_up_again_if_its_bit_rate_cannot_be_set;
use crate::slcan::Adapters;
use crate::socketcan::sh;
use crate::vcan::{Recorder, started};

#[test]
fn doctor_and_the_interfaces_of_a_kernel() {
    let bodies: [Body; 5] = [
        ("a virtual interface is found up and down", a_virtual_interface_is_found_up_and_down),
        ("what a virtual bus lacks is set and put back", what_a_virtual_bus_lacks_is_set_and_put_back),
        ("the bit rate of a card is held against the cell's", the_bit_rate_of_a_card_is_held_against_the_cells),
        ("a card that had no bit rate is put back down", a_card_that_had_no_bit_rate_is_put_back_down),
        (
            "a card that was up comes up again if its bit rate cannot be set",
            a_card_that_was_up_comes_up_again_if_its_bit_rate_cannot_be_set,
        ),
    ];
    bodies_on_vcan("doctor::doctor_and_the_interfaces_of_a_kernel", &bodies, |interface, body| body(interface));
}

fn a_virtual_interface_is_found_up_and_down(interface: &str) {
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

fn what_a_virtual_bus_lacks_is_set_and_put_back(interface: &str) {
    sh(&format!("tc qdisc replace dev {interface} root pfifo; ip link set {interface} txqueuelen 3 down"));
    let of = format!("bus arm, {interface}");
    // This kernel schedules groups of real-time threads. Their share of the run time prevents a smaller value.
    let knobs = [(&*of, "up"), (&of, "txqueuelen")];
    mended_and_put_back(interface, &knobs, || standing(interface));
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

fn the_bit_rate_of_a_card_is_held_against_the_cells(_: &str) {
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
}

fn a_card_that_had_no_bit_rate_is_put_back_down(_: &str) {
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
}
