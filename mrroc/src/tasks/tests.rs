//! Tasks on two IRb-6: errors, joins, dropped instructions, rehearsal, and refusals.

mod operator;
mod refusals;
mod team;
mod transparent;

use std::fs;
use std::future::{pending, poll_fn};
use std::path::Path;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::task::{Context, Poll, Wake, Waker};
use std::thread;

use controller::ecp::{ChartPhase, EcpError};

use super::*;
use crate::prelude::*;
use crate::rehearsal::rehearse;
use crate::report::LastCycles;
use crate::run::{Requests, RunOptions};

/// Two IRb-6, each on a bus of its own. Their axes stand close to the index pulses.
pub(crate) fn two_arms() -> CellFile {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/irb6.toml");
    let mut cell = crate::cell::Cell::parse(&fs::read_to_string(path).unwrap()).unwrap();
    let robot = &mut cell.robot[0];
    robot.program.clear();
    let home = robot.arm().unwrap().robot().home();
    for (axis, home) in robot.axis.iter_mut().zip(&*home) {
        axis.emulator.start = Some(home - 2.5);
        axis.homing.order = 0;
    }
    let (mut bus, mut robot) = (cell.bus[0].clone(), cell.robot[0].clone());
    (cell.robot[0].name, robot.name) = ("left".into(), "right".into());
    (bus.name, bus.interface) = ("second".into(), "can1".into());
    robot.axis.iter_mut().for_each(|axis| axis.bus = "second".into());
    cell.bus.push(bus);
    cell.robot.push(robot);
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("cell.toml");
    fs::write(&path, toml::to_string(&cell).unwrap()).unwrap();
    CellFile::read(&path).unwrap()
}

fn in_lockstep(task: impl AsyncFn(&mut Cell) -> Outcome + Send + Sync + 'static) -> RunReport {
    crate::run(&two_arms(), BenchKind::Lockstep, task).unwrap()
}

/// Rehearses a task that must be accepted.
#[track_caller]
fn accepted(task: impl AsyncFn(&mut Cell) -> Outcome + Send + Sync + 'static) {
    rehearse(&two_arms(), &Program::of(task)).unwrap();
}

/// Rehearses a task that must be refused, and returns the refusal.
#[track_caller]
fn refused(task: impl AsyncFn(&mut Cell) -> Outcome + Send + Sync + 'static) -> String {
    format!("{:#}", rehearse(&two_arms(), &Program::of(task)).unwrap_err())
}

const fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

/// Both robots, with power and a reference.
async fn ready(cell: &Cell) -> Result<[Robot; 2], TaskError> {
    let [mut left, mut right] = cell.robots(["left", "right"])?;
    let prepare = || Task::new().enable().home();
    join(left.perform(prepare()), right.perform(prepare())).await?;
    Ok([left, right])
}

/// A motion of the column to `angle`, rad, of about two seconds for 1 rad.
fn turn(robot: &Robot, angle: f64) -> Newsmooth {
    robot.motions().joints(0.3, &[[angle, -1.571, 0.0, 0.0, 0.0]]).unwrap()
}

/// Commanded position, rad, and velocity, rad/s, of the column.
fn column(robot: &Robot) -> (f64, f64) {
    let joints = robot.image().unwrap().commanded.joints;
    (joints.position[0], joints.velocity[0])
}

/// A generator that refuses its motion in the first step, or steps to and fro faster than the motors can.
#[derive(Clone, Copy)]
enum Impossible {
    Refused,
    Leaps,
}

impl Generator for Impossible {
    type First = ();
    type Every = ();
    type Out = ();
    type Memory = f64;

    fn first_step(&mut self, (): &(), _: Duration) -> Result<Next<f64>, GeneratorError> {
        match self {
            Self::Refused => Err(GeneratorError::User(7)),
            Self::Leaps => Ok(Next::remember(0.3)),
        }
    }
    fn terminal(&self, _: &f64, (): &()) -> bool {
        false
    }
    fn next_step(&self, by: &f64, (): &()) -> Result<Next<f64>, GeneratorError> {
        let mut joints = AxesState::default();
        joints.position[0] = *by;
        Ok(Next::command(Setpoint::JointsBy(joints), -by))
    }
}

#[test]
fn an_error_that_the_task_handles_is_listed_and_the_run_completes() {
    let report = in_lockstep(async |cell: &mut Cell| {
        let [mut left, _right] = ready(cell).await?;
        let error = left.execute(Impossible::Refused).await.unwrap_err();
        assert_eq!(error.class(), Class::NonFatal);
        let found = error.instruction().unwrap();
        assert_eq!(
            (found.robot, found.instruction, found.step, found.phase),
            (0, 2, Some(0), Some(ChartPhase::FirstStep))
        );
        assert_eq!(found.cause, EcpError::Generator { step: 0, error: GeneratorError::User(7) });
        left.execute(turn(&left, 0.2)).await?;
        assert!((column(&left).0 - 0.2).abs() < 1e-6);
        Ok(())
    });
    assert_eq!((report.outcome, &report.faults[..]), (RunOutcome::Completed, &[][..]));
    let recovered = serde_json::to_value(&report.recovered).unwrap();
    let expected = serde_json::json!([{
        "robot": "left", "axis": null, "stop_category": null, "what": "step 0: generator error 7",
        "class": "non-fatal", "instruction": 2, "step": 0, "phase": "first-step", "check": null, "cycle": 428,
        "stopped": [], "time_s": 0.856,
    }]);
    assert_eq!(recovered, expected);
    assert!(report.to_string().contains("\nrecovered: left: step 0: generator error 7"), "{report}");
}

#[test]
fn a_fatal_error_of_one_robot_lets_the_other_finish() {
    let report = in_lockstep(async |cell: &mut Cell| {
        let [mut left, mut right] = ready(cell).await?;
        let motion = turn(&right, 0.4);
        let broken = async {
            let error = left.execute(Impossible::Leaps).await.unwrap_err();
            assert_eq!(error.class(), Class::Fatal);
            Ok(())
        };
        join(broken, right.execute(motion)).await?;
        assert!((column(&right).0 - 0.4).abs() < 1e-6);
        // The fault is latched until a reset.
        assert_eq!(left.enable().await.unwrap_err().class(), Class::Fatal);
        Ok(())
    });
    assert_eq!((report.outcome, &report.faults[..]), (RunOutcome::Completed, &[][..]));
    let recovered = serde_json::to_value(&report.recovered).unwrap();
    assert_eq!((&recovered[0]["robot"], &recovered[0]["class"]), (&"left".into(), &"fatal".into()));
    assert_eq!((&recovered[0]["phase"], &recovered[0]["axis"]), (&"transfer".into(), &"left.column".into()));
    // Both errors are of the same fault.
    assert_eq!(report.recovered.len(), 1, "{recovered}");
    for error in &report.recovered {
        let LastCycles { axes, cycles } = error.last_cycles.as_ref().unwrap();
        assert_eq!((axes.len(), &axes[0][..], cycles.len()), (5, "left.column", 16));
        assert!(cycles.windows(2).all(|two| two[1].cycle == two[0].cycle + 1), "{cycles:?}");
        let fault = &cycles[15];
        assert_eq!([&fault.commanded_rad, &fault.torque_nm].map(Vec::len), [5; 2]);
        assert!(fault.measured_rad.iter().zip(&fault.commanded_rad).all(|(one, other)| (one - other).abs() < 0.1));
    }
}

#[test]
fn in_the_laboratory_a_robot_with_a_fault_stops_no_other() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/lab.toml");
    let task = async |cell: &mut Cell| {
        let [mut irb6, mut conveyor, mut gripper] = cell.robots(["irb6", "conveyor", "gripper"])?;
        let belt = conveyor.motions().joints(0.3, &[[0.5]])?;
        let broken = async {
            let leap = irb6.perform(Task::new().enable().home().run(Impossible::Leaps)).await;
            assert_eq!(leap.unwrap_err().class(), Class::Fatal);
            Ok(())
        };
        let parts = conveyor.perform(Task::new().enable().home().run(Wait { duration: ms(20_000) }).run(belt));
        let jaws = gripper.perform(Task::new().enable().home());
        join(broken, join(parts, jaws)).await?;
        assert!((column(&conveyor).0 - 0.5).abs() < 1e-6);
        Ok(())
    };
    let report = crate::run(&CellFile::read(path).unwrap(), BenchKind::Lockstep, task).unwrap();
    assert_eq!(
        (report.outcome, report.recovered.len(), report.faults.len()),
        (RunOutcome::Completed, 1, 0),
        "{report}"
    );
    assert_eq!(report.recovered[0].robot.as_deref(), Some("irb6"));
}

#[test]
fn a_robot_with_a_fault_moves_again_after_a_reset() {
    let report = in_lockstep(async |cell: &mut Cell| {
        let [mut left, _right] = ready(cell).await?;
        assert_eq!(left.execute(Impossible::Leaps).await.unwrap_err().class(), Class::Fatal);
        // Refused by the same fault, which is reported once.
        assert!(left.enable().await.is_err());
        assert!(left.home().await.is_err());
        left.reset_fault().await?;
        left.enable().await?;
        left.execute(turn(&left, 0.2)).await?;
        assert!((column(&left).0 - 0.2).abs() < 1e-6);
        Ok(())
    });
    assert_eq!((report.outcome, report.recovered.len()), (RunOutcome::Completed, 1), "{report}");
}

#[test]
fn an_error_that_the_task_returns_is_the_fault_of_the_run() {
    let report = in_lockstep(async |cell: &mut Cell| {
        let [mut left, _right] = ready(cell).await?;
        if cell.rehearsing() { Ok(()) } else { left.execute(Impossible::Refused).await }
    });
    assert_eq!((report.outcome, report.recovered.len(), report.faults.len()), (RunOutcome::Faulted, 0, 1));
    assert_eq!(report.faults[0].place.unwrap().class, Class::NonFatal);
}

/// Drops `motion` when `sleep` ends, which must be before the end of the motion.
async fn drop_after(sleep: impl Future<Output = ()>, motion: impl Future<Output = Outcome>) {
    let (mut motion, mut sleep) = (pin!(motion), pin!(sleep));
    let dropped = poll_fn(|context| {
        assert!(motion.as_mut().poll(context).is_pending());
        sleep.as_mut().poll(context)
    });
    dropped.await;
}

#[test]
fn a_dropped_motion_brakes_and_the_next_instruction_begins_after_standstill() {
    accepted(async |cell: &mut Cell| {
        let [mut left, _right] = ready(cell).await?;
        let motion = turn(&left, 1.0);
        drop_after(cell.sleep(ms(600)), left.execute(motion)).await;
        assert!(column(&left).1 > 0.1, "{:?}", column(&left));
        left.enable().await?;
        let (at, velocity) = column(&left);
        assert!((0.01..0.9).contains(&at) && velocity == 0.0, "{at} {velocity}");
        left.execute(turn(&left, 0.0)).await
    });
}

#[test]
fn a_failed_part_of_a_join_brakes_the_other_part_before_the_join_returns() {
    accepted(async |cell: &mut Cell| {
        let [mut left, mut right] = ready(cell).await?;
        let motion = turn(&left, 1.0);
        let failing = async {
            cell.sleep(ms(600)).await;
            right.execute(Impossible::Refused).await
        };
        let error = join(left.execute(motion), failing).await.unwrap_err();
        assert_eq!(error.instruction().unwrap().robot, 1);
        let (at, velocity) = column(&left);
        assert!((0.01..0.9).contains(&at) && velocity == 0.0, "{at} {velocity}");
        Ok(())
    });
}

#[test]
fn a_future_of_another_library_is_refused_in_the_rehearsal() {
    let said = "the task awaits a future that is not of this library";
    let alone = refused(async |_: &mut Cell| {
        pending::<()>().await;
        Ok(())
    });
    assert_eq!(alone, said);
    // The foreign future remains alone when the other part has ended.
    let joined = refused(async |cell: &mut Cell| {
        let slept = async {
            cell.sleep(ms(100)).await;
            Ok(())
        };
        join(pending(), slept).await
    });
    assert_eq!(joined, said);
}

/// Notes that it was woken.
struct Woken(AtomicBool);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[test]
fn a_combinator_that_polls_woken_futures_only_goes_on() {
    accepted(async |cell: &mut Cell| {
        let woken = Arc::new(Woken(true.into()));
        let waker = Waker::from(Arc::clone(&woken));
        let mut slept = pin!(cell.sleep(ms(100)));
        let combined = poll_fn(|_| match woken.0.swap(false, Ordering::Relaxed) {
            true => slept.as_mut().poll(&mut Context::from_waker(&waker)),
            false => Poll::Pending,
        });
        combined.await;
        Ok(())
    });
}

#[test]
fn a_panic_of_the_task_stops_all_robots() {
    assert_eq!(refused(async |_: &mut Cell| panic!("as the test asks")), "the task panicked");
    let report = in_lockstep(async |cell: &mut Cell| {
        let [mut left, _right] = ready(cell).await?;
        let motion = turn(&left, 1.0);
        let panics = async {
            cell.sleep(ms(600)).await;
            assert!(cell.rehearsing(), "as the test asks");
            Ok(())
        };
        join(left.execute(motion), panics).await
    });
    let faults: Vec<_> = report.faults.iter().map(ToString::to_string).collect();
    // A robot that still has power would be a second fault.
    assert_eq!((report.outcome, faults.len()), (RunOutcome::Faulted, 1), "{faults:?}");
    assert!(
        faults[0].starts_with("the task panicked in thread lockstep: as the test asks (mrroc/src/tasks/"),
        "{faults:?}"
    );
}

#[test]
fn a_task_that_blocks_is_refused_in_the_rehearsal_and_stopped_in_the_run() {
    fn block() -> ! {
        loop {
            thread::park();
        }
    }
    let said = "the task did not return from its turn within 10s";
    assert!(refused(async |_: &mut Cell| block()).starts_with(said));
    let task = async |cell: &mut Cell| {
        let [_left, _right] = ready(cell).await?;
        if cell.rehearsing() { Ok(()) } else { block() }
    };
    let report = crate::run(&two_arms(), BenchKind::Emulated, task).unwrap();
    assert_eq!((report.outcome, report.faults.len()), (RunOutcome::Faulted, 1), "{report}");
    assert!(report.faults[0].what.starts_with(said), "{report}");
}

/// A generator that blocks in its tenth step, unless it is rehearsed.
struct Stuck {
    rehearsed: bool,
}

impl Generator for Stuck {
    type First = ();
    type Every = EffectorImage;
    type Out = ();
    type Memory = u32;

    fn first_step(&mut self, (): &(), _: Duration) -> Result<Next<u32>, GeneratorError> {
        Ok(Next::remember(0))
    }
    fn terminal(&self, step: &u32, _: &EffectorImage) -> bool {
        *step == 10
    }
    fn next_step(&self, step: &u32, _: &EffectorImage) -> Result<Next<u32>, GeneratorError> {
        if *step == 9 && !self.rehearsed {
            loop {
                thread::park();
            }
        }
        Ok(Next::remember(step + 1))
    }
}

#[test]
fn a_generator_that_blocks_in_a_step_ends_the_run() {
    let task = async |cell: &mut Cell| {
        let [mut left, _right] = ready(cell).await?;
        left.execute(Stuck { rehearsed: cell.rehearsing() }).await
    };
    let report = crate::run(&two_arms(), BenchKind::Emulated, task).unwrap();
    assert_eq!((report.outcome, report.faults.len()), (RunOutcome::Faulted, 1), "{report}");
    assert!(report.faults[0].what.starts_with("a generator did not return from a step within 10s"), "{report}");
}

#[test]
fn a_task_that_blocks_in_lockstep_ends_the_run_with_an_error() {
    let task = async |cell: &mut Cell| {
        let [_left, _right] = ready(cell).await?;
        if cell.rehearsing() {
            return Ok(());
        }
        loop {
            thread::park();
        }
    };
    let error = crate::run(&two_arms(), BenchKind::Lockstep, task).unwrap_err().to_string();
    assert!(error.starts_with("the task did not return from its turn within 10s"), "{error}");
}

#[test]
fn the_replacement_of_a_first_motion_is_rehearsed_beside_home() {
    let ends = Arc::new(AtomicU32::new(0));
    let count = Arc::clone(&ends);
    accepted(async move |cell: &mut Cell| {
        let [mut left, _right] = ready(cell).await?;
        let limits = left.motions().limits();
        let to = |column| JerkLimited::new(Space::Joint, 5, limits, &[[column, -1.571, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]]);
        let (there, back) = (to(0.3)?.sent_ahead(5), to(-0.1)?);
        let replacer = left.replacer();
        let change = async {
            cell.sleep(ms(200)).await;
            Ok(replacer.replace(back)?)
        };
        join(left.execute(there), change).await?;
        count.fetch_add(1, Ordering::Relaxed);
        Ok(())
    });
    // From home, and from sixteen positions beside home.
    assert_eq!(ends.load(Ordering::Relaxed), 17);
}

#[test]
fn a_first_motion_after_waits_is_rehearsed_beside_home() {
    let ends = Arc::new(AtomicU32::new(0));
    let count = Arc::clone(&ends);
    accepted(async move |cell: &mut Cell| {
        let [mut left, _right] = ready(cell).await?;
        let motion = turn(&left, 0.2);
        left.execute(Wait { duration: ms(40) }).await?;
        left.perform(Task::new().run(Wait { duration: ms(40) }).run(motion)).await?;
        count.fetch_add(1, Ordering::Relaxed);
        Ok(())
    });
    // From home, and from sixteen positions beside home.
    assert_eq!(ends.load(Ordering::Relaxed), 17);
}

#[test]
fn a_robot_has_one_handle_at_a_time() {
    accepted(async |cell: &mut Cell| {
        let twice = cell.robots(["left", "left"]).err().unwrap().to_string();
        assert_eq!(twice, "robot \"left\" is in use: a robot has one handle at a time");
        let unknown = cell.robot("middle").err().unwrap().to_string();
        assert_eq!(unknown, "the cell has no robot \"middle\", only left, right");
        // A dropped handle can be taken again.
        drop(cell.all_robots()?);
        cell.robots(["right", "left"]).map(|robots| assert_eq!(robots.each_ref().map(Robot::name), ["right", "left"]))
    });
}

#[test]
fn side_effects_that_a_task_leaves_out_of_rehearsals_happen_once() {
    let (rehearsals, runs) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicU32::new(0)));
    let counts = [Arc::clone(&rehearsals), Arc::clone(&runs)];
    let report = in_lockstep(async move |cell: &mut Cell| {
        counts[usize::from(!cell.rehearsing())].fetch_add(1, Ordering::Relaxed);
        cell.end_rehearsal("the test has an operator")?;
        cell.robot("left")?.enable().await
    });
    assert_eq!(report.outcome, RunOutcome::Completed);
    // From home, and from sixteen positions beside home.
    assert_eq!((rehearsals.load(Ordering::Relaxed), runs.load(Ordering::Relaxed)), (17, 1));
}

#[test]
fn two_runs_of_a_task_in_lockstep_are_the_same_bit_for_bit() {
    async fn task(cell: &mut Cell) -> Outcome {
        let [mut left, mut right] = ready(cell).await?;
        for angle in [0.3, 0.0] {
            let motion = turn(&right, -angle);
            let other = async {
                cell.sleep(ms(100)).await;
                right.execute(motion).await
            };
            let motion = turn(&left, angle);
            join(left.execute(motion), other).await?;
        }
        let motion = turn(&left, 1.0);
        drop_after(cell.sleep(ms(600)), left.execute(motion)).await;
        left.execute(Impossible::Refused).await.unwrap_err();
        join_all([left.disable(), right.disable()]).await
    }
    let directory = tempfile::tempdir().unwrap();
    let records = ["one.csv", "two.csv"].map(|name| {
        let record = directory.path().join(name);
        let options = RunOptions { record: Some(record.clone()), ..RunOptions::on(BenchKind::Lockstep) };
        let report =
            crate::run::run(&two_arms(), &options, &Requests::default(), &Program::of(task), &mut |_| {}).unwrap();
        assert_eq!((report.outcome, report.recovered.len()), (RunOutcome::Completed, 1));
        fs::read(record).unwrap()
    });
    assert!(records[0].len() > 1_000_000 && records[0] == records[1], "{}", records[0].len());
}
