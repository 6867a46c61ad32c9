//! A cell file that was read and checked, with its device configuration files. The motions of its programs are not
//! checked here.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail};
use controller::robot::Arm;
use drive::cia402::Identity;
use serde::de::DeserializeOwned;
use thiserror::Error;

use crate::input;
use crate::inputs::Inputs;

use super::{Axis, Cell, CellError, LARGEST, device_configuration::DeviceConfiguration, read};

/// A cell with the arms of its robots, and the text of its file.
#[derive(Clone)]
pub struct CellFile {
    /// Path of the file.
    pub path: PathBuf,
    /// Text of the file.
    pub text: String,
    /// The cell.
    pub cell: Cell,
    /// The arms, one per robot.
    pub arms: Vec<Arm>,
    /// The device configurations by robot and axis, where the cell names a file.
    configurations: Vec<Vec<Option<DeviceConfiguration>>>,
    /// The robot descriptions that the cell names.
    descriptions: Vec<PathBuf>,
    /// The files that were read.
    inputs: Inputs,
}

/// An error of a cell file, with the path of the file.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{}:{error}", .path.display())]
pub struct FileError {
    /// Path of the file.
    pub path: PathBuf,
    /// The error.
    pub error: CellError,
}

impl CellFile {
    /// Reads and checks a cell file. The motions of its programs are checked by a rehearsal.
    pub fn read(path: impl AsRef<Path>) -> anyhow::Result<Self> {
        let path = path.as_ref();
        let inputs = Inputs::default();
        let bytes = inputs.read_of_cell("the cell file", path, LARGEST).with_context(|| path.display().to_string())?;
        let text = Cell::text(&bytes).map_err(|error| refusal(path, &error))?.to_owned();
        let mut descriptions = Vec::new();
        let mut description = |name: &str| {
            let path = path.parent().unwrap_or(path).join(name);
            let bytes = inputs.read_of_cell("a robot description of the cell", &path, input::SHEET);
            let text = String::from_utf8(bytes.map_err(|error| error.to_string())?.to_vec());
            descriptions.push(path);
            text.map_err(|error| format!("is no UTF-8 text from byte {} on", error.utf8_error().valid_up_to()))
        };
        let cell = Cell::parse_with(&text, &mut description).map_err(|error| refusal(path, &error))?;
        let arms = (0..cell.robot.len()).map(|robot| cell.arm(robot)).collect::<Result<_, _>>();
        let arms = arms.expect("a parsed cell has sound parameters");
        let mut file =
            Self { path: path.to_owned(), text, cell, arms, configurations: Vec::new(), descriptions, inputs };
        let mut refusals = Vec::new();
        for robot in 0..file.cell.robot.len() {
            let axes = 0..file.cell.robot[robot].axis.len();
            let read = axes.map(|axis| DeviceConfiguration::read(&file, robot, axis));
            let (read, failed): (Vec<_>, Vec<_>) = read.partition(Result::is_ok);
            refusals.extend(failed.into_iter().filter_map(Result::err));
            file.configurations.push(read.into_iter().flatten().collect());
        }
        // The files of all axes are told at once.
        match refusals.as_slice() {
            [] => {}
            [_] => return Err(refusals.remove(0)),
            several => bail!("{}", several.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")),
        }
        Ok(file)
    }

    /// The files that were read.
    pub(crate) fn inputs(&self) -> &Inputs {
        &self.inputs
    }

    /// The same cell for one run with its rehearsals, which read each further file once.
    pub(crate) fn for_one_run(&self) -> Self {
        Self { inputs: self.inputs.of_cell(), ..self.clone() }
    }

    /// The parameters of the task: the table `task`, empty where absent, without the tables of tasks of the command.
    pub fn parameters<T: DeserializeOwned>(&self) -> Result<T, FileError> {
        self.parameters_of(&[])
    }

    /// The parameters of a task of the command: the first of the tables `task.NAME` that the file has, or else the table
    /// `task`.
    pub(crate) fn parameters_of<T: DeserializeOwned>(&self, names: &[&str]) -> Result<T, FileError> {
        read::parameters(&self.text, names).map_err(|error| FileError { path: self.path.clone(), error })
    }

    /// The key of the table that [`parameters_of`](Self::parameters_of) reads.
    pub(crate) fn parameters_key(&self, names: &[&'static str]) -> super::Path {
        let task = super::Path::to("task");
        let own = names.iter().find(|name| self.cell.task.contains_key(**name));
        own.map_or(task.clone(), |name| task.then(*name))
    }

    /// The device configuration of axis `axis` of robot `robot`, if it has one.
    pub fn configuration(&self, robot: usize, axis: usize) -> Option<&DeviceConfiguration> {
        self.configurations[robot][axis].as_ref()
    }

    /// Flaws of the device configuration files on which no value depends.
    pub fn configuration_warnings(&self) -> impl Iterator<Item = String> {
        self.configurations.iter().flatten().flatten().flat_map(DeviceConfiguration::warnings)
    }

    /// The files that the cell names: robot descriptions, and the device configuration files of all axes that have one.
    pub fn named_files(&self) -> impl Iterator<Item = &Path> {
        let configurations = self.configurations.iter().flatten().flatten();
        let configurations = configurations.map(|configuration| configuration.path.as_path());
        self.descriptions.iter().map(PathBuf::as_path).chain(configurations)
    }

    /// Expected identity of the drive of an axis: from the cell, or from the device configuration file where the cell
    /// gives none.
    pub fn identity(&self, robot: usize, axis: usize) -> Identity {
        let drive = self.cell.robot[robot].axis[axis].cia402();
        let configured = |of: fn(&DeviceConfiguration) -> Option<u32>| self.configuration(robot, axis).and_then(of);
        Identity {
            vendor: drive.vendor,
            product: drive.product.or(configured(|dcf| dcf.product)),
            revision: drive.revision.or(configured(|dcf| dcf.revision)),
        }
    }

    /// The error of the value at `key`, with its line. The message gives the name of an axis in place of its number.
    pub fn refuse(&self, key: &super::Path, problem: impl std::fmt::Display) -> anyhow::Error {
        let problem = match key.robot().and_then(|robot| self.cell.robot.get(robot)) {
            Some(robot) => robot.naming_axes(problem),
            None => problem.to_string(),
        };
        refusal(&self.path, &CellError::at(&self.text, key, problem))
    }

    /// Finds the axis with this name, as robot and axis: ROBOT.AXIS, ROBOT/AXIS, or an axis name that is unique in the
    /// cell. With `on_can`, the axis has a drive on CAN, and a node-ID is a name too.
    pub fn find_axis(&self, wanted: &str, on_can: bool) -> anyhow::Result<(usize, usize)> {
        let axes = self.cell.robot.iter().enumerate().flat_map(|(number, robot)| {
            let axes = robot.axis.iter().enumerate();
            axes.map(move |(place, axis)| ((number, place), format!("{}.{}", robot.name, axis.name), axis))
        });
        let axes: Vec<_> = axes.filter(|(.., axis)| !on_can || axis.drive.is_some()).collect();
        if on_can && axes.is_empty() {
            bail!("{}: the cell has no drive on CAN", self.path.display());
        }
        let is_meant = |full: &str, axis: &Axis| {
            let by_node = on_can && wanted.parse() == Ok(axis.node);
            full == wanted || full == wanted.replace('/', ".") || axis.name == wanted || by_node
        };
        let name = |(_, full, axis): &(_, String, &Axis)| match on_can {
            true => format!("{full} (node {})", axis.node),
            false => full.clone(),
        };
        let which = if on_can { " with a drive on CAN" } else { "" };
        let found: Vec<_> = axes.iter().filter(|(_, full, axis)| is_meant(full, axis)).collect();
        match found[..] {
            [(place, ..)] => Ok(*place),
            [] => {
                let all: Vec<_> = axes.iter().map(name).collect();
                bail!("no axis is called {wanted:?}{which}; there are {}", all.join(", "))
            }
            _ => {
                let found: Vec<_> = found.into_iter().map(name).collect();
                bail!("more than one axis is called {wanted:?}{which}: {}", found.join(", "))
            }
        }
    }

    /// The same cell with these robots only, and without programs, meetings, sensors, I/O nodes and scene. Buses without
    /// a robot are left out.
    pub fn with_robots(&self, robots: &[usize]) -> Self {
        let mut file = self.clone();
        file.cell.robot = robots.iter().map(|&robot| self.cell.robot[robot].clone()).collect();
        file.arms = robots.iter().map(|&robot| self.arms[robot].clone()).collect();
        file.configurations = robots.iter().map(|&robot| self.configurations[robot].clone()).collect();
        let cell = &mut file.cell;
        for robot in &mut cell.robot {
            robot.program.clear();
            robot.force_law = None;
        }
        cell.io.clear();
        cell.force_sensor.clear();
        cell.ultrasonic.clear();
        cell.scene = None;
        let used = |name: &str| robots.iter().any(|&robot| self.cell.robot[robot].axis.iter().any(|it| it.bus == name));
        cell.bus.retain(|bus| used(&bus.name));
        cell.serial.retain(|serial| used(&serial.name));
        file
    }

    /// Name of axis `axis` of robot `robot` in reports.
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
