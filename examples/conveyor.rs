//! Class 2, sensor: the arm waits until an object has passed two light gates, and the task reports speed and place of the
//! object.
//!
//! The gates are inputs of a CiA 401 node. The virtual sensor computes speed, length and place from the times of the edges.
//! The places of the gates are in the table `task` of the cell file.
//!
//! ```sh
//! cargo run --release --example conveyor -- --bench lockstep
//! ```

use mrroc::prelude::*;
use serde::Deserialize;

/// Parameters of the task.
#[derive(Deserialize)]
struct Parameters {
    /// The light gates.
    track: GateTrack,
    /// Place of the end of the conveyor, m.
    end: f64,
}

/// Longest wait for an object.
const PATIENCE: Duration = Duration::from_secs(60);

/// Holds the arm until an object has left the last gate. The memory is the time of the wait so far.
struct Await {
    /// Duration of a macrostep.
    macrostep: Duration,
}

impl Generator for Await {
    type First = ();
    type Every = V<GateReading>;
    type Out = ();
    type Memory = Duration;

    fn first_step(&mut self, (): &(), macrostep: Duration) -> Result<Next<Duration>, GeneratorError> {
        self.macrostep = macrostep;
        Ok(Next::remember(Duration::ZERO))
    }

    fn terminal(&self, _: &Duration, v: &V<GateReading>) -> bool {
        let passage = v.0.sample().and_then(|sample| sample.value.passage().ok()).flatten();
        passage.is_some_and(|passage| passage.length.is_some())
    }

    fn next_step(&self, waited: &Duration, v: &V<GateReading>) -> Result<Next<Duration>, GeneratorError> {
        // A node that is silent and a gate without an edge end the wait.
        v.0.younger_than(Duration::from_millis(300))?.passage()?;
        if *waited > PATIENCE {
            return Err(GeneratorError::User(1));
        }
        let hold = AxesState::new([0.0; 8], [0.0; 8]);
        Ok(Next::command(Setpoint::JointsBy(hold), *waited + self.macrostep))
    }
}

pub(crate) async fn watch(cell: &mut Cell) -> Outcome {
    let Parameters { track, end } = cell.parameters()?;
    let mut irb6 = cell.robot("irb6")?;
    let mut gates = cell.light_gates(&track)?;
    irb6.enable().await?;
    irb6.home().await?;
    if !cell.has_surroundings() {
        cell.end_rehearsal("no object passes in a rehearsal")?;
    }
    irb6.sense(cell.light_gates(&track)?, Shell::NonInteractive, 1)?;
    irb6.execute(Await { macrostep: Duration::ZERO }).await?;
    if let Some(passage) = gates.read().1.passage()? {
        let seconds = |at: Instant| at.since(Instant::ZERO).as_secs_f64();
        cell.figure("speed_m_per_s", passage.velocity);
        cell.figure("speed_bound_percent", 100.0 * passage.velocity_bound / passage.velocity);
        cell.figure("length_m", passage.length.unwrap_or_default());
        // The front of the object leaves the conveyor at this time.
        let leaves = passage.reaches(end);
        cell.figure("leaves_at_s", seconds(leaves));
        cell.figure("place_m", passage.front_at(leaves));
        cell.figure("place_bound_mm", 1e3 * passage.place_bound(leaves));
    }
    irb6.disable().await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6-conveyor.toml", watch)
}
