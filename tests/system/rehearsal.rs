//! Rehearsals with the emulated scene: contact and sensors are judged before anything moves.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use ::mrroc::Program;
use ::mrroc::bench::BenchKind;
use ::mrroc::cell::{CellFile, EmulatedPlane, EmulatedScene};
use ::mrroc::prelude::*;
use ::mrroc::run::{Requests, RunOptions, run};
use ::mrroc::tasks::Cell;
use kit::mrroc::{Directory, example, mrroc, shorten};
use kit::refusals::refused;

use crate::force_cell::push_until;

/// Beginnings of a task: on ideal drives, in rehearsals with the scene, and in runs.
#[derive(Clone, Default)]
struct Begun([Arc<AtomicU32>; 3]);

impl Begun {
    fn note(&self, cell: &Cell) {
        let which = match (cell.rehearsing(), cell.has_surroundings()) {
            (true, false) => 0,
            (true, true) => 1,
            (false, _) => 2,
        };
        self.0[which].fetch_add(1, Ordering::Relaxed);
    }

    fn counts(&self) -> [u32; 3] {
        self.0.each_ref().map(|count| count.load(Ordering::Relaxed))
    }
}

/// Runs `task` in lockstep. Returns the report or the refusal, and the beginnings.
fn run_of(
    file: &CellFile,
    rehearse_with_scene: bool,
    task: impl AsyncFn(&mut Cell) -> Outcome + Send + Sync + 'static,
) -> (Result<::mrroc::report::RunReport, String>, [u32; 3]) {
    let begun = Begun::default();
    let noted = begun.clone();
    let program = Program::of(async move |cell: &mut Cell| {
        noted.note(cell);
        task(cell).await
    });
    let options = RunOptions { rehearse_with_scene, ..RunOptions::on(BenchKind::Lockstep) };
    let report = run(file, &options, &Requests::default(), &program, &mut |_| {});
    (report.map_err(|error| format!("{error:#}")), begun.counts())
}

/// The cell with a force sensor, and its table at this height, m.
fn with_table(height: f64) -> CellFile {
    let mut file = CellFile::read(example("irb6-wrist")).unwrap();
    file.cell.scene.as_mut().unwrap().plane[0].height = height;
    file
}

/// Pushes on the table, which a rehearsal on ideal drives does not have.
async fn needs_the_table(cell: &mut Cell) -> Outcome {
    push_until::push(cell).await?;
    let force = cell.force_sensor("wrist")?.in_tool()?.force.norm();
    if force < 10.0 {
        return Err(TaskError::Refused(::mrroc::Error::msg("the task needs the table")));
    }
    Ok(())
}

#[test]
fn a_task_that_needs_contact_is_judged_with_the_scene() {
    // On ideal drives, the task is refused, and the refusal names the option.
    let (refusal, begun) = run_of(&with_table(0.78), false, needs_the_table);
    let refusal = refusal.unwrap_err();
    assert!(refusal.starts_with("the task needs the table (in the rehearsal, which has ideal drives, "), "{refusal}");
    assert!(refusal.ends_with("--rehearse-with-scene has those of the emulated scene)"), "{refusal}");
    assert_eq!(begun, [1, 0, 0]);
    let (report, begun) = run_of(&with_table(0.78), true, needs_the_table);
    let report = report.unwrap();
    assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
    // The first motions from beside home are rehearsed too.
    assert_eq!(begun, [18, 1, 1]);
}

#[test]
fn a_table_that_is_not_there_is_told_before_anything_moves() {
    // Ideal drives cannot judge this: the run refuses the task after the motion.
    let (report, begun) = run_of(&with_table(0.5), false, push_until::push);
    assert_eq!(report.unwrap().outcome, RunOutcome::Faulted);
    assert_eq!(begun, [17, 0, 1]);
    let (refusal, begun) = run_of(&with_table(0.5), true, push_until::push);
    let refusal = refusal.unwrap_err();
    assert!(refusal.starts_with("in the rehearsal with the scene, nothing has moved: "), "{refusal}");
    assert!(refusal.contains("the tool met nothing on its way down"), "{refusal}");
    assert_eq!(begun, [0, 1, 0]);
}

#[test]
fn the_rehearsal_ends_where_the_task_says_so_also_with_the_scene() {
    async fn asks(cell: &mut Cell) -> Outcome {
        cell.robot("irb6")?.perform(Task::new().enable().home()).await?;
        cell.end_rehearsal("the rest needs an operator")?;
        Ok(())
    }
    let (report, begun) = run_of(&with_table(0.78), true, asks);
    assert_eq!(report.unwrap().outcome, RunOutcome::Completed);
    assert_eq!(begun[1..], [1, 1]);
}

/// The IRb-6 with a stiff wall at this place, x, m. Its path reaches beyond 0.8 m.
fn walled(directory: &Directory, place: f64) -> PathBuf {
    directory.cell("irb6", |cell| {
        shorten(cell);
        let normal = [-1.0, 0.0, 0.0];
        let wall = EmulatedPlane { normal, height: -place, stiffness: 1e6, damping: 100.0, friction: 0.0 };
        let scene = EmulatedScene { robot: Some("irb6".to_owned()), plane: vec![wall], ..EmulatedScene::default() };
        cell.scene = Some(scene);
    })
}

#[test]
fn a_program_that_runs_into_a_wall_is_told_before_anything_moves() {
    let directory = Directory::new();
    let cell = walled(&directory, 0.8);
    let log = directory.path("run.log");
    let command = |words: &[&str]| {
        let [word, options @ ..] = words else { unreachable!("there is a command") };
        let place = [word, cell.to_str().unwrap(), "--rehearse-with-scene"];
        mrroc(place.iter().chain(options))
    };
    let trace = log.to_str().unwrap();
    for words in [
        &["check"][..],
        &["run", "--bench", "lockstep", "--trace", trace],
        // The interface of the cell is not opened.
        &["run", "--bench", "card", "--trace", trace],
    ] {
        let run = command(words);
        refused(&run, &["in the rehearsal with the scene, nothing has moved: irb6: "]);
        assert!(!log.exists(), "{words:?}: a bus was opened");
    }
    // The plain check sees the wall in the path of the tip, and warns.
    let plain = mrroc(["check".as_ref(), cell.as_os_str()]);
    assert_eq!(plain.status.code(), Some(0), "{plain:?}");
    assert!(plain.stderr.contains("contact with scene.plane[0]"), "{plain:?}");
}

#[test]
fn check_states_the_time_with_the_scene_and_refuses_the_option_without_one() {
    let check = |cell: &Path, json: bool| {
        let words = ["check".as_ref(), cell.as_os_str(), "--rehearse-with-scene".as_ref()];
        mrroc(words.into_iter().chain(json.then_some("--json".as_ref())))
    };
    let directory = Directory::new();
    let free = walled(&directory, 1.5);
    let checked = check(&free, true);
    assert_eq!(checked.status.code(), Some(0), "{checked:?}");
    let report = checked.json();
    let [after_homing, with_homing] = ["program_s", "with_scene_s"].map(|key| report[key].as_f64().unwrap());
    assert!(with_homing > after_homing + 0.5, "{with_homing} s, {after_homing} s");
    let printed = check(&free, false);
    assert!(printed.stdout.contains("rehearsed with the scene: "), "{printed:?}");
    let said =
        "--rehearse-with-scene needs a scene, and the cell has no table [scene]: add one, or leave the option out";
    for command in ["check", "run"] {
        let cell = example("irb6");
        let words = [command.as_ref(), cell.as_os_str(), "--rehearse-with-scene".as_ref()];
        refused(&mrroc(words.into_iter().chain((command == "run").then_some("--bench=lockstep".as_ref()))), &[said]);
    }
}
