//! Whatever comes over a serial line, reading it does not panic; what was written reads back.

use can::slcan::{AdapterReport, BITRATES_KBPS, BusErrors, Command, LONGEST, Piece, Splitter, StatusFlags};
use can::timing::{Bitrate, Format};
use can::{ControllerState, Frame};
use mrroc_can as can;
use proptest::prelude::*;

fn frames() -> impl Strategy<Value = Frame> {
    // Standard and extended, data and remote; no error frames.
    let id = prop_oneof![0..0x800_u32, (0..0x2000_0000_u32).prop_map(|id| id | 0x8000_0000)];
    (id, any::<bool>(), 0..=8_u8, any::<[u8; 8]>()).prop_map(|(id, remote, len, data)| {
        let id = id | u32::from(remote) << 30;
        Frame::from_raw(id, len, data).expect("at most 8 bytes")
    })
}

fn commands() -> impl Strategy<Value = Command> {
    prop_oneof![
        frames().prop_map(Command::Transmit),
        proptest::sample::select(&BITRATES_KBPS[..])
            .prop_map(|kbps| Command::Bitrate(Bitrate::from_kbps(kbps).expect("a rate of slcan"))),
        any::<(u8, u8)>().prop_map(|(btr0, btr1)| Command::BitTiming { btr0, btr1 }),
        any::<u32>().prop_map(Command::AcceptanceCode),
        any::<u32>().prop_map(Command::AcceptanceMask),
        any::<bool>().prop_map(Command::TimeStamps),
        Just(Command::Empty),
        Just(Command::Open),
        Just(Command::Close),
    ]
}

fn reports() -> impl Strategy<Value = AdapterReport> {
    use ControllerState::{Active, BusOff, Passive, Warning};
    let states = proptest::sample::select(&[Active, Warning, Passive, BusOff][..]);
    prop_oneof![
        (frames(), any::<Option<u16>>()).prop_map(|(frame, stamp)| AdapterReport::Received { frame, stamp }),
        (states, 0..=999_u16, 0..=999_u16)
            .prop_map(|(state, receive, transmit)| { AdapterReport::State { state, receive, transmit } }),
        any::<u8>().prop_map(|flags| AdapterReport::Flags(StatusFlags(flags))),
        "[0-9A-Za-z]{4}"
            .prop_map(|number| { AdapterReport::SerialNumber(number.into_bytes().try_into().expect("four letters")) }),
        Just(AdapterReport::Done),
        Just(AdapterReport::Refused),
        Just(AdapterReport::Transmitted(Format::Extended)),
        Just(AdapterReport::Errors(BusErrors::STUFF | BusErrors::FORM)),
    ]
}

/// Bytes that often look like lines.
fn noise() -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![
        1 => any::<u8>(),
        6 => proptest::sample::select(&b"tTrRsSeVNFZzOCLXMm0123456789ABCDEFabcdef\r\r\r\x07\n"[..]),
    ];
    proptest::collection::vec(byte, 0..400)
}

proptest! {
    #[test]
    fn noise_does_not_panic_and_every_byte_is_accounted_for(bytes in noise()) {
        let mut splitter = Splitter::default();
        let (mut kept, mut ends, mut lines) = (0, 0, 0);
        for &byte in &bytes {
            ends += u64::from(matches!(byte, b'\r' | b'\n' | 0x07));
            if let Some(piece) = splitter.push(byte) {
                let _ = AdapterReport::parse(piece);
                if let Piece::Line(line) = piece {
                    let _ = Command::parse(line);
                    prop_assert!(line.len() <= LONGEST);
                    kept += line.len() as u64;
                    lines += 1;
                }
            }
        }
        // What is not kept was dropped or waits for its end.
        prop_assert!(kept + ends <= bytes.len() as u64);
        let before = splitter.dropped();
        splitter.push(b'\r');
        let dropped = splitter.dropped();
        prop_assert!(dropped <= before + 1);
        prop_assert!(lines + dropped <= ends + 1);
    }

    #[test]
    fn what_is_understood_encodes_to_what_parses_alike(bytes in noise()) {
        let mut splitter = Splitter::default();
        for &byte in &bytes {
            let Some(piece) = splitter.push(byte) else { continue };
            if let Piece::Line(line) = piece && let Ok(command) = Command::parse(line) {
                let again = command.encode().expect("it was a line");
                prop_assert_eq!(Command::parse(&again[..again.len() - 1]), Ok(command));
            }
            if let Ok(report) = AdapterReport::parse(piece) {
                let again = report.encode().expect("it was a line");
                let mut splitter = Splitter::default();
                let found = again.iter().find_map(|&byte| splitter.push(byte).map(AdapterReport::parse));
                prop_assert_eq!(found, Some(Ok(report)));
            }
        }
    }

    #[test]
    fn commands_behind_noise_are_read_as_written(
        noise in proptest::collection::vec(any::<u8>(), 0..80),
        commands in proptest::collection::vec(commands(), 0..20),
    ) {
        let mut splitter = Splitter::default();
        for &byte in noise.iter().chain(b"\r") {
            splitter.push(byte);
        }
        let mut read = Vec::new();
        for command in &commands {
            for &byte in &*command.encode().expect("a line can say it") {
                if let Some(Piece::Line(line)) = splitter.push(byte) {
                    read.push(Command::parse(line).expect("as written"));
                }
            }
        }
        prop_assert_eq!(read, commands);
    }

    #[test]
    fn reports_are_read_as_written(reports in proptest::collection::vec(reports(), 0..20)) {
        let mut splitter = Splitter::default();
        let mut read = Vec::new();
        for report in &reports {
            for &byte in &*report.encode().expect("a line can say it") {
                if let Some(piece) = splitter.push(byte) {
                    read.push(AdapterReport::parse(piece).expect("as written"));
                }
            }
        }
        prop_assert_eq!(read, reports);
        prop_assert_eq!(splitter.dropped(), 0);
    }
}
