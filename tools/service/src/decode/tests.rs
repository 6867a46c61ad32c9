//! Text of frames.

use can::{ExtendedId, StandardId};
use canopen::objects::{POSITION_ACTUAL, STATUSWORD, TORQUE_ACTUAL};
use canopen::pdo::PdoNumber;

use super::*;

mod transfers;

/// Parses a frame in the notation of candump.
fn parse(text: &str) -> Frame {
    let (id, data) = text.split_once('#').unwrap();
    let raw = u32::from_str_radix(id, 16).unwrap();
    let bytes: Vec<u8> =
        (0..data.len()).step_by(2).map(|at| u8::from_str_radix(&data[at..at + 2], 16).unwrap()).collect();
    match id.len() {
        3 => Frame::new(StandardId::new(raw as u16).unwrap(), &bytes).unwrap(),
        _ => Frame::new(ExtendedId::new(raw).unwrap(), &bytes).unwrap(),
    }
}

fn check(decoder: &Decoder, table: &[(&str, Kind, Option<u8>, &str)]) {
    for (frame, kind, node, text) in table {
        let expected = Described { kind: *kind, node: node.and_then(NodeId::new), text: (*text).to_owned() };
        // Each frame is described by a fresh copy of the decoder.
        let described = decoder.clone().describe(&parse(frame), Instant::ZERO);
        assert_eq!(described, expected, "{frame}");
    }
}

#[test]
fn network_management_is_told_in_words() {
    use Kind::{Heartbeat, Nmt, Sync, Time};
    check(
        &Decoder::default(),
        &[
            ("000#0105", Nmt, None, "start, node 5"),
            ("000#8000", Nmt, None, "enter pre-operational, all nodes"),
            ("000#8102", Nmt, None, "reset node, node 2"),
            ("000#0300", Nmt, None, "malformed NMT: 03 00"),
            ("080#", Sync, None, "SYNC"),
            ("080#05", Sync, None, "SYNC 5"),
            ("702#00", Heartbeat, Some(2), "booted"),
            ("702#7F", Heartbeat, Some(2), "pre-operational"),
            ("702#05", Heartbeat, Some(2), "operational"),
            ("702#85", Heartbeat, Some(2), "operational, toggle bit set"),
            ("702#FF", Heartbeat, Some(2), "pre-operational, toggle bit set"),
            ("702#", Heartbeat, Some(2), "malformed heartbeat: "),
            ("100#952CB302313D", Time, None, "TIME 2026-11-21 12:34:56.789"),
            ("100#000000003C00", Time, None, "TIME 1984-03-01 00:00:00.000"),
            ("100#00", Time, None, "malformed TIME: 00"),
        ],
    );
}

#[test]
fn emergencies_are_told_by_the_vendors_own_texts() {
    let mut decoder = Decoder::default();
    let over_current = "error 0x2310 (continuous over-current); present: current";
    check(
        &decoder,
        &[
            ("082#1023030000000000", Kind::Emcy, Some(2), over_current),
            ("082#0000000000000000", Kind::Emcy, Some(2), "error gone; still present: none"),
            (
                "082#0CFF800102030405",
                Kind::Emcy,
                Some(2),
                "error 0xff0c (device specific); present: vendor, vendor's bytes 01 02 03 04 05",
            ),
            ("082#1023", Kind::Emcy, Some(2), "malformed EMCY: 10 23"),
        ],
    );
    let frame = parse("082#8152010000000000");
    let generic = decoder.describe(&frame, Instant::ZERO).text;
    decoder.identify(NodeId::new(2).unwrap(), Identification { vendor: Some(0xFB), device_type: None });
    let maxon = decoder.describe(&frame, Instant::ZERO).text;
    assert_ne!(generic, maxon);
}

#[test]
fn emergencies_of_io_nodes_are_told_by_the_codes_of_their_profile() {
    let emcy = "085#1021030000000000";
    let of_drive = "error 0x2110 (short circuit or earth leakage at the input); present: current";
    let of_io = "error 0x2110 (input current too high); present: current";
    // Answers to reads of the device type: a drive, an I/O node, and an I/O node with another node-ID.
    for (answer, text) in [
        (None, of_drive),
        (Some("585#4300100092010200"), of_drive),
        (Some("585#4300100091010300"), of_io),
        (Some("583#4300100091010300"), of_drive),
    ] {
        let mut decoder = Decoder::default();
        answer.map(|answer| decoder.describe(&parse(answer), Instant::ZERO));
        check(&decoder, &[(emcy, Kind::Emcy, Some(5), text)]);
        // Object 0x603F of the same node.
        let code = decoder.describe(&parse("585#4B3F600010210000"), Instant::ZERO).text;
        let (_, meant) = text.split_once('(').unwrap();
        let (meant, _) = meant.split_once(')').unwrap();
        assert!(code.ends_with(&format!("({meant})")), "{code}");
    }
    let mut decoder = Decoder::default();
    let io = Identification { vendor: Some(0xFB), device_type: Some(401) };
    decoder.identify(NodeId::new(5).unwrap(), io);
    check(&decoder, &[(emcy, Kind::Emcy, Some(5), of_io)]);
}

#[test]
fn sdo_transfers_are_told_by_object_and_value() {
    use Kind::Sdo;
    check(
        &Decoder::default(),
        &[
            ("602#4041600000000000", Sdo, Some(2), "read 0x6041:00 statusword"),
            (
                "582#4B41600037070000",
                Sdo,
                Some(2),
                "0x6041:00 statusword = 0x0737, 1847 (operation enabled, target reached)",
            ),
            ("602#2B4060000F000000", Sdo, Some(2), "write 0x6040:00 controlword = 0x000f, 15 (enable operation)"),
            ("582#6040600000000000", Sdo, Some(2), "0x6040:00 controlword taken"),
            ("602#237A6000FEFFFFFF", Sdo, Some(2), "write 0x607a:00 target position = 0xfffffffe, -2"),
            (
                "582#8041600002000106",
                Sdo,
                Some(2),
                "aborts 0x6041:00 statusword: 0x06010002 (attempt to write a read-only object)",
            ),
            ("602#80FF5F0000000405", Sdo, Some(2), "client aborts 0x5fff:00: 0x05040000 (SDO protocol timed out)"),
            ("582#4108100005000000", Sdo, Some(2), "0x1008:00 manufacturer device name: 5 bytes in segments"),
            ("602#6000000000000000", Sdo, Some(2), "next segment, please"),
            ("582#0545504F53340000", Sdo, Some(2), "last segment 45 50 4f 53 34 \"EPOS4\""),
            ("602#40", Sdo, Some(2), "malformed SDO: 40"),
        ],
    );
}

#[test]
fn pdos_are_told_by_their_mapping_where_it_is_known() {
    let node = NodeId::new(2).unwrap();
    let mut decoder = Decoder::default();
    let tpdo = |entries: &[Entry]| {
        let pdo = Pdo { node, kind: PdoKind::Tpdo, number: PdoNumber::One, entries: entries.to_vec() };
        PdoMap::from([(0x182, pdo)])
    };
    check(&decoder, &[("182#3702", Kind::Pdo, Some(2), "TPDO 1: 37 02"), ("302#", Kind::Pdo, Some(2), "RPDO 2: ")]);
    decoder.add_pdos(tpdo(&[
        Entry::new(STATUSWORD, 16),
        Entry::new(POSITION_ACTUAL, 32),
        Entry::new(TORQUE_ACTUAL, 16),
    ]));
    let whole = "TPDO 1: statusword 0x0237 (operation enabled); position actual value -2; torque actual value 12";
    let short = "TPDO 1: statusword 0x0237 (operation enabled); too short for its mapping; and fe ff";
    check(
        &decoder,
        &[("182#3702FEFFFFFF0C00", Kind::Pdo, Some(2), whole), ("182#3702FEFF", Kind::Pdo, Some(2), short)],
    );
    // Single bits, dummy entries, an object without a name, and a PDO with more bytes than are mapped.
    decoder.add_pdos(tpdo(&[
        Entry::new(Object::new(0x2000, 1), 1),
        Entry::new(Object::new(0x2000, 2), 3),
        Entry::new(Object::new(0x0005, 0), 4),
        Entry::new(Object::new(0x6061, 0), 8),
    ]));
    let bits = "TPDO 1: 0x2000:01 0x1; 0x2000:02 0x6; unused; \
                modes of operation display -3 (mode -3); and 07";
    check(&decoder, &[("182#ADFD07", Kind::Pdo, Some(2), bits)]);
}

#[test]
fn layer_setting_services_are_told_in_words() {
    use Kind::Lss;
    check(
        &Decoder::default(),
        &[
            ("7E5#0401000000000000", Lss, None, "LSS all nodes to configuration"),
            ("7E5#0400000000000000", Lss, None, "LSS all nodes to waiting"),
            ("7E5#40FB000000000000", Lss, None, "LSS select vendor-ID 0x000000fb"),
            ("7E4#4400000000000000", Lss, None, "LSS selected"),
            ("7E5#1105000000000000", Lss, None, "LSS configure node-ID 5"),
            ("7E5#11FF000000000000", Lss, None, "LSS take the node-ID away"),
            ("7E4#1101000000000000", Lss, None, "LSS node-ID: refused, out of range or not supported"),
            ("7E4#1700000000000000", Lss, None, "LSS store: done"),
            ("7E4#5D78563412000000", Lss, None, "LSS serial number 0x12345678"),
            ("7E5#5100000000800000", Lss, None, "LSS fastscan, who is unconfigured"),
            ("7E5#51FB0000001F0000", Lss, None, "LSS fastscan vendor-ID 0x000000fb down to bit 31"),
            ("7E4#4F00000000000000", Lss, None, "LSS identified"),
            ("7E4#04", Lss, None, "malformed LSS: 04"),
        ],
    );
}

#[test]
fn what_is_not_known_is_shown_in_hexadecimal() {
    let remote = Frame::remote(StandardId::new(0x701).unwrap(), 1).unwrap();
    let described = Decoder::default().describe(&remote, Instant::ZERO);
    assert_eq!(described.text, "remote frame");
    check(
        &Decoder::default(),
        &[
            ("7FF#0102", Kind::Other, None, "unknown identifier: 01 02"),
            ("00012345#AB", Kind::Other, None, "29-bit identifier: ab"),
        ],
    );
}

#[test]
fn no_frame_is_too_odd_to_be_told() {
    let mut decoder = Decoder::default();
    decoder.begin(Instant::ZERO);
    let pdo = Pdo {
        node: NodeId::MAX,
        kind: PdoKind::Rpdo,
        number: PdoNumber::Four,
        entries: (0..=u8::MAX).map(|bits| Entry::new(Object::new(0x6064, 0), bits)).collect(),
    };
    decoder.add_pdos(PdoMap::from([(0x57F, pdo)]));
    // A random walk with a fixed seed over identifiers, lengths and bytes.
    let mut random = 0x2545_F491_4F6C_DD1D_u64;
    for id in 0..=0x7FF {
        for length in 0..=8 {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            let data = random.to_le_bytes();
            let frame = Frame::new(StandardId::new(id).unwrap(), &data[..length]).unwrap();
            let at = Instant::from_nanos(random % 3_000_000_000);
            assert!(!decoder.describe(&frame, at).text.is_empty());
        }
    }
}

#[test]
fn an_error_frame_is_told_in_words() {
    let table = [
        (
            0x2000_0204,
            [0, 0x0C, 0, 0, 0, 0, 96, 0],
            "controller: warning limit of receive errors, warning limit of \
         transmit errors; error counters: transmit 96, receive 0",
        ),
        (0x2000_0040, [0; 8], "bus-off"),
        (0x2000_0028, [0, 0, 0x04, 0, 0, 0, 0, 0], "protocol violation: bit stuffing; no acknowledgement"),
        (0x2000_0102, [0; 8], "arbitration lost; controller restarted"),
        (0x2000_0000, [0; 8], "no class is set"),
    ];
    for (id, data, text) in table {
        let described = Decoder::default().describe(&Frame::from_raw(id, 8, data).unwrap(), Instant::ZERO);
        assert_eq!((described.kind, described.text.as_str()), (Kind::Error, text), "{id:#x}");
    }
}
