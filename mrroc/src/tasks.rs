//! The tasks of the robots of a cell.

use anyhow::bail;
use controller::ecp::Task;

use crate::cell::CellFile;

/// A function that makes the tasks of a cell. A run calls the function for each rehearsal and once for the run itself.
pub type MakeTasks<'a> = dyn Fn(&CellFile) -> anyhow::Result<Tasks> + Sync + 'a;

/// One task per robot of a cell. A robot without a task stays switched off.
pub struct Tasks {
    names: Vec<String>,
    pub(crate) tasks: Vec<Option<Task>>,
    /// Whether these are the programs of the cell file.
    pub(crate) programs: bool,
}

impl Tasks {
    /// No task for any robot of `file`.
    pub fn new(file: &CellFile) -> Self {
        let names: Vec<_> = (file.cell.robot.iter()).map(|robot| robot.name.clone()).collect();
        Self { tasks: names.iter().map(|_| None).collect(), names, programs: false }
    }

    /// The programs of the cell file: switch on, home, move, switch off.
    ///
    /// Errors give the file, the line and the key of an instruction that the robot cannot execute.
    pub fn programs(file: &CellFile) -> anyhow::Result<Self> {
        let mut tasks = Self::new(file);
        tasks.programs = true;
        for (robot, place) in tasks.tasks.iter_mut().enumerate() {
            let task = file.cell.task(robot, &file.arms[robot]).map_err(|(key, error)| {
                let axis = error.axis().map_or(String::new(), |axis| file.axis_name(robot, axis) + ", ");
                file.refuse(&key, format_args!("{axis}{error}"))
            })?;
            *place = Some(task);
        }
        Ok(tasks)
    }

    /// Gives the robot called `name` its task. Refuses an unknown name and a second task for one robot.
    pub fn give(mut self, name: &str, task: Task) -> anyhow::Result<Self> {
        let Some(robot) = self.names.iter().position(|known| known == name) else {
            bail!("the cell has no robot {name:?}, only {}", self.names.join(", "));
        };
        if self.tasks[robot].replace(task).is_some() {
            bail!("robot {name:?} has two tasks");
        }
        Ok(self)
    }

    /// Number of instructions of all robots.
    pub fn instructions(&self) -> usize {
        self.tasks.iter().flatten().map(Task::len).sum()
    }
}
