//! Weights and inertias calculated by hand from masses and lengths, and the motion of motors that carry such loads.

pub(super) mod chains;
mod coupled;
mod linkage;

use std::f64::consts::{FRAC_PI_2, TAU};

use super::{Load, Loaded, Mechanism, MechanismConfig};
use crate::plant::{AxisConfig, Demand, FrictionConfig, Irp6Axis, MotorConfig, Noise, PlantAxis, PlantConfig};

const G: f64 = 9.81;
const RNT: MechanismConfig = MechanismConfig::Rnt { home_lengths: [AxisConfig::RNT_HOME_LENGTH; 3] };
const ROBOTS: [MechanismConfig; 6] = [
    MechanismConfig::Irb6,
    MechanismConfig::Irp6,
    MechanismConfig::Irp6OnTrack,
    RNT,
    polycrank(false),
    polycrank(true),
];

/// Polycrank with all joint angles zero at home.
const fn polycrank(coupled: bool) -> MechanismConfig {
    MechanismConfig::Polycrank { coupled, at_home: [0.0; 7] }
}

/// A mechanism with its motors at these angles from home.
fn posed(config: &MechanismConfig, motors: &[f64]) -> Mechanism {
    let mechanism = Mechanism::new(config.clone());
    for (number, &motor) in motors.iter().enumerate() {
        let mount = mechanism.mount(number, 100.0).expect("it has the axis");
        mount.place(100.0 + motor);
    }
    mechanism
}

fn check(found: f64, expected: f64, what: &str) {
    let near = 1e-9 + 1e-5 * expected.abs();
    assert!((found - expected).abs() < near, "{what}: {found} for {expected}");
}

/// Length of the lower arm's screw, mm, and motor angle per joint angle, by the published constants.
fn lower_screw(angle: f64) -> (f64, f64) {
    let (sin, cos) = angle.sin_cos();
    let length = (77_895.25 + 60_902.55 * cos + 29_346.68 * sin).sqrt();
    let slope = (29_346.68 * cos - 60_902.55 * sin) / (2.0 * length);
    (length, slope * TAU / 5.0)
}

/// Motor angle per joint angle of the upper arm's screw at home, by the published constants.
fn upper_gear() -> f64 {
    51_240.0 / (2.0 * (77_895.25_f64 - 44_100.0).sqrt()) * TAU / 5.0
}

/// Motor angle of the lower arm from home, with the arm at an angle.
fn lower_motor(angle: f64) -> f64 {
    (lower_screw(angle).0 - lower_screw(-FRAC_PI_2).0) * TAU / 5.0
}

#[test]
fn irp6_weighs_what_its_masses_say() {
    // Torque of each axis at home. The gripper of 1.35 kg lies 150 mm beside the end of the wrist.
    let roll = G * 1.35 * 0.15 / 76.8;
    let home = [
        0.0,
        0.0,
        G * (14.0 * 0.25 + 5.35 * 0.67) / upper_gear(),
        -G * (4.0 * 0.095 + 1.35 * 0.19) / 128.0 - roll,
        roll,
        0.0,
    ];
    let level = posed(&MechanismConfig::Irp6, &[0.0; 6]);
    for (number, expected) in home.into_iter().enumerate() {
        check(level.load(number).torque, expected, "home");
    }
    // The lower arm leans out by 30 degrees. All other links keep their angle to the horizontal.
    let angle = -60_f64.to_radians();
    let leaning = posed(&MechanismConfig::Irp6, &[0.0, lower_motor(angle)]);
    let lower = G * 0.5 * (12.0 * 0.20 + 19.35 * 0.455) / lower_screw(angle).1;
    check(leaning.load(1).torque, lower, "lower arm");
    check(leaning.load(2).torque, home[2], "upper arm");
    check(leaning.load(3).torque, home[3], "pitch");
}

#[test]
fn irb6_holds_its_gripper_along_the_roll_axis() {
    let upper = G * (14.0 * 0.25 + 5.35 * 0.67) / upper_gear();
    let pitch = -G * (4.0 * 0.0475 + 1.35 * 0.245) / 128.0;
    // The weight does not depend on the roll angle. The sixth axis does not exist.
    for roll in [0.0, 40.0] {
        let level = posed(&MechanismConfig::Irb6, &[0.0, 0.0, 0.0, 0.0, roll]);
        for (number, expected) in [0.0, 0.0, upper, pitch, 0.0].into_iter().enumerate() {
            check(level.load(number).torque, expected, "home");
        }
        assert!(level.axes() == 5 && level.mount(5, 0.0).is_none());
    }
    // The wrist is lowered by a quarter turn, and the gripper hangs straight down.
    let quarter = 128.0 * FRAC_PI_2;
    let down = posed(&MechanismConfig::Irb6, &[0.0, 0.0, 0.0, -quarter]);
    check(down.load(3).torque, 0.0, "down");
}

#[test]
fn irp6_is_as_inert_as_its_masses_say() {
    let home = posed(&MechanismConfig::Irp6, &[0.0; 6]);
    let lower = 12.0 * (0.04 + 0.455 * 0.455 / 12.0) + 19.35 * 0.455 * 0.455;
    check(home.load(1).inertia, 1.8e-4 + lower / lower_screw(-FRAC_PI_2).1.powi(2), "lower arm");
    let column =
        45.0 * 0.04 + 14.0 * (0.0625 + 0.67 * 0.67 / 12.0) + 4.0 * 0.765 * 0.765 + 1.35 * (0.86 * 0.86 + 0.15 * 0.15);
    check(home.load(0).inertia, 1.7e-4 + column / 158.0_f64.powi(2), "column");
    let track = posed(&MechanismConfig::Irp6OnTrack, &[300.0, 20.0, 30.0]).load(0);
    let mass = 60.0 + 45.0 + 12.0 + 14.0 + 4.0 + 1.35;
    check(track.inertia, 4.5e-4 + mass / 1570.796_f64.powi(2), "track");
    check(track.torque, 0.0, "track");
}

#[test]
fn pitch_of_the_wrist_takes_its_roll_along() {
    let quarter = 76.8 * FRAC_PI_2;
    let lowered = (quarter / 128.0).cos();
    let roll = |pitch, roll| posed(&MechanismConfig::Irp6, &[0.0, 0.0, 0.0, pitch, roll]).load(4).torque;
    // When the pitch motor turns and the roll motor stands, the gripper turns upright.
    check(roll(quarter, 0.0), 0.0, "left behind");
    check(roll(quarter, quarter), G * 1.35 * 0.15 * lowered / 76.8, "taken along");
    // Conversely, a level gripper also loads the pitch motor, with the opposite sign.
    let without = posed(&MechanismConfig::Irp6, &[0.0, 0.0, 0.0, quarter]);
    let with = posed(&MechanismConfig::Irp6, &[0.0, 0.0, 0.0, quarter, quarter]);
    let straight = -G * (4.0 * 0.095 + 1.35 * 0.19) * lowered / 128.0;
    check(with.load(3).torque, straight - with.load(4).torque, "pitch with the gripper level");
    // The raised wrist carries the gripper upright, so that the gripper leans back over the pitch axis. Its weight
    // then helps to lift the wrist.
    let upright = straight + G * 1.35 * 0.15 * (quarter / 128.0).sin() / 128.0;
    check(without.load(3).torque, upright, "pitch with the gripper up");
}

#[test]
fn polycrank_weighs_what_its_masses_say() {
    // Axis 1 is level and x points up. The first crank is turned by a quarter turn, so that the arm is level.
    let quarter = 50.0 * FRAC_PI_2;
    let arms = [
        12.0 * -0.1495 + 9.0 * -0.209 + 7.0 * -0.119 + 4.0 * -0.0435 + 3.5 * 0.1075 + 2.1 * 0.183,
        9.0 * 0.09 + 7.0 * 0.18 + 4.0 * 0.2555 + 3.5 * 0.4065 + 2.1 * 0.482,
        4.0 * 0.0755 + 3.5 * 0.2265 + 2.1 * 0.302,
    ];
    let single = posed(&polycrank(false), &[quarter]);
    // Behind parallel cranks the motors set sums of joint angles: all three motors turn with the first joint.
    let coupled = posed(&polycrank(true), &[quarter, quarter, quarter]);
    for (number, arm) in arms.into_iter().enumerate() {
        check(single.load(number).torque, G * arm / 50.0, "joint");
        let next = arms.get(number + 1).copied().unwrap_or(0.0);
        check(coupled.load(number).torque, G * (arm - next) / 50.0, "coupled");
    }
    // At home the second group also turns about a level axis. Only the tool lies beside that axis, by 21.5 mm.
    let home = posed(&polycrank(false), &[]);
    for number in 0..3 {
        let arm = 4.0 * -0.06 + 3.5 * -0.178 + 1.5 * -0.266 + 0.6 * -0.296;
        check(home.load(number).torque, G * arm / 50.0, "home");
        check(home.load(3 + number).torque, G * 0.6 * -0.0215 / 50.0, "home");
    }
    check(home.load(6).torque, 0.0, "roll");
    // A machine with another home posture carries, at home, the load that the first machine has in the same posture.
    let at_home = [0.3, 1.5, -1.2, 0.4, 0.9, -0.5, 0.2];
    for coupled in [false, true] {
        let mut motors = at_home.map(|angle| 50.0 * angle);
        if coupled {
            for joint in [1, 2, 4, 5] {
                motors[joint] += motors[joint - 1];
            }
        }
        let away = posed(&polycrank(coupled), &motors);
        let home = Mechanism::new(MechanismConfig::Polycrank { coupled, at_home });
        for number in 0..7 {
            check(home.load(number).torque, away.load(number).torque, "at home");
        }
    }
}

#[test]
fn polycrank_is_as_inert_as_its_masses_say() {
    // Ends of the links at home, seen along axis 1.
    let ends = [
        (0.0, 0.0),
        (-0.299, 0.0),
        (-0.119, 0.0),
        (-0.119, 0.0),
        (0.032, -0.120),
        (0.183, -0.236),
        (0.183, -0.296),
        (0.183, -0.296),
    ];
    let masses = [12.0, 9.0, 7.0, 4.0, 3.5, 1.5, 0.6];
    let mut inertia = 0.0;
    for (mass, pair) in masses.into_iter().zip(ends.windows(2)) {
        let ((ax, ay), (bx, by)) = (pair[0], pair[1]);
        // Mean square distance of a rod: a third of the sum of the squares at its ends and the product of the two.
        inertia += mass * (ax * ax + ax * bx + bx * bx + ay * ay + ay * by + by * by) / 3.0;
    }
    let home = Mechanism::new(polycrank(false));
    check(home.load(0).inertia, 1e-4 + inertia / 2500.0, "axis 1");
}

#[test]
fn rnt_hangs_in_equal_shares_from_upright_legs() {
    let mechanism = Mechanism::new(RNT);
    let extension = (0.75_f64 * 0.75 - 0.19 * 0.19).sqrt();
    let share = |mass: f64| G * mass / 3.0 * 0.75 / extension * 5e-3 / TAU;
    for leg in 0..3 {
        check(mechanism.load(leg).torque, share(42.0), "leg");
    }
    mechanism.set_payload(8.0, [0.0, 0.0, 0.1]);
    for leg in 0..3 {
        check(mechanism.load(leg).torque, share(50.0), "loaded leg");
    }
    for wrist in 3..6 {
        check(mechanism.load(wrist).torque, 0.0, "wrist on the plumb line");
    }
    // The second axis of the wrist bends the tool aside.
    let bent = posed(&RNT, &[0.0, 0.0, 0.0, 0.0, 50.0]);
    let arm = (4.0 * 0.05 + 3.0 * 0.175) * 0.5_f64.sin();
    check(bent.load(4).torque, -G * arm / 100.0, "bent wrist");
}

#[test]
fn loads_of_another_pose_are_those_of_a_robot_that_stands_there() {
    for config in &ROBOTS {
        let motors: Vec<_> = (0..Mechanism::new(config.clone()).axes()).map(|number| 3.0 - number as f64).collect();
        let (here, there) = (posed(config, &vec![0.0; motors.len()]), posed(config, &motors));
        let before: Vec<_> = (0..motors.len()).map(|number| here.load(number)).collect();
        let angles: Vec<_> = motors.iter().map(|motor| 100.0 + motor).collect();
        for (number, load) in here.loads_at(&angles).into_iter().enumerate() {
            let expected = there.load(number);
            check(load.torque, expected.torque, &format!("{config:?}, torque of axis {number}"));
            check(load.inertia, expected.inertia, &format!("{config:?}, inertia of axis {number}"));
            assert_eq!(here.load(number), before[number], "{config:?}, axis {number} has not moved");
        }
    }
}

#[test]
fn payload_weighs_on_every_axis_that_lifts_it() {
    let angle = -60_f64.to_radians();
    let mechanism = posed(&MechanismConfig::Irp6, &[0.0, lower_motor(angle)]);
    let before: Vec<_> = (0..6).map(|axis| mechanism.load(axis).torque).collect();
    mechanism.set_payload(6.0, [0.0, 0.0, 0.25]);
    let roll = G * 6.0 * 0.25 / 76.8;
    let more = [
        0.0,
        G * 6.0 * 0.455 * 0.5 / lower_screw(angle).1,
        G * 6.0 * 0.67 / upper_gear(),
        -G * 6.0 * 0.19 / 128.0 - roll,
        roll,
        0.0,
    ];
    for (axis, more) in more.into_iter().enumerate() {
        let found = mechanism.load(axis).torque - before[axis];
        check(found, more, "with payload");
    }
    mechanism.set_payload(0.0, [0.0; 3]);
    for (axis, before) in before.into_iter().enumerate() {
        check(mechanism.load(axis).torque, before, "put down");
    }
}

/// The motor of an axis without friction and ripple.
fn smooth(mut config: AxisConfig, change: impl FnOnce(&mut MotorConfig)) -> AxisConfig {
    let PlantConfig::Physical(motor) = &mut config.plant else { unreachable!("the presets are physical") };
    motor.friction = FrictionConfig::NONE;
    motor.viscous = 0.0;
    motor.torque_ripple = 0.0;
    change(motor);
    config.edge_jitter = 0.0;
    config.brake = 0.0;
    config
}

#[test]
fn falling_arm_turns_its_height_into_speed() {
    let mechanism = Mechanism::new(MechanismConfig::Irp6);
    let config = AxisConfig {
        start_angle: 20.0,
        ..smooth(AxisConfig::irp6(Irp6Axis::LowerArm).with_home(0.0), |motor| motor.end_stops = None)
    };
    let mount = mechanism.mount(1, 0.0);
    let mut axis = PlantAxis::mounted(&config, 1, mount.as_ref());
    // Heights of the masses. The angle is searched for by means of the published constants.
    let height = |motor: f64| {
        let (mut low, mut high) = (-FRAC_PI_2, 0.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if lower_motor(middle) < motor {
                low = middle;
            } else {
                high = middle;
            }
        }
        -f64::sin(low) * G * (12.0 * 0.20 + 19.35 * 0.455)
    };
    let top = height(20.0);
    let mut fastest = 0.0_f64;
    while axis.angle() < 150.0 {
        let before = axis.angle();
        axis.advance(10, Demand::Off);
        let (speed, middle) = ((axis.angle() - before) / 1e-3, 0.5 * (axis.angle() + before));
        let moving = 0.5 * mechanism.load(1).inertia * speed * speed;
        let fallen = top - height(middle);
        assert!((moving - fallen).abs() < 0.02 * fallen + 0.02, "{moving} J of {fallen} at {middle} rad");
        fastest = fastest.max(speed);
    }
    // On the way the inertia has changed by a tenth because of the ratio. The assertion above covers this effect.
    assert!(fastest > 200.0, "{fastest} rad/s");
}

#[test]
fn changing_gears_keep_energy_and_folding_arms_momentum() {
    let load = |reflected, ratio| Loaded { links: Load { torque: 0.0, inertia: reflected }, turning: 2.0, ratio };
    let cases = [
        ((6.0, 1.0), (6.0, 1.0), 1.0),
        // Half the ratio gives four times the reflected inertia: 26 in place of 8 in total.
        ((6.0, 2.0), (24.0, 1.0), (8.0_f64 / 26.0).sqrt()),
        // Twice the inertia behind the same ratio.
        ((6.0, 2.0), (14.0, 2.0), 0.5),
    ];
    for ((reflected, ratio), (then, next), expected) in cases {
        let found = load(reflected, ratio).slows_by(&load(then, next));
        check(found, expected, "speed");
    }
}

#[test]
fn payload_taken_up_is_held_with_the_torque_it_weighs() {
    let home = AxisConfig::irp6(Irp6Axis::UpperArm).index_angle;
    let mechanism = Mechanism::new(MechanismConfig::Irp6);
    let config = AxisConfig { start_angle: home, ..smooth(AxisConfig::irp6(Irp6Axis::UpperArm), |_| {}) };
    let mount = mechanism.mount(2, home);
    let mut axis = PlantAxis::mounted(&config, 1, mount.as_ref());
    let mut held = |mass| {
        mechanism.set_payload(mass, [0.0, 0.0, 0.1]);
        let hold = Demand::Position { counts: 0.5, velocity: 0.0 };
        axis.advance(20_000, hold);
        let torques = (0..1000).map(|_| {
            axis.advance(10, hold);
            axis.feedback().torque
        });
        torques.sum::<f64>() / 1000.0
    };
    let (before, with, after) = (held(0.0), held(6.0), held(0.0));
    let more = -G * 6.0 * 0.67 / upper_gear();
    let empty = -G * (14.0 * 0.25 + 5.35 * 0.67) / upper_gear();
    assert!((before - empty).abs() < 0.005, "{before} N·m for {empty}");
    assert!((with - before - more).abs() < 0.005, "{} N·m more, not {more}", with - before);
    assert!((after - before).abs() < 0.005, "{after} N·m after {before}");
}

/// All axes of a robot with its presets, mounted.
fn axes(config: &MechanismConfig, seed: u64) -> (Mechanism, Vec<AxisConfig>, Vec<PlantAxis>) {
    let mechanism = Mechanism::new(config.clone());
    let configs: Vec<_> = (0..mechanism.axes()).filter_map(|number| preset(config, number)).collect();
    let mounted = configs.iter().enumerate().map(|(number, config)| {
        let mount = mechanism.mount(number, config.index_angle);
        PlantAxis::mounted(config, seed + number as u64, mount.as_ref())
    });
    let mounted = mounted.collect();
    (mechanism, configs, mounted)
}

fn preset(config: &MechanismConfig, number: usize) -> Option<AxisConfig> {
    match config {
        MechanismConfig::Irb6 | MechanismConfig::Irp6 => Some(AxisConfig::irp6(Irp6Axis::ALL[number])),
        MechanismConfig::Irp6OnTrack => AxisConfig::irp6_track(number),
        MechanismConfig::Rnt { .. } => AxisConfig::rnt(number),
        MechanismConfig::Polycrank { .. } => AxisConfig::polycrank(number),
        MechanismConfig::Chain(_) | MechanismConfig::Linkage(_) => None,
    }
}

#[test]
fn every_axis_of_every_robot_moves_with_all_others() {
    for robot in &ROBOTS {
        let (_, configs, mut axes) = axes(robot, 3);
        let mut worst = vec![0; axes.len()];
        let mut from = vec![0.0; axes.len()];
        for k in 0..2000 {
            // A sine with 5 rad/s² at the joints of the slowest axis: 12 rad forward and back.
            let t = f64::from(k + 1) * 2e-3;
            for (number, axis) in axes.iter_mut().enumerate() {
                let scale = f64::from(configs[number].counts_per_revolution) / TAU;
                let to = 12.0 * (1.0 - (3.0 * t).cos()) * scale;
                let velocity = (to - from[number]) / 2e-3;
                let counts = from[number];
                axis.advance(20, Demand::Position { counts, velocity });
                from[number] = to;
                assert_eq!(axis.feedback().trip, None, "{robot:?} axis {number} at {t} s");
                let error = (to - f64::from(axis.feedback().counts)) as i32;
                if k > 250 {
                    worst[number] = worst[number].max(error.abs());
                }
            }
        }
        assert!(worst.iter().all(|worst| *worst <= 20), "{robot:?}: {worst:?} counts");
    }
}

#[test]
fn loops_are_tuned_to_inertias_that_poses_keep_to() {
    let mut noise = Noise::new(11);
    for robot in &ROBOTS {
        let mechanism = Mechanism::new(robot.clone());
        for _ in 0..2000 {
            let together = 0.4 * noise.symmetric();
            for number in 0..mechanism.axes() {
                let config = preset(robot, number).expect("it has the axis");
                // Most of the travel, or any turn of the joint. RNT's legs stay near each other.
                let (low, high) = match (config.negative_limit, config.positive_limit) {
                    (Some(low), Some(high)) => (low.to, high.from),
                    _ => (-160.0, 160.0),
                };
                let share = match (robot, number) {
                    (MechanismConfig::Rnt { .. }, 0..=2) => together + 0.05 * noise.symmetric(),
                    _ => 0.4 * noise.symmetric(),
                };
                let angle = 0.5 * (low + high) + share * (high - low);
                let mount = mechanism.mount(number, config.index_angle);
                mount.expect("it has the axis").place(angle);
            }
            for number in 0..mechanism.axes() {
                let config = preset(robot, number).expect("it has the axis");
                let times = mechanism.load(number).inertia / config.amplifier.inertia;
                assert!((0.4..4.0).contains(&times), "{robot:?} axis {number}: {times} times what it is tuned for");
            }
        }
    }
}

#[test]
fn one_seed_and_one_order_are_one_run_bit_for_bit() {
    for robot in &ROBOTS {
        let run = |seed, reversed: bool| {
            let (mechanism, _, mut axes) = axes(robot, seed);
            for k in 0..300 {
                if k == 150 {
                    mechanism.set_payload(2.0, [0.01, 0.02, 0.1]);
                }
                let order = (0..axes.len()).map(|i| if reversed { axes.len() - 1 - i } else { i });
                for number in order.collect::<Vec<_>>() {
                    axes[number].advance(20, Demand::Velocity(20_000.0));
                }
            }
            axes.iter().map(|axis| axis.angle().to_bits()).collect::<Vec<_>>()
        };
        assert_eq!(run(5, false), run(5, false), "{robot:?}");
        assert_ne!(run(5, false), run(6, false), "{robot:?}");
    }
}

#[test]
fn regression_model_feels_nothing_and_is_felt() {
    let mechanism = Mechanism::new(MechanismConfig::Irp6);
    let config = AxisConfig::wut(Irp6Axis::Pitch);
    let mount = mechanism.mount(3, config.start_angle);
    let mut mounted = PlantAxis::mounted(&config, 1, mount.as_ref());
    let mut alone = PlantAxis::new(&config, 1);
    let before = mechanism.load(4).torque;
    for axis in [&mut mounted, &mut alone] {
        axis.advance(10_000, Demand::Velocity(30_000.0));
    }
    assert_eq!(mounted.angle().to_bits(), alone.angle().to_bits());
    assert!(mechanism.load(4).torque < 0.9 * before);
}
