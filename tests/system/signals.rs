//! Signals that end a run in lockstep while an operation blocks.

use std::fs::File;
use std::process::Command;

use kit::mrroc::{Directory, Running, example};

/// Three requests to end, all different, because two equal signals could merge.
const THREE: [&str; 3] = ["INT", "TERM", "HUP"];

#[test]
fn the_third_request_ends_a_run_in_lockstep_whose_trace_takes_nothing() {
    let directory = Directory::new();
    let [trace, record] = ["trace", "axes.csv"].map(|name| directory.path(name));
    let made = Command::new("mkfifo").arg(&trace).status();
    assert!(made.unwrap().success());
    // The pipe is open for writing and is never read.
    let pipe = File::options().read(true).write(true).open(&trace);
    let run = Running::start([
        "run".as_ref(),
        example("irb6").as_os_str(),
        "--bench=lockstep".as_ref(),
        "--trace".as_ref(),
        trace.as_os_str(),
        "--record".as_ref(),
        record.as_os_str(),
    ]);
    run.wait_until_stalled(&record, |text| text.contains(",Homing,"));
    THREE.into_iter().for_each(|signal| run.signal(signal));
    let run = run.output();
    assert_eq!(run.status.code(), Some(1), "{run:?}");
    assert_eq!(run.stdout, "");
    drop(pipe);
}
