//! Tasks that the `mrroc` command carries.

use controller::ecp::Task;
use controller::executor::join_all;

use super::{Cell, Outcome, Program, Robot, teach};

/// Built-in tasks of `mrroc run`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "command-line", derive(clap::ValueEnum))]
pub enum CarriedTask {
    /// The programs of the cell file: all robots enable, home, execute their instructions, and disable.
    #[default]
    Programs,
    /// All robots enable, home and disable.
    Home,
    /// Records positions of a robot on the operator's command, and writes a trajectory file. The table `task` of the
    /// cell file has the parameters. Needs --operator.
    Teach,
    /// Executes the trajectory file that the table `task` of the cell file names.
    Replay,
}

impl CarriedTask {
    /// The task.
    pub fn program(self) -> Program {
        match self {
            Self::Programs => Program { of_file: true, ..Program::of(programs) },
            Self::Home => Program::of(home),
            Self::Teach => Program::of(teach::teach),
            Self::Replay => Program::of(teach::replay),
        }
    }
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
