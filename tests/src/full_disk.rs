//! A trace on a full disk or beyond the limit of file size, which does not stop the arm.

use std::fs;
use std::process::Command;

use serde_json::Value;

use crate::mrroc::{Directory, binary, mrroc, shorten};

/// Runs the IRb-6 with a trace on a full disk. Asserts that the arm completes its program, and that the loss is
/// reported.
pub fn does_not_stop_the_arm(bench: &str) {
    let directory = Directory::new();
    let cell = directory.cell("irb6", shorten);
    let words = ["--bench", bench, "--json", "--trace=/dev/full"].map(AsRef::as_ref);
    let run = mrroc(["run".as_ref(), cell.as_os_str()].into_iter().chain(words));
    assert_eq!(run.status.code(), Some(1), "{run:?}");
    let said = "mrroc: --trace: /dev/full: No space left on device (os error 28): the file ends here, and the run \
                goes on: free space on the disk, or name a file on another disk, and repeat the run\n";
    assert_eq!(run.stderr, said);
    let report = run.json();
    assert_eq!(report["outcome"], "completed", "{report}");
    assert_eq!(report["faults"], Value::Array(Vec::new()), "{report}");
    let files = report["incomplete_files"].as_array().unwrap();
    assert_eq!(files.len(), 1, "{report}");
    assert_eq!((&files[0]["path"], &files[0]["entries"]), (&"/dev/full".into(), &"frames".into()), "{report}");
    assert!(files[0]["lost"].as_f64() > Some(1000.0), "{report}");
}

/// As [`does_not_stop_the_arm`], with a trace that reaches the limit of file size in the middle.
pub fn limit_of_file_size_does_not_stop_the_arm() {
    let directory = Directory::new();
    let cell = directory.cell("irb6", shorten);
    let trace = directory.path("trace.log");
    // In blocks of 512 bytes.
    let limited = Command::new("sh")
        .args(["-c", "ulimit -f 64; exec \"$@\"", "sh"])
        .arg(binary())
        .args(["run", "--bench=lockstep", "--json", "--trace"])
        .args([&trace, &cell])
        .output();
    let run = limited.expect("a shell");
    let (said, report) = (String::from_utf8_lossy(&run.stderr), String::from_utf8_lossy(&run.stdout));
    assert_eq!(run.status.code(), Some(1), "{said}");
    assert!(said.contains("File too large (os error 27): the file ends here, and the run goes on"), "{said}");
    let report: Value = serde_json::from_str(&report).expect("a report");
    assert_eq!(report["outcome"], "completed", "{report}");
    let written = fs::read_to_string(&trace).expect("the trace");
    assert!((64 * 256..=64 * 512).contains(&written.len()), "{} bytes", written.len());
    assert!(written.ends_with('\n'), "no half line");
}
