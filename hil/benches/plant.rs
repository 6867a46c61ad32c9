//! What one axis costs per sub-step of 100 µs: the figure that says how many robots a core can stand in for.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mrroc_hil::{Axis, AxisConfig, Demand, Irp6Axis};

/// Sub-steps in a servo period of 2 ms.
const PERIOD: u32 = 20;

fn advance(c: &mut Criterion) {
    let mut group = c.benchmark_group("advance one servo period");
    group.throughput(Throughput::Elements(u64::from(PERIOD)));
    let plants = [
        ("physical", AxisConfig::irp6(Irp6Axis::Column)),
        ("wut", AxisConfig::wut(Irp6Axis::Column)),
    ];
    for (name, config) in plants {
        let mut axis = Axis::new(&config, 1);
        let mut target = 0.0;
        let mut period = 0_u32;
        group.bench_function(name, |b| {
            b.iter(|| {
                // To and fro at 50 rad/s, a second each way.
                period += 1;
                let velocity = if period % 1000 < 500 {
                    31_831.0
                } else {
                    -31_831.0
                };
                axis.advance(
                    PERIOD,
                    Demand::Position {
                        counts: target,
                        velocity,
                    },
                );
                target += velocity * 0.002;
                black_box(axis.feedback())
            });
        });
    }
    group.finish();
}

criterion_group!(benches, advance);
criterion_main!(benches);
