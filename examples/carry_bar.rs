//! Two arms carry a bar in tight coordination: a coordinator moves the bar along a circle in the vertical plane.
//!
//! In every macrostep the coordinator orders a displacement of the bar, and each arm computes the set-point of its own
//! grip. The arms face each other: the base of the right arm is turned by half a turn about the vertical axis.

use std::f64::consts::TAU;

use mrroc::prelude::*;

/// Radius of the circle, m.
const RADIUS: f64 = 0.05;

/// Duration of the motion, s.
const DURATION: f64 = 6.0;

/// Distance between the bases, m.
const BETWEEN: f64 = 2.2;

/// Displacement of the bar from its start, m, velocity, m/s, and acceleration, m/s², in the vertical plane of the arms:
/// along x of the left base, and up.
#[derive(Clone, Copy, Debug)]
struct Displacement([[f64; 2]; 3]);

impl Displacement {
    /// The displacement after `time` seconds. The phase of the circle is a quintic of the time.
    fn after(time: f64) -> Self {
        let u = (time / DURATION).min(1.0);
        let phase = TAU * u.powi(3) * (10.0 - 15.0 * u + 6.0 * u * u);
        let rate = TAU / DURATION * 30.0 * (u * (1.0 - u)).powi(2);
        let change = TAU / DURATION.powi(2) * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u);
        let (sin, cos) = phase.sin_cos();
        let (outward, along) = ([cos, sin], [-sin, cos]);
        let position = [RADIUS * (cos - 1.0), RADIUS * sin];
        let velocity = along.map(|it| RADIUS * rate * it);
        let acceleration = [0, 1].map(|axis| RADIUS * (change * along[axis] - rate * rate * outward[axis]));
        Self([position, velocity, acceleration])
    }
}

/// The coordinator. Its memory is the number of the macrostep.
struct Circle {
    /// Duration of a macrostep, s.
    macrostep: f64,
}

impl Coordinator<2> for Circle {
    type Order = Displacement;
    type Answer = f64;
    type Sensors = ();
    type Out = ();
    type Memory = u32;

    fn first_step(&mut self, (): &(), macrostep: Duration) -> Result<Orders<Self, 2>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        Ok(NextOrders::new([Displacement::after(0.0); 2], 0))
    }

    fn terminal(&self, step: &u32, _: &[Sample<f64>; 2], (): &()) -> bool {
        f64::from(*step) * self.macrostep >= DURATION
    }

    fn next_step(&self, step: &u32, errors: &[Sample<f64>; 2], (): &()) -> Result<Orders<Self, 2>, GeneratorError> {
        // An arm that is a centimetre away from its orders does not carry the bar any more.
        if errors.iter().any(|error| error.value > 0.01) {
            return Err(GeneratorError::User(1));
        }
        let next = step + 1;
        Ok(NextOrders::new([Displacement::after(f64::from(next) * self.macrostep); 2], next))
    }
}

/// The generator of one arm, class 5: reads its effector and the order.
struct Grip {
    /// Direction of the bar's x axis along x of the arm's base: 1, or -1 for the arm that faces the first.
    facing: f64,
    /// Pose of the tool at the start.
    start: Pose,
}

impl Generator for Grip {
    type First = EffectorImage;
    type Every = (EffectorImage, A<Displacement>);
    type Out = Answer<f64>; // distance of the grip from its last order, m
    type Memory = [f64; 3]; // the last order

    fn first_step(&mut self, e: &EffectorImage, _: Duration) -> Result<Next<[f64; 3], Answer<f64>>, GeneratorError> {
        self.start = e.commanded.pose;
        Ok(Next::remember(self.start.translation.into()).with(Answer(0.0)))
    }

    fn terminal(&self, _: &[f64; 3], _: &(EffectorImage, A<Displacement>)) -> bool {
        false // the coordinator ends the motion
    }

    fn next_step(
        &self,
        last: &[f64; 3],
        (e, a0): &(EffectorImage, A<Displacement>),
    ) -> Result<Next<[f64; 3], Answer<f64>>, GeneratorError> {
        // The link gives each step the order of the same number, also while an override slows the motion.
        let order = a0.0.sample().ok_or(GeneratorError::NothingReceived)?;
        let Displacement(order) = order.value;
        let [position, velocity, acceleration] =
            order.map(|[along, up]| Pose::translation(self.facing * along, 0.0, up).translation);
        let pose = position * self.start;
        let state = PoseState {
            pose,
            linear: velocity.vector,
            linear_acceleration: acceleration.vector,
            ..PoseState::default()
        };
        let away = e.measured.pose.translation.vector - Pose::translation(last[0], last[1], last[2]).translation.vector;
        let next = Next::command(Setpoint::Tool(state), pose.translation.into());
        Ok(next.with(Answer(away.norm())))
    }
}

/// Figures of the motion, taken from the measured positions of both arms in every servo cycle.
#[derive(Default)]
struct Figures {
    samples: u32,
    squares: f64,
    distances: Option<[f64; 2]>,
    center: Option<[f64; 2]>,
    begun: Option<[u64; 2]>,
    skew: u32,
    most_skew: u32,
}

impl Figures {
    fn take(&mut self, images: [EffectorImage; 2]) {
        let [left, right] = images.map(|image| image.measured.pose.translation.vector);
        // The right grip in the frame of the left base.
        let right = [BETWEEN - right.x, -right.y, right.z];
        let distance = ((right[0] - left.x).powi(2) + (right[1] - left.y).powi(2) + (right[2] - left.z).powi(2)).sqrt();
        let [least, most] = self.distances.get_or_insert([distance; 2]);
        (*least, *most) = (least.min(distance), most.max(distance));
        let bar = [(left.x + right[0]) / 2.0, (left.z + right[2]) / 2.0];
        let center = self.center.get_or_insert([bar[0] - RADIUS, bar[1]]);
        let error = (bar[0] - center[0]).hypot(bar[1] - center[1]) - RADIUS;
        self.squares += error * error;
        self.samples += 1;
        let macrosteps = images.map(|image| image.macrostep);
        let begun = self.begun.get_or_insert(macrosteps);
        let together = macrosteps[0] - begun[0] == macrosteps[1] - begun[1];
        self.skew = if together { 0 } else { self.skew + 1 };
        self.most_skew = self.most_skew.max(self.skew);
    }
}

async fn carry(cell: &mut Cell) -> Outcome {
    let [mut left, mut right] = cell.robots(["left", "right"])?;
    for robot in [&mut left, &mut right] {
        robot.enable().await?;
        robot.home().await?;
        let above = robot.motions().joints(0.3, &[[0.0, -1.5, 0.2, 0.8, 0.0]])?;
        robot.execute(above).await?;
    }
    let eyes = [left.observer(), right.observer()];
    let mut figures = Figures::default();
    let carried = std::cell::Cell::new(false);
    let motion = async {
        let grips = [1.0, -1.0].map(|facing| Grip { facing, start: Pose::identity() });
        let mut team = cell.team([&mut left, &mut right]);
        team.execute(Circle { macrostep: 0.0 }, grips).await?;
        carried.set(true);
        Outcome::Ok(())
    };
    let watch = async {
        while !carried.get() {
            figures.take([eyes[0].image()?, eyes[1].image()?]);
            cell.sleep(cell.file().cell.period()).await;
        }
        Outcome::Ok(())
    };
    join(motion, watch).await?;
    let [least, most] = figures.distances.unwrap_or_default();
    cell.figure("object_path_rms_mm", 1e3 * (figures.squares / f64::from(figures.samples)).sqrt());
    cell.figure("grip_distance_max_mm", 1e3 * (most - least));
    cell.figure("start_skew_cycles_max", f64::from(figures.most_skew));
    join(left.disable(), right.disable()).await
}

fn main() -> ExitCode {
    mrroc::program("cells/two-irb6.toml", carry)
}
