//! The order of frames in candump logs of a run.

use std::fs;
use std::path::Path;

use kit::mrroc::{Directory, example, mrroc};
use kit::refusals::refused;

/// Times of a log, s, and the number of interfaces in it.
fn times(path: &Path) -> (Vec<f64>, usize) {
    let text = fs::read_to_string(path).unwrap();
    let mut interfaces: Vec<&str> = text.lines().map(|line| line.split_whitespace().nth(1).unwrap()).collect();
    interfaces.sort_unstable();
    interfaces.dedup();
    let time = |line: &str| line[1..].split(')').next().unwrap().parse().unwrap();
    (text.lines().map(time).collect(), interfaces.len())
}

#[test]
fn logs_of_a_cell_with_several_buses_are_in_the_order_of_time() {
    let directory = Directory::new();
    let cell = example("irp6-track");
    let (trace, recording) = (directory.path("trace.log"), directory.path("run.mcap"));
    let [cell, trace_to, record_to] = [&cell, &trace, &recording].map(|path| path.to_str().unwrap());
    let run = mrroc(["run", cell, "--task=home", "--bench=lockstep", "--trace", trace_to, "--record", record_to]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let mut counts = Vec::new();
    for log in [trace, directory.path("run.log")] {
        let (times, interfaces) = times(&log);
        assert_eq!(interfaces, 2, "{}", log.display());
        let back = times.windows(2).filter(|pair| pair[1] < pair[0]).count();
        assert_eq!(back, 0, "{}: steps backwards of {} frames", log.display(), times.len());
        counts.push(times.len());
    }
    assert!(counts[0] > 1000 && counts[0] == counts[1], "no frame is left out: {counts:?}");
}

#[test]
fn a_trace_of_a_cell_without_a_can_bus_is_refused_with_the_option_that_keeps_telegrams() {
    let directory = Directory::new();
    let (cell, trace) = (example("irb6-serial"), directory.path("trace.log"));
    let [cell, trace_to] = [&cell, &trace].map(|path| path.to_str().unwrap());
    let run = mrroc(["run", cell, "--task=home", "--bench=lockstep", "--trace", trace_to]);
    refused(&run, &["--trace writes the frames of CAN buses, and the cell has none", "--record FILE.mcap"]);
    assert!(!trace.exists());
}

#[test]
fn a_cell_without_a_can_bus_has_no_candump_log() {
    let directory = Directory::new();
    let (cell, recording) = (example("irb6-serial"), directory.path("run.mcap"));
    let [cell, record_to] = [&cell, &recording].map(|path| path.to_str().unwrap());
    let run = mrroc(["run", cell, "--task=home", "--bench=lockstep", "--record", record_to]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    assert!(recording.exists() && !directory.path("run.log").exists());
}
