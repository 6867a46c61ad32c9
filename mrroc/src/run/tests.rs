//! Tasks on two arms with ideal drives: rehearsals from new positions, faults, and errors of dropped instructions.

use std::pin::pin;
use std::sync::Mutex;

use controller::generator::Axes;
use drive::DriveGroup;
use servo::Phase;

use super::descriptions::io_faults;
use super::*;
use crate::prelude::*;
use crate::rehearsal::{Course, IdealDrives, Rehearsed, homes, rehearse, rehearse_again};
use crate::tasks::tests::two_arms;

/// A task under way on two arms with ideal drives.
struct Stage {
    file: Arc<CellFile>,
    servo: Servo,
    carrying: running_task::Carrying,
    /// Setting a flag gives the drives of a robot a fault.
    faults: [Arc<AtomicBool>; 2],
    asked: Receiver<running_task::Question>,
    /// The thread of the rehearsals; `None` once the thread has ended.
    answers: Option<SyncSender<running_task::Verdict>>,
    phases: [Phase; 2],
    /// Whether each robot was in motion.
    moved: [bool; 2],
    now: Instant,
}

impl Stage {
    /// A task that was rehearsed with or without motions. The left robot has a reference, and stands at `found`, rad of
    /// the motors, at these switchings-on.
    fn of(program: &Program, found: &[(usize, Axes)], moved: bool) -> Self {
        let file = Arc::new(two_arms());
        let mut courses: Vec<_> = homes(&file).iter().map(|home| Course::from(home.motors)).collect();
        courses[0].found = found.to_vec();
        let faults = [Arc::default(), Arc::default()];
        let drives = |bus| Box::new(IdealDrives::of(&file, bus, &courses, &faults)) as Box<dyn DriveGroup>;
        let (mut servo, links) = Servo::new(&setup::servo_config(&file), vec![drives(0), drives(1)]).unwrap();
        let rehearsed = Rehearsed {
            duration: None,
            with_scene: None,
            instructions: 8,
            moved: vec![moved; 2],
            refused: None,
            overloads: Vec::new(),
            lags: Vec::new(),
            blocked: Duration::ZERO,
        };
        let task = RunningTask::new(
            &file,
            program,
            links,
            (Vec::new(), Vec::new(), Vec::new(), Vec::new()),
            &servo,
            &rehearsed,
        );
        let ((ask, asked), (answer, verdicts)) = (sync_channel(2), sync_channel(2));
        let carrying = task.begin(Rehearsals::Aside { ask, verdicts });
        let now = lockstep::bring_up(&mut servo, Instant::ZERO, |_| {}).unwrap();
        let (phases, moved) = ([Phase::Off; 2], [false; 2]);
        Self { file, servo, carrying, faults, asked, answers: Some(answer), phases, moved, now }
    }

    /// One cycle. Returns whether the task is under way.
    fn turn(&mut self) -> bool {
        self.servo.step(self.now);
        let busy = self.carrying.poll(self.now, |news| self.phases[news.robot] = news.phase);
        for (moved, phase) in self.moved.iter_mut().zip(self.phases) {
            *moved |= phase == Phase::Moving;
        }
        self.now += self.servo.period();
        busy
    }

    /// Cycles until `what` holds, 20 s at most.
    #[track_caller]
    fn until(&mut self, what: impl Fn(&Self) -> bool) {
        for _ in 0..10_000 {
            assert!(self.turn(), "the task has ended: {:?}", self.phases);
            if what(self) {
                return;
            }
        }
        panic!("waited in vain: {:?}", self.phases);
    }

    /// Cycles until the task has ended, 20 s at most. Returns its errors, and those that the servo still has.
    #[track_caller]
    fn end(mut self) -> (TaskErrors, Vec<FaultReport>) {
        for _ in 0..10_000 {
            if !self.turn() {
                let errors = self.carrying.finish();
                let faults = servo_faults(&self.file, &self.servo, &errors.received);
                return (errors, faults.into_iter().filter(|fault| fault.latched.is_some()).collect());
            }
        }
        panic!("the task does not end: {:?}", self.phases);
    }

    /// The question of a robot that waits for its rehearsal.
    #[track_caller]
    fn question(&mut self) -> running_task::Question {
        for _ in 0..10_000 {
            self.turn();
            if let Ok(question) = self.asked.try_recv() {
                return question;
            }
        }
        panic!("no robot waits: {:?}", self.phases);
    }

    fn answer(&self, robot: usize, verdict: anyhow::Result<()>) {
        self.answers.as_ref().unwrap().send((robot, verdict)).unwrap();
    }

    fn fault(&self, robot: usize) {
        self.faults[robot].store(true, Ordering::Relaxed);
    }
}

/// Motor positions, rad, of the left arm beside its home position.
fn away() -> Axes {
    let mut motors = homes(&two_arms())[0].motors;
    motors[0] += 10.0;
    motors
}

const fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

/// A motion of the column to `angle`, rad.
fn turn(robot: &Robot, angle: f64) -> Newsmooth {
    robot.motions().joints(0.3, &[[angle, -1.571, 0.0, 0.0, 0.0]]).unwrap()
}

/// Both robots home and move.
async fn both(cell: &mut Cell) -> Outcome {
    let [mut left, mut right] = cell.robots(["left", "right"])?;
    let list = |robot: &Robot| Task::new().enable().home().run(turn(robot, 0.2)).disable();
    let (one, other) = (list(&left), list(&right));
    join(left.perform(one), right.perform(other)).await
}

/// Runs [`both`] with the left robot away from home. As soon as the right robot is off, the rehearsal gives `verdict`,
/// or its thread ends. Returns the errors, and whether the left robot moved before and in total.
fn away_from_home(verdict: Option<anyhow::Result<()>>) -> (TaskErrors, [bool; 2]) {
    let mut stage = Stage::of(&Program::of(both), &[(0, away())], true);
    let (robot, courses) = stage.question();
    assert_eq!((robot, &courses[0].found[..], courses[1].found.len()), (0, &[(0, away())][..], 0));
    stage.until(|stage| stage.moved[1] && stage.phases[1] == Phase::Off);
    let before = stage.moved[0];
    match verdict {
        Some(verdict) => stage.answer(robot, verdict),
        None => stage.answers = None,
    }
    let mut moved = before;
    for _ in 0..10_000 {
        let busy = stage.turn();
        moved |= stage.moved[0];
        if !busy {
            return (stage.carrying.finish(), [before, moved]);
        }
    }
    panic!("the task does not end: {:?}", stage.phases);
}

#[test]
fn a_robot_away_from_home_waits_for_its_rehearsal_and_delays_no_other() {
    let (errors, moved) = away_from_home(Some(Ok(())));
    assert_eq!((errors.faults, moved), (Vec::new(), [false, true]));
    let (errors, moved) = away_from_home(Some(Err(anyhow!("a line is impossible"))));
    assert_eq!((errors.faults.len(), moved), (1, [false, false]));
    assert!(errors.faults[0].what.ends_with("from where a line is impossible"), "{:?}", errors.faults);
}

#[test]
fn the_end_of_the_thread_of_rehearsals_refuses_a_robot_that_waits() {
    let (errors, moved) = away_from_home(None);
    assert_eq!((errors.faults.len(), moved), (1, [false, false]));
    let what = &errors.faults[0].what;
    assert!(what.ends_with("the thread of the rehearsals has ended"), "{what}");
}

#[test]
fn a_motion_without_homing_is_rehearsed_from_where_the_robot_stands() {
    let program = Program::of(async |cell: &mut Cell| {
        let mut left = cell.robot("left")?;
        left.enable().await?;
        left.execute(turn(&left, 0.2)).await?;
        if cell.rehearsing() { Err(anyhow!("refused as the test asks").into()) } else { Ok(()) }
    });
    // Where the robot stands is not known yet.
    let rehearsed = rehearse(&two_arms(), &program).unwrap();
    assert_eq!(rehearsed.moved, [false; 2]);
    // Even a robot at home was not rehearsed.
    for start in [away(), homes(&two_arms())[0].motors] {
        let mut stage = Stage::of(&program, &[(0, start)], false);
        let (robot, courses) = stage.question();
        assert_eq!((robot, &courses[0].found[..]), (0, &[(0, start)][..]));
        let refusal = rehearse_again(&stage.file, &program, courses, &Arc::default());
        let said = refusal.as_ref().unwrap_err().to_string();
        assert!(said.starts_with("refused as the test asks (in the rehearsal, "), "{said}");
        stage.answer(robot, refusal);
        assert!(!stage.moved[0]);
        let (errors, _) = stage.end();
        assert!(
            errors.faults[0].what.contains("from where refused as the test asks (in the rehearsal"),
            "{:?}",
            errors.faults
        );
    }
}

/// Repeats a motion after a fault, and notes the motor positions, rad, before it: in rehearsals, and in the run.
fn recovering() -> (Program, Arc<Mutex<[Vec<f64>; 2]>>) {
    let notes = Arc::new(Mutex::new([Vec::new(), Vec::new()]));
    let noted = Arc::clone(&notes);
    let program = Program::of(async move |cell: &mut Cell| {
        let mut left = cell.robot("left")?;
        left.perform(Task::new().enable().home()).await?;
        if left.execute(turn(&left, 0.2)).await.is_err() {
            left.perform(Task::new().reset_fault().enable()).await?;
            let column = left.image()?.commanded.joints.position[0];
            noted.lock().unwrap()[usize::from(!cell.rehearsing())].push(column);
            left.execute(turn(&left, 0.1)).await?;
        }
        Ok(())
    });
    (program, notes)
}

#[test]
fn after_a_fault_the_task_is_rehearsed_with_the_fault_and_the_new_position() {
    let (program, notes) = recovering();
    let mut stage = Stage::of(&program, &[(1, away())], true);
    stage.until(|stage| stage.phases[0] == Phase::Moving);
    stage.fault(0);
    stage.until(|stage| stage.phases[0] == Phase::Faulted);
    stage.moved[0] = false;
    let (robot, courses) = stage.question();
    assert_eq!((robot, &courses[0].found[..], &courses[0].faults[..]), (0, &[(1, away())][..], &[2][..]));
    for _ in 0..100 {
        stage.turn();
    }
    assert!(!stage.moved[0], "the robot waits for its rehearsal");
    stage.answer(robot, rehearse_again(&stage.file, &program, courses, &Arc::default()));
    let (errors, _) = stage.end();
    assert_eq!((errors.faults, errors.recovered.len()), (Vec::new(), 1));
    let [rehearsed, ran] = notes.lock().unwrap().clone();
    assert_eq!((rehearsed.len(), &rehearsed), (1, &ran));
}

#[test]
fn a_robot_that_was_off_and_did_not_move_is_not_rehearsed_again() {
    let program = Program::of(async |cell: &mut Cell| {
        let mut left = cell.robot("left")?;
        let motion = |angle| Task::new().enable().home().run(turn(&left, angle)).disable();
        let [one, other] = [0.2, 0.1].map(motion);
        left.perform(one).await?;
        left.perform(other).await
    });
    let stage = Stage::of(&program, &[], true);
    let (errors, faults) = stage.end();
    assert_eq!((errors.faults, faults), (Vec::new(), Vec::new()));
}

#[test]
fn a_rehearsal_with_a_generator_that_panics_is_refused() {
    /// Panics in a step, or when the macrostep is asked for.
    struct Panics {
        in_step: bool,
    }
    impl Generator for Panics {
        type First = ();
        type Every = ();
        type Out = ();
        type Memory = ();

        fn pace(&self, cell: Pace) -> Pace {
            assert!(self.in_step, "as the test asks");
            cell
        }
        fn first_step(&mut self, (): &(), _: Duration) -> Result<Next<()>, GeneratorError> {
            Ok(Next::remember(()))
        }
        fn terminal(&self, (): &(), (): &()) -> bool {
            false
        }
        fn next_step(&self, (): &(), (): &()) -> Result<Next<()>, GeneratorError> {
            panic!("as the test asks")
        }
    }
    for (in_step, said) in [
        (true, "robot left: instruction 3 of its task: step 0: the step panicked"),
        (false, "the rehearsal panicked: as the test asks"),
    ] {
        let program = Program::of(async move |cell: &mut Cell| {
            let mut left = cell.robot("left")?;
            left.perform(Task::new().enable().home().run(Panics { in_step })).await
        });
        let refusal = rehearse(&two_arms(), &program).unwrap_err();
        assert!(refusal.to_string().starts_with(said), "{refusal}");
        assert_eq!(refusal.to_string().contains("(in the rehearsal, "), in_step, "{refusal}");
    }
}

/// Drops a motion of the left robot while the robot moves, and then waits. Resets the fault of the robot if `resets`.
fn dropping(resets: bool) -> Program {
    Program::of(async move |cell: &mut Cell| {
        let mut left = cell.robot("left")?;
        left.perform(Task::new().enable().home()).await?;
        {
            let motion = turn(&left, 1.0);
            let (mut motion, mut sleep) = (pin!(left.execute(motion)), pin!(cell.sleep(ms(600))));
            std::future::poll_fn(|context| {
                assert!(motion.as_mut().poll(context).is_pending());
                sleep.as_mut().poll(context)
            })
            .await;
        }
        cell.sleep(ms(2000)).await;
        if resets { left.reset_fault().await } else { Ok(()) }
    })
}

#[test]
fn a_fault_in_the_stop_of_a_dropped_motion_is_reported_once_with_its_place() {
    for resets in [false, true] {
        let mut stage = Stage::of(&dropping(resets), &[], true);
        stage.until(|stage| stage.phases[0] == Phase::Stopping);
        stage.fault(0);
        let (TaskErrors { faults, recovered, .. }, of_servo) = stage.end();
        let (reported, other) = if resets { (recovered, faults) } else { (faults, recovered) };
        assert_eq!((reported.len(), other), (1, Vec::new()), "{resets}");
        assert_eq!(reported[0].place.map(|place| place.instruction), Some(2));
        assert!(of_servo.iter().all(|fault| fault.is_same(&reported[0])), "{of_servo:?}");
        assert_eq!(of_servo.len(), usize::from(!resets));
    }
}

#[test]
fn a_second_fault_equal_to_a_handled_one_is_reported() {
    let program = Program::of(async |cell: &mut Cell| {
        let mut left = cell.robot("left")?;
        left.perform(Task::new().enable().home()).await?;
        left.execute(turn(&left, 0.5)).await.unwrap_err();
        left.perform(Task::new().reset_fault().enable()).await?;
        cell.sleep(ms(1000)).await;
        Ok(())
    });
    for second in [false, true] {
        let mut stage = Stage::of(&program, &[], true);
        stage.until(|stage| stage.phases[0] == Phase::Moving);
        stage.fault(0);
        stage.until(|stage| stage.phases[0] == Phase::Faulted);
        stage.until(|stage| stage.phases[0] == Phase::Standing);
        if second {
            stage.fault(0);
        }
        let (errors, of_servo) = stage.end();
        assert_eq!((errors.faults.len(), errors.recovered.len()), (0, 1));
        assert_eq!(of_servo.len(), usize::from(second), "{of_servo:?}");
        assert!(of_servo.iter().all(|fault| fault.is_same(&errors.recovered[0])), "{of_servo:?}");
    }
}

#[test]
fn errors_of_two_robots_in_one_turn_are_reported_with_their_places() {
    let mut stage = Stage::of(&Program::of(both), &[], true);
    stage.until(|stage| stage.phases == [Phase::Moving; 2]);
    stage.fault(0);
    stage.fault(1);
    let (errors, of_servo) = stage.end();
    let places: Vec<_> = errors.faults.iter().map(|fault| (fault.robot.as_deref(), fault.place.is_some())).collect();
    assert_eq!(places, [(Some("left"), true), (Some("right"), true)]);
    assert!(of_servo.iter().all(|fault| errors.faults.iter().any(|known| known.is_same(fault))), "{of_servo:?}");
}

#[test]
fn a_fault_of_an_io_node_is_a_fault_of_the_run() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/irb6-touch.toml");
    let file = CellFile::read(&path).unwrap();
    let port = Box::new(can::virtual_port(16).0) as Box<dyn can::Port>;
    let devices = setup::devices(&file, vec![port], Vec::new(), Vec::new(), None).unwrap();
    let faults: Vec<_> = io_faults(&file, &devices.io).map(|fault| fault.what).collect();
    assert_eq!(faults, ["I/O node tool: node 40: I/O not started"]);
    let (_, rehearsed) = setup::rehearsed_io(&file);
    assert_eq!(io_faults(&file, &rehearsed).count(), 0);
}

#[test]
fn contacts_that_were_not_solved_are_a_fault_of_the_run() {
    assert!(of_contacts(0).is_none());
    let fault = of_contacts(3).expect("a fault");
    assert!(fault.what.starts_with("emulated contacts are wrong in 3 parts of steps: "), "{}", fault.what);
}
