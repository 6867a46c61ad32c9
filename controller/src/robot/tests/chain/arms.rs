//! Chains of the tests: public tables of Denavit and Hartenberg, the built-in robots as chains, and random chains.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{UnitQuaternion, Vector3};

use super::super::*;

/// A revolute joint with a unit ratio.
pub(super) fn joint(name: &str, parent_from_joint: Pose, limits: Limits) -> ChainJoint {
    ChainJoint {
        name: name.to_owned(),
        kind: if limits.is_continuous() { LinkKind::Continuous } else { LinkKind::Revolute },
        parent_from_joint,
        axis: [0.0, 0.0, 1.0],
        limits,
        velocity: None,
        effort: None,
        ratio: 1.0,
        joint_at_home: 0.0,
        motor_at_home: 0.0,
        body: None,
    }
}

pub(super) fn chain(joints: Vec<ChainJoint>, link_from_flange: Pose) -> ChainParameters {
    ChainParameters { joints, link_from_flange, up: [0.0, 0.0, 1.0], motors_from_joints: None, free_axis: None }
}

fn turned(axis: Vector3<f64>, angle: f64) -> Pose {
    Isometry3::rotation(axis * angle)
}

fn degrees(low: f64, high: f64) -> Limits {
    Limits { low: low.to_radians(), high: high.to_radians() }
}

/// Rows of the standard convention: offset of theta, d, a, alpha, and the range.
fn standard(rows: &[([f64; 4], Limits)]) -> ChainParameters {
    let mut before = Pose::identity();
    let mut joints = Vec::new();
    for (number, &([theta, d, a, alpha], limits)) in rows.iter().enumerate() {
        joints.push(joint(&format!("j{number}"), before, limits));
        before = turned(Vector3::z(), theta) * Isometry3::translation(a, 0.0, d) * turned(Vector3::x(), alpha);
    }
    chain(joints, before)
}

/// Rows of the modified convention: alpha and a of the previous link, offset of theta, d, and the range.
fn modified(rows: &[([f64; 4], Limits)], flange: f64) -> ChainParameters {
    let mut before = Pose::identity();
    let mut joints = Vec::new();
    for (number, &([alpha, a, theta, d], limits)) in rows.iter().enumerate() {
        let frame = before * turned(Vector3::x(), alpha) * Isometry3::translation(a, 0.0, 0.0);
        joints.push(joint(&format!("j{number}"), frame * turned(Vector3::z(), theta), limits));
        before = Isometry3::translation(0.0, 0.0, d);
    }
    chain(joints, before * Isometry3::translation(0.0, 0.0, flange))
}

/// Universal Robots: d1, a2, a3, d4, d5, d6.
fn universal([d1, a2, a3, d4, d5, d6]: [f64; 6]) -> ChainParameters {
    let limits = Limits { low: -TAU, high: TAU };
    let rows = [
        [0.0, d1, 0.0, FRAC_PI_2],
        [0.0, 0.0, a2, 0.0],
        [0.0, 0.0, a3, 0.0],
        [0.0, d4, 0.0, FRAC_PI_2],
        [0.0, d5, 0.0, -FRAC_PI_2],
        [0.0, d6, 0.0, 0.0],
    ];
    standard(&rows.map(|row| (row, limits)))
}

fn puma560() -> ChainParameters {
    standard(&[
        ([0.0, 0.6718, 0.0, FRAC_PI_2], degrees(-160.0, 160.0)),
        ([0.0, 0.0, 0.4318, 0.0], degrees(-110.0, 110.0)),
        ([0.0, 0.15005, 0.0203, -FRAC_PI_2], degrees(-135.0, 135.0)),
        ([0.0, 0.4318, 0.0, FRAC_PI_2], degrees(-266.0, 266.0)),
        ([0.0, 0.0, 0.0, -FRAC_PI_2], degrees(-100.0, 100.0)),
        ([0.0, 0.0, 0.0, 0.0], degrees(-266.0, 266.0)),
    ])
}

/// An arm with the proportions of the KUKA KR 16.
fn kr16() -> ChainParameters {
    standard(&[
        ([0.0, 0.675, 0.26, -FRAC_PI_2], degrees(-185.0, 185.0)),
        ([0.0, 0.0, 0.68, 0.0], degrees(-155.0, 35.0)),
        ([-FRAC_PI_2, 0.0, -0.035, FRAC_PI_2], degrees(-130.0, 154.0)),
        ([0.0, -0.67, 0.0, -FRAC_PI_2], degrees(-350.0, 350.0)),
        ([0.0, 0.0, 0.0, FRAC_PI_2], degrees(-130.0, 130.0)),
        ([0.0, -0.158, 0.0, 0.0], degrees(-350.0, 350.0)),
    ])
}

fn irb140() -> ChainParameters {
    standard(&[
        ([0.0, 0.352, 0.07, -FRAC_PI_2], degrees(-180.0, 180.0)),
        ([-FRAC_PI_2, 0.0, 0.36, 0.0], degrees(-100.0, 100.0)),
        ([0.0, 0.0, 0.0, -FRAC_PI_2], degrees(-220.0, 60.0)),
        ([0.0, 0.38, 0.0, FRAC_PI_2], degrees(-200.0, 200.0)),
        ([0.0, 0.0, 0.0, -FRAC_PI_2], degrees(-120.0, 120.0)),
        ([0.0, 0.065, 0.0, 0.0], degrees(-400.0, 400.0)),
    ])
}

pub(super) fn panda() -> ChainParameters {
    let wide = Limits { low: -2.8973, high: 2.8973 };
    let (h, on) = (FRAC_PI_2, |alpha, a, d| [alpha, a, 0.0, d]);
    modified(
        &[
            (on(0.0, 0.0, 0.333), wide),
            (on(-h, 0.0, 0.0), Limits { low: -1.7628, high: 1.7628 }),
            (on(h, 0.0, 0.316), wide),
            (on(h, 0.0825, 0.0), Limits { low: -3.0718, high: -0.0698 }),
            (on(-h, -0.0825, 0.384), wide),
            (on(h, 0.0, 0.0), Limits { low: -0.0175, high: 3.7525 }),
            (on(h, 0.088, 0.0), wide),
        ],
        0.107,
    )
}

fn iiwa14() -> ChainParameters {
    let (h, wide, narrow) = (FRAC_PI_2, degrees(-170.0, 170.0), degrees(-120.0, 120.0));
    let on = |alpha, d| [alpha, 0.0, 0.0, d];
    modified(
        &[
            (on(0.0, 0.36), wide),
            (on(-h, 0.0), narrow),
            (on(h, 0.42), wide),
            (on(h, 0.0), narrow),
            (on(-h, 0.4), wide),
            (on(-h, 0.0), narrow),
            (on(h, 0.126), degrees(-175.0, 175.0)),
        ],
        0.0,
    )
}

/// A six-axis arm with a bent wrist, whose axes do not meet: the table of the Kinova Jaco.
fn jaco() -> ChainParameters {
    let (d1, d2, d3, d4, d5, d6, e2) = (0.2755, 0.41, 0.2073, 0.0741, 0.0741, 0.16, 0.0098);
    let (aa, endless) = (PI / 6.0, Limits::CONTINUOUS);
    let part = aa.sin() / (2.0 * aa).sin();
    standard(&[
        ([0.0, d1, 0.0, FRAC_PI_2], endless),
        ([-FRAC_PI_2, 0.0, d2, PI], degrees(-133.0, 133.0)),
        ([FRAC_PI_2, -e2, 0.0, FRAC_PI_2], degrees(-161.0, 161.0)),
        ([0.0, -(d3 + part * d4), 0.0, 2.0 * aa], endless),
        ([0.0, -part * (d4 + d5), 0.0, 2.0 * aa], endless),
        ([0.0, -(part * d5 + d6), 0.0, PI], endless),
    ])
}

fn prismatic(name: &str, parent_from_joint: Pose, axis: [f64; 3], low: f64, high: f64) -> ChainJoint {
    ChainJoint { kind: LinkKind::Prismatic, axis, ..joint(name, parent_from_joint, Limits { low, high }) }
}

fn scara() -> ChainParameters {
    let on = Isometry3::translation;
    let joints = vec![
        joint("shoulder", on(0.0, 0.0, 0.4), degrees(-130.0, 130.0)),
        joint("elbow", on(0.35, 0.0, 0.0), degrees(-140.0, 140.0)),
        prismatic("quill", on(0.3, 0.0, 0.05), [0.0, 0.0, -1.0], 0.0, 0.2),
        joint("roll", turned(Vector3::x(), PI), degrees(-360.0, 360.0)),
    ];
    chain(joints, on(0.02, 0.01, 0.05))
}

/// Three linear axes, and `wrist` revolute axes, up to three.
fn cartesian(wrist: usize) -> ChainParameters {
    let on = Isometry3::translation;
    let mut joints = vec![
        prismatic("x", on(0.0, 0.0, 1.0), [1.0, 0.0, 0.0], -0.5, 1.5),
        prismatic("y", Pose::identity(), [0.1, 1.0, 0.0], -0.6, 0.6),
        prismatic("z", Pose::identity(), [0.0, 0.0, -1.0], 0.0, 0.8),
    ];
    let turning = [
        joint("yaw", Pose::identity(), degrees(-200.0, 200.0)),
        joint("pitch", on(0.1, 0.0, -0.1) * turned(Vector3::x(), FRAC_PI_2), degrees(-110.0, 110.0)),
        joint("roll", on(0.0, 0.05, 0.0) * turned(Vector3::y(), 1.2), degrees(-300.0, 300.0)),
    ];
    joints.extend(turning.into_iter().take(wrist));
    chain(joints, on(0.05, 0.0, 0.1))
}

/// A spherical wrist behind three axes: translations from axis to axis, and the rotations of the frames of axes 1 and 2
/// about their x axes.
fn shoulder(frames: [[f64; 3]; 3], [first, second]: [f64; 2]) -> ChainParameters {
    let on = |[x, y, z]: [f64; 3]| Isometry3::translation(x, y, z);
    let wide = Limits { low: -3.0, high: 3.0 };
    let [upper, lower, wrist] = frames;
    let frames = [
        on([0.0, 0.0, 0.3]),
        on(upper) * turned(Vector3::x(), first),
        on(lower) * turned(Vector3::x(), second),
        on(wrist) * turned(Vector3::x(), 1.0),
        turned(Vector3::x(), -FRAC_PI_2),
        turned(Vector3::x(), 1.2),
    ];
    let joints = frames.iter().enumerate().map(|(number, frame)| joint(&format!("j{number}"), *frame, wide));
    chain(joints.collect(), on([0.02, 0.01, 0.1]))
}

/// A built-in robot as a chain of its links. The motors of the chain are the joints of the robot.
pub(super) fn built_in(robot: &dyn Robot) -> ChainParameters {
    let links = robot.links();
    let axes = links.len();
    let coupling = DMatrix::from_fn(axes, axes, |row, column| links[row].coupling[column]);
    let inverse = coupling.try_inverse().unwrap();
    let joints = links.iter().map(|link| ChainJoint {
        kind: link.kind,
        axis: link.axis.into_inner().into(),
        ..joint(&link.name, link.parent_from_link, link.limits)
    });
    let rows = (0..axes).map(|row| inverse.row(row).iter().copied().collect());
    ChainParameters { motors_from_joints: Some(rows.collect()), ..chain(joints.collect(), robot.link_from_flange()) }
}

/// Chains with public numbers, and the built-in robots.
pub(super) fn public() -> Vec<(&'static str, ChainParameters)> {
    vec![
        ("ur3", universal([0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819])),
        ("ur5", universal([0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823])),
        ("ur10", universal([0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922])),
        ("puma560", puma560()),
        ("kr16", kr16()),
        ("irb140", irb140()),
        ("crossing", shoulder([[0.0; 3], [0.4, 0.05, 0.1], [0.05, 0.3, 0.1]], [-1.3, 0.8])),
        ("upright", shoulder([[0.4, 0.0, 0.1], [0.3, 0.02, 0.1], [0.05, 0.3, 0.1]], [0.0, 1.2])),
        ("crossing elbow", shoulder([[0.1, 0.2, 0.1], [0.0; 3], [0.05, 0.3, 0.1]], [-1.3, 0.8])),
        ("panda", panda()),
        ("iiwa14", iiwa14()),
        ("jaco", jaco()),
        ("scara", scara()),
        ("gantry", cartesian(0)),
        ("gantry and yaw", cartesian(1)),
        ("gantry and two", cartesian(2)),
        ("gantry and wrist", cartesian(3)),
        ("irb6", built_in(&irb6())),
        ("irp6", built_in(&irp6p())),
        ("polycrank", built_in(&polycrank())),
        ("irp6-track", built_in(&irp6ot())),
    ]
}

/// One of [`public`].
pub(super) fn named(name: &str) -> ChainParameters {
    public().into_iter().find(|(other, _)| *other == name).unwrap().1
}

/// A chain with `axes` joints anywhere, of any kind.
pub(super) fn random(random: &mut Random, axes: usize) -> ChainParameters {
    let any = |random: &mut Random, most: f64| Vector3::from_fn(|_, _| random.within(-most, most));
    let frame = |random: &mut Random| {
        let rotation = UnitQuaternion::from_scaled_axis(any(random, 2.0));
        Pose::from_parts(any(random, 0.4).into(), rotation)
    };
    let joints = (0..axes).map(|number| {
        let kind = match random.next() % 8 {
            0 => LinkKind::Prismatic,
            1 => LinkKind::Continuous,
            _ => LinkKind::Revolute,
        };
        let limits = match kind {
            LinkKind::Prismatic => Limits { low: random.within(-0.5, 0.0), high: random.within(0.1, 0.5) },
            LinkKind::Revolute => Limits { low: random.within(-3.5, -0.5), high: random.within(0.5, 3.5) },
            LinkKind::Continuous => Limits::CONTINUOUS,
        };
        let ratio = if random.next().is_multiple_of(2) { 50.0 } else { -80.0 };
        ChainJoint {
            kind,
            axis: any(random, 1.0).into(),
            ratio,
            joint_at_home: random.within(-0.1, 0.1),
            motor_at_home: random.within(-100.0, 100.0),
            ..joint(&format!("j{number}"), frame(random), limits)
        }
    });
    let joints = joints.collect();
    chain(joints, frame(random))
}
