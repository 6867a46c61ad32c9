//! Logs of several tools.

use clap::Parser;

use super::*;

#[derive(Parser)]
struct Command {
    #[command(flatten)]
    options: Options,
}

fn options(words: &str) -> Options {
    Command::try_parse_from(["monitor"].into_iter().chain(words.split_whitespace())).unwrap().options
}

/// What is printed of a log, and its counts.
fn shown(log: &str, words: &str) -> (Vec<String>, Vec<String>) {
    let mut read = Log::default();
    let mut out = Vec::new();
    read.read(log.as_bytes(), &mut out, &options(&format!("--from - {words}"))).unwrap();
    let lines = String::from_utf8(out).unwrap().lines().map(str::to_owned).collect();
    (lines, read.counts())
}

/// A log of a colleague: two buses, frames of all kinds, a loss, and lines of a mail.
const LOG: &str = "\
# recorded at the bench
(1795242628.500000)    can0 000#0105
(1795242630.500250)    can0 601#4041600000000000
(1795242630.500500)    can0 581#4B41600037020000 R
(1795242630.501000)   vcan1 701#R1
(1795242630.501250)   vcan1 20000040#0000000000000000
(1795242630.501500)   vcan1 123##1112233
DROPCOUNT: dropped 3 CAN frames on 'can0' socket (total drops 3)

> (1795242630.502000) can0 080#
(1795242630.502000) can0 080# <- here the arm stopped
(1795242630.502000) can0 080#\r
(1795242628.499000) can0 705#05
";

#[test]
fn a_log_of_a_colleague_is_decoded_as_on_the_bus_and_its_other_lines_are_counted() {
    let (lines, counts) = shown(LOG, "");
    assert_eq!(
        lines,
        [
            "    0.000000  can0    000#0105              start, node 5",
            "    2.000250  can0    601#4041600000000000  node 1: read 0x6041:00 statusword",
            "    2.000500  can0    581#4B41600037020000  node 1: 0x6041:00 statusword = 0x0237, 567 (operation enabled)",
            "    2.001000  vcan1   701#R1                remote frame",
            "    2.001250  vcan1   20000040#0000000000000000  bus-off",
            "    2.001500  vcan1   123##1112233          CAN FD frame, not decoded",
            "    2.002000  can0    080#                  SYNC",
            "   -0.001000  can0    705#05                node 5: operational",
        ]
    );
    assert_eq!(
        counts,
        [
            "8 frames in 13 lines",
            "1 CAN FD or CAN XL frame is not decoded",
            "1 error frame",
            "3 frames were lost while the log was written (DROPCOUNT)",
            "2 lines skipped, the first is line 1: expected a time such as (1795242630.522011)",
            "1 line skipped, the first is line 11: expected nothing, T or R behind the frame",
        ]
    );
}

#[test]
fn kinds_count_and_json_hold_for_a_log() {
    let (lines, _) = shown(LOG, "--only sdo --count 1");
    assert_eq!(lines, ["    2.000250  can0    601#4041600000000000  node 1: read 0x6041:00 statusword"]);
    let (lines, _) = shown(LOG, "--only error --json");
    assert_eq!(
        lines,
        [r#"{"at_s":2.00125,"interface":"vcan1","frame":"20000040#0000000000000000","kind":"error","text":"bus-off"}"#]
    );
}

#[test]
fn an_sdo_transfer_is_unknown_after_a_loss() {
    let log = "\
(1.000000) can0 080#
(2.000000) can0 601#2108100008000000
DROPCOUNT: dropped 1 CAN frame on 'can0' socket (total drops 1)
(2.000500) can0 080#
(2.001000) can0 601#0111223344556677
";
    let (lines, _) = shown(log, "--only sdo");
    assert!(lines[0].contains("write 0x1008") && lines[1].contains("unknown"), "{lines:?}");
}

#[test]
fn a_line_without_an_end_is_cut_and_counted_once() {
    let log = format!("{}\n(1.000000) can0 080#", "x".repeat(3 * LONGEST));
    let (lines, counts) = shown(&log, "");
    assert_eq!((lines.len(), counts[0].as_str()), (1, "1 frame in 2 lines"));
}

#[test]
fn an_interface_or_a_log_is_needed() {
    for words in ["", "--from x --can can0", "--from x --map"] {
        assert!(Command::try_parse_from(["monitor"].into_iter().chain(words.split_whitespace())).is_err(), "{words}");
    }
}
