//! A virtual sensor: the column turns slowly until the touch probe of the tool reports a touch. The task then sets an
//! output.
//!
//! The probe is a digital input of an I/O node on the bus of the drives. The emulated probe is touched at a fixed time.

use mrroc::prelude::*;

/// Generator of class 2: reads the sensor only.
struct UntilTouch {
    /// Number of the input of the probe.
    probe: u8,
    /// Velocity of the column, rad/s.
    speed: f64,
    /// Duration of a macrostep, s.
    macrostep: f64,
}

impl Generator for UntilTouch {
    type First = ();
    type Every = V<InputImage>;
    type Out = ();
    type Memory = ();

    fn first_step(&mut self, (): &(), macrostep: Duration) -> Result<Next<()>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        Ok(Next::remember(()))
    }

    fn terminal(&self, (): &(), v: &V<InputImage>) -> bool {
        let input = v.0.sample().and_then(|inputs| inputs.value.input(self.probe));
        input.is_some_and(|input| input.level)
    }

    fn next_step(&self, (): &(), v: &V<InputImage>) -> Result<Next<()>, GeneratorError> {
        // A node that is silent or has a fault cannot report a touch.
        let inputs = v.0.younger_than(Duration::from_millis(300))?;
        inputs.input(self.probe).ok_or(GeneratorError::User(1))?;
        let axes = |column: f64| [column, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let by = AxesState::new(axes(self.speed * self.macrostep), axes(self.speed));
        Ok(Next::command(Setpoint::JointsBy(by), ()))
    }
}

async fn find(cell: &mut Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    let (probe, gripper) = (cell.input("touch")?, cell.output("gripper")?);
    irb6.enable().await?;
    irb6.home().await?;
    irb6.sense(probe.sensor(), Shell::NonInteractive, 1)?;
    irb6.execute(UntilTouch { probe: probe.number(), speed: 0.05, macrostep: 0.0 }).await?;
    gripper.set(true);
    cell.figure("stopped_at_rad", irb6.image()?.measured.joints.position[0]);
    cell.sleep(Duration::from_millis(100)).await;
    irb6.disable().await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6-touch.toml", find)
}
