//! Guarded approach: the tool moves down to blocks of known stiffness at several velocities, and stops in the servo cycle
//! that detects the touch.
//!
//! The figures compare the peak force with the bound of [the book](../book/src/force.md): the tool moves on for two servo
//! periods, and then at most the kinetic energy of the arm is stored in the block.
//!
//! ```sh
//! cargo run --release --example guarded_approach -- --bench lockstep
//! ```

use std::cell::Cell as Shared;
use std::f64::consts::FRAC_PI_2;

use mrroc::prelude::*;
use nalgebra::Vector3;
use serde::Deserialize;

/// Joints above a block in front of the robot, the tool pointing down, rad. The column turns to the other blocks.
const ABOVE: [f64; 5] = [0.0, -1.571, 0.0, FRAC_PI_2, 0.0];

/// Contact force that ends an approach, N.
const TOUCH: f64 = 5.0;

/// Velocities of the approaches, m/s.
const VELOCITIES: [f64; 3] = [0.01, 0.05, 0.1];

/// Longest way of an approach, m.
const WAY: f64 = 0.03;

/// The table `task` of the cell file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Approach {
    /// Effective mass of the arm above the blocks in vertical direction, kg.
    effective_mass: f64,
}

/// Greatest force, N, of an arm with the effective mass `mass` that meets the stiffness `stiffness` at `velocity`, and
/// whose drives stop pushing two periods of `period` s after the force has exceeded [`TOUCH`].
fn bound(mass: f64, stiffness: f64, velocity: f64, period: f64) -> f64 {
    let after_delay = TOUCH + stiffness * velocity * 2.0 * period;
    after_delay.hypot(velocity * (mass * stiffness).sqrt())
}

/// Approaches each block at each velocity.
pub(crate) async fn approach(cell: &mut Cell) -> Outcome {
    let Approach { effective_mass } = cell.parameters()?;
    let mut irb6 = cell.robot("irb6")?;
    let wrist = cell.force_sensor("wrist")?;
    let observer = irb6.observer();
    irb6.enable().await?;
    irb6.home().await?;
    let blocks = cell.file().cell.scene.as_ref().map(|scene| scene.block.clone()).unwrap_or_default();
    let guard = ForceTask { guard: Some(Guard { force: TOUCH, torque: 1e3, samples: 1 }), ..ForceTask::default() };
    let mut worst = 0.0_f64;
    for block in blocks {
        for velocity in VELOCITIES {
            let column = block.centre[1].atan2(block.centre[0]);
            let above = [column, ABOVE[1], ABOVE[2], ABOVE[3], ABOVE[4]];
            irb6.execute(irb6.motions().joints(0.8, &[above])?).await?;
            cell.sleep(Duration::from_millis(300)).await;
            wrist.zero().await?;
            let mut target = observer.image()?.commanded.pose;
            target.translation.vector -= Vector3::new(0.0, 0.0, WAY);
            let limits = LineLimits {
                max_velocity: velocity,
                max_acceleration: 2.0,
                max_jerk: 100.0,
                max_angular_velocity: 1.0,
                max_angular_acceleration: 5.0,
                max_angular_jerk: 100.0,
            };
            let line = StraightLine::new(irb6.motions().arm().clone(), target, limits, irb6.motions().limits())?;
            let (peak, ended) = (Shared::new(0.0_f64), Shared::new(false));
            let motion = async {
                let outcome = irb6.execute(line.under(guard)).await;
                // The arm comes to rest on the block.
                cell.sleep(Duration::from_millis(300)).await;
                ended.set(true);
                outcome
            };
            let watch = async {
                while !ended.get() {
                    peak.set(peak.get().max(wrist.in_tool()?.force.norm()));
                    cell.sleep(cell.file().cell.period()).await;
                }
                Outcome::Ok(())
            };
            join(motion, watch).await?;
            if !cell.has_surroundings() {
                continue;
            }
            if !irb6.has_touched() {
                return Err(TaskError::Refused(mrroc::Error::msg("the tool met nothing on its way down")));
            }
            let bound = bound(effective_mass, block.stiffness, velocity, cell.file().cell.period().as_secs_f64());
            let name = format!("{:.0}_kn_per_m_at_{:.0}_mm_per_s", block.stiffness / 1e3, velocity * 1e3);
            cell.figure(&format!("peak_n_{name}"), peak.get());
            cell.figure(&format!("bound_n_{name}"), bound);
            worst = worst.max(peak.get() / bound);
        }
    }
    cell.figure("worst_peak_to_bound", worst);
    irb6.disable().await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6-guarded.toml", approach)
}
