//! Time of one call of each robot: forward and inverse kinematics, Jacobian, drive train.
//!
//! Targets: inverse under 500 ns, forward under 150 ns; for the RNT inverse and joints from motors, which iterates, under
//! 2 µs.

use std::{f64::consts::FRAC_PI_2, hint::black_box};

use criterion::{Criterion, criterion_group, criterion_main};
use mrroc_controller::robot::{
    Irb6, Irb6Parameters, Irp6, Irp6Parameters, Joints, Rnt, RntParameters, Robot,
};

fn robots() -> [(&'static str, Box<dyn Robot>, Joints); 3] {
    let six = Irp6::new(&Irp6Parameters::irp6p()).expect("the preset is a robot");
    let five = Irb6::new(&Irb6Parameters::irb6()).expect("the preset is a robot");
    let rnt = Rnt::new(&RntParameters::nominal()).expect("the preset is a robot");
    [
        (
            "irp6p",
            Box::new(six),
            Joints::from([0.3, -1.7, 0.07, -0.33, 1.1, 0.6]),
        ),
        (
            "irb6",
            Box::new(five),
            Joints::from([0.3, -1.7, 0.07, FRAC_PI_2, 1.1]),
        ),
        (
            "rnt",
            Box::new(rnt),
            Joints::from([0.2, -0.1, 0.9, 0.4, 1.1, 0.6]),
        ),
    ]
}

fn kinematics(criterion: &mut Criterion) {
    for (name, robot, joints) in robots() {
        let flange = robot.forward(&joints).expect("finite joints");
        let motors = robot
            .motors_from_joints(&joints)
            .expect("joints within limits");
        let mut far = flange;
        far.translation.vector *= 3.0;
        let mut group = criterion.benchmark_group(name);
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
