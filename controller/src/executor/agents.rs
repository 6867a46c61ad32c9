//! Agents: the handles by which a task uses the effectors, and the state that they share with the executor.

use std::cell::RefCell;
use std::mem::{replace, take};
use std::pin::Pin;
use std::rc::Rc;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use can::Instant;
use servo::Phase;

use super::{InstructionError, LooseLink, NotedError, SystemError};
use crate::coordination::{Desk, Late, LinkConfig, MemberLink, link};
use crate::ecp::{Class, Ecp, EcpError, EcpEvent, ReplaceRefused, Status, Subcontrollers, Task};
use crate::generator::{EffectorImage, Generator, GeneratorError, Message, SensorReading};
use crate::sensor::{SensorRefused, Shell, VirtualSensor};

/// Greatest number of errors that are kept of one task.
const MOST_ERRORS: usize = 1000;

thread_local! {
    /// The agents of the task that this thread polls.
    static CURRENT: RefCell<Option<Agents>> = const { RefCell::new(None) };
}

/// The effectors of a cell, shared by a task and its executor. Clones share the same effectors.
#[derive(Clone)]
pub struct Agents(Rc<RefCell<Board>>);

/// The only handle of one effector.
pub struct Agent {
    agents: Agents,
    robot: usize,
}

/// Replaces motions of one effector while its [`Agent`] awaits the motion.
#[derive(Clone)]
pub struct Replacer {
    agents: Agents,
    robot: usize,
}

/// Reads the image of one effector while its [`Agent`] is in use.
#[derive(Clone)]
pub struct Observer {
    agents: Agents,
    robot: usize,
}

impl Observer {
    /// The effector in the last servo cycle. See [`Ecp::image`].
    pub fn image(&self) -> Result<EffectorImage, GeneratorError> {
        self.agents.0.borrow().subcontrollers.ecps()[self.robot].image()
    }
}

/// News of the effector control process of a robot.
#[derive(Clone, Copy, Debug)]
pub enum News {
    /// An instruction ended.
    Ended {
        /// Index of the robot in its cell.
        robot: usize,
        /// Whether the instruction was a motion whose generator commanded the effector. False for a replaced motion,
        /// which its replacement continues.
        moved: bool,
    },
    /// A [held](Ecp::is_held) process waits before a motion or a meeting. A release in the call that receives this news
    /// takes effect at once.
    Held {
        /// Index of the robot in its cell.
        robot: usize,
    },
}

/// State shared by the agents, their futures and the executor.
struct Board {
    subcontrollers: Subcontrollers,
    uses: Vec<Use>,
    /// Number of futures of this module that are pending.
    awaited: usize,
    /// Wakers of the futures that were pending in the last turn, for combinators that poll woken futures only.
    wakers: Vec<Waker>,
    /// Errors that the task received or had dropped, [`MOST_ERRORS`] at most.
    noted: Vec<NotedError>,
}

/// Use of one effector.
#[derive(Default)]
struct Use {
    /// Whether an [`Agent`] exists.
    taken: bool,
    progress: Progress,
    /// Whether the task gave or took an instruction in this turn.
    fresh: bool,
    /// Number of instructions before the present list.
    ended: usize,
    /// Whether the effector was faulted in the last poll.
    faulted: bool,
}

/// Progress of an instruction list.
#[derive(Clone, Copy, Default)]
enum Progress {
    #[default]
    None,
    Running,
    /// The task dropped the list, and the effector brakes.
    Dropped,
    /// The result was not fetched yet.
    Ended(Result<(), InstructionError>),
}

impl Agents {
    /// The effectors of a cell, all free.
    pub fn new(subcontrollers: Subcontrollers) -> Self {
        let uses = subcontrollers.ecps().iter().map(|_| Use::default()).collect();
        let (wakers, noted) = (Vec::new(), Vec::new());
        Self(Rc::new(RefCell::new(Board { subcontrollers, uses, awaited: 0, wakers, noted })))
    }

    /// The handle of a robot; `None` while another handle exists, or if the cell has no such robot.
    pub fn agent(&self, robot: usize) -> Option<Agent> {
        let mut board = self.0.borrow_mut();
        let taken = &mut board.uses.get_mut(robot)?.taken;
        if replace(taken, true) { None } else { Some(Agent { agents: self.clone(), robot }) }
    }

    /// Time of the last servo cycle; zero before the first.
    pub(super) fn now(&self) -> Instant {
        self.0.borrow().time()
    }

    /// Whether a robot is a member of a team under a coordinator.
    pub(super) fn is_in_team(&self, robot: usize) -> bool {
        self.0.borrow().subcontrollers.ecps()[robot].is_in_team()
    }

    /// Waits for a duration, measured by the times of the servo cycles.
    pub async fn sleep(&self, duration: Duration) {
        let mut began = None;
        let slept = Leaf::new(self, |board: &mut Board| {
            let now = board.time();
            let first = began.is_none();
            let waited = now.since(*began.get_or_insert(now));
            if first || waited < duration { Poll::Pending } else { Poll::Ready(()) }
        });
        slept.await;
    }

    /// Calls `ask` in every turn of the task, with the desk of the coordinator of these robots.
    pub(super) async fn at_desk<T, const N: usize>(
        &self,
        members: [usize; N],
        mut ask: impl FnMut(&mut Desk) -> Poll<T> + Unpin,
    ) -> T {
        let desk = |board: &mut Board| {
            let now = board.time();
            let (ecps, _, journal) = board.subcontrollers.parts();
            let rate = ecps[members[0]].latest().rate;
            let braking = members.iter().any(|robot| ecps[*robot].is_braking());
            let (planning, planning_limit) = ecps[members[0]].planning();
            ask(&mut Desk { now, rate, braking, journal, planning, planning_limit })
        };
        Leaf::new(self, desk).await
    }

    /// Calls `ask` in every turn of the task until the result is ready. The arguments are the time of the last servo cycle,
    /// and whether motion time runs slower than the clock.
    pub async fn until<T>(&self, mut ask: impl FnMut(Instant, bool) -> Poll<T> + Unpin) -> T {
        Leaf::new(self, |board: &mut Board| ask(board.time(), board.is_slowed())).await
    }

    /// Waits for the standstill of all effectors whose instructions were dropped.
    pub(super) async fn rest(&self) {
        let resting = |board: &mut Board| {
            let braking = board.uses.iter().any(|using| matches!(using.progress, Progress::Dropped));
            if braking { Poll::Pending } else { Poll::Ready(()) }
        };
        Leaf::new(self, resting).await;
    }

    /// The agents of the task that this thread polls.
    pub(super) fn current() -> Option<Self> {
        CURRENT.with_borrow(Clone::clone)
    }

    /// Calls `poll` with these agents as the current ones.
    pub(super) fn within<T>(&self, poll: impl FnOnce() -> T) -> T {
        let before = CURRENT.replace(Some(self.clone()));
        let polled = poll();
        CURRENT.set(before);
        polled
    }

    /// Begins a turn of the task. Returns false before the first servo cycle.
    pub(super) fn begin_turn(&self) -> bool {
        let (begun, mut wakers) = {
            let mut board = self.0.borrow_mut();
            (board.time() != Instant::ZERO, take(&mut board.wakers))
        };
        wakers.drain(..).for_each(Waker::wake);
        // The vector is reused, so a turn does not allocate.
        self.0.borrow_mut().wakers = wakers;
        begun
    }

    /// Polls the processes, or only those to which the task has just given or taken an instruction. Returns a system
    /// error of an effector.
    pub(super) fn poll(
        &self,
        now: Instant,
        fresh_only: bool,
        news: &mut impl FnMut(&mut Ecp, News),
    ) -> Option<SystemError> {
        let mut board = self.0.borrow_mut();
        let Board { subcontrollers, uses, noted, .. } = &mut *board;
        let (ecps, meetings, _) = subcontrollers.parts();
        let (mut polled, mut of_system) = (false, None);
        for (robot, (ecp, using)) in ecps.iter_mut().zip(uses).enumerate() {
            if !take(&mut using.fresh) && fresh_only {
                continue;
            }
            polled = true;
            loop {
                while let Some(event) = ecp.poll(now) {
                    let moved = ecp.has_commanded() && !event.replaced;
                    let error = using.note(robot, ecp, event, noted);
                    let error = error.filter(|error| error.class() == Class::System);
                    of_system = of_system.or(error.map(SystemError::Instruction));
                    news(ecp, News::Ended { robot, moved });
                }
                if !ecp.is_held() {
                    break;
                }
                news(ecp, News::Held { robot });
                if ecp.is_held() {
                    break;
                }
            }
            if replace(&mut using.faulted, is_faulted(ecp)) && !using.faulted {
                let of_robot = noted.iter_mut().filter(|noted| noted.error.robot == robot);
                of_robot.for_each(|noted| noted.latched = false);
            }
        }
        if polled {
            meetings.poll(ecps);
        }
        of_system
    }

    /// Whether any process has an instruction.
    pub(super) fn are_busy(&self) -> bool {
        self.0.borrow().subcontrollers.ecps().iter().any(is_busy)
    }

    /// Whether a future of this module is pending.
    pub(super) fn are_awaited(&self) -> bool {
        self.0.borrow().awaited > 0
    }

    pub(super) fn hold(&self, robot: usize, held: bool) {
        if let Some(ecp) = self.0.borrow_mut().subcontrollers.parts().0.get_mut(robot) {
            ecp.hold(held);
        }
    }

    pub(super) fn statuses(&self) -> Vec<Status> {
        self.0.borrow().subcontrollers.ecps().iter().map(Ecp::status).collect()
    }

    pub(super) fn noted(&self) -> Vec<NotedError> {
        self.0.borrow().noted.clone()
    }
}

impl Agent {
    /// Executes a list of instructions. Waits first for the standstill of an effector that brakes after a dropped list.
    ///
    /// After an error, the remaining instructions are dropped, and the effector stands or is faulted. If the returned
    /// future is dropped, the effector brakes.
    pub async fn perform(&mut self, task: Task) -> Result<(), InstructionError> {
        let robot = self.robot;
        let _braking = Braking(&*self);
        let mut task = Some(task);
        let ended = Leaf::new(&self.agents, |board: &mut Board| {
            if task.is_some() {
                board.begin(robot, &mut task);
                return Poll::Pending;
            }
            board.ended(robot)
        });
        ended.await
    }

    /// The effector in the last servo cycle. See [`Ecp::image`].
    pub fn image(&self) -> Result<EffectorImage, GeneratorError> {
        self.observer().image()
    }

    /// A handle that reads the image while this agent is in use.
    pub fn observer(&self) -> Observer {
        Observer { agents: self.agents.clone(), robot: self.robot }
    }

    /// Index of the robot in its cell.
    pub fn robot(&self) -> usize {
        self.robot
    }

    /// Whether the cycle law of the effector ended its last motion at a touch. See [`Ecp::has_touched`].
    pub fn has_touched(&self) -> bool {
        self.agents.0.borrow().subcontrollers.ecps()[self.robot].has_touched()
    }

    /// Gives the effector's agent a virtual sensor, as [`Sensors::install`](crate::sensor::Sensors::install).
    pub fn sense<S: VirtualSensor>(&mut self, sensor: S, shell: Shell, period: u16) -> Result<(), SensorRefused> {
        self.agents.0.borrow_mut().at(self.robot).0.sensors().install(sensor, shell, period)
    }

    /// Removes the sensor with readings of type `R`. Returns whether there was one.
    pub fn remove_sensor<R: SensorReading>(&mut self) -> bool {
        self.agents.0.borrow_mut().at(self.robot).0.sensors().remove::<R>()
    }

    /// A new link from the task to this agent, for loose coordination. Steps take the latest order and do not wait. In
    /// a motion of a team, orders wait until the next motion, and an end is refused. The new link replaces an earlier
    /// link.
    pub fn coordinated<C: Message, R: Message>(&mut self) -> LooseLink<C, R> {
        let config = LinkConfig { blocking: false, deadline: Duration::ZERO, late: Late::Hold };
        let (coordinator, member) = link(config);
        self.agents.0.borrow_mut().at(self.robot).0.follow_task(Box::new(member));
        LooseLink::new(self.agents.clone(), self.robot, coordinator)
    }

    /// Connects the agent to the coordinator of its team, or ends the connection.
    pub(super) fn follow_team(&mut self, link: Option<Box<dyn MemberLink>>) {
        self.agents.0.borrow_mut().at(self.robot).0.follow_team(link);
    }

    pub(super) fn agents(&self) -> &Agents {
        &self.agents
    }

    /// Duration of the cell's macrostep.
    pub(super) fn cell_macrostep(&self) -> Duration {
        self.agents.0.borrow().subcontrollers.ecps()[self.robot].cell_macrostep()
    }

    /// A handle that replaces motions while this agent awaits them.
    pub fn replacer(&self) -> Replacer {
        Replacer { agents: self.agents.clone(), robot: self.robot }
    }
}

impl Replacer {
    /// Replaces the generator of the present motion. See [`Ecp::replace`].
    pub fn replace(&self, generator: impl Generator) -> Result<(), ReplaceRefused> {
        let mut board = self.agents.0.borrow_mut();
        let (ecp, using) = board.at(self.robot);
        ecp.replace(generator)?;
        using.fresh = true;
        Ok(())
    }
}

impl Drop for Agent {
    fn drop(&mut self) {
        self.agents.0.borrow_mut().uses[self.robot].taken = false;
    }
}

/// Brakes the effector when an instruction is dropped before its end.
struct Braking<'a>(&'a Agent);

impl Drop for Braking<'_> {
    fn drop(&mut self) {
        self.0.agents.0.borrow_mut().drop_list(self.0.robot);
    }
}

impl Board {
    /// Time of the last servo cycle; zero before the first.
    fn time(&self) -> Instant {
        self.subcontrollers.ecps().first().map_or(Instant::ZERO, |ecp| ecp.latest().at)
    }

    /// Whether motion time runs slower than the clock.
    fn is_slowed(&self) -> bool {
        self.subcontrollers.ecps().first().is_some_and(|ecp| ecp.latest().rate < 1.0)
    }

    /// Gives the list to its process, once the process is free.
    fn begin(&mut self, robot: usize, task: &mut Option<Task>) {
        let (ecp, using) = self.at(robot);
        if !matches!(using.progress, Progress::None) || is_busy(ecp) {
            ecp.await_list();
            return;
        }
        let Some(task) = task.take() else {
            return;
        };
        if task.is_empty() {
            using.progress = Progress::Ended(Ok(()));
            return;
        }
        ecp.execute(task).expect("a free process takes a list");
        (using.progress, using.fresh) = (Progress::Running, true);
    }

    /// The result of the list.
    fn ended(&mut self, robot: usize) -> Poll<Result<(), InstructionError>> {
        let Board { subcontrollers, uses, noted, .. } = self;
        let Progress::Ended(result) = uses[robot].progress else {
            return Poll::Pending;
        };
        uses[robot].progress = Progress::None;
        let ecp = &mut subcontrollers.parts().0[robot];
        ecp.close_list();
        keep(noted, ecp, result, true);
        Poll::Ready(result)
    }

    /// Brakes the effector of a list in progress, and notes the error of a list that has ended.
    fn drop_list(&mut self, robot: usize) {
        let Board { subcontrollers, uses, noted, .. } = self;
        let (ecp, using) = (&mut subcontrollers.parts().0[robot], &mut uses[robot]);
        match using.progress {
            Progress::Running => {
                ecp.stop();
                using.fresh = true;
                using.progress = if is_busy(ecp) { Progress::Dropped } else { Progress::None };
            }
            Progress::Ended(result) => {
                using.progress = Progress::None;
                ecp.close_list();
                keep(noted, ecp, result, false);
            }
            Progress::None | Progress::Dropped => ecp.forget_awaited(),
        }
    }

    fn at(&mut self, robot: usize) -> (&mut Ecp, &mut Use) {
        (&mut self.subcontrollers.parts().0[robot], &mut self.uses[robot])
    }
}

impl Use {
    /// Notes the end of an instruction, and returns its error. The error of a dropped list is kept in `noted`.
    fn note(
        &mut self,
        robot: usize,
        ecp: &Ecp,
        event: EcpEvent,
        noted: &mut Vec<NotedError>,
    ) -> Option<InstructionError> {
        let instruction = self.ended + event.instruction;
        let outcome = event.outcome.map_err(|cause| InstructionError::of(robot, instruction, ecp, cause));
        if matches!(self.progress, Progress::Dropped) {
            keep(noted, ecp, outcome, false);
        }
        if !is_busy(ecp) {
            self.ended = instruction + 1;
            self.progress = match self.progress {
                Progress::Running => Progress::Ended(outcome),
                Progress::Dropped | Progress::Ended(_) | Progress::None => Progress::None,
            };
        }
        outcome.err()
    }
}

/// Keeps the error of a list that the task `received` or dropped. The stop of a dropped list is no error.
fn keep(noted: &mut Vec<NotedError>, ecp: &Ecp, result: Result<(), InstructionError>, received: bool) {
    let error = result.err().filter(|error| received || error.cause != EcpError::Stopped);
    if let Some(error) = error.filter(|_| noted.len() < MOST_ERRORS) {
        noted.push(NotedError { error, received, latched: is_faulted(ecp) });
    }
}

fn is_busy(ecp: &Ecp) -> bool {
    ecp.status().instruction.is_some()
}

fn is_faulted(ecp: &Ecp) -> bool {
    ecp.status().phase == Phase::Faulted
}

/// A future of this module: `ask` reads the shared state in each turn of the task. For an instruction, `ask` returns
/// `Pending` in the first turn. Each instruction therefore takes at least one turn, also in a loop.
struct Leaf<'a, F> {
    agents: &'a Agents,
    ask: F,
    awaited: bool,
}

impl<'a, F> Leaf<'a, F> {
    fn new<T>(agents: &'a Agents, ask: F) -> Self
    where
        F: FnMut(&mut Board) -> Poll<T>,
    {
        Self { agents, ask, awaited: false }
    }
}

impl<T, F: FnMut(&mut Board) -> Poll<T> + Unpin> Future for Leaf<'_, F> {
    type Output = T;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<T> {
        let leaf = &mut *self;
        let mut board = leaf.agents.0.borrow_mut();
        let polled = (leaf.ask)(&mut board);
        if polled.is_pending() {
            board.wakers.push(context.waker().clone());
        }
        match (leaf.awaited, polled.is_pending()) {
            (false, true) => board.awaited += 1,
            (true, false) => board.awaited -= 1,
            _ => {}
        }
        leaf.awaited = polled.is_pending();
        polled
    }
}

impl<F> Drop for Leaf<'_, F> {
    fn drop(&mut self) {
        if self.awaited {
            self.agents.0.borrow_mut().awaited -= 1;
        }
    }
}
