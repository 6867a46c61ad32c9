//! Dialogues of the SDO server's block transfer.

use std::time::Duration;

use super::*;
use crate::sdo::{MAX_SIZE, Request};

const NODE: NodeId = NodeId::new(2).unwrap();
const TIME_OUT: Duration = Duration::from_millis(500);
const TEXT: Object = Object::new(0x1008, 0);

/// One object of any length.
struct Text(Vec<u8>);

impl Dictionary for Text {
    fn size(&self, _: Object) -> Option<usize> {
        None
    }
    fn read(&mut self, object: Object, into: &mut [u8; MAX_SIZE]) -> Result<usize, AbortCode> {
        if object != TEXT {
            return Err(AbortCode::NO_OBJECT);
        }
        into[..self.0.len()].copy_from_slice(&self.0);
        Ok(self.0.len())
    }
    fn write(&mut self, object: Object, data: &[u8]) -> Result<(), AbortCode> {
        if object != TEXT {
            return Err(AbortCode::READ_ONLY);
        }
        self.0 = data.to_vec();
        Ok(())
    }
}

fn request(bytes: &str) -> Frame {
    crate::parse(&format!("602#{bytes}"))
}

/// What a server sends to a frame: the answer, then the segments.
fn sent(server: &mut Server, frame: &Frame, objects: &mut Text, now: Instant) -> Vec<Frame> {
    let answer = server.handle_frame(frame, NODE, objects, now);
    let segments = std::iter::from_fn(|| server.poll_transmit(NODE, now));
    answer.into_iter().chain(segments).collect()
}

/// Plays requests against a server that takes blocks of 2, and compares all it sends.
fn check(dialogue: &[(&str, &[&str])]) -> Text {
    let mut server = Server::new(TIME_OUT).with_block_size(2);
    let mut objects = Text(b"EPOS4 50/5".to_vec());
    for (step, &(bytes, expected)) in dialogue.iter().enumerate() {
        let sent = sent(&mut server, &request(bytes), &mut objects, Instant::ZERO);
        let sent: Vec<_> = sent.iter().map(|frame| frame.to_string()).collect();
        let expected: Vec<_> = expected.iter().map(|bytes| format!("582#{bytes}")).collect();
        assert_eq!(sent, expected, "step {step}");
    }
    objects
}

const OFFER: (&str, &[&str]) = ("A40810007F000000", &["C60810000A000000"]);
const FIRST: &str = "0145504F53342035";
const SECOND: &str = "82302F3500000000";
const START: (&str, &[&str]) = ("A300000000000000", &[FIRST, SECOND]);
const TAKE: (&str, &[&str]) = ("C608100009000000", &["A408100002000000"]);

#[test]
fn an_upload_goes_out_in_blocks_of_the_client_s_size() {
    check(&[
        OFFER,
        START,
        ("A2027F0000000000", &["D1F4A50000000000"]),
        ("A100000000000000", &[]),
        // The channel is free at once.
        OFFER,
    ]);
    // One segment at a time, and no checksum for who does not check it.
    check(&[
        ("A008100001000000", &["C20810000A000000"]),
        ("A300000000000000", &[FIRST]),
        ("A201010000000000", &["81302F3500000000"]),
        ("A201010000000000", &["D100000000000000"]),
        ("A100000000000000", &[]),
    ]);
}

#[test]
fn segments_that_were_lost_on_the_way_up_are_sent_again() {
    check(&[
        OFFER,
        START,
        ("A2007F0000000000", &[FIRST, SECOND]),
        ("A201050000000000", &["81302F3500000000"]),
        ("A201050000000000", &["D1F4A50000000000"]),
        ("A100000000000000", &[]),
    ]);
}

#[test]
fn a_short_object_is_uploaded_as_ever_if_the_client_allows_it() {
    check(&[
        ("A40810007F0A0000", &["410810000A000000"]),
        ("6000000000000000", &["0045504F53342035"]),
        ("7000000000000000", &["19302F3500000000"]),
    ]);
    check(&[("A40810007F090000", &["C60810000A000000"])]);
}

#[test]
fn a_download_comes_in_blocks_of_the_server_s_size() {
    let objects = check(&[
        TAKE,
        ("0141424344454647", &[]),
        ("8248490000000000", &["A202020000000000"]),
        ("D5DC1A0000000000", &["A100000000000000"]),
    ]);
    assert_eq!(objects.0, b"ABCDEFGHI");
    // The size is not given and the checksum not made; the data fill both segments.
    let objects = check(&[
        ("C008100000000000", &["A408100002000000"]),
        ("0141424344454647", &[]),
        ("8248494A4B4C4D4E", &["A202020000000000"]),
        ("C1FFFF0000000000", &["A100000000000000"]),
    ]);
    assert_eq!(objects.0, b"ABCDEFGHIJKLMN");
}

#[test]
fn segments_that_were_lost_on_the_way_down_are_asked_for_again() {
    // The first is lost; it comes twice.
    let end: (&str, &[&str]) = ("D5DC1A0000000000", &["A100000000000000"]);
    let first: (&str, &[&str]) = ("0141424344454647", &[]);
    let second: (&str, &[&str]) = ("8248490000000000", &["A202020000000000"]);
    let alone: (&str, &[&str]) = ("8248490000000000", &["A200020000000000"]);
    for dialogue in [[TAKE, alone, first, second, end], [TAKE, first, first, second, end]] {
        assert_eq!(check(&dialogue).0, b"ABCDEFGHI");
    }
}

#[test]
fn refusals_name_their_reason() {
    let table: &[&[(&str, &[&str])]] = &[
        // Block sizes that there are not, at the start and later.
        &[("A408100000000000", &["8008100002000405"])],
        &[("A408100080000000", &["8008100002000405"])],
        &[OFFER, START, ("A201000000000000", &["8008100002000405"])],
        // More acknowledged than sent.
        &[OFFER, START, ("A2037F0000000000", &["8008100003000405"])],
        // No such object, read and written.
        &[("A40020007F000000", &["8000200000000206"])],
        &[
            ("C600200007000000", &["A400200002000000"]),
            ("8141424344454647", &["A201020000000000"]),
            ("C100000000000000", &["8000200004000405"]),
        ],
        &[
            ("C200200007000000", &["A400200002000000"]),
            ("8141424344454647", &["A201020000000000"]),
            ("C100000000000000", &["8000200002000106"]),
        ],
        // Steps out of their order, and without a transfer.
        &[("A300000000000000", &["8000000001000405"])],
        &[("A2017F0000000000", &["8000000001000405"])],
        &[("A100000000000000", &["8000000001000405"])],
        &[("D5DC1A0000000000", &["8000000001000405"])],
        &[OFFER, ("A2017F0000000000", &["8008100001000405"])],
        &[OFFER, START, ("A300000000000000", &["8008100001000405"])],
        &[OFFER, START, ("A100000000000000", &["8008100001000405"])],
        &[OFFER, ("6000000000000000", &["8008100001000405"])],
        // More than the object was to have, more than there is room for, fewer than announced.
        &[("C6081000FF030000", &["8008100005000405"])],
        &[
            ("C608100007000000", &["A408100002000000"]),
            ("0141424344454647", &[]),
            ("8248494A4B4C4D4E", &["8008100012000706"]),
        ],
        &[TAKE, ("8141424344454647", &["A201020000000000"]), ("C1DC1A0000000000", &["8008100013000706"])],
        // A segment past the block size, and a checksum that is wrong.
        &[TAKE, ("0341424344454647", &["8008100003000405"])],
        &[
            TAKE,
            ("0141424344454647", &[]),
            ("8248490000000000", &["A202020000000000"]),
            ("D5DC1B0000000000", &["8008100004000405"]),
        ],
        // An abort in the middle of either is not answered.
        &[OFFER, START, ("8008100000000405", &[]), ("A2027F0000000000", &["8000000001000405"])],
        &[TAKE, ("0141424344454647", &[]), ("8008100000000405", &[]), ("4008100000000000", &["410810000A000000"])],
        // In between sub-blocks another transfer may begin.
        &[OFFER, START, ("4008100000000000", &["410810000A000000"])],
    ];
    for dialogue in table {
        assert_eq!(check(dialogue).0, b"EPOS4 50/5");
    }
}

#[test]
fn a_client_that_falls_silent_is_given_up() {
    let mut server = Server::new(TIME_OUT).with_block_size(2);
    let mut objects = Text(b"EPOS4 50/5".to_vec());
    for dialogue in [&[OFFER, START][..], &[TAKE, ("0141424344454647", &[])]] {
        let mut now = Instant::ZERO;
        for (bytes, _) in dialogue {
            now += Duration::from_millis(400);
            sent(&mut server, &request(bytes), &mut objects, now);
        }
        assert_eq!(server.poll_timeout(), Some(now + TIME_OUT));
        let abort = Response::Abort { object: TEXT, code: AbortCode::TIME_OUT };
        assert_eq!(server.handle_timeout(now + TIME_OUT), Some(abort));
        assert!(!server.transmits() && !server.receives_blocks());
    }
}

/// Numbers that look random, the same at each run.
fn xorshift(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

#[test]
fn every_size_comes_whole_through_a_wire_that_loses_segments() {
    let mut random = 0x9E37_79B9_7F4A_7C15;
    let sizes = (0..30).chain([888, 889, 890, MAX_SIZE - 1, MAX_SIZE]);
    for size in sizes {
        let data: Vec<u8> = (0..size).map(|at| (at * 7 % 251) as u8).collect();
        let block_size = (xorshift(&mut random) % 127 + 1) as u8;
        let mut server = Server::new(TIME_OUT).with_block_size(block_size);
        let now = Instant::ZERO;
        let crc = block::checksum(&data);

        let mut objects = Text(data.clone());
        let initiate = block::Request::InitiateUpload { object: TEXT, crc: true, block_size, threshold: 0 };
        sent(&mut server, &Request::Block(initiate).encode(NODE), &mut objects, now);
        let mut next = block::Request::StartUpload;
        let mut got = Vec::new();
        let end = loop {
            let frames = sent(&mut server, &Request::Block(next).encode(NODE), &mut objects, now);
            if let Some(Response::Block(block::Response::EndUpload(end))) =
                Response::decode(&frames[0], NODE).filter(|_| frames.len() == 1)
                && got.len() >= size.max(1)
            {
                break end;
            }
            let mut sequence = 0;
            for frame in frames {
                let segment = Segment::decode(&frame, cob::sdo_response(NODE))
                    .unwrap_or_else(|| panic!("{frame} for {size} of {block_size}"));
                if segment.sequence() == sequence + 1 && !xorshift(&mut random).is_multiple_of(8) {
                    sequence += 1;
                    got.extend(segment.data);
                }
            }
            next = block::Request::Acknowledge(Acknowledge {
                sequence,
                block_size: (xorshift(&mut random) % 127 + 1) as u8,
            });
        };
        got.truncate(got.len() - end.unused());
        assert!(got == data && end.crc == crc, "upload of {size}");
        let done = Request::Block(block::Request::EndUpload).encode(NODE);
        assert_eq!(sent(&mut server, &done, &mut objects, now), []);

        let mut objects = Text(Vec::new());
        let initiate = block::Request::InitiateDownload { object: TEXT, crc: true, size: Some(size as u32) };
        sent(&mut server, &Request::Block(initiate).encode(NODE), &mut objects, now);
        let mut from = 0;
        let segments = size.div_ceil(SEGMENT).max(1);
        while from < segments {
            let count = (segments - from).min(usize::from(block_size));
            for sequence in 1..=count {
                let mut seven = [0; SEGMENT];
                let at = (from + sequence - 1) * SEGMENT;
                let piece = &data[at..size.min(at + SEGMENT)];
                seven[..piece.len()].copy_from_slice(piece);
                let last = from + sequence == segments;
                let segment = Segment::new(sequence as u8, last, seven).unwrap();
                // The last segment of a sub-block has to arrive, since no other segment is answered.
                if sequence < count && xorshift(&mut random).is_multiple_of(8) {
                    continue;
                }
                let frame = segment.encode(cob::sdo_request(NODE));
                let answer = sent(&mut server, &frame, &mut objects, now);
                assert_eq!(answer.len(), usize::from(sequence == count));
                if let [answer] = answer[..] {
                    let answer = Response::decode(&answer, NODE);
                    let Some(Response::Block(block::Response::Acknowledge(taken))) = answer else {
                        panic!("{answer:?}");
                    };
                    from += usize::from(taken.sequence);
                    break;
                }
            }
        }
        let end = Request::Block(block::Request::EndDownload(End::of(size, crc))).encode(NODE);
        let answer = sent(&mut server, &end, &mut objects, now);
        assert_eq!(answer, [Response::Block(block::Response::EndDownload).encode(NODE)], "download of {size}");
        assert_eq!(objects.0, data);
    }
}
