//! Dialogues of the SDO client.

use super::*;
use crate::parse;
use canopen::objects::{CONTROLWORD, DEVICE_NAME, HOME_OFFSET, MODE_OF_OPERATION, STATUSWORD};
use canopen::sdo::AbortCode;

pub(super) const NODE: NodeId = NodeId::new(2).unwrap();
pub(super) const TIME_OUT: Duration = Duration::from_millis(500);

pub(super) fn client(retries: u8) -> Client {
    Client::new(NODE, TIME_OUT, retries)
}

pub(super) fn at(millis: u64) -> Instant {
    Instant::from_nanos(millis * 1_000_000)
}

/// Plays a dialogue: `602#…` must be sent by the client, `582#…` is handed to it. Nothing else may
/// be sent.
pub(super) fn play(client: &mut Client, now: Instant, dialogue: &[&str]) {
    for line in dialogue {
        if line.starts_with("602") {
            let sent = client.poll_transmit(now).map(|frame| frame.to_string());
            assert_eq!(sent.as_deref(), Some(*line));
        } else {
            client.handle(&parse(line), now);
        }
    }
    assert_eq!(client.poll_transmit(now), None);
}

fn read(object: Object, dialogue: &[&str]) -> Result<Vec<u8>, SdoError> {
    let mut client = client(0);
    client.upload(object, at(0)).unwrap();
    play(&mut client, at(0), dialogue);
    let result = client.poll().unwrap().map(|transfer| transfer.data.to_vec());
    assert_eq!(client.poll(), None);
    assert_eq!(client.poll_timeout(), None);
    result
}

fn write(object: Object, data: &[u8], dialogue: &[&str]) -> Result<(), SdoError> {
    let mut client = client(0);
    client.download(object, data, at(0)).unwrap();
    play(&mut client, at(0), dialogue);
    client.poll().unwrap().map(|transfer| assert_eq!(transfer.data, data))
}

#[test]
fn short_objects_are_read_in_one_exchange() {
    let table: [(&str, &[u8]); 4] = [
        ("582#4F41600001000000", &[1]),
        ("582#4B41600037070000", &[0x37, 0x07]),
        ("582#4341600001020304", &[1, 2, 3, 4]),
        ("582#4241600001020304", &[1, 2, 3, 4]),
    ];
    for (answer, data) in table {
        assert_eq!(read(STATUSWORD, &["602#4041600000000000", answer]).as_deref(), Ok(data));
    }
}

#[test]
fn long_objects_are_read_by_segments() {
    for initiate in ["582#410810000A000000", "582#4008100000000000"] {
        let dialogue = [
            "602#4008100000000000",
            initiate,
            "602#6000000000000000",
            "582#0045504F53342035",
            "602#7000000000000000",
            "582#19302F3500000000",
        ];
        assert_eq!(read(DEVICE_NAME, &dialogue).as_deref(), Ok(b"EPOS4 50/5".as_slice()));
    }
}

#[test]
fn an_empty_object_is_one_empty_last_segment() {
    let upload = ["602#4008100000000000", "582#4108100000000000", "602#6000000000000000", "582#0F00000000000000"];
    assert_eq!(read(DEVICE_NAME, &upload), Ok(vec![]));
    let download = ["602#2108100000000000", "582#6008100000000000", "602#0F00000000000000", "582#2000000000000000"];
    assert_eq!(write(DEVICE_NAME, &[], &download), Ok(()));
}

#[test]
fn numbers_are_written_in_the_size_of_their_type() {
    let table = [
        (Write::new(MODE_OF_OPERATION, -3i8), "602#2F606000FD000000", "582#6060600000000000"),
        (Write::new(MODE_OF_OPERATION, 8u8), "602#2F60600008000000", "582#6060600000000000"),
        (Write::new(CONTROLWORD, 0x000Fu16), "602#2B4060000F000000", "582#6040600000000000"),
        (Write::new(CONTROLWORD, -2i16), "602#2B406000FEFF0000", "582#6040600000000000"),
        (Write::new(HOME_OFFSET, -2i32), "602#237C6000FEFFFFFF", "582#607C600000000000"),
        (Write::new(HOME_OFFSET, 5u32), "602#237C600005000000", "582#607C600000000000"),
    ];
    for (write, request, answer) in table {
        let mut client = client(0);
        client.write(write, at(0)).unwrap();
        play(&mut client, at(0), &[request, answer]);
        assert!(matches!(client.poll(), Some(Ok(_))));
    }
}

#[test]
fn long_data_are_written_by_segments() {
    let dialogue = [
        "602#210810000A000000",
        "582#6008100000000000",
        "602#0045504F53342035",
        "582#2000000000000000",
        "602#19302F3500000000",
        "582#3000000000000000",
    ];
    assert_eq!(write(DEVICE_NAME, b"EPOS4 50/5", &dialogue), Ok(()));
}

#[test]
fn a_broken_upload_is_aborted() {
    let object = DEVICE_NAME;
    let (ask, first) = ("602#4008100000000000", "602#6000000000000000");
    let second = "602#7000000000000000";
    let announced = "582#410810000A000000";
    let table: [(&[&str], SdoError); 7] = [
        (&[ask, announced, first, "582#1045504F53342035", "602#8008100000000305"], SdoCause::Toggle.of(object)),
        (
            &[ask, announced, first, "582#0145504F53342035", "602#8008100010000706"],
            SdoCause::Length { expected: 10, found: 7 }.of(object),
        ),
        (
            &[ask, announced, first, "582#0045504F53342035", second, "582#1745504F53000000", "602#8008100010000706"],
            SdoCause::Length { expected: 10, found: 11 }.of(object),
        ),
        (&[ask, announced, first, "582#0E00000000000000", "602#8008100000000008"], SdoCause::EmptySegment.of(object)),
        (
            &[ask, "582#4108100001010000", "602#8008100005000405"],
            SdoCause::TooLarge { size: 257, capacity: CAPACITY }.of(object),
        ),
        (&[ask, "582#C20810000A000000", "602#8008100001000405"], SdoCause::Specifier { specifier: 0xC2 }.of(object)),
        (&[ask, "582#8008100000000206"], SdoCause::Aborted { code: AbortCode::NO_OBJECT }.of(object)),
    ];
    for (dialogue, error) in table {
        assert_eq!(read(object, dialogue), Err(error));
    }
}

#[test]
fn an_upload_of_unknown_size_is_bounded() {
    let mut client = client(0);
    client.upload(DEVICE_NAME, at(0)).unwrap();
    client.handle(&parse("582#4008100000000000"), at(0));
    for segment in 0..CAPACITY / 7 {
        let toggle = segment % 2 == 1;
        let frame = Response::UploadSegment(Segment::new(&[7; 7], toggle, false).unwrap());
        client.handle(&frame.encode(NODE), at(0));
        assert_eq!(client.poll(), None);
    }
    let frame = Response::UploadSegment(Segment::new(&[7; 7], false, false).unwrap());
    client.handle(&frame.encode(NODE), at(0));
    let error = SdoCause::TooLarge { size: 259, capacity: CAPACITY }.of(DEVICE_NAME);
    assert_eq!(client.poll(), Some(Err(error)));
}

#[test]
fn a_download_confirmed_with_the_wrong_toggle_is_aborted() {
    let dialogue = [
        "602#2108100008000000",
        "582#6008100000000000",
        "602#0001010101010101",
        "582#3000000000000000",
        "602#8008100000000305",
    ];
    let error = SdoCause::Toggle.of(DEVICE_NAME);
    assert_eq!(write(DEVICE_NAME, &[1; 8], &dialogue), Err(error));
}

#[test]
fn a_silent_server_is_asked_again_a_counted_number_of_times() {
    let mut client = client(2);
    client.upload(STATUSWORD, at(0)).unwrap();
    let (ask, abort) = ("602#4041600000000000", "602#8041600000000405");
    play(&mut client, at(0), &[ask]);
    for millis in [500, 1000] {
        assert_eq!(client.poll_timeout(), Some(at(millis)));
        client.handle_timeout(at(millis - 1));
        play(&mut client, at(millis - 1), &[]);
        client.handle_timeout(at(millis));
        play(&mut client, at(millis), &[abort, ask]);
        assert_eq!(client.poll(), None);
    }
    client.handle_timeout(at(1500));
    play(&mut client, at(1500), &[abort]);
    let waited = Duration::from_millis(1500);
    assert_eq!(client.poll(), Some(Err(SdoCause::TimedOut { waited }.of(STATUSWORD))));
    assert_eq!(client.poll_timeout(), None);
}

#[test]
fn a_transfer_that_times_out_in_its_middle_starts_anew() {
    let mut client = client(1);
    client.download(DEVICE_NAME, b"EPOS4 50/5", at(0)).unwrap();
    let begin = ["602#210810000A000000", "582#6008100000000000", "602#0045504F53342035"];
    play(&mut client, at(0), &begin);
    client.handle_timeout(at(500));
    play(&mut client, at(500), &["602#8008100000000405"].into_iter().chain(begin).collect::<Vec<_>>());
    let end = ["582#2000000000000000", "602#19302F3500000000", "582#3000000000000000"];
    play(&mut client, at(501), &end);
    assert_eq!(client.poll().unwrap().unwrap().data, b"EPOS4 50/5");
}

#[test]
fn every_answer_has_the_whole_time_out_to_come() {
    let mut client = client(0);
    client.upload(DEVICE_NAME, at(0)).unwrap();
    client.handle(&parse("582#410810000A000000"), at(400));
    assert_eq!(client.poll_timeout(), Some(at(900)));
    client.handle(&parse("582#0045504F53342035"), at(800));
    assert_eq!(client.poll_timeout(), Some(at(1300)));
}

#[test]
fn late_answers_to_other_requests_are_passed_over() {
    let late = [
        "582#4F60600008000000",
        "582#6041600000000000",
        "582#8060600000000206",
        "582#2000000000000000",
        "582#0045504F53342035",
        "583#4B41600037070000",
        "582#4B416000370700",
    ];
    let mut dialogue = vec!["602#4041600000000000"];
    dialogue.extend(late);
    dialogue.push("582#4B41600037070000");
    assert_eq!(read(STATUSWORD, &dialogue), Ok(vec![0x37, 0x07]));
}

#[test]
fn an_answer_after_the_end_disturbs_nothing() {
    let mut client = client(0);
    client.upload(STATUSWORD, at(0)).unwrap();
    let answer = parse("582#4B41600037070000");
    client.handle(&answer, at(1));
    client.handle(&parse("582#4B41600008000000"), at(1));
    assert_eq!(client.poll().unwrap().unwrap().number(), Ok(0x0737u16));
    client.handle(&answer, at(2));
    assert_eq!(client.poll(), None);
}

#[test]
fn one_transfer_at_a_time() {
    let mut client = client(0);
    client.upload(STATUSWORD, at(0)).unwrap();
    let busy = Err(StartError::Busy { object: STATUSWORD });
    assert_eq!(client.upload(DEVICE_NAME, at(0)), busy);
    client.handle(&parse("582#4B41600037070000"), at(0));
    assert_eq!(client.download(CONTROLWORD, &[6, 0], at(0)), busy);
    assert!(client.poll().is_some());
    let size = CAPACITY + 1;
    let too_large = Err(StartError::TooLarge { object: DEVICE_NAME, size, capacity: CAPACITY });
    assert_eq!(client.download(DEVICE_NAME, &[0; CAPACITY + 1], at(0)), too_large);
    assert_eq!(client.download(DEVICE_NAME, &[0; CAPACITY], at(0)), Ok(()));
}

#[test]
fn numbers_are_read_in_the_size_of_their_type() {
    let answer = |line: &str| {
        let mut client = client(0);
        client.upload(STATUSWORD, at(0)).unwrap();
        client.handle(&parse(line), at(0));
        client
    };
    let mut sized = answer("582#4B416000FEFF0000");
    let transfer = sized.poll().unwrap().unwrap();
    assert_eq!(transfer.number(), Ok(0xFFFEu16));
    assert_eq!(transfer.number(), Ok(-2i16));
    let length = |expected, found| SdoCause::Length { expected, found }.of(STATUSWORD);
    assert_eq!(transfer.number::<u32>(), Err(length(4, 2)));
    assert_eq!(transfer.number::<i8>(), Err(length(1, 2)));
    let mut unsized_ = answer("582#42416000FEFF0000");
    let transfer = unsized_.poll().unwrap().unwrap();
    assert_eq!(transfer.number(), Ok(-2i16));
    assert_eq!(transfer.number(), Ok(0x0000_FFFEu32));
    assert_eq!(transfer.number::<u64>(), Err(length(8, 4)));
}

#[test]
fn errors_name_the_object_and_both_sides() {
    let object = STATUSWORD;
    let table = [
        (
            SdoCause::Aborted { code: AbortCode::NO_OBJECT }.of(object),
            "0x6041:00 aborted by the server: 0x06020000 (object does not exist)",
        ),
        (SdoCause::TimedOut { waited: TIME_OUT }.of(object), "0x6041:00 timed out after 500.0ms"),
        (SdoCause::Length { expected: 4, found: 2 }.of(object), "0x6041:00 has 2 bytes, expected 4"),
    ];
    for (error, text) in table {
        assert_eq!(error.to_string(), text);
    }
}
