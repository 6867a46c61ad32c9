//! `mrroc datasheet`: figure and parameters of a robot, with the source of each parameter.

mod devices;
pub(crate) mod drives;
pub(crate) mod figure;
mod ink;
pub(crate) mod posture;
mod svg;
mod symbols;
pub(crate) mod tables;

use anyhow::bail;
use clap::Args;

use crate::kinematics::{Machine, Which};
use crate::robots::{Drawing, described};

/// Options of `mrroc datasheet`.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    machine: Which,
    /// Print the figure of the data sheet (SVG).
    #[arg(long)]
    figure: bool,
}

/// The data sheet or the figure of a robot, of the gripper or of the conveyor.
pub fn datasheet(options: &Options) -> anyhow::Result<String> {
    let machine = Machine::find(&options.machine)?;
    let described = described(&machine.parameters);
    Ok(match (options.figure, described.drawing) {
        (false, _) => tables::sheet(&machine),
        (true, Drawing::None) => {
            bail!("{}: a figure needs the links of the robot, which it does not state", machine.name)
        }
        (true, Drawing::Arm(views)) => figure::figure(&machine, described.symbols, &views(&machine)),
        (true, Drawing::Gripper(gripper)) => devices::gripper(gripper),
        (true, Drawing::Conveyor(conveyor)) => devices::conveyor(conveyor),
    })
}

#[cfg(test)]
mod tests {
    use mrroc::cell::{Model, Parameters};

    use super::*;

    fn machine(model: Model) -> Machine {
        let robot = model.name().to_owned();
        Machine::find(&Which { robot, cell: None }).unwrap()
    }

    #[test]
    fn every_view_shows_a_posture_that_the_robot_can_take() {
        for model in Model::ALL {
            let machine = machine(model);
            let Drawing::Arm(views) = described(&machine.parameters).drawing else {
                assert_eq!(model.parameters().axes(), 1, "{}", model.name());
                continue;
            };
            for view in views(&machine) {
                let motors = machine.robot.motors_from_joints(&view.joints);
                assert!(motors.is_ok(), "{}, {}: {motors:?}", model.name(), view.title);
            }
        }
    }

    #[test]
    fn only_numbers_of_no_model_are_said_to_be_a_cell_files() {
        for model in Model::ALL {
            let sheet = tables::sheet(&machine(model));
            assert!(!sheet.contains("cell file |"), "{}: {sheet}", model.name());
        }
        let mut gripper = machine(Model::Gripper);
        if let Parameters::Gripper(numbers) = &mut gripper.parameters {
            numbers.opening_limits.low += 0.001;
        }
        let sheet = tables::sheet(&gripper);
        assert_eq!(sheet.matches("cell file |").count(), 1, "{sheet}");
    }
}
