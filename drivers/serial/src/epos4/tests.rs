//! Frames and services of an EPOS4 service port.

use super::*;

pub(crate) const STATUSWORD: Address = Address { node: 1, index: 0x6041, subindex: 0 };
pub(crate) const HOME_POSITION: Address = Address { index: 0x30B0, ..STATUSWORD };
pub(crate) const CONTROLWORD: Address = Address { index: 0x6040, ..STATUSWORD };
pub(crate) const NAME: Address = Address { index: 0x1008, ..STATUSWORD };

#[test]
fn requests_are_the_bytes_of_the_line() {
    let cases: [(Request, &[u8]); 3] = [
        (Request::Read(HOME_POSITION), &[0x90, 0x02, 0x60, 0x02, 0x01, 0xB0, 0x30, 0x00, 0x2E, 0x62]),
        (Request::Read(STATUSWORD), &[0x90, 0x02, 0x60, 0x02, 0x01, 0x41, 0x60, 0x00, 0x22, 0xD1]),
        (
            Request::Write(CONTROLWORD, 0x000F),
            &[0x90, 0x02, 0x68, 0x04, 0x01, 0x40, 0x60, 0x00, 0x0F, 0x00, 0x00, 0x00, 0xB3, 0x07],
        ),
    ];
    for (request, bytes) in cases {
        assert_eq!(encoded(&request.encode()), bytes, "{request:?}");
    }
}

#[test]
fn answers_are_the_bytes_of_the_line() {
    let cases: [(Request, Answer, &[u8]); 2] = [
        (
            Request::Read(HOME_POSITION),
            Answer::Value(0x0000_9001),
            &[0x90, 0x02, 0x00, 0x04, 0x00, 0x00, 0x00, 0x00, 0x01, 0x90, 0x90, 0x00, 0x00, 0x9A, 0x5C],
        ),
        (
            Request::Write(CONTROLWORD, 0x000F),
            Answer::Done,
            &[0x90, 0x02, 0x00, 0x02, 0x00, 0x00, 0x00, 0x00, 0x40, 0x8B],
        ),
    ];
    for (request, answer, bytes) in cases {
        assert_eq!(encoded(&answer.encode()), bytes, "{answer:?}");
        let frame = frames(bytes).remove(0).unwrap();
        assert_eq!(Answer::decode(&frame, &request), Some(answer));
    }
}

#[test]
fn every_service_survives_the_line_both_ways() {
    let object: Vec<u8> = (0..=253).collect();
    let odd = &object[..41];
    let pairs = [
        (Request::Read(NAME), Answer::Value(u32::MAX)),
        (Request::Write(NAME, 0x9090_9090), Answer::Done),
        (Request::InitiateSegmentedRead(NAME), Answer::Started(300, &object)),
        (Request::InitiateSegmentedRead(NAME), Answer::Started(41, odd)),
        (Request::SegmentRead { toggle: true }, Answer::Segment { toggle: true, last: true, data: odd }),
        (Request::InitiateSegmentedWrite(NAME, 300), Answer::Done),
        (
            Request::SegmentWrite { toggle: false, last: false, data: &object },
            Answer::Taken { toggle: false, length: 254 },
        ),
        (Request::SegmentWrite { toggle: true, last: true, data: odd }, Answer::Refused(0x0F00_FFBF)),
        (Request::Nmt { node: 0x90, command: 0x81 }, Answer::Done),
    ];
    for (request, answer) in pairs {
        let there = frames(&encoded(&request.encode())).remove(0).unwrap();
        assert_eq!(Request::decode(&there), Some(request));
        let back = frames(&encoded(&answer.encode())).remove(0).unwrap();
        assert_eq!(Answer::decode(&back, &request), Some(answer), "{request:?}");
    }
}

#[test]
fn what_means_nothing_is_refused() {
    let frame = |opcode, data: &[u8]| Frame::new(opcode, data).unwrap();
    for (opcode, data) in
        [(0x10, &[1, 2, 3, 4][..]), (0x60, &[1, 2]), (0x6A, &[3, 0, 1, 2]), (0x6A, &[1, 0, 1, 2, 3, 4]), (0x70, &[])]
    {
        assert_eq!(Request::decode(&frame(opcode, data)), None, "{opcode:#x}");
    }
    let read = Request::Read(STATUSWORD);
    for (opcode, data) in [(ANSWER, &[0, 0][..]), (ANSWER, &[0, 0, 0, 0]), (0x60, &[0; 8])] {
        assert_eq!(Answer::decode(&frame(opcode, data), &read), None);
    }
    let refused = frame(ANSWER, &[0, 0, 2, 6, 9, 9]);
    assert_eq!(Answer::decode(&refused, &read), Some(Answer::Refused(0x0602_0000)));
}

/// Read 6041:00 of node 1.
const READ: &[u8] = &[0x90, 0x02, 0x60, 0x02, 0x01, 0x41, 0x60, 0x00, 0x22, 0xD1];

pub(crate) fn encoded(frame: &Frame) -> Vec<u8> {
    let mut into = [0; LONGEST];
    let length = frame.encode(&mut into);
    into[..length].to_vec()
}

fn frames(bytes: &[u8]) -> Vec<Result<Frame, FrameError>> {
    let mut deframer = Deframer::new();
    bytes.iter().filter_map(|&byte| deframer.take(byte)).collect()
}

#[test]
fn a_frame_full_of_starts_has_each_of_them_doubled() {
    let frame = Frame::new(DLE, &[DLE; 2 * MAX_WORDS]).unwrap();
    let bytes = encoded(&frame);
    assert!(bytes.len() <= LONGEST);
    assert_eq!(frames(&bytes), [Ok(frame)]);
    assert_eq!(Frame::new(0, &[0; 2 * MAX_WORDS + 1]), None);
}

#[test]
fn a_torn_frame_does_not_cost_the_one_behind_it() {
    let bytes = encoded(&Frame::new(0x68, &[1, 0x40, 0x60, 0, 0x90, 0x02, 0x02, 0x90]).unwrap());
    for offset in 2..bytes.len() {
        let found = frames(&[&bytes[..offset], &bytes].concat());
        let whole = found.iter().filter(|frame| frame.is_ok()).count();
        // If a frame is torn within a doubled 0x90, the next start looks like the second half of the pair.
        let half = bytes[..offset].iter().rev().take_while(|&&b| b == DLE).count() % 2 == 1;
        assert_eq!(whole, usize::from(!half), "torn at {offset}: {found:?}");
    }
}

#[test]
fn a_damaged_frame_is_none() {
    let bytes = READ;
    for (index, bit) in (2..bytes.len()).flat_map(|index| (0..8).map(move |bit| (index, bit))) {
        let mut damaged = bytes.to_vec();
        damaged[index] ^= 1 << bit;
        assert!(frames(&damaged).iter().all(Result::is_err), "bit {bit} of byte {index}");
    }
    let long = [DLE, STX, 0x60, 145];
    assert_eq!(frames(&long), [Err(FrameError::TooLong(145))]);
}
