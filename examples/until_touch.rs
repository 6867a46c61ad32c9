//! A virtual sensor: the column turns slowly until the touch probe of the tool reports a touch. The task then sets an
//! output.
//!
//! The probe is a digital input of an I/O node on the bus of the drives. The emulated probe is actuated by the force
//! between the tip of the tool and a block. A rehearsal on ideal drives has no block: the column then
//! turns all the way.

use mrroc::prelude::*;

/// Generator of class 2: reads the sensor only.
struct UntilTouch {
    /// Number of the input of the probe.
    probe: u8,
    /// Velocity of the column, rad/s.
    speed: f64,
    /// Greatest angle, rad.
    travel: f64,
    /// Duration of a macrostep, s.
    macrostep: f64,
}

impl Generator for UntilTouch {
    type First = ();
    type Every = V<InputImage>;
    type Out = ();
    /// Number of steps.
    type Memory = u32;

    fn first_step(&mut self, (): &(), macrostep: Duration) -> Result<Next<u32>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        Ok(Next::remember(0))
    }

    fn terminal(&self, steps: &u32, v: &V<InputImage>) -> bool {
        let input = v.0.sample().and_then(|inputs| inputs.value.input(self.probe));
        let turned = f64::from(*steps) * self.speed * self.macrostep;
        input.is_some_and(|input| input.level) || turned >= self.travel
    }

    fn next_step(&self, steps: &u32, v: &V<InputImage>) -> Result<Next<u32>, GeneratorError> {
        // A node that is silent or has a fault cannot report a touch.
        let inputs = v.0.younger_than(Duration::from_millis(300))?;
        inputs.input(self.probe).ok_or(GeneratorError::User(1))?;
        let axes = |column: f64| [column, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let by = AxesState::new(axes(self.speed * self.macrostep), axes(self.speed));
        Ok(Next::command(Setpoint::JointsBy(by), steps + 1))
    }
}

/// Homes the robot and turns the column until the probe touches.
pub(crate) async fn find(cell: &mut Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    let (probe, gripper) = (cell.input("touch")?, cell.output("gripper")?);
    irb6.enable().await?;
    irb6.home().await?;
    irb6.sense(probe.sensor(), Shell::NonInteractive, 1)?;
    irb6.execute(UntilTouch { probe: probe.number(), speed: 0.05, travel: 1.0, macrostep: 0.0 }).await?;
    let has_touched = probe.read().is_some_and(|input| input.level);
    if !has_touched && cell.has_surroundings() {
        return Err(TaskError::Refused(mrroc::Error::msg("the probe met nothing on its way")));
    }
    gripper.set(true);
    let measured = irb6.image()?.measured;
    cell.figure("stopped_at_rad", measured.joints.position[0]);
    cell.figure("touched_at_y_m", measured.pose.translation.y);
    cell.sleep(Duration::from_millis(100)).await;
    irb6.disable().await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6-probe.toml", find)
}
