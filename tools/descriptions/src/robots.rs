//! What a data sheet says of each robot beside its numbers.

mod arms;
mod chain;
mod devices;
mod own;
mod polycrank;
mod rnt;

use controller::robot::{ConveyorParameters, GripperParameters};
use mrroc::cell::Parameters;

use crate::datasheet::figure::View;
use crate::datasheet::tables::{Loop, Row};
use crate::kinematics::Machine;

/// A robot with a data sheet.
pub(crate) trait Described {
    fn description(&self) -> Description<'_>;
}

/// Contents of the data sheet of one robot.
pub(crate) struct Description<'a> {
    /// The robot in some sentences: its axes, its base frame, the sense of its joints.
    pub(crate) about: &'static str,
    /// Names of the joints in the formulas; none of a device beside a robot.
    pub(crate) symbols: &'static [&'static str],
    /// Warning about the numbers.
    pub(crate) caution: Option<&'static str>,
    /// Title of the table of its lengths.
    pub(crate) title: &'static str,
    pub(crate) lengths: Vec<Row>,
    /// Transmissions of its axes.
    pub(crate) drives: Vec<Row>,
    /// The measured loops.
    pub(crate) loops: Vec<Loop>,
    /// The arguments of `mrroc identify` that measure one of the loops.
    pub(crate) example: &'static str,
    pub(crate) drawing: Drawing<'a>,
}

/// Draws the views of an arm.
type Views<'a> = dyn Fn(&Machine) -> [View; 2] + 'a;

/// Names of the joints of a robot that is no model, in the formulas.
const SYMBOLS: [&str; 8] = ["q1", "q2", "q3", "q4", "q5", "q6", "q7", "q8"];

/// Content of the figure of a machine.
pub(crate) enum Drawing<'a> {
    /// A robot that is no serial arm, of which nothing is known but its axes.
    None,
    Arm(Box<Views<'a>>),
    Gripper(&'a GripperParameters),
    Conveyor(&'a ConveyorParameters),
}

/// The data sheet of the robot of these numbers.
pub(crate) fn described(parameters: &Parameters) -> Description<'_> {
    mrroc::each_robot!(parameters, it => it.description())
}
