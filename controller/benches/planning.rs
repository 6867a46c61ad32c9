//! Computing times of time-optimal and jerk-limited planning of seven axes, compared with toppra and Ruckig in one run.
//!
//! `cargo bench -p mrroc-controller --bench planning` prints a table and one JSON object. The command fails if time-optimal
//! planning takes more than a tenth of toppra's time on the same grid, or jerk-limited planning more than Ruckig's time.
//! `tests/run` installs toppra and Ruckig in `target/peers`.
//!
//! Times of toppra and Ruckig are times of calls from Python, and times of this project are times of calls from Rust.
//! The solver of toppra is compiled code. Each time is the minimum of several rounds, which is the least disturbed
//! measurement. No time contains the construction of the spline.

#![allow(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
#![expect(clippy::unwrap_used, reason = "a benchmark may panic")]

use std::hint::black_box;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, ExitCode, Stdio};
use std::time::Duration;

use can::clock;
use mrroc_controller::generator::{
    Axes, AxesState, EffectorImage, EffectorState, EndSpeeds, Generator, JerkLimited, MotionLimits, PathTiming, Pose,
};
use mrroc_controller::path::{JointPath, SplineEnds};
use mrroc_controller::robot::Space;
use serde_json::{Value, json};

#[path = "../src/random.rs"]
mod random;

use random::Random;

/// The Python interpreter, installed by `tests/run`.
const PYTHON: &str = "target/peers/bin/python";
const AXES: usize = 7;
/// Segments of the grids.
const GRIDS: [u32; 3] = [100, 300, 1000];
/// Paths per grid, and way-points of a path.
const PATHS: usize = 10;
const WAY_POINTS: usize = 6;
const MOVES: usize = 50;
const ROUNDS: usize = 50;
/// Greatest time of time-optimal planning relative to that of toppra.
const WITHIN: f64 = 0.1;
/// Greatest time of jerk-limited planning relative to that of Ruckig.
const MOVES_WITHIN: f64 = 1.0;

fn axes(random: &mut Random, low: f64, high: f64) -> Axes {
    std::array::from_fn(|axis| if axis < AXES { random.within(low, high) } else { 0.0 })
}

fn limits(random: &mut Random) -> MotionLimits {
    MotionLimits {
        max_velocity: axes(random, 0.5, 2.0),
        max_acceleration: axes(random, 1.0, 10.0),
        max_jerk: axes(random, 10.0, 200.0),
    }
}

fn main() -> ExitCode {
    let mut random = Random(3);
    let (mut paths, mut ours, mut refined) = (Vec::new(), Vec::new(), Vec::new());
    for segments in GRIDS {
        for _ in 0..PATHS {
            let limits = limits(&mut random);
            let points: Vec<Axes> = (0..WAY_POINTS).map(|_| axes(&mut random, -2.0, 2.0)).collect();
            let path = JointPath::through(AXES, &points, SplineEnds::Natural).unwrap();
            let node = |k: u32| path.length() * (f64::from(k) / f64::from(segments));
            let grid: Vec<f64> = (0..=segments).map(node).collect();
            let rest = EndSpeeds::default();
            let timing = PathTiming::on_grid(path.clone(), &limits, rest, &grid).unwrap();
            ours.push(least(|| {
                black_box(PathTiming::on_grid(path.clone(), &limits, rest, black_box(&grid)).unwrap());
            }));
            refined.push(least(|| {
                black_box(PathTiming::optimal(path.clone(), black_box(&limits), rest).unwrap());
            }));
            let (s, rate): (Vec<f64>, Vec<f64>) = timing.profile().unzip();
            paths.push(json!({
                "points": points.iter().map(first).collect::<Vec<_>>(),
                "ends": "natural",
                "max_velocity": first(&limits.max_velocity),
                "max_acceleration": first(&limits.max_acceleration),
                "s": s,
                "rate": rate,
            }));
        }
    }
    let (mut moves, mut jerk_limited, rest) = (Vec::new(), Vec::new(), [0.0; AXES]);
    for _ in 0..MOVES {
        let (limits, start, target) = (limits(&mut random), axes(&mut random, -2.0, 2.0), axes(&mut random, -2.0, 2.0));
        let joints = AxesState::at_rest(start);
        let image = EffectorImage::standing(EffectorState { motors: joints, joints, pose: Pose::identity() });
        let mut motion = JerkLimited::new(Space::Joint, AXES, limits, &[target]).unwrap();
        jerk_limited.push(least(|| {
            black_box(motion.first_step(black_box(&image), Duration::from_millis(20)).unwrap());
        }));
        moves.push(json!({
            "position": first(&start),
            "velocity": rest,
            "acceleration": rest,
            "target": first(&target),
            "max_velocity": first(&limits.max_velocity),
            "max_acceleration": first(&limits.max_acceleration),
            "max_jerk": first(&limits.max_jerk),
        }));
    }
    let theirs = theirs(&json!({ "paths": paths, "moves": moves }));

    println!("µs, mean of {PATHS} paths of {AXES} axes through {WAY_POINTS} way-points");
    println!("segments      ours    toppra     ratio   refined grid");
    let mut rows = Vec::new();
    let mut holds = true;
    for (grid, segments) in GRIDS.into_iter().enumerate() {
        let range = grid * PATHS..(grid + 1) * PATHS;
        let (our, refined) = (mean(&ours[range.clone()]), mean(&refined[range.clone()]));
        let their = mean(&times(&theirs["paths"])[range]);
        let ratio = our / their;
        holds &= ratio <= WITHIN;
        let verdict = if ratio <= WITHIN { "" } else { " - TOO SLOW" };
        println!("{segments:8} {our:9.1} {their:9.1} {ratio:9.4} {refined:14.1}{verdict}");
        rows.push(json!({ "segments": segments, "ours_us": our, "toppra_us": their, "refined_us": refined }));
    }
    let (our, their) = (mean(&jerk_limited), mean(&times(&theirs["moves"])));
    let ratio = our / their;
    holds &= ratio <= MOVES_WITHIN;
    let verdict = if ratio <= MOVES_WITHIN { "" } else { " - TOO SLOW" };
    println!("jerk-limited {our:5.1}, Ruckig {their:.1}, ratio {ratio:.3}{verdict}");
    let moves = json!({ "ours_us": our, "ruckig_us": their });
    println!("{}", json!({ "time_optimal": rows, "within": WITHIN, "jerk_limited": moves }));
    ExitCode::from(u8::from(!holds))
}

fn first(axes: &Axes) -> &[f64] {
    &axes[..AXES]
}

fn mean(times: &[f64]) -> f64 {
    times.iter().sum::<f64>() / times.len() as f64
}

fn times(planned: &Value) -> Vec<f64> {
    planned.as_array().unwrap().iter().map(|it| it["time_us"].as_f64().unwrap()).collect()
}

/// Time of the fastest call, µs.
fn least(mut once: impl FnMut()) -> f64 {
    let round = |_| {
        let begin = clock::now();
        once();
        clock::now().since(begin).as_secs_f64() * 1e6
    };
    (0..ROUNDS).map(round).fold(f64::INFINITY, f64::min)
}

fn theirs(asked: &Value) -> Value {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let mut python = Command::new(root.join(PYTHON))
        .args(["-B", "tests/peers/timing.py"])
        .current_dir(root)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("`tests/run` makes target/peers");
    let mut stdin = python.stdin.take().unwrap();
    stdin.write_all(asked.to_string().as_bytes()).unwrap();
    drop(stdin);
    let output = python.wait_with_output().unwrap();
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}
