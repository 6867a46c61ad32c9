//! Computing time of one call, for each robot: forward and inverse kinematics, Jacobian, drive train.
//!
//! Targets: forward kinematics under 150 ns, inverse under 500 ns. For robots with a free parameter or with legs:
//! inverse under 1 µs, joints from the motors of legs under 2 µs.

use std::{f64::consts::FRAC_PI_2, hint::black_box};

use criterion::{Criterion, criterion_group, criterion_main};
use mrroc_controller::robot::{
    Irb6, Irb6Parameters, Irp6, Irp6Parameters, Irp6Track, Irp6TrackParameters, Joints, Mass, Polycrank,
    PolycrankParameters, Rnt, RntParameters, Robot, Weight,
};

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

criterion_group!(benches, kinematics);
criterion_main!(benches);
