//! Two transparent arms that move as their coordinator orders, and orders that cannot be followed.

use super::*;

/// Macrosteps of the motion.
const STEPS: u32 = 100;

/// Turns both columns by the same angle in opposite directions, by a quintic from where the arms stand.
struct Mirror {
    angle: f64,
    /// The step whose order has a velocity that is not a number.
    broken: Option<u32>,
    macrostep: f64,
}

/// Number of the step, and where the arms stood in the first answers.
#[derive(Clone, Copy, Debug)]
struct Progress {
    step: u32,
    start: Option<[[f64; 8]; 2]>,
}

impl Coordinator<2> for Mirror {
    type Order = Option<Setpoint>;
    type Answer = EffectorImage;
    type Sensors = ();
    type Out = ();
    type Memory = Progress;

    fn first_step(&mut self, (): &(), macrostep: Duration) -> Result<Orders<Self, 2>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        Ok(NextOrders::new([None; 2], Progress { step: 0, start: None }))
    }

    fn terminal(&self, memory: &Progress, _: &[Sample<EffectorImage>; 2], (): &()) -> bool {
        memory.step == STEPS
    }

    fn next_step(
        &self,
        memory: &Progress,
        answers: &[Sample<EffectorImage>; 2],
        (): &(),
    ) -> Result<Orders<Self, 2>, GeneratorError> {
        let here = || answers.map(|answer| answer.value.commanded.joints.position);
        let start = memory.start.unwrap_or_else(here);
        let step = memory.step + 1;
        let (u, whole) = (f64::from(step) / f64::from(STEPS), f64::from(STEPS) * self.macrostep);
        let order = |arm: usize| {
            let angle = if arm == 0 { self.angle } else { -self.angle };
            let mut state = AxesState::at_rest(start[arm]);
            state.position[0] += angle * u.powi(3) * (10.0 - u * (15.0 - 6.0 * u));
            state.velocity[0] = angle * 30.0 * (u * (1.0 - u)).powi(2) / whole;
            let mut acceleration = [0.0; 8];
            acceleration[0] = angle * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / whole.powi(2);
            if arm == 1 && self.broken == Some(step) {
                state.velocity[0] = f64::NAN;
            }
            Some(Setpoint::Joints(state.accelerating(acceleration)))
        };
        Ok(NextOrders::new([order(0), order(1)], Progress { step, start: Some(start) }))
    }
}

#[test]
fn a_coordinator_drives_two_transparent_arms_from_their_answers() {
    let report = in_lockstep(async |cell: &mut Cell| {
        let [mut left, mut right] = ready(cell).await?;
        let before = [column(&left).0, column(&right).0];
        let mirror = Mirror { angle: 0.3, broken: None, macrostep: 0.0 };
        cell.team([&mut left, &mut right]).execute(mirror, [Transparent; 2]).await?;
        let after = [column(&left), column(&right)];
        assert!((after[0].0 - before[0] - 0.3).abs() < 1e-6, "{before:?} {after:?}");
        assert!((after[1].0 - before[1] + 0.3).abs() < 1e-6, "{before:?} {after:?}");
        assert!(after.iter().all(|(_, velocity)| velocity.abs() < 1e-9), "{after:?}");
        Ok(())
    });
    assert_eq!((report.outcome, report.faults), (RunOutcome::Completed, vec![]));
}

#[test]
fn an_order_that_is_not_finite_stops_both_transparent_arms_and_the_task_may_try_again() {
    let report = in_lockstep(async |cell: &mut Cell| {
        let [mut left, mut right] = ready(cell).await?;
        let mirror = |broken| Mirror { angle: 0.3, broken, macrostep: 0.0 };
        let broken = cell.team([&mut left, &mut right]).execute(mirror(Some(40)), [Transparent; 2]).await.unwrap_err();
        assert_eq!(broken.class(), Class::NonFatal);
        let stopped = [column(&left), column(&right)];
        assert!(stopped.iter().all(|(_, velocity)| *velocity == 0.0), "{stopped:?}");
        // The arms kept their relation.
        assert!((stopped[0].0 + stopped[1].0).abs() < 1e-3, "{stopped:?}");
        assert!(stopped[0].0.abs() > 0.05, "{stopped:?}");
        cell.team([&mut left, &mut right]).execute(mirror(None), [Transparent; 2]).await
    });
    assert_eq!(report.outcome, RunOutcome::Completed, "{report}");
    let named = |fault: &FaultReport| fault.what.contains("the order, axis column: not a finite number");
    assert!(report.faults.is_empty() && report.recovered.iter().any(named), "{report}");
}
