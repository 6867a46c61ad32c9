//! Two IRb-6: one reads its effector in every period of a motion, the other plans for 50 ms, ten times. The argument is
//! a cell with the robots `irb6` and `second`.

#![allow(clippy::disallowed_methods, reason = "a plan that takes long")]

use mrroc::prelude::*;

/// Moves joint 0 by 0.1 rad in 0.8 s, in macrosteps of one period.
struct Swing;

const STEPS: u32 = 400;

impl Generator for Swing {
    type First = ();
    type Every = EffectorImage;
    type Out = ();
    type Memory = u32;

    fn pace(&self, _: Pace) -> Pace {
        Pace { periods: 1, read_at: 1 }
    }

    fn first_step(&mut self, (): &(), _: Duration) -> Result<Next<u32>, GeneratorError> {
        Ok(Next::remember(0))
    }

    fn terminal(&self, step: &u32, _: &EffectorImage) -> bool {
        *step == STEPS
    }

    fn next_step(&self, step: &u32, e: &EffectorImage) -> Result<Next<u32>, GeneratorError> {
        let at = |step: u32| 0.1 * (f64::from(step) * std::f64::consts::PI / f64::from(STEPS)).cos() / 2.0;
        let mut joints = e.commanded.joints;
        joints.position[0] += at(*step) - at(step + 1);
        let phase = f64::from(step + 1) * std::f64::consts::PI / f64::from(STEPS);
        // The period is 2 ms.
        joints.velocity[0] = 0.05 * std::f64::consts::PI / f64::from(STEPS) / 0.002 * phase.sin();
        Ok(Next::command(Setpoint::Joints(joints), step + 1))
    }
}

/// Plans for 50 ms and does not move.
struct Ponder;

impl Generator for Ponder {
    type First = ();
    type Every = ();
    type Out = ();
    type Memory = ();

    fn first_step(&mut self, (): &(), _: Duration) -> Result<Next<()>, GeneratorError> {
        std::thread::sleep(Duration::from_millis(50));
        Ok(Next::remember(()))
    }

    fn terminal(&self, (): &(), (): &()) -> bool {
        true
    }

    fn next_step(&self, (): &(), (): &()) -> Result<Next<()>, GeneratorError> {
        Ok(Next::remember(()))
    }
}

async fn both(cell: &mut Cell) -> Outcome {
    let [mut irb6, mut second] = cell.robots(["irb6", "second"])?;
    let swinging = Task::new().enable().home().run(Swing).disable();
    let pondering = (0..10).fold(Task::new().enable().home(), |task, _| task.run(Ponder)).disable();
    join(irb6.perform(swinging), second.perform(pondering)).await
}

fn main() -> ExitCode {
    mrroc::program("cell.toml", both)
}
