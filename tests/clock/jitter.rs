//! `mrroc jitter`: its output for scripts. The tests do not judge the quality of the host.

use std::process::{Command, Stdio};
use std::time::Duration;

use can::clock;
use kit::bench::on_vcan;
use kit::mrroc::{Directory, Running, binary, example, mrroc};
use kit::processors;
use kit::refusals::refused;
use kit::{PERIOD, by_the_clock};
use serde_json::Value;

use crate::doctor::Attached;
use crate::slcan::Adapters;
use crate::socketcan::sh;
use crate::vcan::started;

/// Interval between two looks at a process.
const LOOK: Duration = Duration::from_millis(2);

const KEYS: [&str; 4] = ["p50", "p99", "p999", "max"];

fn measured(arguments: &[&str]) -> Value {
    let words = ["jitter", "--period", "2ms", "--duration", "300ms", "--json"];
    let run = mrroc(words.iter().chain(arguments));
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    run.json()
}

#[test]
fn a_measurement_ends_with_one_object_that_compares_both_sides() {
    by_the_clock(0.6, PERIOD, || {
        let report = measured(&["--against", "plain", "--load", "cpu,memory,fork,io"]);
        for side in ["ours", "peer"] {
            let cycles = report[side]["cycles"].as_u64().unwrap();
            assert!((1..=150).contains(&cycles), "{report}");
            let values = KEYS.map(|key| report[side][key].as_f64().unwrap());
            assert!(values.is_sorted() && values[3] > 0.0, "{report}");
        }
        for key in KEYS {
            let [ours, peer] = ["ours", "peer"].map(|side| report[side][key].as_f64().unwrap());
            let ratio = report["ratio"][key].as_f64().unwrap();
            assert!((ratio * peer - ours).abs() < 1e-6 * peer, "{report}");
        }
        assert!(report["ours"]["spin_percent"].as_f64().unwrap() > 0.0, "{report}");
        assert!(report["causes"]["preempted"].is_u64(), "{report}");
        assert!(report["verdict"].as_str().unwrap().contains("2000 µs"), "{report}");
        for key in KEYS {
            let part = |whose: &str| report["tail"][whose][key].as_f64().unwrap();
            let ours = report["ours"][key].as_f64().unwrap();
            assert!((part("host") + part("own") - ours).abs() < 1e-6, "{report}");
        }
        assert_eq!(report["ended_early"], false, "{report}");
    });
}

#[test]
fn cyclictest_is_run_for_as_long_and_read_whole() {
    let _share = processors::take(0.3);
    let report = measured(&["--against", "cyclictest"]);
    assert_eq!(report["against"], "cyclictest");
    let [ours, peer] = ["ours", "peer"].map(|side| report[side]["cycles"].as_u64().unwrap());
    assert!((1..=150).contains(&ours) && peer == 150, "{report}");
    let worst = report["peer"]["max"].as_f64().unwrap();
    let ratio = report["ratio"]["max"].as_f64().unwrap();
    assert!(worst >= 1.0 && ratio * worst - report["ours"]["max"].as_f64().unwrap() < 1e-6 * worst);
    assert!(report["stolen_ms"].is_u64(), "{report}");
}

#[test]
fn numbers_are_in_microseconds() {
    let _share = processors::take(0.3);
    let report = measured(&["--against", "plain", "--wait", "plain"]);
    let [ours, peer] = ["ours", "peer"].map(|side| report[side]["p50"].as_f64().unwrap());
    for median in [ours, peer] {
        assert!((0.5..20_000.0).contains(&median), "{report}");
    }
    assert_eq!(report["period_us"], 2000.0, "{report}");
}

#[test]
fn the_cycle_of_a_cell_is_measured_with_its_drives_on() {
    by_the_clock(0.5, PERIOD, || {
        let cell = example("irb6");
        let words = ["jitter", "--duration=2s", "--against=plain", "--load=bus", "--json", "--cell"];
        let words = words.map(AsRef::as_ref).into_iter().chain([cell.as_os_str()]);
        let run = mrroc(words);
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        let report = run.json();
        assert_eq!(report["period_us"], 2000.0, "{report}");
        assert_eq!(report["cell"]["state"], "power on, holding position, not homed", "{report}");
        let nodes = report["cell"]["wire"][0]["nodes"].as_array().unwrap();
        for (node, answer) in nodes.iter().zip([123.0, 245.0, 365.0, 487.0, 609.0]) {
            let median = node["sync_to_tpdo_us"]["p50"].as_f64().unwrap();
            assert!((median - answer).abs() < 3.0, "{node}");
        }
        assert_eq!(nodes.len(), 5);
        for (part, least) in [("step_us", 0.5), ("bus_us", 300.0), ("wake_us", 0.0)] {
            let values = KEYS.map(|key| report["cell"][part][key].as_f64().unwrap());
            assert!(values.is_sorted() && values[0] > least && values[0] < 2000.0, "{report}");
        }
        let late = report["causes"].as_object().unwrap().values();
        let late: u64 = late.map(|count| count.as_u64().unwrap()).sum();
        let worst = report["worst"].as_array().unwrap().len() as u64;
        assert_eq!(worst, late.min(8), "{report}");
        let max = report["ours"]["max"].as_f64().unwrap();
        assert!(late > 0 || max <= 2000.0 / 100.0 * 1.001, "{report}");
        for side in ["ours", "peer"] {
            let cycles = report[side]["cycles"].as_u64().unwrap();
            assert!((500..=1100).contains(&cycles), "{report}");
        }
    });
}

#[test]
fn a_cell_is_measured_on_a_virtual_interface_and_never_on_a_card() {
    on_vcan("jitter::a_cell_is_measured_on_a_virtual_interface_and_never_on_a_card", |interface| {
        let directory = Directory::new();
        let cell = directory.cell("irb6", |cell| {
            cell.period_us = 10_000;
            cell.max_missed_in_row = 300;
            cell.bus[0].tolerated_missing = 50;
            cell.bus[0].heartbeat_ms = 1000;
            cell.bus[0].boot_timeout_ms = 10_000;
        });
        let cell = cell.to_str().unwrap();
        let jitter = |can: &str, more: &[&str]| {
            let words = ["jitter", "--cell", cell, "--bench", "vcan", "--can", can];
            mrroc(words.iter().chain(more))
        };
        let loaded = jitter(interface, &["--load", "bus"]);
        refused(&loaded, &["--load bus", "cangen"]);
        let adapters = Adapters::with(1, &[]);
        let _card = Attached::card(&adapters, "jitter0");
        sh("ip link set jitter0 type can bitrate 1000000 && ip link set jitter0 up");
        refused(&jitter("jitter0", &[]), &["--can jitter0: a card"]);
        sh("ip link set jitter0 down");

        let emulators = started(|| Running::start(["emulate", cell, "--can", interface]));
        let run = jitter(interface, &["--duration", "2s", "--json"]);
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        assert_eq!(run.json()["cell"]["bench"], "vcan", "{run:?}");
        emulators.signal("INT");
        assert_eq!(emulators.output().status.code(), Some(0));
    });
}

#[test]
fn an_interrupt_ends_it_early_with_what_was_measured() {
    let _share = processors::take(0.3);
    let scratch = Directory::new();
    let directory = scratch.path("out");
    let words = ["jitter", "--duration=1h", "--json", "--against=plain", "--load=fork", "--out"];
    let words = words.map(AsRef::as_ref).into_iter().chain([directory.as_os_str()]);
    let run = Running::start(words);
    let intervals = |text: &str| text.lines().filter(|line| !line.starts_with('#')).count();
    run.wait_for(&directory.join("ours.hlog"), |text| intervals(text) >= 2);
    run.signal("INT");
    let run = run.output();
    assert_eq!(run.status.code(), Some(1), "{run:?}");
    let report = run.json();
    assert_eq!(report["ended_early"], true, "{report}");
    assert!(report["ours"]["cycles"].as_u64().unwrap() > 1000, "{report}");
    let written = std::fs::read_to_string(directory.join("ours.hgrm")).unwrap();
    assert!(written.contains(&report["ours"]["cycles"].to_string()), "{written}");
}

/// A quarter of a million cycles at the highest allowed rate: the memory does not grow with the number of cycles.
#[test]
fn a_long_measurement_keeps_no_more_than_a_short_one() {
    let _share = processors::take(0.4);
    let resident = |duration: &str| {
        let scratch = Directory::new();
        let directory = scratch.path("out");
        let options = ["jitter", "--period=50us", "--wait=plain", "--against=plain", "--out"];
        let mut child = Command::new(binary());
        child.args(options).arg(&directory).args(["--duration", duration]);
        let mut child = child.stdout(Stdio::null()).spawn().unwrap();
        let status = format!("/proc/{}/status", child.id());
        let mut most = 0;
        while child.try_wait().unwrap().is_none() {
            let status = std::fs::read_to_string(&status).unwrap_or_default();
            let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
            let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse().ok());
            most = most.max(kilobytes.unwrap_or(0u64));
            clock::sleep_until(clock::now() + LOOK);
        }
        assert!(most > 0, "{status} was never read");
        most
    };
    let (short, long) = (resident("1s"), resident("6s"));
    // 100 000 more numbers of 8 bytes on one side would need 780 kB.
    assert!(long < short + 500, "{short} kB, then {long} kB");
}

#[test]
fn alone_and_by_sleep_it_has_no_peer_and_does_not_spin() {
    let _share = processors::take(0.2);
    let report = measured(&["--wait", "plain"]);
    assert!(report["peer"].is_null() && report["ratio"].is_null(), "{report}");
    assert_eq!(report["ours"]["spin_percent"], 0.0, "{report}");
}

/// A substitute for hackbench that never ends by itself. The test finds its process by the process ID.
#[test]
fn programs_of_a_load_end_with_the_command_however_that_ends() {
    let _share = processors::take(0.25);
    for killed in [false, true] {
        let scratch = Directory::new();
        let script = scratch
            .write("hackbench", "#!/bin/sh\n[ \"$1\" = --help ] && exit\necho $$ > \"$0.pid\"\nexec sleep 600\n");
        let executable = Command::new("chmod").arg("+x").arg(&script).status();
        assert!(executable.unwrap().success());
        let directory = script.parent().unwrap().display();
        let path = format!("{directory}:{}", std::env::var("PATH").unwrap());
        let mut command = Command::new(binary());
        command.args(["jitter", "--load=hackbench", "--json", "--duration"]);
        command.arg(if killed { "1h" } else { "1s" }).env("PATH", path);
        let mut command = command.stdout(Stdio::null()).spawn().unwrap();
        let pid = patiently(|| {
            let pid = std::fs::read_to_string(scratch.path("hackbench.pid")).ok()?;
            pid.trim().parse::<u32>().ok()
        });
        assert!(std::path::Path::new(&format!("/proc/{pid}")).exists());
        if killed {
            command.kill().unwrap();
        }
        command.wait().unwrap();
        patiently(|| {
            let stat = std::fs::read_to_string(format!("/proc/{pid}/stat"));
            // The process that inherits the child may not have waited for it yet.
            stat.is_ok_and(|stat| !stat.contains(") Z ")).then_some(()).xor(Some(()))
        });
    }
}

/// Calls `found` for some seconds until it returns a value.
fn patiently<T>(found: impl Fn() -> Option<T>) -> T {
    for _ in 0..1000 {
        if let Some(found) = found() {
            return found;
        }
        clock::sleep_until(clock::now() + 5 * LOOK);
    }
    panic!("it did not happen in time");
}
