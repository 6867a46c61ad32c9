//! Dialogues of the SDO client's block transfer.

use std::time::Duration;

use super::super::tests::{NODE, TIME_OUT, at, client, play};
use super::*;
use crate::parse;
use crate::sdo::SdoError;
use canopen::objects::DEVICE_NAME;

const OBJECT: canopen::Object = DEVICE_NAME;

/// 30 bytes, whose checksum is 0x0121.
fn data() -> Vec<u8> {
    (1..=30).collect()
}

/// Plays the frames of `text`, as [`play`] does.
fn say(client: &mut Client, millis: u64, text: &str) {
    let lines: Vec<_> = text.split_whitespace().collect();
    play(client, at(millis), &lines);
}

fn downloading(retries: u8) -> Client {
    let mut client = client(retries);
    client.block_download(OBJECT, &data(), at(0)).unwrap();
    client
}

fn uploading(retries: u8) -> Client {
    let mut client = client(retries);
    client.block_upload(OBJECT, at(0)).unwrap();
    client
}

fn result(mut client: Client) -> Result<Vec<u8>, SdoError> {
    let result = client.poll().expect("the transfer is over");
    let data = result.map(|transfer| transfer.data.to_vec());
    assert_eq!(client.poll_timeout(), None);
    data
}

fn download(text: &str) -> Result<Vec<u8>, SdoError> {
    let mut client = downloading(1);
    say(&mut client, 0, text);
    result(client)
}

fn upload(text: &str) -> Result<Vec<u8>, SdoError> {
    let mut client = uploading(1);
    say(&mut client, 0, text);
    result(client)
}

/// Sub-blocks of four segments.
const BEGIN_DOWNLOAD: &str = "602#C60810001E000000 582#A408100004000000 ";
const BEGIN_UPLOAD: &str = "602#A40810007F1C0000 582#C60810001E000000 602#A300000000000000 ";
const ALL_SEGMENTS: &str = "582#0101020304050607 582#0208090A0B0C0D0E 582#030F101112131415
     582#04161718191A1B1C 582#851D1E0000000000 602#A2057F0000000000 ";
const ABORT_TIME_OUT: &str = "602#8008100000000405 ";

#[test]
fn data_are_written_in_sub_blocks() {
    let dialogue = [
        BEGIN_DOWNLOAD,
        "602#0101020304050607 602#0208090A0B0C0D0E 602#030F101112131415 602#04161718191A1B1C",
        "582#A2047F0000000000 602#811D1E0000000000 582#A2017F0000000000",
        "602#D521010000000000 582#A100000000000000",
    ];
    assert_eq!(download(&dialogue.join(" ")), Ok(data()));
}

#[test]
fn data_are_read_in_sub_blocks() {
    let dialogue = [BEGIN_UPLOAD, ALL_SEGMENTS, "582#D521010000000000 602#A100000000000000"];
    assert_eq!(upload(&dialogue.join(" ")), Ok(data()));
}

#[test]
fn what_was_not_acknowledged_is_sent_again() {
    let end = "602#D521010000000000 582#A100000000000000";
    let table = [
        // The third segment is lost, and the next sub-block is to be shorter.
        "602#0101020304050607 602#0208090A0B0C0D0E 602#030F101112131415 602#04161718191A1B1C
         582#A202020000000000 602#010F101112131415 602#02161718191A1B1C
         582#A202040000000000 602#811D1E0000000000 582#A201040000000000",
        // All are lost, and the next sub-block is longer.
        "602#0101020304050607 602#0208090A0B0C0D0E 602#030F101112131415 602#04161718191A1B1C
         582#A200050000000000 602#0101020304050607 602#0208090A0B0C0D0E 602#030F101112131415
         602#04161718191A1B1C 602#851D1E0000000000 582#A205000000000000",
        // The server says so as soon as it sees the gap.
        "602#0101020304050607 602#0208090A0B0C0D0E 602#030F101112131415
         582#A2017F0000000000 602#0108090A0B0C0D0E 602#020F101112131415 602#03161718191A1B1C
         602#841D1E0000000000 582#A2047F0000000000",
        // It says it twice.
        "602#0101020304050607 602#0208090A0B0C0D0E 602#030F101112131415 602#04161718191A1B1C
         582#A2047F0000000000 582#A2047F0000000000 602#811D1E0000000000 582#A2017F0000000000",
    ];
    for dialogue in table {
        assert_eq!(download(&[BEGIN_DOWNLOAD, dialogue, end].join(" ")), Ok(data()));
    }
}

#[test]
fn what_did_not_come_in_order_is_asked_for_again_in_shorter_sub_blocks() {
    let end = "582#D521010000000000 602#A100000000000000";
    let table = [
        // The second segment is lost.
        "582#0101020304050607 582#030F101112131415 582#04161718191A1B1C 582#851D1E0000000000
         602#A201400000000000
         582#0108090A0B0C0D0E 582#020F101112131415 582#03161718191A1B1C 582#841D1E0000000000
         602#A204400000000000",
        // All but the last are lost; then the second comes twice.
        "582#851D1E0000000000 602#A200400000000000
         582#0101020304050607 582#0208090A0B0C0D0E 582#0208090A0B0C0D0E 582#030F101112131415
         582#04161718191A1B1C 582#851D1E0000000000 602#A205400000000000",
    ];
    for dialogue in table {
        assert_eq!(upload(&[BEGIN_UPLOAD, dialogue, end].join(" ")), Ok(data()));
    }
}

#[test]
fn a_sub_block_whose_end_is_lost_is_acknowledged_as_far_as_it_came() {
    let mut client = uploading(1);
    say(&mut client, 0, BEGIN_UPLOAD);
    say(&mut client, 100, "582#0101020304050607 582#0208090A0B0C0D0E");
    assert_eq!(client.poll_timeout(), Some(at(600)));
    client.handle_timeout(at(600));
    // The rest of the old sub-block is late.
    say(
        &mut client,
        600,
        "602#A202400000000000 582#030F101112131415 582#7F16171819000000
         582#010F101112131415 582#02161718191A1B1C 582#831D1E0000000000
         602#A203400000000000 582#D521010000000000 602#A100000000000000",
    );
    assert_eq!(result(client), Ok(data()));
}

#[test]
fn without_a_checksum_a_sub_block_whose_end_is_lost_starts_the_transfer_anew() {
    let begin = "602#A40810007F1C0000 582#C20810001E000000 602#A300000000000000 ";
    let mut client = uploading(1);
    say(&mut client, 0, begin);
    say(&mut client, 0, "582#0101020304050607");
    client.handle_timeout(at(500));
    let end = "582#D5FFFF0000000000 602#A100000000000000";
    let anew = [ABORT_TIME_OUT, begin, ALL_SEGMENTS, end].concat();
    say(&mut client, 500, &anew);
    assert_eq!(result(client), Ok(data()));
}

#[test]
fn a_server_without_checksum_is_sent_none() {
    let dialogue = "602#C60810001E000000 582#A00810007F000000
         602#0101020304050607 602#0208090A0B0C0D0E 602#030F101112131415 602#04161718191A1B1C
         602#851D1E0000000000 582#A2057F0000000000 602#D500000000000000 582#A100000000000000";
    assert_eq!(download(dialogue), Ok(data()));
}

#[test]
fn short_objects_take_the_ordinary_transfer() {
    let mut short = client(0);
    short.block_download(OBJECT, b"EPOS4", at(0)).unwrap();
    say(&mut short, 0, "602#2108100005000000");
    let mut longest = client(0);
    longest.block_download(OBJECT, &[0; 28], at(0)).unwrap();
    say(&mut longest, 0, "602#210810001C000000");
    let mut longer = client(0);
    longer.block_download(OBJECT, &[0; 29], at(0)).unwrap();
    say(&mut longer, 0, "602#C60810001D000000");

    let ask = "602#A40810007F1C0000 ";
    let expedited = upload(&[ask, "582#4B08100037070000"].concat());
    assert_eq!(expedited, Ok(vec![0x37, 0x07]));
    let segmented = [ask, "582#4108100005000000 602#6000000000000000 582#0545504F53340000"];
    assert_eq!(upload(&segmented.concat()), Ok(b"EPOS4".to_vec()));
}

#[test]
fn a_server_that_refuses_block_transfer_is_asked_for_an_ordinary_one() {
    let refused = "582#8008100001000405 ";
    let read = [
        "602#A40810007F1C0000 ",
        refused,
        "602#4008100000000000 582#4108100005000000 602#6000000000000000 582#0545504F53340000",
    ];
    assert_eq!(upload(&read.concat()), Ok(b"EPOS4".to_vec()));
    let written = [
        "602#C60810001E000000 ",
        refused,
        "602#210810001E000000 582#6008100000000000
         602#0001020304050607 582#2000000000000000 602#1008090A0B0C0D0E 582#3000000000000000
         602#000F101112131415 582#2000000000000000 602#10161718191A1B1C 582#3000000000000000
         602#0B1D1E0000000000 582#2000000000000000",
    ];
    assert_eq!(download(&written.concat()), Ok(data()));
    // A restart after a refusal does not ask for block transfer again.
    let mut client = uploading(1);
    say(&mut client, 0, "602#A40810007F1C0000");
    say(&mut client, 0, &[refused, "602#4008100000000000"].concat());
    client.handle_timeout(at(500));
    let anew = [ABORT_TIME_OUT, "602#4008100000000000"].concat();
    say(&mut client, 500, &anew);
}

#[test]
fn a_server_that_missed_the_abort_and_takes_the_request_for_a_segment_is_asked_again() {
    let refused = "582#8008100003000405 ";
    for (mut client, ask) in [(uploading(2), "602#A40810007F1C0000 "), (downloading(2), "602#C60810001E000000 ")] {
        say(&mut client, 0, ask);
        client.handle_timeout(at(500));
        say(&mut client, 500, &[ABORT_TIME_OUT, ask, refused, ask].concat());
        say(&mut client, 500, refused);
        let (object, code) = (OBJECT, AbortCode::SEQUENCE_NUMBER);
        assert_eq!(result(client), Err(SdoCause::Aborted { code }.of(object)));
    }
}

#[test]
fn every_other_abort_ends_the_transfer() {
    let aborted = |code| Err(SdoCause::Aborted { code }.of(OBJECT));
    let table = [
        ("602#A40810007F1C0000 582#8008100000000206", AbortCode::NO_OBJECT),
        (&[BEGIN_UPLOAD, "582#0101020304050607 582#8008100000000008"].concat(), AbortCode::GENERAL),
        (&[BEGIN_UPLOAD, ALL_SEGMENTS, "582#8008100001000405"].concat(), AbortCode::COMMAND_SPECIFIER),
    ];
    for (dialogue, code) in table {
        assert_eq!(upload(dialogue), aborted(code));
    }
    let mut client = downloading(1);
    say(&mut client, 0, BEGIN_DOWNLOAD.split_once(' ').unwrap().0);
    client.handle(&parse("582#A408100004000000"), at(0));
    assert!(client.poll_transmit(at(0)).is_some());
    client.handle(&parse("582#8008100022000008"), at(0));
    assert_eq!(client.poll_transmit(at(0)), None);
    assert_eq!(result(client), aborted(AbortCode::DEVICE_STATE));
}

#[test]
fn a_broken_upload_is_aborted() {
    let object = OBJECT;
    let unsized_ = "602#A40810007F1C0000 582#C408100000000000 602#A300000000000000 ";
    let length = |found| SdoCause::Length { expected: 30, found }.of(object);
    let table = [
        (
            [BEGIN_UPLOAD, ALL_SEGMENTS, "582#D522010000000000 602#8008100004000405"].concat(),
            SdoCause::Crc { expected: 0x0122, found: 0x0121 }.of(object),
        ),
        ([BEGIN_UPLOAD, ALL_SEGMENTS, "582#C521010000000000 602#8008100010000706"].concat(), length(34)),
        (
            [
                BEGIN_UPLOAD,
                &ALL_SEGMENTS.replace("582#85", "582#05").replace("602#A2057F0000000000", ""),
                "582#0600000000000000 602#8008100010000706",
            ]
            .concat(),
            length(42),
        ),
        (
            "602#A40810007F1C0000 582#C608100001010000 602#8008100005000405".to_string(),
            SdoCause::TooLarge { size: 257, capacity: 256 }.of(object),
        ),
        (
            [unsized_, &segments(1, 38), "602#8008100005000405"].concat(),
            SdoCause::TooLarge { size: 266, capacity: 256 }.of(object),
        ),
        (
            [
                unsized_,
                &segments(1, 36),
                "582#A500000000000000 602#A2257F0000000000
                 582#C500000000000000 602#8008100005000405",
            ]
            .concat(),
            SdoCause::TooLarge { size: 258, capacity: 256 }.of(object),
        ),
    ];
    for (dialogue, error) in table {
        assert_eq!(upload(&dialogue), Err(error), "{dialogue}");
    }
}

/// Segments that are not the last.
fn segments(first: u8, last: u8) -> String {
    let segments = (first..=last).map(|number| format!("582#{number:02X}00000000000000 "));
    segments.collect()
}

#[test]
fn an_object_as_large_as_the_room_for_it_is_read() {
    let mut client = Client::with_capacity(NODE, TIME_OUT, 0, 30);
    client.block_upload(OBJECT, at(0)).unwrap();
    say(&mut client, 0, BEGIN_UPLOAD);
    say(&mut client, 0, ALL_SEGMENTS);
    say(&mut client, 0, "582#D521010000000000 602#A100000000000000");
    assert_eq!(result(client), Ok(data()));
}

#[test]
fn a_server_that_breaks_a_download_is_told_so() {
    let object = OBJECT;
    let four = "602#0101020304050607 602#0208090A0B0C0D0E 602#030F101112131415 602#04161718191A1B1C ";
    let block_size = |block_size| SdoCause::BlockSize { block_size }.of(object);
    let begin = BEGIN_DOWNLOAD.split_once(' ').unwrap().0;
    let table = [
        ([begin, " 582#A408100000000000 602#8008100002000405"].concat(), block_size(0)),
        ([begin, " 582#A408100080000000 602#8008100002000405"].concat(), block_size(128)),
        ([BEGIN_DOWNLOAD, four, "582#A204000000000000 602#8008100002000405"].concat(), block_size(0)),
        (
            [BEGIN_DOWNLOAD, four, "582#A205040000000000 602#8008100003000405"].concat(),
            SdoCause::Sequence { sequence: 5, sent: 4 }.of(object),
        ),
    ];
    for (dialogue, error) in table {
        assert_eq!(download(&dialogue), Err(error));
    }
}

#[test]
fn silence_in_any_state_starts_anew_and_late_frames_disturb_nothing() {
    let four = "602#0101020304050607 602#0208090A0B0C0D0E 602#030F101112131415 602#04161718191A1B1C ";
    let ask = "602#A40810007F1C0000 ";
    let uploads = [
        [ask, "", ""],
        [BEGIN_UPLOAD, "", ""],
        [BEGIN_UPLOAD, "582#0208090A0B0C0D0E", ""],
        [BEGIN_UPLOAD, ALL_SEGMENTS, ""],
    ];
    // All that might still come of the transfer given up, but an answer that begins one.
    let late = " 582#0208090A0B0C0D0E 582#850102030405060A 582#D521010000000000 582#A2047F0000000000
         582#5000000000000000 582#2000000000000000 582#A100000000000000 582#8000600000000206 ";
    for dialogue in uploads {
        let mut client = uploading(1);
        say(&mut client, 0, &dialogue.concat());
        client.handle_timeout(at(499));
        say(&mut client, 499, "");
        client.handle_timeout(at(500));
        say(&mut client, 500, &[ABORT_TIME_OUT, ask, late].concat());
        let rest = BEGIN_UPLOAD.strip_prefix(ask).unwrap();
        say(&mut client, 600, &[rest, ALL_SEGMENTS].concat());
        client.handle_timeout(at(1100));
        say(&mut client, 1100, ABORT_TIME_OUT);
        let waited = Duration::from_millis(1100);
        let object = OBJECT;
        assert_eq!(result(client), Err(SdoCause::TimedOut { waited }.of(object)));
    }
    let begin = BEGIN_DOWNLOAD.split_once(' ').unwrap().0;
    let last = "582#A2047F0000000000 602#811D1E0000000000 ";
    let downloads = [
        begin.to_string(),
        [BEGIN_DOWNLOAD, four].concat(),
        [BEGIN_DOWNLOAD, four, last].concat(),
        [BEGIN_DOWNLOAD, four, last, "582#A2017F0000000000 602#D521010000000000"].concat(),
    ];
    for dialogue in downloads {
        let mut client = downloading(1);
        say(&mut client, 0, &dialogue);
        client.handle_timeout(at(500));
        say(&mut client, 500, &[ABORT_TIME_OUT, begin, late].concat());
        let rest = BEGIN_DOWNLOAD.strip_prefix(begin).unwrap();
        let end = "582#A2017F0000000000 602#D521010000000000 582#A100000000000000";
        say(&mut client, 600, &[rest, four, last, end].concat());
        assert_eq!(result(client), Ok(data()));
    }
}

#[test]
fn sub_blocks_of_which_nothing_comes_are_borne_a_counted_number_of_times() {
    let mut reader = uploading(2);
    say(&mut reader, 0, BEGIN_UPLOAD);
    for block_size in ["40", "20"] {
        let again = format!("582#851D1E0000000000 602#A200{block_size}0000000000");
        say(&mut reader, 0, &again);
    }
    let anew = [ABORT_TIME_OUT, "602#A40810007F1C0000"].concat();
    say(&mut reader, 0, &["582#851D1E0000000000 ", &anew].concat());

    let mut writer = downloading(2);
    let four = "602#0101020304050607 602#0208090A0B0C0D0E 602#030F101112131415 602#04161718191A1B1C ";
    let nothing = "582#A200040000000000 ";
    let thrice = [four, nothing].concat().repeat(3);
    let anew = [ABORT_TIME_OUT, "602#C60810001E000000"].concat();
    say(&mut writer, 0, &[BEGIN_DOWNLOAD, &thrice, &anew].concat());
}

#[test]
fn only_sub_blocks_in_a_row_of_which_nothing_comes_count() {
    let mut reader = uploading(1);
    say(&mut reader, 0, BEGIN_UPLOAD);
    let dialogue = "582#851D1E0000000000 602#A200400000000000
         582#0101020304050607 582#851D1E0000000000 602#A201200000000000
         582#841D1E0000000000 602#A200100000000000";
    say(&mut reader, 0, dialogue);

    let mut writer = downloading(1);
    let four = "602#0101020304050607 602#0208090A0B0C0D0E 602#030F101112131415 602#04161718191A1B1C ";
    let rest = "602#0108090A0B0C0D0E 602#020F101112131415 602#03161718191A1B1C 602#841D1E0000000000 ";
    let dialogue = [
        BEGIN_DOWNLOAD,
        four,
        "582#A200040000000000 ",
        four,
        "582#A201040000000000 ",
        rest,
        "582#A200040000000000 ",
        rest,
    ];
    say(&mut writer, 0, &dialogue.concat());
}

#[test]
fn a_segment_that_comes_again_does_not_put_off_the_time_out() {
    let mut client = uploading(0);
    say(&mut client, 0, BEGIN_UPLOAD);
    say(&mut client, 100, "582#030F101112131415");
    say(&mut client, 200, "582#030F101112131415");
    assert_eq!(client.poll_timeout(), Some(at(600)));
    say(&mut client, 300, "582#0101020304050607");
    say(&mut client, 400, "582#0101020304050607");
    assert_eq!(client.poll_timeout(), Some(at(800)));
}

#[test]
fn segments_are_handed_out_one_by_one_at_the_callers_pace() {
    let mut client = downloading(0);
    let begin = BEGIN_DOWNLOAD.split_once(' ').unwrap().0;
    say(&mut client, 0, begin);
    client.handle(&parse("582#A408100004000000"), at(100));
    assert_eq!(client.poll_timeout(), Some(at(600)));
    for millis in [200, 300, 400, 500] {
        assert!(client.poll_transmit(at(millis)).is_some());
        assert_eq!(client.poll_timeout(), Some(at(millis + 500)));
    }
    assert_eq!(client.poll_transmit(at(500)), None);
    client.handle_timeout(at(1000));
    assert!(client.poll().is_some_and(|result| result.is_err()));
}

#[test]
fn the_confirmation_of_an_upload_goes_before_the_next_request() {
    let mut client = uploading(0);
    say(&mut client, 0, BEGIN_UPLOAD);
    say(&mut client, 0, ALL_SEGMENTS);
    client.handle(&parse("582#D521010000000000"), at(0));
    assert!(client.poll().is_some());
    client.upload(OBJECT, at(0)).unwrap();
    say(&mut client, 0, "602#A100000000000000 602#4008100000000000");
}

#[test]
fn a_client_that_is_reset_has_nothing_to_say() {
    let mut client = uploading(3);
    client.handle_timeout(at(500));
    client.reset();
    say(&mut client, 0, "");
    assert_eq!(client.poll(), None);
    assert_eq!(client.poll_timeout(), None);
    assert_eq!(client.upload(OBJECT, at(0)), Ok(()));
}
