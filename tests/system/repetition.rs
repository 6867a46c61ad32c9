//! Complete programs of the example cells, run repeatedly.

use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::thread;

use kit::cell::{Setup, traced};
use kit::mrroc::{Directory, Running, example, mrroc, shorten};
use kit::refusals::refused;

/// Hash of every frame of a whole run with time and direction, and the number of frames.
fn run(seed: u64) -> (u64, u64) {
    let mut setup = Setup::of("irb6");
    setup.cell.seed = seed;
    let (mut rig, mut trace) = traced(setup);
    let hash = std::rc::Rc::new(std::cell::RefCell::new((DefaultHasher::new(), 0)));
    let shared = hash.clone();
    rig.after_cycle = Box::new(move |_| {
        let (hasher, frames) = &mut *shared.borrow_mut();
        while let Some(traced) = trace.read() {
            (traced.at, traced.frame, traced.direction as u8).hash(hasher);
            *frames += 1;
        }
        assert_eq!(trace.lost(), 0);
    });
    rig.run_program().expect("the program is done");
    let (hasher, frames) = &*hash.borrow();
    (hasher.finish(), *frames)
}

#[test]
fn the_same_seed_gives_the_same_frames_at_the_same_times() {
    let (one, two) = (run(1), run(1));
    assert!(one.1 > 50_000, "{} frames", one.1);
    assert_eq!(one, two);
    assert_ne!(one, run(2), "the seed has no part in it");
}

fn twenty_seeds(name: &str) {
    for seed in 1..=20 {
        let mut setup = Setup::of(name);
        setup.cell.seed = seed;
        let mut rig = setup.bring_up();
        if let Err(error) = rig.run_program() {
            panic!("{name}, seed {seed}: {error}");
        }
        assert_eq!(rig.servo.fault(0), None, "{name}, seed {seed}");
    }
}

#[test]
fn the_irb6_completes_its_program_with_twenty_seeds() {
    twenty_seeds("irb6");
}

#[test]
fn the_irp6_completes_its_program_with_twenty_seeds() {
    twenty_seeds("irp6");
}

/// Number of helpers among the threads of process `pid`.
fn helpers_of(pid: u32) -> usize {
    let threads = fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    let names = threads.filter_map(|thread| fs::read_to_string(thread.path().join("comm")).ok());
    names.filter(|name| name.starts_with("helper-")).count()
}

#[test]
fn robots_that_are_emulated_by_several_threads_do_the_same() {
    let directory = Directory::new();
    let cell = directory.cell("lab", shorten).display().to_string();
    let processors = thread::available_parallelism().unwrap().get();
    let records = [1, 2, 3].map(|threads: usize| {
        let record = directory.path(&format!("{threads}.csv"));
        let (count, to) = (threads.to_string(), record.display().to_string());
        let run = Running::start(["run", &cell, "--bench", "lockstep", "--threads", &count, "--record", &to]);
        // A helper more than the processors allow is left out.
        let helpers = threads.min(processors) - 1;
        run.wait_for(&record, |_| helpers_of(run.id()) == helpers);
        let run = run.output();
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        fs::read(record).unwrap()
    });
    assert!(records[0].len() > 1_000_000, "{} bytes", records[0].len());
    assert!(records[0] == records[1] && records[0] == records[2]);
}

#[test]
fn threads_of_an_emulation_that_keeps_pace_with_the_clock_are_refused() {
    let cell = example("irb6").display().to_string();
    refused(&mrroc(["run", &cell, "--threads", "2"]), &["--threads needs --bench lockstep"]);
}
