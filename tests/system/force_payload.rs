//! A part that a gripper picks up in the emulated scene, and its weight in the compensation of the force sensor.

use std::f64::consts::FRAC_PI_2;
use std::time::Duration;

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::Cell;
use ::mrroc::prelude::{
    Compliance, Direction, ForceTask, Generator, LineLimits, Outcome, StraightLine, TaskError, Wait,
};
use ::mrroc::prelude::{RunOutcome, RunReport};
use ::mrroc::recording::{ReplayOptions, replay};
use ::mrroc::run::{Requests, RunOptions};
use ::mrroc::tasks::{self, ForceSensor, Program};
use kit::mrroc::Directory;
use nalgebra::Vector3;

/// Mass of the part, kg.
const MASS: f64 = 1.2;

/// Weight of the part, N.
const WEIGHT: f64 = MASS * 9.81;

/// The centre of the part in the frame of the sensor, m: the gripper is 200 mm beyond the sensor, and takes the part 7 mm
/// above its centre.
const CENTRE: [f64; 3] = [0.0, 0.0, 0.207];

/// The cell of two arms with a short bar in front of the left one.
fn short_bar(cell: &mut Cell) {
    let bar = &mut cell.scene.as_mut().unwrap().bar[0];
    (bar.mass, bar.length, bar.place.position) = (MASS, 0.1, [0.67, 0.0, 0.8]);
}

/// Largest absolute force, N, and torque about the origin of the sensor, N·m, of the compensated reading: the mean of 0.2 s.
async fn reading(cell: &tasks::Cell, wrist: &ForceSensor) -> Result<[f64; 2], TaskError> {
    let (mut force, mut torque) = (Vector3::zeros(), Vector3::zeros());
    for _ in 0..100 {
        let wrench = wrist.read()?.1.in_sensor()?;
        (force, torque) = (force + wrench.force / 100.0, torque + wrench.torque / 100.0);
        cell.sleep(cell.file().cell.period()).await;
    }
    Ok([force.norm(), torque.norm()])
}

/// Picks the part up, tells the sensor, turns the part, yields to the rest of the force, and drops the part.
async fn pick(cell: &mut tasks::Cell) -> Outcome {
    let mut left = cell.robot("left")?;
    let (wrist, jaws) = (cell.force_sensor("left-wrist")?, cell.output("left-gripper")?);
    let observer = left.observer();
    left.enable().await?;
    left.home().await?;
    left.execute(left.motions().joints(0.5, &[[0.0, -1.571, 0.0, FRAC_PI_2, 0.0]])?).await?;
    cell.sleep(Duration::from_millis(300)).await;
    wrist.zero().await?;
    jaws.set(true);
    cell.sleep(Duration::from_millis(200)).await;
    let limits = LineLimits {
        max_velocity: 0.05,
        max_acceleration: 0.5,
        max_jerk: 20.0,
        max_angular_velocity: 0.5,
        max_angular_acceleration: 5.0,
        max_angular_jerk: 100.0,
    };
    let mut above = observer.image()?.commanded.pose;
    above.translation.z += 0.05;
    left.execute(StraightLine::new(left.motions().arm().clone(), above, limits, left.motions().limits())?).await?;
    cell.sleep(Duration::from_millis(500)).await;
    let note = |name: &str, [force, torque]: [f64; 2]| {
        cell.figure(&format!("{name}_n"), force);
        cell.figure(&format!("{name}_nm"), torque);
    };
    note("untold", reading(cell, &wrist).await?);
    wrist.set_payload(MASS, CENTRE)?;
    note("told", reading(cell, &wrist).await?);
    let [column, lower, upper, pitch, roll, ..] = observer.image()?.commanded.joints.position;
    left.execute(left.motions().joints(0.5, &[[column, lower, upper, pitch - 0.5, roll]])?).await?;
    cell.sleep(Duration::from_millis(500)).await;
    note("turned", reading(cell, &wrist).await?);
    // A law that yields to every force stays where the sensor has no contact.
    let compliance = Compliance::LINEAR;
    let mut task = ForceTask::default();
    task.directions[..3].fill(Direction::Contact { force: 0.0, compliance });
    let before = observer.image()?.commanded.pose.translation.vector;
    left.execute(Wait { duration: Duration::from_secs(1) }.under(task)).await?;
    let moved = observer.image()?.commanded.pose.translation.vector - before;
    cell.figure("yields_mm", 1e3 * moved.norm());
    jaws.set(false);
    wrist.set_payload(0.0, CENTRE)?;
    cell.sleep(Duration::from_millis(500)).await;
    note("dropped", reading(cell, &wrist).await?);
    left.disable().await
}

fn run(directory: &Directory, options: &RunOptions) -> RunReport {
    let file = ::mrroc::cell::CellFile::read(directory.cell("two-irb6-bar", short_bar)).unwrap();
    ::mrroc::run::run(&file, options, &Requests::default(), &Program::of(pick), &mut |_| {}).unwrap()
}

#[test]
fn a_part_that_is_picked_up_is_compensated_once_the_sensor_is_told_and_the_run_replays_bit_for_bit() {
    let directory = Directory::new();
    let recording = directory.path("pick.mcap");
    let report =
        run(&directory, &RunOptions { record: Some(recording.clone()), ..RunOptions::on(BenchKind::Lockstep) });
    assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
    println!("{:#?}", report.figures);
    let figure = |name: &str| report.figures[name];
    // Two counts of the sensor, and its place at the part.
    assert!((figure("untold_n") - WEIGHT).abs() < 0.3, "{:?}", report.figures);
    for name in ["told", "turned", "dropped"] {
        let [force, torque] = ["n", "nm"].map(|unit| figure(&format!("{name}_{unit}")));
        assert!(force < 0.3 && torque < 0.1, "{name}: {force} N, {torque} N·m");
    }
    assert!(figure("yields_mm") < 2.0, "{:?}", report.figures);
    // The law has taken the payload from the task.
    let replay = replay(&recording, &ReplayOptions::default()).unwrap();
    assert!(replay.is_equal(), "{replay}");
}
