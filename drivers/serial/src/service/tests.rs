//! Dialogues of the client with a service port.

use super::*;
use crate::Settings;
use crate::epos4::tests::{CONTROLWORD, HOME_POSITION, NAME, STATUSWORD, encoded};

/// Content of a reply as an owned value.
type Owned = Result<(Option<u32>, Vec<u8>), ServiceError>;

/// A client, and all bytes that it has sent.
struct Host {
    client: Client,
    now: Instant,
}

impl Host {
    fn new(dialect: Dialect) -> Self {
        Self { client: Client::new(Config::new(dialect, Settings::EPOS)), now: Instant::from_nanos(1_000_000_000) }
    }

    fn read(dialect: Dialect) -> Self {
        let mut host = Self::new(dialect);
        host.client.read(STATUSWORD, host.now).unwrap();
        host
    }

    /// Bytes that the client sends now. The line accepts all of them.
    fn says(&mut self) -> Vec<u8> {
        let bytes = self.client.bytes().to_vec();
        self.client.consume(bytes.len(), self.now);
        bytes
    }

    fn hears(&mut self, bytes: &[u8]) {
        self.client.handle(bytes, self.now);
    }

    fn pass(&mut self, time: Duration) {
        self.now += time;
        self.client.handle_timeout(self.now);
    }

    /// Advances the time to the next deadline of the client, and returns the elapsed time.
    fn wait(&mut self) -> Duration {
        let due = self.client.poll_timeout().expect("it waits");
        let waited = due.since(self.now);
        self.pass(waited);
        waited
    }

    fn result(&mut self) -> Option<Owned> {
        Some(self.client.poll()?.map(|reply| match reply {
            Reply::Value(value) => (Some(value), Vec::new()),
            Reply::Object(object) => (None, object.to_vec()),
            Reply::Done => (None, Vec::new()),
        }))
    }
}

fn hex(text: &str) -> Vec<u8> {
    let bytes = text.split_whitespace();
    bytes.map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

fn epos4(answer: Answer<'_>) -> Vec<u8> {
    encoded(&answer.encode())
}

const READ: &str = "90 02 60 02 01 41 60 00 22 D1";
const WRITE: &str = "90 02 68 04 01 40 60 00 0F 00 00 00 B3 07";

#[test]
fn exchanges_are_the_bytes_of_the_line() {
    type Start = fn(&mut Client, Instant) -> Result<(), StartError>;
    let home: Start = |client, now| client.read(HOME_POSITION, now);
    let read: Start = |client, now| client.read(STATUSWORD, now);
    let write: Start = |client, now| client.write(CONTROLWORD, 0x000F, now);
    let reset: Start = |client, now| client.nmt(1, 0x81, now);
    // Bytes that the host sends and receives, in turns.
    let cases: [(Dialect, Start, &[&str], Owned); 7] = [
        (
            Dialect::Epos4,
            home,
            &["90 02 60 02 01 B0 30 00 2E 62", "90 02 00 04 00 00 00 00 01 90 90 00 00 9A 5C"],
            Ok((Some(0x9001), vec![])),
        ),
        (Dialect::Epos4, write, &[WRITE, "90 02 00 02 00 00 00 00 40 8B"], Ok((None, vec![]))),
        (
            Dialect::Epos2,
            read,
            &["10", "4F", "01 41 60 00 01 AB F0", "4F 00", "4F", "03 00 00 00 00 37 01 00 00 C5 1B", "4F"],
            Ok((Some(0x0137), vec![])),
        ),
        (
            Dialect::Epos2,
            write,
            &["11", "4F", "03 40 60 00 01 0F 00 00 00 52 EF", "4F 00", "4F", "01 00 00 00 00 51 AA", "4F"],
            Ok((None, vec![])),
        ),
        (
            Dialect::Epos2,
            read,
            &["10", "4F", "01 41 60 00 01 AB F0", "4F 00", "4F", "03 00 00 02 06 00 00 00 00 26 E4", "4F"],
            Err(ServiceError::Refused(0x0602_0000)),
        ),
        (
            Dialect::Epos2,
            write,
            &["11", "4F", "03 40 60 00 01 0F 00 00 00 52 EF", "4F 00", "4F", "01 02 00 01 06 B6 7E", "4F"],
            Err(ServiceError::Refused(0x0601_0002)),
        ),
        (Dialect::Epos2, reset, &["0E", "4F", "01 01 00 81 00 6B 9C", "4F"], Ok((None, vec![]))),
    ];
    for (number, (dialect, start, line, expected)) in cases.into_iter().enumerate() {
        let mut host = Host::new(dialect);
        start(&mut host.client, host.now).unwrap();
        for (turn, bytes) in line.iter().enumerate() {
            if turn % 2 == 0 {
                assert_eq!(host.says(), hex(bytes), "case {number}, turn {turn}");
            } else {
                // The bytes arrive one by one.
                hex(bytes).iter().for_each(|byte| host.hears(&[*byte]));
            }
        }
        assert_eq!(host.says(), [], "case {number}");
        assert_eq!(host.result(), Some(expected), "case {number}");
        assert_eq!(host.result(), None, "a reply is given once");
    }
}

#[test]
fn objects_cross_in_segments_of_any_length() {
    let object: Vec<u8> = (0..600_u16).map(|byte| byte as u8).collect();
    let mut host = Host::new(Dialect::Epos4);
    host.client.read_segmented(NAME, host.now).unwrap();
    host.says();
    host.hears(&epos4(Answer::Started(600, &object[..200])));
    for (toggle, from, to) in [(false, 200, 454), (true, 454, 599), (false, 599, 600)] {
        let asked = host.says();
        assert_eq!((asked[2], asked[4]), (0x62, u8::from(toggle)));
        let data = &object[from..to];
        let last = to == 600;
        host.hears(&epos4(Answer::Segment { toggle, last, data }));
    }
    assert_eq!(host.result(), Some(Ok((None, object.clone()))));

    let mut wrote = Vec::new();
    host.client.write_segmented(NAME, &object, host.now).unwrap();
    host.says();
    host.hears(&epos4(Answer::Done));
    for toggle in [false, true, false] {
        let bytes = host.says();
        let mut deframer = epos4::Deframer::new();
        let mut frames = bytes.iter().filter_map(|byte| deframer.take(*byte));
        let frame = frames.next().unwrap().unwrap();
        let Some(Request::SegmentWrite { toggle: of, last, data }) = Request::decode(&frame) else {
            panic!("{frame:?}");
        };
        wrote.extend_from_slice(data);
        assert_eq!((of, last), (toggle, wrote.len() == 600));
        let length = data.len() as u8;
        host.hears(&epos4(Answer::Taken { toggle, length }));
    }
    assert_eq!(host.result(), Some(Ok((None, Vec::new()))));
    assert_eq!(wrote, object);
}

#[test]
fn what_does_not_fit_or_exist_is_refused_at_once() {
    let mut host = Host::new(Dialect::Epos2);
    let now = host.now;
    let client = &mut host.client;
    assert_eq!(client.read_segmented(NAME, now), Err(StartError::NoSegments));
    let mut host = Host::new(Dialect::Epos4);
    let (size, capacity) = (4097, 4096);
    let large = host.client.write_segmented(NAME, &[0; 4097], now);
    assert_eq!(large, Err(StartError::TooLarge { size, capacity }));
    host.client.read_segmented(NAME, now).unwrap();
    assert_eq!(host.client.read(STATUSWORD, now), Err(StartError::Busy));
    host.says();
    host.hears(&epos4(Answer::Started(4097, &[])));
    let large = ServiceError::TooLarge { size, capacity };
    assert_eq!(host.result(), Some(Err(large)));
}

/// The time-out plus the transmission time of a request of ten bytes and of the answer to it.
fn patience() -> Duration {
    TIME_OUT + Settings::EPOS.line_time(10) + Settings::EPOS.line_time(24)
}

#[test]
fn silence_is_borne_twice_and_nothing_is_sent_meanwhile() {
    let mut host = Host::read(Dialect::Epos4);
    assert_eq!(host.says(), hex(READ));
    host.pass(patience() - Duration::from_millis(1));
    assert_eq!(host.says(), [], "before the time-out");
    host.pass(Duration::from_millis(1));
    host.wait();
    assert_eq!(host.says(), hex(READ), "once more");
    host.wait();
    let waited = host.now.since(Instant::from_nanos(1_000_000_000));
    assert!(waited < 2 * patience() + Duration::from_millis(1), "{waited:?}");
    assert_eq!(host.result(), Some(Err(ServiceError::TimedOut { waited })));
    assert_eq!((host.says(), host.client.poll_timeout()), (vec![], None));
}

#[test]
fn after_an_error_the_frame_time_out_is_waited_out_and_the_request_sent_anew() {
    let okay = epos4(Answer::Value(7));
    let mut damaged = okay.clone();
    damaged[8] ^= 0x10;
    let cases = [
        (Dialect::Epos4, damaged, ServiceError::Damaged),
        (Dialect::Epos4, epos4(Answer::Refused(CRC)), ServiceError::NotAcknowledged),
        (Dialect::Epos4, epos4(Answer::Done), ServiceError::Unexpected),
        (Dialect::Epos2, b"F".to_vec(), ServiceError::NotAcknowledged),
        (Dialect::Epos2, b"x".to_vec(), ServiceError::Damaged),
    ];
    for (dialect, wrong, error) in cases {
        let mut host = Host::read(dialect);
        let request = host.says();
        host.pass(Duration::from_millis(3));
        host.hears(&wrong);
        // The acknowledgement is too late and has no effect.
        host.hears(&okay);
        assert_eq!((host.says(), host.result()), (vec![], None), "{error}");
        assert_eq!(host.wait(), TIME_OUT, "{error}");
        assert_eq!(host.says(), request, "{error}");
        host.hears(&wrong);
        assert_eq!(host.result(), Some(Err(error)));
    }
}

#[test]
fn an_answer_with_a_wrong_crc_is_told_so_to_an_epos2() {
    let mut host = Host::read(Dialect::Epos2);
    for heard in ["4F", "4F 00"] {
        host.says();
        host.hears(&hex(heard));
    }
    assert_eq!(host.says(), b"O");
    host.hears(&hex("03 00 00 00 00 37 01 00 01 C5 1B"));
    assert_eq!(host.says(), b"F");
    host.wait();
    assert_eq!(host.says(), [0x10]);
}

#[test]
fn a_late_answer_is_not_taken_for_the_next_one() {
    let mut host = Host::read(Dialect::Epos4);
    host.says();
    host.pass(patience());
    host.wait();
    host.says();
    // The answer to the first attempt arrives 600 ms after that attempt, and completes the second attempt.
    host.pass(Duration::from_millis(90));
    host.hears(&epos4(Answer::Value(1)));
    assert_eq!(host.result(), Some(Ok((Some(1), vec![]))));
    host.client.read(CONTROLWORD, host.now).unwrap();
    assert_eq!(host.says(), [], "the second attempt is not answered yet");
    host.pass(Duration::from_millis(500));
    host.hears(&epos4(Answer::Value(1)));
    host.wait();
    assert!(!host.says().is_empty());
    host.hears(&epos4(Answer::Value(2)));
    assert_eq!(host.result(), Some(Ok((Some(2), vec![]))));
}

#[test]
fn a_segment_with_the_wrong_toggle_starts_the_transfer_anew() {
    let mut host = Host::new(Dialect::Epos4);
    host.client.read_segmented(NAME, host.now).unwrap();
    let initiation = host.says();
    for attempt in 0..2 {
        host.hears(&epos4(Answer::Started(4, b"ab")));
        host.says();
        let (toggle, last, data) = (true, true, &b"cd"[..]);
        host.hears(&epos4(Answer::Segment { toggle, last, data }));
        if attempt == 0 {
            host.wait();
            assert_eq!(host.says(), initiation);
        }
    }
    assert_eq!(host.result(), Some(Err(ServiceError::Unexpected)));
}

#[test]
fn a_line_that_takes_nothing_ends_a_request_too() {
    for dialect in [Dialect::Epos2, Dialect::Epos4] {
        let mut host = Host::read(dialect);
        for _ in 0..4 {
            if host.client.poll_timeout().is_some() {
                host.wait();
            }
        }
        let waited = 2 * TIME_OUT;
        assert_eq!(host.result(), Some(Err(ServiceError::TimedOut { waited })));
        assert_eq!(host.says(), []);
    }
}

#[test]
fn nothing_that_comes_panics_and_every_request_ends() {
    let mut state = 0x2545_F491_4F6C_DD1D_u64;
    let mut random = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    // Half of the bytes are valid parts of a protocol.
    let likely = [0x90, 0x02, 0x00, 0x00, 0x01, 0x03, 0x04, b'O', b'O', b'F'];
    let right = [
        epos4(Answer::Value(5)),
        epos4(Answer::Done),
        epos4(Answer::Started(9, b"12345")),
        b"O".to_vec(),
        b"O\0".to_vec(),
        hex("03 00 00 00 00 37 01 00 00 C5 1B"),
    ];
    let mut ended = [0; 2];
    for round in 0..2_000 {
        let dialect = [Dialect::Epos2, Dialect::Epos4][round % 2];
        let mut host = Host::new(dialect);
        let now = host.now;
        let _ = match random() % 4 {
            0 => host.client.read_segmented(NAME, now),
            1 => host.client.write_segmented(NAME, &[7; 700], now),
            2 => host.client.nmt(0, 1, now),
            _ => host.client.read(STATUSWORD, now),
        };
        while host.client.poll_timeout().is_some() {
            // The line accepts a part of the bytes, possibly none.
            let count = random() as usize % (host.client.bytes().len() + 1);
            host.client.consume(count, host.now);
            let whole = random() as usize % (2 * right.len());
            let noise: Vec<u8> = (0..random() % 20)
                .map(|_| match random() % 2 {
                    0 => likely[random() as usize % likely.len()],
                    _ => random() as u8,
                })
                .collect();
            host.hears(right.get(whole).unwrap_or(&noise));
            host.pass(Duration::from_millis(random() % 80));
            let took = host.now.since(now);
            // Two attempts of at most four turns each, and two pauses.
            assert!(took < Duration::from_secs(8), "round {round}: {took:?}");
        }
        if let Some(result) = host.result() {
            ended[usize::from(result.is_ok())] += 1;
        }
    }
    assert!(ended[0] > 500 && ended[1] > 100, "{ended:?}");
}
