//! Properties of the generators over seeded random motions, without an ECP.

mod combined;
mod constant_velocity;
mod contour;
mod feed;
mod limits;
mod line;
mod planned_start;
mod planning_cost;
mod polynomial;
mod time_optimal;
mod transparent;

use std::time::Duration;

use servo::{Knot, quintic};

use super::*;
use crate::random::Random;
use crate::robot::Space;

const MACROSTEP: Duration = Duration::from_millis(20);
const MC: f64 = 0.02;

impl Random {
    fn axes(&mut self, low: f64, high: f64) -> Axes {
        std::array::from_fn(|_| self.within(low, high))
    }

    fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound as u64) as usize
    }
}

/// An image of an effector at standstill with these joints and equal motors.
struct Standing(AxesState, Pose);

impl Standing {
    fn at(position: Axes) -> Self {
        Self(AxesState::at_rest(position), Pose::identity())
    }
}

impl Partners for Standing {
    fn effector(&self) -> Result<EffectorImage, GeneratorError> {
        let state = EffectorState { motors: self.0, joints: self.0, pose: self.1 };
        Ok(EffectorImage::standing(state))
    }
}

/// Executes the first step.
fn begin(run: &mut dyn Execution, partners: &mut dyn Partners, macrostep: Duration) -> Result<Step, GeneratorError> {
    run.initiate(partners)?;
    run.plan(macrostep)?;
    run.commit(partners)
}

/// The states at all macrostep ends, beginning with the start.
fn walk<G: Generator>(generator: G, start: &Standing) -> Result<Vec<AxesState>, GeneratorError> {
    let mut run = Run::new(generator);
    let mut start = Standing(start.0, start.1);
    let mut states = vec![start.0];
    let Step::Continue(EffectorCommand { setpoint: None, .. }) = begin(&mut run, &mut start, MACROSTEP)? else {
        panic!("planned generators ask for nothing at first")
    };
    while let Step::Continue(EffectorCommand { setpoint, .. }) = run.next_step(&mut start)? {
        states.push(match setpoint {
            Some(Setpoint::Joints(state) | Setpoint::Motors(state)) => state,
            other => panic!("{other:?} from a planned generator"),
        });
    }
    Ok(states)
}

/// One axis of a state. The generators of these tests state their accelerations, and begin at rest.
fn knot(state: &AxesState, axis: usize) -> Knot {
    let acceleration = state.acceleration.map_or(0.0, |acceleration| acceleration[axis]);
    Knot { acceleration, ..Knot::new(state.position[axis], state.velocity[axis]) }
}

/// Greatest speed and acceleration of the servo's quintic for a macrostep.
fn peaks(from: Knot, to: Knot) -> (f64, f64) {
    // Most macrosteps are at rest or at constant speed. Their quintic is a line.
    let way = to.position - from.position;
    let bends = [from.acceleration, to.acceleration, to.velocity - from.velocity, way - from.velocity * MC];
    if bends.iter().all(|bend| bend.abs() <= 1e-13) {
        return (from.velocity.abs(), 0.0);
    }
    let at = (0..=16).map(|sixteenth| quintic(from, to, MC, f64::from(sixteenth) / 16.0));
    at.fold((0.0, 0.0), |(speed, push): (f64, f64), knot| {
        (speed.max(knot.velocity.abs()), push.max(knot.acceleration.abs()))
    })
}

fn random_limits(random: &mut Random) -> MotionLimits {
    MotionLimits {
        max_velocity: random.axes(0.2, 2.0),
        max_acceleration: random.axes(1.0, 10.0),
        max_jerk: random.axes(10.0, 200.0),
    }
}

#[test]
fn newsmooth_keeps_its_limits_meets_every_pose_and_never_jumps() {
    let (mut worst_speed, mut worst_push): (f64, f64) = (0.0, 0.0);
    for seed in 0..20_000 {
        let mut random = Random(seed);
        let axes = 1 + random.below(6);
        let limits = random_limits(&mut random);
        let start = random.axes(-2.0, 2.0);
        let mut poses = Vec::new();
        for index in 0..1 + random.below(5) {
            let mut pose = SmoothPose {
                position: random.axes(-2.0, 2.0),
                velocity: random.axes(0.1, 1.0),
                acceleration: random.axes(0.1, 1.0),
            };
            // Axes that rest, and very short distances.
            let last = if index == 0 { start } else { poses.last().map_or(start, |p: &SmoothPose| p.position) };
            for (axis, last) in last.iter().enumerate().take(axes) {
                match random.below(6) {
                    0 => pose.position[axis] = *last,
                    1 => pose.position[axis] = last + random.within(-1e-6, 1e-6),
                    _ => {}
                }
            }
            poses.push(pose);
        }
        let generator = Newsmooth::new(Space::Joint, axes, limits, poses.clone()).unwrap();
        let states = walk(generator, &Standing::at(start)).unwrap();

        let mut next_pose = 0;
        for pair in states.windows(2) {
            // A pose is reached at the end of a macrostep. A pose at zero distance takes no macrostep.
            let met = |pose: &SmoothPose, state: &AxesState| pose.position[..axes] == state.position[..axes];
            while next_pose + 1 < poses.len() && met(&poses[next_pose], &pair[0]) {
                next_pose += 1;
            }
            let pose = &poses[next_pose];
            for axis in 0..axes {
                let a = limits.max_acceleration[axis] * pose.acceleration[axis];
                let v = limits.max_velocity[axis] * pose.velocity[axis];
                let (from, to) = (knot(&pair[0], axis), knot(&pair[1], axis));
                let case = (seed, axis, from, to, v, a);
                let (gain, way) = (to.velocity - from.velocity, to.position - from.position);
                let fastest = v.max(from.velocity.abs());
                assert!(to.velocity.abs() <= v * (1.0 + 1e-7), "speed: {case:?}");
                assert!(gain.abs() <= a * MC * (1.0 + 1e-6) + 1e-12, "acceleration: {case:?}");
                assert!(way.abs() <= fastest * MC * (1.0 + 1e-7) + 1e-12, "jump: {case:?}");
                let (speed, push) = peaks(from, to);
                // At a pose, the acceleration is the mean of those of two segments with different limits.
                let a = a.max(from.acceleration.abs()).max(to.acceleration.abs());
                assert!(push <= a * 1.9 + 1e-9, "quintic: {case:?} {push}");
                worst_push = worst_push.max((push - 1e-9) / a);
                worst_speed = worst_speed.max((speed - fastest) / (a * MC));
            }
        }
        let end = states.last().unwrap();
        assert_eq!(end.position[..axes], poses.last().unwrap().position[..axes], "seed {seed}");
        assert_eq!(end.velocity, Axes::default(), "seed {seed}");
        assert!(
            poses[next_pose..].iter().all(|pose| pose.position[..axes] == end.position[..axes]),
            "pose {next_pose} missed, seed {seed}"
        );
    }
    println!("quintics need up to {worst_push} of the acceleration");
    assert!(worst_speed < 0.1, "quintics overshoot the speed by {worst_speed} of a macrostep's acceleration");
}

#[test]
fn newsmooth_takes_the_closed_form_time_rounded_up_to_a_macrostep() {
    for seed in 0..20_000 {
        let mut random = Random(seed);
        let axes = 1 + random.below(6);
        let limits = random_limits(&mut random);
        let (start, target) = (random.axes(-2.0, 2.0), random.axes(-2.0, 2.0));
        let mut time: f64 = 0.0;
        for axis in 0..axes {
            let (d, v, a) =
                ((target[axis] - start[axis]).abs(), limits.max_velocity[axis], limits.max_acceleration[axis]);
            time = time.max(if d > v * v / a { d / v + v / a } else { 2.0 * (d / a).sqrt() });
        }
        let generator = Newsmooth::new(Space::Joint, axes, limits, vec![SmoothPose::fast(target)]).unwrap();
        let states = walk(generator, &Standing::at(start)).unwrap();
        assert_eq!(states.len() - 1, (time / MC - 1e-9).ceil() as usize, "seed {seed}");
    }
}

#[test]
fn newsmooth_times_of_one_axis_are_the_known_ones() {
    // Distance and time at 1.5 rad/s and 7 rad/s².
    for (distance, time) in [(0.1, 0.2390), (0.5, 0.5476), (1.0, 0.8810), (2.0, 1.5476)] {
        let limits = MotionLimits::uniform(1.5, 7.0, 70.0);
        let poses = vec![SmoothPose::fast([distance; 8])];
        let states = walk(Newsmooth::new(Space::Joint, 1, limits, poses).unwrap(), &Standing::at([0.0; 8])).unwrap();
        assert_eq!(states.len() - 1, (time / MC).ceil() as usize, "{distance}");
    }
}

#[test]
fn newsmooth_passes_a_pose_on_the_way_without_a_stop_and_stands_where_an_axis_turns() {
    let limits = MotionLimits::uniform(1.0, 5.0, 50.0);
    let pose = |a: f64, b: f64| SmoothPose::fast([a, b, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let poses = vec![pose(1.0, 1.0), pose(2.0, 0.0), pose(3.0, 0.0)];
    let states =
        walk(Newsmooth::new(Space::Joint, 2, limits, poses.clone()).unwrap(), &Standing::at([0.0; 8])).unwrap();
    let at = |pose: &SmoothPose| states.iter().find(|state| state.position == pose.position).unwrap().velocity;
    assert!((at(&poses[0])[0] - 1.0).abs() < 1e-9, "axis 0 goes on at full speed");
    assert_eq!(at(&poses[0])[1], 0.0, "axis 1 turns back");
    assert!((at(&poses[1])[0] - 1.0).abs() < 1e-9);
    assert_eq!(at(&poses[1])[1], 0.0, "axis 1 rests next");
    assert_eq!(at(&poses[2]), Axes::default());
}

#[test]
fn newsmooth_by_displacements_is_the_motion_through_their_sums() {
    for seed in 0..200 {
        let mut random = Random(seed);
        let (axes, limits, start) = (1 + random.below(6), random_limits(&mut random), random.axes(-2.0, 2.0));
        let by: Vec<SmoothPose> = (0..1 + random.below(5)).map(|_| SmoothPose::fast(random.axes(-1.0, 1.0))).collect();
        let mut from = start;
        let sums = by.iter().map(|pose| {
            from = std::array::from_fn(|axis| from[axis] + pose.position[axis]);
            SmoothPose::fast(from)
        });
        let sums = Newsmooth::new(Space::Joint, axes, limits, sums.collect()).unwrap();
        let by = Newsmooth::new(Space::Joint, axes, limits, by).unwrap().by_displacements();
        assert_eq!(walk(by, &Standing::at(start)), walk(sums, &Standing::at(start)), "seed {seed}");
    }
}

#[test]
fn a_motion_that_is_too_long_for_its_profile_is_refused_with_the_longest_time() {
    let all = |value: f64| [value; MAX_AXES];
    let limits = MotionLimits { max_velocity: all(0.3), max_acceleration: all(1.0), max_jerk: all(10.0) };
    let conveyor = |metres: f64| {
        let mut pose = Axes::default();
        pose[0] = metres;
        let motion = JerkLimited::new(Space::Joint, 1, limits, &[pose]);
        motion.and_then(|motion| walk(motion, &Standing::at(Axes::default())).map(|_| ()))
    };
    assert_eq!(conveyor(100.0), Ok(()));
    let refusal = conveyor(3000.0).unwrap_err();
    assert_eq!(refusal, GeneratorError::NoProfile);
    assert!(refusal.to_string().ends_with("the motion takes more than 7600 s"), "{refusal}");
}

#[test]
fn jerk_limited_keeps_its_limits_and_ends_exactly() {
    let mut worst_push: f64 = 0.0;
    for seed in 0..20_000 {
        let mut random = Random(seed);
        let axes = 1 + random.below(6);
        let limits = random_limits(&mut random);
        let start = random.axes(-2.0, 2.0);
        // Solving motions through poses takes milliseconds, so there are fewer of them.
        let count = if seed % 400 == 0 { 2 + random.below(3) } else { 1 };
        let poses: Vec<Axes> = (0..count).map(|_| random.axes(-2.0, 2.0)).collect();
        let states = walk(JerkLimited::new(Space::Joint, axes, limits, &poses).unwrap(), &Standing::at(start)).unwrap();
        for pair in states.windows(2) {
            for axis in 0..axes {
                let (v, a) = (limits.max_velocity[axis], limits.max_acceleration[axis]);
                let (from, to) = (knot(&pair[0], axis), knot(&pair[1], axis));
                assert!(to.velocity.abs() <= v * (1.0 + 1e-9), "speed: seed {seed}");
                let gain = to.velocity - from.velocity;
                assert!(gain.abs() <= a * MC * (1.0 + 1e-9) + 1e-9, "acceleration: seed {seed}");
                let (_, push) = peaks(from, to);
                worst_push = worst_push.max(push / a);
            }
        }
        let stands = |state: &&AxesState| state.position[axes..] == start[axes..];
        assert_eq!(states.iter().filter(stands).count(), states.len(), "other axes: seed {seed}");
        let end = states.last().unwrap();
        assert_eq!(end.position[..axes], poses.last().unwrap()[..axes], "seed {seed}");
        assert_eq!(end.velocity, Axes::default());
        // The last computed state leads to the exact end without a jump.
        let before = &states[states.len() - 2];
        for axis in 0..axes {
            assert!(
                (end.position[axis] - before.position[axis]).abs() <= limits.max_acceleration[axis] * MC * MC,
                "seed {seed}"
            );
        }
    }
    // Where the whole acceleration fits between two macrostep ends, the quintic needs more.
    assert!(worst_push < 1.7, "{worst_push}");
}

#[test]
fn jerk_limited_takes_the_known_times() {
    // Distance and time at 1.5 rad/s, 7 rad/s² and 70 rad/s³.
    for (distance, time) in [(0.1, 0.3576), (0.5, 0.6476), (1.0, 0.9810), (2.0, 1.6476)] {
        let generator =
            JerkLimited::new(Space::Motor, 1, MotionLimits::uniform(1.5, 7.0, 70.0), &[[distance; 8]]).unwrap();
        let states = walk(generator, &Standing::at([0.0; 8])).unwrap();
        assert_eq!(states.len() - 1, (time / MC).ceil() as usize, "{distance}");
    }
}

#[test]
fn wait_stands_for_its_time_rounded_up_to_a_macrostep() {
    for (millis, macrosteps) in [(0, 0), (1, 1), (20, 1), (21, 2), (1_000, 50)] {
        let mut run = Run::new(Wait { duration: Duration::from_millis(millis) });
        let mut source = Standing::at([0.0; 8]);
        assert_eq!(begin(&mut run, &mut source, MACROSTEP), Ok(Step::Continue(EffectorCommand::default())));
        for _ in 0..macrosteps {
            assert_eq!(run.next_step(&mut source), Ok(Step::Continue(EffectorCommand::default())), "{millis} ms");
        }
        assert_eq!(run.next_step(&mut source), Ok(Step::Ended), "{millis} ms");
    }
}

#[test]
fn what_cannot_be_planned_is_refused() {
    let limits = MotionLimits::uniform(1.0, 1.0, 1.0);
    let newsmooth = |axes, limits, poses| Newsmooth::new(Space::Joint, axes, limits, poses).map(|_| ());
    let mut lame = limits;
    lame.max_acceleration[2] = 0.0;
    let mut lost = SmoothPose::fast([0.0; 8]);
    lost.position[1] = f64::NAN;
    let mut greedy = SmoothPose::fast([0.0; 8]);
    greedy.velocity[0] = 1.1;
    let fast = vec![SmoothPose::fast([1.0; 8])];
    assert_eq!(newsmooth(6, limits, vec![]), Err(GeneratorError::NoPoses));
    assert_eq!(newsmooth(0, limits, fast.clone()), Err(GeneratorError::Axes { axes: 0, max: 8 }));
    assert_eq!(newsmooth(9, limits, fast.clone()), Err(GeneratorError::Axes { axes: 9, max: 8 }));
    assert_eq!(newsmooth(6, lame, fast.clone()), Err(GeneratorError::Limit { axis: 2 }));
    assert_eq!(newsmooth(6, limits, vec![fast[0], lost]), Err(GeneratorError::NotFinite { pose: 1, axis: 1 }));
    assert_eq!(newsmooth(6, limits, vec![greedy]), Err(GeneratorError::Fraction { pose: 0, axis: 0, value: 1.1 }));

    let jerk_limited = |axes, poses: &[Axes]| JerkLimited::new(Space::Joint, axes, limits, poses).map(|_| ());
    assert_eq!(jerk_limited(6, &[]), Err(GeneratorError::NoPoses));
    assert_eq!(jerk_limited(6, &[[0.0; 8], lost.position]), Err(GeneratorError::NotFinite { pose: 1, axis: 1 }));

    let mut slow = limits;
    slow.max_velocity[0] = 1e-9;
    let endless = Newsmooth::new(Space::Joint, 1, slow, fast).unwrap();
    assert_eq!(walk(endless, &Standing::at([0.0; 8])), Err(GeneratorError::TooLong { limit: 1 << 24 }));
    let mut run = Run::new(Wait { duration: MACROSTEP });
    assert_eq!(begin(&mut run, &mut Standing::at([0.0; 8]), Duration::ZERO), Err(GeneratorError::NoMacrostep));
}

/// Makes three steps, independent of its images.
struct Reader<F, E>(std::marker::PhantomData<(F, E)>);

impl<F: Images, E: Images> Generator for Reader<F, E> {
    type First = F;
    type Every = E;
    type Out = ();
    type Memory = u8;
    fn first_step(&mut self, _: &F, _: Duration) -> Result<Next<u8>, GeneratorError> {
        Ok(Next::remember(0))
    }
    fn terminal(&self, steps: &u8, _: &E) -> bool {
        *steps == 3
    }
    fn next_step(&self, steps: &u8, _: &E) -> Result<Next<u8>, GeneratorError> {
        Ok(Next::remember(steps + 1))
    }
}

#[test]
fn only_declared_images_are_fetched_and_one_snapshot_serves_terminal_condition_and_step() {
    struct Counting(std::cell::Cell<usize>);
    impl Partners for Counting {
        fn effector(&self) -> Result<EffectorImage, GeneratorError> {
            self.0.set(self.0.get() + 1);
            Standing::at([0.0; 8]).effector()
        }
    }
    fn fetches<F: Images, E: Images>() -> (u8, bool, usize, usize) {
        let mut source = Counting(std::cell::Cell::new(0));
        let mut run = Run::new(Reader::<F, E>(std::marker::PhantomData));
        assert_eq!(begin(&mut run, &mut source, MACROSTEP), Ok(Step::Continue(EffectorCommand::default())));
        let first = source.0.replace(0);
        while run.next_step(&mut source).unwrap() != Step::Ended {}
        (F::CLASS | E::CLASS, run.macrosteps_ahead(100) > 1, first, source.0.get())
    }
    // Class; whether the generator may run ahead; fetches of the first step; fetches of three steps and the end.
    assert_eq!(fetches::<(), ()>(), (0, true, 0, 0));
    assert_eq!(fetches::<EffectorImage, ()>(), (1, true, 1, 0));
    assert_eq!(fetches::<(), EffectorImage>(), (1, false, 0, 4));
    assert_eq!(fetches::<EffectorImage, EffectorImage>(), (1, false, 1, 4));
}
