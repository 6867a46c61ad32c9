//! Arms whose brake does not hold, in runs of tasks.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::CellFile;
use ::mrroc::report::{RunOutcome, RunReport};
use ::mrroc::run::{Requests, RunOptions, run};
use ::mrroc::tasks::{Cell, Outcome, Program};
use controller::generator::{MotionLimits, Newsmooth, SmoothPose};
use controller::robot::Space;
use kit::mrroc::{Directory, example};

fn play(
    file: &CellFile,
    scenario: &str,
    task: impl AsyncFn(&mut Cell) -> Outcome + Send + Sync + 'static,
) -> RunReport {
    let directory = Directory::new();
    let scenario = Some(directory.write("scenario.toml", scenario));
    let options = RunOptions { scenario, ..RunOptions::on(BenchKind::Lockstep) };
    run(file, &options, &Requests::default(), &Program::of(task), &mut |_| {}).unwrap()
}

#[test]
fn an_arm_whose_brake_slips_after_a_power_off_is_held_by_its_motors() {
    let mut file = CellFile::read(example("polycrank")).unwrap();
    let home = file.arms[0].robot().home();
    for (number, axis) in file.cell.robot[0].axis.iter_mut().enumerate() {
        axis.emulator.start = Some(home[number]);
        axis.homing.method = Some(37);
    }
    let moved = Arc::new(Mutex::new(None));
    let seen = Arc::clone(&moved);
    let scenario = "seed = 1\n[[fault]]\nat = 2.0\nkind = \"brake-slips\"\naxis = \"q1\"\n";
    let report = play(&file, scenario, async move |cell: &mut Cell| {
        let mut robot = cell.robot("polycrank")?;
        robot.enable().await?;
        robot.home().await?;
        cell.sleep(Duration::from_secs(3)).await;
        let from = robot.image()?.measured.motors.position[0];
        robot.disable().await?;
        cell.sleep(Duration::from_millis(800)).await;
        let held = robot.image()?.measured.motors.position[0];
        cell.sleep(Duration::from_millis(400)).await;
        let later = robot.image()?.measured.motors.position[0];
        *seen.lock().unwrap() = Some((held - from, later - held));
        Ok(())
    });
    let (fell, then) = moved.lock().unwrap().unwrap();
    assert!((2.0..6.0).contains(&fell.abs()), "{fell} rad, {report}");
    assert!(then.abs() < 0.01, "{then} rad, {report}");
    assert!(report.faults.iter().any(|fault| fault.what.contains("brake does not hold")), "{report}");
}

#[test]
fn an_arm_that_fell_beyond_its_limit_moves_back_at_its_next_homing() {
    let mut file = CellFile::read(example("irb6")).unwrap();
    // A short search.
    let home = file.arms[0].robot().home();
    for (number, axis) in file.cell.robot[0].axis.iter_mut().enumerate() {
        axis.emulator.start = Some(home[number] + 2.0);
    }
    let most = file.cell.robot[0].axis[1].following_error + file.arms[0].robot().motor_limits()[1].high;
    let scenario = "seed = 1
[[fault]]
at = 16.0
duration = 2.0
kind = \"brake-slips\"
axis = \"lower-arm\"
[[fault]]
at = 16.0
duration = 2.0
kind = \"over-current\"
axis = \"lower-arm\"
";
    let report = play(&file, scenario, async move |cell: &mut Cell| {
        let mut robot = cell.robot("irb6")?;
        robot.enable().await?;
        robot.home().await?;
        let limits = MotionLimits::uniform(250.0, 1500.0, 15_000.0);
        let mut low = robot.image()?.commanded.motors.position;
        let high = low;
        (low[1], low[2]) = (low[1] + 60.0, low[2] + 25.0);
        let motion = |to| {
            Newsmooth::new(
                Space::Motor,
                5,
                limits,
                vec![SmoothPose { velocity: [0.2; 8], acceleration: [0.2; 8], position: to }],
            )
        };
        robot.execute(motion(low)?).await?;
        // The fault comes at rest.
        cell.sleep(Duration::from_secs(13)).await;
        if cell.rehearsing() {
            return Ok(());
        }
        let fell = robot.image()?.measured.motors.position[1];
        assert!(fell > most, "{fell} rad");
        robot.reset_fault().await?;
        robot.enable().await?;
        robot.home().await?;
        let back = robot.image()?.measured.motors.position[1];
        assert!(back < most - 3.0, "{back} rad");
        robot.execute(motion(high)?).await
    });
    assert_eq!(report.outcome, RunOutcome::Completed, "{report}");
}
