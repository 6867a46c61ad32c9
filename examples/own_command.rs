//! The whole `mrroc` command with a task of one's own: `run`, `check`, `emulate`, `replay` and all others.

use mrroc::Extension;
use mrroc::prelude::*;

/// Waves with the column of the IRb-6.
async fn wave(cell: &mut Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    let home = [0.0, -1.571, 0.0, 0.0, 0.0];
    let aside = |angle| [angle, home[1], home[2], home[3], home[4]];
    let waving = irb6.motions().joints(0.4, &[aside(0.3), aside(-0.3), home])?;
    irb6.enable().await?;
    irb6.home().await?;
    irb6.execute(waving).await
}

fn main() -> ExitCode {
    mrroc_console::main(&Extension::new().task("wave", wave))
}
