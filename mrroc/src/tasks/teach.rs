//! Teach-in and replay: the tasks that write and execute a trajectory file.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::anyhow;
use controller::ecp::Class;
use controller::generator::{Newsmooth, SmoothPose};
use controller::robot::Space;
use controller::sensor::Question;
use controller::trajectory_file::{Coordinates, JointConvention, MOST_POSES, MotionType, TrajectoryFile};
use serde::Deserialize;
use servo::MAX_AXES;

use super::draft::Draft;
use super::{Cell, Outcome, Robot, TaskError};
use crate::cell;
use crate::report::{counted, counted_as};

/// Parameters of both tasks: the table `task` of the cell file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Parameters {
    /// The trajectory file, relative to the cell file.
    file: PathBuf,
    /// The robot. A cell with one robot needs no name.
    robot: Option<String>,
    /// Fractions of the limits of velocity and acceleration, for the motions of the teach-in and for those in the file.
    #[serde(default)]
    velocity: Fraction,
    #[serde(default)]
    acceleration: Fraction,
    /// Whether the drives stay on during the teach-in. With the drives off, the operator moves the robot by hand.
    #[serde(default = "on")]
    drives_on: bool,
    #[serde(default)]
    coordinates: Taught,
    /// Convention of the joints in a JOINT file. A replayed file that tells its own convention needs none. A taught file
    /// tells its convention; where absent, the joints are inclinations.
    joints: Option<JointConvention>,
    /// Whether the teach-in replaces an existing file.
    #[serde(default)]
    replace: bool,
}

/// Coordinates of a taught file.
#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Taught {
    #[default]
    Joint,
    Motor,
}

/// A number above 0 and at most 1.
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "f64")]
struct Fraction(f64);

impl Default for Fraction {
    fn default() -> Self {
        Self(0.2)
    }
}

impl TryFrom<f64> for Fraction {
    type Error = &'static str;

    fn try_from(value: f64) -> Result<Self, &'static str> {
        if value > 0.0 && value <= 1.0 { Ok(Self(value)) } else { Err("must be above 0 and at most 1") }
    }
}

const fn on() -> bool {
    true
}

impl Parameters {
    /// Path of the trajectory file.
    fn path(&self, cell: &Cell) -> PathBuf {
        let cell_file = &cell.file().path;
        cell_file.parent().unwrap_or(cell_file).join(&self.file)
    }

    fn robot(&self, cell: &Cell) -> Result<Robot, TaskError> {
        match (&self.robot, &cell.file().cell.robot[..]) {
            (Some(name), _) => cell.robot(name),
            (None, [robot]) => cell.robot(&robot.name),
            (None, _) => {
                let problem = "is missing: the cell has several robots";
                Err(cell.file().refuse(&cell::Path::to("task").then("robot"), problem).into())
            }
        }
    }

    fn pose(&self, position: [f64; MAX_AXES]) -> SmoothPose {
        let (velocity, acceleration) = ([self.velocity.0; MAX_AXES], [self.acceleration.0; MAX_AXES]);
        SmoothPose { position, velocity, acceleration }
    }
}

/// A command of the operator during a teach-in.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Order {
    Record,
    /// A displacement of one axis, rad or m.
    Move {
        axis: usize,
        by: f64,
    },
    Done,
}

/// Orders in the words of the operator.
const ORDERS: &str = "record, move AXIS BY, or done";

impl Order {
    /// The order of a line. `axes` are the names of the robot's axes. An axis is AXIS, ROBOT.AXIS or ROBOT/AXIS.
    fn parse(line: &str, robot: &str, axes: &[&str]) -> Result<Self, String> {
        let words: Vec<_> = line.split_whitespace().collect();
        match words[..] {
            ["record"] => Ok(Self::Record),
            ["done"] => Ok(Self::Done),
            ["move", axis, by] => {
                let own = axis.strip_prefix(robot).and_then(|rest| rest.strip_prefix(['.', '/']));
                let index = axes.iter().position(|name| *name == axis || Some(*name) == own);
                let axis = index.ok_or_else(|| format!("no axis {axis:?}; axes are {}", axes.join(", ")))?;
                let number = by.parse::<f64>().ok().filter(|by| by.is_finite());
                let by = number.ok_or_else(|| format!("{by:?} is no displacement in rad or m"))?;
                Ok(Self::Move { axis, by })
            }
            _ => Err(format!("{line:?} is no order; orders are {ORDERS}")),
        }
    }
}

/// Homes the robot, records its position at each order `record` of the operator, and writes the file at `done`.
///
/// `joints` replaces the parameter of this name.
pub(super) async fn teach(cell: &mut Cell, joints: Option<JointConvention>) -> Outcome {
    let parameters: Parameters = cell.parameters_of(&["teach"])?;
    let path = parameters.path(cell);
    let mut robot = parameters.robot(cell)?;
    let key = cell.file().parameters_key(&["teach"]).then("file");
    if !parameters.replace && fs::symlink_metadata(&path).is_ok() {
        let problem = format!("{} is there already: name another, or set replace = true", path.display());
        return Err(cell.file().refuse(&key, problem).into());
    }
    if let Some(what) = cell.file().inputs().reads(&path) {
        let problem = format!("{} is {what}: name another", path.display());
        return Err(cell.file().refuse(&key, problem).into());
    }
    cell.file().inputs().protect_target("the trajectory file of the task", &path);
    robot.enable().await?;
    robot.home().await?;
    if !parameters.drives_on {
        let name = robot.name();
        let question = format!("{name}: support the arm. Switch the drives off?");
        if cell.ask(Question::new(question, ["off", "cancel"])).await? == "cancel" {
            return robot.disable().await;
        }
        robot.disable().await?;
    }
    let mut taught = TaughtPoses {
        coordinates: match parameters.coordinates {
            Taught::Joint => Coordinates::Joint,
            Taught::Motor => Coordinates::Motor,
        },
        convention: joints.or(parameters.joints).unwrap_or(JointConvention::Inclination),
        lower_arm: robot.motions().arm().robot().lower_arm(),
        axes: robot.motions().arm().axes(),
        poses: Vec::new(),
        draft: Draft::of(&path),
    };
    let recorded = record(cell, &mut robot, &parameters, &mut taught).await;
    if recorded.is_err() {
        taught.leave(cell);
    }
    recorded?;
    let count = taught.poses.len();
    cell.tell(format!("{}: {}", path.display(), counted(count, "pose")));
    cell.figure("poses", count as f64);
    robot.disable().await
}

/// Number of poses up to which each pose is written at once. A longer file is written at each hundredth pose.
const EACH: usize = 1000;

/// The poses of a teach-in. They are in a file beside the trajectory file before it is complete, so that no end of the
/// run loses them.
struct TaughtPoses {
    coordinates: Coordinates,
    /// Convention of the joints in the file.
    convention: JointConvention,
    /// Index of the lower arm of a robot whose joints are of one of the conventions.
    lower_arm: Option<usize>,
    axes: usize,
    poses: Vec<SmoothPose>,
    draft: Draft,
}

impl TaughtPoses {
    /// The text of the trajectory file.
    fn text(&self) -> anyhow::Result<String> {
        let file = TrajectoryFile::new(self.coordinates, MotionType::Absolute, self.axes, self.poses.clone());
        let file = file.map_err(|error| anyhow!(error))?;
        Ok(if self.lower_arm.is_some() { file.telling(self.convention) } else { file }.to_string())
    }

    /// The joints in the convention of the file.
    fn joints(&self, joints: [f64; MAX_AXES]) -> [f64; MAX_AXES] {
        let of_file = |axis| self.convention.of_inclinations(&joints, axis, MotionType::Absolute);
        self.lower_arm.map_or(joints, of_file)
    }

    /// Adds a pose and writes all of them to the draft.
    fn add(&mut self, pose: SmoothPose, cell: &Cell) {
        self.poses.push(pose);
        let count = self.poses.len();
        if count > EACH && !count.is_multiple_of(100) {
            return;
        }
        match self.save() {
            Ok(()) if count == 1 => {
                let place = self.draft.place().unwrap_or(Path::new("")).display();
                cell.tell(format!("the poses are kept in {place} until done"));
            }
            Ok(()) => {}
            Err(error) => cell.tell(format!("pose {count} is kept in memory alone: {error:#}: free space on the disk")),
        }
    }

    fn save(&mut self) -> anyhow::Result<()> {
        let text = self.text()?;
        self.draft.save(&text)
    }

    /// Completes the trajectory file.
    fn complete(&mut self, replace: bool) -> anyhow::Result<()> {
        self.save()?;
        self.draft.complete(replace)
    }

    /// Tells where the poses are after a teach-in that was not completed.
    fn leave(&mut self, cell: &Cell) {
        if self.poses.is_empty() {
            return;
        }
        let count = self.poses.len();
        match (self.save(), self.draft.place()) {
            (Ok(()), Some(place)) => {
                let poses = counted_as(count, "pose is", "poses are");
                cell.tell(format!("{poses} in {}: rename it to replay it", place.display()));
            }
            (saved, _) => {
                let why = saved.err().map(|error| format!("{error:#}: ")).unwrap_or_default();
                let poses = counted_as(count, "pose is", "poses are");
                cell.tell(format!("{why}the {poses}:\n{}", self.text().unwrap_or_default()));
            }
        }
    }
}

/// Records the poses of the operator, at least one, and writes the file.
async fn record(cell: &Cell, robot: &mut Robot, parameters: &Parameters, taught: &mut TaughtPoses) -> Outcome {
    let name = robot.name().to_owned();
    let axes = cell.file().cell.robot.iter().find(|it| it.name == name).map(|it| &it.axis[..]).unwrap_or_default();
    let axes: Vec<_> = axes.iter().map(|axis| axis.name.as_str()).collect();
    loop {
        let line = cell.ask(Question::open(format!("{name}: {ORDERS}?"))).await?;
        match Order::parse(&line, &name, &axes) {
            Ok(Order::Record) if taught.poses.len() == MOST_POSES => {
                cell.tell(format!("a file has at most {MOST_POSES} poses"));
            }
            Ok(Order::Record) => {
                // With the drives off, the commanded position is the measured one.
                let commanded = robot.image()?.commanded;
                let position = match parameters.coordinates {
                    Taught::Joint => taught.joints(commanded.joints.position),
                    Taught::Motor => commanded.motors.position,
                };
                taught.add(parameters.pose(position), cell);
                let joints = &commanded.joints.position[..axes.len()];
                cell.tell(format!("pose {}: joints {joints:.4?}", taught.poses.len()));
            }
            Ok(Order::Move { .. }) if !parameters.drives_on => cell.tell("the drives are off: move the robot by hand"),
            Ok(Order::Move { axis, by }) => match displace(robot, parameters, axis, by).await {
                Err(error) if error.class() == Class::NonFatal => cell.tell(error.to_string()),
                moved => moved?,
            },
            Ok(Order::Done) if taught.poses.is_empty() => cell.tell("no pose is recorded"),
            Ok(Order::Done) => match taught.complete(parameters.replace) {
                Ok(()) => return Ok(()),
                Err(error) => cell.tell(format!("{error:#}: the poses are kept: remove the cause, then done again")),
            },
            Err(problem) => cell.tell(problem),
        }
    }
}

/// Moves one joint by a displacement, rad or m.
async fn displace(robot: &mut Robot, parameters: &Parameters, axis: usize, by: f64) -> Outcome {
    let motions = robot.motions();
    let mut target = robot.image()?.commanded.joints.position;
    target[axis] += by;
    motions.arm().motors(&target)?;
    let poses = vec![parameters.pose(target)];
    robot.execute(Newsmooth::new(Space::Joint, motions.arm().axes(), motions.limits(), poses)?).await
}

/// Homes the robot and executes the trajectory file. `joints` replaces the parameter of this name.
pub(super) async fn replay(cell: &mut Cell, joints: Option<JointConvention>) -> Outcome {
    const TABLES: [&str; 2] = ["replay", "teach"];
    let parameters: Parameters = cell.parameters_of(&TABLES)?;
    let mut robot = parameters.robot(cell)?;
    let remedy = format!("set {}, or give --joints", cell.file().parameters_key(&TABLES).then("joints"));
    let motion = robot.motions().trajectory_of(&parameters.path(cell), joints.or(parameters.joints), &remedy)?;
    robot.enable().await?;
    robot.home().await?;
    robot.execute(motion).await?;
    robot.disable().await
}

#[cfg(test)]
mod tests {
    //! Orders, and refusals of trajectory files.

    use super::*;
    use crate::cell::CellFile;
    use crate::rehearsal::rehearse;
    use crate::tasks::CarriedTask;

    const IRB6: &str = include_str!("../../../cells/irb6.toml");

    #[test]
    fn a_refused_joint_file_names_the_table_that_has_the_parameters() {
        let directory = tempfile::tempdir().unwrap();
        let joints = "JOINT\n1\nABSOLUTE\n1 1 1 1 1\n1 1 1 1 1\n0.3 -1.5 0.1 0.2 0\n";
        fs::write(directory.path().join("irb6.trj"), joints).unwrap();
        let (cell, _) = IRB6.split_once("[task]").unwrap();
        for table in ["task.teach", "task.replay", "task"] {
            let path = directory.path().join("cell.toml");
            fs::write(&path, format!("{cell}[{table}]\nfile = \"irb6.trj\"\n")).unwrap();
            let file = CellFile::read(&path).unwrap();
            let said = format!("{:#}", rehearse(&file, &CarriedTask::Replay.program()).unwrap_err());
            assert!(said.contains(&format!("inclinations: set {table}.joints, or give --joints")), "{said}");
        }
    }

    #[test]
    fn orders_are_words_of_the_operator_and_other_lines_are_refused_with_the_reason() {
        let axes = ["column", "lower-arm"];
        let table = [
            ("record", Ok(Order::Record)),
            (" move  lower-arm -0.25 ", Ok(Order::Move { axis: 1, by: -0.25 })),
            ("done", Ok(Order::Done)),
            ("move irb6.column 0.3", Ok(Order::Move { axis: 0, by: 0.3 })),
            ("move irb6/lower-arm 0.1", Ok(Order::Move { axis: 1, by: 0.1 })),
            ("move irb6column 0.1", Err("no axis \"irb6column\"; axes are column, lower-arm")),
            ("move irp6.column 0.1", Err("no axis \"irp6.column\"; axes are column, lower-arm")),
            ("", Err("\"\" is no order; orders are record, move AXIS BY, or done")),
            ("record 2", Err("\"record 2\" is no order; orders are record, move AXIS BY, or done")),
            ("move elbow 0.1", Err("no axis \"elbow\"; axes are column, lower-arm")),
            ("move column NaN", Err("\"NaN\" is no displacement in rad or m")),
        ];
        for (line, order) in table {
            assert_eq!(Order::parse(line, "irb6", &axes), order.map_err(str::to_owned), "{line:?}");
        }
    }
}
