//! Data sheets of the gripper and of the conveyor.

use controller::robot::{ConveyorParameters, GripperParameters};

use super::{Described, Description, Drawing};
use crate::datasheet::tables::{BY_DRIVE, Tag, row};

impl Described for GripperParameters {
    fn description(&self) -> Description<'_> {
        let (motors, openings) = (self.motor_limits, self.opening_limits);
        let sign = Tag::Derived(
            "ptroja/mrrocpp, src/robot/irp6ot_tfg; with the sign by which its home, 4830 rad, is within its \
                 openings: the code has the other, by which it is not",
        );
        let code = Tag::PublicCode("ptroja/mrrocpp, src/robot/irp6ot_tfg");
        Description {
            about: "The two-finger gripper of the WUT robots: one motor, two jaws. The opening is a polynomial of \
                    the motor's position; past its vertex the jaws close again.",
            symbols: &[],
            caution: None,
            title: "Parameters",
            lengths: vec![
                row("square", "opening per square of the motor's position", self.square, "m/rad²", code),
                row("linear", "opening per motor position", self.linear, "m/rad", sign),
                row("constant", "opening at motor position 0", self.constant, "m", code),
                row("motor_at_home", "motor position at home", self.motor_at_home, "rad", code),
                row("motor_limits.low", "lowest motor position", motors.low, "rad", code),
                row("motor_limits.high", "highest motor position", motors.high, "rad", code),
                row("opening_limits.low", "narrowest opening", openings.low, "m", code),
                row("opening_limits.high", "widest opening", openings.high, "m", code),
            ],
            drives: Vec::new(),
            loops: vec![[
                "`cells/lab.toml`",
                BY_DRIVE,
                "48.9",
                "38.8°, roughly: at 98 rad/s and by `--periods 12`, with a coherence of 0.85; its encoder has 128 counts a turn",
            ]],
            example: "cells/lab.toml --axis jaws",
            drawing: Drawing::Gripper(self),
        }
    }
}

impl Described for ConveyorParameters {
    fn description(&self) -> Description<'_> {
        let counter = Tag::Derived("what a 32-bit counter of 4000 counts per turn holds");
        let code = Tag::PublicCode("ptroja/mrrocpp, src/robot/conveyor");
        let motors = self.motor_limits;
        Description {
            about: "The conveyor of the WUT laboratory: a belt behind a gear, without limits.",
            symbols: &[],
            caution: None,
            title: "Parameters",
            lengths: vec![
                row("ratio", "motor position per position of the belt", self.ratio, "rad/m", code),
                row("motor_at_home", "motor position at home", self.motor_at_home, "rad", code),
                row("motor_limits.low", "lowest motor position", motors.low, "rad", counter),
                row("motor_limits.high", "highest motor position", motors.high, "rad", counter),
            ],
            drives: Vec::new(),
            loops: vec![["`cells/lab.toml`", BY_DRIVE, "45.9", "39.1°"]],
            example: "cells/lab.toml --axis belt",
            drawing: Drawing::Conveyor(self),
        }
    }
}
