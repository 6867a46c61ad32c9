//! Report of an error that a drive reported without a fault.

use std::fmt;

use drive::Warning;
use serde::Serialize;

use crate::cell::CellFile;

/// One error of one drive, and how often the drive reported the error.
#[derive(Debug, Serialize)]
pub struct WarningReport {
    /// The bus.
    bus: String,
    /// The axis, as in [`AxisReport::name`](crate::report::AxisReport::name).
    axis: Option<String>,
    /// Node-ID.
    node: u8,
    /// Error code of the EMCY.
    code: u16,
    /// Error register of the EMCY (object 0x1001).
    register: u8,
    /// Time of the first report, from the end of bring-up, s.
    time_s: f64,
    /// How often the drive reported it.
    count: u64,
    /// Description of the error.
    what: String,
}

impl WarningReport {
    /// A warning of drive group `group`.
    pub fn of(file: &CellFile, group: usize, warning: &Warning) -> Self {
        let node = |&(robot, axis): &(usize, usize)| {
            file.cell.robot[robot].axis[axis].node == warning.node
        };
        let axis = file.cell.axes_on(group).find(node);
        Self {
            bus: file.cell.groups().nth(group).unwrap_or_default().to_owned(),
            axis: axis.map(|(robot, axis)| file.axis_name(robot, axis)),
            node: warning.node,
            code: warning.code,
            register: warning.register,
            time_s: warning.after.as_secs_f64(),
            count: warning.count,
            what: warning.to_string(),
        }
    }
}

impl fmt::Display for WarningReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "bus {}", self.bus)?;
        if let Some(axis) = &self.axis {
            write!(f, ", axis {axis}")?;
        }
        write!(f, ": {}, at {:.3} s", self.what, self.time_s)?;
        if self.count > 1 {
            write!(f, " and {} times more", self.count - 1)?;
        }
        Ok(())
    }
}
