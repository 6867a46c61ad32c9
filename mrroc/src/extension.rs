//! What a program adds to the `mrroc` command.

use anyhow::bail;

use crate::devices::{self, OwnDevice};
use crate::robots::{OwnRobot, register};
use crate::tasks::{CarriedTask, Cell, Outcome, Program};

/// Tasks of a program, which the whole `mrroc` command then has beside its own.
#[derive(Clone, Default)]
pub struct Extension {
    tasks: Vec<(&'static str, Program)>,
}

impl Extension {
    /// Nothing beside the command itself.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a task that `run` and `check` find by this name.
    ///
    /// # Panics
    ///
    /// If another task has the name: the program could not choose between both.
    #[must_use]
    pub fn task(
        mut self,
        name: &'static str,
        task: impl AsyncFn(&mut Cell) -> Outcome + Send + Sync + 'static,
    ) -> Self {
        assert!(!self.tasks().contains(&name), "two tasks are called {name:?}");
        self.tasks.push((name, Program::of(task)));
        self
    }

    /// Makes a robot known to every command: see [`OwnRobot`].
    ///
    /// # Panics
    ///
    /// If another robot has the name.
    #[must_use]
    pub fn robot<T: OwnRobot>(self) -> Self {
        register::<T>();
        self
    }

    /// Makes a kind of device known to every command: see [`OwnDevice`].
    ///
    /// # Panics
    ///
    /// If another kind has the name, or, with the feature `schema`, if the kind has a key that every device has.
    #[must_use]
    pub fn device<T: OwnDevice>(self) -> Self {
        devices::register::<T>();
        self
    }

    /// The names of all tasks: the built-in ones, then those of the program.
    pub fn tasks(&self) -> Vec<&'static str> {
        CarriedTask::ALL.into_iter().map(CarriedTask::name).chain(self.tasks.iter().map(|(name, _)| *name)).collect()
    }

    /// The task of the program with this name.
    pub(crate) fn find(&self, name: &str) -> anyhow::Result<Program> {
        match self.tasks.iter().find(|(known, _)| *known == name) {
            Some((_, program)) => Ok(program.clone()),
            None => bail!("no task is called {name:?}; there are {}", self.tasks().join(", ")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    async fn nothing(_: &mut Cell) -> Outcome {
        Ok(())
    }

    #[test]
    fn own_tasks_are_found_beside_the_built_in_ones() {
        let extension = Extension::new().task("wave", nothing);
        assert_eq!(extension.tasks(), ["programs", "home", "teach", "replay", "wave"]);
        assert!(extension.find("wave").is_ok());
        let refused = extension.find("wove").err().unwrap().to_string();
        assert_eq!(refused, "no task is called \"wove\"; there are programs, home, teach, replay, wave");
    }

    #[test]
    #[should_panic(expected = "two tasks are called \"home\"")]
    fn a_built_in_task_is_not_replaced() {
        let _ = Extension::new().task("home", nothing);
    }
}
