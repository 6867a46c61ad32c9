//! Contours of an emulated arm in lockstep.

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::CellFile;
use ::mrroc::prelude::{Cell, Outcome, RunOutcome, TaskError};
use controller::generator::{Contour, FeedLimits};
use controller::path::{BSpline, Curve, Path, SplineEnds};
use kit::mrroc::example;
use nalgebra::Vector3;

/// Joints in the middle of the IRp-6's workspace, the wrist bent, rad.
const START: [f64; 6] = [0.2, -1.57, 0.1, 0.2, 1.2, 0.3];

/// Moves to the start, writes the reference letter at 20 mm/s, and goes round a square with blends at 100 mm/s.
async fn write(cell: &mut Cell) -> Outcome {
    let mut robot = cell.robot("irp6")?;
    let irp6 = robot.motions();
    let arm = irp6.arm();
    let mut joints = [0.0; servo::MAX_AXES];
    joints[..6].copy_from_slice(&START);
    let start = arm.forward(&joints)?;
    let at = |x: i32, y: i32| start.translation.vector + Vector3::new(f64::from(x), f64::from(y), 0.0) * 1e-3;
    let contour = |curve, max_velocity: f64, max_acceleration: f64| -> Result<Contour, TaskError> {
        let limits = FeedLimits {
            max_velocity,
            max_acceleration,
            max_jerk: 10.0 * max_acceleration,
            max_normal_acceleration: max_acceleration,
            max_angular_velocity: 1.0,
            max_angular_acceleration: 4.0,
        };
        let path = Path::keeping(curve, start.rotation)?;
        Ok(Contour::along(arm.clone(), path, limits, irp6.limits())?)
    };
    let letter = [(0, 0), (5, 12), (10, 0), (15, 12), (20, 0), (30, 6), (36, 0), (30, -6), (24, 0)];
    let letter = BSpline::through(&letter.map(|(x, y)| at(x, y)), SplineEnds::NotAKnot)?;
    let square = [(24, 0), (60, 0), (60, 60), (0, 60), (0, 0)].map(|(x, y)| at(x, y));
    robot.enable().await?;
    robot.home().await?;
    robot.execute(irp6.joints(0.5, &[START])?).await?;
    robot.execute(contour(Curve::spline(letter)?, 0.02, 0.1)?).await?;
    robot.execute(contour(Curve::polyline(&square, 0.01)?, 0.1, 0.5)?).await
}

#[test]
fn an_emulated_arm_follows_a_letter_and_a_blended_square() {
    let cell = CellFile::read(example("irp6")).unwrap();
    let report = ::mrroc::run(&cell, BenchKind::Lockstep, write).unwrap();
    assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
    let error = report.robots[0].position_mm.unwrap();
    println!("tool {:.3} mm rms, {:.3} mm peak", error.rms, error.peak);
    assert!(error.rms < 0.1 && error.peak < 1.0, "{error:?}");
}
