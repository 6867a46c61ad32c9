//! Network cameras: from the emulated world over the connection to the task, in lockstep.

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::CellFile;
use ::mrroc::prelude::RunOutcome;
use ::mrroc::report::RunReport;
use kit::camera::{REFUSED, assert_found, refusal, refusal_of, run};
use kit::mrroc::example;

fn faults(report: &RunReport) -> Vec<&str> {
    report.faults.iter().map(|fault| fault.what.as_str()).collect()
}

#[test]
fn box_is_located_within_1_mm_from_a_picture_in_lockstep() {
    for (seed, x, z) in [(1, 0.713, 0.887), (2, 0.66, 0.93), (3, 0.741, 0.842)] {
        let report = run(BenchKind::Lockstep, |cell| {
            cell.seed = seed;
            let block = &mut cell.scene.as_mut().unwrap().block[0];
            (block.centre[0], block.centre[2]) = (x, z);
        });
        assert_found(&report, x, z);
    }
}

#[test]
fn pictures_in_lockstep_are_the_same_each_run() {
    let [first, second] = [(); 2].map(|()| run(BenchKind::Lockstep, |_| {}).figures);
    assert_eq!(first, second);
}

#[test]
fn lost_box_ends_the_task_by_a_typed_error() {
    let away = run(BenchKind::Lockstep, |cell| cell.scene.as_mut().unwrap().block[0].centre[0] = 5.0);
    assert_eq!(away.outcome, RunOutcome::Faulted);
    assert!(faults(&away)[0].contains("camera eye: nothing bright is in the picture"), "{:?}", faults(&away));
    let half = run(BenchKind::Lockstep, |cell| cell.scene.as_mut().unwrap().block[0].centre[0] = 0.93);
    assert!(faults(&half)[0].contains("camera eye: the brightest area is at the edge"), "{:?}", faults(&half));
}

#[test]
fn silence_of_the_camera_ends_the_task_by_its_fault_with_the_age() {
    let report = run(BenchKind::Lockstep, |cell| cell.camera[0].emulator.silent_from_s = Some(5.0));
    assert_eq!(report.outcome, RunOutcome::Faulted);
    assert!(faults(&report)[0].contains("camera eye: no picture for "), "{:?}", faults(&report));
}

#[test]
fn absent_silent_garbled_and_other_cameras_are_refused_before_motion() {
    for (change, expected) in REFUSED {
        let refused = refusal(BenchKind::Lockstep, change);
        assert!(refused.contains(expected), "{refused}");
    }
    let file = CellFile::read(example("irb6")).unwrap();
    let unknown = refusal_of(&file, BenchKind::Lockstep);
    assert!(unknown.contains("the cell has no camera \"eye\": add it as [[camera]]"), "{unknown}");
}
