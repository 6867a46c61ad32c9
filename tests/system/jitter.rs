//! `mrroc jitter`: what it tells scripts, and what it refuses. How good the host is, is not judged.

use serde_json::Value;

use crate::cli_refusals::refused;
use crate::mrroc::mrroc;

const KEYS: [&str; 4] = ["p50", "p99", "p999", "max"];

fn measured(arguments: &[&str]) -> Value {
    let words = ["jitter", "--period", "2ms", "--duration", "300ms", "--json"];
    let run = mrroc(words.iter().chain(arguments));
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    run.json()
}

#[test]
fn a_measurement_ends_with_one_object_that_compares_both_sides() {
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
    assert!(
        report["ours"]["spin_percent"].as_f64().unwrap() > 0.0,
        "{report}"
    );
    assert!(report["causes"]["preempted"].is_u64(), "{report}");
    assert!(
        report["verdict"].as_str().unwrap().contains("2000 µs"),
        "{report}"
    );
}

#[test]
fn alone_and_by_sleep_it_has_no_peer_and_does_not_spin() {
    let report = measured(&["--wait", "plain"]);
    assert!(
        report["peer"].is_null() && report["ratio"].is_null(),
        "{report}"
    );
    assert_eq!(report["ours"]["spin_percent"], 0.0, "{report}");
}

#[test]
fn what_cannot_be_measured_is_refused() {
    for (arguments, needles) in [
        (["--period", "0ms"], ["--period", "50us and 1s"]),
        (["--period", "2s"], ["--period", "50us and 1s"]),
        (["--period", "fast"], ["--period", "250us"]),
        (["--duration", "0s"], ["--duration", "ten periods"]),
        (["--priority", "0"], ["--priority", "between 1 and 99"]),
        (["--priority", "100"], ["--priority", "between 1 and 99"]),
        (
            ["--cpu", "1023"],
            ["CPU 1023", "/sys/devices/system/cpu/online"],
        ),
    ] {
        refused(&mrroc(["jitter"].iter().chain(&arguments)), &needles);
    }
}
