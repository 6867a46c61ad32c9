//! A drive and an I/O node on a scripted bus.

use std::collections::BTreeMap;
use std::time::Duration;

pub(super) use crate::cia401::*;
pub(super) use crate::cia402::tests::bench::*;
pub(super) use crate::cia402::{AxisConfig, ConfigError, GroupConfig, Identity};

/// Node-ID of the drive.
pub(super) const DRIVE: u8 = 2;
/// Node-ID of the I/O node.
pub(super) const IO: u8 = 5;

/// Ten inputs and four outputs. In the error state outputs 0, 1 and 3 take 1, 0 and 0, and output 2 keeps its level.
pub(super) fn io_config(raw: u8) -> IoConfig {
    IoConfig {
        node: node(raw),
        identity: Identity { vendor: 0x1234, product: Some(7), revision: None },
        inputs: 10,
        outputs: 4,
        inhibit_time: Duration::from_millis(1),
        event_timer: Duration::from_millis(50),
        inverted_inputs: 0,
        emergency_inputs: 0,
        filtered_inputs: 0,
        inverted_outputs: 0,
        error_mode: 0b1011,
        error_value: 0b0001,
        configuration: Vec::new(),
    }
}

/// The service side of an I/O node with 16 inputs and eight outputs, whose first inputs are 0x0201. The node lacks the
/// output filter (0x6208) and the PDOs 2 to 4.
pub(super) fn io_store(raw: u8) -> Store {
    let mut objects = BTreeMap::new();
    let mut put = |index, subindex, bytes: &[u8]| objects.insert((index, subindex), bytes.to_vec());
    put(0x1000, 0, &[0x91, 0x01, 0x03, 0x00]);
    put(0x1016, 1, &[0; 4]);
    put(0x1017, 0, &[0; 2]);
    put(0x1018, 1, &[0x34, 0x12, 0, 0]);
    put(0x1018, 2, &[7, 0, 0, 0]);
    put(0x1029, 1, &[0]);
    for index in [0x1400, 0x1800] {
        put(index, 1, &[0; 4]);
        put(index, 2, &[254]);
    }
    put(0x1400, 5, &[7, 0]);
    put(0x1800, 3, &[0; 2]);
    put(0x1800, 5, &[0; 2]);
    for index in [0x1600, 0x1A00] {
        put(index, 0, &[1]);
        put(index, 1, &[0; 4]);
        put(index, 2, &[0; 4]);
    }
    put(0x6000, 0, &[2]);
    put(0x6005, 0, &[0]);
    for index in [0x6002, 0x6003, 0x6006, 0x6007, 0x6008] {
        put(index, 1, &[0x55]);
        put(index, 2, &[0x55]);
    }
    put(0x6200, 0, &[1]);
    put(0x6202, 1, &[0x55]);
    put(0x6206, 1, &[0xFF]);
    put(0x6207, 1, &[0]);
    let mut store = Store::of(raw, objects);
    store.sends = Some(frame(&format!("{:03X}#0102", 0x180 + u16::from(raw))));
    store
}

/// A bus that is not up.
pub(super) fn down(config: GroupConfig, io: IoConfig) -> Bench {
    let raw = io.node.raw();
    let mut bench = Bench::with_io(config, &[axis_config(DRIVE)], &[io]);
    bench.stores.push(io_store(raw));
    bench
}

/// A drive and an I/O node, brought up.
pub(super) fn up() -> Bench {
    up_with(io_config(IO))
}

pub(super) fn up_with(io: IoConfig) -> Bench {
    let raw = io.node.raw();
    Bench::up_with_io(group_config(), &[axis_config(DRIVE)], &[io], vec![io_store(raw)])
}

/// A cycle in which the drive answers, switched off, and the I/O node sends `frames`. Returns the frames sent.
pub(super) fn cycle(bench: &mut Bench, frames: &[&str]) -> Vec<String> {
    let mut answers = bench.answers(0x0740, 1_000);
    answers.extend(frames.iter().map(|text| (*text).to_owned()));
    bench.cycle(&answers, &[AxisCommand::Off])
}

/// The image of the I/O node.
pub(super) fn image(bench: &Bench) -> InputImage {
    bench.links[0].inputs.read()
}
