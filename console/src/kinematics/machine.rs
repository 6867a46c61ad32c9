//! The robot that is asked about.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context as _, anyhow};
use clap::Args;
use controller::cell::{Model, Parameters};
use controller::robot::{
    Irb6Parameters, Irp6Parameters, Irp6Track, Irp6TrackParameters, Joints, Limits, Motors,
    ParameterError, Polycrank, PolycrankParameters, Rnt, RntParameters, Robot, Vector,
};

use nalgebra::Vector3;

use super::numbers;
use crate::cell_file::CellFile;

/// Makes a robot of its own numbers.
type Make = fn() -> Result<Machine, ParameterError>;

/// The robots by name.
const ROBOTS: [(&str, Make); 5] = [
    ("irb6", || of_cell(&Model::Irb6.parameters())),
    ("irp6", || of_cell(&Model::Irp6.parameters())),
    ("irp6-track", || {
        let numbers = Irp6TrackParameters::irp6ot();
        let robot = Irp6Track::new(&numbers)?;
        Ok(Machine::new(Arc::new(robot), Numbers::Irp6Track(numbers)))
    }),
    ("rnt", || of_cell(&Model::Rnt.parameters())),
    ("polycrank", || {
        let numbers = PolycrankParameters::polycrank();
        let robot = Polycrank::new(&numbers)?;
        let mut machine = Machine::new(Arc::new(robot), Numbers::Polycrank(numbers));
        machine.caution = Some(POLYCRANK);
        Ok(machine)
    }),
];

const RNT: &str =
    "geometry, drives and limits of the RNT are nominal: none was measured or published";
const POLYCRANK: &str =
    "drives and home of the Polycrank are nominal: none was measured or published";

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

impl Which {
    /// The name, where no cell file has to be read to know whose it is.
    pub(crate) fn known(&self) -> Option<&str> {
        self.cell.is_none().then_some(&*self.robot)
    }

    #[cfg(test)]
    pub(crate) fn preset(name: &str) -> Self {
        Self {
            robot: name.into(),
            cell: None,
        }
    }
}

/// The parameters of a robot, by its kind.
#[derive(Clone, Copy)]
pub(crate) enum Numbers {
    Irb6(Irb6Parameters),
    Irp6(Irp6Parameters),
    Irp6Track(Irp6TrackParameters),
    Rnt(RntParameters),
    Polycrank(PolycrankParameters),
}

/// A robot by name.
pub(crate) struct Machine {
    pub(crate) name: String,
    pub(crate) robot: Arc<dyn Robot>,
    pub(crate) numbers: Numbers,
    /// Of a robot that has legs.
    rnt: Option<Rnt>,
    /// What must be known of the numbers.
    pub(crate) caution: Option<&'static str>,
}

impl Machine {
    fn new(robot: Arc<dyn Robot>, numbers: Numbers) -> Self {
        Self {
            name: String::new(),
            robot,
            numbers,
            rnt: None,
            caution: None,
        }
    }

    pub(crate) fn find(Which { robot, cell }: &Which) -> anyhow::Result<Self> {
        let machine = match cell {
            None => preset(robot)?,
            Some(cell) => {
                let file = CellFile::read(cell)?;
                let mut robots = file.cell.robot.iter();
                let found = robots.find(|candidate| candidate.name == *robot);
                let found = found.ok_or_else(|| {
                    let names = file.cell.robot.iter().map(|robot| robot.name.as_str());
                    unknown(&format!("{} has no robot", cell.display()), robot, names)
                })?;
                of_cell(&found.parameters.unwrap_or_else(|| found.model.parameters()))?
            }
        };
        Ok(Self {
            name: robot.clone(),
            ..machine
        })
    }

    /// The joints of a list.
    pub(super) fn joints(&self, option: &str, list: &str) -> anyhow::Result<Joints> {
        self.vector(option, list)
    }

    /// The joints at a list of motor positions, of the RNT's legs at their lengths.
    pub(super) fn joints_from_motors(&self, list: &str) -> anyhow::Result<Joints> {
        let mut motors: Motors = self.vector("--motors", list)?;
        if let Numbers::Rnt(parameters) = &self.numbers {
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
        let rnt = self.rnt.as_ref();
        Ok(rnt.map(|rnt| rnt.leg_lengths(joints)).transpose()?)
    }

    /// Ranges of the legs, m, of a robot that has them.
    pub(super) fn leg_limits(&self) -> Option<[Limits; 3]> {
        let Numbers::Rnt(parameters) = &self.numbers else {
            return None;
        };
        Some(parameters.legs.map(|leg| leg.length_limits))
    }

    /// Where each leg begins on the base and ends on the platform, m, of a robot that has legs.
    pub(crate) fn leg_ends(&self) -> Option<[[Vector3<f64>; 2]; 3]> {
        let Numbers::Rnt(parameters) = &self.numbers else {
            return None;
        };
        Some(parameters.leg_ends())
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

/// The robot of these numbers of a cell.
fn of_cell(parameters: &Parameters) -> Result<Machine, ParameterError> {
    let robot = parameters.kinematics()?;
    Ok(match *parameters {
        Parameters::Irb6(numbers) => Machine::new(robot, Numbers::Irb6(numbers)),
        Parameters::Irp6(numbers) => Machine::new(robot, Numbers::Irp6(numbers)),
        Parameters::Rnt(numbers) => Machine {
            rnt: Some(Rnt::new(&numbers)?),
            caution: (numbers == RntParameters::nominal()).then_some(RNT),
            ..Machine::new(robot, Numbers::Rnt(numbers))
        },
    })
}

fn preset(name: &str) -> anyhow::Result<Machine> {
    let found = ROBOTS.iter().find(|(known, _)| *known == name);
    let names = ROBOTS.iter().map(|(known, _)| *known);
    let (_, make) = found.ok_or_else(|| unknown("there is no robot", name, names))?;
    Ok(make()?)
}

fn unknown<'a>(what: &str, name: &str, known: impl Iterator<Item = &'a str>) -> anyhow::Error {
    anyhow!(
        "{what} {name:?}, only {}",
        known.collect::<Vec<_>>().join(", ")
    )
}
