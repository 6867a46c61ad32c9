//! Data sheet of a robot that a program registers.

use controller::robot::{Joints, RobotParameters};
use mrroc::robots::OwnParameters;
use nalgebra::Vector3;

use super::{Described, Description, Drawing, SYMBOLS};
use crate::datasheet::drives::{drive, range, signed};
use crate::datasheet::figure::View;
use crate::datasheet::tables::{Row, Tag};

impl Described for OwnParameters {
    fn description(&self) -> Description<'_> {
        let robot = self.robot().expect("the machine has been made of these numbers");
        let home = robot.home();
        let at_home = robot.joints_from_motors(&home).ok();
        let row = |axis: usize| {
            let joint = at_home.map_or("no joint position".into(), |joints| signed(joints[axis]));
            let cells = [
                "by the robot's program",
                &format!("{joint} at m {}", signed(home[axis])),
                &range(&robot.joint_limits()[axis]),
                &range(&robot.motor_limits()[axis]),
            ];
            drive(SYMBOLS[axis], &format!("axis {axis}"), cells, Tag::Program)
        };
        let drawn = at_home.filter(|_| !robot.links().is_empty());
        Description {
            about: "A robot of the program that prints this page. Its keys are in the schema that the program prints.",
            symbols: &SYMBOLS[..self.axes()],
            caution: None,
            title: "Numbers",
            lengths: numbers(self),
            drives: (0..self.axes()).map(row).collect(),
            loops: Vec::new(),
            example: "CELL --axis AXIS",
            drawing: drawn.map_or(Drawing::None, |home| Drawing::Arm(Box::new(move |_| views(home)))),
        }
    }
}

/// The numbers by their keys.
fn numbers(own: &OwnParameters) -> Vec<Row> {
    let table = own.table().unwrap_or_default();
    let row = |(key, value): (&String, &_)| Row { cells: format!("`{key}` | | {value} | "), tag: Tag::Program };
    table.iter().map(row).collect()
}

fn views(home: Joints) -> [View; 2] {
    let side = View::of("From the side", home, [Vector3::x(), Vector3::z()]);
    let above = View::of("From above", home, [Vector3::x(), Vector3::y()]);
    [side, above]
}
