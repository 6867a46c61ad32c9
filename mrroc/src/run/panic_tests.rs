//! A panic of each thread of a run by the wall clock, in motion: the robots brake and are switched off, and the report names
//! the thread and the message.

use std::io::{BufReader, Read};

use super::*;
use crate::operator::Console;
use crate::prelude::*;
use crate::tasks::tests::two_arms;
use servo::{Phase, StopCategory};

/// Both robots home, and the left one moves to and fro.
async fn moving(cell: &mut Cell) -> Outcome {
    let [mut left, mut right] = cell.robots(["left", "right"])?;
    let motion = |angle: f64| left.motions().joints(0.3, &[[angle, -1.571, 0.0, 0.0, 0.0]]);
    let (there, back) = (motion(0.4)?, motion(0.0)?);
    let list = Task::new().enable().home().run(there).run(back).disable();
    join(left.perform(list), right.perform(Task::new().enable().home().disable())).await
}

/// A run of two arms in which the thread `member` panics once the left robot is in `phase`. Returns the report and the
/// record.
fn panicking(program: &Program, member: &'static str, phase: Option<Phase>) -> (RunReport, String) {
    panicking_in(&two_arms(), program, member, phase)
}

fn panicking_in(file: &CellFile, program: &Program, member: &'static str, phase: Option<Phase>) -> (RunReport, String) {
    let directory = tempfile::tempdir().unwrap();
    let record = directory.path().join("record.csv");
    let options = RunOptions { record: Some(record.clone()), ..RunOptions::on(BenchKind::Emulated) };
    let requests = Requests::default();
    if phase.is_none() {
        requests.crew.plant(member);
    }
    // The operator's console of `mrroc run --operator`.
    let (press, keys) = sync_channel(1);
    let console = Console::reading(BufReader::new(Keyboard(keys)), BenchKind::Emulated, &requests, |_| {});
    let report = run(file, &options, &requests, program, &mut |news| {
        if news.robot == 0 && Some(news.phase) == phase {
            requests.crew.plant(member);
            // The thread that reads lines passes its point after a line.
            let _ = press.try_send(());
        }
    });
    console.unwrap().finish();
    (report.unwrap(), std::fs::read_to_string(record).unwrap())
}

/// An input of empty lines, one for each message. The input ends with the sender.
struct Keyboard(Receiver<()>);

impl Read for Keyboard {
    fn read(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        Ok(self.0.recv().map_or(0, |()| b"\n".as_slice().read(into).unwrap_or(0)))
    }
}

/// Whether the rows of the left column end with a controlled stop from motion, and then no power.
fn brakes(record: &str) -> bool {
    let rows = record.lines().filter(|row| row.contains(",left.column,"));
    let mut phases: Vec<_> = rows.filter_map(|row| row.split(',').find(|it| PHASES.contains(it))).collect();
    phases.dedup();
    let end = phases.iter().rev().take(3).copied().collect::<Vec<_>>();
    matches!(end[..], ["Off" | "Faulted", "Stopping", "Homing" | "Moving"])
}

const PHASES: [&str; 7] = ["Off", "Enabling", "Homing", "Standing", "Moving", "Stopping", "Faulted"];

#[test]
fn a_panic_of_any_thread_stops_the_robots_in_category_1_and_is_reported() {
    let members =
        ["files", "listener", "controller", "servo", "planning", "operator input", "operator lines", "operator output"];
    for member in members {
        let phase = if member == "planning" { Phase::Standing } else { Phase::Homing };
        let (report, record) = panicking(&Program::of(moving), member, Some(phase));
        let first = &report.faults[0];
        println!("{first}");
        assert_eq!(report.outcome, RunOutcome::Faulted, "{member}");
        assert!(first.what.contains(&format!("{member} as the test asks")), "{member}: {:?}", report.faults);
        assert!(first.what.contains(&format!("thread {member}")), "{member}: {first}");
        assert_eq!(first.stop_category, Some(StopCategory::One), "{member}");
        assert_eq!(first.stopped, ["left", "right"], "{member}");
        assert!(first.time_s.is_some() && first.number.is_some(), "{member}: {first}");
        // After a panic on the servo thread, the emulated drives stand still in time and cannot report that they are off.
        let has_power = report.faults.iter().any(|fault| fault.what.contains("still has power"));
        assert_eq!(has_power, member == "servo", "{member}: {report}");
        // The record ends where the thread of the files does, and the first step of a motion is computed at a stand.
        let is_visible = ["listener", "controller"].contains(&member);
        assert!(!is_visible || brakes(&record), "{member}");
    }
}

#[test]
fn a_panic_of_the_rehearsals_before_motion_ends_the_run() {
    let (report, _) = panicking(&Program::of(moving), "rehearsal", None);
    assert_eq!(report.outcome, RunOutcome::Faulted);
    assert!(report.faults[0].what.starts_with("thread rehearsal panicked: rehearsal as the test asks"), "{report}");
}

#[test]
fn the_fault_of_a_task_that_panics_has_the_message() {
    let program = Program::of(async |cell: &mut Cell| {
        let mut left = cell.robot("left")?;
        left.perform(Task::new().enable().home()).await?;
        assert!(cell.rehearsing(), "as the test asks");
        Ok(())
    });
    let (report, _) = panicking(&program, "nobody", None);
    let faults: Vec<_> = report.faults.iter().map(|fault| fault.what.as_str()).collect();
    assert!(faults[0].starts_with("the task panicked in thread controller: as the test asks"), "{faults:?}");
    assert_eq!(faults.len(), 1, "{faults:?}");
}

#[test]
fn a_panic_of_the_thread_of_a_camera_stops_the_robot() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/irb6-camera.toml");
    let file = CellFile::read(path).unwrap();
    let program = Program::of(async |cell: &mut Cell| {
        let mut irb6 = cell.robot("irb6")?;
        irb6.perform(Task::new().enable().home()).await
    });
    let (report, _) = panicking_in(&file, &program, "camera", Some(Phase::Standing));
    let first = &report.faults[0];
    assert_eq!(report.outcome, RunOutcome::Faulted);
    assert!(first.what.starts_with("thread camera panicked: camera as the test asks"), "{report}");
    assert_eq!((first.stop_category, &first.stopped[..]), (Some(StopCategory::One), &["irb6".to_owned()][..]));
}
