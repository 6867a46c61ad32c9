//! The robot that is asked about.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context as _, anyhow};
use clap::Args;
use controller::cell::{Model, Parameters};
use controller::robot::{Joints, Limits, Motors, Rnt, RntParameters, Robot, Vector};

use nalgebra::Vector3;

use super::numbers;
use crate::cell_file::CellFile;

/// The robots by name.
const MODELS: [(&str, Model); 3] = [
    ("irb6", Model::Irb6),
    ("irp6", Model::Irp6),
    ("rnt", Model::Rnt),
];

/// Which robot.
#[derive(Args)]
pub(crate) struct Which {
    /// The robot: irb6, irp6, irp6-track, rnt or polycrank; with --cell the name of one of its robots.
    #[arg(long)]
    robot: String,
    /// A cell file, whose robot may have parameters of its own.
    #[arg(long)]
    cell: Option<PathBuf>,
}

/// A robot by name.
pub(crate) struct Machine {
    pub(crate) name: String,
    pub(crate) robot: Arc<dyn Robot>,
    parameters: Parameters,
}

impl Machine {
    pub(crate) fn find(Which { robot, cell }: &Options) -> anyhow::Result<Self> {
        let parameters = match cell {
            None => model(robot)?.parameters(),
            Some(cell) => {
                let file = CellFile::read(cell)?;
                let mut robots = file.cell.robot.iter();
                let found = robots.find(|candidate| candidate.name == *robot);
                let found = found.ok_or_else(|| {
                    let names = file.cell.robot.iter().map(|robot| robot.name.as_str());
                    unknown(&format!("{} has no robot", cell.display()), robot, names)
                })?;
                found.parameters.unwrap_or_else(|| found.model.parameters())
            }
        };
        Ok(Self {
            name: robot.clone(),
            robot: parameters.kinematics().context("unsound parameters")?,
            parameters,
        })
    }

    /// The joints of a list.
    pub(super) fn joints(&self, option: &str, list: &str) -> anyhow::Result<Joints> {
        self.vector(option, list)
    }

    /// The joints at a list of motor positions, of the RNT's legs at their lengths.
    pub(super) fn joints_from_motors(&self, list: &str) -> anyhow::Result<Joints> {
        let mut motors: Motors = self.vector("--motors", list)?;
        if let Parameters::Rnt(parameters) = &self.parameters {
            for (motor, leg) in motors.iter_mut().zip(&parameters.legs) {
                *motor = leg.motor(*motor);
            }
        }
        let joints = self.robot.joints_from_motors(&motors);
        joints.with_context(|| format!("{}: no joints at these motors", self.name))
    }

    /// The joints at home.
    pub(super) fn home(&self) -> anyhow::Result<Joints> {
        Ok(self.robot.joints_from_motors(&self.robot.home())?)
    }

    /// Leg lengths at these joints, m, of a robot that has legs.
    pub(super) fn leg_lengths(&self, joints: &Joints) -> anyhow::Result<Option<[f64; 3]>> {
        let Parameters::Rnt(parameters) = &self.parameters else {
            return Ok(None);
        };
        let rnt = Rnt::new(parameters).context("unsound parameters")?;
        Ok(Some(rnt.leg_lengths(joints)?))
    }

    /// Ranges of the legs, m, of a robot that has them.
    pub(super) fn leg_limits(&self) -> Option<[Limits; 3]> {
        match &self.parameters {
            Parameters::Rnt(parameters) => Some(parameters.legs.map(|leg| leg.length_limits)),
            Parameters::Irb6(_) | Parameters::Irp6(_) => None,
        }
    }

    /// Where each leg begins on the base and ends on the platform, m, of a robot that has legs.
    pub(crate) fn legs(&self) -> Option<[[Vector3<f64>; 2]; 3]> {
        match &self.parameters {
            Parameters::Rnt(parameters) => Some(parameters.leg_ends()),
            Parameters::Irb6(_) | Parameters::Irp6(_) => None,
        }
    }

    /// What must be known of the numbers.
    pub(crate) fn caution(&self) -> Option<&'static str> {
        let nominal = match self.parameters {
            Parameters::Rnt(parameters) => parameters == RntParameters::nominal(),
            Parameters::Irb6(_) | Parameters::Irp6(_) => false,
        };
        nominal.then_some(
            "geometry, drives and limits of the RNT are nominal: none was measured or published",
        )
    }

    fn vector<Space>(&self, option: &str, text: &str) -> anyhow::Result<Vector<Space>> {
        let numbers = numbers::list(option, text)?;
        let (given, axes) = (numbers.len(), self.robot.axes());
        let vector = Vector::new(&numbers).filter(|_| given == axes);
        vector.ok_or_else(|| {
            anyhow!(
                "{option}: {given} positions, and {} has {axes} axes",
                self.name
            )
        })
    }
}

fn model(name: &str) -> anyhow::Result<Model> {
    let found = MODELS.iter().find(|(known, _)| *known == name);
    let names = MODELS.iter().map(|(known, _)| *known);
    let (_, model) = found.ok_or_else(|| unknown("there is no robot", name, names))?;
    Ok(*model)
}

fn unknown<'a>(what: &str, name: &str, known: impl Iterator<Item = &'a str>) -> anyhow::Error {
    anyhow!(
        "{what} {name:?}, only {}",
        known.collect::<Vec<_>>().join(", ")
    )
}
