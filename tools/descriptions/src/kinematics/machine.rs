//! Selection of a robot and its parameters, and numbers from the command line.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context as _, anyhow, ensure};
use clap::Args;
use controller::robot::{
    Arm, Joints, Limits, Mass, MotorRating, Motors, Pose, Rnt, RntParameters, Robot, RobotParameters as _, Vector,
};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::robots::described;
use mrroc::cell::{self, Axis, CellFile, Model, Parameters};
use mrroc::report::counted;

/// Tolerance of the norm of a quaternion.
const NORM: f64 = 0.01;

/// Which robot.
#[derive(Args)]
pub struct Which {
    /// The model of the robot, such as irp6-track. With --cell, the name of the robot in the cell.
    #[arg(long)]
    pub(crate) robot: String,
    /// A cell file. Its robot may have parameters of its own.
    #[arg(long)]
    pub(crate) cell: Option<PathBuf>,
}

/// A robot with its name and parameters.
pub struct Machine {
    /// Name of the robot or of its model.
    pub name: String,
    /// Kinematics and drive train.
    pub robot: Arc<dyn Robot>,
    /// Parameters of the robot.
    pub parameters: Parameters,
    /// Warning about the numbers.
    pub caution: Option<&'static str>,
    /// What stands before the names of links and joints: the name of a robot of a cell.
    pub(crate) prefix: String,
    /// Masses of the links.
    pub(crate) masses: Vec<Mass>,
    /// Load at the flange.
    pub(crate) load: Mass,
    /// What the motors can do.
    pub(crate) motors: Vec<MotorRating>,
    /// Where the velocities and efforts come from.
    pub(crate) source: &'static str,
    /// Place of the tool in the frame of the flange, m.
    pub(crate) tool: [f64; 3],
}

impl Machine {
    /// Finds a robot by name: a model, or a robot of a cell.
    pub fn find(Which { robot, cell }: &Which) -> anyhow::Result<Self> {
        let Some(path) = cell else {
            return Self::of(robot.clone(), preset(robot)?);
        };
        let file = CellFile::read(path)?;
        let found = file.cell.robot.iter().find(|candidate| candidate.name == *robot);
        let found = found.ok_or_else(|| {
            let names = file.cell.robot.iter().map(|robot| robot.name.as_str());
            unknown(&format!("{} has no robot", path.display()), robot, names)
        })?;
        Self::of(robot.clone(), found.numbers()).map(|of| of.in_cell(found))
    }

    /// The machine of a model.
    fn of(name: String, parameters: Parameters) -> anyhow::Result<Self> {
        let caution = described(&parameters).caution;
        Ok(Self {
            name,
            robot: parameters.kinematics()?,
            caution,
            prefix: String::new(),
            masses: parameters.masses(),
            load: Mass::default(),
            motors: mrroc::each_robot!(&parameters, it => it.motors()),
            source: "Velocities and efforts are those of the model's motors (nominal).",
            tool: [0.0; 3],
            parameters,
        })
    }

    /// The machine with what the cell states of it.
    fn in_cell(self, robot: &cell::Robot) -> Self {
        let weights = robot.weight.as_ref();
        Self {
            prefix: format!("{}_", robot.name),
            masses: weights.and_then(|weights| weights.masses.clone()).unwrap_or(self.masses),
            load: weights.map_or_else(Mass::default, |weights| weights.load),
            motors: robot.axis.iter().map(Axis::motor_rating).collect(),
            source: "Velocities and efforts are those of the cell: max_velocity, and rated_torque of a drive (or its \
                     object 0x6072) or max_current of an axis controller.",
            tool: robot.tool,
            ..self
        }
    }

    /// The robot with a tool at this place of the flange; the tool of the cell where absent.
    pub(super) fn arm(&self, tool: Option<[f64; 3]>) -> Arm {
        let [x, y, z] = tool.unwrap_or(self.tool);
        Arm::new(Arc::clone(&self.robot), Pose::translation(x, y, z))
    }

    /// Joint positions from a list of motor positions. The first three motors of the RNT are given by their leg
    /// lengths.
    pub(super) fn joints_from_motors(&self, list: &str) -> anyhow::Result<Joints> {
        let mut motors: Motors = self.vector("--motors", list)?;
        for (motor, leg) in motors.iter_mut().zip(self.rnt().iter().flat_map(|rnt| &rnt.legs)) {
            *motor = leg.motor(*motor);
        }
        let joints = self.robot.joints_from_motors(&motors);
        joints.with_context(|| format!("{}: no joints at these motors", self.name))
    }

    /// Parameters of the RNT, the robot with legs; `None` for any other robot.
    fn rnt(&self) -> Option<&RntParameters> {
        match &self.parameters {
            Parameters::Rnt(parameters) => Some(parameters),
            _ => None,
        }
    }

    /// Leg lengths at these joint positions, m; `None` for a robot without legs.
    pub(super) fn leg_lengths(&self, joints: &Joints) -> anyhow::Result<Option<[f64; 3]>> {
        let lengths = |rnt| anyhow::Ok(Rnt::new(rnt)?.leg_lengths(joints)?);
        self.rnt().map(lengths).transpose()
    }

    /// Ranges of the leg lengths, m; `None` for a robot without legs.
    pub(super) fn leg_limits(&self) -> Option<[Limits; 3]> {
        Some(self.rnt()?.legs.map(|leg| leg.length_limits))
    }

    /// Ends of each leg on the base and on the platform, m; `None` for a robot without legs.
    pub fn leg_ends(&self) -> Option<[[Vector3<f64>; 2]; 3]> {
        Some(self.rnt()?.leg_ends())
    }

    /// Parses a list of positions, one per axis.
    pub(super) fn vector<Space>(&self, option: &str, text: &str) -> anyhow::Result<Vector<Space>> {
        let numbers = list(option, text)?;
        let (given, axes) = (numbers.len(), self.robot.axes());
        let vector = Vector::new(&numbers).filter(|_| given == axes);
        vector.ok_or_else(|| anyhow!("{option}: {given} positions, and {} has {axes} axes", self.name))
    }
}

fn preset(name: &str) -> anyhow::Result<Parameters> {
    let unknown = || unknown("there is no robot", name, Model::all().into_iter().map(Model::name));
    Ok(Model::named(name).ok_or_else(unknown)?.parameters())
}

fn unknown<'a>(what: &str, name: &str, known: impl Iterator<Item = &'a str>) -> anyhow::Error {
    anyhow!("{what} {name:?}, only {}", known.collect::<Vec<_>>().join(", "))
}

/// Parses a list of finite numbers, separated by commas.
fn list(option: &str, text: &str) -> anyhow::Result<Vec<f64>> {
    let number = |part: &str| {
        let refused = |_| anyhow!("{option}: {part:?} is not a number, as in a list separated by commas");
        let value: f64 = part.trim().parse().map_err(refused)?;
        ensure!(value.is_finite(), "{option}: {part:?} is not finite");
        Ok(value)
    };
    text.split(',').map(number).collect()
}

pub(super) fn exactly<const N: usize>(option: &str, text: &str, form: &str) -> anyhow::Result<[f64; N]> {
    let numbers = list(option, text)?;
    let count = counted(numbers.len(), "number");
    numbers.try_into().map_err(|_| anyhow!("{option}: {count}, not the {N} of {form}"))
}

/// Parses a pose from its position and its quaternion.
pub(super) fn pose(position: &str, quaternion: &str) -> anyhow::Result<Isometry3<f64>> {
    let position = exactly::<3>("--position", position, "x,y,z")?;
    let [w, x, y, z] = exactly("--quaternion", quaternion, "w,x,y,z")?;
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    ensure!((norm - 1.0).abs() <= NORM, "--quaternion: its norm is {norm:.6}, and that of a rotation is 1");
    Ok(Isometry3::from_parts(Translation3::from(position), UnitQuaternion::from_quaternion(quaternion)))
}
