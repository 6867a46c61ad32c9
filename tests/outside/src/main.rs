//! Homes an IRb-6, rotates its column with a generator of its own, and reads the following error of the motor.
use mrroc::prelude::*;

/// Turns joint 0 by 0.3 rad within 100 macrosteps.
#[derive(Default)]
struct Turn(AxesState, f64);

impl Generator for Turn {
    type First = EffectorImage;
    type Every = ();
    type Out = ();
    type Memory = u32;

    fn first_step(&mut self, e: &EffectorImage, dt: Duration) -> Result<Next<u32>, GeneratorError> {
        (self.0, self.1) = (e.commanded.joints, 100.0 * dt.as_secs_f64());
        Ok(Next::remember(0))
    }

    fn terminal(&self, step: &u32, _: &()) -> bool {
        *step == 100
    }

    fn next_step(&self, step: &u32, _: &()) -> Result<Next<u32>, GeneratorError> {
        let (mut joints, s) = (self.0, f64::from(step + 1) / 100.0);
        joints.position[0] += 0.3 * s * s * (3.0 - 2.0 * s);
        joints.velocity[0] = 1.8 * s * (1.0 - s) / self.1;
        Ok(Next::command(Setpoint::Joints(joints), step + 1))
    }
}

async fn turn(cell: &mut Cell) -> Outcome {
    cell.robot("irb6")?.perform(Task::new().enable().home().run(Turn::default()).disable()).await
}

fn main() -> Result<(), mrroc::Error> {
    let cell = CellFile::read(std::env::args().nth(1).expect("the cell file"))?;
    let report = mrroc::run(&cell, BenchKind::Lockstep, turn)?;
    println!("{:?}, column {:.6} rad rms", report.outcome, report.axes[0].tracking_rms_rad);
    Ok(())
}
