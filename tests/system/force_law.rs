//! Force control in the servo cycle: from the cell file to the figures of the examples, in lockstep.

use std::fs;
use std::time::Duration;

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::{Cell, CellFile};
use ::mrroc::prelude::{
    Compliance, Direction, ForceTask, Generator, Guard, LineLimits, Outcome, RunOutcome, StraightLine, Wait, join,
};
use ::mrroc::report::RunReport;
use ::mrroc::tasks;
use controller::robot::Joints;
use hil::AxisConfig;
use hil::plant::{Irp6Axis, Mechanism, MechanismConfig, PlantAxis};
use kit::mrroc::{Directory, example, text};

#[path = "../../examples/force_table.rs"]
#[expect(dead_code, reason = "the program of the example has a main of its own")]
mod force_table;

#[path = "../../examples/guarded_approach.rs"]
#[expect(dead_code, reason = "the program of the example has a main of its own")]
mod guarded_approach;

fn cell(name: &str, change: impl FnOnce(&mut Cell)) -> CellFile {
    let directory = Directory::new();
    CellFile::read(directory.cell(name, change)).unwrap()
}

fn completed(report: &RunReport) {
    assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
}

#[test]
fn steps_of_the_force_have_the_overshoot_settling_and_stability_of_the_force_table() {
    let file = CellFile::read(example("irb6-force")).unwrap();
    let report = ::mrroc::run(&file, BenchKind::Lockstep, force_table::table).unwrap();
    completed(&report);
    let figures = &report.figures;
    println!("{figures:#?}");
    assert_eq!(figures.keys().filter(|name| name.starts_with("overshoot_percent_")).count(), 4, "{figures:?}");
    assert!(figures["worst_row_error_percent"] <= 5.0, "{figures:?}");
    assert!((31.5..=38.5).contains(&figures["stability_limit_kn_per_m"]), "{figures:?}");
    // The same law once per macrostep is stable only against softer blocks.
    assert!(figures["macrostep_stability_limit_kn_per_m"] < 15.0, "{figures:?}");
}

#[test]
fn worst_error_of_the_force_table_is_nan_if_an_error_is_nan_or_missing() {
    for errors in [vec![], vec![f64::NAN], vec![f64::NAN, 1.0], vec![1.0, f64::NAN], vec![1.0, f64::NAN, 2.0]] {
        assert!(force_table::worst(&errors).is_nan(), "{errors:?}");
    }
    for errors in [[1.0, 3.0, 2.0], [3.0, 2.0, 1.0], [0.0, 0.0, 3.0]] {
        assert_eq!(force_table::worst(&errors), 3.0, "{errors:?}");
    }
}

#[test]
fn the_peak_force_of_a_guarded_approach_is_within_the_kinetic_bound() {
    let file = CellFile::read(example("irb6-guarded")).unwrap();
    let report = ::mrroc::run(&file, BenchKind::Lockstep, guarded_approach::approach).unwrap();
    completed(&report);
    println!("{:#?}", report.figures);
    assert_eq!(report.figures.keys().filter(|name| name.starts_with("peak_n_")).count(), 9);
    assert!(report.figures["worst_peak_to_bound"] <= 1.1, "{:?}", report.figures);
}

/// The mass in the cell file, from which the example computes its bound, is that of the emulated arm.
#[test]
fn the_effective_mass_of_the_guarded_approach_is_that_of_the_mechanism() {
    let file = CellFile::read(example("irb6-guarded")).unwrap();
    let (arm, tool) = (&file.arms[0], file.cell.robot[0].tool);
    let above = Joints::new(&[0.0, -1.571, 0.0, std::f64::consts::FRAC_PI_2, 0.0]).unwrap();
    let (motors, home) = (arm.robot().motors_from_joints(&above).unwrap(), arm.robot().home());
    let mechanism = Mechanism::new(MechanismConfig::Irb6);
    for (number, (&angle, &zero)) in motors.iter().zip(home.iter()).enumerate() {
        let axis = AxisConfig { start_angle: angle, ..AxisConfig::wut(Irp6Axis::Column) };
        PlantAxis::mounted(&axis, 1, Some(&mechanism.mount(number, zero).unwrap()));
    }
    let found = mechanism.effective_mass(tool, [0.0, 0.0, 1.0]);
    let text = text("irb6-guarded");
    let given: f64 = text.split_once("effective_mass = ").unwrap().1.split_once('\n').unwrap().0.parse().unwrap();
    assert!((found - given).abs() < 0.01 * given, "{found} kg");
}

/// Presses on the third block, for ten seconds or until the law ends the motion.
async fn press(cell: &mut tasks::Cell, task: ForceTask) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    let wrist = cell.force_sensor("wrist")?;
    irb6.enable().await?;
    irb6.home().await?;
    let column = cell.file().cell.scene.as_ref().map_or(0.0, |scene| {
        let [x, y, _] = scene.block[2].centre;
        y.atan2(x)
    });
    irb6.execute(irb6.motions().joints(0.8, &[[column, -1.571, 0.0, std::f64::consts::FRAC_PI_2, 0.0]])?).await?;
    wrist.zero().await?;
    let outcome = irb6.execute(Wait { duration: Duration::from_secs(10) }.under(task)).await;
    cell.figure("touched", f64::from(u8::from(irb6.has_touched())));
    outcome?;
    // The next motion begins where the law has moved the arm.
    irb6.execute(irb6.motions().joints(0.3, &[[column, -1.571, 0.0, std::f64::consts::FRAC_PI_2, 0.0]])?).await?;
    irb6.disable().await
}

fn pressing(force: f64, guard: Option<Guard>) -> ForceTask {
    let mut task = ForceTask { guard, ..ForceTask::default() };
    task.directions[2] = Direction::Contact { force, compliance: Compliance::LINEAR };
    task
}

#[test]
fn a_touch_ends_a_motion_with_success_and_the_next_motion_begins_there() {
    let guard = Some(Guard { force: 3.0, torque: 1e3, samples: 2 });
    let task = async move |cell: &mut tasks::Cell| press(cell, pressing(5.0, guard)).await;
    let report = ::mrroc::run(&cell("irb6-force", |_| {}), BenchKind::Lockstep, task).unwrap();
    completed(&report);
    assert_eq!(report.figures["touched"], 1.0);
}

/// Each end of the law by a fault is one line with the robot and the cause, and the drives are switched off.
#[test]
fn a_law_that_cannot_go_on_stops_the_robot_with_a_fault_that_names_the_cause() {
    type Change = fn(&mut Cell);
    let cases: [(&str, f64, Change); 4] = [
        ("cycle law: channel 2 of its sensor measures -1", 30.0, |cell| {
            cell.robot[0].force_law.as_mut().unwrap().force[2] = 10.0;
        }),
        ("cycle law displaces by", 5.0, |cell| {
            cell.robot[0].force_law.as_mut().unwrap().displacement = vec![0.5; 5];
        }),
        ("cycle law: no sample for 4 cycles", 5.0, |cell| cell.force_sensor[0].emulator.silent_from_s = Some(15.0)),
        // The limit of the law is the range of the sensor.
        ("force sensor wrist: Fz went beyond its range", 29.0, |cell| {
            cell.force_sensor[0].force_range[2] = 15.0;
            cell.robot[0].force_law.as_mut().unwrap().force[2] = 15.0;
        }),
    ];
    for (expected, force, change) in cases {
        let task = async move |cell: &mut tasks::Cell| press(cell, pressing(force, None)).await;
        let report = ::mrroc::run(&cell("irb6-force", change), BenchKind::Lockstep, task).unwrap();
        assert_eq!(report.outcome, RunOutcome::Faulted, "{expected}");
        let faults: Vec<_> = report.faults.iter().map(|fault| fault.to_string()).collect();
        assert!(faults.iter().any(|fault| fault.contains(expected)), "{expected}: {faults:?}");
        assert!(!faults.iter().any(|fault| fault.contains("still has power")), "{faults:?}");
    }
}

#[test]
fn a_law_whose_sensor_was_not_zeroed_stops_before_it_moves_the_arm() {
    let task = async |cell: &mut tasks::Cell| {
        let mut irb6 = cell.robot("irb6")?;
        irb6.enable().await?;
        irb6.home().await?;
        irb6.execute(Wait { duration: Duration::from_secs(1) }.under(pressing(5.0, None))).await
    };
    let report = ::mrroc::run(&cell("irb6-force", |_| {}), BenchKind::Lockstep, task).unwrap();
    let faults: Vec<_> = report.faults.iter().map(ToString::to_string).collect();
    assert_eq!(report.outcome, RunOutcome::Faulted);
    assert!(faults[0].starts_with("irb6: cycle law: its sensor was not zeroed"), "{faults:?}");
}

#[test]
fn a_generator_that_sends_a_law_to_a_robot_without_one_is_refused_before_motion() {
    let task = async |cell: &mut tasks::Cell| press(cell, pressing(5.0, None)).await;
    let file = cell("irb6-force", |cell| cell.robot[0].force_law = None);
    let error = ::mrroc::run(&file, BenchKind::Lockstep, task).unwrap_err().to_string();
    assert!(error.contains("robot irb6: instruction") && error.contains("law"), "{error}");
}

/// Moves the tool down beside the blocks by a force law: for one second of motion time, and again with a pause.
async fn approach_in_air(cell: &mut tasks::Cell, direction: Direction, fraction: f64) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    let wrist = cell.force_sensor("wrist")?;
    let observer = irb6.observer();
    irb6.enable().await?;
    irb6.home().await?;
    irb6.execute(irb6.motions().joints(0.8, &[[1.3, -1.571, 0.0, std::f64::consts::FRAC_PI_2, 0.0]])?).await?;
    wrist.zero().await?;
    cell.speed().set(fraction).unwrap();
    cell.sleep(Duration::from_secs(1)).await;
    let mut task = ForceTask::default();
    task.directions[2] = direction;
    let approach = Wait { duration: Duration::from_secs(1) }.under(task);
    let begin = observer.image()?.commanded.pose.translation.z;
    irb6.execute(approach).await?;
    cell.figure("way_mm", 1e3 * (begin - observer.image()?.commanded.pose.translation.z));
    let pause = async {
        cell.sleep(Duration::from_millis(300)).await;
        cell.speed().pause();
        cell.sleep(Duration::from_secs(2)).await;
        let begin = observer.image()?.commanded.pose.translation.z;
        cell.sleep(Duration::from_secs(1)).await;
        cell.figure("way_in_pause_mm", 1e3 * (begin - observer.image()?.commanded.pose.translation.z));
        cell.speed().resume();
        Outcome::Ok(())
    };
    join(irb6.execute(approach), pause).await?;
    irb6.disable().await
}

#[test]
fn a_speed_override_and_a_pause_slow_the_approach_of_every_force_law() {
    let compliance = Compliance::LINEAR;
    let directions = [
        Direction::Unguarded { velocity: 0.02 },
        Direction::Guarded { velocity: 0.02, compliance },
        Direction::Contact { force: 4.0, compliance },
        // A spring to the place where the law began: without a force, it moves nothing.
        Direction::Admittance { stiffness: 500.0, compliance },
    ];
    for direction in directions {
        for fraction in [0.25, 1.0] {
            let task = async move |cell: &mut tasks::Cell| approach_in_air(cell, direction, fraction).await;
            let report = ::mrroc::run(&cell("irb6-force", |_| {}), BenchKind::Lockstep, task).unwrap();
            completed(&report);
            let [way, paused] = ["way_mm", "way_in_pause_mm"].map(|name| report.figures[name]);
            println!("{direction:?} at {fraction}: {way:.3} mm, {paused:.5} mm in a pause");
            // 20 mm in 1 s of motion time, less the way lost while the virtual inertia accelerates for 0.1 s.
            let lost = if matches!(direction, Direction::Unguarded { .. }) { 0.2 } else { 2.2 * fraction };
            // A spring follows the residual of the sensor also in a pause: one count is 0.3 mm.
            let (right, most) = match direction {
                Direction::Admittance { .. } => (way.abs() < 0.3, 0.3),
                _ => ((20.0 - lost..=20.2).contains(&way), 1e-3),
            };
            assert!(right, "{direction:?} at {fraction}: {way} mm");
            assert!(paused.abs() < most, "{direction:?} at {fraction}: {paused} mm in a pause");
        }
    }
}

/// Presses a block at a fraction of the speed, and pauses in contact.
async fn press_and_pause(cell: &mut tasks::Cell, direction: Direction, fraction: f64) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    let wrist = cell.force_sensor("wrist")?;
    irb6.enable().await?;
    irb6.home().await?;
    let column = cell.file().cell.scene.as_ref().map_or(0.0, |scene| {
        let [x, y, _] = scene.block[2].centre;
        y.atan2(x)
    });
    irb6.execute(irb6.motions().joints(0.8, &[[column, -1.571, 0.0, std::f64::consts::FRAC_PI_2, 0.0]])?).await?;
    wrist.zero().await?;
    cell.speed().set(fraction).unwrap();
    let pause = async {
        // The force has settled.
        cell.sleep(Duration::from_secs_f64(4.0 / fraction)).await;
        cell.figure("before_n", wrist.in_tool()?.force.z.abs());
        cell.speed().pause();
        cell.sleep(Duration::from_secs(4)).await;
        cell.figure("paused_n", wrist.in_tool()?.force.z.abs());
        cell.speed().resume();
        Outcome::Ok(())
    };
    let mut task = ForceTask::default();
    task.directions[2] = direction;
    join(irb6.execute(Wait { duration: Duration::from_secs(6) }.under(task)), pause).await?;
    irb6.disable().await
}

#[test]
fn the_force_of_a_contact_is_the_same_at_each_speed_and_in_a_pause() {
    let compliance = Compliance::LINEAR;
    // The laws that press: the guarded one with the velocity that its compliance turns into 5 N.
    for direction in [Direction::Contact { force: 5.0, compliance }, Direction::Guarded { velocity: 0.025, compliance }]
    {
        for fraction in [0.25, 1.0] {
            let task = async move |cell: &mut tasks::Cell| press_and_pause(cell, direction, fraction).await;
            let report = ::mrroc::run(&cell("irb6-force", |_| {}), BenchKind::Lockstep, task).unwrap();
            completed(&report);
            // Two counts of the sensor.
            for name in ["before_n", "paused_n"] {
                let right = (report.figures[name] - 5.0).abs() < 0.3;
                assert!(right, "{direction:?} at {fraction}, {name}: {:?}", report.figures);
            }
        }
    }
}

/// Stiffness of the spring of an admittance, N/m: that of the third block.
const SPRING: f64 = 3000.0;

/// A line ends 2 mm inside the third block under an admittance. Two waits follow, and a line that ends 20 mm above the
/// block. `between`: a wait without a law stands between the first line and the waits.
async fn spring_over_instructions(cell: &mut tasks::Cell, between: bool) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    let wrist = cell.force_sensor("wrist")?;
    let observer = irb6.observer();
    irb6.enable().await?;
    irb6.home().await?;
    let ([x, y, _], surface) = cell.file().cell.scene.as_ref().map_or(([0.0; 3], 0.0), |scene| {
        let block = &scene.block[2];
        (block.centre, block.centre[2] + block.size[2] / 2.0)
    });
    irb6.execute(irb6.motions().joints(0.8, &[[y.atan2(x), -1.571, 0.0, std::f64::consts::FRAC_PI_2, 0.0]])?).await?;
    let limits = LineLimits {
        max_velocity: 0.02,
        max_acceleration: 0.5,
        max_jerk: 20.0,
        max_angular_velocity: 0.5,
        max_angular_acceleration: 5.0,
        max_angular_jerk: 100.0,
    };
    let pose = observer.image()?.commanded.pose;
    let (arm, joints) = (irb6.motions().arm().clone(), irb6.motions().limits());
    let at = |above: f64| {
        let mut pose = pose;
        pose.translation.z = surface + above;
        pose
    };
    let line = |above: f64| StraightLine::new(arm.clone(), at(above), limits, joints);
    irb6.execute(line(0.01)?).await?;
    cell.sleep(Duration::from_millis(300)).await;
    wrist.zero().await?;
    let mut task = ForceTask::default();
    task.directions[2] = Direction::Admittance { stiffness: SPRING, compliance: Compliance::LINEAR };
    let wait = Wait { duration: Duration::from_secs(3) };
    irb6.execute(line(-0.002)?.under(task)).await?;
    if between {
        irb6.execute(Wait { duration: Duration::from_millis(100) }).await?;
    }
    for name in ["first_n", "second_n"] {
        irb6.execute(wait.under(task)).await?;
        cell.figure(name, wrist.in_tool()?.force.z.abs());
    }
    irb6.execute(line(0.02)?.under(task)).await?;
    irb6.execute(wait.under(task)).await?;
    let error = observer.image()?.commanded.pose.translation.vector - at(0.02).translation.vector;
    cell.figure("off_path_mm", 1e3 * error.norm());
    irb6.disable().await
}

#[test]
fn the_spring_of_an_admittance_keeps_force_and_path_from_one_instruction_to_the_next() {
    let task = async |cell: &mut tasks::Cell| spring_over_instructions(cell, false).await;
    let report = ::mrroc::run(&cell("irb6-force", |_| {}), BenchKind::Lockstep, task).unwrap();
    completed(&report);
    println!("{:?}", report.figures);
    // Two springs in series share 2 mm: 3 N. A count of the sensor is 0.087 N, and its residual moves the spring.
    for name in ["first_n", "second_n"] {
        assert!((report.figures[name] - 3.0).abs() < 0.25, "{name}: {:?}", report.figures);
    }
    assert!(report.figures["off_path_mm"] < 0.1, "{:?}", report.figures);
}

#[test]
fn an_instruction_without_a_law_gives_up_the_displacement_of_the_spring() {
    let task = async |cell: &mut tasks::Cell| spring_over_instructions(cell, true).await;
    let report = ::mrroc::run(&cell("irb6-force", |_| {}), BenchKind::Lockstep, task).unwrap();
    completed(&report);
    println!("{:?}", report.figures);
    // The spring begins anew where the arm stands, and yields to the force that is there.
    assert!(report.figures["first_n"] < 2.5, "{:?}", report.figures);
    assert!((report.figures["second_n"] - report.figures["first_n"]).abs() < 0.3, "{:?}", report.figures);
}

#[test]
fn a_force_law_without_a_limit_is_refused_with_file_line_and_key() {
    let directory = Directory::new();
    let whole = fs::read_to_string(example("irb6-force")).unwrap();
    for key in ["force", "torque", "displacement", "velocity", "acceleration"] {
        let (before, law) = whole.split_once("[robot.force_law]").unwrap();
        let kept: Vec<_> = law.lines().filter(|line| !line.starts_with(&format!("{key} = "))).collect();
        let path = directory.write("cell.toml", &format!("{before}[robot.force_law]{}", kept.join("\n")));
        let error = CellFile::read(&path).err().unwrap().to_string();
        assert!(error.contains(&format!("robot[0].force_law.{key}: is missing")), "{error}");
    }
}
