//! The task of a run under way: its instructions, its errors, and its rehearsals from the present position of a robot.

use std::io;
use std::mem::{replace, take};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Receiver, SyncSender};

use can::Instant;
use controller::ecp::{EcpError, Subcontrollers};
use controller::executor::{Ended, Executor, InstructionError, SystemError, Turns};
use controller::generator::Axes;
use drive::Fault;
use drive::cia401::IoLink;
use servo::{EffectorLink, Phase, Servo, ServoFault, SpeedOverride, StopCause, StopRequest};

use super::worker::Worker;
use crate::cell::CellFile;
use crate::report::{ErrorPlace, FaultReport};
use crate::tasks::{Equipment, Figures, Program, TaskError};
use crate::{rehearsal, setup};

/// A task that is to run.
pub(crate) struct RunningTask {
    file: Arc<CellFile>,
    program: Program,
    subcontrollers: Subcontrollers,
    /// One link per I/O node, in the order of [`Cell::io`](crate::cell::Cell::io).
    io: Vec<IoLink>,
    /// Figures that the task reports.
    figures: Figures,
    /// Number of instructions in the rehearsal.
    instructions: u64,
    stop: StopRequest,
    speed: SpeedOverride,
    /// Count of the task's turns.
    pub(super) turns: Turns,
}

/// Errors of a task.
#[derive(Default)]
pub(super) struct TaskErrors {
    /// Errors that ended the task.
    pub(super) faults: Vec<FaultReport>,
    /// Errors that the task received and handled.
    pub(super) recovered: Vec<FaultReport>,
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
    /// Number of instructions of all robots in the rehearsal.
    pub expected: u64,
}

/// A robot, and the motor positions, rad, from which to rehearse the task.
pub(super) type Start = (usize, Axes);

/// A robot, and why the task is refused from its position.
pub(super) type Verdict = (usize, anyhow::Result<()>);

/// Where rehearsals from the present position of a robot take place.
pub(super) enum Rehearsals {
    /// Within the poll, in virtual time.
    AtOnce,
    /// On another thread. The robot waits.
    Aside { ask: SyncSender<Start>, verdicts: Receiver<Verdict> },
}

impl RunningTask {
    /// The task on the `links` to `servo` and on the I/O nodes of the cell. The rehearsal had so many `instructions`.
    pub(crate) fn new(
        file: &Arc<CellFile>,
        program: &Program,
        links: Vec<EffectorLink>,
        io: Vec<IoLink>,
        servo: &Servo,
        instructions: u64,
    ) -> Self {
        Self {
            file: Arc::clone(file),
            program: program.clone(),
            subcontrollers: setup::subcontrollers(file, links),
            io,
            figures: Figures::default(),
            instructions,
            stop: servo.stop_request(),
            speed: servo.speed_override(),
            turns: Turns::default(),
        }
    }

    /// Starts one planning thread per robot, which computes the first steps of that robot's generators.
    pub(super) fn plan_aside(&mut self) -> io::Result<()> {
        let mut workers = Vec::new();
        for _ in &self.file.cell.robot {
            workers.push(Worker::start()?);
        }
        let mut workers = workers.into_iter();
        self.subcontrollers.plan_with(|| Box::new(workers.next().expect("each robot has one")));
        Ok(())
    }

    /// The figures that the task reports.
    pub(super) fn figures(&self) -> Figures {
        self.figures.clone()
    }

    /// What another thread needs to rehearse the task.
    pub(super) fn rehearsed(&self) -> (Arc<CellFile>, Program) {
        (Arc::clone(&self.file), self.program.clone())
    }

    /// Begins the task on the calling thread.
    pub(super) fn begin(self, rehearsals: Rehearsals) -> Carrying {
        let Self { file, program, subcontrollers, io, figures, instructions, stop, speed, turns } = self;
        let equipment = Equipment { subcontrollers, io: io.clone(), speed, figures };
        let robots = file.cell.robot.len();
        Carrying {
            executor: program.begin(&file, equipment, false, turns),
            file,
            program,
            io,
            instructions,
            stop,
            rehearsals,
            verdicts: Vec::new(),
            checked: vec![false; robots],
            phases: vec![Phase::Off; robots],
            refusals: Vec::new(),
        }
    }
}

/// A task under way, on one thread.
pub(super) struct Carrying {
    executor: Executor<TaskError>,
    file: Arc<CellFile>,
    program: Program,
    io: Vec<IoLink>,
    instructions: u64,
    stop: StopRequest,
    rehearsals: Rehearsals,
    /// Verdicts of rehearsals at once.
    verdicts: Vec<Verdict>,
    /// Whether the position of each robot after its first homing was checked.
    checked: Vec<bool>,
    /// Last reported phase of each robot.
    phases: Vec<Phase>,
    /// Refusals from the present positions of robots.
    refusals: Vec<FaultReport>,
}

impl Carrying {
    /// Polls the processes and the task. Returns whether the task is under way or any robot has an instruction. `tell`
    /// receives the progress and must not wait.
    pub(super) fn poll(&mut self, now: Instant, mut tell: impl FnMut(Progress)) -> bool {
        self.judge();
        let Self { executor, file, checked, phases, .. } = self;
        let expected = self.instructions;
        let mut ended = vec![0; phases.len()];
        let mut away = Vec::new();
        let busy = executor.poll(now, |ecp, event| {
            let robot = event.robot;
            ended[robot] += 1;
            if event.homed && !replace(&mut checked[robot], true) {
                // Drives that kept their reference may stand away from home, where no rehearsal began.
                let motors = ecp.latest().commanded;
                if !file.cell.home(robot, &file.arms[robot]).admits(&motors) {
                    ecp.hold(true);
                    away.push((robot, motors));
                }
            }
        });
        for (robot, (status, phase)) in executor.statuses().into_iter().zip(phases).enumerate() {
            if ended[robot] > 0 || status.phase != *phase {
                *phase = status.phase;
                tell(Progress { robot, phase: status.phase, ended: ended[robot], expected });
            }
        }
        for start in away {
            self.ask(start);
        }
        busy
    }

    /// Ends the task, and returns its errors and the faults of the I/O nodes. The drive groups still exist.
    pub(super) fn finish(self) -> TaskErrors {
        let (ended, mut delivered) = self.executor.finish();
        let (file, mut faults) = (&*self.file, self.refusals);
        let error = match ended {
            Some(Ended::Task(Err(error))) => Some(error),
            // The refusal was noted when it was found.
            Some(Ended::System(SystemError::RefusedFromHere { .. })) => None,
            Some(Ended::System(error)) => Some(TaskError::System(error)),
            Some(Ended::Task(Ok(()))) | None => None,
        };
        if let Some(error) = error {
            let of_instruction = error.instruction();
            delivered.retain(|delivered| Some(delivered) != of_instruction);
            faults.push(of_instruction.map_or_else(|| FaultReport::of_run(&error), |error| describe(file, error)));
        }
        faults.extend(io_faults(file, &self.io));
        TaskErrors { faults, recovered: delivered.iter().map(|error| describe(file, error)).collect() }
    }

    /// Requests a rehearsal from the present position of a robot, which is held.
    fn ask(&mut self, start: Start) {
        let (robot, motors) = start;
        match &self.rehearsals {
            Rehearsals::AtOnce => {
                let (file, program) = (&self.file, &self.program);
                let never = AtomicBool::new(false);
                self.verdicts.push((robot, rehearsal::rehearse_from(file, program, robot, motors, &never)));
            }
            // The queue has a place for each robot, and each robot is checked once.
            Rehearsals::Aside { ask, .. } => _ = ask.try_send(start),
        }
    }

    /// Releases the robots from whose positions the task is possible. The first refusal ends the task.
    fn judge(&mut self) {
        let mut verdicts = take(&mut self.verdicts);
        if let Rehearsals::Aside { verdicts: aside, .. } = &self.rehearsals {
            verdicts.extend(aside.try_iter());
        }
        for (robot, verdict) in verdicts {
            match verdict {
                Ok(()) => self.executor.hold(robot, false),
                Err(error) => {
                    let what = format!("was referenced and stands away from its home position, from where {error:#}");
                    self.refusals.push(FaultReport::of_robot(&self.file, robot, None, what));
                    self.stop.request();
                    self.executor.abort(SystemError::RefusedFromHere { robot });
                }
            }
        }
    }
}

/// The error of an instruction, with the names of the cell.
fn describe(file: &CellFile, error: &InstructionError) -> FaultReport {
    let robot = error.robot;
    let fault = match error.cause {
        EcpError::Servo(fault) => describe_fault(file, robot, &fault),
        cause => FaultReport::of_robot(file, robot, None, file.cell.robot[robot].naming_axes(cause)),
    };
    FaultReport { place: Some(ErrorPlace::of(error)), ..fault }
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

/// The latched faults of the I/O nodes of a cell. The axes do not stop by such a fault.
fn io_faults(file: &CellFile, links: &[IoLink]) -> impl Iterator<Item = FaultReport> {
    let nodes = file.cell.io.iter().zip(links);
    let faults = nodes.filter_map(|(io, link)| Some((io, link.inputs.read().fault?)));
    faults.map(|(io, fault)| FaultReport::of_run(format!("I/O node {}: {fault}", io.name)))
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
            place: None,
            what: "still has power, or did not say otherwise".into(),
        });
    }
    faults
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::sync_channel;

    use anyhow::anyhow;
    use drive::DriveGroup;
    use servo::lockstep;

    use super::*;
    use crate::prelude::*;
    use crate::rehearsal::IdealDrives;
    use crate::tasks::tests::two_arms;

    /// Both robots home and move.
    async fn both(cell: &mut Cell) -> Outcome {
        let [mut left, mut right] = cell.robots(["left", "right"])?;
        let list = |robot: &Robot| {
            let motion = robot.motions().joints(0.3, &[[0.2, -1.571, 0.0, 0.0, 0.0]])?;
            Ok::<_, TaskError>(Task::new().enable().home().run(motion).disable())
        };
        let (one, other) = (list(&left)?, list(&right)?);
        join(left.perform(one), right.perform(other)).await
    }

    /// Runs the task with the left robot referenced away from home. The rehearsal from there gives `verdict` as soon as
    /// the right robot is off. Returns the errors, and whether the left robot moved before the verdict and in total.
    fn run(verdict: anyhow::Result<()>) -> (TaskErrors, [bool; 2]) {
        let file = Arc::new(two_arms());
        let homes = (0..2).map(|robot| file.cell.home(robot, &file.arms[robot]).motors);
        let mut starts: Vec<_> = homes.collect();
        starts[0][0] += 10.0;
        let drives = |bus| Box::new(IdealDrives::of(&file, bus, &starts)) as Box<dyn DriveGroup>;
        let (mut servo, links) = Servo::new(&setup::servo_config(&file), vec![drives(0), drives(1)]).unwrap();
        let task = RunningTask::new(&file, &Program::of(both), links, Vec::new(), &servo, 8);
        let (ask, asked) = sync_channel(2);
        let (answer, verdicts) = sync_channel(2);
        let mut carrying = task.begin(Rehearsals::Aside { ask, verdicts });
        let mut now = lockstep::bring_up(&mut servo, Instant::ZERO, |_| {}).unwrap();
        let mut verdict = Some(verdict);
        let (mut phases, mut moved) = ([Phase::Off; 2], [false; 2]);
        let mut other_moved = false;
        for _ in 0..10_000 {
            servo.step(now);
            let busy = carrying.poll(now, |news| phases[news.robot] = news.phase);
            moved[1] |= phases[0] == Phase::Moving;
            other_moved |= phases[1] == Phase::Moving;
            if !busy {
                return (carrying.finish(), moved);
            }
            if other_moved
                && phases[1] == Phase::Off
                && let Some(verdict) = verdict.take()
            {
                moved[0] = moved[1];
                let (robot, motors) = asked.try_recv().unwrap();
                assert_eq!((robot, motors), (0, starts[0]));
                answer.send((robot, verdict)).unwrap();
            }
            now += servo.period();
        }
        panic!("the task does not end: {phases:?}");
    }

    #[test]
    fn a_fault_of_an_io_node_is_a_fault_of_the_run() {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/irb6-touch.toml");
        let file = CellFile::read(&path).unwrap();
        let port = Box::new(can::virtual_port(16).0) as Box<dyn can::Port>;
        let devices = setup::devices(&file, vec![port], Vec::new(), None).unwrap();
        let faults: Vec<_> = io_faults(&file, &devices.io).map(|fault| fault.what).collect();
        assert_eq!(faults, ["I/O node tool: node 40: I/O not started"]);
        let (_, rehearsed) = setup::rehearsed_io(&file);
        assert_eq!(io_faults(&file, &rehearsed).count(), 0);
    }

    #[test]
    fn a_robot_away_from_home_waits_for_its_rehearsal_and_delays_no_other() {
        let (errors, moved) = run(Ok(()));
        assert_eq!((errors.faults, moved), (Vec::new(), [false, true]));
        let (errors, moved) = run(Err(anyhow!("a line is impossible")));
        assert_eq!((errors.faults.len(), moved), (1, [false, false]));
        assert!(errors.faults[0].what.ends_with("from where a line is impossible"), "{:?}", errors.faults);
    }
}
