//! What the device configuration files of a cell ask of its drives, for `check`, the report and the page of a run.

use std::fmt;

use serde::Serialize;

use super::{counted, counted_as};
use crate::cell::{CellFile, printable};

/// The device configuration file of one axis.
#[derive(Debug, Serialize)]
pub struct ConfigurationReport {
    axis: String,
    file: String,
    writes: usize,
    /// Writes of defaults, which are made where the drive holds another value.
    defaults: usize,
    /// Read-only values in the file, which are compared with the drive.
    compared: usize,
    /// Values in the file that are not written.
    left_out: usize,
    /// Lines that are not as CiA 306 has them, and on which no value depends.
    warnings: Vec<String>,
}

impl ConfigurationReport {
    /// The file of axis `axis` of robot `robot`, with the name of the axis in the report; `None` without a file.
    pub(crate) fn of(file: &CellFile, robot: usize, axis: usize, name: String) -> Option<Self> {
        let configuration = file.configuration(robot, axis)?;
        Some(Self {
            axis: name,
            file: printable(&configuration.path.display().to_string()),
            writes: configuration.download.writes.len(),
            defaults: configuration.download.defaults(),
            compared: configuration.download.compared.len(),
            left_out: configuration.download.left_out,
            warnings: configuration.warnings().collect(),
        })
    }

    /// The files of all axes.
    pub(crate) fn all(file: &CellFile) -> Vec<Self> {
        let axes = file.cell.robot.iter().enumerate();
        let axes = axes.flat_map(|(robot, value)| (0..value.axis.len()).map(move |axis| (robot, axis)));
        axes.filter_map(|(robot, axis)| Self::of(file, robot, axis, file.axis_name(robot, axis))).collect()
    }

    /// What the file asks for, the axis in the first line.
    pub(crate) fn lines(&self) -> impl Iterator<Item = String> {
        let Self { axis, file, writes, defaults, compared, left_out, .. } = self;
        let defaults = (*defaults > 0).then(|| {
            counted_as(*defaults, "write is of a default", "writes are of defaults")
                + ", made where the drive holds another value"
        });
        let compared = (*compared > 0)
            .then(|| counted_as(*compared, "read-only value is", "read-only values are") + " compared with the drive");
        let (writes, values) = (counted(*writes, "write"), counted(*left_out, "value"));
        let first = format!("axis {axis}: {file} asks for {writes} and notes {values} more");
        [Some(first), defaults, compared].into_iter().flatten()
    }

    /// The flaws of the file, each kind in one line.
    #[cfg(feature = "pages")]
    pub(crate) fn warnings(&self) -> &[String] {
        &self.warnings
    }
}

impl fmt::Display for ConfigurationReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.lines().collect::<Vec<_>>().join("; "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_write_and_one_value_are_told_in_the_singular() {
        let of = |number: usize| ConfigurationReport {
            axis: "column".into(),
            file: "motor.dcf".into(),
            writes: number,
            defaults: number,
            compared: number,
            left_out: number,
            warnings: Vec::new(),
        };
        let one = "axis column: motor.dcf asks for 1 write and notes 1 value more; 1 write is of a default, made where \
                   the drive holds another value; 1 read-only value is compared with the drive";
        assert_eq!(of(1).to_string(), one);
        let two = "axis column: motor.dcf asks for 2 writes and notes 2 values more; 2 writes are of defaults, made \
                   where the drive holds another value; 2 read-only values are compared with the drive";
        assert_eq!(of(2).to_string(), two);
    }
}
