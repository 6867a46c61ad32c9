//! Two arms that hold one bar: path, internal force, and stops after faults, by the truth of the emulated scene.

use std::fs;
use std::path::Path;

use ::mrroc::bench::BenchKind;
use ::mrroc::carry::{ObjectPath, Regulation};
use ::mrroc::cell::{Cell, CellFile};
use ::mrroc::prelude::{Outcome, RunOutcome};
use ::mrroc::report::RunReport;
use ::mrroc::run::{Requests, RunOptions};
use ::mrroc::tasks::{self, Program};
use controller::coordination::Disturbance;
use controller::executor::DisturbedMessage;
use hold_bar::{Arms, COURSE, LIMITS};
use kit::mrroc::Directory;
use kit::steps::lines;
use nalgebra::Vector3;

#[path = "../../examples/hold_bar.rs"]
#[expect(dead_code, reason = "the program of the example has a main of its own")]
mod hold_bar;

/// The bar and its grips at one time.
#[derive(Clone, Copy, Debug)]
struct Truth {
    /// Time, s.
    at: f64,
    /// Middle of the bar, m.
    place: Vector3<f64>,
    /// Internal force, N; `None` while a gripper is open.
    internal: Option<Vector3<f64>>,
}

/// The lines of a file of the truth.
fn truth(path: &Path) -> Vec<Truth> {
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
fn cell(change: impl FnOnce(&mut Cell)) -> CellFile {
    let directory = Directory::new();
    CellFile::read(directory.cell("two-irb6-bar", change)).unwrap()
}

/// A run with its truth, and with its file of steps.
struct Run {
    report: RunReport,
    truth: Vec<Truth>,
    steps: String,
}

/// Runs a task in lockstep.
fn run(file: &CellFile, task: impl AsyncFn(&mut tasks::Cell) -> Outcome + Send + Sync + 'static) -> Run {
    let directory = Directory::new();
    let [path, steps] = ["truth.csv", "steps.csv"].map(|name| directory.path(name));
    let options =
        RunOptions { truth: Some(path.clone()), steps: Some(steps.clone()), ..RunOptions::on(BenchKind::Lockstep) };
    let report = ::mrroc::run::run(file, &options, &Requests::default(), &Program::of(task), &mut |_| {}).unwrap();
    Run { report, truth: truth(&path), steps: fs::read_to_string(steps).unwrap() }
}

fn course() -> ObjectPath {
    ObjectPath::through(&COURSE, &LIMITS).unwrap()
}

/// Root of the mean square, and greatest value.
fn rms_and_peak(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let (mut count, mut squares, mut peak) = (0, 0.0, 0.0_f64);
    for value in values {
        (count, squares, peak) = (count + 1, squares + value * value, peak.max(value));
    }
    [(squares / f64::from(count)).sqrt(), peak]
}

#[test]
fn a_bar_is_carried_within_the_bounds_of_path_and_internal_force() {
    let Run { report, truth, .. } = run(&cell(|_| ()), hold_bar::hold);
    assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
    let figure = |name: &str| report.figures[name];
    assert_eq!(figure("start_skew_cycles_max"), 0.0);
    assert!(figure("object_path_rms_mm") < 0.5);
    // The third carriage is regulated in each period, and ends with the last motion of the bar.
    let course = course();
    let last = truth[truth.len() - 1].place;
    let end = truth.iter().rposition(|it| (it.place - last).norm() > 1e-3).unwrap();
    let end = truth[end].at;
    let window = |from: f64, to: f64| truth.iter().filter(move |it| it.at > from && it.at < to);
    let internal = |from, to| rms_and_peak(window(from, to).map(|it| it.internal.unwrap().norm()));
    let duration = course.duration();
    let [rms, peak] = internal(end - duration + 0.2, end);
    // Some macrosteps lie between two carriages.
    let [stiff_rms, stiff_peak] = internal(end - 3.0 * duration, end - 2.0 * duration - 0.4);
    let [path, _] = rms_and_peak(window(end - duration + 0.2, end).map(|it| course.distance(&it.place)));
    println!("internal {rms:.2} N rms, {peak:.2} N peak; path {:.3} mm rms", 1e3 * path);
    println!("without regulation: {stiff_rms:.2} N rms, {stiff_peak:.2} N peak");
    assert!(rms < 10.0 && peak < 30.0 && path < 5e-4, "{rms} N, {peak} N, {path} m");
    assert!(stiff_rms > 20.0 && stiff_peak > 40.0, "{stiff_rms} N, {stiff_peak} N");
    // The controller measures what the grips do.
    for (figure, truth) in [
        (figure("internal_force_rms_n"), rms),
        (figure("internal_force_peak_n"), peak),
        (figure("unregulated_internal_force_rms_n"), stiff_rms),
        (figure("unregulated_internal_force_peak_n"), stiff_peak),
    ] {
        assert!((figure - truth).abs() < 2.0 + 0.1 * truth, "{figure} N measured of {truth} N");
    }
}

/// Carries the bar along its course until a fault, with a message disturbed.
fn faulted(message: Option<DisturbedMessage>, change: impl FnOnce(&mut Cell)) -> Run {
    run(&cell(change), async move |cell: &mut tasks::Cell| {
        let mut arms = Arms::of(cell)?;
        let course = arms.path(&COURSE)?;
        arms.take(cell).await?;
        // A rehearsal would refuse the disturbed motion.
        let message = message.filter(|_| !cell.rehearsing());
        let prepare = |team: &mut tasks::Team<2>| message.into_iter().for_each(|message| team.disturb(message));
        let outcome = arms.carry(cell, &course, Regulation::CYCLE, prepare).await;
        // The truth shows the arms at rest.
        cell.sleep(std::time::Duration::from_millis(500)).await;
        outcome.map(|_| ())
    })
}

/// Longest reaction of the bar to a stop of the servo, s: two servo periods, and the emulated position loops with a
/// set-point filter of 3 ms and a lag of 4 ms.
const REACTION: f64 = 0.011;

/// Longest stop of the bar from 0.1 m/s to 2 mm/s, s.
///
/// The columns are the fastest motors: 0.1 m/s at 0.7 m and a gear ratio of 158 are 22.6 rad/s. The limit of
/// 1500 rad/s² brakes them in 15 ms. The bar of 4 kg then swings in two grips with 1e5 N/m and 300 N·s/m each. The
/// velocity decays with a time constant of 2 · 4 kg / 600 N·s/m = 13.3 ms, and to a fiftieth in 52 ms. With the
/// reaction, the sum is 78 ms.
const LONGEST_STOP: f64 = 0.078;

/// Longest displacement of the bar in a stop, m: 1.1 mm in the reaction, 0.75 mm while the motors brake, and an
/// amplitude of 0.1 m/s / √(2e5 N/m / 4 kg) = 0.45 mm.
const LONGEST_WAY: f64 = 2.3e-3;

/// Checks a stop from the greatest speed, 0.1 m/s: the bar stands within the bounds, and the arms do not tear it.
/// Returns the time at which the stop began, s.
#[track_caller]
fn check_stop(what: &str, Run { report, truth, .. }: &Run) -> f64 {
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

/// Macrostep in the first leg of the course at its greatest speed.
const STEP: u64 = 40;

/// Longest time from a disturbed message to the stop of the bar, s: a macrostep, the deadline of the exchange, which is
/// one servo period, and the reaction.
const DETECTION: f64 = 0.020 + 0.002 + REACTION;

/// A message that arrives after the deadline of its step, while the arms brake.
const LATE: Disturbance = Disturbance::Late(std::time::Duration::from_millis(30));

/// Time at which a message of the last motion was sent, s.
fn sent_at(steps: &str, message: &DisturbedMessage) -> f64 {
    let (agent, event) = match (message.answer, message.member) {
        (false, _) => ("coordinator", "exchange"),
        (true, 0) => ("left", "answer-coordinator"),
        (true, _) => ("right", "answer-coordinator"),
    };
    let of_message = lines(steps).filter(|it| (it.agent, it.event, it.macrostep) == (agent, event, message.step));
    of_message.last().unwrap().time_s
}

#[test]
fn a_lost_late_doubled_or_swapped_message_stops_both_arms_and_does_not_tear_the_bar() {
    let (answer, order) = ((1, true), (0, false));
    let cases = [
        (answer, Disturbance::Lost, "left: step 40: the order of step 41 did not come within 4ms"),
        (answer, LATE, "left: step 40: the order of step 41 did not come within 4ms"),
        (
            answer,
            Disturbance::Doubled,
            "step 41, link to member 1: a message of step 40 came in place of that of step 41",
        ),
        (
            answer,
            Disturbance::Swapped,
            "step 40, link to member 1: a message of step 41 came in place of that of step 40",
        ),
        (order, Disturbance::Lost, "left: step 39: the order of step 40 did not come within 4ms"),
    ];
    for ((member, answer), disturbance, cause) in cases {
        let message = DisturbedMessage { member, answer, step: STEP, disturbance };
        let what = format!("{} {disturbance:?}", if answer { "answer" } else { "order" });
        let run = faulted(Some(message), |_| ());
        let delay = check_stop(&what, &run) - sent_at(&run.steps, &message);
        println!("  the stop began {:.1} ms after the message", 1e3 * delay);
        assert!((0.0..DETECTION).contains(&delay), "{what}: {delay} s");
        let causes: Vec<_> = run.report.faults.iter().map(ToString::to_string).collect();
        assert!(causes.len() == 1 && causes[0].contains(cause), "{what}: {causes:?}");
    }
}

/// Time in the first leg of the course at its greatest speed, s since the emulated devices were switched on.
const DURING: f64 = 19.5;

#[test]
fn a_wrist_that_falls_silent_stops_both_arms_and_does_not_tear_the_bar() {
    let run = faulted(None, |cell| cell.force_sensor[1].emulator.silent_from_s = Some(DURING));
    let began = check_stop("right wrist silent", &run);
    // Three missing samples are tolerated, and the macrostep that has begun ends.
    assert!((0.0..0.05).contains(&(began - DURING)), "{began} s");
    let faults = &run.report.faults;
    assert!(faults.iter().any(|fault| fault.what.contains("force sensor")), "{faults:?}");
}

#[test]
fn a_drive_that_trips_stops_both_arms_and_does_not_tear_the_bar() {
    for axis in 0..5 {
        let run = faulted(None, |cell| cell.robot[1].axis[axis].emulator.trips_at_s = Some(DURING));
        let began = check_stop(&format!("axis {axis} of the right arm trips"), &run);
        assert!((-0.01..0.02).contains(&(began - DURING)), "{began} s");
    }
}

#[test]
fn a_bar_that_does_not_reach_is_refused_in_one_line_before_motion() {
    let file = cell(|cell| cell.robot[1].base.position[0] = 3.0);
    let error = ::mrroc::run(&file, BenchKind::Lockstep, hold_bar::hold).unwrap_err();
    let said = format!("{error:#}");
    assert!(
        said.contains("the grip of member 1 does not reach (1.500, 0.000, 0.860) m of the cell at 0.00 s"),
        "{said}"
    );
    assert!(!said.contains('\n'), "{said}");
}
