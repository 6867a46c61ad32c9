//! Golden exchanges over a line, byte for byte.

use std::time::Duration;

use can::Instant;
use canopen::NodeId;
use serial::epos2;
use serial::epos4::{Address, Answer, Deframer, LONGEST, Request};
use serial::{Line, Settings, VirtualLine};

use super::{EposSerial, EposSerialConfig};
use crate::{AxisConfig, Epos4Config, Irp6Axis, LineDevice, World};

struct Rig {
    world: World,
    host: VirtualLine,
    now: Instant,
}

fn config() -> EposSerialConfig {
    let axis = AxisConfig::irp6(Irp6Axis::Column);
    let node = NodeId::new(1).unwrap();
    EposSerialConfig::new(Epos4Config::new(node, axis))
}

impl Rig {
    /// A test rig with a booted device.
    fn new(device: Box<dyn LineDevice>) -> Self {
        let mut world = World::new();
        let line = world.add_line(Settings::EPOS, None, device);
        let host = world.host_line(line, 1024);
        let now = Instant::from_nanos(100_000_000);
        world.advance(now);
        Self { world, host, now }
    }

    fn epos2(config: EposSerialConfig) -> Self {
        Self::new(Box::new(EposSerial::epos2(config)))
    }

    fn epos4(config: EposSerialConfig) -> Self {
        Self::new(Box::new(EposSerial::epos4(config)))
    }

    fn wait(&mut self, time: Duration) -> Vec<u8> {
        self.now += time;
        self.world.advance(self.now);
        let mut into = [0; 1024];
        let count = self.host.read(self.now, &mut into).unwrap();
        into[..count].to_vec()
    }

    /// Writes now, and returns the bytes received 40 ms later.
    fn send(&mut self, bytes: &[u8]) -> Vec<u8> {
        assert_eq!(self.host.write(self.now, bytes), Ok(bytes.len()));
        self.wait(Duration::from_millis(40))
    }

    /// A complete exchange with an EPOS2. Returns the answer's data, or `None` for a request without an answer.
    fn epos2_exchange(&mut self, request: epos2::Request) -> Option<epos2::Answer> {
        let telegram = request.encode();
        assert_eq!(self.send(&[telegram.opcode()]), b"O");
        let end = self.send(telegram.body());
        if !request.is_answered() {
            assert_eq!(end, b"O");
            return None;
        }
        assert_eq!(end, b"O\x00");
        let body = self.send(b"O");
        assert_eq!(self.send(b"O"), [0_u8; 0]);
        Some(epos2::Answer::decode(&body).unwrap())
    }

    fn epos4_frame(&mut self, frame: &serial::epos4::Frame) -> serial::epos4::Frame {
        let mut bytes = [0; LONGEST];
        let length = frame.encode(&mut bytes);
        let answer = self.send(&bytes[..length]);
        let mut deframer = Deframer::new();
        let mut found = answer.iter().filter_map(|&byte| deframer.take(byte));
        found.next().expect("an answer").expect("a right one")
    }

    /// Compares the answer of an EPOS4 with `expected`.
    fn epos4_exchange(&mut self, request: Request, expected: Answer) {
        let frame = self.epos4_frame(&request.encode());
        let answer = Answer::decode(&frame, &request);
        assert_eq!(answer, Some(expected), "{request:?}");
    }
}

const fn object(index: u16, subindex: u8) -> Address {
    Address { node: 0, index, subindex }
}

#[test]
fn epos4_exchanges_are_the_bytes_of_the_line() {
    let mut rig = Rig::epos4(config());
    let cases: [(&[u8], &[u8]); 3] = [
        // Statusword of node 1 right after boot: 0x0440, switch on disabled. In profile position mode no target is
        // reached.
        (
            &[0x90, 0x02, 0x60, 0x02, 0x01, 0x41, 0x60, 0x00, 0x22, 0xD1],
            &[0x90, 0x02, 0x00, 0x04, 0x00, 0x00, 0x00, 0x00, 0x40, 0x04, 0x00, 0x00],
        ),
        (
            &[0x90, 0x02, 0x68, 0x04, 0x01, 0x40, 0x60, 0x00, 0x0F, 0x00, 0x00, 0x00, 0xB3, 0x07],
            &[0x90, 0x02, 0x00, 0x02, 0x00, 0x00, 0x00, 0x00, 0x40, 0x8B],
        ),
        // The same with a wrong CRC.
        (
            &[0x90, 0x02, 0x68, 0x04, 0x01, 0x40, 0x60, 0x00, 0x0F, 0x00, 0x00, 0x00, 0xB3, 0x08],
            &[0x90, 0x02, 0x00, 0x02, 0x04, 0x00, 0x04, 0x05],
        ),
    ];
    for (request, answer) in cases {
        let found = rig.send(request);
        assert!(found.starts_with(answer), "{found:02x?}");
        assert!(found.len() <= answer.len() + 3);
    }
}

#[test]
fn epos2_exchanges_are_the_bytes_of_the_line() {
    let mut config = config();
    config.epos.vendor_bits = 0x0100;
    let mut rig = Rig::epos2(config);
    // Statusword of an EPOS2: bit 8 is always set.
    assert_eq!(rig.send(&[0x10]), b"O");
    let read = [0x01, 0x41, 0x60, 0x00, 0x01, 0xAB, 0xF0];
    assert_eq!(rig.send(&read), b"O\x00");
    let answer = rig.send(b"O");
    assert_eq!(answer[..9], [0x03, 0, 0, 0, 0, 0x40, 0x05, 0, 0]);
    assert_eq!(rig.send(b"O"), [0_u8; 0]);
    // Controlword.
    assert_eq!(rig.send(&[0x11]), b"O");
    let write = [0x03, 0x40, 0x60, 0x00, 0x01, 0x0F, 0x00, 0x00, 0x00, 0x52, 0xEF];
    assert_eq!(rig.send(&write), b"O\x00");
    assert_eq!(rig.send(b"O"), [0x01, 0, 0, 0, 0, 0x51, 0xAA]);
    assert_eq!(rig.send(b"O"), [0_u8; 0]);
    // An object that does not exist.
    assert_eq!(rig.send(&[0x10]), b"O");
    let missing = epos2::Request::Read(Address { node: 1, index: 0x5FFF, subindex: 0 });
    assert_eq!(rig.send(missing.encode().body()), b"O\x00");
    let refused = [0x03, 0, 0, 0x02, 0x06, 0, 0, 0, 0, 0x26, 0xE4];
    assert_eq!(rig.send(b"O"), refused);
}

#[test]
fn an_answer_takes_its_turn_around_and_its_line_time() {
    let line = Settings::EPOS;
    let mut rig = Rig::epos4(config());
    let read = [0x90, 0x02, 0x60, 0x02, 0x01, 0x41, 0x60, 0x00, 0x22, 0xD1];
    let written = rig.now;
    rig.host.write(written, &read).unwrap();
    let due = written + line.line_time(10) + Duration::from_micros(100) + line.line_time(14);
    rig.world.advance(due);
    let mut into = [0; 64];
    let early = due - Duration::from_nanos(1);
    assert_eq!(rig.host.read(early, &mut into), Ok(13));
    assert_eq!(rig.host.read(due, &mut into), Ok(1));
}

#[test]
fn an_object_over_rs232_costs_an_epos2_more_than_two_milliseconds() {
    let mut rig = Rig::epos2(config());
    let begin = rig.now;
    let telegram = epos2::Request::Read(Address { node: 0, index: 0x6041, subindex: 0 }).encode();
    let steps: [(&[u8], usize); 3] = [(&[telegram.opcode()], 1), (telegram.body(), 2), (b"O", 11)];
    for (bytes, answer) in steps {
        rig.host.write(rig.now, bytes).unwrap();
        let mut count = 0;
        // A host as fast as the line.
        while count < answer {
            rig.now = rig.world.next_event().expect("an answer is to come");
            rig.world.advance(rig.now);
            count += rig.host.read(rig.now, &mut [0; 64]).unwrap();
        }
    }
    let took = rig.now.since(begin);
    // 23 bytes and three turn-arounds of 100 µs.
    let expected = Settings::EPOS.line_time(23) + Duration::from_micros(300);
    assert!(took.abs_diff(expected) < Duration::from_micros(1), "{took:?}");
}

#[test]
fn both_ports_enable_and_move_the_axis() {
    // Profile velocity of 60 revolutions per minute: the value written, and the value read back 2 s later.
    let writes = [(0x6060, 3), (0x6040, 0x06), (0x6040, 0x0F), (0x60FF, 60), (0x6040, 0x0F)];
    let moved = |from: i32, to: i32| (to - from) as f64 / 4000.0;
    let mut rig = Rig::epos4(config());
    for (index, value) in writes {
        rig.epos4_exchange(Request::Write(object(index, 0), value), Answer::Done);
    }
    let position = |rig: &mut Rig| {
        let request = Request::Read(object(0x6064, 0));
        let frame = rig.epos4_frame(&request.encode());
        match Answer::decode(&frame, &request) {
            Some(Answer::Value(value)) => value as i32,
            other => panic!("{other:?}"),
        }
    };
    rig.wait(Duration::from_secs(1));
    let from = position(&mut rig);
    rig.wait(Duration::from_millis(1960));
    let turns = moved(from, position(&mut rig));
    assert!((turns - 2.0).abs() < 0.02, "{turns}");

    let mut rig = Rig::epos2(config());
    for (index, value) in writes {
        let written = rig.epos2_exchange(epos2::Request::Write(Address { node: 0, index, subindex: 0 }, value));
        assert_eq!(written, Some(epos2::Answer::Done));
    }
    let position = |rig: &mut Rig| {
        let read = rig.epos2_exchange(epos2::Request::Read(Address { node: 0, index: 0x6064, subindex: 0 }));
        match read {
            Some(epos2::Answer::Value(value)) => value as i32,
            other => panic!("{other:?}"),
        }
    };
    rig.wait(Duration::from_secs(1));
    let from = position(&mut rig);
    rig.wait(Duration::from_millis(1840));
    let turns = moved(from, position(&mut rig));
    assert!((turns - 2.0).abs() < 0.02, "{turns}");
}

#[test]
fn refusals_carry_the_code_of_an_abort() {
    let other_node = |index| Address { node: 2, ..object(index, 0) };
    let cases = [
        (Request::Read(object(0x5FFF, 0)), 0x0602_0000),
        (Request::Read(object(0x607D, 9)), 0x0609_0011),
        (Request::Read(object(0x1008, 0)), 0x0607_0010),
        (Request::Read(other_node(0x6041)), 0x0F00_FFB9),
        (Request::Write(object(0x6041, 0), 1), 0x0601_0002),
        (Request::Write(object(0x6060, 0), 99), 0x0609_0030),
        (Request::SegmentRead { toggle: false }, 0x0F00_FFBF),
        (Request::InitiateSegmentedWrite(object(0x6040, 0), 10_000), 0x0504_0005),
        (Request::Nmt { node: 0, command: 77 }, 0x0F00_FFBF),
        (Request::Nmt { node: 5, command: 1 }, 0x0F00_FFB9),
    ];
    let mut rig = Rig::epos4(config());
    for (request, code) in cases {
        rig.epos4_exchange(request, Answer::Refused(code));
    }
    let unknown = serial::epos4::Frame::new(0x10, &[0, 0, 0, 0]).unwrap();
    let frame = rig.epos4_frame(&unknown);
    assert_eq!(frame.data(), [0xBF, 0xFF, 0x00, 0x0F]);
    // An EPOS2 receives a telegram with an unknown opcode to its end before it refuses the telegram.
    let mut rig = Rig::epos2(config());
    assert_eq!(rig.send(&[0x12]), b"O");
    // Opcode 0x12, two words of zeros. The CRC follows from the rule of the layout.
    let crc = 0x3B95_u16;
    let mut body = vec![0x01, 0, 0, 0, 0];
    body.extend(crc.to_le_bytes());
    assert_eq!(rig.send(&body), b"O\x00");
    assert_eq!(rig.send(b"O")[..5], [0x01, 0xBF, 0xFF, 0x00, 0x0F]);
}

#[test]
fn nmt_commands_are_obeyed_and_a_stopped_node_refuses_its_objects() {
    let read = Request::Read(object(0x6041, 0));
    let nmt = |command| Request::Nmt { node: 1, command };
    let mut rig = Rig::epos4(config());
    rig.epos4_exchange(nmt(2), Answer::Done);
    rig.epos4_exchange(read, Answer::Refused(0x0F00_FFC0));
    rig.epos4_exchange(nmt(0x80), Answer::Done);
    rig.epos4_exchange(read, Answer::Value(0x0440));
    let mut rig = Rig::epos2(config());
    let stop = epos2::Request::Nmt { node: 0, command: 2 };
    assert_eq!(rig.epos2_exchange(stop), None);
    let read = epos2::Request::Read(Address { node: 0, index: 0x6041, subindex: 0 });
    let refused = epos2::Answer::Refused(0x0F00_FFC0);
    assert_eq!(rig.epos2_exchange(read), Some(refused));
}

#[test]
fn a_restarting_device_is_silent_until_it_has_booted() {
    let mut rig = Rig::epos4(config());
    let read = [0x90, 0x02, 0x60, 0x02, 0x01, 0x41, 0x60, 0x00, 0x22, 0xD1];
    let reset = Request::Nmt { node: 0, command: 0x81 };
    rig.epos4_exchange(reset, Answer::Done);
    assert_eq!(rig.send(&read), [0_u8; 0], "40 ms of 50 have gone by");
    assert_eq!(rig.send(&read).len(), 14);
    let mut rig = Rig::epos4(EposSerialConfig {
        epos: Epos4Config { boot_delay: Duration::from_millis(300), ..config().epos },
        ..config()
    });
    assert_eq!(rig.send(&read), [0_u8; 0]);
    rig.wait(Duration::from_millis(300));
    assert_eq!(rig.send(&read).len(), 14);
}

#[test]
fn objects_are_read_and_written_in_segments() {
    let mut config = config();
    config.segment = 2;
    let mut rig = Rig::epos4(config);
    let name = object(0x1008, 0);
    rig.epos4_exchange(Request::InitiateSegmentedRead(name), Answer::Started(5, b"EP"));
    let segment = |toggle, last, data| Answer::Segment { toggle, last, data };
    let next = |toggle| Request::SegmentRead { toggle };
    rig.epos4_exchange(next(false), segment(false, false, b"OS"));
    rig.epos4_exchange(next(true), segment(true, true, b"4"));
    rig.epos4_exchange(next(false), Answer::Refused(0x0F00_FFBF));
    // A toggle bit that does not alternate ends the transfer.
    rig.epos4_exchange(Request::InitiateSegmentedRead(name), Answer::Started(5, b"EP"));
    rig.epos4_exchange(next(true), Answer::Refused(0x0503_0000));
    rig.epos4_exchange(next(false), Answer::Refused(0x0F00_FFBF));

    let target = object(0x607A, 0);
    let put = |toggle, last, data| Request::SegmentWrite { toggle, last, data };
    let taken = |toggle, length| Answer::Taken { toggle, length };
    rig.epos4_exchange(Request::InitiateSegmentedWrite(target, 4), Answer::Done);
    rig.epos4_exchange(put(false, false, &[1, 2, 3]), taken(false, 3));
    rig.epos4_exchange(put(true, true, &[4]), taken(true, 1));
    rig.epos4_exchange(Request::Read(target), Answer::Value(0x0403_0201));
    // Too few bytes, and too many.
    for data in [&[9, 9][..], &[9; 5]] {
        rig.epos4_exchange(Request::InitiateSegmentedWrite(target, 4), Answer::Done);
        rig.epos4_exchange(put(false, true, data), Answer::Refused(0x0607_0010));
        rig.epos4_exchange(Request::Read(target), Answer::Value(0x0403_0201));
    }
}

#[test]
fn after_the_frame_time_out_a_torn_exchange_is_over() {
    let read = epos2::Request::Read(Address { node: 0, index: 0x6041, subindex: 0 });
    let telegram = read.encode();
    // Points at which the host stops sending: after the opcode, within the telegram, before its acknowledgements.
    let body = telegram.body();
    let scripts: [&[&[u8]]; 5] =
        [&[&[0x10]], &[&[0x10], &body[..3]], &[&[0x10], body], &[&[0x10], body, b"O"], &[&[0x11], body]];
    for script in scripts {
        let mut rig = Rig::epos2(config());
        for bytes in script {
            rig.send(bytes);
        }
        // Before the time-out the next opcode is taken for the rest of the telegram. After the time-out it begins a
        // new telegram.
        rig.wait(Duration::from_millis(501));
        assert_eq!(rig.epos2_exchange(read), Some(epos2::Answer::Value(0x0440)), "{script:02x?}");
    }
    let mut rig = Rig::epos2(config());
    rig.send(&[0x10]);
    rig.wait(Duration::from_millis(400));
    assert_eq!(rig.send(&[0x10]), [0_u8; 0], "taken for a number of words");

    let bytes = [0x90, 0x02, 0x60, 0x02, 0x01, 0x41, 0x60, 0x00, 0x22, 0xD1];
    for offset in 0..bytes.len() {
        let mut rig = Rig::epos4(config());
        assert_eq!(rig.send(&bytes[..offset]), [0_u8; 0]);
        rig.wait(Duration::from_millis(501));
        assert_eq!(rig.send(&bytes).len(), 14, "torn at {offset}");
    }
}

#[test]
fn a_damaged_telegram_is_acknowledged_as_failed_and_not_obeyed() {
    let mut rig = Rig::epos2(config());
    assert_eq!(rig.send(&[0x11]), b"O");
    let damaged = [0x03, 0x40, 0x60, 0x00, 0x01, 0x0F, 0x00, 0x00, 0x00, 0x52, 0xEE];
    assert_eq!(rig.send(&damaged), b"F");
    let read = epos2::Request::Read(Address { node: 0, index: 0x6040, subindex: 0 });
    assert_eq!(rig.epos2_exchange(read), Some(epos2::Answer::Value(0)));
    // A host that does not acknowledge the answer also ends the exchange.
    assert_eq!(rig.send(&[0x10]), b"O");
    assert_eq!(rig.send(read.encode().body()), b"O\x00");
    assert_eq!(rig.send(b"F"), [0_u8; 0]);
    assert_eq!(rig.epos2_exchange(read), Some(epos2::Answer::Value(0)));
}

#[test]
fn what_comes_before_the_answer_is_not_heard() {
    let mut rig = Rig::epos4(config());
    let read = [0x90, 0x02, 0x60, 0x02, 0x01, 0x41, 0x60, 0x00, 0x22, 0xD1];
    let both = [read, read].concat();
    assert_eq!(rig.send(&both).len(), 14);
    assert_eq!(rig.send(&read).len(), 14);
}

#[test]
fn after_any_noise_and_the_time_out_a_port_works() {
    let read = [0x90, 0x02, 0x60, 0x02, 0x01, 0x41, 0x60, 0x00, 0x22, 0xD1];
    let statusword = epos2::Request::Read(Address { node: 0, index: 0x6041, subindex: 0 });
    for seed in 0..50 {
        let mut noise = crate::plant::Noise::new(seed);
        // Random bytes with many opcodes, stuffing bytes and acknowledgements.
        let bytes: Vec<u8> = std::iter::repeat_with(|| match noise.bits() % 8 {
            0 | 1 => 0x90,
            2 => 0x02,
            3 => b'O',
            4 => 0x00,
            _ => noise.bits() as u8,
        })
        .take(400)
        .collect();
        let mut rig = Rig::epos4(config());
        rig.send(&bytes);
        rig.wait(Duration::from_millis(501));
        assert_eq!(rig.send(&read).len(), 14, "seed {seed}");
        let mut rig = Rig::epos2(config());
        rig.send(&bytes);
        rig.wait(Duration::from_millis(501));
        let answer = rig.epos2_exchange(statusword);
        assert_eq!(answer, Some(epos2::Answer::Value(0x0440)), "seed {seed}");
    }
}
