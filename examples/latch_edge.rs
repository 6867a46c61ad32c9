//! Class 3, effector and sensor: the column turns until a light gate sees a part, and stops at the edge of the part.
//!
//! An edge of the gate has the receive time of its CAN frame. The image of the effector has the time of its samples. The
//! position at the edge follows from both times and the measured velocity, and does not depend on the macrostep.
//!
//! ```sh
//! cargo run --release --example latch_edge -- --bench lockstep
//! ```

use mrroc::prelude::*;

/// Position of the column at the edge of the part, rad, once it is known.
type Edge = Option<f64>;

/// Turns the column until the gate sees a part. Memory and answer are the position at the edge.
struct Search {
    /// Number of the gate's input.
    gate: u8,
    /// Velocity of the column, rad/s.
    speed: f64,
    /// Acceleration of the column, rad/s².
    acceleration: f64,
    /// Duration of a macrostep, s.
    macrostep: f64,
}

impl Search {
    /// Position of the column at the edge, rad, if the gate sees a part. Fails if the node is silent or has a fault.
    fn edge(&self, e: &EffectorImage, v: &V<InputImage>) -> Result<Edge, GeneratorError> {
        let inputs = v.0.younger_than(Duration::from_millis(300))?;
        let gate = inputs.input(self.gate).ok_or(GeneratorError::User(2))?;
        let (position, velocity) = (e.measured.joints.position[0], e.measured.joints.velocity[0]);
        let after = |edge: &_| e.at.since(*edge).as_secs_f64() - edge.since(e.at).as_secs_f64();
        Ok(gate.last_edge.filter(|_| gate.level).map(|edge| position - velocity * after(&edge)))
    }
}

impl Generator for Search {
    type First = (EffectorImage, V<InputImage>);
    type Every = (EffectorImage, V<InputImage>);
    type Out = Answer<Edge>;
    type Memory = Edge;

    fn first_step(
        &mut self,
        (e, v): &Self::First,
        macrostep: Duration,
    ) -> Result<Next<Edge, Answer<Edge>>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        // If the gate sees a part already, its edge is not of this motion.
        match self.edge(e, v)? {
            None => Ok(Next::remember(None).with(Answer(None))),
            Some(_) => Err(GeneratorError::User(1)),
        }
    }

    fn terminal(&self, edge: &Edge, _: &Self::Every) -> bool {
        edge.is_some()
    }

    fn next_step(&self, _: &Edge, (e, v): &Self::Every) -> Result<Next<Edge, Answer<Edge>>, GeneratorError> {
        let edge = self.edge(e, v)?;
        let mut joints = e.commanded.joints;
        let before = joints.velocity[0];
        joints.velocity[0] = (before + self.acceleration * self.macrostep).min(self.speed);
        joints.position[0] += (before + joints.velocity[0]) / 2.0 * self.macrostep;
        Ok(Next::command(Setpoint::Joints(joints), edge).with(Answer(edge)))
    }
}

async fn latch(cell: &mut Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    let gate = cell.input("gate")?;
    irb6.enable().await?;
    irb6.home().await?;
    irb6.sense(gate.sensor(), Shell::NonInteractive, 1)?;
    let mut answers = irb6.coordinated::<(), Edge>();
    let found = std::cell::Cell::new(None);
    let search = Search { gate: gate.number(), speed: 0.05, acceleration: 0.2, macrostep: 0.0 };
    let listen = async {
        while found.get().is_none() {
            found.set(answers.answer()?.and_then(|answer| answer.value));
            cell.sleep(cell.file().cell.period()).await;
        }
        Outcome::Ok(())
    };
    join(irb6.execute(search), listen).await?;
    let edge = found.get().unwrap_or_default();
    let passed = irb6.image()?.measured.joints.position[0];
    let back = irb6.motions().joints(0.1, &[[edge, -1.571, 0.0, 0.0, 0.0]])?;
    irb6.execute(back).await?;
    cell.figure("edge_rad", edge);
    cell.figure("passed_by_rad", passed - edge);
    irb6.disable().await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6-touch.toml", latch)
}
