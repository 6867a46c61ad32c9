//! A custom generator: joint 0 of the IRb-6 swings out and back once.

use std::f64::consts::TAU;

use mrroc::prelude::*;

struct Swing {
    /// Greatest displacement, rad.
    amplitude: f64,
    /// Number of macrosteps of the swing.
    steps: u32,
    start: AxesState,
    /// Duration of a macrostep, s.
    macrostep: f64,
}

impl Generator for Swing {
    type First = EffectorImage; // where the motion begins
    type Every = (); // no feedback while it moves
    type Out = ();
    type Memory = u32; // macrosteps done

    fn first_step(&mut self, e: &EffectorImage, macrostep: Duration) -> Result<Next<u32>, GeneratorError> {
        self.start = e.commanded.joints;
        self.macrostep = macrostep.as_secs_f64();
        Ok(Next::remember(0))
    }

    fn terminal(&self, step: &u32, _: &()) -> bool {
        *step == self.steps
    }

    fn next_step(&self, step: &u32, _: &()) -> Result<Next<u32>, GeneratorError> {
        let per_step = TAU / f64::from(self.steps);
        let phase = per_step * f64::from(step + 1);
        let mut joints = self.start;
        joints.position[0] += self.amplitude * (1.0 - phase.cos()) / 2.0;
        joints.velocity[0] = self.amplitude * per_step / self.macrostep * phase.sin() / 2.0;
        Ok(Next::command(Setpoint::Joints(joints), step + 1))
    }
}

async fn swing(cell: &mut Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    irb6.enable().await?;
    irb6.home().await?;
    irb6.execute(Swing { amplitude: 0.5, steps: 200, start: AxesState::default(), macrostep: 0.0 }).await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6.toml", swing)
}
