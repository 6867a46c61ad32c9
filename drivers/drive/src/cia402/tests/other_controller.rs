//! A second controller on the bus: before the start, during bring-up and in operation.

use std::task::Poll;
use std::time::Duration;

use can::Received;

use super::bench::*;
use crate::cia402::*;

/// Frames that only a controller sends: SYNC, the heartbeat of the host's node-ID, set-points of the group's drives.
const SIGNS: [(&str, Sign); 5] = [
    ("080#", Sign::Sync),
    ("080#11", Sign::Sync),
    ("77F#05", Sign::Heartbeat { node: 127 }),
    ("202#0F0000000000", Sign::Setpoint { node: 2 }),
    ("302#0F00", Sign::Setpoint { node: 2 }),
];

/// Frames of drives, of the drives of other hosts, and of service tools.
const OTHERS: [&str; 11] = [
    "182#3707E80300000000",
    "282#08",
    "702#05",
    "082#2081110000000000",
    "705#7F",
    "205#0F0000000000",
    "602#4000100000000000",
    "582#4300100092010200",
    "000#0102",
    "100#0000000000000000",
    "7E5#0400000000000000",
];

fn hear(bench: &Bench, text: &str) {
    let (frame, at) = (frame(text), bench.now);
    let received = Received { frame, at };
    bench.bus.0.lock().unwrap().inbox.push_back(received);
}

/// Runs bring-up until `until` with one call per period.
fn listen(bench: &mut Bench, until: Duration) -> Poll<Result<(), BringUpError>> {
    while u128::from(bench.now.as_nanos()) < until.as_nanos() {
        let polled = bench.group.bring_up(bench.now);
        if polled.is_ready() {
            return polled;
        }
        bench.now += PERIOD;
    }
    Poll::Pending
}

#[test]
fn a_second_master_refuses_the_start() {
    let listening = group_config().listening();
    for (text, sign) in SIGNS {
        for heard in [Duration::ZERO, PERIOD, listening / 2, listening - PERIOD] {
            let mut bench = Bench::new(group_config(), &[axis_config(2)]);
            assert_eq!(listen(&mut bench, heard), Poll::Pending);
            hear(&bench, text);
            let polled = bench.group.bring_up(bench.now);
            let refused = Err(BringUpError::OtherController { sign });
            assert_eq!(polled, Poll::Ready(refused), "{text} at {heard:?}");
            assert_eq!(sent(&bench), NONE, "{text} at {heard:?}");
        }
    }
    let error = BringUpError::OtherController { sign: Sign::Sync };
    let text = "another controller is at work: it sent SYNC; end it before this one is started";
    assert_eq!(error.to_string(), text);
}

#[test]
fn the_first_frame_waits_for_three_periods_of_the_heartbeat_and_of_sync_and_for_a_second() {
    let table = [(2_000, 2, 6_000), (334, 2, 1_002), (100, 2, 1_000), (1, 20, 1_000), (5, 1, 1_000), (1, 1, 1_000)];
    for (heartbeat, period, listening) in table {
        let config = GroupConfig {
            heartbeat_period: Duration::from_millis(heartbeat),
            period: Duration::from_millis(period),
            ..group_config()
        };
        let listening = Duration::from_millis(listening);
        assert_eq!(config.listening(), listening);
        let mut bench = Bench::new(config, &[axis_config(2)]);
        assert_eq!(listen(&mut bench, listening), Poll::Pending);
        assert_eq!(sent(&bench), NONE);
        assert_eq!(bench.group.bring_up(bench.now), Poll::Pending);
        assert_eq!(sent(&bench)[0], "000#8202");
    }
}

#[test]
fn drives_and_service_commands_do_not_refuse_the_start() {
    let mut bench = Bench::new(group_config(), &[axis_config(2)]);
    OTHERS.iter().for_each(|text| hear(&bench, text));
    assert_eq!(bench.bring_up(), Ok(()));
}

#[test]
fn a_master_that_comes_during_bring_up_ends_it() {
    for (text, sign) in SIGNS {
        let mut bench = Bench::new(group_config(), &[axis_config(2)]);
        let listening = group_config().listening();
        assert_eq!(listen(&mut bench, listening + 4 * PERIOD), Poll::Pending);
        assert_ne!(sent(&bench), NONE);
        hear(&bench, text);
        let refused = BringUpError::OtherController { sign };
        assert_eq!(bench.bring_up(), Err(refused));
        // After the other controller has gone, bring-up starts again.
        assert_eq!(bench.bring_up(), Ok(()));
    }
}

#[test]
fn a_master_that_comes_in_operation_stops_every_axis() {
    for (text, sign) in SIGNS {
        let mut bench = Bench::up(&[1, 2]);
        bench.enable();
        let mut answers = bench.answers(0x0737, 1_000);
        answers.push(text.to_owned());
        let frames = bench.cycle(&answers, &[AxisCommand::Stand; 2]);
        let fault = Fault::OtherController { sign };
        for state in &bench.states {
            assert_eq!(state.fault, Some(fault), "{text}");
        }
        // The quick stop of each drive.
        assert!(frames[1].starts_with("201#0200") && frames[2].starts_with("202#0200"));
    }
    let fault = Fault::OtherController { sign: Sign::Heartbeat { node: 127 } };
    let text = "bus: another controller is at work: it sent the heartbeat of node 127";
    assert_eq!(fault.to_string(), text);
}

#[test]
fn drives_and_service_commands_do_not_stop_a_robot() {
    // Of the frames of the node itself, only those that a drive may send in operation.
    let others = OTHERS.iter().filter(|text| !text.starts_with("702"));
    let mut bench = Bench::up(&[2]);
    bench.enable();
    for text in others {
        let mut answers = bench.answers(0x0737, 1_000);
        answers.push((*text).to_owned());
        bench.cycle(&answers, &[AxisCommand::Stand]);
        assert_eq!(bench.states[0].fault, None, "{text}");
    }
}

/// Initiation of a download of four bytes, of one byte, and of a block.
const WRITES: [&str; 3] = ["602#2316100132007F00", "602#2F60600008000000", "602#C6001F1000010000"];

#[test]
fn a_master_that_configures_a_node_of_ours_refuses_the_start() {
    let listening = group_config().listening();
    let sign = Sign::Write { node: 2 };
    for text in WRITES {
        for heard in [Duration::ZERO, listening - PERIOD, listening + 2 * PERIOD] {
            let mut bench = Bench::new(group_config(), &[axis_config(2)]);
            assert_eq!(listen(&mut bench, heard), Poll::Pending);
            hear(&bench, text);
            assert_eq!(bench.bring_up(), Err(BringUpError::OtherController { sign }), "{text} at {heard:?}");
        }
        // A write to another node, and a write in operation.
        let mut bench = Bench::new(group_config(), &[axis_config(3)]);
        hear(&bench, text);
        assert_eq!(bench.bring_up(), Ok(()), "{text}");
        let mut bench = Bench::up(&[2]);
        bench.enable();
        let mut answers = bench.answers(0x0737, 1_000);
        answers.push(text.to_owned());
        bench.cycle(&answers, &[AxisCommand::Stand]);
        assert_eq!(bench.states[0].fault, None, "{text}");
    }
    let text = "another controller is at work: it sent a write to node 2 by SDO; end it before this one is started";
    assert_eq!(BringUpError::OtherController { sign }.to_string(), text);
}

#[test]
fn an_end_of_a_transfer_and_a_segment_are_no_signs() {
    // A segment of a download, the end of a block, an abort, a read, and a read of a block.
    for text in ["602#0011223344556677", "602#C100000000000000", "602#8000100000000405", "602#4000100000000000"] {
        let mut bench = Bench::new(group_config(), &[axis_config(2)]);
        hear(&bench, text);
        assert_eq!(bench.bring_up(), Ok(()), "{text}");
    }
}
