//! Retry after an error: a motion that needs more time is refused at rest, and the task allows twice the time.

use mrroc::prelude::*;

/// Number of attempts at a motion.
const ATTEMPTS: u32 = 4;

/// Moves to a joint position, rad, within `duration`, or within a multiple of it if the robot is not fast enough.
async fn move_to(robot: &mut Robot, position: [f64; 8], mut duration: Duration) -> Outcome {
    for attempt in 1.. {
        let limits = robot.motions().limits();
        let motion = JerkLimited::new(Space::Joint, 5, limits, &[position])?.lasting(duration);
        match robot.execute(motion).await {
            // The robot stands and takes another instruction.
            Err(error) if error.class() == Class::NonFatal && attempt < ATTEMPTS => duration *= 2,
            ended => return ended,
        }
    }
    Ok(())
}

async fn carry(cell: &mut Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    irb6.enable().await?;
    irb6.home().await?;
    move_to(&mut irb6, [0.4, -1.8, 0.1, 0.5, 0.3, 0.0, 0.0, 0.0], Duration::from_millis(400)).await?;
    cell.sleep(Duration::from_millis(500)).await;
    irb6.disable().await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6.toml", carry)
}
