//! Class 6, sensor and orders: a coordinator orders an arm to grip a part that a light gate sees.
//!
//! The arm approaches until the gate sees the part. In each step the arm answers whether the gate sees a part. The
//! coordinator then orders the arm to grip and to retreat. Each step of the arm commands the valve of the gripper. No
//! step reads the effector.
//!
//! ```sh
//! cargo run --release --example handshake -- --bench lockstep
//! ```

use mrroc::prelude::*;

/// Orders of the coordinator.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Order {
    /// Approach with the gripper open, and stand while the gate sees a part.
    Approach,
    /// Stand with the gripper closed.
    Grip,
    /// Return with the gripper closed.
    Retreat,
}

/// Answer of the arm.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// Whether the gate sees a part.
    part: bool,
    /// Angle of the column from its start, rad.
    angle: f64,
    /// Velocity of the column, rad/s.
    velocity: f64,
}

/// The generator of the arm. The memory is the angle of the column from its start, rad, and its velocity, rad/s.
struct Pick {
    /// Number of the gate's input.
    gate: u8,
    /// Number of the output of the gripper's valve.
    gripper: u8,
    /// Duration of a macrostep, s.
    macrostep: f64,
}

/// Velocity, rad/s, and acceleration, rad/s², of the column.
const LIMITS: (f64, f64) = (0.05, 0.2);

impl Generator for Pick {
    type First = ();
    type Every = (V<InputImage>, A<Order>);
    type Out = (Tell<u64>, Answer<Seen>);
    type Memory = [f64; 2];

    fn first_step(&mut self, (): &(), macrostep: Duration) -> Result<Next<[f64; 2], Self::Out>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        let answer = Answer(Seen { part: false, angle: 0.0, velocity: 0.0 });
        Ok(Next::remember([0.0; 2]).with((Tell(0), answer)))
    }

    fn terminal(&self, _: &[f64; 2], _: &Self::Every) -> bool {
        false // the coordinator ends the motion
    }

    fn next_step(
        &self,
        [angle, before]: &[f64; 2],
        (v, a0): &Self::Every,
    ) -> Result<Next<[f64; 2], Self::Out>, GeneratorError> {
        let order = a0.0.sample().ok_or(GeneratorError::NothingReceived)?.value;
        let inputs = v.0.younger_than(Duration::from_millis(300))?;
        let part = inputs.input(self.gate).ok_or(GeneratorError::User(1))?.level;
        let (speed, acceleration) = LIMITS;
        let wanted = match order {
            Order::Approach if !part => speed,
            Order::Approach | Order::Grip => 0.0,
            Order::Retreat => -speed,
        };
        let change = acceleration * self.macrostep;
        let velocity = wanted.clamp(before - change, before + change);
        let by = (before + velocity) / 2.0 * self.macrostep;
        let axes = |column: f64| [column, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let displacement = AxesState::new(axes(by), axes(velocity));
        let closed = u64::from(order != Order::Approach) << self.gripper;
        let answer = Answer(Seen { part, angle: angle + by, velocity });
        let next = Next::command(Setpoint::JointsBy(displacement), [angle + by, velocity]);
        Ok(next.with((Tell(closed), answer)))
    }
}

/// The coordinator. Its memory is the present order and the number of macrosteps since that order.
struct Conduct;

/// Number of macrosteps that the jaws need to close.
const CLOSING: u32 = 25;

impl Coordinator<1> for Conduct {
    type Order = Order;
    type Answer = Seen;
    type Sensors = ();
    type Out = ();
    type Memory = (Order, u32);

    fn first_step(&mut self, (): &(), _: Duration) -> Result<Orders<Self, 1>, GeneratorError> {
        Ok(NextOrders::new([Order::Approach], (Order::Approach, 0)))
    }

    fn terminal(&self, (order, _): &Self::Memory, [seen]: &[Sample<Seen>; 1], (): &()) -> bool {
        *order == Order::Retreat && seen.value.angle <= 0.0
    }

    fn next_step(
        &self,
        memory: &Self::Memory,
        [seen]: &[Sample<Seen>; 1],
        (): &(),
    ) -> Result<Orders<Self, 1>, GeneratorError> {
        let memory = match *memory {
            (Order::Approach, _) if seen.value.part && seen.value.velocity == 0.0 => (Order::Grip, 0),
            (Order::Grip, CLOSING) => (Order::Retreat, 0),
            (order, steps) => (order, steps + 1),
        };
        Ok(NextOrders::new([memory.0], memory))
    }
}

async fn pick(cell: &mut Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    let (gate, gripper) = (cell.input("gate")?, cell.output("gripper")?);
    irb6.enable().await?;
    irb6.home().await?;
    irb6.sense(gate.sensor(), Shell::NonInteractive, 1)?;
    let pick = Pick { gate: gate.number(), gripper: gripper.number(), macrostep: 0.0 };
    cell.team([&mut irb6]).execute(Conduct, [pick]).await?;
    cell.figure("ends_at_rad", irb6.image()?.measured.joints.position[0]);
    irb6.disable().await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6-touch.toml", pick)
}
