//! Throughput of the SDO layouts, frames per second on one core.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mrroc_canopen::sdo::{Expedited, Initiate, Request, Response};
use mrroc_canopen::{NodeId, objects};

const NODE: NodeId = NodeId::new(2).expect("2 is a node-ID");

fn sdo(c: &mut Criterion) {
    let mut group = c.benchmark_group("sdo");
    group.throughput(Throughput::Elements(1));
    let request = Request::InitiateUpload { object: objects::STATUSWORD };
    group.bench_function("encode", |b| b.iter(|| black_box(request).encode(NODE)));
    let data = Expedited::from(0x0737_u16);
    let response = Response::InitiateUpload { object: objects::STATUSWORD, initiate: Initiate::Expedited(data) };
    let frame = response.encode(NODE);
    group.bench_function("decode", |b| {
        b.iter(|| Response::decode(black_box(&frame), NODE));
    });
    group.finish();
}

criterion_group!(benches, sdo);
criterion_main!(benches);
