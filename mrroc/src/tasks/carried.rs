//! Tasks that the `mrroc` command carries.

use anyhow::bail;
use controller::ecp::Task;
use controller::executor::join_all;
use controller::trajectory_file::JointConvention;

use super::{Cell, Outcome, Program, Robot, teach};
#[cfg(feature = "command-line")]
use crate::Extension;

/// Built-in tasks of `mrroc run`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CarriedTask {
    /// The programs of the cell file: all robots enable, home, execute their instructions, and disable.
    #[default]
    Programs,
    /// All robots enable, home and disable.
    Home,
    /// Records positions of a robot on the operator's command, and writes a trajectory file. The table `task.teach` of
    /// the cell file, or the table `task`, has the parameters. Needs --operator.
    Teach,
    /// Executes the trajectory file that the table `task.replay` of the cell file names; the table `task.teach` where
    /// absent, or the table `task`.
    Replay,
}

impl CarriedTask {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Programs, Self::Home, Self::Teach, Self::Replay];

    /// The name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Programs => "programs",
            Self::Home => "home",
            Self::Teach => "teach",
            Self::Replay => "replay",
        }
    }

    /// The task.
    pub fn program(self) -> Program {
        self.with(None)
    }

    /// The task with the convention of the joints of its trajectory file, in place of the parameter `joints`. Refuses a
    /// convention for a task without such a file.
    pub fn program_with(self, joints: Option<JointConvention>) -> anyhow::Result<Program> {
        match (self, joints) {
            (Self::Programs | Self::Home, Some(_)) => {
                bail!("--joints: the task has no trajectory file: add --task replay or --task teach, or leave it out")
            }
            _ => Ok(self.with(joints)),
        }
    }

    fn with(self, joints: Option<JointConvention>) -> Program {
        match self {
            Self::Programs => Program { of_file: true, ..Program::of(programs) },
            Self::Home => Program::of(home),
            Self::Teach => Program::of(async move |cell: &mut Cell| teach::teach(cell, joints).await),
            Self::Replay => Program::of(async move |cell: &mut Cell| teach::replay(cell, joints).await),
        }
    }
}

/// The task of `mrroc run` and `mrroc check`.
#[cfg(feature = "command-line")]
#[derive(clap::Args, Clone, Debug)]
pub struct TaskOptions {
    /// The task of the robots. `programs` are the programs of the cell file.
    #[arg(long, default_value = "programs")]
    pub task: String,
    /// Meaning of the joints of upper arm and wrist pitch in the trajectory file of IRp-6 or IRb-6, in place of the
    /// parameter `joints` of the task. Files of MRROC++ since 8 October 2010 have relative joints.
    #[arg(long, value_name = "CONVENTION", value_parser = convention())]
    pub joints: Option<JointConvention>,
}

#[cfg(feature = "command-line")]
impl TaskOptions {
    /// The task, which may be one of `extension`, or why it cannot have these options.
    pub fn program(&self, extension: &Extension) -> anyhow::Result<Program> {
        match CarriedTask::ALL.into_iter().find(|task| task.name() == self.task) {
            Some(task) => task.program_with(self.joints),
            None if self.joints.is_some() => {
                bail!("--joints: the task {} has no trajectory file: leave it out", self.task)
            }
            None => extension.find(&self.task),
        }
    }
}

/// The convention of a word of the command line.
#[cfg(feature = "command-line")]
pub fn convention() -> impl clap::builder::TypedValueParser<Value = JointConvention> {
    use clap::builder::{PossibleValuesParser, TypedValueParser as _};

    let words = JointConvention::ALL.map(JointConvention::keyword);
    PossibleValuesParser::new(words).try_map(|word| JointConvention::of(&word).ok_or("no convention of joints"))
}

/// Executes the programs of the cell file, all robots at the same time.
///
/// An instruction that the robot cannot execute is refused with file, line and key before any robot moves.
async fn programs(cell: &mut Cell) -> Outcome {
    let file = cell.file();
    let task = |(robot, arm)| {
        file.cell.task(robot, arm).map_err(|(key, error)| {
            let axis = error.axis().map_or(String::new(), |axis| file.axis_name(robot, axis) + ", ");
            file.refuse(&key, format_args!("{axis}{error}"))
        })
    };
    let tasks: Vec<Task> = file.arms.iter().enumerate().map(task).collect::<anyhow::Result<_>>()?;
    let mut robots = cell.all_robots()?;
    join_all(robots.iter_mut().zip(tasks).map(|(robot, task)| robot.perform(task))).await
}

/// Homes all robots at the same time.
async fn home(cell: &mut Cell) -> Outcome {
    let mut robots = cell.all_robots()?;
    let home = async |robot: &mut Robot| {
        robot.enable().await?;
        robot.home().await?;
        robot.disable().await
    };
    join_all(robots.iter_mut().map(home)).await
}
