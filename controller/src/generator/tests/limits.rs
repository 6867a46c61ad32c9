//! Durations under rising limits, for every robot. `MRROC_RANDOM_TIMES` multiplies the number of cases.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::path::{BSpline, Curve, JointPath, Path, SplineEnds};
use crate::robot::{
    Arm, Irb6, Irb6Parameters, Irp6, Irp6Parameters, Irp6Track, Irp6TrackParameters, Polycrank, PolycrankParameters,
    Rnt, RntParameters, Robot,
};

/// The servo period.
pub(super) const PERIOD: Duration = Duration::from_millis(2);

/// All robots with arms.
pub(super) fn arms() -> [(&'static str, Arm); 5] {
    let arm = |robot: Arc<dyn Robot>| Arm::new(robot, Pose::translation(0.0, 0.0, 0.1));
    [
        ("irb6", arm(Arc::new(Irb6::new(&Irb6Parameters::irb6()).unwrap()))),
        ("irp6", arm(Arc::new(Irp6::new(&Irp6Parameters::irp6p()).unwrap()))),
        ("irp6-track", arm(Arc::new(Irp6Track::new(&Irp6TrackParameters::irp6ot()).unwrap()))),
        ("rnt", arm(Arc::new(Rnt::new(&RntParameters::nominal()).unwrap()))),
        ("polycrank", arm(Arc::new(Polycrank::new(&PolycrankParameters::polycrank()).unwrap()))),
    ]
}

fn times() -> u64 {
    std::env::var("MRROC_RANDOM_TIMES").map_or(1, |times| times.parse().expect("a number"))
}

/// Random joints in the inner part of all ranges, and their image.
pub(super) fn standing(arm: &Arm, random: &mut Random) -> Option<(Axes, EffectorImage)> {
    let mut joints = Axes::default();
    for (joint, limits) in joints.iter_mut().zip(arm.robot().joint_limits()) {
        let (low, high) = if limits.is_continuous() { (-2.0, 2.0) } else { (limits.low, limits.high) };
        *joint = random.within(0.8 * low + 0.2 * high, 0.2 * low + 0.8 * high);
    }
    if arm.axes() == 5 {
        // The tool points downward, so that all lines without a turn stay in the plane of the arm.
        joints[3] = FRAC_PI_2;
    }
    let motors = AxesState::at_rest(arm.motors(&joints).ok()?);
    let state = EffectorState { motors, joints: AxesState::at_rest(joints), pose: arm.forward(&joints).ok()? };
    Some((joints, EffectorImage::standing(state)))
}

/// A pose up to 0.3 m and 0.5 rad from another, or without a turn for an arm of five axes.
pub(super) fn beside(arm: &Arm, from: &Pose, random: &mut Random) -> Pose {
    let mut vector = |most: f64| Vector3::from_fn(|_, _| random.within(-most, most));
    let (by, turn) = (vector(0.17), vector(if arm.axes() == 5 { 0.0 } else { 0.3 }));
    let rotation = UnitQuaternion::from_scaled_axis(turn) * from.rotation;
    Pose::from_parts((from.translation.vector + by).into(), rotation)
}

/// Limits of tool and joints that rise at random.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    pub(super) tool: [f64; 6],
    pub(super) joints: MotionLimits,
}

impl Limits {
    fn random(random: &mut Random) -> Self {
        let mut factor = || 10_f64.powf(random.within(-1.0, 0.5));
        let [v, a, j] = [0.3, 3.0, 60.0].map(|typical| typical * factor());
        let [w, b, k] = [1.0, 10.0, 200.0].map(|typical| typical * factor());
        Self {
            tool: [v, a, j, w, b, k],
            joints: MotionLimits::uniform(1.5 * factor(), 7.0 * factor(), 70.0 * factor()),
        }
    }

    /// One or more limits rise, by a factor of up to 10.
    fn rise(&mut self, random: &mut Random) {
        let factor = 10_f64.powf(random.within(0.0, 1.0));
        match random.below(4) {
            0 => self.tool[random.below(6)] *= factor,
            1 => self.tool = self.tool.map(|limit| limit * factor),
            2 => {
                let joints = &mut self.joints;
                let of = [&mut joints.max_velocity, &mut joints.max_acceleration, &mut joints.max_jerk];
                of.into_iter().nth(random.below(3)).unwrap()[random.below(MAX_AXES)] *= factor;
            }
            _ => {
                let joints = &mut self.joints;
                for limits in [&mut joints.max_velocity, &mut joints.max_acceleration, &mut joints.max_jerk] {
                    *limits = limits.map(|limit| limit * factor);
                }
            }
        }
    }

    /// The limits of a contour. The limit of the normal acceleration follows from that of the angular jerk.
    fn feed(&self) -> FeedLimits {
        let [max_velocity, max_acceleration, max_jerk, max_angular_velocity, max_angular_acceleration, k] = self.tool;
        let max_normal_acceleration = k / 60.0;
        FeedLimits {
            max_velocity,
            max_acceleration,
            max_jerk,
            max_normal_acceleration,
            max_angular_velocity,
            max_angular_acceleration,
        }
    }

    pub(super) fn line(&self) -> LineLimits {
        let [max_velocity, max_acceleration, max_jerk, w, b, k] = self.tool;
        LineLimits {
            max_velocity,
            max_acceleration,
            max_jerk,
            max_angular_velocity: w,
            max_angular_acceleration: b,
            max_angular_jerk: k,
        }
    }
}

/// Number of servo periods of a motion.
fn periods<G: Generator<First = EffectorImage, Every = (), Out = ()>>(
    mut generator: G,
    image: &EffectorImage,
) -> Result<u32, GeneratorError> {
    let mut memory = generator.first_step(image, PERIOD)?.memory;
    let mut count = 0;
    while !generator.terminal(&memory, &()) {
        memory = generator.next_step(&memory, &())?.memory;
        count += 1;
    }
    Ok(count)
}

/// Durations of the motions of `motion` under limits that rise `RISES` times. The motion may be refused as a whole.
fn check(name: &str, seed: u64, mut motion: impl FnMut(&Limits) -> Result<u32, GeneratorError>) -> bool {
    const RISES: u32 = 6;
    let mut random = Random(seed ^ 0x5eed);
    let mut limits = Limits::random(&mut random);
    let Ok(mut last) = motion(&limits) else { return false };
    for rise in 0..RISES {
        let before = limits;
        limits.rise(&mut random);
        let found = motion(&limits).unwrap_or_else(|error| panic!("{name}, seed {seed}, rise {rise}: {error}"));
        assert!(
            found <= last + 1,
            "{name}, seed {seed}, rise {rise}: {last} periods, then {found}\n{before:?}\n{limits:?}"
        );
        last = found;
    }
    true
}

#[test]
fn no_line_of_any_robot_takes_longer_or_is_refused_when_a_limit_rises() {
    for (name, arm) in arms() {
        let mut lines = 0;
        for seed in 0..40 * times() {
            let mut random = Random(seed);
            let Some((_, image)) = standing(&arm, &mut random) else { continue };
            let target = beside(&arm, &image.commanded.pose, &mut random);
            lines += u32::from(check(name, seed, |limits| {
                let mut line = StraightLine::new(arm.clone(), target, limits.line(), limits.joints)?;
                line.first_step(&image, PERIOD)?;
                Ok(line.periods())
            }));
        }
        println!("{name}: {lines} lines");
        assert!(lines >= 10, "{name}: {lines} lines");
    }
}

/// Seeds of cases of every robot.
fn cases() -> impl Iterator<Item = (&'static str, Arm, u64)> {
    arms().into_iter().flat_map(|(name, arm)| (0..20 * times()).map(move |seed| (name, arm.clone(), seed)))
}

#[test]
fn no_motion_of_joints_takes_longer_or_is_refused_when_a_limit_rises() {
    for (name, arm, seed) in cases() {
        let axes = arm.axes();
        let mut random = Random(seed);
        let Some((_, image)) = standing(&arm, &mut random) else { continue };
        let poses: Vec<Axes> = (0..1 + random.below(4)).map(|_| random.axes(-1.5, 1.5)).collect();
        let name = |generator| format!("{generator} of {name}");
        check(&name("newsmooth"), seed, |limits| {
            let poses = poses.iter().copied().map(SmoothPose::fast).collect();
            periods(Newsmooth::new(Space::Joint, axes, limits.joints, poses)?, &image)
        });
        check(&name("cubic"), seed, |limits| {
            periods(Polynomial::cubic(Space::Joint, axes, limits.joints, poses[0])?, &image)
        });
        check(&name("quintic"), seed, |limits| {
            periods(Polynomial::quintic(Space::Motor, axes, limits.joints, poses[0])?, &image)
        });
        check(&name("jerk-limited"), seed, |limits| {
            periods(JerkLimited::new(Space::Joint, axes, limits.joints, &poses[..1])?, &image)
        });
        check(&name("time-optimal"), seed, |limits| {
            periods(TimeOptimal::through(Space::Joint, axes, limits.joints, poses.clone())?, &image)
        });
        let velocity = poses[0].map(|value| 0.05 * value);
        check(&name("constant velocity"), seed, |limits| {
            periods(ConstantVelocity::new(arm.clone(), limits.joints, velocity)?.over(0.01)?, &image)
        });
    }
}

#[test]
fn no_motion_through_poses_takes_longer_or_is_refused_when_a_limit_rises() {
    for (name, arm, seed) in cases() {
        let mut random = Random(seed);
        let Some((_, image)) = standing(&arm, &mut random) else { continue };
        let poses: Vec<Axes> = (0..2 + random.below(4)).map(|_| random.axes(-1.5, 1.5)).collect();
        check(&format!("jerk-limited of {name}"), seed, |limits| {
            periods(JerkLimited::new(Space::Joint, arm.axes(), limits.joints, &poses)?, &image)
        });
    }
}

/// A random path of the tool from a pose: a line, an arc, a polyline with blends or a spline. The tool turns unless the
/// arm has five axes.
fn random_path(arm: &Arm, from: &Pose, random: &mut Random) -> Option<Path> {
    let mut points = vec![from.translation.vector];
    for _ in 0..3 + random.below(3) {
        let by = Vector3::from_fn(|_, _| random.within(-0.12, 0.12));
        points.push(points[points.len() - 1] + by);
    }
    let curve = match random.below(4) {
        0 => Curve::line(points[0], points[1]),
        1 => Curve::arc(points[0], points[1], points[2]),
        2 => Curve::polyline(&points, random.within(0.002, 0.02)),
        _ => Curve::spline(BSpline::through(&points, SplineEnds::NotAKnot).ok()?),
    };
    if arm.axes() == 5 || random.below(2) == 0 {
        return Path::keeping(curve.ok()?, from.rotation).ok();
    }
    let turn = UnitQuaternion::from_scaled_axis(Vector3::from_fn(|_, _| random.within(-0.3, 0.3)));
    Path::turning(curve.ok()?, from.rotation, turn * from.rotation).ok()
}

#[test]
fn no_contour_of_any_robot_takes_longer_or_is_refused_when_a_limit_rises() {
    let mut contours = 0;
    for (name, arm, seed) in cases().filter(|(_, _, seed)| *seed < 5 * times()) {
        let mut random = Random(seed);
        let Some((_, image)) = standing(&arm, &mut random) else { continue };
        let Some(path) = random_path(&arm, &image.commanded.pose, &mut random) else { continue };
        contours += u32::from(check(&format!("contour of {name}"), seed, |limits| {
            let mut contour = Contour::along(arm.clone(), path.clone(), limits.feed(), limits.joints)?;
            contour.first_step(&image, PERIOD)?;
            Ok((contour.feed().unwrap().duration() / PERIOD.as_secs_f64()).round() as u32)
        }));
    }
    println!("{contours} contours");
    assert!(contours >= 10, "{contours} contours");
}

#[test]
fn contours_that_joints_limit_keep_the_limits_of_the_joints_at_their_set_points() {
    let (mut contours, mut slowed) = (0, 0);
    for (name, arm, seed) in cases().filter(|(_, _, seed)| *seed < 6 * times()) {
        let mut random = Random(seed);
        let Some((_, image)) = standing(&arm, &mut random) else { continue };
        let Some(path) = random_path(&arm, &image.commanded.pose, &mut random) else { continue };
        let limits = if seed % 2 == 0 { HIGH } else { Limits { tool: [0.5, 5.0, 100.0, 2.0, 20.0, 400.0], ..HIGH } };
        let mut contour = Contour::along(arm.clone(), path, limits.feed(), limits.joints).unwrap();
        let Ok(Next { mut memory, .. }) = contour.first_step(&image, PERIOD) else { continue };
        let mut joints = vec![image.commanded.joints.position];
        while !contour.terminal(&memory, &()) {
            memory = contour.next_step(&memory, &()).unwrap().memory;
            let pose = contour.state(memory).unwrap().pose;
            joints.push(arm.inverse(&pose, &joints[joints.len() - 1]).unwrap());
        }
        let [speed, push, ..] = parts_of_limits(&arm, &joints, &limits);
        contours += 1;
        slowed += u32::from(contour.slowed().is_some());
        assert!(speed <= 1.01 && push <= 1.01, "{name}, seed {seed}: {speed} {push}");
    }
    println!("{contours} contours, {slowed} slowed");
    assert!(contours >= 12 && slowed >= 8, "{contours} contours, {slowed} slowed");
}

/// Limits of the tool that no arm reaches, but for the jerk of the joints.
pub(super) const HIGH: Limits = Limits {
    tool: [100.0, 1e3, 2e4, 500.0, 5e3, 1e5],
    joints: MotionLimits {
        max_velocity: [1.5; MAX_AXES],
        max_acceleration: [7.0; MAX_AXES],
        max_jerk: [70.0; MAX_AXES],
    },
};

/// Joint positions at all set-points of a line, beginning with the start; `None` if the arm cannot follow the line.
fn followed(mut line: StraightLine, image: &EffectorImage) -> Option<Vec<Axes>> {
    let mut memory = line.first_step(image, PERIOD).ok()?.memory;
    let mut joints = vec![image.commanded.joints.position];
    while !line.terminal(&memory, &()) {
        let next = line.next_step(&memory, &()).unwrap();
        let Some(Setpoint::Joints(state)) = next.effector else { panic!("a line commands joints") };
        joints.push(state.position);
        memory = next.memory;
    }
    Some(joints)
}

/// A joint path through some of these joint positions, at about equal distances of the tool.
fn joint_path(arm: &Arm, joints: &[Axes]) -> Option<JointPath> {
    const PARTS: f64 = 60.0;
    let place = |joints: &Axes| arm.forward(joints).unwrap();
    let (start, end) = (place(&joints[0]), place(joints.last()?));
    let way = (end.translation.vector - start.translation.vector).norm();
    let mut points = vec![joints[0]];
    for joints in &joints[1..] {
        let done = (place(joints).translation.vector - start.translation.vector).norm() / way;
        if done * PARTS >= points.len() as f64 - 0.5 && done * PARTS < PARTS - 0.5 {
            points.push(*joints);
        }
    }
    points.push(*joints.last()?);
    JointPath::through(arm.axes(), &points, SplineEnds::<MAX_AXES>::NotAKnot).ok()
}

#[test]
fn lines_that_joints_limit_take_at_most_1_3_times_the_optimum_in_the_median() {
    for (name, arm) in arms() {
        let mut ratios = Vec::new();
        for seed in 0..60 {
            let mut random = Random(seed);
            let Some((_, image)) = standing(&arm, &mut random) else { continue };
            let target = beside(&arm, &image.commanded.pose, &mut random);
            let line = StraightLine::new(arm.clone(), target, HIGH.line(), HIGH.joints).unwrap();
            let Some(joints) = followed(line, &image) else { continue };
            let Some(path) = joint_path(&arm, &joints) else { continue };
            let Ok(optimum) = PathTiming::optimal(path, &HIGH.joints, EndSpeeds::default()) else { continue };
            ratios.push((joints.len() - 1) as f64 * PERIOD.as_secs_f64() / optimum.duration());
        }
        ratios.sort_by(f64::total_cmp);
        let [median, ninth] = [ratios.len() / 2, ratios.len() * 9 / 10].map(|at| ratios[at]);
        println!("{name}: {} lines, {median:.3} times the optimum, 90 % up to {ninth:.3}", ratios.len());
        assert!(ratios.len() >= 10 && median <= 1.3, "{name}: {median}");
    }
}

/// Largest velocity and acceleration of a joint, then of the tool, relative to the limits.
fn parts_of_limits(arm: &Arm, joints: &[Axes], limits: &Limits) -> [f64; 4] {
    let dt = PERIOD.as_secs_f64();
    let (first, last) = (joints[0], joints[joints.len() - 1]);
    let joints: Vec<Axes> = [first].into_iter().chain(joints.iter().copied()).chain([last]).collect();
    let tools: Vec<Vector3<f64>> =
        joints.iter().map(|joints| arm.forward(joints).unwrap().translation.vector).collect();
    let mut worst = [0.0_f64; 4];
    for at in 2..joints.len() {
        let [a, b, c] = [joints[at - 2], joints[at - 1], joints[at]];
        for axis in 0..arm.axes() {
            let speed = (c[axis] - b[axis]).abs() / dt;
            let push = (c[axis] - 2.0 * b[axis] + a[axis]).abs() / (dt * dt);
            worst[0] = worst[0].max(speed / limits.joints.max_velocity[axis]);
            worst[1] = worst[1].max(push / limits.joints.max_acceleration[axis]);
        }
        let (step, last) = (tools[at] - tools[at - 1], tools[at - 1] - tools[at - 2]);
        worst[2] = worst[2].max(step.norm() / dt / limits.tool[0]);
        worst[3] = worst[3].max((step - last).norm() / (dt * dt) / limits.tool[1]);
    }
    worst
}

#[test]
fn lines_that_joints_limit_keep_all_limits_at_their_set_points() {
    for (name, arm) in arms() {
        let mut worst = [0.0_f64; 4];
        let mut lines = 0;
        for seed in 0..60 {
            let mut random = Random(seed);
            let Some((_, image)) = standing(&arm, &mut random) else { continue };
            let target = beside(&arm, &image.commanded.pose, &mut random);
            let limits =
                if seed % 2 == 0 { HIGH } else { Limits { tool: [0.5, 5.0, 100.0, 2.0, 20.0, 400.0], ..HIGH } };
            let line = StraightLine::new(arm.clone(), target, limits.line(), limits.joints).unwrap();
            let Some(joints) = followed(line, &image) else { continue };
            lines += 1;
            let parts = parts_of_limits(&arm, &joints, &limits);
            if parts.iter().any(|part| *part > 1.01) {
                println!("{name}, seed {seed}: {parts:.4?}");
            }
            worst = std::array::from_fn(|at| worst[at].max(parts[at]));
        }
        println!("{name}: {lines} lines, parts of the limits {worst:.4?}");
        assert!(lines >= 10 && worst.iter().all(|part| *part <= 1.01), "{name}: {worst:?}");
    }
}

#[test]
fn lines_of_the_polycrank_from_near_a_fold_are_slow_there_and_keep_all_limits() {
    let arm = arms()[4].1.clone();
    let (mut lines, mut beyond, mut worst) = (0, 0, 0.0_f64);
    for seed in 0..120 {
        let mut random = Random(seed);
        let mut joints = Axes::default();
        joints[..7].copy_from_slice(&random.axes(-2.0, 2.0)[..7]);
        // Stretched or folded upper cranks or forearm.
        let [axis, turn] = [[1, 4][random.below(2)], random.below(2)];
        joints[axis] = turn as f64 * std::f64::consts::PI + random.within(-0.3, 0.3);
        let motors = AxesState::at_rest(arm.motors(&joints).unwrap());
        let pose = arm.forward(&joints).unwrap();
        let state = EffectorState { motors, joints: AxesState::at_rest(joints), pose };
        let target = beside(&arm, &pose, &mut random);
        let limits = Limits { tool: [0.25, 2.5, 50.0, 1.0, 10.0, 200.0], ..HIGH };
        let line = StraightLine::new(arm.clone(), target, limits.line(), limits.joints).unwrap();
        let Some(joints) = followed(line, &EffectorImage::standing(state)) else { continue };
        lines += 1;
        let [_, push, ..] = parts_of_limits(&arm, &joints, &limits);
        if push > 1.01 {
            println!("seed {seed}: {push:.3} times the acceleration, {} periods", joints.len());
        }
        beyond += u32::from(push > 1.01);
        worst = worst.max(push);
    }
    println!("{lines} lines, {beyond} beyond the acceleration, at most {worst:.4} times");
    assert!(lines >= 40 && beyond == 0, "{beyond} of {lines} lines, {worst}");
}

#[test]
fn a_line_past_a_singular_wrist_is_slow_only_there() {
    let arm = arms()[1].1.clone();
    let mut joints = [0.2, -FRAC_PI_2, 0.1, 0.2, 1.2, 0.3, 0.0, 0.0];
    joints[4] = 0.05;
    let motors = AxesState::at_rest(arm.motors(&joints).unwrap());
    let pose = arm.forward(&joints).unwrap();
    let state = EffectorState { motors, joints: AxesState::at_rest(joints), pose };
    let image = EffectorImage::standing(state);
    let target = Pose::from_parts((pose.translation.vector + Vector3::new(0.0, 0.2, 0.1)).into(), pose.rotation);
    let limits = Limits { tool: [0.25, 2.5, 50.0, 1.0, 10.0, 200.0], ..HIGH };
    let mut line = StraightLine::new(arm.clone(), target, limits.line(), limits.joints).unwrap();
    let mut memory = line.first_step(&image, PERIOD).unwrap().memory;
    let (mut last, mut speeds) = (pose.translation.vector, Vec::new());
    while !line.terminal(&memory, &()) {
        let next = line.next_step(&memory, &()).unwrap();
        let Some(Setpoint::Joints(state)) = next.effector else { panic!("a line commands joints") };
        let here = arm.forward(&state.position).unwrap().translation.vector;
        speeds.push((here - last).norm() / PERIOD.as_secs_f64());
        (last, memory) = (here, next.memory);
    }
    let fastest = speeds.iter().copied().fold(0.0, f64::max);
    let slowest = speeds[50..speeds.len() - 50].iter().copied().fold(f64::INFINITY, f64::min);
    println!("{} periods, {slowest:.3} to {fastest:.3} m/s", speeds.len());
    assert!(fastest > 0.2 && slowest < 0.5 * fastest, "{slowest} to {fastest} of 0.25 m/s");
}
