//! toppra finds the shortest durations along the joint paths of random lines, and judges the durations of the
//! controller.

use std::time::Duration;

use controller::generator::{
    Axes, AxesState, EffectorImage, EffectorState, EndSpeeds, Generator, LineLimits, MotionLimits, PathTiming, Pose,
    Setpoint, StraightLine,
};
use controller::path::{JointPath, SplineEnds};
use controller::robot::{
    Arm, Irb6Parameters, Irp6Parameters, Irp6TrackParameters, PolycrankParameters, RntParameters, RobotParameters,
};
use kit::draw::Draw;
use kit::processors;
use serde_json::{Value, json};

use super::python;
use super::timing::judged;

/// Lines of each robot. `MRROC_RANDOM_TIMES` multiplies this number.
const LINES: usize = 25;
/// Largest accepted median of durations relative to the optimum of toppra.
const MEDIAN: f64 = 1.3;
const PERIOD: Duration = Duration::from_millis(2);
/// Number of joint positions of a line for toppra.
const PARTS: f64 = 60.0;
/// Largest motion of a joint that counts as standing, rad or m. toppra finds no solution for some joints that nearly
/// stand.
const STANDING: f64 = 1e-6;
/// Largest accepted share of lines for which toppra finds no solution.
const UNSOLVED: f64 = 0.1;
/// Number of coordinates of a path: seven joints, and the distance of the tool from the start of the line.
const COORDINATES: usize = 8;
/// Limits of velocity and acceleration of the tool, m/s and m/s². No arm reaches the last ones.
const TOOL: [[f64; 2]; 4] = [[0.5, 2.0], [0.5, 5.0], [1.0, 20.0], [100.0, 1e3]];

fn arms() -> [(&'static str, Arm); 5] {
    fn arm(parameters: &impl RobotParameters) -> Arm {
        Arm::new(parameters.robot().unwrap(), Pose::translation(0.0, 0.0, 0.1))
    }
    [
        ("irb6", arm(&Irb6Parameters::irb6())),
        ("irp6", arm(&Irp6Parameters::irp6p())),
        ("irp6-track", arm(&Irp6TrackParameters::irp6ot())),
        ("rnt", arm(&RntParameters::nominal())),
        ("polycrank", arm(&PolycrankParameters::polycrank())),
    ]
}

/// A random posture in the inner part of all ranges, and a random place near the tool.
fn drawn(arm: &Arm, draw: &mut Draw) -> Option<(EffectorImage, Pose)> {
    let mut joints = Axes::default();
    for (joint, limits) in joints.iter_mut().zip(arm.robot().joint_limits()) {
        let (low, high) = if limits.is_continuous() { (-2.0, 2.0) } else { (limits.low, limits.high) };
        *joint = draw.within(0.8 * low + 0.2 * high, 0.2 * low + 0.8 * high);
    }
    if arm.axes() == 5 {
        // The tool points downward, so that all lines stay in the plane of the arm.
        joints[3] = std::f64::consts::FRAC_PI_2;
    }
    let pose = arm.forward(&joints).ok()?;
    let motors = AxesState::at_rest(arm.motors(&joints).ok()?);
    let image = EffectorImage::standing(EffectorState { motors, joints: AxesState::at_rest(joints), pose });
    let mut target = pose;
    for coordinate in target.translation.vector.iter_mut() {
        *coordinate += draw.within(-0.17, 0.17);
    }
    Some((image, target))
}

/// The joint positions at all set-points of a line; `None` if the arm cannot follow the line.
fn followed(arm: &Arm, image: &EffectorImage, target: Pose, tool: [f64; 2], limits: MotionLimits) -> Option<Vec<Axes>> {
    let [max_velocity, max_acceleration] = tool;
    let line_limits = LineLimits {
        max_velocity,
        max_acceleration,
        max_jerk: 1e3 * max_acceleration,
        max_angular_velocity: 1e3,
        max_angular_acceleration: 1e4,
        max_angular_jerk: 1e7,
    };
    let mut line = StraightLine::new(arm.clone(), target, line_limits, limits).unwrap();
    let mut memory = line.first_step(image, PERIOD).ok()?.memory;
    let mut positions = vec![image.commanded.joints.position];
    while !line.terminal(&memory, &()) {
        let next = line.next_step(&memory, &()).unwrap();
        let Some(Setpoint::Joints(state)) = next.effector else { panic!("a line commands joints") };
        positions.push(state.position);
        memory = next.memory;
    }
    Some(positions)
}

/// Some of these joint positions, at about equal distances of the tool, with these distances.
fn points(arm: &Arm, joints: &[Axes]) -> Vec<Axes> {
    let place = |joints: &Axes| arm.forward(joints).unwrap().translation.vector;
    let (start, end) = (place(&joints[0]), place(&joints[joints.len() - 1]));
    let length = (end - start).norm();
    let with = |joints: &Axes, distance: f64| {
        let mut point = *joints;
        point[COORDINATES - 1] = distance;
        point
    };
    let mut points = vec![with(&joints[0], 0.0)];
    for joints in joints {
        let distance = (place(joints) - start).norm();
        let done = distance / length * PARTS;
        if done >= points.len() as f64 - 0.5 && done < PARTS - 0.5 {
            points.push(with(joints, distance));
        }
    }
    points.push(with(&joints[joints.len() - 1], length));
    points
}

/// The request to toppra for the shortest duration on a path within limits, on the grid of the controller.
fn asked(points: &[Axes], limits: &MotionLimits) -> Option<Value> {
    let path = JointPath::through(COORDINATES, points, SplineEnds::NotAKnot).ok()?;
    let timing = PathTiming::optimal(path, limits, EndSpeeds::default()).ok()?;
    let (s, rate): (Vec<f64>, Vec<f64>) = timing.profile().unzip();
    let moves = |axis: &usize| points.iter().any(|point| (point[*axis] - points[0][*axis]).abs() > STANDING);
    let moving: Vec<usize> = (0..COORDINATES).filter(moves).collect();
    let of = |axes: &Axes| moving.iter().map(|axis| axes[*axis]).collect::<Vec<_>>();
    Some(json!({
        "points": points.iter().map(of).collect::<Vec<_>>(),
        "ends": "not-a-knot",
        "max_velocity": of(&limits.max_velocity),
        "max_acceleration": of(&limits.max_acceleration),
        "s": s,
        "rate": rate,
        "rounds": 1,
    }))
}

/// The quantile of the values at `share`.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).round() as usize]
}

#[test]
fn random_lines_of_every_robot_take_at_most_1_3_times_the_optimum_of_toppra_in_the_median() {
    let test = "peers::lines::random_lines_of_every_robot_take_at_most_1_3_times_the_optimum_of_toppra_in_the_median";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.9);
    let times: usize = std::env::var("MRROC_RANDOM_TIMES").map_or(1, |times| times.parse().expect("a number"));
    println!("| robot | lines | tool m/s, m/s² | median s | toppra s | median ratio | 90 % | longer than before |");
    for (name, arm) in arms() {
        let mut draw = Draw(21);
        let (mut questions, mut durations) = (Vec::new(), Vec::new());
        while durations.len() < LINES * times {
            let Some((image, target)) = drawn(&arm, &mut draw) else { continue };
            let line = TOOL.map(|tool| {
                let mut limits = MotionLimits::uniform(1.5, 7.0, 70.0);
                let joints = followed(&arm, &image, target, tool, limits)?;
                [limits.max_velocity[COORDINATES - 1], limits.max_acceleration[COORDINATES - 1]] = tool;
                let question = asked(&points(&arm, &joints), &limits)?;
                Some((question, (joints.len() - 1) as f64 * PERIOD.as_secs_f64()))
            });
            let [Some(a), Some(b), Some(c), Some(d)] = line else { continue };
            durations.push([a.1, b.1, c.1, d.1]);
            questions.extend([a.0, b.0, c.0, d.0]);
        }
        let mut optima = Vec::new();
        for questions in questions.chunks(100) {
            let answer = judged(&python, &json!({ "paths": questions, "moves": [] }));
            let paths = answer["paths"].as_array().unwrap();
            optima.extend(paths.iter().map(|path| path["duration"].as_f64()));
        }
        for (level, tool) in TOOL.iter().enumerate() {
            let both = durations.iter().map(|line| line[level]).zip(optima.iter().skip(level).step_by(TOOL.len()));
            let both = both.filter_map(|(ours, theirs)| Some((ours, (*theirs)?)));
            let (mut ours, mut theirs): (Vec<f64>, Vec<f64>) = both.unzip();
            let mut ratios: Vec<f64> = ours.iter().zip(&theirs).map(|(ours, theirs)| ours / theirs).collect();
            let before = |line: &&[f64; 4]| level > 0 && line[level] > line[level - 1] + 1.5 * PERIOD.as_secs_f64();
            let longer = durations.iter().filter(before).count();
            let lines = ours.len();
            assert!(lines as f64 >= (1.0 - UNSOLVED) * durations.len() as f64, "{name}: toppra solved {lines}");
            let [median, optimum, ratio] = [&mut ours, &mut theirs, &mut ratios].map(|values| quantile(values, 0.5));
            let ninth = quantile(&mut ratios, 0.9);
            println!(
                "| {name} | {lines} | {}, {} | {median:.3} | {optimum:.3} | {ratio:.3} | {ninth:.3} | {longer} |",
                tool[0], tool[1]
            );
            assert!(ratio <= MEDIAN && longer == 0, "{name}, {tool:?}: {ratio}, {longer} lines are longer");
        }
    }
}
