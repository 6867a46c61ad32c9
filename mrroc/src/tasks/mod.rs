//! Tasks of a cell: `async` functions that use its robots.

mod camera;
mod carried;
mod cell;
mod draft;
mod error;
mod figures;
mod force;
mod gates;
mod lines;
mod operator;
mod retreat;
mod teach;
mod team;
#[cfg(test)]
pub(crate) mod tests;
mod ultrasonic;

use std::pin::Pin;
use std::sync::Arc;

use controller::ecp::Subcontrollers;
use controller::executor::{Agents, Executor, Turns};
use controller::sensor::{ForceTorque, OperatorLink};
use drive::camera::CameraLink;
use drive::cia401::IoLink;
use drive::ultrasonic::UltrasonicLink;
use servo::SpeedOverride;

use crate::cell::CellFile;

pub use camera::Camera;
pub use carried::CarriedTask;
#[cfg(feature = "command-line")]
pub use carried::{TaskOptions, convention};
pub use cell::{Cell, Robot};
pub use error::{Outcome, TaskError};
pub use figures::Figures;
pub use force::ForceSensor;
pub use gates::{GateDirection, GatePlace, GateTrack};
pub use lines::{InputLine, OutputLine};
use operator::Desk;
pub use team::Team;
pub use ultrasonic::Ultrasonic;

/// A task in a form that can be boxed.
trait Carry: Send + Sync {
    fn carry<'a>(&'a self, cell: &'a mut Cell) -> Pin<Box<dyn Future<Output = Outcome> + 'a>>;
}

impl<T: AsyncFn(&mut Cell) -> Outcome + Send + Sync> Carry for T {
    fn carry<'a>(&'a self, cell: &'a mut Cell) -> Pin<Box<dyn Future<Output = Outcome> + 'a>> {
        Box::pin(async move { self(cell).await })
    }
}

/// The devices of a cell that a task works on.
pub struct Equipment {
    /// The subcontrollers of the robots: see [`setup::subcontrollers`](crate::setup::subcontrollers).
    pub subcontrollers: Subcontrollers,
    /// One link per I/O node, in the order of [`Cell::io`](crate::cell::Cell::io).
    pub io: Vec<IoLink>,
    /// One virtual sensor per force sensor, in the order of [`Cell::force_sensor`](crate::cell::Cell::force_sensor).
    pub sensors: Vec<ForceTorque>,
    /// One link per ultrasonic matrix, in the order of [`Cell::ultrasonic`](crate::cell::Cell::ultrasonic).
    pub matrices: Vec<UltrasonicLink>,
    /// One link per camera, in the order of [`Cell::camera`](crate::cell::Cell::camera).
    pub cameras: Vec<CameraLink>,
    /// The speed override of the servo.
    pub speed: SpeedOverride,
    /// The figures that the task reports.
    pub figures: Figures,
}

/// A task to rehearse and to run. Every rehearsal and the run begin the task from its start.
#[derive(Clone)]
pub struct Program {
    task: Arc<dyn Carry>,
    /// Whether the instructions are those of the cell file.
    pub(crate) of_file: bool,
    operator: Option<OperatorLink>,
    /// Where messages go without an operator.
    texts: Option<OperatorLink>,
    /// Whether the run of the task is a rehearsal on the emulated cell with its scene.
    pub(crate) with_scene: bool,
}

impl Program {
    /// A task in Rust.
    pub fn of(task: impl AsyncFn(&mut Cell) -> Outcome + Send + Sync + 'static) -> Self {
        Self { task: Arc::new(task), of_file: false, operator: None, texts: None, with_scene: false }
    }

    /// The same task with an operator, who answers its questions.
    #[must_use]
    pub fn with_operator(self, operator: OperatorLink) -> Self {
        Self { operator: Some(operator), ..self }
    }

    /// The same task with a place for its messages ([`Cell::tell`]), and without answers to its questions.
    #[must_use]
    pub fn with_texts(self, texts: OperatorLink) -> Self {
        Self { texts: Some(texts), ..self }
    }

    /// The same task, whose run is a rehearsal.
    pub(crate) fn rehearsed_with_scene(self) -> Self {
        Self { with_scene: true, ..self }
    }

    /// The task on the robots of `file`, for a caller with a servo and a clock of its own. [`run`](crate::run::run) is the
    /// usual caller. `turns` counts the turns of the task, by which another thread detects a task that hangs.
    pub fn begin(
        &self,
        file: &Arc<CellFile>,
        equipment: Equipment,
        rehearsing: bool,
        turns: Turns,
    ) -> Executor<TaskError> {
        let Equipment { subcontrollers, io, sensors, matrices, cameras, speed, figures } = equipment;
        let agents = Agents::new(subcontrollers);
        let desk = Desk {
            link: self.operator.clone(),
            texts: self.texts.clone(),
            rehearsing: rehearsing || self.with_scene,
            surroundings: !rehearsing,
        };
        let devices = (io, sensors, matrices, cameras);
        let (task, mut cell) = (Arc::clone(&self.task), Cell::new(file, agents.clone(), devices, speed, figures, desk));
        Executor::new(agents, async move { task.carry(&mut cell).await }, turns)
    }
}
