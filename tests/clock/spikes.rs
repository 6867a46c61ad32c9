//! `--spikes`: file with the cycles around the latest ones, for Perfetto.

use std::fs;
use std::path::Path;

use kit::mrroc::{Directory, Running, example, mrroc, shorten};
use kit::{PERIOD, by_the_clock};
use serde_json::Value;

use crate::cycle_calls::emulate;

/// A number of the file in ns, with the interpretation of Perfetto.
fn nanos(event: &Value, key: &str) -> u64 {
    (event[key].as_f64().expect("a number") * 1e3) as u64
}

/// Names of the processes in a file. Asserts that the phases fill each cycle without gaps.
fn processes(file: &Path) -> Vec<String> {
    let text = fs::read_to_string(file).expect("it was written");
    let document: Value = serde_json::from_str(&text).expect("it is JSON");
    let events = document["traceEvents"].as_array().expect("a list");
    let named = |name: &'static str| events.iter().filter(move |event| event["name"] == name);
    for process in named("process_name").map(|event| &event["pid"]) {
        let of = |category: &'static str| {
            events.iter().filter(move |event| event["pid"] == *process && event["cat"] == category)
        };
        let mut phases = of("phase");
        let (mut number, mut end) = (None, None);
        for cycle in of("cycle") {
            let from = nanos(cycle, "ts");
            // The phases follow each other without a gap.
            assert!(end.is_none_or(|end| end == from), "{cycle}");
            let this = cycle["args"]["cycle"].as_u64().expect("a number");
            assert!(number.is_none_or(|before| before + 1 == this), "{cycle}");
            let mut reached = from;
            while reached < from + nanos(cycle, "dur") {
                let phase = phases.next().expect("a cycle consists of phases");
                assert_eq!(nanos(phase, "ts"), reached, "{phase}");
                reached += nanos(phase, "dur");
            }
            assert_eq!(reached, from + nanos(cycle, "dur"), "{cycle}");
            (number, end) = (Some(this), Some(reached));
        }
        assert!(number.is_some() && phases.next().is_none(), "{process}");
        assert!(of("deadline").count() >= of("cycle").count(), "{process}");
    }
    named("process_name").map(|event| event["args"]["name"].as_str().expect("a name").to_owned()).collect()
}

/// SIGSTOP delays a cycle by a large amount.
#[test]
fn a_late_cycle_of_a_run_and_one_that_is_asked_for_are_in_the_file() {
    by_the_clock(0.3, PERIOD, || {
        let directory = Directory::new();
        let cell = directory.cell("irb6", shorten);
        let [file, record] = ["spikes.json", "states.csv"].map(|name| directory.path(name));
        let run = Running::start([
            "run".as_ref(),
            cell.as_os_str(),
            "--json".as_ref(),
            "--spikes".as_ref(),
            file.as_os_str(),
            "--record".as_ref(),
            record.as_os_str(),
        ]);
        let has = |lines: usize| move |text: &str| text.lines().count() > lines;
        run.wait_for(&record, has(1000));
        run.signal("STOP");
        run.signal("CONT");
        run.wait_for(&record, has(2000));
        run.signal("USR1");
        let output = run.output();
        let report = output.json();
        let processes = processes(&file);
        let asked = processes.last().expect("there is one");
        assert!(asked.starts_with("on request: cycle "), "{processes:?}");
        let worst = &report["cycle"]["worst"][0];
        let expected = format!(
            "spike 1: {:.0} µs late, {}, cycle {}",
            worst["late_us"].as_f64().expect("a number"),
            worst["cause"].as_str().expect("a cause"),
            worst["cycle"]
        );
        assert_eq!(processes[0], expected, "{report}");
        let text = fs::read_to_string(&file).expect("it was written");
        let cause = worst["cause"].as_str().expect("a cause");
        assert!(text.contains(&format!("µs: {cause}")), "{report}");
    });
}

/// The process at the other end of the lines is stopped, so that the drives cannot come up before the request.
#[test]
fn cycles_that_are_asked_for_before_the_drives_are_up_are_the_first() {
    by_the_clock(0.45, PERIOD, || {
        let directory = Directory::new();
        let cell = directory.cell("irb6-serial", |cell| {
            shorten(cell);
            cell.serial[0].tolerated_missing = 10;
            cell.serial[0].answer_timeout_ms = 500;
            cell.max_missed_in_row = 500;
        });
        let [ttys, file] = ["ttys", "spikes.json"].map(|name| directory.path(name));
        let emulator = emulate(&cell, &ttys);
        emulator.signal("STOP");
        let run = Running::start([
            "run".as_ref(),
            cell.as_os_str(),
            "--bench=card".as_ref(),
            "--serial".as_ref(),
            ttys.as_os_str(),
            "--spikes".as_ref(),
            file.as_os_str(),
        ]);
        run.wait_for(&file, |_| true);
        run.signal("USR1");
        emulator.signal("CONT");
        // The signal itself must not end the run.
        let output = run.output();
        assert!(matches!(output.status.code(), Some(0 | 1)), "{output:?}");
        let processes = processes(&file);
        assert_eq!(processes.last().map(String::as_str), Some("on request: cycle 0"));
    });
}

#[test]
fn a_measurement_shows_its_late_wake_ups() {
    by_the_clock(0.3, PERIOD, || {
        let directory = Directory::new();
        let file = directory.path("spikes.json");
        let cell = example("irb6");
        let cell = ["--cell".as_ref(), cell.as_os_str()];
        for more in [&[][..], &cell] {
            let words = ["jitter", "--duration=1s", "--wait=plain", "--json", "--force", "--spikes"];
            let words = words.iter().map(AsRef::as_ref);
            let words = words.chain([file.as_os_str()]).chain(more.iter().copied());
            let output = mrroc(words);
            assert_eq!(output.status.code(), Some(0), "{output:?}");
            let report = output.json();
            let worst = report["worst"].as_array().expect("a list");
            let processes = processes(&file);
            // One spike may contain several late cycles.
            assert_eq!(processes.is_empty(), worst.is_empty(), "{report}");
            if let Some(worst) = worst.first() {
                let late = worst["late_us"].as_f64().expect("a number");
                let cause = worst["cause"].as_str().expect("a cause");
                let begins = format!("spike 1: {late:.0} µs late, {cause}, ");
                assert!(processes[0].starts_with(&begins), "{processes:?} {report}");
            }
        }
    });
}
