//! Output files of `mrroc jitter --out`, read by an independent implementation of HdrHistogram.

use std::fs;
use std::io::Write;
use std::process::{Command, Stdio};

use kit::mrroc::{Directory, mrroc, root};
use kit::processors;

use super::{PATIENCE, python};

#[test]
fn histograms_of_a_measurement_read_as_the_report_says() {
    let Some(python) = python("histograms_of_a_measurement_read_as_the_report_says") else {
        return;
    };
    let _share = processors::take(0.5);
    let scratch = Directory::new();
    let directory = scratch.path("histograms");
    let words = ["jitter", "--duration=3s", "--against=plain", "--json", "--out"];
    let words = words.map(AsRef::as_ref).into_iter().chain([directory.as_os_str()]);
    let run = mrroc(words);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let mut judge = Command::new("timeout")
        .args(["--signal=KILL", PATIENCE])
        .arg(python)
        .arg("-B")
        .arg(root().join("tests/peers/latency.py"))
        .arg(&directory)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("timeout runs");
    let mut report = judge.stdin.take().expect("it is piped");
    report.write_all(run.stdout.as_bytes()).unwrap();
    drop(report);
    let judged = judge.wait_with_output().unwrap();
    let complained = String::from_utf8_lossy(&judged.stderr);
    assert!(judged.status.success(), "{complained}\n{run:?}");
    let chart = fs::read_to_string(directory.join("jitter.svg")).unwrap();
    for said in ["mrroc, ", "plain probe, ", "late by, µs", "percentile of cycles, %", "</svg>"] {
        assert!(chart.contains(said), "{said:?} is not in the chart");
    }
}
