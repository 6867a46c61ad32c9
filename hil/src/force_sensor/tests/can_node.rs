//! A host that speaks to the sensor on a CAN bus frame by frame.

use std::time::Duration;

use can::timing::Bitrate;
use can::{Frame, Instant, Port, Received, StandardId, VirtualPort};
use canopen::NodeId;

use super::super::{
    CanForceSensor, CanForceSensorConfig, CountWidth, ForceSensorError, Resolution, TemperatureCourse,
    TransducerConfig, WrenchProbe,
};
use super::{constant, course};
use crate::{DeviceId, World};

/// A wrench within the range of 16-bit counts: 100, -200, 300 counts of 0.02 N and 1000, -2000, 3000 counts of
/// 0.001 N·m.
const LOAD: [f64; 6] = [2.0, -4.0, 6.0, 1.0, -2.0, 3.0];
const FORCES: &str = "185#640038FF2C01";
const TORQUES: &str = "285#E80330F8B80B";

/// A host with node 5 on a bus of 1 Mbit/s.
struct Bench {
    world: World,
    port: VirtualPort,
    device: DeviceId,
    now: Instant,
}

fn config() -> CanForceSensorConfig {
    CanForceSensorConfig::new(NodeId::new(5).unwrap(), TransducerConfig::default())
}

/// A sensor that takes no sample by itself during a test.
fn slow() -> CanForceSensorConfig {
    CanForceSensorConfig { sample_period: Duration::from_secs(60), ..config() }
}

fn parse(text: &str) -> Frame {
    let (id, data) = text.split_once('#').unwrap();
    let byte = |at: usize| u8::from_str_radix(&data[2 * at..2 * at + 2], 16).unwrap();
    let bytes: Vec<u8> = (0..data.len() / 2).map(byte).collect();
    Frame::new(StandardId::new(u16::from_str_radix(id, 16).unwrap()).unwrap(), &bytes).unwrap()
}

/// An expedited download.
fn download(object: &str, value: u32, bytes: usize) -> String {
    let specifier = 0x23 | (4 - bytes as u8) << 2;
    let data: String = value.to_le_bytes().map(|byte| format!("{byte:02X}")).concat();
    format!("{specifier:02X}{object}{data}")
}

impl Bench {
    /// A booted sensor, with its boot-up frame already read.
    fn booted(config: CanForceSensorConfig, probe: Box<dyn WrenchProbe>) -> Self {
        let mut world = World::new();
        let bus = world.add_bus(Bitrate::KBPS_1000);
        let port = world.host_port(bus, 256);
        let device = world.add_device(bus, Box::new(CanForceSensor::new(config, probe).unwrap()));
        let mut bench = Self { world, port, device, now: Instant::ZERO };
        assert_eq!(bench.run(60), ["705#00"]);
        bench
    }

    fn received(&mut self, time: Duration) -> Vec<Received> {
        self.now += time;
        self.world.advance(self.now);
        let mut into = [Received { frame: parse("000#"), at: Instant::ZERO }; 256];
        let count = self.port.receive(self.now, &mut into).unwrap();
        into[..count].to_vec()
    }

    /// Advances time and returns the frames of the sensor.
    fn run(&mut self, millis: u64) -> Vec<String> {
        self.received(Duration::from_millis(millis)).into_iter().map(|received| received.frame.to_string()).collect()
    }

    fn send(&mut self, text: &str) {
        self.port.send(self.now, &[parse(text)]).unwrap();
    }

    /// Sends a frame and returns the answers within 5 ms.
    fn say(&mut self, text: &str) -> Vec<String> {
        self.send(text);
        self.run(5)
    }

    /// Sends an SDO request and returns its answer, payload only.
    fn ask(&mut self, request: &str) -> String {
        let answers = self.say(&format!("605#{request}"));
        answers.iter().find_map(|answer| answer.strip_prefix("585#")).unwrap_or("nothing").to_owned()
    }

    fn write(&mut self, object: &str, value: u32, bytes: usize) {
        assert_eq!(self.ask(&download(object, value, bytes)), format!("60{object}00000000"), "writing {object}");
    }

    fn read(&mut self, object: &str) -> u32 {
        let answer = self.ask(&format!("40{object}00000000"));
        assert!(answer.starts_with('4'), "{object}: {answer}");
        u32::from_str_radix(&answer[8..], 16).unwrap().swap_bytes()
    }

    /// Sets type and event timer, ms, of a TPDO of this COB-ID.
    fn configure(&mut self, tpdo: u8, cob: u32, kind: u32, timer: u32) {
        let object = |sub: u8| format!("{tpdo:02X}18{sub:02X}");
        self.write(&object(1), 0xC000_0000 | cob, 4);
        self.write(&object(2), kind, 1);
        self.write(&object(5), timer, 2);
        self.write(&object(1), 0x4000_0000 | cob, 4);
    }

    /// Maps objects to a TPDO of this COB-ID, with type 1.
    fn map(&mut self, tpdo: u8, cob: u32, entries: &[u32]) {
        self.write(&format!("{tpdo:02X}1801"), 0xC000_0000 | cob, 4);
        self.write(&format!("{tpdo:02X}1A00"), 0, 1);
        for (sub, entry) in (1..).zip(entries) {
            self.write(&format!("{tpdo:02X}1A{sub:02X}"), *entry, 4);
        }
        self.write(&format!("{tpdo:02X}1A00"), entries.len() as u32, 1);
        self.write(&format!("{tpdo:02X}1801"), 0x4000_0000 | cob, 4);
    }
}

#[test]
fn the_node_shows_its_identity_and_scale() {
    let mut bench = Bench::booted(CanForceSensorConfig { vendor: 0x1234_5678, ..config() }, constant(LOAD));
    for (object, value) in [
        ("001000", 0),
        ("181001", 0x1234_5678),
        ("181002", 0x0000_0F76),
        ("181003", 0x0001_0000),
        ("181004", 0x3000_0005),
        ("042001", 20_000),
        ("042002", 1000),
        ("042003", 1000),
        ("042004", 10),
        ("062000", 1000),
        ("052000", 250),
        ("022000", 0),
    ] {
        assert_eq!(bench.read(object), value, "{object}");
    }
}

#[test]
fn sdo_reads_counts_of_both_widths() {
    let mut bench = Bench::booted(config(), constant(LOAD));
    let narrow = [100, -200, 300, 1000, -2000, 3000_i16].map(|count| u32::from(count as u16));
    let wide = [2000, -4000, 6000, 100_000, -200_000, 300_000_i32].map(|count| count as u32);
    for (sub, (narrow, wide)) in (1..).zip(narrow.into_iter().zip(wide)) {
        assert_eq!(bench.read(&format!("0020{sub:02X}")), narrow, "0x2000:{sub}");
        assert_eq!(bench.read(&format!("0120{sub:02X}")), wide, "0x2001:{sub}");
    }
}

#[test]
fn two_tpdos_follow_every_sync() {
    let mut bench = Bench::booted(config(), constant(LOAD));
    assert_eq!(bench.say("080#"), [""; 0], "pre-operational");
    assert_eq!(bench.say("000#0105"), [""; 0], "no event at the start");
    assert_eq!(bench.say("080#"), [FORCES, TORQUES]);
    assert_eq!(bench.say("080#"), [FORCES, TORQUES]);
}

#[test]
fn a_tpdo_follows_sync_as_its_transmission_type_says() {
    for (kind, expected) in [(2, [0, 1, 0, 1, 0]), (3, [0, 0, 1, 0, 0]), (240, [0; 5]), (0, [1, 0, 0, 0, 0])] {
        let mut bench = Bench::booted(config(), constant(LOAD));
        bench.configure(0, 0x185, kind, 0);
        bench.configure(1, 0x285, 240, 0);
        bench.say("000#0105");
        assert_eq!(expected.map(|_| bench.say("080#").len()), expected, "type {kind}");
    }
    let mut bench = Bench::booted(config(), constant(LOAD));
    bench.configure(0, 0x185, 240, 0);
    bench.configure(1, 0x285, 240, 0);
    bench.say("000#0105");
    let sent: Vec<usize> = (0..240).map(|_| bench.say("080#").len()).collect();
    assert_eq!((sent[238], sent[239]), (0, 2));
}

#[test]
fn both_tpdos_carry_the_sample_of_their_sync() {
    // One count of each channel per microsecond of the last millisecond.
    let load = |now: Instant| {
        let micros = (now.as_nanos() / 1000 % 1000) as f64;
        [micros * 0.02, 0.0, 0.0, micros * 0.001, 0.0, 0.0]
    };
    let mut bench = Bench::booted(slow(), course(load));
    bench.say("000#0105");
    // The SYNC takes at most 48 bit times of 1 µs, and the TPDOs follow one after the other.
    let begin = bench.now.as_nanos() / 1000 % 1000;
    assert_eq!(begin, 0);
    bench.send("080#");
    let sent = bench.received(Duration::from_millis(1));
    let counts = |at: usize| u16::from_le_bytes([sent[at].frame.data()[0], sent[at].frame.data()[1]]);
    assert_eq!(sent.len(), 2);
    assert_eq!(counts(0), counts(1));
    assert!((40..=48).contains(&counts(0)), "{} µs after the SYNC began", counts(0));
}

#[test]
fn the_event_timer_sends_a_sample_of_the_last_sample_period() {
    // One count per 10 µs since power-on.
    let load = |now: Instant| [(now.as_nanos() / 10_000 % 6000) as f64 * 0.02, 0.0, 0.0, 0.0, 0.0, 0.0];
    for (period, timer) in [(1, 5), (2, 5), (4, 10)] {
        let config = CanForceSensorConfig { sample_period: Duration::from_millis(period), ..config() };
        let mut bench = Bench::booted(config, course(load));
        bench.configure(0, 0x185, 255, timer);
        bench.configure(1, 0x285, 240, 0);
        bench.send("000#0105");
        let sent = bench.received(Duration::from_millis(u64::from(timer) * 10 + 1));
        assert_eq!(sent.len(), 11, "every {timer} ms");
        for received in sent {
            let count = u64::from(u16::from_le_bytes([received.frame.data()[0], received.frame.data()[1]]));
            let age = (received.at.as_nanos() / 10_000 % 6000 + 6000 - count) % 6000;
            // The frame itself takes up to 0.12 ms.
            assert!(age <= period * 100 + 12, "a sample {age}0 µs old every {timer} ms");
        }
    }
}

#[test]
fn counts_of_32_bits_fill_three_tpdos() {
    let mut bench = Bench::booted(CanForceSensorConfig { width: CountWidth::Bits32, ..config() }, constant(LOAD));
    bench.say("000#0105");
    assert_eq!(bench.say("080#"), ["185#D007000060F0FFFF", "285#70170000A0860100", "385#C0F2FCFFE0930400"]);
}

#[test]
fn a_host_maps_readings_status_and_temperature_in_any_order() {
    let transducer = TransducerConfig { range: [5.0; 6], ..TransducerConfig::default() };
    let mut bench = Bench::booted(CanForceSensorConfig { transducer, ..config() }, constant(LOAD));
    bench.map(0, 0x185, &[0x2001_0320, 0x2002_0010, 0x2000_0610]);
    bench.map(1, 0x321, &[0x2005_0010, 0x2001_0120]);
    bench.say("000#0105");
    // The force along z is limited to 5 N: 5000 counts, bit 2 of the status.
    assert_eq!(bench.say("080#"), ["185#881300000400B80B", "321#FA00D0070000"]);
    // Bias and scale cannot be mapped.
    bench.say("000#8005");
    bench.write("021801", 0xC000_0385, 4);
    for entry in [0x2003_0008, 0x2004_0120, 0x2006_0010] {
        assert_eq!(bench.ask(&download("021A01", entry, 4)), "80021A0141000406", "{entry:#x}");
    }
}

#[test]
fn saturation_is_an_event_of_a_tpdo_that_carries_the_status() {
    // The force along x leaves its range 300 ms after power-on.
    let load = |now: Instant| [if now.as_nanos() < 300_000_000 { 0.0 } else { -150.0 }, 0.0, 0.0, 0.0, 0.0, 0.0];
    let mut bench = Bench::booted(config(), course(load));
    bench.map(0, 0x185, &[0x2002_0010, 0x2000_0110]);
    bench.configure(0, 0x185, 255, 0);
    bench.configure(1, 0x285, 240, 0);
    assert_eq!(bench.say("000#0105"), ["185#00000000"]);
    let left = 299 - bench.now.as_nanos() / 1_000_000;
    assert_eq!(bench.run(left), [""; 0]);
    // -130 N are -6500 counts.
    assert_eq!(bench.run(5), ["185#01009CE6"]);
    assert_eq!(bench.run(100), [""; 0]);
}

#[test]
fn the_bias_is_an_object_that_a_reset_of_the_node_clears() {
    let mut bench = Bench::booted(slow(), constant(LOAD));
    bench.say("000#0105");
    bench.write("032000", 1, 1);
    assert_eq!(bench.read("002001"), 0);
    assert_eq!(bench.say("080#"), ["185#000000000000", "285#000000000000"]);
    bench.write("032000", 0, 1);
    assert_eq!(bench.say("080#"), [FORCES, TORQUES]);
    assert_eq!(bench.ask(&download("032000", 2, 1)), "8003200030000906");
    bench.write("032000", 1, 1);
    for (command, counts, bias) in [("82", 0, 1), ("81", 100, 0)] {
        bench.say(&format!("000#{command}05"));
        bench.run(60);
        assert_eq!((bench.read("002001"), bench.read("032000")), (counts, bias), "command {command}");
    }
}

#[test]
fn a_power_cycle_clears_the_bias_and_the_heartbeat_runs() {
    let mut bench = Bench::booted(config(), constant(LOAD));
    bench.write("171000", 20, 2);
    assert_eq!(bench.run(41), ["705#7F"; 2]);
    bench.write("032000", 1, 1);
    let switch = |bench: &mut Bench, on| {
        let now = bench.now;
        bench.world.change(bench.device, now, |sensor: &mut CanForceSensor| sensor.set_power(on, now)).unwrap();
    };
    bench.run(5);
    switch(&mut bench, false);
    assert_eq!(bench.run(200), [""; 0]);
    assert_eq!(bench.ask("4000200100000000"), "nothing");
    switch(&mut bench, true);
    assert_eq!(bench.run(60), ["705#00"]);
    assert_eq!(bench.read("002001"), 100);
}

#[test]
fn the_temperature_is_readable() {
    let temperature = TemperatureCourse { start: -5.0, end: 15.0, time_constant: Duration::from_millis(100) };
    let transducer = TransducerConfig { temperature, ..TransducerConfig::default() };
    let mut bench = Bench::booted(CanForceSensorConfig { transducer, ..config() }, constant(LOAD));
    let first = bench.read("052000");
    let tenths = f64::from(first as u16 as i16);
    // Sampled between 60 and 65 ms.
    let expected = |seconds: f64| 150.0 - 200.0 * (-seconds / 0.1).exp();
    assert!(expected(0.059) < tenths && tenths < expected(0.065), "{tenths}");
    bench.run(2000);
    assert_eq!(bench.read("052000"), 150);
}

#[test]
fn the_same_frames_give_the_same_answers() {
    let frames = |seed| {
        let transducer = TransducerConfig { noise: [1.0; 6], drift: [0.1; 6], seed, ..TransducerConfig::default() };
        let mut bench = Bench::booted(CanForceSensorConfig { transducer, ..config() }, constant(LOAD));
        bench.configure(1, 0x285, 255, 3);
        bench.say("000#0105");
        (0..50).flat_map(|_| bench.say("080#")).collect::<Vec<_>>()
    };
    assert!(frames(1).len() > 100);
    assert_eq!(frames(1), frames(1));
    assert_ne!(frames(1), frames(2));
}

#[test]
fn impossible_configurations_are_refused() {
    let refusal = |config| CanForceSensor::new(config, constant(LOAD)).err();
    let none = Resolution { force_micronewtons: 0, torque_micronewton_metres: 10 };
    let count = Some(ForceSensorError::Count { force: 0.0, torque: none.torque() });
    assert_eq!(refusal(CanForceSensorConfig { resolution_16: none, ..config() }), count);
    assert_eq!(refusal(CanForceSensorConfig { resolution_32: none, ..config() }), count);
    let stopped = CanForceSensorConfig { sample_period: Duration::ZERO, ..config() };
    assert_eq!(refusal(stopped), Some(ForceSensorError::NoSamplePeriod));
}
