//! Ends of motions: at standstill, almost at standstill, and in motion.

use super::*;

/// Moves joint 0 by `distance`, m, within 50 macrosteps, and ends with a velocity, m/s.
struct Ramp {
    distance: f64,
    last: f64,
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
