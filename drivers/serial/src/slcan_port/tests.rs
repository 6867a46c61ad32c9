//! Dialogues with an slcan adapter.

use can::StandardId;

use super::*;
use crate::{TimedByte, VirtualLine, VirtualLinePeer, virtual_line};

/// Commands that remove an acceptance filter.
const FILTER: &str = "M00000000\rmFFFFFFFF\r";

/// The port, the device's end of its line, and the time.
struct Stage {
    port: SlcanPort<VirtualLine>,
    peer: VirtualLinePeer,
    now: Instant,
}

impl Stage {
    fn new(capacity: usize) -> Self {
        let (line, peer) = virtual_line(capacity);
        let port = SlcanPort::new(line, Bitrate::KBPS_1000, Instant::ZERO).unwrap();
        let now = Instant::ZERO;
        Self { port, peer, now }
    }

    /// A port whose adapter answered each command with an empty line.
    fn open(capacity: usize) -> Self {
        let mut stage = Self::new(capacity);
        assert_eq!(stage.open_with(&[("\rC\r", "\r\r"), ("S8\r", "\r"), (FILTER, "\r\r"), ("O\r", "\r")]), Ok(()));
        stage
    }

    /// Checks and answers each line of the port, and returns the result of opening.
    fn open_with(&mut self, script: &[(&str, &str)]) -> Result<(), SlcanError> {
        for (said, answer) in script {
            let mut told = self.said();
            // A line with little room accepts the bytes piece by piece.
            while told.len() < said.len() && self.port.poll_open(self.now).is_pending() {
                let more = self.said();
                if more.is_empty() {
                    break;
                }
                told += &more;
            }
            assert_eq!(told, *said);
            self.answer(answer.as_bytes());
            if let Poll::Ready(result) = self.port.poll_open(self.now) {
                return result;
            }
            // An answer may make the port send the next command at once.
            if self.peer.peek().is_none() {
                self.now = self.port.poll_timeout().unwrap();
                if let Poll::Ready(result) = self.port.poll_open(self.now) {
                    return result;
                }
            }
        }
        panic!("it still waits, and says {:?}", self.said());
    }

    fn said(&mut self) -> String {
        let bytes = std::iter::from_fn(|| self.peer.take());
        String::from_utf8(bytes.map(|timed| timed.byte).collect()).unwrap()
    }

    fn answer(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            let at = self.now;
            self.peer.deliver(TimedByte { byte, at });
        }
    }

    fn receive(&mut self, most: usize) -> Result<Vec<String>, PortError> {
        let mut into = vec![Received { frame: frame(0, &[]), at: Instant::ZERO }; most];
        let count = self.port.receive(self.now, &mut into)?;
        let received = into[..count].iter();
        Ok(received.map(|received| received.frame.to_string()).collect())
    }
}

fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::new(StandardId::new(id).unwrap(), data).unwrap()
}

#[test]
fn it_opens_by_close_bit_rate_and_open_whatever_the_answers_look_like() {
    // Four adapters. The first was left open by an earlier host. The second was closed, and answers `C` with a bell.
    // The third acknowledges nothing but reports a version. The fourth is recognised by its frames only.
    let scripts: [&[(&str, &str)]; 4] = [
        &[("\rC\r", "t0800\rz\r\r\r"), ("S8\r", "\r"), (FILTER, "\r\r"), ("O\r", "\r")],
        &[("\rC\r", "\x07\x07"), ("S8\r", "\r"), (FILTER, "\x07\x07"), ("O\r", "\r")],
        &[("\rC\r", ""), ("S8\r", ""), (FILTER, ""), ("O\r", ""), ("V\r", "version 8\r")],
        &[("\rC\r", ""), ("S8\r", ""), (FILTER, ""), ("O\r", "t70117F\r")],
    ];
    for script in scripts {
        let mut stage = Stage::new(256);
        assert_eq!(stage.open_with(script), Ok(()), "{script:?}");
        assert!(stage.now <= Instant::ZERO + Duration::from_millis(900));
        assert_eq!(stage.port.poll_open(stage.now), Poll::Ready(Ok(())));
        assert_eq!(stage.port.poll_timeout(), None);
        // Frames from before the opening are not received.
        assert_eq!(stage.receive(8), Ok(vec![]));
        assert_eq!(stage.port.counters(), Counters::default());
    }
}

#[test]
fn an_adapter_that_refuses_or_says_nothing_is_not_opened() {
    let kbps = 1000;
    let scripts: [(&[(&str, &str)], SlcanError); 5] = [
        (&[("\rC\r", "\r"), ("S8\r", "\x07")], SlcanError::BitrateRefused { kbps }),
        (&[("\rC\r", "\r"), ("S8\r", "\r"), (FILTER, "\r\x07"), ("O\r", "\x07")], SlcanError::OpenRefused),
        (&[("\rC\r", ""), ("S8\r", ""), (FILTER, ""), ("O\r", ""), ("V\r", "")], SlcanError::Silent),
        // A line that echoes, and a device with another baud rate.
        (&[("\rC\r", "\rC\r"), ("S8\r", "S8\r"), (FILTER, FILTER), ("O\r", "O\r"), ("V\r", "V\r")], SlcanError::Silent),
        (
            &[
                ("\rC\r", "\x1f\r"),
                ("S8\r", "\x1f\x02\r"),
                (FILTER, "\x1f\r\x1f\r"),
                ("O\r", "\x1f\r"),
                ("V\r", "\x1f\x02v\r"),
            ],
            SlcanError::Silent,
        ),
    ];
    for (script, error) in scripts {
        let mut stage = Stage::new(256);
        assert_eq!(stage.open_with(script), Err(error));
        assert_eq!(stage.port.poll_open(stage.now), Poll::Ready(Err(error)));
        let offered = [frame(0x80, &[])];
        assert_eq!(stage.port.send(stage.now, &offered), Ok(0));
    }
    let (line, _peer) = virtual_line(256);
    let odd = Bitrate::from_kbps(40).unwrap();
    let refused = SlcanPort::new(line, odd, Instant::ZERO);
    assert!(matches!(refused, Err(SlcanError::NoSuchBitrate { kbps: 40 })));
    let (line, peer) = virtual_line(256);
    drop(peer);
    let refused = SlcanPort::new(line, Bitrate::KBPS_500, Instant::ZERO);
    assert!(matches!(refused, Err(SlcanError::Line(LineError::Gone))));
}

#[test]
fn one_that_listens_is_opened_so() {
    let mut stage = Stage::new(256);
    let (line, peer) = virtual_line(256);
    stage.port = SlcanPort::listening(line, Bitrate::KBPS_500, Instant::ZERO).unwrap();
    stage.peer = peer;
    let script = [("\rC\r", "\r\r"), ("S6\r", "\r"), (FILTER, "\r\r"), ("L\r", "\r")];
    assert_eq!(stage.open_with(&script), Ok(()));
    stage.answer(b"t70117F\r");
    assert_eq!(stage.receive(8), Ok(vec!["701#7F".to_owned()]));
}

#[test]
fn nothing_is_sent_or_received_before_it_is_open() {
    let mut stage = Stage::new(256);
    stage.said();
    stage.answer(b"t0800\r");
    assert_eq!(stage.port.send(stage.now, &[frame(0x80, &[])]), Ok(0));
    assert_eq!(stage.receive(8), Ok(vec![]));
    assert_eq!(stage.said(), "");
    assert_eq!(stage.port.counters().refused, 1);
}

#[test]
fn frames_go_out_as_text_in_one_write() {
    let mut stage = Stage::open(256);
    let frames = [frame(0x080, &[]), frame(0x601, &[0x40, 0x41, 0x60, 0, 0, 0, 0, 0])];
    assert_eq!(stage.port.send(stage.now, &frames), Ok(2));
    assert_eq!(stage.said(), "t0800\rt60184041600000000000\r");
    assert_eq!((stage.port.counters().sent, stage.port.counters().refused), (2, 0));
}

#[test]
fn a_frame_of_which_the_line_took_a_part_is_finished_before_anything_else() {
    // Room for "t0800\rt0811AB\r" (15 bytes) and a part of the next frame.
    let mut stage = Stage::open(18);
    let frames = [frame(0x080, &[]), frame(0x081, &[0xAB]), frame(0x082, &[0xCD]), frame(0x083, &[])];
    assert_eq!(stage.port.send(stage.now, &frames), Ok(3));
    assert_eq!(stage.port.send(stage.now, &frames[3..]), Ok(0));
    assert_eq!(stage.said(), "t0800\rt0811AB\rt082");
    // The remaining bytes are sent even if no further frame is sent.
    assert_eq!(stage.receive(1), Ok(vec![]));
    assert_eq!(stage.said(), "1CD\r");
    assert_eq!(stage.port.send(stage.now, &frames[3..]), Ok(1));
    assert_eq!(stage.said(), "t0830\r");
    assert_eq!((stage.port.counters().sent, stage.port.counters().refused), (4, 1));
}

#[test]
fn a_frame_that_is_offered_again_and_again_counts_as_refused_once() {
    let mut stage = Stage::open(18);
    let frames = [frame(0x080, &[0; 8]), frame(0x081, &[]), frame(0x082, &[])];
    // Room for a part of the first frame.
    assert_eq!(stage.port.send(stage.now, &frames[..1]), Ok(1));
    for _ in 0..10 {
        assert_eq!(stage.port.send(stage.now, &frames[1..2]), Ok(0));
    }
    assert_eq!(stage.port.counters().refused, 1);
    // The caller gave up one frame and offers this one in its place.
    assert_eq!(stage.port.send(stage.now, &frames[2..]), Ok(0));
    assert_eq!(stage.port.counters().refused, 2);
}

#[test]
fn however_little_the_line_takes_the_stream_is_that_of_the_frames_taken() {
    for capacity in 3..60 {
        let mut stage = Stage::open(capacity);
        let (mut taken, mut said) = (0, String::new());
        let frames: Vec<_> = (0..40).map(|id| frame(id, &[0; 8][..usize::from(id % 9)])).collect();
        // Each call sends at least a byte of a frame, or a part of its remaining bytes.
        for _ in 0..frames.len() * LONGEST {
            taken += stage.port.send(stage.now, &frames[taken..]).unwrap();
            said += &stage.said();
        }
        assert_eq!(taken, frames.len(), "capacity {capacity}");
        // Upper bound of the number of calls for the longest line.
        for _ in 0..LONGEST.div_ceil(capacity) {
            stage.receive(1).unwrap();
            said += &stage.said();
        }
        let lines =
            frames.iter().map(|frame| String::from_utf8(Command::Transmit(*frame).encode().unwrap().to_vec()).unwrap());
        assert_eq!(said, lines.collect::<String>(), "capacity {capacity}");
    }
}

#[test]
fn an_error_frame_is_never_sent() {
    let mut stage = Stage::open(256);
    let error = Frame::from_raw(0x2000_0004, 8, [0; 8]).unwrap();
    let frames = [frame(0x080, &[]), error, frame(0x081, &[])];
    assert_eq!(stage.port.send(stage.now, &frames), Ok(1));
    assert_eq!(stage.said(), "t0800\r");
}

#[test]
fn frames_are_found_between_garbage_which_is_counted() {
    let mut stage = Stage::open(256);
    stage.now += Duration::from_millis(1);
    stage.answer(b"\xFF\x00\rt70117F\rt7011\rZ\rnonsense\rt08\x07\rt0800EA5F\r\r");
    assert_eq!(stage.receive(8), Ok(vec!["701#7F".to_owned(), "080#".to_owned()]));
    let counters = stage.port.counters();
    // Unreadable lines: noise, a frame that is too short, a word, and the frame that a bell interrupted.
    assert_eq!((counters.received, counters.dropped), (2, 4));
    assert_eq!(counters.refused, 1, "the bell");
}

#[test]
fn what_finds_no_room_waits_for_the_next_call() {
    let mut stage = Stage::open(256);
    stage.answer(b"t0010\rt0020\rt0030\rt00");
    assert_eq!(stage.receive(2), Ok(vec!["001#".to_owned(), "002#".to_owned()]));
    stage.answer(b"40\r");
    assert_eq!(stage.receive(2), Ok(vec!["003#".to_owned(), "004#".to_owned()]));
    assert_eq!(stage.receive(0), Ok(vec![]));
}

#[test]
fn state_lines_and_error_lines_show_in_state_and_counters() {
    use ControllerState::{Active, BusOff, Passive, Warning};
    let mut stage = Stage::open(256);
    for (line, state) in
        [("sw096000\r", Warning), ("sp000128\r", Passive), ("sb000256\r", BusOff), ("sa000000\r", Active)]
    {
        stage.answer(line.as_bytes());
        assert_eq!(stage.receive(1), Ok(vec![]));
        assert_eq!(stage.port.state(), state);
    }
    stage.answer(b"e1a\re2oO\r");
    assert_eq!(stage.receive(1), Ok(vec![]));
    let counters = stage.port.counters();
    assert_eq!((counters.errors, counters.dropped, counters.refused), (2, 1, 1));
    assert_eq!((counters.passive, counters.bus_off), (1, 1), "of the states before");
}

#[test]
fn an_adapter_that_was_unplugged_is_gone_after_its_last_frame() {
    let mut stage = Stage::open(256);
    stage.answer(b"t0010\rt0020\rt0800\r");
    assert_eq!(stage.receive(1), Ok(vec!["001#".to_owned()]));
    let Stage { mut port, peer, now } = stage;
    drop(peer);
    let mut into = [Received { frame: frame(0, &[]), at: now }; 4];
    assert_eq!(port.receive(now, &mut into), Ok(2));
    assert_eq!(port.receive(now, &mut into), Err(PortError::Gone));
    assert_eq!(port.send(now, &[frame(0x080, &[])]), Err(PortError::Gone));
    assert_eq!(port.counters().refused, 1);
}

#[test]
fn dropping_it_closes_the_channel_even_behind_half_a_frame() {
    let mut stage = Stage::open(64);
    assert_eq!(stage.port.send(stage.now, &[frame(0x080, &[])]), Ok(1));
    let Stage { port, mut peer, .. } = stage;
    drop(port);
    let said: Vec<u8> = std::iter::from_fn(|| peer.take()).map(|timed| timed.byte).collect();
    assert_eq!(said, b"t0800\r\rC\r");
}
