//! The receiver of a network camera: bounded memory, and only whole pictures of the declared size.

use std::time::Duration;

use arbitrary::{Arbitrary, Result, Unstructured};
use can::Instant;
use drive::camera::{CameraConfig, CameraReceiver, FrameHeader, FrameKind, Picture, checksum};

const CONFIG: CameraConfig =
    CameraConfig { width: 8, height: 4, period: Duration::from_millis(40), tolerated_missing: 2 };

/// The stream of a camera.
pub fn camera(data: &[u8]) {
    let (mut receiver, link) = CameraReceiver::new(CONFIG);
    let mut now = Instant::ZERO;
    let (mut picture, mut last) = (Picture::with_room(&CONFIG), 0);
    receiver.connected(now);
    let mut input = Unstructured::new(data);
    while !input.is_empty() {
        if piece(&mut receiver, &mut now, &mut input).is_err() {
            break;
        }
        if let Ok(true) = link.take(&mut picture) {
            assert_eq!((picture.width, picture.height), (CONFIG.width, CONFIG.height));
            assert_eq!(picture.pixels.len(), CONFIG.pixels());
            assert!(picture.number > last, "{} after {last}", picture.number);
            last = picture.number;
        }
        assert!(link.fault().is_none_or(|fault| !fault.to_string().is_empty()));
    }
    // A valid picture ends every fault.
    receiver.connected(now);
    let mut bytes = Vec::new();
    frame(&mut bytes, FrameKind::Greeting, 0, &[]);
    frame(&mut bytes, FrameKind::Picture, 7, &[1; 32]);
    receiver.receive(&bytes, now);
    assert_eq!(link.fault(), None);
    assert_eq!(link.take(&mut picture), Ok(true));
    assert_eq!(picture.pixels, [1; 32]);
}

fn frame(into: &mut Vec<u8>, kind: FrameKind, sequence: u32, pixels: &[u8]) {
    let header = FrameHeader {
        kind,
        sequence,
        width: CONFIG.width,
        height: CONFIG.height,
        exposed_ns: 0,
        exposure_ns: 1_000_000,
        period_ns: 40_000_000,
        pixels_crc: checksum(pixels),
    };
    into.extend(header.encode());
    into.extend(pixels);
}

/// The next part of the stream.
fn piece(receiver: &mut CameraReceiver, now: &mut Instant, input: &mut Unstructured) -> Result<()> {
    let mut bytes = Vec::new();
    match input.int_in_range(0..=7_u8)? {
        0 => bytes = Vec::arbitrary(input)?,
        1 => frame(&mut bytes, FrameKind::Greeting, 0, &[]),
        2..=3 => frame(&mut bytes, FrameKind::Picture, u32::arbitrary(input)?, &<[u8; 32]>::arbitrary(input)?),
        4 => {
            let header = FrameHeader {
                kind: *input.choose(&[FrameKind::Greeting, FrameKind::Picture])?,
                sequence: u32::arbitrary(input)?,
                width: u16::arbitrary(input)?,
                height: u16::arbitrary(input)?,
                exposed_ns: u64::arbitrary(input)?,
                exposure_ns: u32::arbitrary(input)?,
                period_ns: u32::arbitrary(input)?,
                pixels_crc: u32::arbitrary(input)?,
            };
            bytes.extend(header.encode());
        }
        5 => {
            frame(&mut bytes, FrameKind::Picture, 1, &[3; 32]);
            let place = usize::from(u8::arbitrary(input)?) % bytes.len();
            bytes[place] ^= u8::arbitrary(input)?;
            bytes.truncate(bytes.len() - usize::from(u8::arbitrary(input)?) % 8);
        }
        6 => {
            receiver.closed(*now);
            receiver.connected(*now);
        }
        _ => {
            *now += Duration::from_millis(u64::from(u8::arbitrary(input)?));
            receiver.tick(*now);
        }
    }
    receiver.receive(&bytes, *now);
    Ok(())
}
