//! A cell file that was read and checked, with the device configuration files it names; what its programs ask for is not
//! yet looked at.

use std::path::{Path, PathBuf};

use crate::cell::{Cell, CellError};
use anyhow::{Context, anyhow};
use controller::generator::Arm;
use drive::cia402::Identity;

use crate::configuration::Configuration;

/// A cell with the arms of its robots, and the text it came from.
pub struct CellFile {
    /// Path of the file.
    pub path: PathBuf,
    /// Text of the file.
    pub text: String,
    /// The cell.
    pub cell: Cell,
    /// One per robot.
    pub arms: Vec<Arm>,
    /// Of each axis of each robot that has a device configuration file.
    configurations: Vec<Vec<Option<Configuration>>>,
}

impl CellFile {
    /// Reads and checks a cell file. What its programs ask for is not looked at: that is a rehearsal's work.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
        let cell = Cell::parse(&text).map_err(|error| refusal(path, &error))?;
        let arms = cell
            .robot
            .iter()
            .map(|robot| robot.arm().expect("a parsed cell has sound parameters"))
            .collect();
        let mut file = Self {
            path: path.to_owned(),
            text,
            cell,
            arms,
            configurations: Vec::new(),
        };
        for robot in 0..file.cell.robot.len() {
            let axes = 0..file.cell.robot[robot].axis.len();
            let read = axes.map(|axis| Configuration::read(&file, robot, axis));
            let read = read.collect::<anyhow::Result<_>>()?;
            file.configurations.push(read);
        }
        Ok(file)
    }

    /// The device configuration of axis `axis` of robot `robot`, if it has one.
    pub fn configuration(&self, robot: usize, axis: usize) -> Option<&Configuration> {
        self.configurations[robot][axis].as_ref()
    }

    /// Who the drive of an axis must be: by the cell, and by its device configuration file where the cell does not say.
    pub fn identity(&self, robot: usize, axis: usize) -> Identity {
        let drive = self.cell.robot[robot].axis[axis].cia402();
        let configured = self.configuration(robot, axis);
        let configured = |of: fn(&Configuration) -> Option<u32>| configured.and_then(of);
        Identity {
            vendor: drive.vendor,
            product: drive.product.or(configured(|dcf| dcf.product)),
            revision: drive.revision.or(configured(|dcf| dcf.revision)),
        }
    }

    /// The error of the value at `key`, with its line.
    pub fn refuse(
        &self,
        key: &crate::cell::Path,
        problem: impl std::fmt::Display,
    ) -> anyhow::Error {
        refusal(&self.path, &CellError::at(&self.text, key, problem))
    }

    /// What reports call axis `axis` of robot `robot`.
    pub fn axis_name(&self, robot: usize, axis: usize) -> String {
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
