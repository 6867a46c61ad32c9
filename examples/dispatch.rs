//! Class 4, orders only, and loose coordination: two arms serve stations, and the task assigns the next station to the
//! arm that is free.
//!
//! The arms work independently and at their own speeds. The task decides only when an arm is free, and selects each
//! decision from a finite set. A step of an arm takes the latest decision without waiting.
//!
//! ```sh
//! cargo run --release --example dispatch -- --bench lockstep
//! ```

use mrroc::prelude::*;

/// Decisions of the task.
#[derive(Clone, Copy, Debug)]
enum Decision {
    /// Serve the station in front.
    Front,
    /// Serve the station on the left.
    Left,
    /// Serve the station on the right.
    Right,
    /// End the motion.
    Finish,
}

impl Decision {
    /// Position of the column at the ordered station, rad.
    fn column(self) -> Option<f64> {
        match self {
            Self::Front => Some(0.0),
            Self::Left => Some(0.4),
            Self::Right => Some(-0.4),
            Self::Finish => None,
        }
    }
}

/// Turns the column to one ordered station after the other, and answers how many stations it has served.
struct Serve {
    /// Number of macrosteps of a motion.
    steps: u32,
    start: AxesState,
    /// Duration of a macrostep, s.
    macrostep: f64,
}

/// The motion of the column between two stations, rad; the number of its macrosteps done; and the number of stations
/// served.
#[derive(Clone, Copy, Debug)]
struct Motion {
    from: f64,
    to: f64,
    step: u32,
    served: u32,
}

impl Generator for Serve {
    type First = EffectorImage; // where the arm stands
    type Every = A<Decision>;
    type Out = Answer<u32>;
    type Memory = Motion;

    fn first_step(
        &mut self,
        e: &EffectorImage,
        macrostep: Duration,
    ) -> Result<Next<Motion, Answer<u32>>, GeneratorError> {
        (self.start, self.macrostep) = (e.commanded.joints, macrostep.as_secs_f64());
        let column = self.start.position[0];
        let standing = Motion { from: column, to: column, step: self.steps, served: 0 };
        Ok(Next::remember(standing).with(Answer(0)))
    }

    fn terminal(&self, motion: &Motion, a0: &A<Decision>) -> bool {
        let finish = a0.0.sample().is_some_and(|order| order.value.column().is_none());
        finish && motion.step == self.steps
    }

    fn next_step(&self, motion: &Motion, a0: &A<Decision>) -> Result<Next<Motion, Answer<u32>>, GeneratorError> {
        let mut motion = *motion;
        if motion.step == self.steps {
            let Received::New(Sample { value: decision, .. }) = a0.0 else {
                return Ok(Next::remember(motion).with(Answer(motion.served)));
            };
            let to = decision.column().unwrap_or(motion.to);
            motion = Motion { from: motion.to, to, step: 0, ..motion };
        }
        motion.step += 1;
        motion.served += u32::from(motion.step == self.steps);
        // A quintic of the time, at rest at both ends.
        let (u, by) = (f64::from(motion.step) / f64::from(self.steps), motion.to - motion.from);
        let mut joints = self.start;
        joints.position[0] = motion.from + by * u.powi(3) * (10.0 - 15.0 * u + 6.0 * u * u);
        joints.velocity[0] = by * 30.0 * (u * (1.0 - u)).powi(2) / (f64::from(self.steps) * self.macrostep);
        Ok(Next::command(Setpoint::Joints(joints), motion).with(Answer(motion.served)))
    }
}

async fn dispatch(cell: &mut Cell) -> Outcome {
    let [mut left, mut right] = cell.robots(["left", "right"])?;
    let prepare = || Task::new().enable().home();
    join(left.perform(prepare()), right.perform(prepare())).await?;
    let mut links = [left.coordinated::<Decision, u32>(), right.coordinated()];
    let serve = |steps| Serve { steps, start: AxesState::default(), macrostep: 0.0 };
    // The right arm is slower.
    let work = join(left.execute(serve(50)), right.execute(serve(90)));
    let decide = async {
        use Decision::{Finish, Front, Left, Right};
        let mut stations = [Left, Right, Right, Left, Right, Front, Left, Front].into_iter();
        // Decisions given to each arm, and stations that it has served.
        let (mut given, mut served, mut finishing) = ([0; 2], [None; 2], 0);
        while finishing < 2 {
            for arm in 0..2 {
                served[arm] = links[arm].answer()?.map(|answer| answer.value).or(served[arm]);
                if served[arm] == Some(given[arm]) {
                    let decision = stations.next().unwrap_or(Finish);
                    finishing += u32::from(matches!(decision, Finish));
                    links[arm].order(decision)?;
                    given[arm] += 1;
                }
            }
            cell.sleep(cell.file().cell.period()).await;
        }
        // The last decision for each arm is `Finish`, which is no station.
        cell.figure("served_by_left", f64::from(given[0] - 1));
        cell.figure("served_by_right", f64::from(given[1] - 1));
        Outcome::Ok(())
    };
    join(work, decide).await?;
    join(left.disable(), right.disable()).await
}

fn main() -> ExitCode {
    mrroc::program("cells/two-irb6.toml", dispatch)
}
