//! Retry after an error: a motion with too little time is refused at rest, and the task then allows twice the time.

use mrroc::prelude::*;
use serde::Deserialize;

/// Parameters of the task, from the table `task` of the cell file.
#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Parameters {
    /// Number of attempts at a motion.
    attempts: u32,
    /// Time for the first attempt, ms.
    first_ms: u64,
}

impl Default for Parameters {
    fn default() -> Self {
        Self { attempts: 4, first_ms: 400 }
    }
}

/// Moves to a joint position, rad. After a refusal, the next attempt allows twice the time.
async fn move_to(robot: &mut Robot, position: [f64; 8], parameters: &Parameters) -> Outcome {
    let mut duration = Duration::from_millis(parameters.first_ms);
    for attempt in 1.. {
        let limits = robot.motions().limits();
        let motion = JerkLimited::new(Space::Joint, 5, limits, &[position])?.lasting(duration);
        match robot.execute(motion).await {
            // The robot stands and takes another instruction.
            Err(error) if error.class() == Class::NonFatal && attempt < parameters.attempts => duration *= 2,
            ended => return ended,
        }
    }
    Ok(())
}

async fn carry(cell: &mut Cell) -> Outcome {
    let parameters = cell.parameters()?;
    let mut irb6 = cell.robot("irb6")?;
    irb6.enable().await?;
    irb6.home().await?;
    move_to(&mut irb6, [0.4, -1.8, 0.1, 0.5, 0.3, 0.0, 0.0, 0.0], &parameters).await?;
    cell.sleep(Duration::from_millis(500)).await;
    irb6.disable().await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6.toml", carry)
}
