//! Throughput of the SDO client and of the power state machine, steps per second on one core.

use std::hint::black_box;
use std::time::Duration;

use can::Instant;
use canopen::cia402::Statusword;
use canopen::sdo::{Expedited, Initiate, Response};
use canopen::{NodeId, objects};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mrroc_master::power::{Goal, PowerStateMachine};
use mrroc_master::sdo::Client;

const NODE: NodeId = NodeId::new(2).expect("2 is a node-ID");

fn machines(c: &mut Criterion) {
    let mut group = c.benchmark_group("machines");
    group.throughput(Throughput::Elements(1));
    let response = Response::InitiateUpload {
        object: objects::STATUSWORD,
        initiate: Initiate::Expedited(Expedited::from(0x0737_u16)),
    };
    let frame = response.encode(NODE);
    let mut client = Client::new(NODE, Duration::from_millis(500), 2);
    group.bench_function("upload", |b| {
        b.iter(|| {
            client.upload(objects::STATUSWORD, Instant::ZERO).expect("the last result was taken");
            black_box(client.poll_transmit(Instant::ZERO));
            client.handle(black_box(&frame), Instant::ZERO);
            client.poll().and_then(|result| result.ok()?.number::<u16>().ok())
        });
    });
    let mut machine = PowerStateMachine::default();
    group.bench_function("power step", |b| {
        b.iter(|| machine.step(black_box(Statusword(0x0737)), Goal::On));
    });
    group.finish();
}

criterion_group!(benches, machines);
criterion_main!(benches);
