//! Class 3, effector and sensor: the tool moves down until the force sensor at the wrist measures a force, and stops.
//!
//! The approach is guarded at the rate of the macrosteps. From the sample of the sensor to the stop, the tool moves on for
//! up to two macrosteps. The force exceeds the limit by the stiffness of the contact times this displacement.
//!
//! ```sh
//! cargo run --release --example push_until -- --bench lockstep
//! ```

use mrroc::prelude::*;
use nalgebra::Vector3;

/// Force that ends the approach, N.
const FORCE: f64 = 20.0;

/// Joints above the table, the tool pointing down, rad.
const ABOVE: [f64; 5] = [0.0, -1.571, 0.0, 1.3, 0.0];

/// Greatest age of a sample of the force sensor.
const STALE: Duration = Duration::from_millis(100);

/// Moves the tool down along z of the base.
struct PushUntil {
    /// Contact force that ends the approach, N.
    force: f64,
    /// Velocity of the tool, m/s.
    velocity: f64,
    /// Acceleration of the tool, m/s².
    acceleration: f64,
    /// Greatest displacement of the tool, m.
    travel: f64,
    /// Duration of a macrostep, s.
    macrostep: f64,
}

/// The approach so far.
#[derive(Clone, Copy, Debug)]
struct Way {
    /// Height of the tool at the start, m.
    start: f64,
    /// Velocity at the end of the last macrostep, m/s.
    velocity: f64,
}

impl Generator for PushUntil {
    type First = EffectorImage;
    type Every = (EffectorImage, V<ForceReading>);
    type Out = ();
    type Memory = Way;

    fn first_step(&mut self, e: &EffectorImage, macrostep: Duration) -> Result<Next<Way>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        Ok(Next::remember(Way { start: e.commanded.pose.translation.z, velocity: 0.0 }))
    }

    fn terminal(&self, way: &Way, (e, v): &Self::Every) -> bool {
        let contact = v.0.sample().and_then(|sample| sample.value.in_sensor().ok());
        let is_touching = contact.is_some_and(|contact| contact.force.norm() >= self.force);
        is_touching || way.start - e.commanded.pose.translation.z >= self.travel
    }

    fn next_step(&self, way: &Way, (e, v): &Self::Every) -> Result<Next<Way>, GeneratorError> {
        // A sensor that is silent, saturated or otherwise at fault cannot report a touch.
        v.0.younger_than(STALE)?.in_sensor()?;
        let velocity = (way.velocity + self.acceleration * self.macrostep).min(self.velocity);
        let mut pose = e.commanded.pose;
        pose.translation.z -= (way.velocity + velocity) / 2.0 * self.macrostep;
        let down = Vector3::new(0.0, 0.0, -velocity);
        let setpoint = Setpoint::Pose { pose, linear: down, angular: Vector3::zeros() };
        Ok(Next::command(setpoint, Way { velocity, ..*way }))
    }
}

/// Homes the robot, moves above the table, zeroes the sensor and pushes on the table.
pub(crate) async fn push(cell: &mut Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    let wrist = cell.force_sensor("wrist")?;
    irb6.enable().await?;
    irb6.home().await?;
    irb6.execute(irb6.motions().joints(0.3, &[ABOVE])?).await?;
    wrist.zero().await?;
    irb6.sense(wrist.sensor(), Shell::NonInteractive, 1)?;
    let (peak, ended) = (std::cell::Cell::new(0.0_f64), std::cell::Cell::new(false));
    let approach = async {
        let push = PushUntil { force: FORCE, velocity: 0.01, acceleration: 0.1, travel: 0.06, macrostep: 0.0 };
        let outcome = irb6.execute(push).await;
        ended.set(true);
        outcome
    };
    let watch = async {
        while !ended.get() {
            if let Ok(contact) = wrist.in_tool() {
                peak.set(peak.get().max(contact.force.norm()));
            }
            cell.sleep(cell.file().cell.period()).await;
        }
        Outcome::Ok(())
    };
    join(approach, watch).await?;
    // The arm and the contact come to rest.
    cell.sleep(Duration::from_millis(500)).await;
    let force = wrist.in_tool()?.force.norm();
    // A rehearsal on ideal drives has no table: the tool moves all the way.
    if force < FORCE / 2.0 && cell.has_surroundings() {
        return Err(TaskError::Refused(mrroc::Error::msg("the tool met nothing on its way down")));
    }
    cell.figure("force_n", force);
    cell.figure("peak_force_n", peak.get());
    cell.figure("tool_height_m", irb6.image()?.measured.pose.translation.z);
    irb6.disable().await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6-wrist.toml", push)
}
