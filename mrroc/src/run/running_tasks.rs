//! The subcontrollers of a run under way: their reports, and the failures that stop them.

use std::io;

use can::Instant;
use controller::ecp::{Ecp, EcpError, Subcontrollers, Task};
use drive::Fault;
use servo::{EffectorLink, Phase, Servo, ServoFault, StopCause, StopRequest};

use super::worker::Worker;
use crate::{cell::CellFile, rehearsal, report::FaultReport, setup, tasks::MakeTasks};

/// All tasks of a run. The first failure stops every robot.
pub(crate) struct RunningTasks<'a> {
    file: &'a CellFile,
    tasks: &'a MakeTasks<'a>,
    subcontrollers: Subcontrollers,
    /// Index of the first homing instruction of each task.
    homings: Vec<Option<usize>>,
    /// Last reported phase of each robot.
    phases: Vec<Phase>,
    /// Number of instructions of each robot that ended in this poll.
    ended: Vec<u64>,
    pub(crate) faults: Vec<FaultReport>,
    stop: StopRequest,
}

/// Progress of one robot.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Index of the robot in its cell.
    pub robot: usize,
    /// Phase of its effector.
    pub phase: Phase,
    /// Number of instructions that ended since the last report.
    pub ended: u64,
}

impl<'a> RunningTasks<'a> {
    /// The tasks of a cell's robots, on the `links` to `servo`.
    pub(crate) fn new(
        file: &'a CellFile,
        tasks: &'a MakeTasks<'a>,
        links: Vec<EffectorLink>,
        servo: &Servo,
    ) -> anyhow::Result<Self> {
        let given = tasks(file)?;
        let homing = |task: &Option<_>| Option::as_ref(task).and_then(Task::first_homing);
        let robots = file.cell.robot.len();
        Ok(Self {
            file,
            tasks,
            homings: given.tasks.iter().map(homing).collect(),
            subcontrollers: setup::subcontrollers(file, links, servo.gates(), given),
            phases: vec![Phase::Off; robots],
            ended: vec![0; robots],
            faults: Vec::new(),
            stop: servo.stop_request(),
        })
    }

    /// Starts one planning thread per robot, which computes the first steps of that robot's generators.
    pub(crate) fn plan_aside(&mut self) -> io::Result<()> {
        let mut workers = Vec::new();
        for _ in &self.file.cell.robot {
            workers.push(Worker::start()?);
        }
        let mut workers = workers.into_iter();
        self.subcontrollers.plan_with(|| Box::new(workers.next().expect("each robot has one")));
        Ok(())
    }

    /// Polls every process, and returns whether any has an instruction. `tell` receives the progress and must not
    /// wait.
    pub(crate) fn poll(&mut self, now: Instant, mut tell: impl FnMut(Progress)) -> bool {
        self.ended.fill(0);
        let (file, tasks) = (self.file, self.tasks);
        let busy = self.subcontrollers.poll(now, |robot, ecp, event| {
            self.ended[robot] += 1;
            let fault = match event.outcome {
                // The cause of the stop has been reported.
                Err(EcpError::Stopped) => None,
                Err(EcpError::Servo(fault)) => Some(describe_fault(file, robot, &fault)),
                Err(error) => Some(FaultReport::of_robot(file, robot, None, file.cell.robot[robot].naming_axes(error))),
                Ok(()) if self.homings[robot] == Some(event.instruction) => refused_from_here(file, tasks, robot, ecp),
                Ok(()) => None,
            };
            if let Some(fault) = fault {
                self.stop.request();
                self.faults.push(fault);
                ecp.stop();
            }
        });
        let news = self.subcontrollers.statuses().zip(&mut self.phases);
        for (robot, ((status, phase), &ended)) in news.zip(&self.ended).enumerate() {
            if ended > 0 || status.phase != *phase {
                *phase = status.phase;
                tell(Progress { robot, phase: status.phase, ended });
            }
        }
        busy
    }
}

/// Checks whether a robot may continue after its homing instruction from its present position. Drives that kept their
/// reference may stand away from home, where no rehearsal began. The program is then rehearsed from this position, and
/// a refusal is returned as a fault.
fn refused_from_here(file: &CellFile, tasks: &MakeTasks, robot: usize, ecp: &Ecp) -> Option<FaultReport> {
    let motors = ecp.latest().commanded;
    if file.cell.home(robot, &file.arms[robot]).admits(&motors) {
        return None;
    }
    let error = rehearsal::rehearse_from(file, tasks, robot, motors).err()?;
    let what = format!("was referenced and stands away from its home position, from where {error:#}");
    Some(FaultReport::of_robot(file, robot, None, what))
}

/// A fault of the servo, with the names of the cell.
fn describe_fault(file: &CellFile, robot: usize, fault: &ServoFault) -> FaultReport {
    let axis = fault.axis.map(usize::from);
    // Some faults concern the bus and all axes on it.
    let of_bus = match fault.cause {
        StopCause::Drive(Fault::Port(error)) => Some(error.to_string()),
        StopCause::Drive(Fault::OtherController { sign }) => {
            Some(format!("another controller is at work: it sent {sign}"))
        }
        _ => None,
    };
    if let Some((what, axis)) = of_bus.zip(axis) {
        let bus = &file.cell.robot[robot].axis[axis].bus;
        return FaultReport::of_robot(file, robot, None, format!("bus {bus}: {what}"));
    }
    FaultReport::of_robot(file, robot, axis, fault.cause.to_string())
}

/// The fault that the servo latched for each robot, and a fault if some robots still have power.
pub(crate) fn servo_faults(file: &CellFile, servo: &Servo) -> Vec<FaultReport> {
    let robots = &file.cell.robot;
    let latched = |robot| Some(describe_fault(file, robot, &servo.fault(robot)?));
    let mut faults: Vec<_> = (0..robots.len()).filter_map(latched).collect();
    if !servo.is_off() {
        // The servo reports the power of all robots together.
        let names: Vec<_> = robots.iter().map(|robot| robot.name.as_str()).collect();
        faults.push(FaultReport {
            robot: Some(names.join(" or ")),
            axis: None,
            what: "still has power, or did not say otherwise".into(),
        });
    }
    faults
}
