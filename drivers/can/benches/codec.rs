//! What a frame costs on its way through bus-time arithmetic, recordings and the virtual port.

use std::hint::black_box;
use std::io::Write;

use can::candump::Entry;
use can::timing::bits_on_wire;
use can::{ExtendedId, Frame, Instant, InterfaceName, Port, Received, StandardId, virtual_port};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mrroc_can as can;

const LINES: usize = 1000;

fn upload() -> Frame {
    let id = StandardId::new(0x601).expect("11 bits");
    Frame::new(id, &[0x40, 0x41, 0x60, 0, 0, 0, 0, 0]).expect("8 bytes")
}

fn frame_time(criterion: &mut Criterion) {
    let extended = ExtendedId::new(0x1ABC_DEF0).expect("29 bits");
    let extended = Frame::new(extended, &[0x55; 8]).expect("8 bytes");
    let mut group = criterion.benchmark_group("bits_on_wire");
    group.bench_function("standard", |bencher| {
        bencher.iter(|| bits_on_wire(black_box(&upload())));
    });
    group.bench_function("extended", |bencher| {
        bencher.iter(|| bits_on_wire(black_box(&extended)));
    });
}

fn recording(criterion: &mut Criterion) {
    let entry = Entry {
        at: Instant::from_nanos(1_795_242_630_522_011_000),
        interface: InterfaceName::new("vcan0").expect("5 bytes"),
        frame: upload(),
        direction: None,
    };
    let write = |mut sink: Vec<u8>| {
        for _ in 0..LINES {
            writeln!(sink, "{}", black_box(&entry)).expect("a vector takes everything");
        }
        sink
    };
    let text = write(Vec::new());
    let mut group = criterion.benchmark_group("candump");
    group.throughput(Throughput::Elements(LINES as u64));
    group.bench_function("write", |bencher| {
        bencher.iter(|| write(Vec::with_capacity(text.len())));
    });
    group.bench_function("read", |bencher| {
        let lines = || black_box(text.as_slice()).split(|&byte| byte == b'\n');
        bencher.iter(|| lines().flat_map(Entry::parse).count());
    });
}

fn virtual_round_trip(criterion: &mut Criterion) {
    let (mut port, mut peer) = virtual_port(64);
    let frames = [upload(); 8];
    let mut into = [Received { frame: upload(), at: Instant::ZERO }; 8];
    let mut group = criterion.benchmark_group("virtual_port");
    group.throughput(Throughput::Elements(8));
    group.bench_function("there and back", |bencher| {
        bencher.iter(|| {
            let sent = port.send(Instant::ZERO, black_box(&frames));
            while let Some(received) = peer.take_sent() {
                peer.deliver(received, 111);
            }
            (sent, port.receive(Instant::ZERO, &mut into))
        });
    });
}

criterion_group!(benches, frame_time, recording, virtual_round_trip);
criterion_main!(benches);
