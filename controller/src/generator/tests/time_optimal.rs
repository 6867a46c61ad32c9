//! Properties of time-optimal motions over seeded random paths, their known times, and refusals.

use super::*;
use crate::path::{BSpline, JointPath, PathError, SplineEnds};

/// A random path and limits of its axes. Some axes of some paths rest. Way-points of some `uneven` paths are close.
fn random_path(random: &mut Random, uneven: bool) -> (JointPath, MotionLimits) {
    let axes = 1 + random.below(8);
    let limits = random_limits(random);
    let count = 2 + random.below(8);
    let resting = random.below(2 * axes);
    let near = uneven && random.below(4) == 0;
    let mut points: Vec<Axes> = Vec::new();
    for _ in 0..count {
        let mut point = random.axes(-2.0, 2.0);
        if let (true, Some(last)) = (near && random.below(2) == 0, points.last()) {
            point = std::array::from_fn(|axis| last[axis] + 0.01 * point[axis]);
        }
        if axes > 1 && resting < axes {
            point[resting] = 0.3;
        }
        points.push(point);
    }
    let ends = match random.below(3) {
        0 if count >= 4 => SplineEnds::NotAKnot,
        1 => SplineEnds::Clamped { start: random.axes(-1.0, 1.0).into(), end: random.axes(-1.0, 1.0).into() },
        _ => SplineEnds::Natural,
    };
    (JointPath::through(axes, &points, ends).unwrap(), limits)
}

/// Greatest factor of a limit of velocity or acceleration at a time.
fn excess(timing: &PathTiming, limits: &MotionLimits, time: f64) -> f64 {
    let state = timing.at(time);
    let acceleration = state.acceleration.unwrap();
    let times = |axis: usize| {
        let velocity = state.velocity[axis].abs() / limits.max_velocity[axis];
        velocity.max(acceleration[axis].abs() / limits.max_acceleration[axis])
    };
    (0..timing.path().axes()).map(times).fold(0.0, f64::max)
}

#[test]
fn a_time_optimal_path_keeps_its_limits_and_one_of_them_is_always_reached() {
    const TIMES: u32 = 2_000;
    let (mut worst, mut idle): (f64, f64) = (0.0, 0.0);
    for seed in 0..300 {
        let (path, limits) = random_path(&mut Random(seed), true);
        let timing = PathTiming::optimal(path.clone(), &limits, EndSpeeds::default()).unwrap();
        let duration = timing.duration();
        let mut reached = 0;
        for k in 0..TIMES {
            let times = excess(&timing, &limits, duration * (f64::from(k) + 0.5) / f64::from(TIMES));
            worst = worst.max(times);
            reached += u32::from(times > 0.97);
        }
        assert!(worst <= 1.0 + 1e-3, "seed {seed}: {worst} times a limit");
        idle = idle.max(1.0 - f64::from(reached) / f64::from(TIMES));
        let [start, end] = [timing.at(0.0), timing.at(duration)];
        assert_eq!((start.velocity, end.velocity), (Axes::default(), Axes::default()), "seed {seed}");
        assert_eq!(start.position, path.at(0.0).position, "seed {seed}");
        assert_eq!(end.position, path.at(path.length()).position, "seed {seed}");
    }
    println!("at most {worst} times a limit; no limit is reached in {idle} of the time at most");
    assert!(idle < 0.1, "{idle}");
}

#[test]
fn velocity_and_acceleration_of_a_timed_path_are_derivatives_of_its_position() {
    for seed in 0..100 {
        let (path, limits) = random_path(&mut Random(seed), true);
        let timing = PathTiming::optimal(path, &limits, EndSpeeds::default()).unwrap();
        let nodes: Vec<f64> = {
            let (mut time, mut times) = (0.0, vec![0.0]);
            let profile: Vec<(f64, f64)> = timing.profile().collect();
            for pair in profile.windows(2) {
                time += 2.0 * (pair[1].0 - pair[0].0) / (pair[0].1 + pair[1].1);
                times.push(time);
            }
            times
        };
        assert!((nodes[nodes.len() - 1] - timing.duration()).abs() < 1e-9, "seed {seed}");
        for pair in nodes.windows(2) {
            let (time, h) = (f64::midpoint(pair[0], pair[1]), (pair[1] - pair[0]) * 0.1);
            let [behind, here, ahead] = [time - h, time, time + h].map(|time| timing.at(time));
            for axis in 0..8 {
                let velocity = (ahead.position[axis] - behind.position[axis]) / (2.0 * h);
                let acceleration = (ahead.velocity[axis] - behind.velocity[axis]) / (2.0 * h);
                let stated = here.acceleration.unwrap()[axis];
                assert!((velocity - here.velocity[axis]).abs() < 0.01 * limits.max_velocity[axis], "seed {seed}");
                assert!((acceleration - stated).abs() < 0.05 * limits.max_acceleration[axis], "seed {seed}");
            }
        }
    }
}

#[test]
fn a_straight_joint_path_takes_the_time_of_its_slowest_axis() {
    for seed in 0..500 {
        let mut random = Random(seed);
        let axes = 1 + random.below(8);
        let limits = random_limits(&mut random);
        let points = [random.axes(-2.0, 2.0), random.axes(-2.0, 2.0)];
        let path = JointPath::through(axes, &points, SplineEnds::Natural).unwrap();
        // On a straight path all axes move in proportion, and the tightest limits bound the path parameter.
        let way = |axis: usize| (points[1][axis] - points[0][axis]).abs() / path.length();
        let v = (0..axes).map(|axis| limits.max_velocity[axis] / way(axis)).fold(f64::INFINITY, f64::min);
        let a = (0..axes).map(|axis| limits.max_acceleration[axis] / way(axis)).fold(f64::INFINITY, f64::min);
        let d = path.length();
        let time = if d > v * v / a { d / v + v / a } else { 2.0 * (d / a).sqrt() };
        let found = PathTiming::optimal(path, &limits, EndSpeeds::default()).unwrap().duration();
        assert!(found >= time * (1.0 - 1e-9) && found < time * 1.002, "seed {seed}: {found} for {time}");
    }
}

#[test]
fn a_finer_grid_is_never_slower_by_more_than_its_resolution() {
    for seed in 0..50 {
        let (path, limits) = random_path(&mut Random(seed), false);
        let length = path.length();
        let duration = |parts: u32| {
            let node = |k: u32| if k == parts { length } else { length * f64::from(k) / f64::from(parts) };
            let grid: Vec<f64> = (0..=parts).map(node).collect();
            PathTiming::on_grid(path.clone(), &limits, EndSpeeds::default(), &grid).unwrap().duration()
        };
        let [coarse, fine, finest] = [500, 1000, 2000].map(duration);
        assert!((fine - finest).abs() <= 0.02 * finest, "seed {seed}: {coarse} {fine} {finest}");
        let best = PathTiming::optimal(path.clone(), &limits, EndSpeeds::default()).unwrap().duration();
        assert!((best - finest).abs() <= 0.02 * finest, "seed {seed}: {best} for {finest}");
    }
}

/// Limits for a motion of the duration divided by `factor`.
fn slowed(limits: &MotionLimits, factor: f64) -> MotionLimits {
    MotionLimits {
        max_velocity: limits.max_velocity.map(|limit| limit * factor),
        max_acceleration: limits.max_acceleration.map(|limit| limit * factor * factor),
        max_jerk: limits.max_jerk,
    }
}

#[test]
fn a_timed_path_begins_and_ends_with_the_given_speeds() {
    for seed in 0..200 {
        let mut random = Random(seed);
        let (path, limits) = random_path(&mut random, true);
        // Speeds in a motion of twice the duration are possible at both ends.
        let rest = PathTiming::optimal(path.clone(), &slowed(&limits, 0.5), EndSpeeds::default()).unwrap();
        let half: Vec<(f64, f64)> = rest.profile().collect();
        let speed = half[half.len() / 2].1 * random.within(0.0, 0.1);
        match PathTiming::optimal(path.clone(), &limits, EndSpeeds { start: 0.0, end: speed }) {
            Ok(timing) => {
                let [s, end, _] = timing.parameter(timing.duration());
                assert!((end - speed).abs() < 1e-9 && s == path.length(), "seed {seed}: {end} for {speed}");
                assert!(timing.duration() <= rest.duration(), "seed {seed}");
            }
            // Curvature at the end may not permit the speed.
            Err(TimingError::Infeasible { .. }) => {}
            Err(error) => panic!("seed {seed}: {error}"),
        }
        let started = PathTiming::optimal(path.clone(), &limits, EndSpeeds { start: speed, end: 0.0 });
        match started {
            Ok(timing) => assert!((timing.parameter(0.0)[1] - speed).abs() < 1e-9, "seed {seed}"),
            Err(TimingError::StartSpeed { least, most, .. }) => assert!(speed < least || speed > most, "seed {seed}"),
            Err(error) => panic!("seed {seed}: {error}"),
        }
    }
}

#[test]
fn the_place_where_a_timing_fails_is_named() {
    let limits = MotionLimits::uniform(1.0, 2.0, 1.0);
    let point = |x: f64| [x, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let path = JointPath::through(1, &[point(0.0), point(1.0)], SplineEnds::Natural).unwrap();
    let timed = |start: f64, end: f64| {
        PathTiming::optimal(path.clone(), &limits, EndSpeeds { start, end })
            .map(|timing| timing.duration())
            .unwrap_err()
    };
    assert_eq!(timed(0.0, 1.5), TimingError::Infeasible { s: 1.0, length: 1.0 });
    let TimingError::StartSpeed { speed, least, most } = timed(1.5, 0.0) else { panic!("too fast") };
    assert!(speed == 1.5 && least == 0.0 && (most - 1.0).abs() < 1e-9, "{least} {most}");
    assert_eq!(timed(-1.0, 0.0), TimingError::EndSpeed { speed: -1.0 });
    assert!(matches!(timed(0.0, f64::NAN), TimingError::EndSpeed { .. }));

    let on = |grid: &[f64]| PathTiming::on_grid(path.clone(), &limits, EndSpeeds::default(), grid).map(|_| ());
    assert_eq!(on(&[0.0, 0.5, 1.0]), Ok(()));
    assert_eq!(on(&[0.0, 1.0]), Err(TimingError::Standstill { s: 0.0, length: 1.0 }));
    for (grid, node) in
        [(&[][..], 0), (&[0.0][..], 0), (&[0.1, 1.0][..], 0), (&[0.0, 0.5, 0.5, 1.0][..], 2), (&[0.0, 0.9][..], 1)]
    {
        assert_eq!(on(grid), Err(TimingError::Grid { node, length: 1.0 }), "{grid:?}");
    }
    assert_eq!(on(&[0.0, f64::NAN, 1.0]), Err(TimingError::Grid { node: 1, length: 1.0 }));
    assert_eq!(on(&[0.0, 1.5, 1.0]), Err(TimingError::Grid { node: 1, length: 1.0 }));
    let mut lame = limits;
    lame.max_velocity[0] = -1.0;
    let refused = PathTiming::optimal(path, &lame, EndSpeeds::default()).map(|_| ());
    assert_eq!(refused, Err(TimingError::Limit { axis: 0 }));
}

#[test]
fn a_time_optimal_motion_passes_its_way_points_and_ends_exactly_with_a_macrostep() {
    let mut worst: f64 = 0.0;
    for seed in 0..300 {
        let mut random = Random(seed);
        let axes = 1 + random.below(8);
        let limits = random_limits(&mut random);
        let start = random.axes(-2.0, 2.0);
        let points: Vec<Axes> = (0..1 + random.below(5)).map(|_| random.axes(-2.0, 2.0)).collect();
        let mut motion = TimeOptimal::through(Space::Joint, axes, limits, points.clone()).unwrap();
        let image = Standing::at(start).effector().unwrap();
        motion.first_step(&image, MACROSTEP).unwrap();
        let duration = motion.timing().unwrap().duration();
        let states = walk(motion, &Standing::at(start)).unwrap();
        assert_eq!(states.len() - 1, (duration / MC - 1e-9).ceil() as usize, "seed {seed}");
        let end = states.last().unwrap();
        assert_eq!(end.velocity, Axes::default(), "seed {seed}");
        assert_eq!(end.position[..axes], points.last().unwrap()[..axes], "seed {seed}");
        for pair in states.windows(2) {
            for axis in 0..axes {
                let (speed, push) = peaks(knot(&pair[0], axis), knot(&pair[1], axis));
                worst = worst.max(push / limits.max_acceleration[axis]);
                let most = limits.max_velocity[axis] + 0.2 * limits.max_acceleration[axis] * MC;
                assert!(speed <= most, "seed {seed}: {speed} of {most}");
            }
        }
    }
    println!("quintics need up to {worst} of the acceleration");
    assert!(worst < 2.5, "{worst}");
}

#[test]
fn a_motion_to_the_place_where_the_effector_stands_takes_no_macrostep() {
    let limits = MotionLimits::uniform(1.0, 2.0, 1.0);
    let here = [0.5; 8];
    let motion = TimeOptimal::through(Space::Joint, 3, limits, vec![here]).unwrap();
    assert_eq!(walk(motion, &Standing::at(here)).unwrap().len(), 1);
    let there = [0.7; 8];
    let motion = TimeOptimal::through(Space::Motor, 3, limits, vec![here, there]).unwrap();
    let states = walk(motion, &Standing::at(here)).unwrap();
    assert_eq!(states.last().unwrap().position[..3], there[..3]);
}

#[test]
fn way_points_that_define_no_motion_are_refused() {
    let limits = MotionLimits::uniform(1.0, 2.0, 1.0);
    let refused = |axes, points: Vec<Axes>| TimeOptimal::through(Space::Joint, axes, limits, points).unwrap_err();
    assert_eq!(refused(3, vec![]), GeneratorError::NoPoses);
    assert_eq!(refused(0, vec![[0.0; 8]]), GeneratorError::Axes { axes: 0, max: 8 });
    let mut lost = [0.0; 8];
    lost[2] = f64::NAN;
    assert_eq!(refused(3, vec![[1.0; 8], lost]), GeneratorError::NotFinite { pose: 1, axis: 2 });
    let twice = PathError::Coincident { point: 1 };
    assert_eq!(refused(3, vec![[0.0; 8], [1.0; 8], [1.0; 8]]), GeneratorError::JointPath(twice));
    let path = |axes, points: &[Axes]| JointPath::through(axes, points, SplineEnds::Natural).unwrap_err();
    assert_eq!(path(9, &[[0.0; 8], [1.0; 8]]), PathError::Axes { axes: 9, max: 8 });
    assert_eq!(path(3, &[[0.0; 8]]), PathError::TooFewPoints { given: 1, needed: 2 });
    assert_eq!(path(3, &[[0.0; 8], lost]), PathError::NotFinite { point: 1 });
    assert_eq!(path(2, &[[0.0; 8], lost]), PathError::Coincident { point: 0 });
}

/// Control points and uniform knots, with ends that occur four times.
fn b_spline(random: &mut Random) -> BSpline<8> {
    let count = 4 + random.below(8);
    let inner = (count - 3) as f64;
    let knots = (0..count + 4).map(|knot| 2.0 + (knot as f64 - 3.0).clamp(0.0, inner)).collect();
    BSpline::new(knots, (0..count).map(|_| random.axes(-2.0, 2.0).into()).collect()).unwrap()
}

#[test]
fn a_time_optimal_motion_along_a_b_spline_keeps_its_limits_and_stays_on_the_spline() {
    for seed in 0..100 {
        let mut random = Random(seed);
        let axes = 1 + random.below(8);
        let limits = random_limits(&mut random);
        let spline = b_spline(&mut random);
        let path = JointPath::along(axes, &spline).unwrap();
        let (first, last) = spline.domain();
        assert_eq!(path.length(), last - first);
        for share in [0.0, 0.3, 0.71, 1.0] {
            let (point, expected) = (path.at(share * path.length()), spline.at(first + share * (last - first)));
            for axis in 0..8 {
                let values = [point.position[axis], point.first[axis], point.second[axis]];
                for (value, vector) in values.into_iter().zip(expected) {
                    assert!((value - if axis < axes { vector[axis] } else { 0.0 }).abs() < 1e-9, "seed {seed}");
                }
            }
        }
        let timing = PathTiming::optimal(path.clone(), &limits, EndSpeeds::default()).unwrap();
        for k in 0..500 {
            let times = excess(&timing, &limits, timing.duration() * (f64::from(k) + 0.5) / 500.0);
            assert!(times <= 1.0 + 1e-3, "seed {seed}: {times} times a limit");
        }
        let start = path.at(0.0).position;
        let motion = TimeOptimal::along(Space::Joint, limits, path.clone()).unwrap();
        let states = walk(motion.clone(), &Standing::at(start)).unwrap();
        let end = states[states.len() - 1];
        assert_eq!((end.position, end.velocity), (path.at(path.length()).position, Axes::default()), "seed {seed}");
        let mut beside = start;
        beside[0] += 1e-3;
        let refused = walk(motion, &Standing::at(beside)).unwrap_err();
        assert!(matches!(refused, GeneratorError::NotAtJointStart { axis: 0, .. }), "seed {seed}: {refused}");
    }
}

#[test]
fn a_b_spline_without_continuous_curvature_is_no_joint_path_and_one_without_length_no_motion() {
    let points = |count: usize| (0..count).map(|k| [k as f64; 8].into()).collect();
    let spline = BSpline::new(vec![0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0], points(6)).unwrap();
    let refused = JointPath::along(3, &spline).unwrap_err();
    assert_eq!(refused, PathError::JointKnotMultiplicity { knot: 4 });
    assert_eq!(JointPath::along(0, &spline).unwrap_err(), PathError::Axes { axes: 0, max: 8 });
    let still = BSpline::new(vec![0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0], vec![[0.5; 8].into(); 4]).unwrap();
    let limits = MotionLimits::uniform(1.0, 2.0, 1.0);
    let path = JointPath::along(3, &still).unwrap();
    let motion = TimeOptimal::along(Space::Joint, limits, path).unwrap();
    assert_eq!(walk(motion, &Standing::at([0.5; 8])).unwrap().len(), 1, "there is no way to go");
}
