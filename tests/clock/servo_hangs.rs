//! A servo thread that hangs for good: a run in motion, and a measurement of a cell, end by themselves and report the
//! hang.
//!
//! `mrroc` is a process of its own, and the emulator on ttys is in this process. The thread hangs until all outputs of
//! the process are read.

use std::ffi::OsStr;
use std::fs;
use std::path::Path;
use std::time::Duration;

use ::mrroc::cell::{Cell, CellFile};
use ::mrroc::guardian::NAME;
use can::clock;
use kit::by_the_clock;
use kit::mrroc::{Directory, Running, example};
use serde_json::json;

use crate::guardian::{Emulator, child_of, moved};
use crate::hang::{Hang, servo_thread};
use crate::serial_cli::{patient, run_arguments};

/// Shortest delay that disturbs a run before the hang.
const UNBEARABLE: Duration = Duration::from_millis(6);

/// Longest time from the hang to the end of the process. The run notices the hang after a second.
const END: Duration = Duration::from_secs(15);

/// The same for emulated drives in the process: the hang is noticed after 10 s.
const EMULATED_END: Duration = Duration::from_secs(25);

struct Rig<'a> {
    directory: &'a Directory,
    cell: &'a Path,
    ttys: &'a Path,
    emulator: &'a Emulator,
}

impl Rig<'_> {
    /// Lets the servo thread of a run hang in motion, and sends `signal` to the run.
    fn hangs(&self, signal: Option<&str>) {
        let [record, flights] = ["record.csv", "flights"].map(|name| self.directory.path(name));
        let _ = (fs::remove_file(&record), fs::remove_dir_all(&flights));
        fs::create_dir(&flights).expect("a directory of a new name");
        self.emulator.samples.lock().expect("no panic").clear();
        let began = clock::now();
        let arguments = run_arguments(self.cell, self.ttys, &record);
        let flight: [&OsStr; 2] = ["--flight".as_ref(), flights.as_ref()];
        let run = Running::start(arguments.into_iter().chain(flight));
        let broken = |text: &str| text.contains(",Stopping,") || text.contains(",Faulted,");
        let begun = |text: &str| text.matches(",wrist-roll,Moving,").count() > 300 || broken(text);
        let begun = run.ended_before(&record, begun);
        assert_eq!(begun, Ok(()), "the run ended before the hang");
        assert!(!broken(&fs::read_to_string(&record).expect("the record")), "the run stopped before the hang");
        let (process, guardian) = (run.id(), child_of(run.id(), NAME).expect("a guardian"));
        let hang = Hang::of(process);
        let event = clock::now();
        if let Some(signal) = signal {
            let rows = |text: &str| text.lines().count();
            run.wait_until_stalled(&record, |text| rows(text) > 0);
            run.signal(signal);
        }
        let ended = run.output();
        let duration = clock::now().since(event);
        for id in [process, guardian] {
            assert!(!Path::new(&format!("/proc/{id}")).exists(), "process {id} is there: {ended:?}");
        }
        let after = self.emulator.at_rest(began);
        drop(hang);
        println!("{signal:?}: ended after {duration:?}, {}", ended.json()["faults"]);
        assert!(duration < END, "{duration:?}");
        assert_eq!(ended.status.code(), Some(1), "{ended:?}");
        let report = ended.json();
        assert_eq!(report["outcome"], "faulted", "{report}");
        let faults = report["faults"].as_array().expect("faults");
        let what = |number: usize| faults[number]["what"].as_str().expect("a text");
        assert!(what(0).starts_with("thread servo hangs (no servo cycle for 1."), "{faults:?}");
        assert!(what(0).ends_with("the guardian put all drives that it guards into their error state"), "{faults:?}");
        assert_eq!(faults[0]["check"], "check adapters and cycle laws");
        assert_eq!((&faults[0]["stop_category"], &faults[0]["stopped"]), (&json!(0), &json!(["irb6"])), "{faults:?}");
        assert_eq!(Some(faults[0]["cycle"].as_u64().expect("a cycle") + 1), report["cycle"]["cycles"].as_u64());
        assert!(what(1).starts_with("still has power"), "{faults:?}");
        assert_eq!(faults.len(), 2, "{faults:?}");
        assert!(!broken(&fs::read_to_string(&record).expect("the record")), "the servo saw nothing of it");
        assert_eq!(fs::read_dir(&flights).expect("a directory").count(), 1, "a flight without a bus has no log");
        let last = after.last().expect("samples");
        assert!(last.error && !moved(last, self.emulator.at_rest(began).last().expect("samples")), "{last:?}");
    }
}

#[test]
fn a_run_whose_servo_thread_hangs_for_good_is_reported_and_ends() {
    let directory = Directory::new();
    let cell = directory.cell("irb6-serial", |cell: &mut Cell| {
        patient(cell);
        cell.max_missed_in_row = 20;
        cell.guardian_ms = Some(50);
        for axis in &mut cell.robot[0].axis {
            axis.following_error = 100.0;
        }
    });
    let ttys = directory.path("ttys");
    let emulator = Emulator::start(&CellFile::read(&cell).expect("the cell"), &ttys);
    let rig = Rig { directory: &directory, cell: &cell, ttys: &ttys, emulator: &emulator };
    for signal in [None, Some("INT")] {
        by_the_clock(0.45, UNBEARABLE, || rig.hangs(signal));
    }
}

#[test]
fn a_measurement_whose_servo_thread_hangs_for_good_is_reported_and_ends() {
    by_the_clock(0.25, Duration::from_secs(1), || {
        let cell = example("irb6");
        let words = ["jitter", "--duration=1h", "--json", "--cell"].map(AsRef::as_ref);
        let run = Running::start(words.into_iter().chain([cell.as_os_str()]));
        let limit = clock::now() + END;
        // A servo thread that is seen twice has begun its cycles.
        let mut seen = None;
        while seen.is_none() || servo_thread(run.id()) != seen {
            assert!(clock::now() < limit, "no servo thread");
            seen = servo_thread(run.id());
            clock::sleep_until(clock::now() + Duration::from_millis(200));
        }
        let hang = Hang::of(run.id());
        let event = clock::now();
        let ended = run.output();
        let duration = clock::now().since(event);
        drop(hang);
        println!("ended after {duration:?}: {ended:?}");
        assert!(duration < EMULATED_END, "{duration:?}");
        assert_eq!(ended.status.code(), Some(1), "{ended:?}");
        assert!(ended.stderr.contains("thread servo hangs (no servo cycle for 10."), "{ended:?}");
        assert!(ended.stderr.contains("check adapters and cycle laws"), "{ended:?}");
    });
}
