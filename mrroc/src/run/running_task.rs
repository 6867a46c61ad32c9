//! The task of a run under way: its instructions, its errors, and its rehearsals from the present positions of robots.

use std::io;
use std::mem::take;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError};

use can::Instant;
use controller::ecp::{StepRecords, Subcontrollers};
use controller::executor::{Ended, Executor, News, NotedError, SystemError, Turns};
use controller::generator::{Axes, PlannedStart};
use controller::sensor::ForceTorque;
use drive::camera::CameraLink;
use drive::cia401::IoLink;
use drive::ultrasonic::UltrasonicLink;
use servo::{EffectorLink, Phase, Servo, SpeedOverride, StopRequest};
use thiserror::Error;

use super::descriptions::{describe, force_faults, io_faults, matrix_faults};
use super::worker::Worker;
use crate::cell::CellFile;
use crate::rehearsal::{Course, Rehearsed, homes, rehearse_again};
use crate::report::FaultReport;
use crate::report::slowed::{self, SlowedMotion};
use crate::tasks::{Equipment, Figures, Program, TaskError};
use crate::{setup, streams};

/// A task that is to run.
pub(crate) struct RunningTask {
    file: Arc<CellFile>,
    program: Program,
    subcontrollers: Subcontrollers,
    /// One link per I/O node, in the order of [`Cell::io`](crate::cell::Cell::io).
    io: Vec<IoLink>,
    /// One virtual sensor per force sensor, in the order of [`Cell::force_sensor`](crate::cell::Cell::force_sensor).
    sensors: Vec<ForceTorque>,
    /// One link per ultrasonic matrix.
    matrices: Vec<UltrasonicLink>,
    /// One link per camera.
    cameras: Vec<CameraLink>,
    /// Figures that the task reports.
    figures: Figures,
    /// Number of instructions in the rehearsal.
    instructions: u64,
    /// Whether each robot moved in the rehearsal.
    moved: Vec<bool>,
    stop: StopRequest,
    speed: SpeedOverride,
    /// Count of the task's turns.
    pub(super) turns: Turns,
}

/// Errors of a task.
#[derive(Default)]
pub(super) struct TaskErrors {
    /// Errors that ended the task, and faults of dropped instructions that still stop their robot.
    pub(super) faults: Vec<FaultReport>,
    /// Errors that the task received and handled, and other errors of dropped instructions.
    pub(super) recovered: Vec<FaultReport>,
    /// Whether the task received the fault that still stops each robot.
    pub(super) received: Vec<bool>,
    /// Motions that joints slowed, and the number of further ones.
    pub(super) slowed: (Vec<SlowedMotion>, u64),
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
    /// Whether a generator of one of these instructions commanded the robot.
    pub moved: bool,
    /// Number of instructions of all robots in the rehearsal.
    pub expected: u64,
}

/// A robot that waits, and the courses of all robots with which to rehearse the task.
pub(super) type Question = (usize, Vec<Course>);

/// A robot that waits, and why the task is refused from its position.
pub(super) type Verdict = (usize, anyhow::Result<()>);

/// Where rehearsals from the present position of a robot take place.
pub(super) enum Rehearsals {
    /// Within the poll, in virtual time.
    AtOnce,
    /// On another thread. The robot waits.
    Aside { ask: SyncSender<Question>, verdicts: Receiver<Verdict> },
    /// Nowhere, since the run itself is a rehearsal.
    Unneeded,
}

/// The thread of the rehearsals takes no question or gives no verdict.
#[derive(Clone, Copy, Debug, Error)]
#[error("the task cannot be rehearsed, since the thread of the rehearsals has ended")]
struct NoRehearsals;

impl RunningTask {
    /// A task that was rehearsed, on the `links` to `servo` and on the I/O nodes, force sensors, ultrasonic
    /// matrices and cameras of the cell.
    pub(crate) fn new(
        file: &Arc<CellFile>,
        program: &Program,
        links: Vec<EffectorLink>,
        (io, sensors, matrices, cameras): (Vec<IoLink>, Vec<ForceTorque>, Vec<UltrasonicLink>, Vec<CameraLink>),
        servo: &Servo,
        rehearsed: &Rehearsed,
    ) -> Self {
        Self {
            file: Arc::clone(file),
            program: program.clone(),
            sensors,
            matrices,
            cameras,
            subcontrollers: setup::subcontrollers(file, links),
            io,
            figures: Figures::default(),
            instructions: rehearsed.instructions,
            moved: rehearsed.moved.clone(),
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

    /// Keeps a journal of the steps of each robot, with room for `size` events.
    pub(super) fn keep_steps(&mut self, size: usize) -> Vec<StepRecords> {
        self.subcontrollers.keep_steps(size)
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
        let Self {
            file,
            program,
            subcontrollers,
            io,
            sensors,
            matrices,
            cameras,
            figures,
            instructions,
            moved,
            stop,
            speed,
            turns,
        } = self;
        let equipment = Equipment {
            subcontrollers,
            io: io.clone(),
            sensors: sensors.clone(),
            matrices: matrices.clone(),
            cameras,
            speed,
            figures,
        };
        let rehearsals = if program.with_scene { Rehearsals::Unneeded } else { rehearsals };
        let mut executor = program.begin(&file, equipment, false, turns);
        let robots = homes(&file).into_iter().zip(moved).map(|(home, moved)| RunningRobot::at(home, moved));
        let robots: Vec<_> = robots.collect();
        let noticed = vec![None; io.len() + sensors.len() + matrices.len()];
        (0..robots.len()).for_each(|robot| executor.hold(robot, true));
        Carrying {
            executor,
            file,
            program,
            io,
            sensors,
            matrices,
            instructions,
            stop,
            rehearsals,
            verdicts: Vec::new(),
            robots,
            refusals: Vec::new(),
            began: None,
            noticed,
            slowed: (Vec::with_capacity(slowed::MOST), 0),
        }
    }
}

/// A task under way, on one thread.
pub(super) struct Carrying {
    executor: Executor<TaskError>,
    file: Arc<CellFile>,
    program: Program,
    io: Vec<IoLink>,
    sensors: Vec<ForceTorque>,
    matrices: Vec<UltrasonicLink>,
    instructions: u64,
    stop: StopRequest,
    rehearsals: Rehearsals,
    /// Verdicts of rehearsals at once.
    verdicts: Vec<Verdict>,
    robots: Vec<RunningRobot>,
    /// Refusals from the present positions of robots.
    refusals: Vec<FaultReport>,
    /// Time of the first poll.
    began: Option<Instant>,
    /// Time since the first poll, s, of the fault of each I/O node, force sensor and ultrasonic matrix, in this order.
    noticed: Vec<Option<f64>>,
    /// Motions that joints slowed, and the number of further ones.
    slowed: (Vec<SlowedMotion>, u64),
}

/// A robot of a task under way.
struct RunningRobot {
    /// Last phase.
    phase: Phase,
    /// Number of instructions that ended.
    ended: u64,
    /// Whether a generator of an instruction that ended commanded the robot, and was not told yet.
    moved: bool,
    /// Number of times that the drives were switched on.
    switched_on: usize,
    /// Where the rehearsals have the robot at its next motion; `None` if no rehearsal has it anywhere.
    expected: Option<Axes>,
    /// Tolerance of each motor about `expected`, rad.
    tolerance: Axes,
    /// Whether the robot may move. Set when its position is checked, and cleared when it is off or faulted.
    released: bool,
    /// `switched_on` when the rehearsal was requested for which the robot waits.
    asked: Option<usize>,
    course: Course,
}

impl RunningRobot {
    /// A robot that is off. Its position is expected at home if the robot `moved` in the rehearsal.
    fn at(home: PlannedStart, moved: bool) -> Self {
        Self {
            phase: Phase::Off,
            ended: 0,
            moved: false,
            switched_on: 0,
            expected: moved.then_some(home.motors),
            tolerance: home.tolerance,
            released: false,
            asked: None,
            course: Course::from(home.motors),
        }
    }

    /// Takes the phase of the effector.
    fn enter(&mut self, phase: Phase) {
        if is_down(self.phase) && !is_down(phase) {
            self.switched_on += 1;
        }
        if phase == Phase::Faulted && self.phase != phase {
            self.course.faults.push(self.ended);
            self.expected = None;
        }
        self.released &= !is_down(phase);
        self.phase = phase;
    }

    /// Whether a rehearsal has the robot at these motor positions, rad.
    fn is_expected_at(&self, motors: &Axes) -> bool {
        let start = self.expected.map(|motors| PlannedStart { motors, tolerance: self.tolerance });
        start.is_some_and(|start| start.admits(motors))
    }
}

/// Whether the drives have no power. The robot may then be moved by hand.
fn is_down(phase: Phase) -> bool {
    matches!(phase, Phase::Off | Phase::Faulted)
}

impl Carrying {
    /// Polls the processes and the task. Returns whether the task is under way or any robot has an instruction. `tell`
    /// receives the progress and must not wait.
    pub(super) fn poll(&mut self, now: Instant, mut tell: impl FnMut(Progress)) -> bool {
        self.judge();
        self.notice(now);
        let Self { executor, robots, slowed: (listed, more), began, .. } = self;
        let time_s = began.map_or(0.0, |began| now.since(began).as_secs_f64());
        let expected = self.instructions;
        let before: Vec<_> = robots.iter().map(|it| (it.phase, it.ended)).collect();
        let mut waiting = Vec::new();
        let busy = executor.poll(now, |ecp, news| match news {
            News::Ended { robot, moved } => {
                let it = &mut robots[robot];
                it.enter(ecp.status().phase);
                it.ended += 1;
                it.moved |= moved;
                match ecp.take_slowed() {
                    Some(part) if listed.len() < slowed::MOST => listed.push(SlowedMotion { robot, time_s, part }),
                    Some(_) => *more += 1,
                    None => {}
                }
                if it.released {
                    it.expected = Some(ecp.latest().commanded);
                }
            }
            News::Held { robot } => {
                let (it, motors) = (&mut robots[robot], ecp.latest().commanded);
                it.enter(ecp.status().phase);
                if it.is_expected_at(&motors) {
                    it.released = true;
                    ecp.hold(false);
                } else if it.asked.is_none() {
                    it.asked = Some(it.switched_on);
                    it.course.found.push((it.switched_on.saturating_sub(1), motors));
                    waiting.push(robot);
                }
            }
        });
        let statuses = executor.statuses();
        for (robot, ((status, it), (phase, ended))) in statuses.iter().zip(robots.iter_mut()).zip(before).enumerate() {
            it.enter(status.phase);
            if is_down(it.phase) {
                executor.hold(robot, true);
            }
            if it.ended > ended || it.phase != phase {
                let moved = take(&mut it.moved);
                tell(Progress { robot, phase: it.phase, ended: it.ended - ended, moved, expected });
            }
        }
        for robot in waiting {
            self.ask(robot);
        }
        busy
    }

    /// Notes the times of new faults of devices that stop no axis.
    fn notice(&mut self, now: Instant) {
        let time = now.since(*self.began.get_or_insert(now)).as_secs_f64();
        let io = self.io.iter().map(|link| link.inputs.read().fault.is_some());
        let sensors = self.sensors.iter().map(|sensor| sensor.link().read().fault.is_some());
        let matrices = self.matrices.iter().map(|link| link.read().fault.is_some());
        for (noticed, faulted) in self.noticed.iter_mut().zip(io.chain(sensors).chain(matrices)) {
            *noticed = faulted.then(|| noticed.unwrap_or(time));
        }
    }

    /// Ends the task, and returns its errors and the faults of the I/O nodes. The drive groups still exist.
    pub(super) fn finish(self) -> TaskErrors {
        let (ended, mut noted) = self.executor.finish();
        let (file, mut faults) = (&*self.file, self.refusals);
        let error = match ended {
            // The rehearsal with the scene ends here.
            Some(Ended::Task(Err(TaskError::NotRehearsed { why }))) => {
                streams::warn(format_args!("mrroc: the task is not rehearsed with the scene up to its end: {why}"));
                None
            }
            Some(Ended::Task(Err(error))) => Some(error),
            // The refusal was noted when it was found.
            Some(Ended::System(SystemError::RefusedFromHere { .. })) => None,
            Some(Ended::System(error)) => Some(TaskError::System(error)),
            Some(Ended::Task(Ok(()))) | None => None,
        };
        if let Some(error) = error {
            let of_instruction = error.instruction();
            noted.retain(|noted| Some(&noted.error) != of_instruction);
            faults.push(of_instruction.map_or_else(|| FaultReport::of_run(&error), |error| describe(file, error)));
        }
        let mut noticed = self.noticed.into_iter().flatten();
        let of_devices = io_faults(file, &self.io).chain(force_faults(file, &self.sensors));
        for fault in of_devices.chain(matrix_faults(file, &self.matrices)) {
            let fault = FaultReport { time_s: noticed.next(), ..fault };
            // This error may have ended the task.
            if !faults.iter().any(|known| known.is_same(&fault)) {
                faults.push(fault);
            }
        }
        let mut received = vec![false; self.robots.len()];
        for NotedError { error, received: by_task, latched } in &noted {
            received[error.robot] |= by_task & latched;
        }
        let mut recovered = Vec::new();
        for NotedError { error, latched, .. } in &noted {
            let still_stops = *latched && !received[error.robot];
            let list = if still_stops { &mut faults } else { &mut recovered };
            list.push(describe(file, error));
        }
        TaskErrors { faults, recovered, received, slowed: self.slowed }
    }

    /// Requests a rehearsal for a robot, which is held.
    fn ask(&mut self, robot: usize) {
        let courses = self.robots.iter().map(|robot| robot.course.clone()).collect();
        match &self.rehearsals {
            Rehearsals::Unneeded => self.verdicts.push((robot, Ok(()))),
            Rehearsals::AtOnce => {
                let never = Arc::default();
                self.verdicts.push((robot, rehearse_again(&self.file, &self.program, courses, &never)));
            }
            // The queue has a place for each robot, and each robot waits for one verdict.
            Rehearsals::Aside { ask, .. } => {
                if ask.try_send((robot, courses)).is_err() {
                    self.verdicts.push((robot, Err(NoRehearsals.into())));
                }
            }
        }
    }

    /// Releases the robots from whose positions the task is possible. The first refusal ends the task.
    fn judge(&mut self) {
        let mut verdicts = take(&mut self.verdicts);
        if let Rehearsals::Aside { verdicts: aside, .. } = &self.rehearsals {
            let end = loop {
                match aside.try_recv() {
                    Ok(verdict) => verdicts.push(verdict),
                    Err(end) => break end,
                }
            };
            if end == TryRecvError::Disconnected {
                let waiting = self.robots.iter().enumerate().filter(|(_, it)| it.asked.is_some());
                verdicts.extend(waiting.map(|(robot, _)| (robot, Err(NoRehearsals.into()))));
            }
        }
        for (robot, verdict) in verdicts {
            let it = &mut self.robots[robot];
            if it.asked.take() != Some(it.switched_on) || is_down(it.phase) {
                // The drives were off since the request. The robot waits at its next motion again.
                continue;
            }
            match verdict {
                Ok(()) => {
                    it.released = true;
                    self.executor.hold(robot, false);
                }
                Err(error) => {
                    let what =
                        format!("was referenced and stands away from the rehearsed positions, from where {error:#}");
                    self.refusals.push(FaultReport::of_robot(&self.file, robot, None, what));
                    self.stop.request();
                    self.executor.abort(SystemError::RefusedFromHere { robot });
                }
            }
        }
    }
}
