//! Replanning in motion: the column turns to one side, and gets a target on the other side while it moves.

use mrroc::prelude::*;

async fn replan(cell: &mut Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    irb6.enable().await?;
    irb6.home().await?;
    let limits = irb6.motions().limits();
    let to = |column: f64| JerkLimited::new(Space::Joint, 5, limits, &[[column, -1.571, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]]);
    // A replacement acts after the macrosteps already sent: five of 20 ms.
    let (there, back) = (to(0.8)?.sent_ahead(5), to(-0.3)?);
    let replacer = irb6.replacer();
    let change = async {
        cell.sleep(Duration::from_millis(400)).await;
        // The new plan begins with position, velocity and acceleration at the end of the macrosteps already sent.
        Ok(replacer.replace(back)?)
    };
    join(irb6.execute(there), change).await
}

fn main() -> ExitCode {
    mrroc::program("cells/irb6.toml", replan)
}
