//! Two arms that hold one bar: path, internal force, and stops after faults, by the truth of the emulated scene.

use ::mrroc::bench::BenchKind;
use ::mrroc::prelude::RunOutcome;
use kit::held_bar::{Run, cell, check_stop, course, faulted, hold, run};

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
    let Run { report, truth, .. } = run(&cell(|_| ()), hold);
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

/// Time in the first leg of the course at its greatest speed, s since the emulated devices were switched on.
const DURING: f64 = 19.5;

#[test]
fn a_wrist_that_falls_silent_stops_both_arms_and_does_not_tear_the_bar() {
    let run = faulted(|_| (), |cell| cell.force_sensor[1].emulator.silent_from_s = Some(DURING));
    let began = check_stop("right wrist silent", &run);
    // Three missing samples are tolerated, and the macrostep that has begun ends.
    assert!((0.0..0.05).contains(&(began - DURING)), "{began} s");
    let faults = &run.report.faults;
    assert!(faults.iter().any(|fault| fault.what.contains("force sensor")), "{faults:?}");
}

#[test]
fn a_drive_that_trips_stops_both_arms_and_does_not_tear_the_bar() {
    for axis in 0..5 {
        let run = faulted(|_| (), |cell| cell.robot[1].axis[axis].emulator.trips_at_s = Some(DURING));
        let began = check_stop(&format!("axis {axis} of the right arm trips"), &run);
        assert!((-0.01..0.02).contains(&(began - DURING)), "{began} s");
    }
}

#[test]
fn a_bar_that_does_not_reach_is_refused_in_one_line_before_motion() {
    let file = cell(|cell| cell.robot[1].base.position[0] = 3.0);
    let error = ::mrroc::run(&file, BenchKind::Lockstep, hold).unwrap_err();
    let said = format!("{error:#}");
    assert!(
        said.contains("the grip of member 1 does not reach (1.500, 0.000, 0.860) m of the cell at 0.00 s"),
        "{said}"
    );
    assert!(!said.contains('\n'), "{said}");
}
