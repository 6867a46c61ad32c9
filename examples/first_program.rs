//! A first program: the IRb-6 homes, moves through two poses, and comes back at half the speed.

use mrroc::prelude::*;

fn main() -> ExitCode {
    mrroc::program("cells/irb6.toml", |cell| {
        let irb6 = Motions::of(cell, "irb6")?;
        // Fraction of the robot's limits, then joint positions, rad.
        let there = irb6.joints(0.4, &[[0.4, -1.8, 0.1, 0.5, 0.3], [-0.5, -1.6, 0.0, 0.9, 1.0]])?;
        let back = irb6.joints(0.2, &[[0.0, -1.571, 0.0, 0.0, 0.0]])?;
        let task = Task::new().enable().home().run(there).run(back).disable();
        Tasks::new(cell).give("irb6", task)
    })
}
