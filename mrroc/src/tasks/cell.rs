//! The cell and its robots, as a task sees them.

use std::sync::Arc;
use std::time::Duration;

use controller::coordination::{Late, LinkConfig};
use controller::ecp::Task;
use controller::executor::{Agent, Agents, LooseLink, Observer, Replacer};
use controller::generator::{EffectorImage, Generator, Message, Pose, SensorReading};
use controller::sensor::{ForceTorque, Shell, VirtualSensor};
use drive::camera::CameraLink;
use drive::cia401::{IoLink, LatestInputs};
use drive::ultrasonic::UltrasonicLink;
use serde::de::DeserializeOwned;
use servo::SpeedOverride;

use super::{Camera, Desk, Figures, ForceSensor, InputLine, Outcome, OutputLine, TaskError, Team, Ultrasonic};
use crate::cell::CellFile;
use crate::motions::Motions;

/// The cell of a task.
pub struct Cell {
    file: Arc<CellFile>,
    pub(super) agents: Agents,
    io: Vec<IoLink>,
    sensors: Vec<ForceTorque>,
    matrices: Vec<UltrasonicLink>,
    cameras: Vec<CameraLink>,
    speed: SpeedOverride,
    figures: Figures,
    pub(super) desk: Desk,
}

/// Handle of one robot of a cell. A robot has one handle at a time.
///
/// An instruction returns an error only after its robot stands or is faulted. If the future of an instruction is dropped,
/// the robot brakes, and the next instruction begins after standstill.
pub struct Robot {
    pub(super) file: Arc<CellFile>,
    pub(super) agent: Agent,
    pub(super) desk: Desk,
}

impl Cell {
    pub(super) fn new(
        file: &Arc<CellFile>,
        agents: Agents,
        (io, sensors, matrices, cameras): (Vec<IoLink>, Vec<ForceTorque>, Vec<UltrasonicLink>, Vec<CameraLink>),
        speed: SpeedOverride,
        figures: Figures,
        desk: Desk,
    ) -> Self {
        Self { file: Arc::clone(file), agents, io, sensors, matrices, cameras, speed, figures, desk }
    }

    /// The cell file.
    pub fn file(&self) -> &CellFile {
        &self.file
    }

    /// The parameters of the task: the table `task` of the cell file, empty where absent. Refuses a table that does not
    /// describe a `T`, with file, line and key.
    pub fn parameters<T: DeserializeOwned>(&self) -> Result<T, TaskError> {
        self.file.parameters().map_err(TaskError::Parameters)
    }

    /// The parameters of a task of the command: see [`CellFile::parameters_of`].
    pub(super) fn parameters_of<T: DeserializeOwned>(&self, names: &[&str]) -> Result<T, TaskError> {
        self.file.parameters_of(names).map_err(TaskError::Parameters)
    }

    /// The robot called `name`. Refuses an unknown name and a robot that is in use.
    pub fn robot(&self, name: &str) -> Result<Robot, TaskError> {
        let robots = &self.file.cell.robot;
        let Some(robot) = robots.iter().position(|robot| robot.name == name) else {
            let known: Vec<_> = robots.iter().map(|robot| robot.name.as_str()).collect();
            return Err(TaskError::UnknownRobot { name: name.to_owned(), known: known.join(", ") });
        };
        self.robot_at(robot)
    }

    /// The robots with these names, in their order. Refuses an unknown name and a robot that is in use.
    pub fn robots<const COUNT: usize>(&self, names: [&str; COUNT]) -> Result<[Robot; COUNT], TaskError> {
        let robots: Vec<_> = names.iter().map(|name| self.robot(name)).collect::<Result<_, _>>()?;
        let Ok(robots) = robots.try_into() else { unreachable!("each name has one robot") };
        Ok(robots)
    }

    /// All robots, in the order of the cell file. Refuses a robot that is in use.
    pub fn all_robots(&self) -> Result<Vec<Robot>, TaskError> {
        (0..self.file.cell.robot.len()).map(|robot| self.robot_at(robot)).collect()
    }

    /// The digital input called `line`.
    pub fn input(&self, line: &str) -> Result<InputLine, TaskError> {
        let place = self.file.cell.input_line(line).ok_or_else(|| TaskError::UnknownInput { name: line.to_owned() })?;
        Ok(InputLine::new(self.io[place.node].clone(), place.line))
    }

    /// The digital output called `line`.
    pub fn output(&self, line: &str) -> Result<OutputLine, TaskError> {
        let place =
            self.file.cell.output_line(line).ok_or_else(|| TaskError::UnknownOutput { name: line.to_owned() })?;
        Ok(OutputLine::new(self.io[place.node].clone(), place.line))
    }

    /// The force/torque sensor called `name`.
    pub fn force_sensor(&self, name: &str) -> Result<ForceSensor, TaskError> {
        let mut given = self.file.cell.force_sensor.iter().zip(&self.sensors);
        let Some((given, sensor)) = given.find(|(given, _)| given.name == name) else {
            return Err(TaskError::UnknownForceSensor { name: name.to_owned() });
        };
        let period = given.sample_period(self.file.cell.period());
        Ok(ForceSensor::new(&given.name, sensor.clone(), self.agents.clone(), period, given.zero_samples))
    }

    /// The ultrasonic matrix called `name`.
    pub fn ultrasonic(&self, name: &str) -> Result<Ultrasonic, TaskError> {
        let mut given = self.file.cell.ultrasonic.iter().zip(&self.matrices);
        let Some((given, link)) = given.find(|(given, _)| given.name == name) else {
            return Err(TaskError::UnknownUltrasonic { name: name.to_owned() });
        };
        Ok(Ultrasonic::new(given, link.clone(), self.agents.clone(), self.file.cell.period()))
    }

    /// The camera called `name`.
    pub fn camera(&self, name: &str) -> Result<Camera, TaskError> {
        let mut given = self.file.cell.camera.iter().zip(&self.cameras);
        let Some((given, link)) = given.find(|(given, _)| given.name == name) else {
            return Err(TaskError::UnknownCamera { name: name.to_owned() });
        };
        Ok(Camera::new(given, link.clone(), self.agents.clone(), self.file.cell.period()))
    }

    /// Reports a number of this run, such as the accuracy of a motion. The report and `--json` show the number under
    /// `figures`. A rehearsal reports no figures. A second figure of the same name replaces the first.
    pub fn figure(&self, name: &str, value: f64) {
        self.figures.set(name, value);
    }

    /// Speed of all programmed motions of the cell: override, pause and resume. The override of the operator
    /// (`--speed`, [`Requests::speed`](crate::run::Requests::speed)) acts in addition.
    pub fn speed(&self) -> &SpeedOverride {
        &self.speed
    }

    /// Waits for a duration, measured by the times of the servo cycles.
    pub async fn sleep(&self, duration: Duration) {
        self.agents.sleep(duration).await;
    }

    /// Whether this is a rehearsal. A task leaves out its side effects in a rehearsal: files, messages, devices.
    pub fn rehearsing(&self) -> bool {
        self.desk.rehearsing
    }

    /// Whether the tool can touch something, and objects can be before the sensors: in a run, and in a rehearsal with the
    /// scene (`--rehearse-with-scene`). Any other rehearsal has no surroundings.
    pub fn has_surroundings(&self) -> bool {
        self.desk.surroundings
    }

    /// Ends a rehearsal here with success: the rest of the task is not rehearsed. In a run the call has no effect. The
    /// call is for tasks with a partner that a rehearsal does not provide, such as an operator. `why` appears in the
    /// error that ends the rehearsal.
    pub fn end_rehearsal(&self, why: &'static str) -> Outcome {
        if self.desk.rehearsing { Err(TaskError::NotRehearsed { why }) } else { Ok(()) }
    }

    /// A team of these robots. A coordinator gives each robot an order in every macrostep, and the servo begins each
    /// macrostep of all robots in the same cycle. Any stop of one robot stops all robots of the team.
    ///
    /// If a member waits longer than a servo period for an order, the motion fails. [`Team::linked`] sets another deadline
    /// or reaction.
    pub fn team<'a, const N: usize>(&self, members: [&'a mut Robot; N]) -> Team<'a, N> {
        let deadline = self.file.cell.period();
        Team::new(&self.file, members, LinkConfig { blocking: true, deadline, late: Late::Stop })
    }

    /// The inputs of I/O node `node`, in the order of the cell file.
    pub(super) fn link(&self, node: usize) -> LatestInputs {
        self.io[node].inputs.clone()
    }

    fn robot_at(&self, robot: usize) -> Result<Robot, TaskError> {
        let in_use = || TaskError::RobotInUse { name: self.file.cell.robot[robot].name.clone() };
        let agent = self.agents.agent(robot).ok_or_else(in_use)?;
        Ok(Robot { file: Arc::clone(&self.file), agent, desk: self.desk.clone() })
    }
}

impl Robot {
    /// Name of the robot in the cell file.
    pub fn name(&self) -> &str {
        &self.file.cell.robot[self.agent.robot()].name
    }

    /// Generators of motions within the limits of the robot.
    pub fn motions(&self) -> Motions {
        Motions::of(&self.file, self.agent.robot())
    }

    /// Pose of the robot's base in the frame of the cell, as the cell file gives it.
    pub fn cell_from_base(&self) -> Pose {
        self.file.cell.robot[self.agent.robot()].cell_from_base()
    }

    /// State of the robot in the last servo cycle, in every phase, also with the drives off. Joints and pose are
    /// meaningful after homing.
    #[doc(alias = "get_position")]
    pub fn image(&self) -> Result<EffectorImage, TaskError> {
        Ok(self.agent.image()?)
    }

    /// A handle that reads the state of this robot while the robot is in use, for example in a team.
    pub fn observer(&self) -> Observer {
        self.agent.observer()
    }

    /// Switches the drives on. The robot then holds its position.
    pub async fn enable(&mut self) -> Outcome {
        self.perform(Task::new().enable()).await
    }

    /// Homes the axes, unless all axes are homed. A motor that then stands beyond a position limit, because the arm fell
    /// or was moved while it was off, moves back to within the limit at a twentieth of its greatest speed.
    pub async fn home(&mut self) -> Outcome {
        self.perform(Task::new().home()).await?;
        self.return_within_limits().await
    }

    /// Executes the motion of a generator until its terminal condition holds and the robot stands.
    #[doc(alias = "Move")]
    pub async fn execute(&mut self, generator: impl Generator) -> Outcome {
        self.perform(Task::new().run(generator)).await
    }

    /// Gives the robot a virtual sensor, whose readings are the image [`V`](controller::generator::V) of its generators.
    /// A reading is taken every `period` macrosteps. Refuses a second sensor with readings or commands of the same type:
    /// mark one of the sensors ([`VirtualSensor::marked`]), or remove the first sensor.
    pub fn sense<S: VirtualSensor>(&mut self, sensor: S, shell: Shell, period: u16) -> Outcome {
        Ok(self.agent.sense(sensor, shell, period)?)
    }

    /// Removes the virtual sensor with readings of type `R`. Returns whether there was one.
    pub fn remove_sensor<R: SensorReading>(&mut self) -> bool {
        self.agent.remove_sensor::<R>()
    }

    /// Connects the robot to this task by a link (loose coordination). Orders of the task are the image
    /// [`A`](controller::generator::A) of the robot's generators. Steps take the latest order and do not wait. In a
    /// motion of a team, orders wait until the next motion, and an end is refused. The new link replaces an earlier
    /// link.
    pub fn coordinated<C: Message, R: Message>(&mut self) -> LooseLink<C, R> {
        self.agent.coordinated()
    }

    /// Whether the force law of the robot ended its last motion at a touch ([`Guard`](controller::law::Guard)). Such a
    /// motion ends with success, like a motion to the end of its path.
    pub fn has_touched(&self) -> bool {
        self.agent.has_touched()
    }

    /// A handle that replaces a motion of this robot while the motion is awaited. If the new generator begins in motion,
    /// such as [`JerkLimited`](controller::generator::JerkLimited), the robot continues without a stop.
    pub fn replacer(&self) -> Replacer {
        self.agent.replacer()
    }

    /// Executes a list of instructions. The list ends at its first error.
    pub async fn perform(&mut self, task: Task) -> Outcome {
        let performed = self.agent.perform(task).await;
        performed.map_err(|error| TaskError::Instruction { robot: self.name().into(), error })
    }

    /// Switches the drives off. A moving robot brakes first.
    pub async fn disable(&mut self) -> Outcome {
        self.perform(Task::new().disable()).await
    }

    /// Clears a latched fault. The drives stay off.
    pub async fn reset_fault(&mut self) -> Outcome {
        self.perform(Task::new().reset_fault()).await
    }
}
