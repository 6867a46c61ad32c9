//! Generators that choose their macrostep.

use super::*;

/// Moves axis 0 by 1 mm in each of 50 macrosteps of its own length, and reads the effector in every one.
struct Creep(Pace);

impl Generator for Creep {
    type First = ();
    type Every = EffectorImage;
    type Out = ();
    type Memory = u32;

    fn pace(&self, cell: Pace) -> Pace {
        assert_eq!(cell, CONFIG.pace);
        self.0
    }

    fn first_step(&mut self, _: &(), macrostep: Duration) -> Result<Next<u32>, GeneratorError> {
        assert_eq!(macrostep, PERIOD * u32::from(self.0.periods));
        Ok(Next::remember(0))
    }

    fn terminal(&self, steps: &u32, _: &EffectorImage) -> bool {
        *steps == 50
    }

    fn next_step(&self, steps: &u32, e: &EffectorImage) -> Result<Next<u32>, GeneratorError> {
        // The image is of the macrostep before.
        assert_eq!(e.macrostep, u64::from(*steps));
        Ok(Next::command(Setpoint::JointsBy(AxesState::at_rest(axis_0(1e-3))), steps + 1))
    }
}

#[test]
fn a_generator_chooses_its_macrostep_also_of_one_period_and_the_next_one_has_that_of_the_cell() {
    for pace in [Pace { periods: 1, read_at: 1 }, Pace { periods: 4, read_at: 3 }] {
        let mut bench = Bench::ready();
        let begun = bench.now;
        assert_eq!(bench.run(Task::new().run(Creep(pace))), finished(1));
        let moves: Vec<_> = bench.servo.moves().copied().collect();
        assert_eq!(moves.len(), 50);
        assert!(moves.iter().all(|it| (it.steps, it.report_at) == (pace.periods, pace.read_at)));
        // A macrostep begins in the period after the last one.
        assert!(bench.now.since(begun) <= PERIOD * (50 * u32::from(pace.periods) + 2), "{pace:?}");
        assert_eq!(bench.run(Task::new().run(to(0.1, 0.0, 0.0))), finished(1));
        assert!(bench.servo.moves().skip(50).all(|it| (it.steps, it.report_at) == (10, 8)));
    }
}

#[test]
fn a_macrostep_without_periods_or_with_its_images_outside_is_refused() {
    for (periods, read_at) in [(0, 0), (0, 1), (3, 0), (3, 4), (1001, 1)] {
        let mut bench = Bench::ready();
        let events = bench.run(Task::new().run(Creep(Pace { periods, read_at })));
        let error = GeneratorError::Pace { periods, read_at };
        assert_eq!(events, failed(EcpError::Generator { step: 0, error }));
        assert_eq!(bench.servo.moves().count(), 0);
    }
}
