//! Continuous feedback in every servo period: the velocity of joint 0 is proportional to the distance from its target.

use mrroc::prelude::*;

struct Approach {
    /// Joint 0, rad.
    target: f64,
    /// Velocity per distance, 1/s.
    rate: f64,
    /// Greatest acceleration, rad/s².
    acceleration: f64,
    /// Duration of a macrostep, s.
    macrostep: f64,
}

impl Generator for Approach {
    type First = (); // the first step reads nothing
    type Every = EffectorImage; // class 1: each next step reads the effector
    type Out = ();
    type Memory = (); // the image says everything

    fn pace(&self, _: Pace) -> Pace {
        Pace { periods: 1, read_at: 1 }
    }

    fn first_step(&mut self, (): &(), macrostep: Duration) -> Result<Next<()>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        Ok(Next::remember(()))
    }

    fn terminal(&self, (): &(), e: &EffectorImage) -> bool {
        (self.target - e.measured.joints.position[0]).abs() < 1e-3
    }

    fn next_step(&self, (): &(), e: &EffectorImage) -> Result<Next<()>, GeneratorError> {
        let mut joints = e.commanded.joints;
        let (before, change) = (joints.velocity[0], self.acceleration * self.macrostep);
        let wanted = self.rate * (self.target - e.measured.joints.position[0]);
        let velocity = wanted.clamp(before - change, before + change);
        joints.position[0] += (before + velocity) / 2.0 * self.macrostep;
        joints.velocity[0] = velocity;
        Ok(Next::command(Setpoint::Joints(joints), ()))
    }
}

async fn approach(cell: &mut Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    irb6.enable().await?;
    irb6.home().await?;
    irb6.execute(Approach { target: 0.3, rate: 3.0, acceleration: 1.0, macrostep: 0.0 }).await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6.toml", approach)
}
