//! SciPy judges the splines of the controller.

use std::io::Write;
use std::process::{Command, Stdio};

use controller::path::{BSpline, Curve, SplineEnds};
use kit::draw::Draw;
use kit::mrroc;
use kit::processors;
use nalgebra::Vector3;
use serde_json::{Value, json};

use super::{PATIENCE, python};

/// Parameters at which a spline is compared, in each of its domains.
const PARAMETERS: u32 = 500;

fn number(draw: &mut Draw) -> f64 {
    draw.within(0.0, 1.0)
}

fn points(draw: &mut Draw, count: usize) -> Vec<Vector3<f64>> {
    (0..count).map(|_| Vector3::from_fn(|_, _| number(draw))).collect()
}

/// A spline with its values, for the script.
fn described(spline: &BSpline, through: &Value) -> Value {
    let (first, last) = spline.domain();
    let at = |k: u32| first + (last - first) * f64::from(k) / f64::from(PARAMETERS);
    let parameters: Vec<f64> = (0..=PARAMETERS).map(at).collect();
    let rows =
        |derivative: usize| -> Vec<[f64; 3]> { parameters.iter().map(|&u| spline.at(u)[derivative].into()).collect() };
    let controls: Vec<[f64; 3]> = spline.controls().iter().map(|&control| control.into()).collect();
    json!({
        "through": through,
        "knots": spline.knots(),
        "controls": controls,
        "parameters": parameters,
        "values": [rows(0), rows(1), rows(2)],
        "length": Curve::spline(spline.clone()).unwrap().length(),
    })
}

#[test]
fn scipy_finds_the_same_splines_derivatives_and_lengths() {
    let test = "peers::splines::scipy_finds_the_same_splines_derivatives_and_lengths";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.9);
    let mut draw = Draw(7);
    let mut splines = Vec::new();
    for count in [4, 5, 9, 40] {
        let mut knots: Vec<f64> = (0..count + 4).map(|_| number(&mut draw)).collect();
        knots.sort_by(f64::total_cmp);
        splines.push(described(&BSpline::new(knots, points(&mut draw, count)).unwrap(), &Value::Null));
    }
    let letter = [(0, 0), (5, 12), (10, 0), (15, 12), (20, 0), (30, 6), (36, 0), (30, -6), (24, 0)];
    let letter = letter.map(|(x, y)| Vector3::new(f64::from(x), f64::from(y), 0.0) * 1e-3).to_vec();
    for points in [letter, points(&mut draw, 4), points(&mut draw, 17), points(&mut draw, 60)] {
        let [start, end] = [points[1] - points[0], points[0] - points[2]];
        let clamped = SplineEnds::Clamped { start, end };
        for ends in [SplineEnds::Averaged, SplineEnds::NotAKnot, SplineEnds::Natural, clamped] {
            let condition = match ends {
                SplineEnds::Averaged => json!("averaged"),
                SplineEnds::NotAKnot => json!("not-a-knot"),
                SplineEnds::Natural => json!("natural"),
                SplineEnds::Clamped { start, end } => json!([<[f64; 3]>::from(start), <[f64; 3]>::from(end)]),
            };
            let data: Vec<[f64; 3]> = points.iter().map(|&point| point.into()).collect();
            let through = json!({ "points": data, "ends": condition });
            splines.push(described(&BSpline::through(&points, ends).unwrap(), &through));
        }
    }
    let mut judge = Command::new("timeout")
        .args(["--signal=KILL", PATIENCE])
        .arg(python)
        .arg("-B")
        .arg(mrroc::root().join("tests/peers/splines.py"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("timeout runs");
    let mut splines_out = judge.stdin.take().expect("it is piped");
    splines_out.write_all(json!(splines).to_string().as_bytes()).unwrap();
    drop(splines_out);
    let judged = judge.wait_with_output().unwrap();
    let complained = String::from_utf8_lossy(&judged.stderr);
    assert!(judged.status.success(), "{complained}");
    print!("{}", String::from_utf8_lossy(&judged.stdout));
}
