//! What a data sheet says of each robot beside its numbers.

mod arms;
mod devices;
mod polycrank;
mod rnt;

use mrroc::cell::Parameters;

use crate::datasheet::drives::Drive;
use crate::datasheet::loops::Loop;
use crate::datasheet::tables::Row;
use crate::datasheet::views::Drawing;
use crate::kinematics::Machine;

/// The data sheet of one robot.
pub(crate) trait Described {
    /// The robot in some sentences: its axes, its base frame, the sense of its joints.
    fn about(&self) -> &'static str;

    /// Names of the joints in the formulas; none of a device beside a robot.
    fn symbols(&self) -> &'static [&'static str] {
        &[]
    }

    /// Title of the table of its lengths.
    fn title(&self) -> &'static str {
        "Geometry"
    }

    /// What must be known of the numbers.
    fn caution(&self) -> Option<&'static str> {
        None
    }

    /// Its lengths.
    fn lengths(&self) -> Vec<Row>;

    /// Its axes.
    fn drives(&self) -> Vec<Drive> {
        Vec::new()
    }

    /// The measured loops, and the arguments that measure one of them.
    fn loops(&self) -> (Vec<Loop>, &'static str);

    /// What its figure shows.
    fn drawing<'a>(&'a self, machine: &Machine) -> Drawing<'a>;
}

/// The data sheet of the robot of these numbers.
pub(crate) fn described(parameters: &Parameters) -> &dyn Described {
    mrroc::each_robot!(parameters, it => it as &dyn Described)
}
