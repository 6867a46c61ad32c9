//! Tests of the receiver of a camera.

use can::Instant;

use super::*;

const PERIOD: Duration = Duration::from_millis(100);

const CONFIG: CameraConfig = CameraConfig { width: 4, height: 3, period: PERIOD, tolerated_missing: 2 };

fn header(kind: FrameKind, sequence: u32, pixels: &[u8]) -> FrameHeader {
    FrameHeader {
        kind,
        sequence,
        width: 4,
        height: 3,
        exposed_ns: 7_000_000,
        exposure_ns: 5_000_000,
        period_ns: 100_000_000,
        pixels_crc: checksum(pixels),
    }
}

fn greeting() -> Vec<u8> {
    header(FrameKind::Greeting, 0, &[]).encode().to_vec()
}

fn picture(sequence: u32) -> Vec<u8> {
    let pixels: Vec<u8> = (0..12).map(|pixel| pixel + sequence as u8).collect();
    [&header(FrameKind::Picture, sequence, &pixels).encode()[..], &pixels].concat()
}

fn at(millis: u64) -> Instant {
    Instant::ZERO + Duration::from_millis(millis)
}

fn up() -> (CameraReceiver, CameraLink) {
    let (mut receiver, link) = CameraReceiver::new(CONFIG);
    receiver.connected(at(0));
    receiver.receive(&greeting(), at(0));
    assert!(receiver.is_greeted());
    (receiver, link)
}

#[test]
fn pictures_arrive_whole_in_pieces_of_any_length() {
    for piece in [1, 3, 39, 40, 41, 1000] {
        let (mut receiver, link) = up();
        let bytes = [picture(0), picture(1)].concat();
        bytes.chunks(piece).for_each(|bytes| receiver.receive(bytes, at(10)));
        let mut taken = Picture::with_room(&CONFIG);
        assert_eq!(link.take(&mut taken), Ok(true), "{piece} bytes");
        assert_eq!((taken.number, taken.sequence, link.lost()), (2, 1, 0));
        assert_eq!(taken.pixels, (1..13).collect::<Vec<u8>>());
        assert_eq!((taken.exposed, taken.exposure), (Duration::from_millis(7), Duration::from_millis(5)));
        assert_eq!(link.take(&mut taken), Ok(false));
    }
}

#[test]
fn next_picture_is_found_after_garbage_and_ends_the_fault() {
    let (mut receiver, link) = up();
    receiver.receive(&[0x4D; 100], at(10));
    receiver.tick(at(360));
    let discarded = 100 - (HEADER as u64 - 1);
    assert_eq!(link.fault(), Some(CameraFault::Garbled { age: Duration::from_millis(360), discarded }));
    receiver.receive(&picture(0), at(370));
    assert_eq!((link.fault(), link.number()), (None, 1));
}

#[test]
fn picture_with_a_changed_pixel_is_discarded() {
    let (mut receiver, link) = up();
    let mut bytes = picture(0);
    bytes[HEADER + 5] ^= 0x10;
    receiver.receive(&bytes, at(10));
    assert_eq!(link.number(), 0);
    receiver.tick(at(351));
    let expected = CameraFault::Garbled { age: Duration::from_millis(351), discarded: 52 };
    assert_eq!(link.fault(), Some(expected));
}

#[test]
fn silence_is_a_fault_with_its_age_after_the_tolerated_pictures() {
    let (mut receiver, link) = up();
    receiver.receive(&picture(0), at(20));
    receiver.tick(at(370));
    assert_eq!(link.fault(), None);
    receiver.tick(at(371));
    assert_eq!(link.fault(), Some(CameraFault::Silent { age: Duration::from_millis(351) }));
    let mut taken = Picture::default();
    assert!(link.take(&mut taken).is_err());
    receiver.tick(at(1020));
    assert_eq!(link.fault(), Some(CameraFault::Silent { age: Duration::from_secs(1) }));
    // The pictures 1 to 9 were lost.
    receiver.receive(&picture(10), at(1021));
    assert_eq!((link.fault(), link.lost()), (None, 9));
}

#[test]
fn end_of_the_connection_is_a_fault_until_a_picture_of_the_next_one() {
    let (mut receiver, link) = up();
    receiver.receive(&picture(0)[..45], at(20));
    receiver.closed(at(30));
    assert_eq!(link.fault(), Some(CameraFault::Closed { age: Duration::from_millis(30) }));
    receiver.connected(at(100));
    receiver.receive(&[greeting(), picture(0)].concat(), at(110));
    assert_eq!((link.fault(), link.number()), (None, 1));
}

#[test]
fn camera_of_another_size_or_rate_is_refused_by_its_greeting() {
    let other = [
        (FrameHeader { width: 8, ..header(FrameKind::Greeting, 0, &[]) }, "8 × 3 pixels, declared were 4 × 3"),
        (
            FrameHeader { period_ns: 40_000_000, ..header(FrameKind::Greeting, 0, &[]) },
            "a picture every 40.0ms, declared was 100.0ms",
        ),
    ];
    for (header, expected) in other {
        let (mut receiver, link) = CameraReceiver::new(CONFIG);
        receiver.connected(at(0));
        receiver.receive(&header.encode(), at(1));
        receiver.tick(at(5_000));
        let fault = link.fault().unwrap().to_string();
        assert!(!receiver.is_greeted() && fault.ends_with(expected), "{fault}");
    }
}
