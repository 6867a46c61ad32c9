//! Ends, replacements and drops of motions by a task, on the real servo with ideal drives, against a model.

use std::cell::{Cell, RefCell};
use std::future::poll_fn;
use std::pin::{Pin, pin};
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use servo::{Servo, SpeedOverride};

use super::*;
use crate::coordination::LinkError;
use crate::ecp::tests::Gantry;
use crate::ecp::tests::teams::ideal::{self, PERIOD, Sent};
use crate::ecp::{EcpConfig, EcpError, Meetings, Plan, Planner, ReplaceRefused, Subcontrollers, Task};
use crate::generator::{
    AxesState, EffectorImage, Generator, GeneratorError, Images, JerkLimited, MotionLimits, Newsmooth, Next, Pace,
    Pose, Setpoint, SmoothPose, Wait,
};
use crate::random::Random;
use crate::robot::{Arm, Space};

const CONFIG: EcpConfig = EcpConfig {
    period: PERIOD,
    pace: Pace { periods: 10, read_at: 8 },
    macrosteps_ahead: 2,
    silence: Duration::from_millis(500),
    switching: Duration::from_secs(5),
    planning: Duration::from_secs(60),
    homing: Duration::from_secs(10),
    meeting: Duration::from_secs(600),
};

/// Returns a plan some polls after it was handed over.
struct Slow {
    polls: u32,
    left: u32,
    plan: Option<Plan>,
}

impl Planner for Slow {
    fn begin(&mut self, mut plan: Plan) {
        plan.compute();
        (self.left, self.plan) = (self.polls, Some(plan));
    }
    fn finished(&mut self) -> Option<Plan> {
        if self.left > 0 {
            self.left -= 1;
            return None;
        }
        self.plan.take()
    }
}

/// One robot with its task.
struct Bench {
    servo: Servo,
    executor: Executor<()>,
    /// Whether the process of the robot has an instruction.
    busy: Rc<Cell<bool>>,
    now: Instant,
}

impl Bench {
    /// `plan_polls`: polls that each plan takes.
    fn new<T: Future<Output = Result<(), ()>> + 'static>(plan_polls: u32, task: impl FnOnce(Stage) -> T) -> Self {
        let (servo, link) = ideal::servo([0.0; 3], 500.0, 2000.0, &Sent::default());
        let arm = Arm::new(Arc::new(Gantry), Pose::identity());
        let mut subcontrollers = Subcontrollers::new(vec![Ecp::new(arm, link, CONFIG)], Meetings::new([]));
        subcontrollers.plan_with(|| Box::new(Slow { polls: plan_polls, left: 0, plan: None }));
        let agents = Agents::new(subcontrollers);
        let (agent, busy) = (agents.agent(0).expect("the robot is free"), Rc::new(Cell::new(false)));
        let stage = Stage { agent, busy: Rc::clone(&busy), speed: servo.speed_override() };
        let executor = Executor::new(agents, task(stage), Turns::default());
        Self { servo, executor, busy, now: Instant::ZERO }
    }

    /// Executes the task, for `cycles` at most.
    fn run(mut self, cycles: u32) {
        for _ in 0..cycles {
            self.now += PERIOD;
            self.servo.step(self.now);
            let under_way = self.executor.poll(self.now, |ecp, _| self.busy.set(ecp.status().instruction.is_some()));
            self.busy.set(self.executor.statuses()[0].instruction.is_some());
            if !under_way {
                assert!(matches!(self.executor.finish().0, Some(Ended::Task(Ok(())))));
                return;
            }
        }
        panic!("the task does not end");
    }
}

/// What a task works with.
struct Stage {
    agent: Agent,
    busy: Rc<Cell<bool>>,
    speed: SpeedOverride,
}

impl Stage {
    /// Commanded position and velocity of joint 0, m and m/s.
    fn joint(&self) -> (f64, f64) {
        let joints = self.agent.image().expect("the gantry is in range").commanded.joints;
        (joints.position[0], joints.velocity[0])
    }
}

async fn wait(agents: &Agents, cycles: u32) {
    agents.sleep(PERIOD * cycles).await;
}

/// Drops `motion` after some cycles, which must be before its end.
async fn drop_after(agents: &Agents, cycles: u32, motion: impl Future) {
    let (mut motion, mut slept) = (pin!(motion), pin!(wait(agents, cycles)));
    let dropped = poll_fn(|context| {
        assert!(motion.as_mut().poll(context).is_pending());
        slept.as_mut().poll(context)
    });
    dropped.await;
}

fn limits() -> MotionLimits {
    MotionLimits::uniform(1.0, 5.0, 50.0)
}

fn to(x: f64) -> Newsmooth {
    let pose = SmoothPose::fast([x, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    Newsmooth::new(Space::Joint, 3, limits(), vec![pose]).expect("a sound motion")
}

fn jerk_limited(x: f64) -> JerkLimited {
    JerkLimited::new(Space::Joint, 3, limits(), &[[x, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]]).expect("a sound motion")
}

/// Moves joint 0 to and fro without an end. Begins in motion. The next steps read the images `I`.
struct Roam<I>(std::marker::PhantomData<I>);

impl<I> Roam<I> {
    fn new() -> Self {
        Self(std::marker::PhantomData)
    }
}

/// State of the joints, and duration of a macrostep, s.
#[derive(Clone, Copy, Debug)]
struct Roaming(AxesState, f64);

impl Roaming {
    /// The next set-point: towards 0.2 m/s to the middle, at 1 m/s².
    fn next(self) -> Next<Self> {
        let Self(mut joints, dt) = self;
        let (x, before) = (joints.position[0], joints.velocity[0]);
        let wanted = if x > 0.5 || x >= -0.5 && before < 0.0 { -0.2 } else { 0.2 };
        let after = before + (wanted - before).clamp(-dt, dt);
        joints = AxesState::new(joints.position, joints.velocity);
        joints.position[0] = x + (before + after) / 2.0 * dt;
        joints.velocity[0] = after;
        Next::command(Setpoint::Joints(joints), Self(joints, dt))
    }
}

impl<I: Images> Generator for Roam<I> {
    type First = EffectorImage;
    type Every = I;
    type Out = ();
    type Memory = Roaming;

    fn begins_in_motion(&self) -> bool {
        true
    }
    fn first_step(&mut self, e: &EffectorImage, macrostep: Duration) -> Result<Next<Roaming>, GeneratorError> {
        Ok(Next::remember(Roaming(e.commanded.joints, macrostep.as_secs_f64())))
    }
    fn terminal(&self, _: &Roaming, _: &I) -> bool {
        false
    }
    fn next_step(&self, roaming: &Roaming, _: &I) -> Result<Next<Roaming>, GeneratorError> {
        Ok(roaming.next())
    }
}

#[test]
fn an_end_after_a_dropped_motion_is_one_of_that_motion_while_the_robot_brakes() {
    let bench = Bench::new(0, async |mut stage: Stage| {
        let agents = stage.agent.agents().clone();
        stage.agent.perform(Task::new().enable()).await.unwrap();
        let mut link = stage.agent.coordinated::<(), ()>();
        drop_after(&agents, 200, stage.agent.perform(Task::new().run(to(1.0)))).await;
        wait(&agents, 2).await;
        assert!(stage.busy.get() && stage.joint().1 > 0.1, "it brakes");
        link.end_motion().unwrap();
        stage.agent.perform(Task::new().run(to(0.1))).await.unwrap();
        assert!((stage.joint().0 - 0.1).abs() < 1e-9, "{:?}", stage.joint());
        Ok(())
    });
    bench.run(5000);
}

#[test]
fn an_end_after_the_next_motion_was_awaited_ends_that_motion() {
    // With and without an end of the dropped motion before.
    for also_before in [false, true] {
        let bench = Bench::new(0, async move |mut stage: Stage| {
            let agents = stage.agent.agents().clone();
            stage.agent.perform(Task::new().enable()).await.unwrap();
            let mut link = stage.agent.coordinated::<(), ()>();
            drop_after(&agents, 200, stage.agent.perform(Task::new().run(to(1.0)))).await;
            if also_before {
                link.end_motion().unwrap();
            }
            let ends = async {
                wait(&agents, 2).await;
                link.end_motion().unwrap();
                Ok(())
            };
            join(stage.agent.perform(Task::new().run(to(0.1))), ends).await.unwrap();
            let (at, velocity) = stage.joint();
            assert!(at > 0.1 && velocity == 0.0, "the second motion has not moved: {at}");
            stage.agent.perform(Task::new().run(to(0.1))).await.unwrap();
            assert!((stage.joint().0 - 0.1).abs() < 1e-9);
            Ok(())
        });
        bench.run(5000);
    }
}

#[test]
fn an_end_for_a_motion_that_was_dropped_before_it_began_is_forgotten() {
    let bench = Bench::new(0, async |mut stage: Stage| {
        let agents = stage.agent.agents().clone();
        stage.agent.perform(Task::new().enable()).await.unwrap();
        let mut link = stage.agent.coordinated::<(), ()>();
        drop_after(&agents, 200, stage.agent.perform(Task::new().run(to(1.0)))).await;
        let (busy, mut turns) = (Rc::clone(&stage.busy), 0);
        {
            let mut next = pin!(stage.agent.perform(Task::new().run(to(0.5))));
            // The next motion is dropped in the turn in which it would begin.
            poll_fn(|context| {
                if !busy.get() {
                    return Poll::Ready(());
                }
                assert!(next.as_mut().poll(context).is_pending());
                turns += 1;
                if turns == 3 {
                    link.end_motion().unwrap();
                }
                Poll::Pending
            })
            .await;
        }
        assert!(turns > 3);
        stage.agent.perform(Task::new().run(to(0.1))).await.unwrap();
        assert!((stage.joint().0 - 0.1).abs() < 1e-9, "{:?}", stage.joint());
        Ok(())
    });
    bench.run(5000);
}

#[test]
fn an_end_in_the_turn_in_which_a_motion_has_ended_does_not_end_the_next_one() {
    let bench = Bench::new(0, async |mut stage: Stage| {
        stage.agent.perform(Task::new().enable()).await.unwrap();
        let mut link = stage.agent.coordinated::<(), ()>();
        let (busy, mut told) = (Rc::clone(&stage.busy), false);
        {
            let mut motion = pin!(stage.agent.perform(Task::new().run(to(0.2))));
            let mut begun = false;
            poll_fn(|context| {
                begun |= busy.get();
                // The process has ended the motion, and the task does not know.
                if begun && !busy.get() && !told {
                    told = true;
                    link.end_motion().unwrap();
                }
                motion.as_mut().poll(context)
            })
            .await
            .unwrap();
        }
        assert!(told);
        stage.agent.perform(Task::new().run(to(0.1))).await.unwrap();
        assert!((stage.joint().0 - 0.1).abs() < 1e-9, "{:?}", stage.joint());
        Ok(())
    });
    bench.run(5000);
}

#[test]
fn an_end_between_two_motions_is_kept_through_a_list_without_a_motion() {
    let bench = Bench::new(0, async |mut stage: Stage| {
        stage.agent.perform(Task::new().enable().run(to(0.2))).await.unwrap();
        let mut link = stage.agent.coordinated::<(), ()>();
        link.end_motion().unwrap();
        stage.agent.perform(Task::new()).await.unwrap();
        stage.agent.perform(Task::new().run(to(0.1))).await.unwrap();
        assert!((stage.joint().0 - 0.2).abs() < 1e-9, "the motion has moved: {:?}", stage.joint());
        stage.agent.perform(Task::new().run(to(0.1))).await.unwrap();
        assert!((stage.joint().0 - 0.1).abs() < 1e-9, "{:?}", stage.joint());
        Ok(())
    });
    bench.run(5000);
}

#[test]
fn an_earlier_link_to_the_task_is_gone() {
    let bench = Bench::new(0, async |mut stage: Stage| {
        let mut first = stage.agent.coordinated::<u8, ()>();
        assert_eq!(first.order(1), Ok(()));
        let mut second = stage.agent.coordinated::<u8, ()>();
        assert_eq!([first.order(2), first.end_motion()], [Err(LinkError::Gone); 2]);
        assert_eq!((0..5).map(|order| second.order(order)).filter(Result::is_err).count(), 1);
        assert_eq!(second.order(5), Err(LinkError::Full));
        wait(&stage.agent.agents().clone(), 1).await;
        Ok(())
    });
    bench.run(100);
}

/// A motion of a random task, as the model has it.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    /// Without an end of its own.
    Endless,
    /// Ends by itself.
    Finite,
}

/// A list of one random motion.
fn list(random: &mut Random) -> (Kind, Task) {
    let x = random.within(-0.4, 0.4);
    match random.next() % 5 {
        0 | 1 => (Kind::Endless, Task::new().run(Roam::<()>::new())),
        2 => (Kind::Endless, Task::new().run(Roam::<EffectorImage>::new())),
        3 => (Kind::Finite, Task::new().run(jerk_limited(x))),
        _ => (Kind::Finite, Task::new().run(Wait { duration: Duration::from_millis(100) })),
    }
}

/// Replaces the present motion by a random one.
fn replace(random: &mut Random, replacer: &Replacer) -> Result<Kind, ReplaceRefused> {
    let x = random.within(-0.4, 0.4);
    match random.next() % 4 {
        0 => replacer.replace(Roam::<()>::new()).map(|()| Kind::Endless),
        1 => replacer.replace(Roam::<EffectorImage>::new()).map(|()| Kind::Endless),
        2 => replacer.replace(jerk_limited(x)).map(|()| Kind::Finite),
        _ => replacer.replace(to(x)).map(|()| Kind::Finite),
    }
}

/// Most cycles from an end until the task has the result: the poll, braking, and the settling time of the stop.
const SETTLED: u32 = 150;

/// The model: which motion is told to end, by the order of the calls.
struct Model {
    /// The last motion given, and whether it was told to end.
    kind: Kind,
    told: bool,
    /// Cycles since then.
    since: u32,
    /// Whether it is a replacement whose plan may come too late.
    late: bool,
}

/// Executes random motions with random ends, replacements, pauses and drops.
async fn random_task(mut stage: Stage, seed: u64, slow: bool, counts: Rc<RefCell<[u32; 6]>>) -> Result<(), ()> {
    let mut random = Random(seed);
    let agents = stage.agent.agents().clone();
    stage.agent.perform(Task::new().enable()).await.unwrap();
    let mut link = stage.agent.coordinated::<u8, ()>();
    let mut told_next = false;
    for number in 0..12 {
        // Between two motions.
        for _ in 0..random.next() % 3 * 10 {
            wait(&agents, 1).await;
            if random.next().is_multiple_of(64) && link.end_motion().is_ok() {
                // A dropped motion that still brakes ends anyway.
                told_next |= !stage.busy.get();
            }
        }
        let (kind, list) = list(&mut random);
        let case = format!("seed {seed}, motion {number}, {kind:?}");
        let mut model = Model { kind, told: told_next, since: 0, late: false };
        let start = stage.joint().0;
        let unmoved = std::mem::take(&mut told_next);
        let (replacer, speed) = (stage.agent.replacer(), stage.speed.clone());
        let mut dropped = false;
        {
            let mut motion: Pin<Box<dyn Future<Output = Result<(), InstructionError>>>> =
                Box::pin(stage.agent.perform(list));
            let mut began = false;
            poll_fn(|context| {
                let mut act = |model: &mut Model| {
                    match random.next() % 600 {
                        0 | 1 if link.end_motion().is_ok() => {
                            (model.told, model.since) = (true, if model.told { model.since } else { 0 });
                            counts.borrow_mut()[0] += 1;
                        }
                        2..=4 => _ = link.order(1),
                        5..=8 => match replace(&mut random, &replacer) {
                            Ok(kind) => {
                                *model = Model { kind, told: false, since: 0, late: slow };
                                counts.borrow_mut()[1] += 1;
                            }
                            Err(refused) => assert_eq!(refused, ReplaceRefused::NotRunning),
                        },
                        9 => speed.pause(),
                        10..=15 => speed.resume(),
                        16 => return true,
                        _ => {}
                    }
                    false
                };
                // The task acts before or after it learns of an end. The first poll gives the motion to the process.
                let first = began && act(&mut model);
                began = true;
                if let Poll::Ready(result) = motion.as_mut().poll(context) {
                    match result {
                        Ok(()) => assert!(model.told || model.kind == Kind::Finite, "{case}: ended without an end"),
                        Err(error) => {
                            let late = matches!(error.cause, EcpError::Unplanned { .. }) && model.late;
                            assert!(late, "{case}: {error}");
                        }
                    }
                    counts.borrow_mut()[2 + usize::from(model.told)] += 1;
                    return Poll::Ready(());
                }
                model.since += 1;
                assert!(!model.told || model.since < SETTLED, "{case}: the end had no effect");
                dropped = first || act(&mut model);
                if dropped { Poll::Ready(()) } else { Poll::Pending }
            })
            .await;
        }
        if dropped {
            counts.borrow_mut()[4] += 1;
            continue;
        }
        assert!(stage.joint().1.abs() < 1e-9, "{case}: moves after its end");
        if unmoved {
            counts.borrow_mut()[5] += 1;
            assert!((stage.joint().0 - start).abs() < 1e-12, "{case}: told to end before it moved");
        }
    }
    stage.speed.resume();
    stage.agent.perform(Task::new().run(Wait { duration: Duration::ZERO })).await.map_err(drop)?;
    assert!(stage.joint().1.abs() < 1e-9, "seed {seed}");
    Ok(())
}

#[test]
fn at_random_ends_replacements_and_drops_each_motion_ends_if_and_only_if_it_was_told_to() {
    let counts = Rc::default();
    for seed in 0..400 {
        let counts = Rc::clone(&counts);
        let polls = [0, 0, 2][seed as usize % 3];
        Bench::new(polls, |stage| random_task(stage, seed, polls > 0, counts)).run(100_000);
    }
    // Ends, replacements, motions that ended by themselves and as told, drops, and ends before the motion.
    let counts: &[u32; 6] = &counts.borrow();
    assert!(counts.iter().all(|count| *count > 200), "{counts:?}");
}
