//! Data sheets of the gripper and of the conveyor.

use controller::robot::{ConveyorParameters, GripperParameters};

use super::Described;
use crate::datasheet::loops::{BY_DRIVE, Loop};
use crate::datasheet::tables::{Row, Tag, row};
use crate::datasheet::views::Drawing;
use crate::kinematics::Machine;

const GRIPPER: &str = "ptroja/mrrocpp, src/robot/irp6ot_tfg";
const CONVEYOR: &str = "ptroja/mrrocpp, src/robot/conveyor";

impl Described for GripperParameters {
    fn about(&self) -> &'static str {
        "The two-finger gripper of the WUT robots: one motor, two jaws. The opening is a polynomial of the motor's \
             position; past its vertex the jaws close again."
    }

    fn title(&self) -> &'static str {
        "Parameters"
    }

    fn lengths(&self) -> Vec<Row> {
        let gripper = self;
        let (motors, openings) = (gripper.motor_limits, gripper.opening_limits);
        let sign = Tag::Derived(
            "ptroja/mrrocpp, src/robot/irp6ot_tfg; with the sign by which its home, 4830 rad, is within its \
                 openings: the code has the other, by which it is not",
        );
        let code = Tag::PublicCode(GRIPPER);
        [
            (
                "square",
                "opening per square of the motor's position",
                gripper.square,
                "m/rad²",
            ),
            (
                "linear",
                "opening per motor position",
                gripper.linear,
                "m/rad",
            ),
            (
                "constant",
                "opening at motor position 0",
                gripper.constant,
                "m",
            ),
            (
                "motor_at_home",
                "motor position at home",
                gripper.motor_at_home,
                "rad",
            ),
            (
                "motor_limits.low",
                "lowest motor position",
                motors.low,
                "rad",
            ),
            (
                "motor_limits.high",
                "highest motor position",
                motors.high,
                "rad",
            ),
            ("opening_limits.low", "narrowest opening", openings.low, "m"),
            ("opening_limits.high", "widest opening", openings.high, "m"),
        ]
        .map(|(name, meaning, value, unit)| {
            let tag = if name == "linear" { sign } else { code };
            row(name, meaning, value, unit, tag)
        })
        .into()
    }

    fn loops(&self) -> (Vec<Loop>, &'static str) {
        (
            vec![[
                "`cells/lab.toml`",
                BY_DRIVE,
                "48.9",
                "38.8°, roughly: at 98 rad/s and by `--periods 12`, with a coherence of 0.85; its encoder has 128 counts a turn",
            ]],
            "cells/lab.toml --axis jaws",
        )
    }

    fn drawing<'a>(&'a self, _: &Machine) -> Drawing<'a> {
        Drawing::Gripper(self)
    }
}

impl Described for ConveyorParameters {
    fn about(&self) -> &'static str {
        "The conveyor of the WUT laboratory: a belt behind a gear, without limits."
    }

    fn title(&self) -> &'static str {
        "Parameters"
    }

    fn lengths(&self) -> Vec<Row> {
        let conveyor = self;
        let counter = Tag::Derived("what a 32-bit counter of 4000 counts per turn holds");
        let code = Tag::PublicCode(CONVEYOR);
        let motors = conveyor.motor_limits;
        [
            (
                "ratio",
                "motor position per position of the belt",
                conveyor.ratio,
                "rad/m",
                code,
            ),
            (
                "motor_at_home",
                "motor position at home",
                conveyor.motor_at_home,
                "rad",
                code,
            ),
            (
                "motor_limits.low",
                "lowest motor position",
                motors.low,
                "rad",
                counter,
            ),
            (
                "motor_limits.high",
                "highest motor position",
                motors.high,
                "rad",
                counter,
            ),
        ]
        .map(|(name, meaning, value, unit, tag)| row(name, meaning, value, unit, tag))
        .into()
    }

    fn loops(&self) -> (Vec<Loop>, &'static str) {
        (
            vec![["`cells/lab.toml`", BY_DRIVE, "45.9", "39.1°"]],
            "cells/lab.toml --axis belt",
        )
    }

    fn drawing<'a>(&'a self, _: &Machine) -> Drawing<'a> {
        Drawing::Conveyor(self)
    }
}
