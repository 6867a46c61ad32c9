//! A host that speaks to the serial sensor byte by byte.

use std::time::Duration;

use can::Instant;
use serial::{Line, Settings, VirtualLine};

use super::super::{ForceSensorError, SerialForceSensor, SerialForceSensorConfig, TransducerConfig, WrenchProbe};
use super::{constant, course};
use crate::{LineFaults, LineId, Stuck, WireFaults, World};

const SETTINGS: Settings = SerialForceSensor::SETTINGS;
/// Longer than the text after power-on.
const BOOT: Duration = Duration::from_millis(100);
/// Longer than an exchange.
const PATIENCE: Duration = Duration::from_millis(2);

struct Rig {
    world: World,
    line: LineId,
    host: VirtualLine,
    now: Instant,
}

/// The scale of the MRROC++ driver, no noise.
fn config() -> SerialForceSensorConfig {
    SerialForceSensorConfig::new(TransducerConfig::default())
}

/// A wrench of these counts.
fn counts(counts: [i16; 6]) -> [f64; 6] {
    let mut wrench = counts.map(f64::from);
    wrench[..3].iter_mut().for_each(|force| *force *= 10.0 / 115.0);
    wrench[3..].iter_mut().for_each(|torque| *torque *= 5.0 / 940.0);
    wrench
}

impl Rig {
    fn new(config: SerialForceSensorConfig, probe: Box<dyn WrenchProbe>) -> Self {
        let mut world = World::new();
        let device = SerialForceSensor::new(config, probe).unwrap();
        let line = world.add_line(SETTINGS, None, Box::new(device));
        let host = world.host_line(line, 256);
        Self { world, line, host, now: Instant::ZERO }
    }

    /// A sensor whose text after power-on has been read.
    fn booted(config: SerialForceSensorConfig, probe: Box<dyn WrenchProbe>) -> Self {
        let mut rig = Self::new(config, probe);
        rig.run(BOOT);
        rig
    }

    fn run(&mut self, time: Duration) -> Vec<u8> {
        self.now += time;
        self.world.advance(self.now);
        let mut into = [0; 256];
        let count = self.host.read(self.now, &mut into).unwrap();
        into[..count].to_vec()
    }

    fn write(&mut self, bytes: &[u8]) {
        assert_eq!(self.host.write(self.now, bytes), Ok(bytes.len()));
    }

    /// Writes now, and returns the bytes received until [`PATIENCE`] later.
    fn ask(&mut self, bytes: &[u8]) -> Vec<u8> {
        self.write(bytes);
        self.run(PATIENCE)
    }

    fn lost_queries(&self) -> u64 {
        self.world.line(self.line).device::<SerialForceSensor>().unwrap().lost_queries()
    }
}

#[test]
fn a_query_is_answered_by_six_counts_and_two_bytes() {
    let load = counts([100, -1, 1000, 1, -256, 1800]);
    let reply = [0, 100, 0xFF, 0xFF, 0x03, 0xE8, 0, 1, 0xFF, 0, 0x07, 0x08];
    let mut rig = Rig::booted(config(), constant(load));
    assert_eq!(rig.ask(b"q"), [&reply[..], &[0, 0]].concat());
    let mut rig = Rig::booted(SerialForceSensorConfig { trailer: [0x12, 0xFE], ..config() }, constant(load));
    assert_eq!(rig.ask(b"q"), [&reply[..], &[0x12, 0xFE]].concat());
}

#[test]
fn counts_stop_at_the_range_and_at_sixteen_bits() {
    let beyond = [1000.0, -1000.0, 0.0, 0.0, 0.0, 50.0];
    let mut rig = Rig::booted(config(), constant(beyond));
    // 130 N and 10 N·m.
    assert_eq!(rig.ask(b"q"), [0x05, 0xD7, 0xFA, 0x29, 0, 0, 0, 0, 0, 0, 0x07, 0x58, 0, 0]);
    let fine = SerialForceSensorConfig { force_per_count: 0.001, torque_per_count: 0.0001, ..config() };
    let mut rig = Rig::booted(fine, constant(beyond));
    assert_eq!(rig.ask(b"q"), [0x7F, 0xFF, 0x80, 0, 0, 0, 0, 0, 0, 0, 0x7F, 0xFF, 0, 0]);
}

#[test]
fn the_bias_makes_the_present_load_zero_without_a_reply() {
    let begin = Instant::ZERO + BOOT;
    // The force along z changes by 23 counts after the bias.
    let load = move |now: Instant| counts([50, 60, if now > begin + PATIENCE { 93 } else { 70 }, 8, 9, 10]);
    let mut rig = Rig::booted(config(), course(load));
    assert_eq!(rig.ask(b"b"), []);
    assert_eq!(rig.ask(b"q"), [0, 0, 0, 0, 0, 23, 0, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(rig.ask(b"b"), []);
    assert_eq!(rig.ask(b"q"), [0; 14]);
}

#[test]
fn the_sample_is_that_of_the_end_of_the_query() {
    // One count per microsecond since the query began.
    let load = |now: Instant| {
        let micros = now.since(Instant::ZERO + BOOT).as_micros() as f64;
        [micros * 10.0 / 115.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    };
    let delay = Duration::from_micros(500);
    let mut rig = Rig::booted(SerialForceSensorConfig { answer_delay: delay, ..config() }, course(load));
    rig.write(b"q");
    // The query takes ten bits of 8.68 µs.
    assert_eq!(SETTINGS.line_time(1).as_micros(), 86);
    let begins = SETTINGS.line_time(1) + delay;
    assert_eq!(rig.run(begins + SETTINGS.line_time(1) - Duration::from_nanos(1)), []);
    assert_eq!(rig.run(Duration::from_nanos(1)), [0]);
    assert_eq!(rig.run(SETTINGS.line_time(1)), [86]);
    assert_eq!(rig.run(SETTINGS.line_time(14)).len(), 12);
}

#[test]
fn a_query_during_a_reply_is_lost() {
    // End of the query, delay of the answer, and 14 bytes. The second query ends one byte after it was written.
    let query = SETTINGS.line_time(1);
    let ends = query + config().answer_delay + SETTINGS.line_time(14);
    let free = ends - query;
    let nano = Duration::from_nanos(1);
    for (wait, bytes, lost) in
        [(nano, 14, 1), (query, 14, 1), (free / 2, 14, 1), (free, 14, 1), (free + nano, 28, 0), (ends, 28, 0)]
    {
        let mut rig = Rig::booted(config(), constant([0.0; 6]));
        rig.write(b"q");
        let mut heard = rig.run(wait).len();
        rig.write(b"q");
        heard += rig.run(2 * PATIENCE).len();
        assert_eq!((heard, rig.lost_queries()), (bytes, lost), "{wait:?} after the first query");
        assert_eq!(rig.ask(b"q").len(), 14);
    }
}

#[test]
fn a_bias_during_a_reply_counts_for_the_next_reply() {
    let mut rig = Rig::booted(config(), constant(counts([5; 6])));
    let before = [[0, 5]; 6].concat();
    assert_eq!(rig.ask(b"qb"), [&before[..], &[0, 0]].concat());
    assert_eq!(rig.ask(b"q"), [0; 14]);
}

#[test]
fn other_bytes_are_ignored() {
    let mut rig = Rig::booted(config(), constant(counts([5; 6])));
    let all: Vec<u8> = (0..=u8::MAX).filter(|byte| !b"bq".contains(byte)).collect();
    rig.write(&all);
    assert_eq!(rig.run(SETTINGS.line_time(all.len()) + PATIENCE), []);
    assert_eq!(rig.ask(b"q")[..12], [[0, 5]; 6].concat());
    assert_eq!(rig.lost_queries(), 0);
}

#[test]
fn a_line_of_text_follows_power_on_and_queries_until_its_end_are_lost() {
    let config = SerialForceSensorConfig { greeting: "ready\r\n", ..config() };
    let mut rig = Rig::new(config.clone(), constant([0.0; 6]));
    assert_eq!(rig.ask(b"bq"), []);
    assert_eq!(rig.run(config.boot_delay - PATIENCE), []);
    assert_eq!(rig.ask(b"q"), b"ready\r\n");
    assert_eq!(rig.lost_queries(), 2);
    assert_eq!(rig.ask(b"q").len(), 14);
    // Without text the sensor answers as soon as it has booted.
    let config = SerialForceSensorConfig { greeting: "", ..config };
    let mut silent = Rig::new(config.clone(), constant(counts([5; 6])));
    assert_eq!(silent.ask(b"bq"), []);
    assert_eq!(silent.lost_queries(), 1);
    assert_eq!(silent.run(config.boot_delay - PATIENCE), []);
    assert_eq!(silent.ask(b"q")[..12], [[0, 5]; 6].concat());
}

#[test]
fn a_silent_line_carries_no_reply_and_the_sensor_goes_on_afterwards() {
    let mut rig = Rig::booted(config(), constant([0.0; 6]));
    let silent = WireFaults { stuck: Some(Stuck::Silent), ..WireFaults::default() };
    rig.world.line_mut(rig.line).set_faults(&LineFaults { to_host: silent, ..LineFaults::default() });
    assert_eq!(rig.ask(b"q"), []);
    rig.world.line_mut(rig.line).set_faults(&LineFaults::default());
    assert_eq!(rig.ask(b"q").len(), 14);
}

#[test]
fn the_same_queries_give_the_same_bytes() {
    let bytes = |seed| {
        let transducer = TransducerConfig { noise: [1.0; 6], drift: [0.1; 6], seed, ..TransducerConfig::default() };
        let mut rig = Rig::booted(SerialForceSensorConfig::new(transducer), constant([1.0; 6]));
        (0..50).flat_map(|_| rig.ask(b"q")).collect::<Vec<_>>()
    };
    assert_eq!(bytes(1).len(), 50 * 14);
    assert_eq!(bytes(1), bytes(1));
    assert_ne!(bytes(1), bytes(2));
}

#[test]
fn a_count_of_nothing_is_refused() {
    let refused = SerialForceSensorConfig { torque_per_count: 0.0, force_per_count: 0.5, ..config() };
    let error = SerialForceSensor::new(refused, constant([0.0; 6])).err();
    assert_eq!(error, Some(ForceSensorError::Count { force: 0.5, torque: 0.0 }));
}
