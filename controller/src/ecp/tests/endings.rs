//! Ends of motions: at standstill, almost at standstill, and in motion.

use super::*;

/// Moves joint 0 by `distance`, m, within 50 macrosteps, and ends with a velocity, m/s.
pub(super) struct Ramp {
    pub(super) distance: f64,
    pub(super) last: f64,
}

impl Generator for Ramp {
    type First = ();
    type Every = ();
    type Out = ();
    type Memory = u32;

    fn first_step(&mut self, _: &(), _: Duration) -> Result<Next<u32>, GeneratorError> {
        Ok(Next::remember(0))
    }
    fn terminal(&self, step: &u32, _: &()) -> bool {
        *step == 50
    }
    fn next_step(&self, step: &u32, _: &()) -> Result<Next<u32>, GeneratorError> {
        let velocity = self.distance / (50.0 * (10 * PERIOD).as_secs_f64());
        let position = axis_0(self.distance * f64::from(step + 1) / 50.0);
        let joints = AxesState::new(position, axis_0(if *step == 49 { self.last } else { velocity }));
        Ok(Next::command(Setpoint::Joints(joints), step + 1))
    }
}

#[test]
fn a_generator_that_ends_in_motion_is_braked_in_its_last_macrostep() {
    for last in [0.0, -2.4e-16, 0.02] {
        let mut bench = Bench::ready();
        let ramp = Ramp { distance: 0.02, last };
        assert_eq!(bench.run(Task::new().run(ramp)), finished(1), "{last}");
        assert_eq!(bench.servo.moves().count(), 50, "{last}");
        let braked = bench.servo.log.last() == Some(&Order::Stop);
        assert_eq!(braked, last > 1e-3, "{last}");
        let stood = bench.servo.report.snapshot.commanded[0];
        // A stop takes effect within the last macrostep, which is 0.04 rad long.
        assert!((stood - 2.0).abs() < 0.05, "{last}: {stood}");
    }
}

#[test]
fn a_stop_while_the_end_of_a_motion_is_braked_drops_the_rest() {
    let mut bench = Bench::ready();
    let ramp = Ramp { distance: 0.02, last: 0.02 };
    let task = Task::new().run(ramp).run(to(1.0, 0.0, 0.0));
    bench.ecp.execute(task).unwrap();
    let events = bench.go_on(|bench| {
        if matches!(bench.ecp.activity, Activity::Stopping { .. }) {
            bench.ecp.stop();
        }
    });
    assert_eq!(events, failed(EcpError::Stopped));
    assert_eq!(bench.servo.moves().count(), 50);
}

#[test]
fn the_task_ends_a_motion_at_once_although_all_macrosteps_are_sent() {
    use crate::coordination::{Late, LinkConfig, link};
    let mut bench = Bench::ready();
    let config = LinkConfig { blocking: false, deadline: Duration::ZERO, late: Late::Hold };
    let (mut task, member) = link::<(), ()>(config);
    bench.ecp.follow_task(Box::new(member));
    // The effector first moves away and then, after the end, elsewhere.
    bench.ecp.execute(Task::new().run(to(0.5, 0.0, 0.0)).run(to(0.4, 0.0, 0.0))).unwrap();
    let mut stood = None;
    let mut cycles = 0;
    let events = bench.go_on(|bench| {
        cycles += 1;
        if cycles == 60 {
            assert!(task.end_motion(bench.now));
        }
        if bench.ecp.status().instruction == Some(1) {
            stood.get_or_insert(bench.servo.report.snapshot.commanded[0]);
        }
    });
    assert_eq!(events, finished(2));
    let stood = stood.unwrap();
    assert!(stood > 0.0 && stood < 40.0, "{stood}");
    assert_eq!(bench.servo.report.snapshot.commanded[0], 40.0);
}
