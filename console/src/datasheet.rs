//! `mrroc datasheet`: a robot's figure and its parameters, each with the place it comes from.

mod devices;
mod figure;
mod ink;
mod posture;
mod tables;
mod views;

use std::process::ExitCode;

use clap::Args;

use crate::kinematics::{Machine, Which};
use crate::stdout;

#[derive(Args)]
pub(crate) struct Options {
    #[command(flatten)]
    machine: Which,
    /// Print the figure (SVG) that the data sheet shows.
    #[arg(long)]
    figure: bool,
}

/// Prints the data sheet of a robot or of a device beside it, the gripper or the conveyor.
pub(crate) fn datasheet(options: &Options) -> anyhow::Result<ExitCode> {
    if let Some(device) = devices::find(&options.machine) {
        return stdout::print(if options.figure {
            device.figure()
        } else {
            device.sheet()
        });
    }
    let machine = Machine::find(&options.machine)?;
    stdout::print(if options.figure {
        let symbols = views::symbols(&machine.numbers);
        figure::figure(&machine, symbols, &views::views(&machine))
    } else {
        tables::sheet(&machine)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_view_shows_a_posture_that_the_robot_can_take() {
        for name in ["irb6", "irp6", "irp6-track", "rnt", "polycrank"] {
            let machine = Machine::find(&Which::preset(name)).unwrap();
            for view in views::views(&machine) {
                let motors = machine.robot.motors_from_joints(&view.joints);
                assert!(motors.is_ok(), "{name}, {}: {motors:?}", view.title);
            }
        }
    }
}
