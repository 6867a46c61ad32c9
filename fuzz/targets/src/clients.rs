//! Clients of the host against arbitrary answers: every service ends, and asks for no more than it is allowed to.

use std::time::Duration;

use arbitrary::{Arbitrary, Unstructured};
use can::{Frame, Instant};
use canopen::sdo::Request;
use canopen::{Object, lss};
use master::lss::{Master, Service};
use master::sdo::{CAPACITY, Client};
use serial::Settings;
use serial::epos4::Address;
use serial::service::{self, Dialect};

use crate::frames::{AnyFrame, DRIVE};

const TIME_OUT: Duration = Duration::from_millis(100);

/// Most answers of an input.
const MOST: usize = 256;

/// Answers and the milliseconds before each.
fn answers<'a>(input: &mut Unstructured<'a>) -> impl Iterator<Item = (Frame, u64)> + use<'a> {
    let answers = Vec::<(AnyFrame, u8)>::arbitrary(input).unwrap_or_default();
    answers.into_iter().take(MOST).map(|(AnyFrame(frame), delay)| (frame, u64::from(delay)))
}

/// The SDO client: each transfer ends, and sends at most a sub-block at once.
pub fn sdo_client(data: &[u8]) {
    let mut input = Unstructured::new(data);
    let Ok((write, by_blocks, length)) = <(bool, bool, u16)>::arbitrary(&mut input) else {
        return;
    };
    let written: Vec<u8> = (0..usize::from(length) % (CAPACITY + 1)).map(|at| at as u8).collect();
    let object = Object::new(0x1008, 0);
    let mut now = Instant::ZERO;
    let mut client = Client::new(DRIVE, TIME_OUT, 2);
    match (write, by_blocks) {
        (false, false) => client.upload(object, now).unwrap(),
        (false, true) => client.block_upload(object, now).unwrap(),
        (true, false) => client.download(object, &written, now).unwrap(),
        (true, true) => client.block_download(object, &written, now).unwrap(),
    }
    for (frame, millis) in answers(&mut input) {
        now += Duration::from_millis(millis);
        client.handle_timeout(now);
        client.handle(&frame, now);
        let mut sent = 0;
        while let Some(frame) = client.poll_transmit(now) {
            assert!(Request::decode(&frame, DRIVE).is_some());
            sent += 1;
        }
        let sub_block = CAPACITY / 7 + 1;
        assert!(sent <= if by_blocks { 2 + sub_block } else { 2 }, "{sent} frames at once");
    }
    // A sub-block in progress is acknowledged up to seven times, each half as large as the one before.
    for _ in 0..=2 + 7 {
        if let Some(deadline) = client.poll_timeout() {
            client.handle_timeout(deadline);
        }
    }
    let ended = client.poll().expect("retries are counted");
    if let (Ok(transfer), true) = (ended, write) {
        assert_eq!(transfer.data, &written[..]);
    }
    assert_eq!(client.poll_timeout(), None);
}

/// Most questions of a fastscan: three that show whether slaves answer truly, and 33 for each part of the identity.
const QUESTIONS: usize = 3 + 4 * 33;

/// The LSS master: each service ends after a bounded number of frames.
pub fn lss_master(data: &[u8]) {
    let mut input = Unstructured::new(data);
    let services = [
        Service::SwitchGlobal(lss::Mode::Configuration),
        Service::SwitchSelective(lss::Identity::default()),
        Service::ConfigureNodeId(Some(DRIVE)),
        Service::Store,
        Service::InquireIdentity,
        Service::InquireNodeId,
        Service::IdentifyUnconfigured,
        Service::Fastscan,
    ];
    let Ok(&service) = input.choose(&services) else {
        return;
    };
    let mut now = Instant::ZERO;
    let mut master = Master::default();
    master.start(service, TIME_OUT, now).unwrap();
    let mut sent = 0;
    let answers: Vec<(u8, [u8; 7], bool, u8)> = Vec::arbitrary(&mut input).unwrap_or_default();
    for (choice, data, same, millis) in answers.into_iter().take(MOST) {
        now += Duration::from_millis(u64::from(millis));
        master.handle_timeout(now);
        let specifier = [0x11, 0x13, 0x17, 0x44, 0x4F, 0x50, 0x5A, 0x5B, 0x5C, 0x5D, 0x5E][usize::from(choice) % 11];
        let [a, b, c, d, ..] = data;
        let id = if same { 0x7E4 } else { 0x780 | u32::from(choice) };
        let frame = Frame::from_raw(id, 8, [specifier, a, b, c, d, 0, 0, 0]).unwrap();
        master.handle(&frame, now);
        while let Some(frame) = master.poll_transmit(now) {
            assert!(lss::Request::decode(&frame).is_some());
            sent += 1;
        }
    }
    for _ in 0..QUESTIONS {
        if let Some(deadline) = master.poll_timeout() {
            master.handle_timeout(deadline);
            sent += usize::from(master.poll_transmit(deadline).is_some());
        }
    }
    assert!(sent <= QUESTIONS);
    assert!(master.poll().is_some());
    assert_eq!(master.poll_timeout(), None);
}

/// The client of a service port of a drive: each request ends, and an object is never longer than allowed.
pub fn epos_service(data: &[u8]) {
    let mut input = Unstructured::new(data);
    let Ok((old, request, object)) = <(bool, u8, Vec<u8>)>::arbitrary(&mut input) else {
        return;
    };
    let dialect = if old { Dialect::Epos2 } else { Dialect::Epos4 };
    let config = service::Config { capacity: 256, ..service::Config::new(dialect, Settings::EPOS) };
    let mut client = service::Client::new(config);
    let mut now = Instant::ZERO;
    let address = Address { node: 1, index: 0x6041, subindex: 0 };
    let started = match request % 5 {
        0 => client.read(address, now),
        1 => client.write(address, 0x1234_5678, now),
        2 => client.read_segmented(address, now),
        3 => client.write_segmented(address, &object, now),
        _ => client.nmt(1, request, now),
    };
    if started.is_err() {
        assert_eq!(client.poll_timeout(), None);
        return;
    }
    let pieces: Vec<(u8, Vec<u8>, u8)> = Vec::arbitrary(&mut input).unwrap_or_default();
    let mut sent = 0;
    for (room, bytes, millis) in pieces.into_iter().take(MOST) {
        let count = client.bytes().len().min(usize::from(room));
        client.consume(count, now);
        sent += count;
        now += Duration::from_millis(u64::from(millis));
        client.handle(&framed(dialect, room, &bytes), now);
        client.handle_timeout(now);
    }
    // One repetition, each segment with a time-out of its own.
    for _ in 0..64 {
        let Some(deadline) = client.poll_timeout() else {
            break;
        };
        now = now.max(deadline);
        let count = client.bytes().len();
        client.consume(count, now);
        client.handle_timeout(now);
    }
    assert_eq!(client.poll_timeout(), None, "after {sent} bytes");
    let ended = client.poll().expect("the request has ended");
    if let Ok(service::Reply::Object(object)) = ended {
        assert!(object.len() <= config.capacity);
    }
}

/// The bytes as they are, or as the data of a frame with a valid checksum.
fn framed(dialect: Dialect, choice: u8, bytes: &[u8]) -> Vec<u8> {
    match (dialect, bytes) {
        (Dialect::Epos4, [opcode, data @ ..]) if !choice.is_multiple_of(4) => {
            match serial::epos4::Frame::new(*opcode, data) {
                Some(frame) => {
                    let mut into = [0; serial::epos4::LONGEST];
                    let length = frame.encode(&mut into);
                    into[..length].to_vec()
                }
                None => bytes.to_vec(),
            }
        }
        _ => bytes.to_vec(),
    }
}
