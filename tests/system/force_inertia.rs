//! The inertia of a heavy tool in the readings of its force sensor and in a force law, and offsets of a zeroing, in
//! lockstep.

use std::cell::{Cell as Shared, RefCell};
use std::time::Duration;

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::{Cell, CellFile};
use ::mrroc::prelude::{ForceTask, Generator, Guard, JerkLimited, Outcome, RunOutcome, Space, join};
use ::mrroc::report::RunReport;
use ::mrroc::tasks;
use controller::force::Wrench;
use kit::mrroc::Directory;

/// Contact force that ends a guarded motion, N.
const TOUCH: f64 = 6.0;

/// The cell of the force table without its blocks, and with a tool of 2 kg. The axes have no dry friction, whose
/// stick-slip vibrations the sensor measures, too.
fn heavy(change: impl FnOnce(&mut Cell)) -> CellFile {
    let directory = Directory::new();
    let path = directory.cell("irb6-force", |cell| {
        let sensor = &mut cell.force_sensor[0];
        (sensor.tool.mass, sensor.tool.centre) = (2.0, [0.0, 0.02, 0.12]);
        sensor.tool_inertia = [0.012, 0.011, 0.006];
        (sensor.force_range, sensor.torque_range) = ([130.0; 3], [20.0; 3]);
        // The set-point filters of the emulated drives lag 3 ms.
        sensor.tool_lag_s = 0.004;
        cell.scene = None;
        cell.task.clear();
        change(cell);
    });
    CellFile::read(path).unwrap()
}

/// Root of the mean square, and greatest value.
fn rms_and_peak(values: impl Iterator<Item = f64> + Clone) -> [f64; 2] {
    let (squares, count) = values.clone().fold((0.0, 0.0), |(sum, count), value| (sum + value * value, count + 1.0));
    [(squares / f64::max(count, 1.0)).sqrt(), values.fold(0.0, f64::max)]
}

/// A component of a reading and of the same sample without the inertia of the tool subtracted.
type Length = fn(&(Wrench, Wrench)) -> f64;

/// Moves fast in free space, first on the planned path, then with a guard that would end the motion at a touch.
async fn swing(cell: &mut tasks::Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    let wrist = cell.force_sensor("wrist")?;
    irb6.enable().await?;
    irb6.home().await?;
    let there = [0.0, -1.571, 0.0, 1.3, 0.0, 0.0, 0.0, 0.0];
    let away = [0.8, -1.4, 0.2, 0.8, 1.0, 0.0, 0.0, 0.0];
    let mut limits = irb6.motions().limits();
    limits.max_acceleration = limits.max_acceleration.map(|acceleration| 0.8 * acceleration);
    limits.max_jerk = limits.max_acceleration.map(|acceleration| 20.0 * acceleration);
    irb6.execute(JerkLimited::new(Space::Joint, 5, limits, &[there])?).await?;
    cell.sleep(Duration::from_millis(500)).await;
    wrist.zero().await?;
    let sensor = wrist.sensor();
    let guard = Guard { force: TOUCH, torque: 2.0, samples: 1 };
    let guarded = ForceTask { guard: Some(guard), ..ForceTask::default() };
    let (ended, seen) = (Shared::new(false), RefCell::new(Vec::new()));
    let motion = async {
        let outcome = async {
            irb6.execute(JerkLimited::new(Space::Joint, 5, limits, &[away])?).await?;
            irb6.execute(JerkLimited::new(Space::Joint, 5, limits, &[there])?.under(guarded)).await
        };
        let outcome = outcome.await;
        ended.set(true);
        outcome
    };
    let watch = async {
        while !ended.get() {
            // The weight of the tool alone is subtracted.
            let measured = Wrench::from_components(sensor.link().read().wrench) + sensor.zeroed_weight().read().1;
            let weight = sensor.weight().map_err(|error| tasks::TaskError::Refused(error.into()))?;
            seen.borrow_mut().push((wrist.read()?.1.in_sensor()?, measured - weight));
            cell.sleep(cell.file().cell.period()).await;
        }
        Outcome::Ok(())
    };
    join(motion, watch).await?;
    cell.figure("touched", f64::from(u8::from(irb6.has_touched())));
    let seen = seen.take();
    let figures: [(&str, Length); 4] = [
        ("force_n", |(read, _)| read.force.norm()),
        ("torque_nm", |(read, _)| read.torque.norm()),
        ("force_without_compensation_n", |(_, measured)| measured.force.norm()),
        ("torque_without_compensation_nm", |(_, measured)| measured.torque.norm()),
    ];
    for (name, of) in figures {
        let [rms, peak] = rms_and_peak(seen.iter().map(of));
        cell.figure(&format!("rms_{name}"), rms);
        cell.figure(&format!("peak_{name}"), peak);
    }
    irb6.disable().await
}

fn completed(file: &CellFile) -> RunReport {
    let report = ::mrroc::run(file, BenchKind::Lockstep, swing).unwrap();
    assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
    println!("{:#?}", report.figures);
    report
}

#[test]
fn a_fast_arm_with_a_heavy_tool_reads_no_contact_and_touches_nothing_in_free_space() {
    let figures = completed(&heavy(|_| {})).figures;
    // 2.7 N in place of 11.0 N, and 0.34 N·m in place of 1.21 N·m. The rest are jerks and vibrations.
    for (name, unit, most, least) in [("force", "n", 3.5, 10.0), ("torque", "nm", 0.45, 1.1)] {
        let [read, measured] = ["", "_without_compensation"].map(|part| figures[&format!("peak_{name}{part}_{unit}")]);
        assert!(read < most && measured > least, "{figures:?}");
        let [read, measured] = ["", "_without_compensation"].map(|part| figures[&format!("rms_{name}{part}_{unit}")]);
        assert!(read < 0.35 * measured, "{figures:?}");
    }
    // The inertia alone exceeds the threshold of the guard, which is that of a light tool.
    assert!(figures["peak_force_without_compensation_n"] > 1.5 * TOUCH, "{figures:?}");
    assert_eq!(figures["touched"], 0.0, "{figures:?}");
}

#[test]
fn a_zero_that_is_not_that_of_an_unloaded_sensor_is_refused_with_its_size() {
    // The arm at rest vibrates by single counts of its encoders. A single sample of the tool then reads up to 5 N too much,
    // in other samples after each pause.
    for pause in [0, 2, 4, 14] {
        zeroed_after(Duration::from_millis(pause));
    }
}

/// Zeroes the sensor of an arm at rest, `pause` after homing.
fn zeroed_after(pause: Duration) {
    let run = |file: &CellFile| {
        let zero = async move |cell: &mut tasks::Cell| {
            let (mut irb6, wrist) = (cell.robot("irb6")?, cell.force_sensor("wrist")?);
            irb6.enable().await?;
            irb6.home().await?;
            cell.sleep(pause).await;
            wrist.zero().await?;
            irb6.disable().await
        };
        ::mrroc::run(file, BenchKind::Lockstep, zero).unwrap()
    };
    // A fifth of the range of 65 N is 13 N.
    let offset = |force: f64, greatest: Option<[f64; 6]>| {
        heavy(|cell| {
            let sensor = &mut cell.force_sensor[0];
            (sensor.force_range, sensor.max_offset) = ([65.0; 3], greatest);
            sensor.emulator.offset[1] = force;
            cell.robot[0].force_law = None;
        })
    };
    let accepted = [offset(-12.5, None), offset(20.0, Some([25.0, 25.0, 25.0, 1.0, 1.0, 1.0]))];
    for file in accepted {
        let report = run(&file);
        assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
    }
    let report = run(&offset(-20.0, None));
    assert_ne!(report.outcome, RunOutcome::Completed);
    let faults: Vec<_> = report.faults.iter().map(ToString::to_string).collect();
    let value = |fault: &String| {
        let (value, rest) = fault.strip_prefix("force sensor wrist: not zeroed, Fy reads ")?.split_once(' ')?;
        rest.contains("at most 13.00").then(|| value.parse::<f64>().unwrap())
    };
    // The mean of the vibration is less than a count of the sensor.
    let value = faults.iter().find_map(value).unwrap_or_else(|| panic!("{faults:?}"));
    assert!((value + 20.0).abs() < 0.05, "{pause:?}: {faults:?}");
}
