//! Text of SDO transfers, frame by frame: which frames are commands, and which are segments.

use canopen::objects::DEVICE_NAME;
use canopen::sdo::{AbortCode, Dictionary, MAX_SIZE, Server};
use master::sdo::Client;

use super::*;

mod doubt;

/// A decoder that listens since time zero.
fn listening() -> Decoder {
    let mut decoder = Decoder::default();
    decoder.begin(Instant::ZERO);
    decoder
}

/// Checks the text of frames in their order. Each row has the time of arrival, ms, the frame and its text. `NAME` in a
/// text stands for the name of the object "device name".
#[track_caller]
fn tell(decoder: &mut Decoder, table: &[(u64, &str, &str)]) {
    for (ms, frame, text) in table {
        let text = text.replace("NAME", "0x1008:00 manufacturer device name");
        let at = Instant::from_nanos(ms * 1_000_000);
        let described = decoder.describe(&parse(frame), at);
        assert_eq!(described.text, text, "{frame} at {ms} ms");
    }
}

/// Starts a block download with sub-blocks of 127 segments. Sends the first `segments` segments, 1 ms apart, the first
/// at 2 ms.
fn download(decoder: &mut Decoder, segments: u8) -> u64 {
    tell(
        decoder,
        &[(0, "606#C008100000000000", "write NAME in blocks"), (1, "586#A40810007F000000", "NAME, in blocks of 127")],
    );
    for number in 1..=segments {
        let frame = format!("606#{number:02X}40600006000000");
        let text = format!("segment {number} of NAME: 40 60 00 06 00 00 00");
        tell(decoder, &[(1 + u64::from(number), &frame, &text)]);
    }
    2 + u64::from(segments)
}

const CONTROLWORD: &str = "606#2B40600006000000";
const WRITTEN: &str = "write 0x6040:00 controlword = 0x0006, 6 (shutdown)";
const UNKNOWN: &str = "unknown, a command or segment 43 of a block: 2b 40 60 00 06 00 00 00";

#[test]
fn the_segments_of_a_block_download_are_no_commands() {
    let mut decoder = Decoder::default();
    let at = download(&mut decoder, 42);
    tell(
        &mut decoder,
        &[
            (at, CONTROLWORD, "segment 43 of NAME: 40 60 00 06 00 00 00"),
            (at, "606#AC18191A1B1C1D1E", "last segment 44 of NAME: 18 19 1a 1b 1c 1d 1e"),
            (at, "586#A22C7F0000000000", "block taken up to segment 44, next of 127"),
            (at, "606#C131C30000000000", "end of blocks, checksum 0xc331"),
            (at, "586#A100000000000000", "end of blocks taken"),
            (at, CONTROLWORD, WRITTEN),
            (at, "586#6040600000000000", "0x6040:00 controlword taken"),
        ],
    );
}

#[test]
fn a_sub_block_ends_with_its_last_segment_or_its_size_and_lost_segments_come_again() {
    tell(
        &mut Decoder::default(),
        &[
            (0, "606#C60810000F000000", "write NAME in blocks, 15 bytes"),
            (1, "586#A408100002000000", "NAME, in blocks of 2"),
            (2, "606#0145504F53342D45", "segment 1 of NAME: 45 50 4f 53 34 2d 45"),
            (3, "606#022B406000060000", "segment 2 of NAME: 2b 40 60 00 06 00 00"),
            (4, "586#A201030000000000", "block taken up to segment 1, next of 3"),
            (5, "606#012B406000060000", "segment 1 of NAME: 2b 40 60 00 06 00 00"),
            (6, "606#8241000000000000", "last segment 2 of NAME: 41 00 00 00 00 00 00"),
            // The last segment was lost.
            (7, "586#A2017F0000000000", "block taken up to segment 1, next of 127"),
            (8, "606#8141000000000000", "last segment 1 of NAME: 41 00 00 00 00 00 00"),
            (9, "586#A2017F0000000000", "block taken up to segment 1, next of 127"),
            (10, "606#D931C30000000000", "end of blocks, checksum 0xc331"),
            (11, "586#A100000000000000", "end of blocks taken"),
            (12, CONTROLWORD, WRITTEN),
        ],
    );
}

#[test]
fn the_segments_of_a_block_upload_are_no_answers() {
    let mut decoder = Decoder::default();
    tell(
        &mut decoder,
        &[
            (0, "606#A408100043000000", "read NAME in blocks of 67"),
            (1, "586#C608100000020000", "NAME in blocks, 512 bytes"),
            (2, "606#A300000000000000", "first block, please"),
        ],
    );
    for number in 1..=67 {
        // Segment 67 (0x43) looks like the answer to a read of the statusword.
        let frame = format!("586#{number:02X}41600037060000");
        let text = format!("segment {number} of NAME: 41 60 00 37 06 00 00");
        tell(&mut decoder, &[(3, &frame, &text)]);
    }
    tell(
        &mut decoder,
        &[
            (4, "606#A243020000000000", "block taken up to segment 67, next of 2"),
            (5, "586#0102030405060708", "segment 1 of NAME: 02 03 04 05 06 07 08"),
            (6, "586#8209000000000000", "last segment 2 of NAME: 09 00 00 00 00 00 00"),
            (7, "606#A2027F0000000000", "block taken up to segment 2, next of 127"),
            (8, "586#D931C30000000000", "end of blocks, checksum 0xc331"),
            (9, "606#A100000000000000", "end of blocks taken"),
            (10, "606#4041600000000000", "read 0x6041:00 statusword"),
            (11, "586#4341600037060000", "0x6041:00 statusword = 0x00000637, 1591 (operation enabled, target reached)"),
        ],
    );
}

#[test]
fn a_short_object_may_be_uploaded_without_blocks() {
    tell(
        &mut Decoder::default(),
        &[
            (0, "606#A40810007F150000", "read NAME in blocks of 127"),
            (1, "586#4108100005000000", "NAME: 5 bytes in segments"),
            (2, "606#6000000000000000", "next segment, please"),
            (3, "586#0545504F53340000", "last segment of NAME: 45 50 4f 53 34 \"EPOS4\""),
            (4, "586#0545504F53340000", "last segment 45 50 4f 53 34 \"EPOS4\""),
        ],
    );
}

#[test]
fn ordinary_segments_are_told_with_their_object() {
    tell(
        &mut Decoder::default(),
        &[
            (0, "606#210810000A000000", "write NAME, 10 bytes in segments"),
            (1, "586#6008100000000000", "NAME taken"),
            (2, "606#0045504F532B4060", "segment of NAME: 45 50 4f 53 2b 40 60 \"EPOS+@`\""),
            (3, "586#2000000000000000", "segment taken"),
            // The client repeats the request, because the answer was late.
            (4, "606#0045504F532B4060", "segment of NAME: 45 50 4f 53 2b 40 60 \"EPOS+@`\""),
            (5, "586#2000000000000000", "segment taken"),
            (6, "606#1900010200000000", "last segment of NAME: 00 01 02"),
            (7, "586#3000000000000000", "segment taken"),
            (8, CONTROLWORD, WRITTEN),
        ],
    );
    // A transfer with another node is independent.
    let mut decoder = Decoder::default();
    download(&mut decoder, 42);
    tell(
        &mut decoder,
        &[(50, "607#2B40600006000000", WRITTEN), (51, "586#6040600000000000", "0x6040:00 controlword taken")],
    );
}

#[test]
fn an_abort_of_either_side_ends_a_transfer() {
    let aborts = [
        ("606#8008100000000405", "client aborts NAME: 0x05040000 (SDO protocol timed out)"),
        ("586#8008100004000405", "aborts NAME: 0x05040004 (CRC error)"),
    ];
    for (frame, text) in aborts {
        let mut decoder = Decoder::default();
        let at = download(&mut decoder, 42);
        tell(&mut decoder, &[(at, frame, text), (at, CONTROLWORD, WRITTEN)]);
    }
}

#[test]
fn steps_of_a_block_transfer_are_told_without_their_beginning() {
    let name = "0x1008:00 manufacturer device name";
    let cases = [
        ("602#C60810000A000000", format!("write {name} in blocks, 10 bytes")),
        ("582#A408100007000000", format!("{name}, in blocks of 7")),
        ("582#A2037F0000000000", "block taken up to segment 3, next of 127".to_owned()),
        ("602#C931C30000000000", "end of blocks, checksum 0xc331".to_owned()),
        ("582#A100000000000000", "end of blocks taken".to_owned()),
        ("602#A40810007F000000", format!("read {name} in blocks of 127")),
        ("582#C60810000A000000", format!("{name} in blocks, 10 bytes")),
        ("602#A300000000000000", "first block, please".to_owned()),
        ("582#E445504F53340000", "unknown command specifier: e4 45 50 4f 53 34 00 00".to_owned()),
    ];
    for (frame, text) in &cases {
        check(&Decoder::default(), &[(frame, Kind::Sdo, Some(2), text)]);
    }
}

/// A server with a single object of any size.
struct Object1008(Vec<u8>);

impl Dictionary for Object1008 {
    fn size(&self, _: Object) -> Option<usize> {
        None
    }
    fn read(&mut self, _: Object, into: &mut [u8; MAX_SIZE]) -> Result<usize, AbortCode> {
        into[..self.0.len()].copy_from_slice(&self.0);
        Ok(self.0.len())
    }
    fn write(&mut self, _: Object, data: &[u8]) -> Result<(), AbortCode> {
        self.0 = data.to_vec();
        Ok(())
    }
}

/// Texts of all frames that a client and a server exchange.
fn told(client: &mut Client, server: &mut Server, object: &mut Object1008) -> Vec<String> {
    const NODE: NodeId = NodeId::new(6).unwrap();
    let mut decoder = Decoder::default();
    let mut texts = Vec::new();
    let mut now = Instant::ZERO;
    loop {
        let mut passed = false;
        while let Some(frame) = client.poll_transmit(now) {
            texts.push(decoder.describe(&frame, now).text);
            if let Some(answer) = server.handle_frame(&frame, NODE, object, now) {
                texts.push(decoder.describe(&answer, now).text);
                client.handle(&answer, now);
            }
            passed = true;
        }
        while let Some(frame) = server.poll_transmit(NODE, now) {
            texts.push(decoder.describe(&frame, now).text);
            client.handle(&frame, now);
            passed = true;
        }
        if let Some(result) = client.poll() {
            result.unwrap();
            return texts;
        }
        now = client.poll_timeout().filter(|_| !passed).unwrap_or(now);
        client.handle_timeout(now);
        assert!(now < Instant::from_nanos(1_000_000_000), "{texts:?}");
    }
}

#[test]
fn every_frame_of_a_client_and_a_server_is_told_for_what_it_is() {
    let time_out = std::time::Duration::from_millis(500);
    // Each segment would be a write of the controlword if it were a command.
    let data: Vec<u8> = [0x40, 0x60, 0, 6, 0, 0, 0].repeat(146);
    for size in [41, 301, 889, 890, 1022] {
        for block_size in [1, 2, 43, 44, 127] {
            for upload in [false, true] {
                let mut object = Object1008(data[..size].to_vec());
                let mut server = Server::new(time_out).with_block_size(block_size);
                let mut client = Client::with_capacity(NodeId::new(6).unwrap(), time_out, 0, 2000);
                if upload {
                    client.block_upload(DEVICE_NAME, Instant::ZERO).unwrap();
                } else {
                    client.block_download(DEVICE_NAME, &object.0, Instant::ZERO).unwrap();
                }
                let texts = told(&mut client, &mut server, &mut object);
                let of_name = |text: &&String| text.contains("segment ") && text.contains(" of 0x1008");
                let segments = texts.iter().filter(of_name).count();
                assert_eq!(segments, size.div_ceil(7), "{size} in {block_size}, {upload}");
                let expected = if upload {
                    ["read", "0x1008", "first", "block taken", "end of blocks", "end of blocks taken"]
                } else {
                    ["write", "0x1008", "block taken", "end of blocks", "end of blocks taken", ""]
                };
                let mut others = texts.iter().filter(|text| !of_name(text)).collect::<Vec<_>>();
                others.dedup_by(|one, other| one.starts_with("block taken") && other.starts_with("block taken"));
                let expected = expected.iter().filter(|text| !text.is_empty());
                assert_eq!(others.len(), expected.clone().count(), "{others:?}");
                for (text, expected) in others.iter().zip(expected) {
                    assert!(text.starts_with(expected), "{size} in {block_size}: {text}");
                }
            }
        }
    }
}
