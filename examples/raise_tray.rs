//! Class 7, effector, sensor and orders: two arms raise a tray until a light gate sees its edge, and then lower the tray
//! to the height at the edge.
//!
//! Each arm computes the height of its grip at the edge from the time of the edge and its measured position, and
//! answers with this height. The coordinator brakes both arms and orders the mean of both heights: the tray stays level.
//!
//! ```sh
//! cargo run --release --example raise_tray -- --bench lockstep
//! ```

use mrroc::prelude::*;

/// Order to both arms: height above the start, m, velocity, m/s, and acceleration, m/s².
type Height = [f64; 3];

/// Velocity, m/s, and acceleration, m/s², of the tray.
const LIMITS: (f64, f64) = (0.01, 0.05);

/// Velocity of the tray per distance from the edge, 1/s.
const RATE: f64 = 2.0;

/// The coordinator.
struct Raise {
    /// Duration of a macrostep, s.
    macrostep: f64,
}

/// Memory of the coordinator: ordered height, m, and velocity, m/s, and the height of the edge, m.
#[derive(Clone, Copy, Debug, Default)]
struct Tray {
    height: f64,
    velocity: f64,
    edge: Option<f64>,
}

impl Coordinator<2> for Raise {
    type Order = Height;
    type Answer = Option<f64>;
    type Sensors = ();
    type Out = ();
    type Memory = Tray;

    fn first_step(&mut self, (): &(), macrostep: Duration) -> Result<Orders<Self, 2>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        Ok(NextOrders::new([[0.0; 3]; 2], Tray::default()))
    }

    fn terminal(&self, tray: &Tray, _: &[Sample<Option<f64>>; 2], (): &()) -> bool {
        tray.edge.is_some_and(|edge| (edge - tray.height).abs() < 1e-5)
    }

    fn next_step(
        &self,
        tray: &Tray,
        [left, right]: &[Sample<Option<f64>>; 2],
        (): &(),
    ) -> Result<Orders<Self, 2>, GeneratorError> {
        let edge = tray.edge.or(left.value.zip(right.value).map(|(left, right)| (left + right) / 2.0));
        let (speed, acceleration) = LIMITS;
        let wanted = edge.map_or(speed, |edge| (RATE * (edge - tray.height)).clamp(-speed, speed));
        let change = acceleration * self.macrostep;
        let velocity = wanted.clamp(tray.velocity - change, tray.velocity + change);
        let height = tray.height + (tray.velocity + velocity) / 2.0 * self.macrostep;
        let order = [height, velocity, (velocity - tray.velocity) / self.macrostep];
        Ok(NextOrders::new([order; 2], Tray { height, velocity, edge }))
    }
}

/// The generator of one arm. The memory is the height of the grip at the edge, m above the start.
struct Lift {
    /// Number of the gate's input.
    gate: u8,
    /// Pose of the tool at the start.
    start: Pose,
}

impl Generator for Lift {
    type First = EffectorImage;
    type Every = (EffectorImage, V<InputImage>, A<Height>);
    type Out = Answer<Option<f64>>;
    type Memory = Option<f64>;

    fn first_step(&mut self, e: &EffectorImage, _: Duration) -> Result<Next<Option<f64>, Self::Out>, GeneratorError> {
        self.start = e.commanded.pose;
        Ok(Next::remember(None).with(Answer(None)))
    }

    fn terminal(&self, _: &Option<f64>, _: &Self::Every) -> bool {
        false // the coordinator ends the motion
    }

    fn next_step(
        &self,
        edge: &Option<f64>,
        (e, v, a0): &Self::Every,
    ) -> Result<Next<Option<f64>, Self::Out>, GeneratorError> {
        let order = a0.0.sample().ok_or(GeneratorError::NothingReceived)?;
        let [height, velocity, acceleration] = order.value;
        let inputs = v.0.younger_than(Duration::from_millis(300))?;
        let gate = inputs.input(self.gate).ok_or(GeneratorError::User(1))?;
        let at_edge = gate.last_edge.filter(|_| gate.level).map(|at| {
            let after = e.at.since(at).as_secs_f64() - at.since(e.at).as_secs_f64();
            e.measured.pose.translation.z - self.start.translation.z - velocity * after
        });
        let edge = edge.or(at_edge);
        let up = |value| Pose::translation(0.0, 0.0, value).translation;
        let state = PoseState {
            pose: up(height) * self.start,
            linear: up(velocity).vector,
            linear_acceleration: up(acceleration).vector,
            ..PoseState::default()
        };
        Ok(Next::command(Setpoint::Tool(state), edge).with(Answer(edge)))
    }
}

async fn raise(cell: &mut Cell) -> Outcome {
    let [mut left, mut right] = cell.robots(["left", "right"])?;
    let gate = cell.input("gate")?;
    for robot in [&mut left, &mut right] {
        robot.sense(gate.sensor(), Shell::NonInteractive, 1)?;
    }
    let below = |robot: &Robot| robot.motions().joints(0.3, &[[0.0, -1.5, 0.2, 0.8, 0.0]]);
    let (one, other) = (below(&left)?, below(&right)?);
    let prepare = || Task::new().enable().home();
    join(left.perform(prepare().run(one)), right.perform(prepare().run(other))).await?;
    let height = |robot: &Robot| Ok::<_, TaskError>(robot.image()?.measured.pose.translation.z);
    let start = height(&left)?;
    let lifts = [0, 1].map(|_| Lift { gate: gate.number(), start: Pose::identity() });
    cell.team([&mut left, &mut right]).execute(Raise { macrostep: 0.0 }, lifts).await?;
    cell.figure("raised_mm", 1e3 * (height(&left)? - start));
    cell.figure("slant_mm", 1e3 * (height(&left)? - height(&right)?));
    join(left.disable(), right.disable()).await
}

fn main() -> ExitCode {
    mrroc::program("cells/two-irb6-gate.toml", raise)
}
