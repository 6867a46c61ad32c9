//! Computing time of one call, for each robot: forward and inverse kinematics, Jacobian, drive train.
//!
//! Targets: forward kinematics under 150 ns, inverse under 500 ns. For robots with a free parameter or with legs:
//! inverse under 1 µs, joints from the motors of legs under 2 µs.
//!
//! Chains: mean time of the inverse of random poses from random postures, by closed form and by the numerical solver.

use std::{
    f64::consts::{FRAC_PI_2, TAU},
    hint::black_box,
};

use criterion::{Criterion, criterion_group, criterion_main};
use mrroc_controller::robot::{
    Chain, ChainJoint, ChainParameters, Irb6, Irb6Parameters, Irp6, Irp6Parameters, Irp6Track, Irp6TrackParameters,
    Joints, Limits, LinkKind, Mass, Polycrank, PolycrankParameters, Pose, Rnt, RntParameters, Robot, Weight,
};
use nalgebra::Vector3;

#[path = "../src/random.rs"]
mod random;

fn robots() -> [(&'static str, Box<dyn Robot>, Joints); 5] {
    let six = Irp6::new(&Irp6Parameters::irp6p()).expect("the preset is a robot");
    let five = Irb6::new(&Irb6Parameters::irb6()).expect("the preset is a robot");
    let track = Irp6Track::new(&Irp6TrackParameters::irp6ot()).expect("the preset is a robot");
    let seven = Polycrank::new(&PolycrankParameters::polycrank()).expect("the preset is a robot");
    let rnt = Rnt::new(&RntParameters::nominal()).expect("the preset is a robot");
    [
        ("irp6ot", Box::new(track), Joints::from([0.4, 0.3, -1.7, 0.07, -0.33, 1.1, 0.6])),
        ("polycrank", Box::new(seven), Joints::from([0.3, 1.2, -0.7, 0.4, 1.3, -0.6, 0.2])),
        ("irp6p", Box::new(six), Joints::from([0.3, -1.7, 0.07, -0.33, 1.1, 0.6])),
        ("irb6", Box::new(five), Joints::from([0.3, -1.7, 0.07, FRAC_PI_2, 1.1])),
        ("rnt", Box::new(rnt), Joints::from([0.2, -0.1, 0.9, 0.4, 1.1, 0.6])),
    ]
}

fn kinematics(criterion: &mut Criterion) {
    for (name, robot, joints) in robots() {
        let flange = robot.forward(&joints).expect("finite joints");
        let motors = robot.motors_from_joints(&joints).expect("joints within limits");
        let mut far = flange;
        far.translation.vector *= 3.0;
        let masses = vec![Mass { mass: 5.0, centre: [0.1; 3] }; robot.axes()];
        let weight = Weight::new(&*robot, &masses, Mass::default(), [0.0, 0.0, 1.0]).expect("one mass per link");
        let mut group = criterion.benchmark_group(name);
        group.bench_function("weight", |b| {
            b.iter(|| weight.torque(&*robot, black_box(&motors)));
        });
        group.bench_function("forward", |b| b.iter(|| robot.forward(black_box(&joints))));
        group.bench_function("inverse", |b| {
            b.iter(|| robot.inverse(black_box(&flange), black_box(&joints)));
        });
        group.bench_function("inverse, out of reach", |b| {
            b.iter(|| robot.inverse(black_box(&far), black_box(&joints)));
        });
        group.bench_function("jacobian", |b| {
            b.iter(|| robot.jacobian(black_box(&joints)));
        });
        group.bench_function("singularity", |b| {
            b.iter(|| robot.singularity(black_box(&joints)));
        });
        group.bench_function("motors from joints", |b| {
            b.iter(|| robot.motors_from_joints(black_box(&joints)));
        });
        group.bench_function("joints from motors", |b| {
            b.iter(|| robot.joints_from_motors(black_box(&motors)));
        });
        group.finish();
    }
}

/// A chain of rows of the modified convention: alpha and a of the previous link, d, and the range.
fn chain(rows: &[([f64; 3], [f64; 2])], flange: f64) -> Chain {
    let mut before = Pose::identity();
    let mut joints = Vec::new();
    for (number, &([alpha, a, d], [low, high])) in rows.iter().enumerate() {
        joints.push(ChainJoint {
            name: format!("j{number}"),
            kind: LinkKind::Revolute,
            parent_from_joint: before * Pose::rotation(Vector3::x() * alpha) * Pose::translation(a, 0.0, 0.0),
            axis: [0.0, 0.0, 1.0],
            limits: Limits { low, high },
            velocity: None,
            effort: None,
            ratio: 100.0,
            joint_at_home: 0.0,
            motor_at_home: 0.0,
            body: None,
        });
        before = Pose::translation(0.0, 0.0, d);
    }
    let link_from_flange = before * Pose::translation(0.0, 0.0, flange);
    let up = [0.0, 0.0, 1.0];
    Chain::new(&ChainParameters { joints, link_from_flange, up, motors_from_joints: None, free_axis: None })
        .expect("the rows are an arm")
}

/// UR5: three parallel axes. IRB 140: spherical wrist. Panda: numerical solver.
fn chains() -> [(&'static str, Chain); 3] {
    const H: f64 = FRAC_PI_2;
    let (turn, wide) = ([-TAU, TAU], [-2.8973, 2.8973]);
    let ur5 = [
        ([0.0, 0.0, 0.089159], turn),
        ([H, 0.0, 0.0], turn),
        ([0.0, -0.425, 0.0], turn),
        ([0.0, -0.39225, 0.10915], turn),
        ([H, 0.0, 0.09465], turn),
        ([-H, 0.0, 0.0823], turn),
    ];
    let irb140 = [
        ([0.0, 0.0, 0.352], [-3.1, 3.1]),
        ([-H, 0.07, 0.0], [-3.3, 0.2]),
        ([0.0, 0.36, 0.0], [-3.8, 1.0]),
        ([-H, 0.0, 0.38], [-3.4, 3.4]),
        ([H, 0.0, 0.0], [-2.0, 2.0]),
        ([-H, 0.0, 0.065], [-6.9, 6.9]),
    ];
    let panda = [
        ([0.0, 0.0, 0.333], wide),
        ([-H, 0.0, 0.0], [-1.7628, 1.7628]),
        ([H, 0.0, 0.316], wide),
        ([H, 0.0825, 0.0], [-3.0718, -0.0698]),
        ([-H, -0.0825, 0.384], wide),
        ([H, 0.0, 0.0], [-0.0175, 3.7525]),
        ([H, 0.088, 0.0], wide),
    ];
    [("ur5", chain(&ur5, 0.0)), ("irb140", chain(&irb140, 0.0)), ("panda", chain(&panda, 0.107))]
}

fn chains_anywhere(criterion: &mut Criterion) {
    for (name, chain) in chains() {
        let mut random = random::Random(1);
        let mut any = || {
            let joints: Vec<f64> =
                chain.joint_limits().iter().map(|limits| random.within(limits.low, limits.high)).collect();
            Joints::new(&joints).expect("at most eight axes")
        };
        let asked: Vec<_> = (0..1_000).map(|_| (chain.forward(&any()).expect("finite joints"), any())).collect();
        let joints = any();
        let mut next = 0;
        let mut group = criterion.benchmark_group(format!("chain {name}"));
        group.bench_function("forward", |b| b.iter(|| chain.forward(black_box(&joints))));
        group.bench_function("jacobian", |b| b.iter(|| chain.jacobian(black_box(&joints))));
        group.bench_function("inverse, anywhere", |b| {
            b.iter(|| {
                next = (next + 1) % asked.len();
                let (pose, near) = &asked[next];
                chain.inverse(black_box(pose), black_box(near))
            });
        });
        group.finish();
    }
}

criterion_group!(benches, kinematics, chains_anywhere);
criterion_main!(benches);
