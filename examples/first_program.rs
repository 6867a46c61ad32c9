//! A first program: the IRb-6 homes, moves through two poses, and comes back at half the speed.

use mrroc::prelude::*;

async fn carry(cell: &mut Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    // Fraction of the robot's limits, then joint positions, rad.
    let there = irb6.motions().joints(0.4, &[[0.4, -1.8, 0.1, 0.5, 0.3], [-0.5, -1.6, 0.0, 0.9, 1.0]])?;
    let back = irb6.motions().joints(0.2, &[[0.0, -1.571, 0.0, 0.0, 0.0]])?;

    irb6.enable().await?;
    irb6.home().await?;
    irb6.execute(there).await?;
    irb6.execute(back).await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6.toml", carry)
}
