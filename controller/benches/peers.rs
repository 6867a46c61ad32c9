//! Computing times of forward and inverse kinematics compared with pinocchio in one run.
//!
//! `cargo bench -p mrroc-controller --bench peers` prints a table and one JSON object. pinocchio is the package `pin`
//! of PyPI, which `tests/run` installs in `target/peers`. The times of pinocchio are times of calls from Python. One
//! row gives the cost of such a call alone. The times of this project are times of calls from Rust. Most of the time
//! of pinocchio's inverse is spent in Python and NumPy.
//!
//! Inverse kinematics is a closed form here. With pinocchio it is Newton's method with damped least squares, to 1e-9.
//! Both get the same seed, 0.1 away from the posture in every joint: pinocchio as the start of the iteration, this
//! project to choose the branch. Each time is the minimum of many rounds,
//! which is the least disturbed measurement.

#![allow(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
#![expect(clippy::unwrap_used, reason = "a benchmark may panic")]

use std::hint::black_box;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, ExitCode, Stdio};

use can::clock;
use mrroc_controller::robot::{
    Irb6, Irb6Parameters, Irp6, Irp6Parameters, Irp6Track, Irp6TrackParameters, Joints, LinkKind, Polycrank,
    PolycrankParameters, Rnt, RntParameters, Robot,
};
use serde_json::{Value, json};

/// The Python interpreter, installed by `tests/run`.
const PYTHON: &str = "target/peers/bin/python";

/// Number of postures of each robot.
const POSTURES: usize = 12;

/// Time limit of forward kinematics, ns.
const FORWARD: f64 = 150.0;

/// Time limit of the joints from motors, ns.
const FROM_MOTORS: f64 = 2000.0;

/// Distance of a seed from its posture in each joint, rad or m.
const AWAY: f64 = 0.1;

struct Measured {
    name: &'static str,
    robot: Box<dyn Robot>,
    postures: Vec<Joints>,
    /// Time limit of inverse kinematics, ns.
    within: f64,
}

fn main() -> ExitCode {
    let robots = robots();
    let theirs = theirs(&robots);
    let call = theirs["call_ns"].as_f64().unwrap();
    println!("a call of pinocchio from Python that does next to nothing: {call:.0} ns");
    println!("ns          forward: ours, theirs; inverse: ours, theirs; joints from motors: ours");
    let mut rows = Vec::new();
    let mut holds = true;
    for (robot, theirs) in robots.iter().zip(theirs["robots"].as_array().unwrap()) {
        let (forward, inverse, from_motors) = (robot.forward(), robot.inverse(), robot.joints_from_motors());
        let number = |key: &str| theirs[key].as_f64().unwrap_or(f64::NAN);
        let slow = forward >= FORWARD || inverse >= robot.within || from_motors >= FROM_MOTORS;
        holds &= !slow;
        println!(
            "{:10} {forward:8.0} {:10.0} {inverse:8.0} {:10.0}  ({:3.1} steps, {} of {} converged) {from_motors:6.0}{}",
            robot.name,
            number("forward_ns"),
            number("inverse_ns"),
            number("steps"),
            theirs["converged"],
            theirs["asked"],
            if slow { " - TOO SLOW" } else { "" },
        );
        rows.push(json!({
            "robot": robot.name,
            "forward_ns": forward,
            "forward_within_ns": FORWARD,
            "inverse_ns": inverse,
            "inverse_within_ns": robot.within,
            "joints_from_motors_ns": from_motors,
            "joints_from_motors_within_ns": FROM_MOTORS,
            "pinocchio": theirs,
        }));
    }
    println!("{}", json!({ "python_call_ns": call, "kinematics": rows }));
    ExitCode::from(u8::from(!holds))
}

impl Measured {
    fn forward(&self) -> f64 {
        least(|| {
            for joints in &self.postures {
                black_box(self.robot.forward(black_box(joints)).unwrap());
            }
        }) / self.postures.len() as f64
    }

    fn inverse(&self) -> f64 {
        let asked: Vec<_> =
            self.postures.iter().map(|joints| (self.robot.forward(joints).unwrap(), seed(joints))).collect();
        for (pose, near) in &asked {
            self.robot.inverse(pose, near).unwrap();
        }
        least(|| {
            for (pose, near) in &asked {
                let _ = black_box(self.robot.inverse(black_box(pose), black_box(near)));
            }
        }) / asked.len() as f64
    }

    /// Computing time of the joints from the motors. The legs of the RNT need Newton's method.
    fn joints_from_motors(&self) -> f64 {
        let motors = self.postures.iter().map(|joints| self.robot.motors_from_joints(joints));
        let motors: Vec<_> = motors.map(Result::unwrap).collect();
        least(|| {
            for motors in &motors {
                black_box(self.robot.joints_from_motors(black_box(motors)).unwrap());
            }
        }) / motors.len() as f64
    }

    /// The links as joints of pinocchio, and the positions of these joints.
    fn described(&self) -> Value {
        let links = self.robot.links();
        let positions = |joints: &Joints| -> Vec<f64> {
            let position = |coupling: &[f64; 8]| joints.iter().zip(coupling).map(|(q, k)| q * k).sum();
            links.iter().map(|link| position(&link.coupling)).collect()
        };
        let described: Vec<_> = links
            .iter()
            .map(|link| {
                json!({
                    "name": link.name,
                    "kind": if link.kind == LinkKind::Prismatic { "prismatic" } else { "revolute" },
                    "position": link.parent_from_link.translation.vector.as_slice(),
                    "quaternion": link.parent_from_link.rotation.coords.as_slice(),
                    "axis": link.axis.as_slice(),
                })
            })
            .collect();
        let flange = self.robot.forward(&self.postures[0]).unwrap();
        let seeds: Vec<_> = self.postures.iter().map(|joints| positions(&seed(joints))).collect();
        json!({
            "name": self.name,
            "links": described,
            "postures": self.postures.iter().map(positions).collect::<Vec<_>>(),
            "seeds": seeds,
            "flange": flange.translation.vector.as_slice(),
        })
    }
}

/// Shortest time of one call of `once`, ns.
fn least(mut once: impl FnMut()) -> f64 {
    const ROUNDS: usize = 20_000;
    let round = |_| {
        let begin = clock::now();
        once();
        clock::now().since(begin).as_secs_f64() * 1e9
    };
    (0..ROUNDS).map(round).fold(f64::INFINITY, f64::min)
}

/// Present posture for the inverse: alternating offsets from the posture sought, joint by joint.
fn seed(joints: &Joints) -> Joints {
    let mut seed = *joints;
    for (axis, joint) in seed.iter_mut().enumerate() {
        *joint += if axis % 2 == 0 { AWAY } else { -AWAY };
    }
    seed
}

fn robots() -> [Measured; 5] {
    let made = |name, robot: Box<dyn Robot>, middle: &[f64], within| Measured {
        name,
        robot,
        postures: (0..POSTURES)
            .map(|number| {
                let sway = |axis: usize| 0.15 * (1.7 * number as f64 + 2.3 * axis as f64).sin();
                let joints: Vec<_> = (0..).zip(middle).map(|(axis, q)| q + sway(axis)).collect();
                Joints::new(&joints).unwrap()
            })
            .collect(),
        within,
    };
    let five = Irb6::new(&Irb6Parameters::irb6()).unwrap();
    let six = Irp6::new(&Irp6Parameters::irp6p()).unwrap();
    let track = Irp6Track::new(&Irp6TrackParameters::irp6ot()).unwrap();
    let rnt = Rnt::new(&RntParameters::nominal()).unwrap();
    let seven = Polycrank::new(&PolycrankParameters::polycrank()).unwrap();
    [
        made("irb6", Box::new(five), &[0.3, -1.5, 0.1, 0.4, 1.1], 500.0),
        made("irp6", Box::new(six), &[0.3, -1.5, 0.1, -0.2, 1.1, 0.6], 500.0),
        made("irp6-track", Box::new(track), &[0.4, 0.3, -1.5, 0.1, -0.2, 1.1, 0.6], 1000.0),
        made("rnt", Box::new(rnt), &[0.1, -0.1, 0.95, 0.4, 1.1, 0.6], 1000.0),
        made("polycrank", Box::new(seven), &[0.3, 1.2, -0.7, 0.4, 1.3, -0.6, 0.2], 1000.0),
    ]
}

fn theirs(robots: &[Measured]) -> Value {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let mut python = Command::new(root.join(PYTHON))
        .args(["-B", "tests/peers/bodies_speed.py"])
        .current_dir(root)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("`tests/run` makes target/peers");
    let asked: Vec<_> = robots.iter().map(Measured::described).collect();
    let mut stdin = python.stdin.take().unwrap();
    stdin.write_all(json!(asked).to_string().as_bytes()).unwrap();
    drop(stdin);
    let output = python.wait_with_output().unwrap();
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}
