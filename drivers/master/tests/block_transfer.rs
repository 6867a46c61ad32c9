//! SDO block transfer of the client against a scripted server, over a wire that loses frames.
//!
//! The server is written here from the description of the protocol, byte by byte, and shares nothing with the
//! client.

use std::collections::VecDeque;
use std::time::Duration;

use can::{Frame, Instant, StandardId};
use canopen::sdo::AbortCode;
use canopen::{NodeId, Object};
use mrroc_master::sdo::{Client, SdoError};
use proptest::prelude::*;

const NODE: NodeId = NodeId::new(2).unwrap();
const TIME_OUT: Duration = Duration::from_millis(500);
const OBJECT: Object = Object::new(0x1F50, 1);
const CAPACITY: usize = 3000;

/// A server of one object.
struct Peer {
    object: Vec<u8>,
    crc: bool,
    tells_size: bool,
    /// The block sizes it asks for in turn.
    block_sizes: Vec<u8>,
    asked: usize,
    state: State,
    out: VecDeque<[u8; 8]>,
}

enum State {
    Idle,
    /// `base` bytes of the object are acknowledged.
    Sending {
        base: usize,
        segments: usize,
    },
    Ending,
    Receiving {
        data: Vec<u8>,
        block_size: u8,
        in_order: u8,
    },
    Received {
        data: Vec<u8>,
    },
}

fn xmodem(data: &[u8]) -> u16 {
    data.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ u16::from(*byte) << 8, |crc, _| if crc & 0x8000 == 0 { crc << 1 } else { crc << 1 ^ 0x1021 })
    })
}

impl Peer {
    fn new(object: Vec<u8>, crc: bool, tells_size: bool, block_sizes: Vec<u8>) -> Self {
        Self { object, crc, tells_size, block_sizes, asked: 0, state: State::Idle, out: VecDeque::new() }
    }

    fn block_size(&mut self) -> u8 {
        self.asked += 1;
        self.block_sizes[self.asked % self.block_sizes.len()]
    }

    fn sub_block(&mut self, base: usize, block_size: u8) {
        let left = self.object[base..].len().div_ceil(7).max(1);
        let segments = left.min(usize::from(block_size));
        for number in 1..=segments {
            let mut bytes = [0; 8];
            bytes[0] = number as u8 | if number == left { 0x80 } else { 0 };
            let from = &self.object[base + 7 * (number - 1)..];
            let count = from.len().min(7);
            bytes[1..=count].copy_from_slice(&from[..count]);
            self.out.push_back(bytes);
        }
        self.state = State::Sending { base, segments };
    }

    fn take(&mut self, bytes: [u8; 8]) {
        let [first, ..] = bytes;
        let index_and_sub = [bytes[1], bytes[2], bytes[3]];
        if first == 0x80 {
            self.state = State::Idle;
            self.out.clear();
            return;
        }
        if let State::Receiving { data, block_size, in_order } = &mut self.state {
            let (number, last) = (first & 0x7F, first & 0x80 != 0);
            let fits = number == *in_order + 1;
            if fits {
                data.extend_from_slice(&bytes[1..]);
                *in_order += 1;
            }
            if last || number == *block_size {
                let (data, in_order) = (std::mem::take(data), *in_order);
                let block_size = self.block_size();
                self.out.push_back([0xA2, in_order, block_size, 0, 0, 0, 0, 0]);
                self.state = if last && fits {
                    State::Received { data }
                } else {
                    State::Receiving { data, block_size, in_order: 0 }
                };
            }
            return;
        }
        let crc_bit = if self.crc { 4 } else { 0 };
        match first {
            0xA0 | 0xA4 => {
                let size = if self.tells_size { self.object.len() as u32 } else { 0 };
                let [a, b, c, d] = size.to_le_bytes();
                let [i, j, k] = index_and_sub;
                let first = 0xC0 | crc_bit | if self.tells_size { 2 } else { 0 };
                self.out.push_back([first, i, j, k, a, b, c, d]);
                self.state = State::Sending { base: 0, segments: usize::from(bytes[4]) };
            }
            0xA3 => {
                if let State::Sending { base, segments } = self.state {
                    self.sub_block(base, segments as u8);
                }
            }
            0xA2 => {
                if let State::Sending { base, segments } = self.state {
                    let acknowledged = usize::from(bytes[1]);
                    assert!(acknowledged <= segments, "acknowledged more than was sent");
                    let base = base + 7 * acknowledged;
                    if base < self.object.len() {
                        self.sub_block(base, bytes[2]);
                    } else {
                        let unused = (7 - self.object.len() % 7) % 7;
                        let sum = if self.crc { xmodem(&self.object) } else { 0 };
                        let [low, high] = sum.to_le_bytes();
                        let first = 0xC1 | (unused as u8) << 2;
                        self.out.push_back([first, low, high, 0, 0, 0, 0, 0]);
                        self.state = State::Ending;
                    }
                }
            }
            0xA1 => self.state = State::Idle,
            0xC0 | 0xC2 | 0xC4 | 0xC6 => {
                let block_size = self.block_size();
                let [i, j, k] = index_and_sub;
                self.out.push_back([0xA0 | crc_bit, i, j, k, block_size, 0, 0, 0]);
                self.state = State::Receiving { data: vec![], block_size, in_order: 0 };
            }
            first if first & 0b1110_0011 == 0xC1 => {
                if let State::Received { data } = &mut self.state {
                    let unused = usize::from(first >> 2 & 7);
                    data.truncate(data.len() - unused);
                    let sum = u16::from_le_bytes([bytes[1], bytes[2]]);
                    if self.crc && sum != xmodem(data) {
                        let [i, j, k] = OBJECT_BYTES;
                        self.out.push_back([0x80, i, j, k, 0x04, 0x00, 0x04, 0x05]);
                    } else {
                        self.object = std::mem::take(data);
                        self.out.push_back([0xA1, 0, 0, 0, 0, 0, 0, 0]);
                    }
                    self.state = State::Idle;
                }
            }
            _ => {}
        }
    }
}

const OBJECT_BYTES: [u8; 3] = [0x50, 0x1F, 0x01];

/// A frame on the wire.
#[derive(Clone, Copy)]
struct Carried {
    /// Its number, both directions counted together from 1.
    at: usize,
    to_server: bool,
    bytes: [u8; 8],
}

/// What became of a transfer, and how many frames it took.
type Outcome = (Result<Vec<u8>, SdoError>, usize);

/// Runs the transfer to its end over a wire that does to each frame what `fate` says: the frame, or
/// another, or none.
fn run(client: &mut Client, peer: &mut Peer, mut fate: impl FnMut(Carried) -> Option<[u8; 8]>) -> Outcome {
    let mut now = Instant::ZERO;
    let mut carried = 0;
    loop {
        // Both ends speak at once, the client one frame for three of the server.
        let mut silent = true;
        if let Some(frame) = client.poll_transmit(now) {
            silent = false;
            carried += 1;
            assert_eq!(frame.standard_data_id(), StandardId::new(0x602));
            let bytes = frame.data().try_into().expect("requests have eight bytes");
            if let Some(bytes) = fate(Carried { at: carried, to_server: true, bytes }) {
                peer.take(bytes);
            }
        }
        for _ in 0..3 {
            if let Some(bytes) = peer.out.pop_front() {
                silent = false;
                carried += 1;
                if let Some(bytes) = fate(Carried { at: carried, to_server: false, bytes }) {
                    let id = StandardId::new(0x582).expect("11 bits");
                    client.handle(&Frame::new(id, &bytes).expect("8 bytes"), now);
                }
            }
        }
        now += Duration::from_micros(200);
        if silent {
            if let Some(result) = client.poll() {
                return (result.map(|transfer| transfer.data.to_vec()), carried);
            }
            now = client.poll_timeout().expect("a transfer under way has a deadline");
            client.handle_timeout(now);
        }
    }
}

fn client(retries: u8) -> Client {
    Client::with_capacity(NODE, TIME_OUT, retries, CAPACITY)
}

fn upload(retries: u8, peer: &mut Peer, fate: impl FnMut(Carried) -> Option<[u8; 8]>) -> Outcome {
    let mut client = client(retries);
    client.block_upload(OBJECT, Instant::ZERO).expect("idle");
    run(&mut client, peer, fate)
}

fn download(retries: u8, peer: &mut Peer, data: &[u8], fate: impl FnMut(Carried) -> Option<[u8; 8]>) -> Outcome {
    let mut client = client(retries);
    client.block_download(OBJECT, data, Instant::ZERO).expect("idle");
    run(&mut client, peer, fate)
}

fn objects() -> impl Strategy<Value = Vec<u8>> {
    prop_oneof![29..=200_usize, 201..=CAPACITY].prop_flat_map(|size| proptest::collection::vec(any::<u8>(), size))
}

fn block_sizes() -> impl Strategy<Value = Vec<u8>> {
    proptest::collection::vec(prop_oneof![1..=8_u8, 1..=127_u8], 1..4)
}

proptest! {
    #[test]
    fn objects_of_any_length_come_across_whole_or_not_at_all(
        old in objects(),
        new in objects(),
        crc in any::<bool>(),
        tells_size in any::<bool>(),
        block_sizes in block_sizes(),
        lost in proptest::collection::vec(1..600_usize, 0..5),
        retries in 0..6_u8,
    ) {
        let enough = usize::from(retries) >= lost.len();
        let mut peer = Peer::new(old.clone(), crc, tells_size, block_sizes);
        let wire = |carried: Carried| (!lost.contains(&carried.at)).then_some(carried.bytes);
        match upload(retries, &mut peer, wire).0 {
            Ok(read) => prop_assert_eq!(&read, &old),
            Err(error) => prop_assert!(!enough, "{}", error),
        }
        match download(retries, &mut peer, &new, wire).0 {
            Ok(written) => prop_assert!(written == new && peer.object == new),
            Err(error) => {
                prop_assert!(!enough, "{}", error);
                prop_assert!(peer.object == old || peer.object == new);
            }
        }
    }

    #[test]
    fn a_flipped_bit_is_found_by_the_checksum(
        old in objects(),
        new in objects(),
        flipped in 3..100_usize,
        bit in 8..64_usize,
    ) {
        let flip = |Carried { at, mut bytes, .. }| {
            let segment = bytes[0] & 0x7F != 0 && bytes[1..4] != OBJECT_BYTES;
            if at == flipped && segment && bytes[0] & 0x7F < 0x20 {
                bytes[bit / 8] ^= 1 << (bit % 8);
            }
            Some(bytes)
        };
        let crc = |error: SdoError| error.cause.abort_code() == AbortCode::CRC;
        let mut peer = Peer::new(old.clone(), true, true, vec![30]);
        match upload(0, &mut peer, flip).0 {
            Ok(read) => prop_assert_eq!(&read, &old),
            Err(error) => prop_assert!(crc(error), "{}", error),
        }
        match download(0, &mut peer, &new, flip).0 {
            Ok(_) => prop_assert_eq!(&peer.object, &new),
            Err(error) => {
                prop_assert!(crc(error), "{}", error);
                prop_assert_eq!(&peer.object, &old);
            }
        }
    }
}

#[test]
fn a_queue_of_ten_frames_on_the_way_is_found_by_halving() {
    let object: Vec<u8> = (0..2100).map(|at| at as u8).collect();
    let mut peer = Peer::new(object.clone(), true, true, vec![127]);
    // Of each burst of the server no more than ten frames come through.
    let mut burst = 0;
    let (read, frames) = upload(0, &mut peer, |carried| {
        burst = if carried.to_server { 0 } else { burst + 1 };
        (burst <= 10).then_some(carried.bytes)
    });
    assert!(read == Ok(object), "the object came whole");
    assert!((300..800).contains(&frames), "{frames} frames for 300 segments");
}

#[test]
fn an_upload_by_blocks_takes_little_more_frames_than_segments() {
    let object = vec![7; 2800];
    let mut peer = Peer::new(object.clone(), true, true, vec![127]);
    let lossless = |carried: Carried| Some(carried.bytes);
    assert_eq!(upload(0, &mut peer, lossless), (Ok(object.clone()), 3 + 400 + 4 + 2));
    assert_eq!(download(0, &mut peer, &object, lossless), (Ok(object), 2 + 400 + 4 + 2));
}
