//! Ultrasonic matrices and touch probes: from the emulated world over the wire to the task, in lockstep.

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::{Cell, CellFile};
use ::mrroc::prelude::{Outcome, RunOutcome};
use ::mrroc::report::RunReport;
use ::mrroc::tasks;
use drive::ultrasonic::ScanKind;
use kit::mrroc::{Directory, example};

#[path = "../../examples/locate_box.rs"]
#[expect(dead_code, reason = "the program of the example has a main of its own")]
mod locate_box;

#[path = "../../examples/until_touch.rs"]
#[expect(dead_code, reason = "the program of the example has a main of its own")]
mod until_touch;

/// A cell of the examples after a change.
fn cell(name: &str, change: impl FnOnce(&mut Cell)) -> CellFile {
    CellFile::read(Directory::new().cell(name, change)).unwrap()
}

fn locate(change: impl FnOnce(&mut Cell)) -> RunReport {
    ::mrroc::run(&cell("irb6-sonar", change), BenchKind::Lockstep, locate_box::locate).unwrap()
}

fn faults(report: &RunReport) -> Vec<&str> {
    report.faults.iter().map(|fault| fault.what.as_str()).collect()
}

#[test]
fn box_is_located_within_3_mm_with_one_echo_in_ten_lost() {
    for (seed, x, z) in [(1, 0.713, 0.887), (2, 0.68, 0.93), (3, 0.745, 0.865)] {
        let report = locate(|cell| {
            cell.seed = seed;
            let block = &mut cell.scene.as_mut().unwrap().block[0];
            (block.centre[0], block.centre[2]) = (x, z);
            assert_eq!(cell.ultrasonic[0].emulator.lost_echoes, 0.1);
        });
        assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
        let figure = |name: &str| report.figures[name];
        // The near face of the box is at 0.45 m.
        let error = [figure("box_x_m") - x, figure("face_y_m") - 0.45, figure("box_z_m") - z];
        let size = error.iter().map(|part| part * part).sum::<f64>().sqrt();
        println!("seed {seed}: {:.2?} mm, stated {:.2} mm", error.map(|part| 1e3 * part), figure("deviation_x_mm"));
        assert!(size < 3e-3, "seed {seed}: {error:?} m");
    }
}

#[test]
fn lost_box_and_lost_echoes_end_the_task_by_a_typed_error() {
    let away = locate(|cell| cell.scene.as_mut().unwrap().block[0].centre[0] = 5.0);
    assert_eq!(away.outcome, RunOutcome::Faulted);
    assert!(faults(&away)[0].contains("ultrasonic matrix matrix: no box of 0.05 m height is in view"), "{away:?}");
    let lost = locate(|cell| cell.ultrasonic[0].emulator.lost_echoes = 1.0);
    assert!(faults(&lost)[0].contains("0 of 144 elements have an echo, 72 are needed"), "{lost:?}");
}

#[test]
fn silence_of_the_matrix_ends_the_task_by_its_fault() {
    let report = locate(|cell| cell.ultrasonic[0].emulator.silent_from_s = Some(14.0));
    assert_eq!(report.outcome, RunOutcome::Faulted);
    let faults = faults(&report);
    assert!(faults.iter().any(|what| what.starts_with("ultrasonic matrix matrix: no reply to")), "{faults:?}");
    assert!(!faults.iter().any(|what| what.contains("still has power")), "{faults:?}");
}

/// The cell of the example with a matrix of 4 × 4 elements that scans all pairs, without noise and lost echoes.
fn of_pairs(cell: &mut Cell) {
    let matrix = &mut cell.ultrasonic[0];
    (matrix.size, matrix.scan) = (4, ScanKind::Pairs);
    (matrix.emulator.noise, matrix.emulator.lost_echoes) = (Some(0.0), 0.0);
}

/// Puts the echo times of pairs with element (0, 0), and their number, into the figures.
async fn echoes(cell: &mut tasks::Cell) -> Outcome {
    let scan = cell.ultrasonic("matrix")?.scan().await?;
    let echoes = (0..16).flat_map(|from| (0..16).filter_map(move |to| Some(((from, to), scan.echo(from, to)?))));
    let echoes: Vec<_> = echoes.collect();
    cell.figure("echoes", echoes.len() as f64);
    for ((from, to), time) in echoes.into_iter().filter(|((from, to), _)| *from == 0 || *to == 0) {
        cell.figure(&format!("echo_s_{from}_{to}"), time.as_secs_f64());
    }
    Ok(())
}

#[test]
fn scan_of_pairs_has_the_echo_of_each_pair_over_the_serial_line() {
    let file = cell("irb6-sonar", |cell| {
        of_pairs(cell);
        // The wall alone reflects.
        cell.scene.as_mut().unwrap().block[0].centre[0] = 5.0;
    });
    let report = ::mrroc::run(&file, BenchKind::Lockstep, echoes).unwrap();
    assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
    // The wall is at 0.35 m. The point of reflection is in both cones: 0.35 m · tan 8° = 49 mm from each element.
    assert_eq!(report.figures["echoes"], 256.0);
    for to in 0..16_u8 {
        let apart = 0.02 * f64::from(to / 4).hypot(f64::from(to % 4));
        let expected = 2.0 * (apart / 2.0).hypot(0.35) / 343.0;
        for name in [format!("echo_s_0_{to}"), format!("echo_s_{to}_0")] {
            // The resolution is 1 µs. The echo of a neighbour is 0.8 µs later than the own echo.
            assert!((report.figures[&name] - expected).abs() < 0.51e-6, "{name}: {:?}", report.figures);
        }
    }
    let silent = cell("irb6-sonar", |cell| {
        of_pairs(cell);
        cell.ultrasonic[0].emulator.silent_from_s = Some(2.0);
    });
    let report = ::mrroc::run(&silent, BenchKind::Lockstep, echoes).unwrap();
    assert!(faults(&report)[0].starts_with("ultrasonic matrix matrix: no reply to"), "{report:?}");
}

#[test]
fn absent_matrix_and_matrix_of_another_size_are_refused_before_motion() {
    let refused = |change: fn(&mut Cell)| {
        let file = cell("irb6-sonar", change);
        ::mrroc::run(&file, BenchKind::Lockstep, locate_box::locate).unwrap_err().to_string()
    };
    let line = "ultrasonic matrix matrix, line /dev/serial/by-id/usb-matrix: ";
    let absent = refused(|cell| cell.ultrasonic[0].emulator.absent = true);
    assert!(absent.starts_with(&format!("{line}no answer, waited")), "{absent}");
    let other = refused(|cell| cell.ultrasonic[0].emulator.size = Some(8));
    assert_eq!(other, format!("{line}the matrix has 8 × 8 elements, declared were 12 × 12"));
    let file = CellFile::read(example("irb6")).unwrap();
    let unknown = ::mrroc::run(&file, BenchKind::Lockstep, locate_box::locate).unwrap_err().to_string();
    assert!(unknown.contains("the cell has no ultrasonic matrix \"matrix\": add it as [[ultrasonic]]"), "{unknown}");
}

#[test]
fn arm_stops_where_its_touch_probe_meets_a_block() {
    for face in [0.25, 0.15] {
        let file = cell("irb6-probe", |cell| cell.scene.as_mut().unwrap().block[0].centre[1] = face + 0.05);
        let report = ::mrroc::run(&file, BenchKind::Lockstep, until_touch::find).unwrap();
        assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
        // The tip has a radius of 3 mm. From the touch to the stop the arm moves on for some hundredths of a second.
        let depth = report.figures["touched_at_y_m"] + 0.003 - face;
        println!("face at {face} m: {:.2} mm deep", 1e3 * depth);
        assert!((0.0..4e-3).contains(&depth), "face at {face} m: {depth} m deep");
    }
}

#[test]
fn arm_without_a_block_ends_its_search() {
    let file = cell("irb6-probe", |cell| cell.scene.as_mut().unwrap().block[0].centre[1] = 5.0);
    let report = ::mrroc::run(&file, BenchKind::Lockstep, until_touch::find).unwrap();
    assert_eq!(report.outcome, RunOutcome::Faulted);
    assert!(faults(&report)[0].contains("the probe met nothing on its way"), "{:?}", report.faults);
}
