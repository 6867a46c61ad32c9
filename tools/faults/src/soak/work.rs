//! The task of a soak: each robot moves between two poses, and the task recovers the robot from faults.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use controller::executor::join_all;
use controller::generator::{Newsmooth, SmoothPose};
use controller::robot::Space;
use mrroc::cell::CellFile;
use mrroc::tasks::{Cell, Outcome, Robot};
use servo::MAX_AXES;

use crate::phase::{Course, FixedMotion};

/// Share of the limits of velocity and acceleration that the motions use.
const SHARE: f64 = 0.4;
/// Rest after each motion, in which the reference is checked.
const REST: Duration = Duration::from_millis(400);
/// Wait between two attempts to recover.
const PAUSE: Duration = Duration::from_millis(700);
/// Attempts to recover. After the last attempt, the task ends with the error.
const ATTEMPTS: u32 = 12;
/// Rounds after which a robot is switched off and on again.
const SWITCHED: u64 = 16;

/// Counts of a robot at work.
#[derive(Debug, Default)]
pub(super) struct Counts {
    /// Completed rounds: to the second pose and back.
    pub(super) rounds: AtomicU64,
    /// Rests at a pose that have ended.
    pub(super) rests: AtomicU64,
    /// Errors that the task received.
    pub(super) errors: AtomicU64,
}

/// Moves all robots of the cell without end. Returns the error of a robot that does not recover.
pub(super) async fn work(cell: &mut Cell, counts: &[Counts]) -> Outcome {
    let poses: Vec<_> = (0..counts.len()).map(|robot| poses(cell.file(), robot)).collect();
    let robots = cell.all_robots()?;
    let cell = &*cell;
    let parts = robots.into_iter().zip(poses).zip(counts);
    join_all(parts.map(|((robot, poses), counts)| serve(cell, robot, poses, counts))).await
}

/// The poses of a robot in joint coordinates: home, and the end of the fixed motion of the fault table.
fn poses(file: &CellFile, robot: usize) -> anyhow::Result<[Vec<f64>; 2]> {
    let arm = &file.arms[robot];
    let home = arm.robot().home();
    let from = std::array::from_fn(|axis| if axis < arm.axes() { home[axis] } else { 0.0 });
    let course = Course::of(file, false);
    let velocity = FixedMotion::of(file, robot, from, 0, course).velocity;
    let time = (course.ramp + course.cruise).as_secs_f64();
    let to = std::array::from_fn(|axis| from[axis] + velocity[axis] * time);
    let joints = |motors: &[f64; MAX_AXES]| anyhow::Ok(arm.joints(motors)?[..arm.axes()].to_vec());
    Ok([joints(&from)?, joints(&to)?])
}

async fn serve(cell: &Cell, mut robot: Robot, poses: anyhow::Result<[Vec<f64>; 2]>, counts: &Counts) -> Outcome {
    let poses = poses?;
    let (mut ready, mut failed) = (false, 0);
    loop {
        let ended = round(cell, &mut robot, &poses, ready, counts).await;
        ready = ended.is_ok();
        match ended {
            Ok(()) => failed = 0,
            Err(error) => {
                counts.errors.fetch_add(1, Ordering::Relaxed);
                failed += 1;
                if failed > ATTEMPTS {
                    return Err(error);
                }
                cell.sleep(PAUSE).await;
                // The next round shows whether the robot can be enabled.
                let _ = robot.reset_fault().await;
            }
        }
    }
}

/// Moves to both poses, and rests at each.
async fn round(cell: &Cell, robot: &mut Robot, poses: &[Vec<f64>; 2], ready: bool, counts: &Counts) -> Outcome {
    if !ready {
        robot.enable().await?;
        robot.home().await?;
    }
    for pose in [&poses[1], &poses[0]] {
        let motions = robot.motions();
        let position = std::array::from_fn(|axis| pose.get(axis).copied().unwrap_or_default());
        let target = vec![SmoothPose { position, velocity: [SHARE; MAX_AXES], acceleration: [SHARE; MAX_AXES] }];
        robot.execute(Newsmooth::new(Space::Joint, pose.len(), motions.limits(), target)?).await?;
        cell.sleep(REST).await;
        counts.rests.fetch_add(1, Ordering::Relaxed);
    }
    if counts.rounds.fetch_add(1, Ordering::Relaxed) % SWITCHED == SWITCHED - 1 {
        robot.disable().await?;
        robot.enable().await?;
    }
    Ok(())
}
