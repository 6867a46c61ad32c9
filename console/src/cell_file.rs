//! A cell file that was read and checked; what its programs ask for is not yet looked at.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use controller::cell::{Cell, CellError};
use controller::generator::Arm;

/// A cell with the arms of its robots, and the text it came from.
pub(crate) struct CellFile {
    pub(crate) path: PathBuf,
    pub(crate) text: String,
    pub(crate) cell: Cell,
    /// One per robot.
    pub(crate) arms: Vec<Arm>,
}

impl CellFile {
    /// Reads and checks a cell file. What its programs ask for is not looked at: that is a rehearsal's work.
    pub(crate) fn read(path: &Path) -> anyhow::Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
        let cell = Cell::parse(&text).map_err(|error| refusal(path, &error))?;
        let arms = cell
            .robot
            .iter()
            .map(|robot| robot.arm().expect("a parsed cell has sound parameters"))
            .collect();
        Ok(Self {
            path: path.to_owned(),
            text,
            cell,
            arms,
        })
    }

    /// The error of the value at `key`, with its line.
    pub(crate) fn refuse(
        &self,
        key: &controller::cell::Path,
        problem: impl std::fmt::Display,
    ) -> anyhow::Error {
        refusal(&self.path, &CellError::at(&self.text, key, problem))
    }

    /// What reports call axis `axis` of robot `robot`.
    pub(crate) fn axis_name(&self, robot: usize, axis: usize) -> String {
        let robot = &self.cell.robot[robot];
        if self.cell.robot.len() == 1 {
            robot.axis[axis].name.clone()
        } else {
            format!("{}.{}", robot.name, robot.axis[axis].name)
        }
    }
}

fn refusal(path: &Path, error: &CellError) -> anyhow::Error {
    anyhow!("{}:{error}", path.display())
}
