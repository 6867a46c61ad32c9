//! Rig of two arms that hold one bar: runs with the truth of the emulated scene, and the check of a stop.

use std::fs;
use std::path::Path;

use ::mrroc::bench::BenchKind;
use ::mrroc::carry::{ObjectPath, Regulation};
use ::mrroc::cell::{Cell, CellFile};
use ::mrroc::prelude::{Outcome, RunOutcome};
use ::mrroc::report::RunReport;
use ::mrroc::run::{Requests, RunOptions};
use ::mrroc::tasks::{self, Program};
use nalgebra::Vector3;

use crate::mrroc::Directory;
use hold_bar::{Arms, COURSE, LIMITS};

#[path = "../../examples/hold_bar.rs"]
#[expect(dead_code, reason = "the program of the example has a main of its own")]
mod hold_bar;

/// The task of the example.
pub async fn hold(cell: &mut tasks::Cell) -> Outcome {
    hold_bar::hold(cell).await
}

/// The course of the example.
pub fn course() -> ObjectPath {
    ObjectPath::through(&COURSE, &LIMITS).unwrap()
}

/// The bar and its grips at one time.
#[derive(Clone, Copy, Debug)]
pub struct Truth {
    /// Time, s.
    pub at: f64,
    /// Middle of the bar, m.
    pub place: Vector3<f64>,
    /// Internal force, N; `None` while a gripper is open.
    pub internal: Option<Vector3<f64>>,
}

/// The lines of a file of the truth.
pub fn truth(path: &Path) -> Vec<Truth> {
    let text = fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    let names: Vec<_> = lines.next().unwrap().split(',').collect();
    let column = |name: &str| names.iter().position(|it| *it == name).unwrap();
    let vector = |name: &str, suffix: &str| ["x", "y", "z"].map(|axis| column(&format!("{name}{axis}{suffix}")));
    let (place, left, right) = (vector("bar.", "_m"), vector("left.f", "_n"), vector("right.f", "_n"));
    let line = |line: &str| {
        let fields: Vec<_> = line.split(',').collect();
        let number = |column: usize| fields[column].parse::<f64>().ok();
        let of = |columns: [usize; 3]| {
            let [x, y, z] = columns.map(number);
            Some(Vector3::new(x?, y?, z?))
        };
        let internal = of(left).zip(of(right)).map(|(left, right)| (left - right) / 2.0);
        Truth { at: number(0).unwrap(), place: of(place).unwrap(), internal }
    };
    lines.map(line).collect()
}

/// The example cell after a change.
pub fn cell(change: impl FnOnce(&mut Cell)) -> CellFile {
    let directory = Directory::new();
    CellFile::read(directory.cell("two-irb6-bar", change)).unwrap()
}

/// A run with its truth, and with its file of steps.
pub struct Run {
    pub report: RunReport,
    pub truth: Vec<Truth>,
    pub steps: String,
}

/// Runs a task in lockstep.
pub fn run(file: &CellFile, task: impl AsyncFn(&mut tasks::Cell) -> Outcome + Send + Sync + 'static) -> Run {
    let directory = Directory::new();
    let [path, steps] = ["truth.csv", "steps.csv"].map(|name| directory.path(name));
    let options =
        RunOptions { truth: Some(path.clone()), steps: Some(steps.clone()), ..RunOptions::on(BenchKind::Lockstep) };
    let report = ::mrroc::run::run(file, &options, &Requests::default(), &Program::of(task), &mut |_| {}).unwrap();
    Run { report, truth: truth(&path), steps: fs::read_to_string(steps).unwrap() }
}

/// Carries the bar along its course until a fault. `prepare` changes the team before the motion, not in the rehearsal.
pub fn faulted(prepare: impl Fn(&mut tasks::Team<2>) + Send + Sync + 'static, change: impl FnOnce(&mut Cell)) -> Run {
    run(&cell(change), async move |cell: &mut tasks::Cell| {
        let mut arms = Arms::of(cell)?;
        let course = arms.path(&COURSE)?;
        arms.take(cell).await?;
        let is_run = !cell.rehearsing();
        let prepare = |team: &mut tasks::Team<2>| {
            if is_run {
                prepare(team);
            }
        };
        let outcome = arms.carry(cell, &course, Regulation::CYCLE, prepare).await;
        // The truth shows the arms at rest.
        cell.sleep(std::time::Duration::from_millis(500)).await;
        outcome.map(|_| ())
    })
}

/// Longest reaction of the bar to a stop of the servo, s: two servo periods, and the emulated position loops with a
/// set-point filter of 3 ms and a lag of 4 ms.
pub const REACTION: f64 = 0.011;

/// Longest stop of the bar from 0.1 m/s to 2 mm/s, s.
///
/// The columns are the fastest motors: 0.1 m/s at 0.7 m and a gear ratio of 158 are 22.6 rad/s. The limit of
/// 1500 rad/s² brakes them in 15 ms. The bar of 4 kg then swings in two grips with 1e5 N/m and 300 N·s/m each. The
/// velocity decays with a time constant of 2 · 4 kg / 600 N·s/m = 13.3 ms, and to a fiftieth in 52 ms. With the
/// reaction, the sum is 78 ms.
pub const LONGEST_STOP: f64 = 0.078;

/// Longest displacement of the bar in a stop, m: 1.1 mm in the reaction, 0.75 mm while the motors brake, and an
/// amplitude of 0.1 m/s / √(2e5 N/m / 4 kg) = 0.45 mm.
pub const LONGEST_WAY: f64 = 2.3e-3;

/// Checks a stop from the greatest speed, 0.1 m/s: the bar stands within the bounds, and the arms do not tear it.
/// Returns the time at which the stop began, s.
#[track_caller]
pub fn check_stop(what: &str, Run { report, truth, .. }: &Run) -> f64 {
    assert_eq!(report.outcome, RunOutcome::Faulted, "{what}");
    let peak = truth.iter().filter_map(|it| it.internal).map(|it| it.norm()).fold(0.0, f64::max);
    let speeds: Vec<_> = truth.windows(2).map(|two| (two[1].place - two[0].place).norm() / 2e-3).collect();
    let began = speeds.iter().rposition(|speed| *speed > 0.09).unwrap();
    let rest = speeds.iter().rposition(|speed| *speed > 2e-3).unwrap();
    let stop = truth[rest].at - truth[began].at;
    let way = (truth[rest].place - truth[began].place).norm();
    println!("{what}: stop of {:.0} ms and {:.2} mm, internal force up to {peak:.1} N", 1e3 * stop, 1e3 * way);
    assert!(stop < LONGEST_STOP && way < LONGEST_WAY, "{what}: {stop} s, {way} m");
    assert!(peak < 100.0, "{what}: {peak} N");
    assert!(truth.iter().rev().take(100).all(|it| it.internal.is_some()), "{what}: the bar was dropped");
    truth[began].at
}
