//! A host that speaks to the matrix byte by byte.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use can::Instant;
use serial::{Line, Settings, VirtualLine};

use super::{EchoProbe, NO_ECHO, UltrasonicConfig, UltrasonicError, UltrasonicMatrix, frames};
use crate::World;

const SETTINGS: Settings = UltrasonicMatrix::SETTINGS;
const SLOT: Duration = Duration::from_micros(3500);
/// Longer than the query of a row.
const PATIENCE: Duration = Duration::from_millis(100);
/// Distance of the plane in the tests, m, and the echo time of an element, µs.
const PLANE: f64 = 0.35;
const ECHO: u16 = 2041;

/// Asked elements, each with its time.
type Asked = Arc<Mutex<Vec<((usize, usize), Instant)>>>;

/// A distance per element.
struct Surface {
    distance: fn((usize, usize)) -> Option<f64>,
    asked: Asked,
}

impl EchoProbe for Surface {
    fn distance(&mut self, element: (usize, usize), now: Instant) -> Option<f64> {
        self.asked.lock().unwrap().push((element, now));
        (self.distance)(element)
    }
}

fn exact() -> UltrasonicConfig {
    UltrasonicConfig { noise: 0.0, ..UltrasonicConfig::default() }
}

struct Rig {
    world: World,
    host: VirtualLine,
    asked: Asked,
    now: Instant,
}

impl Rig {
    fn new(config: UltrasonicConfig, distance: fn((usize, usize)) -> Option<f64>) -> Self {
        let asked = Asked::default();
        let probe = Surface { distance, asked: Arc::clone(&asked) };
        let mut world = World::new();
        let matrix = UltrasonicMatrix::new(config, Box::new(probe)).unwrap();
        let line = world.add_line(SETTINGS, None, Box::new(matrix));
        let host = world.host_line(line, 1024);
        Self { world, host, asked, now: Instant::ZERO }
    }

    fn plane(config: UltrasonicConfig) -> Self {
        Self::new(config, |_| Some(PLANE))
    }

    fn run(&mut self, time: Duration) -> Vec<u8> {
        self.now += time;
        self.world.advance(self.now);
        let mut into = [0; 1024];
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

    /// Sends the frame of a body, and returns the body of the answer.
    fn exchange(&mut self, body: &[u8]) -> Vec<u8> {
        let answer = self.ask(&frames::encode(body));
        let [0xA5, length, body @ .., crc] = answer.as_slice() else { panic!("no frame: {answer:02x?}") };
        assert_eq!(usize::from(*length), body.len());
        assert_eq!(*crc, frames::crc(&answer[1..answer.len() - 1]));
        body.to_vec()
    }

    /// Echo times of a row.
    fn row(&mut self, row: u8) -> Vec<u16> {
        let answer = self.exchange(&[0x03, row]);
        assert_eq!(answer[..2], [0x03, row]);
        answer[2..].chunks(2).map(|time| u16::from_be_bytes([time[0], time[1]])).collect()
    }

    fn pair(&mut self, pair: [u8; 4]) -> u16 {
        let answer = self.exchange(&[&[0x02], &pair[..]].concat());
        assert_eq!(answer[..5], [&[0x02], &pair[..]].concat());
        u16::from_be_bytes([answer[5], answer[6]])
    }
}

#[test]
fn the_check_of_a_frame_is_the_crc_of_its_name() {
    // CRC-8 with polynomial 0x07 (CRC-8/SMBUS) of the usual check string.
    assert_eq!(frames::crc(b"123456789"), 0xF4);
}

#[test]
fn frames_are_the_documented_bytes() {
    let mut rig = Rig::plane(exact());
    // 12 elements, 20.0 mm, 3500 µs.
    assert_eq!(
        rig.ask(&[0xA5, 1, 0x01, 0x12]),
        [0xA5, 6, 0x01, 12, 0, 200, 0x0D, 0xAC, frames::crc(&[6, 1, 12, 0, 200, 0x0D, 0xAC])]
    );
    let pair = [5, 0x02, 0, 11, 0, 11];
    let answer = [7, 0x02, 0, 11, 0, 11, 0x07, 0xF9];
    assert_eq!(
        rig.ask(&[&[0xA5], &pair[..], &[frames::crc(&pair)]].concat()),
        [&[0xA5], &answer[..], &[frames::crc(&answer)]].concat()
    );
}

#[test]
fn an_echo_time_is_the_way_there_and_back() {
    let mut rig = Rig::new(exact(), |(row, column)| (row == 2).then_some(0.1 + 0.03 * column as f64));
    let expected: Vec<u16> =
        (0..12).map(|column| (2.0 * (0.1 + 0.03 * f64::from(column)) / 343.0 * 1e6).round() as u16).collect();
    assert_eq!(rig.row(2), expected);
    assert_eq!(rig.row(3), [NO_ECHO; 12]);
}

#[test]
fn an_echo_after_the_slot_is_none() {
    // The sound returns from 0.6 m in 3499 µs, and from 0.6003 m in 3500 µs.
    let mut rig = Rig::new(exact(), |(row, _)| Some(if row == 0 { 0.6 } else { 0.6003 }));
    assert_eq!((rig.pair([0; 4]), rig.pair([1, 0, 1, 0])), (3499, NO_ECHO));
}

#[test]
fn a_row_takes_one_slot_per_element() {
    let mut rig = Rig::plane(exact());
    let begin = rig.now;
    let request = frames::encode(&[0x03, 7]);
    let asked_at = begin + SETTINGS.line_time(request.len());
    rig.write(&request);
    let reply = asked_at + 12 * SLOT + exact().answer_delay + SETTINGS.line_time(1);
    assert_eq!(rig.run(reply.since(begin) - Duration::from_nanos(1)), []);
    assert_eq!(rig.run(Duration::from_nanos(1)), [0xA5]);
    let expected: Vec<_> = (0..12).map(|column| ((7, column as usize), asked_at + column * SLOT)).collect();
    assert_eq!(*rig.asked.lock().unwrap(), expected);
}

#[test]
fn the_echo_of_a_pair_takes_the_longer_way_of_a_reflection() {
    let mut rig = Rig::plane(exact());
    let way = |base: f64| (2.0 * (base / 2.0).hypot(PLANE) / 343.0 * 1e6).round() as u16;
    // The half-cone of 8° at 0.35 m holds a base of 98 mm: 4 elements and not 5, (3, 3) and not (4, 3).
    for (pair, time) in [
        ([5, 5, 5, 5], ECHO),
        ([5, 5, 5, 6], way(0.02)),
        ([5, 1, 5, 5], way(0.08)),
        ([5, 0, 5, 5], NO_ECHO),
        ([5, 5, 2, 2], way(0.06 * 2.0_f64.sqrt())),
        ([5, 5, 1, 2], NO_ECHO),
    ] {
        assert_eq!(rig.pair(pair), time, "{pair:?}");
    }
    // A box under one of the two elements is not in the cone of the other.
    let mut rig = Rig::new(exact(), |(_, column)| Some(if column < 6 { 0.25 } else { PLANE }));
    assert_eq!((rig.pair([5, 5, 5, 6]), rig.pair([5, 6, 5, 5])), (way(0.02), way(0.02)));
    let mut rig = Rig::new(exact(), |(_, column)| (column < 6).then_some(0.25));
    assert_eq!((rig.pair([5, 5, 5, 6]), rig.pair([5, 6, 5, 5])), (NO_ECHO, NO_ECHO));
}

#[test]
fn noise_and_lost_echoes_have_their_deviation_and_share() {
    let mut rig = Rig::plane(UltrasonicConfig { noise: 0.003, drop_out: 0.1, seed: 3, ..exact() });
    let times: Vec<u16> = (0..300).flat_map(|_| rig.row(4)).collect();
    let count = times.len() as f64;
    let heard: Vec<f64> = times.iter().filter(|time| **time != NO_ECHO).map(|time| f64::from(*time)).collect();
    let lost = 1.0 - heard.len() as f64 / count;
    // Five standard errors.
    assert!((lost - 0.1).abs() < 5.0 * (0.09 / count).sqrt(), "{lost}");
    let distances: Vec<f64> = heard.iter().map(|time| time * 1e-6 * 343.0 / 2.0).collect();
    let mean = distances.iter().sum::<f64>() / distances.len() as f64;
    let square = distances.iter().map(|distance| (distance - mean).powi(2)).sum::<f64>() / distances.len() as f64;
    let error = 5.0 / (distances.len() as f64).sqrt();
    assert!((mean - PLANE).abs() < 0.003 * error, "{mean}");
    assert!((square.sqrt() / 0.003 - 1.0).abs() < error, "{}", square.sqrt());
}

#[test]
fn the_same_queries_give_the_same_bytes() {
    let bytes = |seed| {
        let mut rig = Rig::plane(UltrasonicConfig { drop_out: 0.2, seed, ..UltrasonicConfig::default() });
        (0..12).flat_map(|row| rig.row(row)).collect::<Vec<_>>()
    };
    assert_eq!(bytes(1), bytes(1));
    assert_ne!(bytes(1), bytes(2));
}

#[test]
fn a_request_during_a_measurement_or_a_reply_is_lost() {
    let row = frames::encode(&[0x03, 0]);
    let identify = frames::encode(&[0x01]);
    let reply = SETTINGS.line_time(frames::encode(&[0; 26]).len());
    let begin = SETTINGS.line_time(row.len());
    let end = begin + 12 * SLOT + exact().answer_delay + reply;
    // The first byte of a request that is written at this time ends with the reply.
    let last = end - SETTINGS.line_time(1);
    for (at, answers) in [
        (begin, 1),
        (begin + SLOT, 1),
        (begin + 12 * SLOT, 1),
        (last - SETTINGS.line_time(4), 1),
        (last - Duration::from_micros(10), 1),
        (last, 1),
        (last + Duration::from_micros(10), 2),
        (end, 2),
    ] {
        let mut rig = Rig::plane(exact());
        rig.write(&row);
        let mut heard = rig.run(at);
        rig.write(&identify);
        heard.extend(rig.run(PATIENCE));
        let expected = if answers == 1 { 29 } else { 29 + 9 };
        assert_eq!(heard.len(), expected, "{at:?}");
        assert_eq!(rig.exchange(&[0x01])[..2], [0x01, 12]);
    }
}

#[test]
fn requests_that_cannot_be_served_are_refused() {
    let mut rig = Rig::plane(exact());
    for (body, reason) in [
        (&[0x04][..], 1),
        (&[0xFF], 1),
        (&[0x01, 0], 2),
        (&[0x02, 0, 0, 0], 2),
        (&[0x03], 2),
        (&[0x03, 0, 0], 2),
        (&[0x02, 12, 0, 0, 0], 3),
        (&[0x02, 0, 0, 0, 12], 3),
        (&[0x03, 12], 3),
    ] {
        assert_eq!(rig.exchange(body), [0xFF, body[0], reason], "{body:02x?}");
    }
    assert!(rig.asked.lock().unwrap().is_empty());
}

#[test]
fn a_frame_that_is_torn_or_wrong_is_not_answered_and_the_next_frame_is() {
    let identify = frames::encode(&[0x01]);
    let mut wrong = identify.clone();
    wrong[3] ^= 1;
    let empty = frames::encode(&[]);
    let long = frames::encode(&[0x01; 9]);
    for bytes in [&wrong[..], &identify[..3], &empty, &long, &[0xA5, 8], &[0, 1, 2, 3], b"hello"] {
        let mut rig = Rig::plane(exact());
        assert_eq!(rig.ask(bytes), [], "{bytes:02x?}");
        assert_eq!(rig.exchange(&[0x01])[..2], [0x01, 12], "after {bytes:02x?}");
    }
    // Bytes that begin no frame are skipped without a pause.
    for bytes in [&[0, 1, 2, 3][..], &[0xA5], &wrong, &empty] {
        let mut rig = Rig::plane(exact());
        assert_eq!(rig.ask(&[bytes, &identify].concat()).len(), 9, "{bytes:02x?}");
    }
}

#[test]
fn impossible_configurations_are_refused() {
    let refusal =
        |config| UltrasonicMatrix::new(config, Box::new(Surface { distance: |_| None, asked: Asked::default() })).err();
    let slot = Duration::from_micros(65_535);
    for (config, error) in [
        (UltrasonicConfig { size: 0, ..exact() }, UltrasonicError::Size { size: 0 }),
        (UltrasonicConfig { size: 65, ..exact() }, UltrasonicError::Size { size: 65 }),
        (UltrasonicConfig { pitch: 0.0, ..exact() }, UltrasonicError::Pitch { pitch: 0.0 }),
        (UltrasonicConfig { pitch: 7.0, ..exact() }, UltrasonicError::Pitch { pitch: 7.0 }),
        (UltrasonicConfig { half_cone: -0.1, ..exact() }, UltrasonicError::Cone { half_cone: -0.1 }),
        (UltrasonicConfig { half_cone: 1.6, ..exact() }, UltrasonicError::Cone { half_cone: 1.6 }),
        (UltrasonicConfig { slot: Duration::ZERO, ..exact() }, UltrasonicError::Slot { slot: Duration::ZERO }),
        (UltrasonicConfig { slot, ..exact() }, UltrasonicError::Slot { slot }),
        (UltrasonicConfig { speed_of_sound: 0.0, ..exact() }, UltrasonicError::SpeedOfSound { speed: 0.0 }),
        (UltrasonicConfig { noise: -0.001, ..exact() }, UltrasonicError::Noise { noise: -0.001 }),
        (UltrasonicConfig { drop_out: 1.01, ..exact() }, UltrasonicError::DropOut { share: 1.01 }),
    ] {
        assert_eq!(refusal(config), Some(error));
    }
    let noise = UltrasonicConfig { noise: f64::NAN, ..exact() };
    assert!(matches!(refusal(noise), Some(UltrasonicError::Noise { .. })));
}

#[test]
fn positions_of_elements_lie_around_the_centre() {
    let config = exact();
    for (element, expected) in [((0, 0), [-0.11, -0.11]), ((0, 11), [0.11, -0.11]), ((6, 5), [-0.01, 0.01])] {
        let position = config.position(element);
        let apart = (position[0] - expected[0]).hypot(position[1] - expected[1]);
        assert!(apart < 1e-12, "{element:?}: {position:?}");
    }
}
