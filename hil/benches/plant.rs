//! Computing time of one axis per sub-step of 100 µs. The result determines how many robots one core can emulate.

use std::hint::black_box;
use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mrroc_hil::plant::{ChainBodies, ChainBodyJoint};
use mrroc_hil::{AxisConfig, Demand, Irp6Axis, Mechanism, MechanismConfig, PlantAxis};

/// Sub-steps in a servo period of 2 ms.
const PERIOD: u32 = 20;

fn advance(c: &mut Criterion) {
    let mut group = c.benchmark_group("advance one servo period");
    group.throughput(Throughput::Elements(u64::from(PERIOD)));
    let plants = [("physical", AxisConfig::irp6(Irp6Axis::Column)), ("wut", AxisConfig::wut(Irp6Axis::Column))];
    for (name, config) in plants {
        let mut axis = PlantAxis::new(&config, 1);
        let mut target = 0.0;
        let mut period = 0_u32;
        group.bench_function(name, |b| {
            b.iter(|| {
                // Forward and back at 50 rad/s, one second each way.
                period += 1;
                let velocity = if period % 1000 < 500 { 31_831.0 } else { -31_831.0 };
                axis.advance(PERIOD, Demand::Position { counts: target, velocity });
                target += velocity * 0.002;
                black_box(axis.feedback())
            });
        });
    }
    group.finish();
}

/// Configuration of an axis of a robot, by the number of the axis.
type Preset = fn(usize) -> Option<AxisConfig>;

/// Six axes with coupled dynamics.
fn chain() -> MechanismConfig {
    let joint = |number: usize| ChainBodyJoint {
        translation: [0.2, 0.0, 0.1],
        rotation: [1.0, 0.0, 0.0, 0.0],
        axis: [0.0, (number % 2) as f64, 1.0],
        prismatic: false,
        mass: 2.0,
        centre: [0.1, 0.0, 0.05],
        inertia: [0.02, 0.03, 0.04, 0.0, 0.0, 0.0],
        at_home: 0.1,
    };
    let joints: Vec<_> = (0..6).map(joint).collect();
    let rows: Vec<Vec<f64>> =
        (0..6).map(|row| (0..6).map(|column| if row == column { 0.02 } else { 0.0 }).collect()).collect();
    let flange = ([0.0; 3], [1.0, 0.0, 0.0, 0.0]);
    let bodies = ChainBodies::new(&joints, flange, [0.0, 0.0, 1.0], &rows, &[1e-4; 6]);
    MechanismConfig::Chain(Arc::new(bodies.expect("the numbers of an arm")))
}

/// The axes of a robot mounted on their mechanism. Each axis in turn advances by one servo period.
fn mounted(c: &mut Criterion) {
    let mut group = c.benchmark_group("advance a robot by one servo period");
    let rnt = MechanismConfig::Rnt { home_lengths: [AxisConfig::RNT_HOME_LENGTH; 3] };
    let polycrank = MechanismConfig::Polycrank { coupled: false, at_home: [0.0; 7] };
    let pedestal: Preset = |axis| Some(AxisConfig::irp6(Irp6Axis::ALL[axis]));
    let robots: [(&str, MechanismConfig, Preset); 5] = [
        ("irp6", MechanismConfig::Irp6, pedestal),
        ("irp6 on track", MechanismConfig::Irp6OnTrack, AxisConfig::irp6_track),
        ("rnt", rnt, AxisConfig::rnt),
        ("polycrank", polycrank, AxisConfig::polycrank),
        ("chain", chain(), AxisConfig::polycrank),
    ];
    for (name, config, preset) in robots {
        let mechanism = Mechanism::new(config);
        let axis = |number: usize| {
            let config = preset(number)?;
            let mount = mechanism.mount(number, config.index_angle)?;
            Some(PlantAxis::mounted(&config, number as u64, Some(&mount)))
        };
        let mut axes: Vec<PlantAxis> = (0..mechanism.axes()).filter_map(axis).collect();
        let sub_steps = axes.len() as u64 * u64::from(PERIOD);
        group.throughput(Throughput::Elements(sub_steps));
        let mut period = 0_u32;
        group.bench_function(name, |b| {
            b.iter(|| {
                period += 1;
                let velocity = if period % 1000 < 500 { 20_000.0 } else { -20_000.0 };
                for axis in &mut axes {
                    axis.advance(PERIOD, Demand::Velocity(velocity));
                }
                black_box(axes[0].feedback())
            });
        });
    }
    group.finish();
}

criterion_group!(benches, advance, mounted);
criterion_main!(benches);
