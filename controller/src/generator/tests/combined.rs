//! Combinations of generators: selection, weighted sum, and generators that declare more images.

use std::sync::Arc;

use super::*;
use crate::robot::{Arm, Irb6, Irb6Parameters};

const LIMITS: MotionLimits = MotionLimits::uniform(1.0, 5.0, 50.0);

fn arm() -> Arm {
    Arm::new(Arc::new(Irb6::new(&Irb6Parameters::irb6()).unwrap()), Pose::identity())
}

/// Where the arm stands.
fn home() -> Axes {
    arm().joints(&arm().robot().home().padded()).unwrap()
}

/// Column at this position, the other joints at home.
fn column(position: f64) -> Axes {
    let mut joints = home();
    joints[0] = position;
    joints
}

/// Accelerates the column to a velocity, rad/s, from the commanded state. Ends after a number of steps.
struct Drift {
    velocity: f64,
    steps: u32,
}

impl Generator for Drift {
    type First = EffectorImage;
    type Every = EffectorImage;
    type Out = ();
    type Memory = u32;

    fn begins_in_motion(&self) -> bool {
        true
    }
    fn first_step(&mut self, _: &EffectorImage, _: Duration) -> Result<Next<u32>, GeneratorError> {
        Ok(Next::remember(0))
    }
    fn terminal(&self, done: &u32, _: &EffectorImage) -> bool {
        *done == self.steps
    }
    fn next_step(&self, done: &u32, e: &EffectorImage) -> Result<Next<u32>, GeneratorError> {
        let most = LIMITS.max_acceleration[0] * MC;
        let before = e.commanded.joints.velocity[0];
        let mut state = e.commanded.joints;
        state.velocity[0] += (self.velocity - before).clamp(-most, most);
        state.position[0] += MC * (before + state.velocity[0]) / 2.0;
        Ok(Next::command(Setpoint::Joints(state), done + 1))
    }
}

/// The states of a generator on an effector that follows exactly, and the result of the motion.
fn followed(generator: impl Generator) -> (Vec<AxesState>, Result<(), GeneratorError>) {
    let (mut run, mut partners) = (Run::new(generator), Standing::at(home()));
    assert_eq!(begin(&mut run, &mut partners, MACROSTEP), Ok(Step::Continue(EffectorCommand::default())));
    let mut states = vec![partners.0];
    loop {
        match run.next_step(&mut partners) {
            Ok(Step::Continue(EffectorCommand { setpoint: Some(Setpoint::Joints(state)), .. })) => partners.0 = state,
            Ok(Step::Continue(EffectorCommand { setpoint: None, .. })) => {
                partners.0 = AxesState::at_rest(partners.0.position);
            }
            Ok(Step::Continue(other)) => panic!("{other:?}"),
            Ok(Step::Ended) => return (states, Ok(())),
            Err(error) => return (states, Err(error)),
        }
        states.push(partners.0);
    }
}

#[test]
fn a_selection_runs_one_generator_at_a_time_and_keeps_the_memory_of_the_other() {
    let out = Drift { velocity: 0.5, steps: 100 };
    let back = Drift { velocity: -0.5, steps: 1000 };
    // Out to 0.2 rad, back for 30 steps, and out again to the end.
    let motion =
        Selection::between(arm(), LIMITS, out, back, |memory: &SelectionMemory<u32, u32>, e: &EffectorImage| {
            match memory.selected {
                Selected::First if memory.second == 0 && e.commanded.joints.position[0] > 0.2 => Selected::Second,
                Selected::Second if memory.steps == 30 => Selected::First,
                stays => stays,
            }
        });
    let motion = motion.unwrap();
    assert!(motion.begins_in_motion());
    let (states, end) = followed(motion);
    assert_eq!((states.len() - 1, end), (130, Ok(())));
    let turn = states.iter().position(|state| state.position[0] > 0.2).unwrap();
    assert!(states[turn].velocity[0] == 0.5 && states[turn + 30].velocity[0] == -0.5);
    for pair in states.windows(2) {
        assert!((pair[1].velocity[0] - pair[0].velocity[0]).abs() <= 0.1 + 1e-9, "{pair:?}");
    }
}

#[test]
fn a_selected_generator_that_does_not_continue_the_motion_is_refused_before_its_set_point_is_sent() {
    let selects = |memory: &SelectionMemory<u32, _>, _: &EffectorImage| match memory.first {
        20.. => Selected::Second,
        _ => Selected::First,
    };
    let drift = || Drift { velocity: 0.5, steps: 100 };
    // A plan from the start, the standstill from motion, and a set-point of the motors.
    let planned = Newsmooth::new(Space::Joint, 5, LIMITS, vec![SmoothPose::fast(column(1.0))]).unwrap();
    let planned = Selection::between(arm(), LIMITS, drift(), WithImages::of(planned), {
        move |memory: &SelectionMemory<u32, Progress>, e: &EffectorImage| {
            selects(&SelectionMemory { selected: memory.selected, steps: 0, first: memory.first, second: 0_u8 }, e)
        }
    });
    let (states, end) = followed(planned.unwrap());
    assert_eq!(states.len() - 1, 20);
    assert!(matches!(end, Err(GeneratorError::Switch { axis: 0, commanded: 0.5, .. })), "{end:?}");

    let wait = WithImages::<_, EffectorImage, EffectorImage>::of(Wait { duration: Duration::from_secs(1) });
    let stands = Selection::between(arm(), LIMITS, drift(), wait, |memory: &SelectionMemory<u32, u64>, _: &_| {
        if memory.first < 20 { Selected::First } else { Selected::Second }
    });
    let (_, end) = followed(stands.unwrap());
    assert_eq!(end, Err(GeneratorError::Switch { axis: 0, needed: 0.0, commanded: 0.5 }));
}

#[test]
fn a_selected_wait_at_rest_ends_the_selection_after_its_time() {
    let wait = WithImages::of(Wait { duration: MACROSTEP * 7 });
    let motion = Selection::between(
        arm(),
        LIMITS,
        Drift { velocity: 0.0, steps: 100 },
        wait,
        |memory: &SelectionMemory<u32, u64>, _: &EffectorImage| match memory.first {
            3.. => Selected::Second,
            _ => Selected::First,
        },
    );
    let (states, end) = followed(motion.unwrap());
    assert_eq!((states.len() - 1, end), (10, Ok(())));
}

#[test]
fn a_generator_with_images_has_the_class_of_what_it_declares() {
    struct Count(std::cell::Cell<usize>);
    impl Partners for Count {
        fn effector(&self) -> Result<EffectorImage, GeneratorError> {
            self.0.set(self.0.get() + 1);
            Standing::at([0.0; 8]).effector()
        }
    }
    let wait = WithImages::<_, (), EffectorImage>::of(Wait { duration: MACROSTEP * 2 });
    let mut run = Run::new(wait);
    let Description { first, every, .. } = run.description();
    assert_eq!((first, every), (0, 1));
    let mut partners = Count(std::cell::Cell::new(0));
    assert_eq!(begin(&mut run, &mut partners, MACROSTEP), Ok(Step::Continue(EffectorCommand::default())));
    while run.next_step(&mut partners).unwrap() != Step::Ended {}
    assert_eq!(partners.0.get(), 3);
    assert_eq!(run.macrosteps_ahead(100), 1);
}

#[test]
fn a_weighted_sum_keeps_the_limits_of_both_generators_and_ends_between_their_ends() {
    for seed in 0..2_000 {
        let mut random = Random(seed);
        let axes = 1 + random.below(6);
        let limits = random_limits(&mut random);
        let (start, one, other) = (random.axes(-2.0, 2.0), random.axes(-2.0, 2.0), random.axes(-2.0, 2.0));
        let weight = random.within(0.0, 1.0);
        let first = JerkLimited::new(Space::Joint, axes, limits, &[one]).unwrap();
        let second = Polynomial::quintic(Space::Joint, axes, limits, other).unwrap();
        let sum = WeightedSum::new(Space::Joint, first, second, weight).unwrap();
        let states = walk(sum, &Standing::at(start)).unwrap();
        for pair in states.windows(2) {
            for axis in 0..axes {
                let (v, a) = (limits.max_velocity[axis], limits.max_acceleration[axis]);
                let (from, to) = (knot(&pair[0], axis), knot(&pair[1], axis));
                assert!(to.velocity.abs() <= v * (1.0 + 1e-9), "seed {seed}");
                assert!((to.velocity - from.velocity).abs() <= a * MC * (1.0 + 1e-9) + 1e-9, "seed {seed}");
                assert!(peaks(from, to).1 <= 1.7 * a, "seed {seed}");
            }
        }
        let end = states[states.len() - 1];
        assert_eq!(end.velocity, Axes::default(), "seed {seed}");
        for axis in 0..axes {
            let between = one[axis] + weight * (other[axis] - one[axis]);
            assert!((end.position[axis] - between).abs() < 1e-12, "seed {seed}");
        }
    }
}

#[test]
fn a_changing_weight_leads_from_one_motion_to_the_other_with_true_derivatives() {
    let quintic = |target: f64, seconds: f64| {
        let motion = Polynomial::quintic(Space::Joint, 1, LIMITS, [target; 8]).unwrap();
        motion.lasting(Duration::from_secs_f64(seconds))
    };
    // The change ends before the motions, between their ends, and after the motions.
    for change in [1.0, 3.5, 6.0] {
        let sum = WeightedSum::new(Space::Joint, quintic(1.0, 3.0), quintic(-1.0, 4.0), 0.0).unwrap();
        let sum = sum.changing_to(1.0, Duration::from_secs_f64(change)).unwrap();
        let states = walk(sum, &Standing::at([0.0; 8])).unwrap();
        assert_eq!(states.len() - 1, (change.max(4.0) / MC).round() as usize);
        for pair in states.windows(2) {
            let (from, to) = (knot(&pair[0], 0), knot(&pair[1], 0));
            let way = MC * (from.velocity + to.velocity) / 2.0 - MC * MC * (to.acceleration - from.acceleration) / 12.0;
            assert!((to.position - from.position - way).abs() < 1e-6, "{change} s: {from:?} {to:?}");
            let gain = MC * (from.acceleration + to.acceleration) / 2.0;
            assert!((to.velocity - from.velocity - gain).abs() < 2e-4, "{change} s: {from:?} {to:?}");
        }
        let end = states[states.len() - 1];
        assert_eq!((end.position[0], end.velocity[0]), (-1.0, 0.0), "{change} s");
    }
}

#[test]
fn a_sum_without_a_meaning_is_refused() {
    let to = |space| JerkLimited::new(space, 1, LIMITS, &[[1.0; 8]]).unwrap();
    for weight in [f64::NAN, -0.1, 1.1] {
        let refused = WeightedSum::new(Space::Joint, to(Space::Joint), to(Space::Joint), weight).unwrap_err();
        assert!(matches!(refused, GeneratorError::Weight { .. }), "{refused}");
    }
    let start = Standing::at([0.0; 8]);
    let mixed = WeightedSum::new(Space::Joint, to(Space::Joint), to(Space::Motor), 0.5).unwrap();
    assert_eq!(walk(mixed, &start), Err(GeneratorError::NotAdded));
    let early = to(Space::Joint).ending_at([0.5; 8]).unwrap();
    let long = to(Space::Joint).lasting(Duration::from_secs(10));
    let early = WeightedSum::new(Space::Joint, early, long, 0.5).unwrap();
    assert_eq!(walk(early, &start), Err(GeneratorError::EndedInMotion));
    // Two motions that end in motion together are a sum that ends in motion.
    let ending = || to(Space::Joint).ending_at([0.5; 8]).unwrap();
    let both = walk(WeightedSum::new(Space::Joint, ending(), ending(), 0.5).unwrap(), &start).unwrap();
    assert!((both[both.len() - 1].velocity[0] - 0.5).abs() < 1e-9);
}

#[test]
fn a_combination_does_not_drop_the_force_law_of_a_part() {
    use crate::law::{ForceTask, Guard};
    let guard = ForceTask { guard: Some(Guard { force: 5.0, torque: 1.0, samples: 1 }), ..ForceTask::default() };
    let refused = |mut run: Box<dyn Execution>| {
        let mut partners = Standing::at(home());
        run.initiate(&partners).unwrap();
        let begun = run.plan(MACROSTEP).and_then(|()| run.commit(&mut partners));
        begun.and_then(|_| run.next_step(&mut partners)).err()
    };
    let drift = || Drift { velocity: 0.1, steps: 3 };
    let sum = WeightedSum::new(Space::Joint, drift().under(guard), drift(), 0.5).unwrap();
    assert_eq!(refused(Box::new(Run::new(sum))), Some(GeneratorError::LawOfPart));
    let first = |_: &SelectionMemory<_, _>, _: &EffectorImage| Selected::First;
    let one = Selection::between(arm(), LIMITS, drift().under(guard), drift(), first).unwrap();
    assert_eq!(refused(Box::new(Run::new(one))), Some(GeneratorError::LawOfPart));
    let both = Selection::between(arm(), LIMITS, drift().under(guard), drift().under(guard), first).unwrap();
    assert_eq!(refused(Box::new(Run::new(both))), None);
}
