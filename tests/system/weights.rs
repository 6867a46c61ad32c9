//! Weight of the emulated robots and their payloads, computed from the torques in the record of a run.
//!
//! An axis moves to and fro over the same distance with the same velocities. In the mean of its torques, dry friction,
//! viscous friction and acceleration cancel. The remaining torque is the torque that holds the weight.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::fs;

use ::mrroc::cell::{Cell, EmulatedPayload, Instruction, JointGenerator, Joints, Parameters};
use controller::robot::RntParameters;
use kit::mrroc::{Directory, mrroc, shorten};
use kit::refusals::refused;

const G: f64 = 9.81;

/// Entries of one axis in a record: time, s, whether the axis moves, and torque, N·m.
type Row = (f64, bool, f64);

type Alteration = fn(&mut Cell);

const AS_IT_IS: Alteration = |_| {};

/// Moves through the poses in order. Every motion lasts 4 s.
fn run(example: &str, alter: Alteration, axis: &str, poses: &[Vec<f64>], payloads: &[EmulatedPayload]) -> Vec<Row> {
    let directory = Directory::new();
    let cell = directory.cell(example, |cell| {
        alter(cell);
        shorten(cell);
        let joints = |pose: &Vec<f64>| {
            Instruction::Joints(Joints {
                poses: vec![pose.clone()],
                generator: JointGenerator::JerkLimited,
                velocity: 1.0,
                acceleration: 1.0,
                duration: Some(4.0),
            })
        };
        cell.robot[0].program = poses.iter().map(joints).collect();
        cell.robot[0].emulated_payload = payloads.to_vec();
    });
    let record = directory.path("weights.csv");
    let run =
        mrroc(["run".as_ref(), cell.as_os_str(), "--bench=lockstep".as_ref(), "--record".as_ref(), record.as_os_str()]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let record = fs::read_to_string(record).unwrap();
    let mut lines = record.lines();
    let columns: Vec<_> = lines.next().unwrap().split(',').collect();
    let column = |name| columns.iter().position(|it| *it == name).unwrap();
    let (time, name, phase, torque) = (column("time_s"), column("axis"), column("phase"), column("torque_nm"));
    let rows = lines.map(|line| line.split(',').collect::<Vec<_>>());
    rows.filter(|row| row[name] == axis)
        .map(|row| {
            let number = |at: usize| row[at].parse::<f64>().unwrap();
            (number(time), row[phase] == "Moving", number(torque))
        })
        .collect()
}

/// Torque that holds the weight, N·m: the mean over the middle halves of two motions, forward and back.
fn held(there_and_back: &[&[Row]]) -> f64 {
    let [there, back] = there_and_back else { panic!("{} motions", there_and_back.len()) };
    let mean = |rows: &[Row]| {
        let middle = &rows[rows.len() / 4..rows.len() - rows.len() / 4];
        middle.iter().map(|row| row.2).sum::<f64>() / middle.len() as f64
    };
    0.5 * (mean(there) + mean(back))
}

/// The motions of an axis.
fn motions(rows: &[Row]) -> Vec<&[Row]> {
    rows.chunk_by(|one, next| one.1 == next.1).filter(|rows| rows[0].1).collect()
}

fn check(found: f64, expected: f64, what: &str) {
    let near = 0.002 + 0.015 * expected.abs();
    println!("{what}: {found:.4} N·m for {expected:.4}");
    assert!((found - expected).abs() < near, "{what}: {found} N·m for {expected}");
}

/// Ratio of motor angle to joint angle for a ball screw, from the constants of its length, mm: L² = s + c cos + n sin.
fn screw(squared: f64, cosine: f64, sine: f64, angle: f64) -> f64 {
    let (sin, cos) = angle.sin_cos();
    let length = (squared + cosine * cos + sine * sin).sqrt();
    (sine * cos - cosine * sin) / (2.0 * length) * TAU / 5.0
}

fn lower_gear(angle: f64) -> f64 {
    screw(77_895.25, 60_902.55, 29_346.68, angle)
}

fn upper_gear(angle: f64) -> f64 {
    screw(77_895.25, -44_100.0, 51_240.0, angle)
}

#[test]
fn axes_of_every_robot_hold_what_its_masses_weigh() {
    // IRp-6: lower arm 12 kg, 0.20 m from the shoulder; upper arm 14 kg, 0.25 m from the elbow; at its end wrist 4 kg
    // and gripper 1.35 kg. The lower arm tilts up to 30° from the vertical.
    let angle = -60_f64.to_radians();
    let lower = -G * angle.cos() * (12.0 * 0.20 + 19.35 * 0.455) / lower_gear(angle);
    let upper = -G * (14.0 * 0.25 + 5.35 * 0.67) / upper_gear(0.0);
    // RNT: 42 kg on three legs. The tilt of the legs follows from the difference between the radii of base and
    // platform.
    let rho = 0.85_f64;
    let leg = -G * 42.0 / 3.0 * rho.hypot(0.19) / rho * 5e-3 / TAU;
    let bent = G * (4.0 * 0.05 + 3.0 * 0.175) * 0.5_f64.sin() / 100.0;
    // Polycrank with its first crank horizontal: the rods beyond the third axis, with distances from this axis.
    let crank = -G * (4.0 * 0.0755 + 3.5 * 0.2265 + 2.1 * 0.302) / 50.0;
    let leaning = |by: f64| vec![0.0, angle + by, 0.0, 0.0, 0.0];
    let level = |by: f64| vec![0.0, -FRAC_PI_2, by, 0.0, 0.0];
    let six = |mut pose: Vec<f64>| {
        pose.push(0.0);
        pose
    };
    let on_track = |pose: Vec<f64>| [vec![0.3], six(pose)].concat();
    let down = |by: f64| vec![0.0, 0.0, rho + by, 0.0, 0.0, 0.0];
    let aside = |by: f64| vec![0.0, 0.0, rho, 0.0, 0.5 + by, 0.0];
    let turned = |by: f64| vec![FRAC_PI_2, 0.0, by, 0.0, 0.0, 0.0, 0.0];
    let by = 0.03;
    // The result does not depend on the lengths of the legs at home.
    let unequal: Alteration = |cell| {
        let mut rnt = RntParameters::nominal();
        for (leg, length) in rnt.legs.iter_mut().zip([0.72, 0.75, 0.79]) {
            leg.length_at_home = length;
        }
        cell.robot[0].parameters = Some(Parameters::Rnt(rnt));
    };
    let cases = [
        ("irb6", AS_IT_IS, "lower-arm", [leaning(-by), leaning(by)], lower),
        ("irb6", AS_IT_IS, "upper-arm", [level(-by), level(by)], upper),
        ("irp6", AS_IT_IS, "lower-arm", [leaning(-by), leaning(by)].map(six), lower),
        ("irp6-track", AS_IT_IS, "upper-arm", [level(-by), level(by)].map(on_track), upper),
        ("rnt", AS_IT_IS, "leg-2", [down(-by), down(by)], leg),
        ("rnt", unequal, "leg-2", [down(-by), down(by)], leg),
        ("rnt", AS_IT_IS, "wrist-pitch", [aside(-by), aside(by)], bent),
        ("polycrank", AS_IT_IS, "q3", [turned(-by), turned(by)], crank),
    ];
    for (example, alter, axis, [from, to], expected) in cases {
        let rows = run(example, alter, axis, &[from.clone(), to, from], &[]);
        let held = held(&motions(&rows)[1..]);
        check(held, expected, &format!("{example}, {axis}"));
    }
}

#[test]
fn an_arm_holds_a_payload_from_when_it_takes_it_up_until_it_puts_it_down() {
    // The upper arm moves to and fro with the wrist horizontal. It rests for one motion of the flange between two
    // rounds.
    let pose = |by: f64, flange: f64| vec![0.2, 0.0, -FRAC_PI_2, by, 0.0, FRAC_PI_2, flange];
    let by = 0.03;
    let mut poses = vec![pose(-by, 0.0)];
    for flange in [0.1, 0.2, 0.3] {
        poses.extend([pose(by, flange - 0.1), pose(-by, flange - 0.1), pose(-by, flange)]);
    }
    let empty = run("irp6-track", AS_IT_IS, "upper-arm", &poses, &[]);
    let begins = |motion: usize| motions(&empty)[motion][0].0;
    let (up, down) = (begins(3) + 0.5, begins(6) + 0.5);
    let payload = |at_s, mass| EmulatedPayload { at_s, mass, centre: [0.0, 0.0, 0.1] };
    // The payloads may be listed in any order.
    let payloads = [payload(down, 0.0), payload(up, 6.0)];
    let carried = run("irp6-track", AS_IT_IS, "upper-arm", &poses, &payloads);
    let earlier = |rows: &[Row]| rows.iter().filter(|row| row.0 <= up).copied().collect::<Vec<_>>();
    assert_eq!(earlier(&carried), earlier(&empty));
    // The rods of the parallelogram keep the wrist horizontal. Only the distance to the pitch axis has an effect, not
    // the distance beyond it.
    let weight = -G * 6.0 * 0.67 / upper_gear(0.0);
    for (round, mass) in [(0, 0.0), (1, 1.0), (2, 0.0)] {
        let held = |rows: &[Row]| held(&motions(rows)[3 * round + 1..][..2]);
        let more = held(&carried) - held(&empty);
        check(more, mass * weight, &format!("round {round}"));
    }
}

#[test]
fn payloads_that_nobody_can_carry_are_refused_with_the_line() {
    let payload = |at_s, mass, centre| EmulatedPayload { at_s, mass, centre: [0.0, 0.0, centre] };
    let cases = [
        ("irp6-track", 0, payload(-1.0, 1.0, 0.0), "robot[0].emulated_payload[0].at_s"),
        ("irp6-track", 0, payload(1.0, -1.0, 0.0), "robot[0].emulated_payload[0].mass"),
        ("irp6-track", 0, payload(1.0, 1.0, 20.0), "robot[0].emulated_payload[0].centre[2]"),
        ("lab", 5, payload(1.0, 1.0, 0.0), "whose emulated axes carry no common load"),
    ];
    for (example, robot, payload, needle) in cases {
        let directory = Directory::new();
        let cell = directory.cell(example, |cell| {
            cell.robot[robot].emulated_payload.push(payload);
        });
        refused(&mrroc(["check".as_ref(), cell.as_os_str()]), &[needle]);
    }
}
