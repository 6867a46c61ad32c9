//! Throughput of the SDO and PDO layouts, frames per second on one core.

use std::hint::black_box;

use can::Frame;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mrroc_canopen::pdo::{Entry, PdoMapping, PdoNumber};
use mrroc_canopen::sdo::{Expedited, Initiate, Request, Response};
use mrroc_canopen::{NodeId, cob, objects};

const NODE: NodeId = NodeId::new(2).expect("2 is a node-ID");

fn sdo(c: &mut Criterion) {
    let mut group = c.benchmark_group("sdo");
    group.throughput(Throughput::Elements(1));
    let request = Request::InitiateUpload {
        object: objects::STATUSWORD,
    };
    group.bench_function("encode", |b| b.iter(|| black_box(request).encode(NODE)));
    let data = Expedited::from(0x0737_u16);
    let response = Response::InitiateUpload {
        object: objects::STATUSWORD,
        initiate: Initiate::Expedited(data),
    };
    let frame = response.encode(NODE);
    group.bench_function("decode", |b| {
        b.iter(|| Response::decode(black_box(&frame), NODE));
    });
    group.finish();
}

fn pdo(c: &mut Criterion) {
    let mut group = c.benchmark_group("pdo");
    group.throughput(Throughput::Elements(1));
    let mapping = PdoMapping::new(&[
        Entry::new(objects::CONTROLWORD, 16),
        Entry::new(objects::TARGET_POSITION, 32),
    ])
    .expect("6 bytes fit");
    let control = mapping.slot(objects::CONTROLWORD).expect("mapped");
    let target = mapping.slot(objects::TARGET_POSITION).expect("mapped");
    let id = cob::rpdo(PdoNumber::One, NODE);
    group.bench_function("encode", |b| {
        b.iter(|| {
            let mut bytes = [0; 8];
            control.write(&mut bytes, black_box(0x000F));
            target.write(&mut bytes, black_box(-100_000_i64) as u64);
            Frame::new(id, &bytes[..mapping.bytes()])
        });
    });
    let frame = Frame::new(id, &[0x37, 0x07, 0x60, 0x79, 0xFE, 0xFF, 0, 0]).expect("8 bytes");
    group.bench_function("decode", |b| {
        b.iter(|| {
            let bytes = black_box(&frame).data().try_into().expect("8 bytes");
            (control.read_unsigned(bytes), target.read_signed(bytes))
        });
    });
    group.finish();
}

criterion_group!(benches, sdo, pdo);
criterion_main!(benches);
