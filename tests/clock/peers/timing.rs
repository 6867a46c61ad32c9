//! toppra judges the time-optimal motions of the controller, and Ruckig the jerk-limited ones.

use std::io::Write;
use std::process::{Command, Stdio};
use std::time::Duration;

use controller::generator::{
    Axes, AxesState, EffectorImage, EffectorState, EndSpeeds, Generator, JerkLimited, MotionLimits, Pace, PathTiming,
    Pose,
};
use controller::path::{JointPath, SplineEnds};
use controller::robot::Space;
use kit::draw::Draw;
use kit::mrroc;
use kit::processors;
use serde_json::{Value, json};

use super::{PATIENCE, python};

const AXES: usize = 7;

const PATHS: usize = 40;

const MOVES: usize = 200;

/// Segments of an even grid.
const SEGMENTS: u32 = 300;

/// Period by which the durations of the moves are rounded up. A jerk-limited motion has macrosteps of one servo period.
const PERIOD: Duration = Duration::from_millis(2);

fn axes(draw: &mut Draw, low: f64, high: f64) -> Axes {
    std::array::from_fn(|axis| if axis < AXES { draw.within(low, high) } else { 0.0 })
}

fn limits(draw: &mut Draw) -> MotionLimits {
    MotionLimits {
        max_velocity: axes(draw, 0.5, 2.0),
        max_acceleration: axes(draw, 1.0, 10.0),
        max_jerk: axes(draw, 10.0, 200.0),
    }
}

fn first(axes: &Axes) -> &[f64] {
    &axes[..AXES]
}

/// A timing with its path, for the script.
fn described(points: &[Axes], ends: &str, limits: &MotionLimits, timing: &PathTiming) -> Value {
    let (s, rate): (Vec<f64>, Vec<f64>) = timing.profile().unzip();
    json!({
        "points": points.iter().map(first).collect::<Vec<_>>(),
        "ends": ends,
        "max_velocity": first(&limits.max_velocity),
        "max_acceleration": first(&limits.max_acceleration),
        "s": s,
        "rate": rate,
    })
}

/// Duration of a jerk-limited motion in whole periods, s.
fn lasting(start: AxesState, acceleration: Axes, target: Axes, limits: MotionLimits) -> f64 {
    let mut motion = JerkLimited::new(Space::Joint, AXES, limits, &[target]).unwrap();
    let state = EffectorState { motors: start, joints: start, pose: Pose::identity() };
    let mut image = EffectorImage::standing(state);
    image.commanded_acceleration.joints = acceleration;
    assert_eq!(motion.pace(Pace { periods: 10, read_at: 8 }), Pace::PERIOD);
    let mut memory = motion.first_step(&image, PERIOD).unwrap().memory;
    let mut periods = 0;
    while !motion.terminal(&memory, &()) {
        memory = motion.next_step(&memory, &()).unwrap().memory;
        periods += 1;
    }
    PERIOD.as_secs_f64() * f64::from(periods)
}

/// Answer of the script.
pub(super) fn judged(python: &std::path::Path, asked: &Value) -> Value {
    let mut judge = Command::new("timeout")
        .args(["--signal=KILL", PATIENCE])
        .arg(python)
        .arg("-B")
        .arg(mrroc::root().join("tests/peers/timing.py"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("timeout runs");
    let mut input = judge.stdin.take().expect("it is piped");
    input.write_all(asked.to_string().as_bytes()).unwrap();
    drop(input);
    let output = judge.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn toppra_finds_the_same_durations_and_no_limit_exceeded_on_random_paths_of_seven_axes() {
    let test = "peers::timing::toppra_finds_the_same_durations_and_no_limit_exceeded_on_random_paths_of_seven_axes";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.9);
    let mut draw = Draw(11);
    let (mut asked, mut durations) = (Vec::new(), Vec::new());
    for number in 0..PATHS {
        let limits = limits(&mut draw);
        let points: Vec<Axes> = (0..4 + number % 6).map(|_| axes(&mut draw, -2.0, 2.0)).collect();
        let (ends, named) =
            if number % 2 == 0 { (SplineEnds::Natural, "natural") } else { (SplineEnds::NotAKnot, "not-a-knot") };
        let path = JointPath::through(AXES, &points, ends).unwrap();
        let node = |k: u32| path.length() * (f64::from(k) / f64::from(SEGMENTS));
        let grid: Vec<f64> = (0..=SEGMENTS).map(node).collect();
        let even = PathTiming::on_grid(path.clone(), &limits, EndSpeeds::default(), &grid).unwrap();
        let refined = PathTiming::optimal(path, &limits, EndSpeeds::default()).unwrap();
        for timing in [even, refined] {
            asked.push(described(&points, named, &limits, &timing));
            durations.push(timing.duration());
        }
    }
    let answer = judged(&python, &json!({ "paths": asked, "moves": [] }));
    let (mut shortest, mut longest, mut between): (f64, f64, f64) = (f64::INFINITY, 0.0, 0.0);
    for (number, (judged, ours)) in answer["paths"].as_array().unwrap().iter().zip(durations).enumerate() {
        let theirs = judged["duration"].as_f64().unwrap();
        let ratio = ours / theirs;
        assert!((ratio - 1.0).abs() < 0.02, "path {}: {ours} s, toppra {theirs} s", number / 2);
        (shortest, longest) = (shortest.min(ratio), longest.max(ratio));
        let at_nodes = judged["at_nodes"].as_f64().unwrap();
        assert!(at_nodes < 1.0 + 1e-6, "path {}: {at_nodes} times a limit at a node", number / 2);
        if number % 2 == 1 {
            between = between.max(judged["between"].as_f64().unwrap());
        }
    }
    println!("durations {shortest:.5} to {longest:.5} of toppra's; at most {between:.5} times a limit between nodes");
    assert!(between < 1.0 + 1e-3, "{between}");
}

#[test]
fn ruckig_finds_the_same_durations_of_jerk_limited_motions_of_seven_axes() {
    let test = "peers::timing::ruckig_finds_the_same_durations_of_jerk_limited_motions_of_seven_axes";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.9);
    let mut draw = Draw(12);
    let (mut asked, mut durations) = (Vec::new(), Vec::new());
    for number in 0..MOVES {
        let (limits, start, target) = (limits(&mut draw), axes(&mut draw, -2.0, 2.0), axes(&mut draw, -2.0, 2.0));
        // Half of the motions begin in motion.
        let share = if number % 2 == 0 { 0.0 } else { 0.5 };
        let (speed, push) = (axes(&mut draw, -share, share), axes(&mut draw, -share, share));
        let velocity: Axes = std::array::from_fn(|axis| speed[axis] * limits.max_velocity[axis]);
        let acceleration: Axes = std::array::from_fn(|axis| push[axis] * limits.max_acceleration[axis]);
        durations.push(lasting(AxesState::new(start, velocity), acceleration, target, limits));
        asked.push(json!({
            "position": first(&start),
            "velocity": first(&velocity),
            "acceleration": first(&acceleration),
            "target": first(&target),
            "max_velocity": first(&limits.max_velocity),
            "max_acceleration": first(&limits.max_acceleration),
            "max_jerk": first(&limits.max_jerk),
        }));
    }
    let answer = judged(&python, &json!({ "paths": [], "moves": asked }));
    let (mut shortest, mut longest): (f64, f64) = (f64::INFINITY, 0.0);
    for (number, (judged, ours)) in answer["moves"].as_array().unwrap().iter().zip(durations).enumerate() {
        let theirs = judged["duration"].as_f64().unwrap();
        let ratio = ours / theirs;
        assert!((ratio - 1.0).abs() < 0.01, "motion {number}: {ours} s, Ruckig {theirs} s");
        (shortest, longest) = (shortest.min(ratio), longest.max(ratio));
    }
    println!("{MOVES} motions, durations {shortest:.5} to {longest:.5} of Ruckig's");
}
