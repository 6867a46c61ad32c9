//! Path error of the flange of an IRp-6 with all six loops closed by the servo. The tests compare the robot's own
//! regulators with and without feed-forward. The error is measured at the motors, not at their encoders.

use std::f64::consts::FRAC_PI_2;
use std::sync::mpsc::{self, Receiver, Sender};

use can::Instant;
use controller::robot::{Irp6, Irp6Parameters, Joints, Mass, Motors, Robot, Weight};
use drive::{AxisCommand, DriveGroup};
use hil::plant::{Irp6Axis, Mechanism, MechanismConfig};
use nalgebra::{Isometry3, Point3, Vector3};
use servo::{FeedForward, MAX_AXES, Macrostep, Order, Phase};

use super::motors::{ByCurrent, Motor, Regression, physical};
use super::{DT, Group, Running, letter, original, regression_motor, servo};
use crate::regression::Trapezoid;

const AXES: usize = 6;

/// Number of cycles at rest before and after a motion.
const REST: usize = 500;

#[derive(Clone, Copy, Debug)]
enum Plant {
    /// The motors emulated by the robot's own software, in ten steps per period.
    Regression,
    /// The motors of the physical plant with inertia, ripple and limits, without weight and dry friction.
    Weightless,
    /// The complete physical plant under the links of the whole arm.
    Physical,
    /// The complete physical plant. The controller knows only four fifths of its masses and of its dry friction.
    Misjudged,
}

/// A motor that reports its shaft angle at each sample.
struct Watched {
    motor: Box<dyn Motor>,
    angles: Sender<f64>,
}

impl Motor for Watched {
    fn angle(&self) -> f64 {
        self.motor.angle()
    }

    fn run(&mut self, input: f64) {
        self.angles.send(self.motor.angle()).expect("it is watched");
        // Drives receive whole milliamperes.
        let milliampere = 1e-3 * 0.105;
        self.motor.run((input / milliampere).trunc() * milliampere);
    }
}

/// Path errors of the flange, m: distance from the nearest point of the path, and from the commanded position at that
/// time.
#[derive(Clone, Copy, Debug)]
struct Errors {
    contour: Figures,
    timed: Figures,
}

#[derive(Clone, Copy, Debug, Default)]
struct Figures {
    rms: f64,
    max: f64,
}

impl Figures {
    fn of(errors: impl ExactSizeIterator<Item = f64> + Clone) -> Self {
        let count = errors.len() as f64;
        Self { rms: (errors.clone().map(|e| e * e).sum::<f64>() / count).sqrt(), max: errors.fold(0.0, f64::max) }
    }
}

fn robot() -> Irp6 {
    Irp6::new(&Irp6Parameters::irp6p()).unwrap()
}

/// The letter, drawn with the tool pointing down in front of the robot, its strokes towards the column. The height has
/// little influence: between 0.1 and 0.4 m the results agree within 3 %.
fn letter(feed: f64, acceleration: f64) -> Vec<Motors> {
    let robot = robot();
    let mut near = Joints::new(&[0.0, -FRAC_PI_2, 0.0, 0.0, 3.0 * FRAC_PI_2, 0.0]).unwrap();
    let down = robot.forward(&near).unwrap().rotation;
    letter::points(feed, acceleration, DT)
        .into_iter()
        .map(|point| {
            let at = Vector3::new(0.85 - point.y, point.x - 0.018, 0.2);
            let pose = Isometry3::from_parts(at.into(), down);
            near = *robot.inverse(&pose, &near).unwrap().preferred();
            robot.motors_from_joints(&near).unwrap()
        })
        .collect()
}

/// Motion of all joints between two poses, rest to rest, as fast as the limits of the generators allow: 1.5 rad/s and 7
/// rad/s² for every joint, 200 rad/s and 150 rad/s² for every motor.
fn at_the_limits() -> Vec<Motors> {
    let robot = robot();
    let from = [-0.6, -1.9, -0.2, -0.4, 1.0, -0.5];
    let to = [0.6, -1.2, 0.4, 0.5, 2.2, 0.6];
    let joints = |s: f64| -> [f64; AXES] { std::array::from_fn(|i| from[i] + s * (to[i] - from[i])) };
    let motors = |s: f64| {
        let joints = Joints::new(&joints(s)).unwrap();
        robot.motors_from_joints(&joints).unwrap()
    };
    let (mut velocity, mut acceleration) = (f64::INFINITY, f64::INFINITY);
    for k in 0..100 {
        let (s, ds) = (f64::from(k) / 100.0, 0.01);
        let (here, there) = (motors(s), motors(s + ds));
        for axis in 0..AXES {
            let joint = (to[axis] - from[axis]).abs();
            let motor = (there[axis] - here[axis]).abs() / ds;
            velocity = velocity.min(1.5 / joint).min(200.0 / motor);
            acceleration = acceleration.min(7.0 / joint).min(150.0 / motor);
        }
    }
    let motion = Trapezoid { distance: 1.0, velocity, acceleration };
    let velocity = velocity.min(acceleration.sqrt());
    let motion = Trapezoid { velocity, ..motion };
    let count = (motion.duration() / DT).ceil() as u32;
    (0..=count).map(|k| motors(motion.at(f64::from(k) * DT))).collect()
}

fn flange(motors: &[f64; AXES]) -> Point3<f64> {
    let robot = robot();
    let motors = Motors::new(motors).unwrap();
    let joints = robot.joints_from_motors(&motors).unwrap();
    robot.forward(&joints).unwrap().translation.vector.into()
}

impl Plant {
    fn motor(self, axis: Irp6Axis, angle: f64, arm: &Mechanism) -> Box<dyn Motor> {
        match self {
            Self::Regression => Box::new(Regression::new(regression_motor(axis), 10, angle)),
            Self::Weightless => Box::new(ByCurrent::weightless(axis, angle)),
            Self::Physical | Self::Misjudged => Box::new(ByCurrent::mounted(axis, angle, arm)),
        }
    }

    /// Known torque demand of the motor, N·m, as feed-forward. The inertia is that of the pose of `arm`.
    fn feed_forward(self, axis: Irp6Axis, arm: &Mechanism) -> FeedForward {
        let (wut, motor) = (regression_motor(axis), physical(axis));
        match self {
            Self::Regression => {
                FeedForward { velocity: wut.viscous, acceleration: wut.inertia, ..FeedForward::default() }
            }
            Self::Weightless => {
                FeedForward { velocity: motor.viscous, acceleration: motor.inertia, ..FeedForward::default() }
            }
            Self::Physical | Self::Misjudged => {
                let load = arm.load(axis as usize);
                FeedForward {
                    velocity: motor.viscous,
                    acceleration: load.inertia,
                    coulomb: self.known() * motor.friction.coulomb,
                    stiction: Some(self.known() * motor.friction.stiction),
                    stribeck_velocity: Some(motor.friction.stribeck_velocity),
                    weight: Some(1.0),
                    ..FeedForward::default()
                }
            }
        }
    }

    /// Torques that hold the links along `path`, N·m.
    fn torques(self, path: &[Motors]) -> Vec<[f64; MAX_AXES]> {
        let robot = robot();
        let masses = Mass::IRP6.map(|link| Mass { mass: self.known() * link.mass, ..link });
        let weight = Weight::new(&robot, &masses, Mass::default(), [0.0, 0.0, 1.0]).unwrap();
        let torque = |motors: &Motors| match self {
            Self::Physical | Self::Misjudged => weight.torque(&robot, motors).unwrap(),
            Self::Regression | Self::Weightless => [0.0; MAX_AXES],
        };
        path.iter().map(torque).collect()
    }

    /// Known share of masses and dry friction.
    fn known(self) -> f64 {
        match self {
            Self::Misjudged => 0.8,
            Self::Regression | Self::Weightless | Self::Physical => 1.0,
        }
    }
}

/// Runs all of `path` with the robot's own regulators. The loops are closed in the order of the original software: a
/// sample takes effect in its own period.
fn track(plant: Plant, fed_forward: bool, path: &[Motors]) -> Errors {
    let arm = Mechanism::new(MechanismConfig::Irp6);
    let motors = Irp6Axis::ALL.map(|axis| plant.motor(axis, path[0][axis as usize], &arm));
    let mut angles = Vec::new();
    let mut configs = Vec::new();
    let mut groups: Vec<Box<dyn DriveGroup>> = Vec::new();
    for (axis, motor) in Irp6Axis::ALL.into_iter().zip(motors) {
        let mut rig = original(axis, |_| unreachable!("the motor is there"));
        if fed_forward {
            rig.host.feed_forward = plant.feed_forward(axis, &arm);
        }
        let mut config = rig.axis_config();
        config.group = axis as usize;
        configs.push(config);
        let (sender, receiver) = mpsc::channel();
        angles.push(receiver);
        groups.push(Box::new(Group {
            motor: Box::new(Watched { motor, angles: sender }),
            counts: rig.counts,
            delay: rig.delay,
            sample: 0,
            last: 0,
            command: AxisCommand::Off,
        }));
    }
    let (servo, link) = servo(configs, groups);
    let torques = if fed_forward { plant.torques(path) } else { vec![[0.0; MAX_AXES]; path.len()] };
    run(servo, link, &angles, path, &torques)
}

fn run(
    mut servo: servo::Servo,
    link: servo::EffectorLink,
    angles: &[Receiver<f64>],
    path: &[Motors],
    torques: &[[f64; MAX_AXES]],
) -> Errors {
    let records = servo.record(1);
    let mut running = Running { servo, link, records, now: Instant::ZERO, start: 0.0 };
    running.link.orders.push(Order::Enable).unwrap();
    running.run(REST);
    assert_eq!(running.phase(), Phase::Standing);
    angles.iter().for_each(|angles| angles.try_iter().for_each(drop));
    let point = |k: usize| k.saturating_sub(REST).min(path.len() - 1);
    let at = |k: usize| path[point(k)].padded();
    let length = path.len() + 2 * REST;
    let mut errors = Vec::new();
    let mut commanded = Vec::new();
    let mut moved = Vec::new();
    for k in 0..length {
        let (before, here, after) = (at(k.max(1) - 1), at(k), at(k + 1));
        let step = Macrostep {
            number: k as u64 + 1,
            steps: 1,
            report_at: 1,
            position: here,
            velocity: std::array::from_fn(|axis| (after[axis] - before[axis]) / (2.0 * DT)),
            acceleration: None,
            torque: torques[point(k)],
            law: None,
            continues_law: false,
        };
        running.link.orders.push(Order::Move(step)).unwrap();
        running.run(1);
        assert_eq!(running.servo.fault(0), None);
        let truth: [f64; AXES] = std::array::from_fn(|axis| angles[axis].recv().unwrap());
        commanded.push(flange(&here[..AXES].try_into().unwrap()));
        moved.push(flange(&truth));
    }
    for k in REST..length - REST {
        // A command of one cycle is measured in the next cycle.
        let timed = (moved[k + 1] - commanded[k]).norm();
        let contour = commanded[k - 100..k + 100]
            .windows(2)
            .map(|ends| distance(&moved[k + 1], &ends[0], &ends[1]))
            .fold(f64::INFINITY, f64::min);
        errors.push((contour, timed));
    }
    Errors { contour: Figures::of(errors.iter().map(|e| e.0)), timed: Figures::of(errors.iter().map(|e| e.1)) }
}

/// Distance from a point to the line through two others, m.
fn distance(point: &Point3<f64>, from: &Point3<f64>, to: &Point3<f64>) -> f64 {
    let (line, off) = (to - from, point - from);
    let part = (off.dot(&line) / line.norm_squared().max(1e-30)).clamp(0.0, 1.0);
    (off - part * line).norm()
}

/// Runs once, and prints the errors in µm.
fn print_track(name: &str, plant: Plant, fed_forward: bool, path: &[Motors]) -> Errors {
    let errors = track(plant, fed_forward, path);
    let Errors { contour, timed } = errors;
    let printed = [contour.rms, contour.max, timed.rms, timed.max].map(|error| error * 1e6);
    println!("{name} {plant:?}, {}: {printed:.1?}", if fed_forward { "fed forward" } else { "own" });
    errors
}

/// Runs without and with feed-forward.
fn both(name: &str, plant: Plant, path: &[Motors]) -> [Errors; 2] {
    [false, true].map(|fed_forward| print_track(name, plant, fed_forward, path))
}

#[test]
fn the_letter_is_drawn_as_by_the_original_loops_and_fed_forward_three_times_as_well() {
    // Feed, m/s; acceleration, m/s²; rms and largest contour error on the emulator of the original software, µm.
    let table =
        [(0.005, 0.05, 16.0, 67.0), (0.01, 0.05, 43.0, 121.0), (0.02, 0.1, 115.0, 243.0), (0.05, 0.5, 290.0, 573.0)];
    println!("µm: contour rms, largest, timed rms, largest");
    for (feed, acceleration, rms, max) in table {
        let path = letter(feed, acceleration);
        let [own, fed] = both(&format!("{feed} m/s"), Plant::Regression, &path);
        for (found, expected) in [(own.contour.rms, rms), (own.contour.max, max)] {
            let found = found * 1e6;
            assert!((found / expected - 1.0).abs() < 0.1, "{feed} m/s: {found:.1} for {expected} µm");
        }
        assert!(fed.contour.rms < own.contour.rms / 3.0, "{feed} m/s");
        assert!(fed.contour.max < own.contour.max / 3.0, "{feed} m/s");
        assert!(fed.contour.rms < 15e-6, "{feed} m/s");
    }
}

/// Remaining rms error: 5 to 8 µm for the column, 2 to 4 µm for each arm. A count of the encoders corresponds to 4 to 9
/// µm.
#[test]
fn the_letter_is_drawn_three_times_as_well_under_weight_and_friction_that_are_fed_forward() {
    println!("µm: contour rms, largest, timed rms, largest");
    for (feed, acceleration) in [(0.005, 0.05), (0.01, 0.05), (0.02, 0.1), (0.05, 0.5)] {
        let path = letter(feed, acceleration);
        let name = format!("{feed} m/s");
        let [own, fed] = both(&name, Plant::Physical, &path);
        assert!(fed.contour.rms < own.contour.rms / 3.0, "{name}");
        assert!(fed.contour.max < own.contour.max / 3.0, "{name}");
        assert!(fed.contour.rms < 15e-6, "{name}");
        // Masses and friction of a real robot are not known this precisely.
        let fed = print_track(&name, Plant::Misjudged, true, &path);
        assert!(fed.contour.rms < own.contour.rms / 3.0, "{name}");
    }
}

#[test]
fn at_the_limits_feed_forward_leaves_a_third_of_what_velocity_and_acceleration_take() {
    println!("µm: contour rms, largest, timed rms, largest");
    let [own, fed] = both("limits", Plant::Weightless, &at_the_limits());
    assert!(fed.contour.rms < own.contour.rms / 3.0);
    assert!(fed.contour.max < own.contour.max / 3.0);
    assert!(fed.timed.rms < own.timed.rms / 3.0);
    assert!(fed.timed.max < own.timed.max / 3.0);
}

#[test]
fn at_the_limits_feed_forward_leaves_a_third_of_what_weight_and_friction_take_too() {
    println!("µm: contour rms, largest, timed rms, largest");
    let [own, fed] = both("limits", Plant::Physical, &at_the_limits());
    assert!(fed.contour.rms < own.contour.rms / 3.0);
    assert!(fed.contour.max < own.contour.max / 3.0);
    assert!(fed.timed.rms < own.timed.rms / 3.0);
    assert!(fed.timed.max < own.timed.max / 3.0);
    print_track("limits", Plant::Misjudged, true, &at_the_limits());
}
