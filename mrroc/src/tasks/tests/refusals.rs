//! Refusals by type, with all robots at rest.

use controller::path::PathError;

use super::*;
use crate::PoseSize;

/// A set-point that is not a number, in the first step.
struct NotANumber;

impl Generator for NotANumber {
    type First = ();
    type Every = ();
    type Out = ();
    type Memory = ();

    fn first_step(&mut self, (): &(), _: Duration) -> Result<Next<()>, GeneratorError> {
        let mut by = AxesState::default();
        by.position[3] = f64::NAN;
        Ok(Next::command(Setpoint::JointsBy(by), ()))
    }
    fn terminal(&self, (): &(), (): &()) -> bool {
        true
    }
    fn next_step(&self, (): &(), (): &()) -> Result<Next<()>, GeneratorError> {
        Ok(Next::remember(()))
    }
}

#[test]
fn impossible_motions_are_refused_by_type_and_no_robot_moves() {
    let report = in_lockstep(async |cell: &mut Cell| {
        let [mut left, _right] = ready(cell).await?;
        let (start, motions) = (left.image()?.commanded.motors, left.motions());
        let refused = |poses: &[[f64; 5]]| {
            let error = motions.joints(0.3, poses).unwrap_err();
            *error.downcast_ref::<GeneratorError>().expect("the error of a generator")
        };
        assert_eq!(refused(&[]), GeneratorError::NoPoses);
        let lost = [[0.1, -1.571, 0.0, 0.0, 0.0], [0.0, -1.571, 0.0, f64::NAN, 0.0]];
        assert_eq!(refused(&lost), GeneratorError::NotFinite { pose: 1, axis: 3 });
        let short = motions.joints(0.3, &[[0.1; 3]]).unwrap_err();
        assert_eq!(short.downcast_ref(), Some(&PoseSize { given: 3, axes: 5 }));
        let knots = BSpline::<2>::new(vec![0.0; 7], vec![[0.0; 2].into(); 4]).unwrap_err();
        assert!(matches!(knots, PathError::KnotCount { given: 7, controls: 4, needed: 8 }), "{knots}");

        let to = |column| [column, -1.571, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let jerk_limited = JerkLimited::new(Space::Joint, 5, motions.limits(), &[to(0.2)])?.lasting(Duration::ZERO);
        let quintic = Polynomial::quintic(Space::Joint, 5, motions.limits(), to(0.2))?.lasting(Duration::ZERO);
        let high = Pose::translation(0.0, 0.0, 9.0);
        let limits = LineLimits {
            max_velocity: 0.1,
            max_acceleration: 0.5,
            max_jerk: 5.0,
            max_angular_velocity: 0.5,
            max_angular_acceleration: 2.0,
            max_angular_jerk: 20.0,
        };
        let line = StraightLine::new(motions.arm().clone(), high, limits, motions.limits())?;
        let errors = [
            left.execute(jerk_limited).await,
            left.execute(quintic).await,
            left.execute(line).await,
            left.execute(NotANumber).await,
        ];
        let causes = errors.map(|error| error.unwrap_err().instruction().expect("an error of an instruction").cause);
        assert!(
            matches!(
                causes,
                [
                    EcpError::Generator { step: 0, error: GeneratorError::TooShort { given: 0.0, .. } },
                    EcpError::Generator { step: 0, error: GeneratorError::TooShort { given: 0.0, .. } },
                    EcpError::Generator { step: 0, error: GeneratorError::Path { .. } },
                    EcpError::NotFinite { step: 0, axis: 3 },
                ]
            ),
            "{causes:?}"
        );
        assert_eq!(left.image()?.commanded.motors, start);
        Ok(())
    });
    assert_eq!((report.outcome, report.recovered.len()), (RunOutcome::Completed, 4), "{report}");
    assert!(report.recovered.iter().all(|error| error.place.unwrap().class == Class::NonFatal), "{report}");
}

#[test]
fn a_pose_out_of_reach_in_the_middle_of_a_path_is_refused_before_any_robot_moves() {
    let said = refused(async |cell: &mut Cell| {
        let [mut left, _right] = ready(cell).await?;
        let [there, beyond, back] = [-1.6, 0.5, -1.571].map(|lower| [0.0, lower, 0.0, 0.0, 0.0]);
        let path = left.motions().joints(0.3, &[there, beyond, back])?;
        left.execute(path).await
    });
    assert!(said.starts_with("robot left: instruction 3 of its task: step "), "{said}");
    assert!(said.contains("axis lower-arm: motor at "), "{said}");
    let lacks = "(in the rehearsal, which has ideal drives, no contact, and no objects before the sensors)";
    assert!(said.ends_with(lacks), "{said}");
}

#[test]
fn a_task_that_blocks_is_told_in_the_rehearsal() {
    let begun = Arc::new(AtomicU32::new(0));
    let task = async move |_: &mut Cell| {
        if begun.fetch_add(1, Ordering::Relaxed) == 0 {
            let (_sender, nothing) = std::sync::mpsc::channel::<()>();
            // A wait that is no future of the library.
            let _ = nothing.recv_timeout(ms(1_000));
        }
        Ok(())
    };
    let rehearsed = rehearse(&two_arms(), &Program::of(task)).unwrap();
    assert!((ms(600)..ms(5_000)).contains(&rehearsed.blocked), "{:?}", rehearsed.blocked);
    let told = crate::rehearsal::told_of_blocking(rehearsed.blocked).unwrap();
    assert!(told.contains("blocked for ") && told.contains("await cell.sleep"), "{told}");
    let quiet = rehearse(&two_arms(), &Program::of(async |_: &mut Cell| Ok(()))).unwrap();
    assert_eq!(crate::rehearsal::told_of_blocking(quiet.blocked), None);
}

/// Fails in step 20, unless the cell rehearses.
#[derive(Clone, Copy)]
enum Fails {
    Never,
    Panics,
    Hangs,
}

impl Coordinator<2> for Fails {
    type Order = f64;
    type Answer = ();
    type Sensors = ();
    type Out = ();
    type Memory = u32;

    fn first_step(&mut self, (): &(), _: Duration) -> Result<Orders<Self, 2>, GeneratorError> {
        Ok(NextOrders::new([0.0; 2], 0))
    }
    fn terminal(&self, step: &u32, _: &[Sample<()>; 2], (): &()) -> bool {
        *step == 40
    }
    fn next_step(&self, step: &u32, _: &[Sample<()>; 2], (): &()) -> Result<Orders<Self, 2>, GeneratorError> {
        match self {
            Self::Panics => assert!(*step < 20, "as the test asks"),
            Self::Hangs if *step == 20 => loop {
                thread::park();
            },
            Self::Never | Self::Hangs => {}
        }
        Ok(NextOrders::new([1e-3; 2], step + 1))
    }
}

/// Turns the column by the ordered angle in every macrostep.
struct Turn {
    macrostep: f64,
}

impl Generator for Turn {
    type First = ();
    type Every = A<f64>;
    type Out = Answer<()>;
    type Memory = ();

    fn first_step(&mut self, (): &(), macrostep: Duration) -> Result<Next<(), Answer<()>>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        Ok(Next::remember(()).with(Answer(())))
    }
    fn terminal(&self, (): &(), _: &A<f64>) -> bool {
        false
    }
    fn next_step(&self, (): &(), a0: &A<f64>) -> Result<Next<(), Answer<()>>, GeneratorError> {
        let angle = *a0.0.younger_than(ms(100))?;
        let axes = |column: f64| [column, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let by = AxesState::new(axes(angle), axes(angle / self.macrostep));
        Ok(Next::command(Setpoint::JointsBy(by), ()).with(Answer(())))
    }
}

#[test]
fn a_coordinator_that_panics_or_hangs_in_motion_leaves_all_robots_at_rest() {
    let hung = "the task did not return from its turn within 10s";
    for (fails, said) in [(Fails::Panics, "coordinator of a team: step 21: the step panicked"), (Fails::Hangs, hung)] {
        let task = async move |cell: &mut Cell| {
            let [mut left, mut right] = ready(cell).await?;
            let coordinator = if cell.rehearsing() { Fails::Never } else { fails };
            cell.team([&mut left, &mut right]).execute(coordinator, [0, 1].map(|_| Turn { macrostep: 0.0 })).await
        };
        let directory = tempfile::tempdir().unwrap();
        let record = directory.path().join("axes.csv");
        let options = RunOptions { record: Some(record.clone()), ..RunOptions::on(BenchKind::Emulated) };
        let report = crate::run::run(&two_arms(), &options, &Requests::default(), &Program::of(task), &mut |_| {});
        let report = report.unwrap();
        assert_eq!(report.outcome, RunOutcome::Faulted, "{report}");
        assert!(report.faults[0].what.starts_with(said), "{report}");
        let record = fs::read_to_string(record).unwrap();
        assert!(record.contains("right.column,Moving,"), "{said}: nothing moved");
        let last: Vec<_> = record.lines().rev().take(10).map(|row| row.split(',').collect::<Vec<_>>()).collect();
        // The encoder may waver by an increment, which is 0.79 rad/s over a period.
        let rests = |row: &Vec<&str>| row[4] == "Off" && row[8].parse::<f64>().unwrap().abs() < 0.8;
        assert!(last.iter().all(rests), "{last:?}");
    }
}
