//! A straight groove: the tool of the robot sinks into a board, cuts along a line, and rises.
//!
//! The figures are those that the controller knows: the force sensor gives the cutting force, and the measured motor
//! positions give depth and width of the groove. The option `--carved DIR` writes a picture of the board after the run.
//!
//! ```sh
//! cargo run --release --example cut_groove -- --bench lockstep
//! ```

use std::cell::{Cell as Shared, RefCell};
use std::f64::consts::FRAC_PI_2;

use mrroc::prelude::*;
use nalgebra::Vector3;
use serde::Deserialize;

/// Joints above the board, the tool pointing down, rad.
const ABOVE: [f64; 5] = [0.0, -1.571, 0.0, FRAC_PI_2, 0.0];

/// Beginning of the groove in the base frame of the robot: x and y, m.
pub(crate) const BEGIN: [f64; 2] = [0.67, -0.02];

/// Length of the groove along y, m.
pub(crate) const LENGTH: f64 = 0.04;

/// Height of the tool above the board between two cuts, m.
const CLEARANCE: f64 = 5e-3;

/// Velocity in the air, of the plunge, and along the groove, m/s.
const VELOCITIES: [f64; 3] = [0.05, 0.003, 0.02];

/// The table `task` of the cell file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Groove {
    /// Diameter of the tool, m.
    diameter: f64,
    /// Depth of the groove, m.
    depth: f64,
    /// Height of the face of the board above the base of the robot, m.
    face: f64,
}

/// A measured point of the groove.
struct Point {
    /// Tool, in the base frame, m.
    tool: Vector3<f64>,
    /// Force on the tool, in the axes of the base, N.
    force: Vector3<f64>,
}

/// A line of the tool to a point, without rotation.
fn line(robot: &Robot, to: Vector3<f64>, velocity: f64) -> Result<StraightLine, TaskError> {
    let mut target = robot.observer().image()?.commanded.pose;
    target.translation.vector = to;
    let limits = LineLimits {
        max_velocity: velocity,
        max_acceleration: 0.5,
        max_jerk: 20.0,
        max_angular_velocity: 1.0,
        max_angular_acceleration: 5.0,
        max_angular_jerk: 100.0,
    };
    Ok(StraightLine::new(robot.motions().arm().clone(), target, limits, robot.motions().limits())?)
}

/// Cuts the groove.
pub(crate) async fn cut(cell: &mut Cell) -> Outcome {
    let Groove { diameter, depth, face } = cell.parameters()?;
    let mut irb6 = cell.robot("irb6")?;
    let wrist = cell.force_sensor("wrist")?;
    let observer = irb6.observer();
    irb6.enable().await?;
    irb6.home().await?;
    irb6.execute(irb6.motions().joints(0.5, &[ABOVE])?).await?;
    let [x, y] = BEGIN;
    let [air, plunge, feed] = VELOCITIES;
    irb6.execute(line(&irb6, Vector3::new(x, y, face + CLEARANCE), air)?).await?;
    cell.sleep(Duration::from_millis(300)).await;
    wrist.zero().await?;
    irb6.execute(line(&irb6, Vector3::new(x, y, face - depth), plunge)?).await?;
    let (points, ended) = (RefCell::new(Vec::new()), Shared::new(false));
    let groove = line(&irb6, Vector3::new(x, y + LENGTH, face - depth), feed)?;
    let motion = async {
        let outcome = irb6.execute(groove).await;
        ended.set(true);
        outcome
    };
    let watch = async {
        while !ended.get() {
            let pose = observer.image()?.measured.pose;
            let force = pose.rotation * wrist.in_tool()?.force;
            points.borrow_mut().push(Point { tool: pose.translation.vector, force });
            cell.sleep(cell.file().cell.period()).await;
        }
        Outcome::Ok(())
    };
    join(motion, watch).await?;
    irb6.execute(line(&irb6, Vector3::new(x, y + LENGTH, face + CLEARANCE), air)?).await?;
    let points = points.take();
    // The middle half of the groove is cut at constant velocity.
    let middle = |point: &&Point| (point.tool.y - y - 0.5 * LENGTH).abs() < 0.25 * LENGTH;
    let count = points.iter().filter(middle).count().max(1) as f64;
    cell.figure("cutting_force_n", -points.iter().filter(middle).map(|point| point.force.y).sum::<f64>() / count);
    let error = |point: &Point| face - point.tool.z - depth;
    cell.figure("depth_error_mm", 1e3 * points.iter().map(|it| error(it).abs()).fold(0.0, f64::max));
    let mean = points.iter().map(error).sum::<f64>() / points.len().max(1) as f64;
    cell.figure("depth_mm", 1e3 * (depth + mean));
    let side = |end: fn(f64, f64) -> f64| points.iter().map(|point| point.tool.x).reduce(end).unwrap_or(x);
    cell.figure("width_mm", 1e3 * (diameter + side(f64::max) - side(f64::min)));
    irb6.disable().await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6-milling.toml", cut)
}
