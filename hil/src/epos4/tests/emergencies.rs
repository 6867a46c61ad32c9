//! EMCY, the error register and the history: from the cause of an error to its end.

use super::*;

const SHORT: &str = "082#1082110000000000";
const NO_ERROR: &str = "082#0000000000000000";

/// A drive in fault because of a missing RPDO, with 0x6007 = 1.
fn faulted() -> Bench {
    let mut bench = Bench::booted(config());
    bench.write("076000", 1, 2);
    bench.say("000#0102");
    let answers = bench.say("202#");
    assert!(answers.contains(&SHORT.to_owned()), "{answers:?}");
    assert_eq!(bench.statusword() & 0x4F, 0x08);
    bench
}

/// Checks that a fault reset ends the error and announces its end.
fn check_reset(bench: &mut Bench) {
    bench.write("406000", 0, 2);
    let answers = bench.say("602#2B40600080000000");
    assert!(answers.contains(&NO_ERROR.to_owned()), "{answers:?}");
    assert_eq!(bench.statusword() & 0x4F, 0x40);
    assert_eq!(bench.read("011000"), 0);
    assert_eq!(bench.read("3F6000"), 0);
}

#[test]
fn a_fault_keeps_its_error_through_a_reset_of_the_communication() {
    let mut bench = faulted();
    for _ in 0..2 {
        bench.say("000#8202");
        assert_eq!(bench.run(60), ["702#00", SHORT]);
        assert_eq!(bench.statusword() & 0x4F, 0x08);
        assert_eq!(bench.read("011000"), 0x11);
        assert_eq!(bench.read("3F6000"), 0x8210);
        assert_eq!(bench.read("031000"), 1);
        assert_eq!(bench.read("031001"), 0x8210);
    }
    check_reset(&mut bench);
}

#[test]
fn an_error_without_a_fault_ends_with_a_reset_of_the_communication() {
    let mut bench = Bench::booted(config());
    bench.say("000#0102");
    assert_eq!(bench.say("202#"), [SHORT]);
    bench.say("000#8202");
    assert_eq!(bench.run(60), ["702#00"]);
    assert_eq!(bench.read("011000"), 0);
    assert_eq!(bench.read("3F6000"), 0);
    assert_eq!(bench.read("031000"), 0);
}

#[test]
fn a_reset_of_the_node_ends_every_error() {
    let mut bench = Bench::booted(config());
    bench.cyclic();
    let start = bench.read("646000");
    bench.follow(5, |_| start);
    bench.follow(50, |_| start + 100_000);
    bench.run(500);
    assert_eq!(bench.statusword() & 0x204F, 0x2008, "fault and following error");
    bench.say("000#8102");
    assert_eq!(bench.run(60), ["702#00"]);
    assert_eq!(bench.statusword() & 0x204F, 0x0040);
    assert_eq!(bench.read("011000"), 0);
    assert_eq!(bench.read("3F6000"), 0);
}

#[test]
fn a_fault_for_an_ended_connection_has_an_error() {
    const ENDED: &str = "082#0081110000000000";
    for (command, heard) in [("000#0202", &[][..]), ("000#8202", &["702#00", ENDED])] {
        let mut bench = Bench::booted(config());
        bench.write("076000", 1, 2);
        bench.enable(1);
        assert_eq!(bench.say(command), [""; 0]);
        assert_eq!(bench.run(60), heard, "{command}");
        if heard.is_empty() {
            assert_eq!(bench.say("000#8002"), [ENDED]);
        }
        bench.run(500);
        assert_eq!(bench.statusword() & 0x4F, 0x08, "{command}");
        assert_eq!(bench.read("011000"), 0x11, "{command}");
        assert_eq!(bench.read("3F6000"), 0x8100, "{command}");
        assert_eq!(bench.read("031001"), 0x8100, "{command}");
        check_reset(&mut bench);
    }
}

#[test]
fn an_emergency_of_a_stopped_node_is_sent_when_the_node_leaves_the_state() {
    const LOST: &str = "082#3081110000000000";
    let watched = || {
        let mut bench = Bench::booted(config());
        bench.write("161001", 127 << 16 | 50, 4);
        assert_eq!(bench.say("77F#05"), [""; 0]);
        bench
    };
    // The error occurs in stopped.
    let mut bench = watched();
    assert_eq!(bench.say("000#0202"), [""; 0]);
    assert_eq!(bench.run(100), [""; 0]);
    assert_eq!(bench.say("000#8002"), [LOST]);
    assert_eq!(bench.read("031000"), 1);
    // The error ends in stopped.
    assert_eq!(bench.say("000#0202"), [""; 0]);
    assert_eq!(bench.say("77F#05"), [""; 0]);
    assert_eq!(bench.say("000#0102"), [NO_ERROR, "182#4006"]);
    // The error occurs and ends in stopped, so that there is nothing to announce.
    let mut bench = watched();
    bench.say("000#0202");
    bench.run(100);
    bench.say("77F#05");
    assert_eq!(bench.say("000#8002"), [""; 0]);
    assert_eq!(bench.read("011000"), 0);
}

#[test]
fn every_short_rpdo_stops_the_drive_and_the_error_is_said_once() {
    let mut bench = Bench::booted(config());
    bench.enable(1);
    bench.say("000#0102");
    assert_eq!(bench.say("202#")[..1], [SHORT]);
    for _ in 0..2 {
        assert_eq!(bench.statusword() & 0x6F, 0x07);
        bench.write("406000", 0x0F, 2);
        assert_eq!(bench.statusword() & 0x6F, 0x27);
        let heard = bench.say("202#0F");
        assert!(!heard.contains(&SHORT.to_owned()), "{heard:?}");
    }
    assert_eq!(bench.statusword() & 0x6F, 0x07);
    assert_eq!(bench.read("031000"), 1);
}

#[test]
fn a_sync_with_data_is_not_taken_and_says_so() {
    const LENGTH: &str = "082#4082110000000000";
    for sync in ["080#01", "080#0102030405060708"] {
        let mut bench = Bench::booted(config());
        bench.cyclic();
        let start = bench.read("646000");
        bench.follow(3, |_| start);
        assert_eq!(bench.say(sync), [LENGTH]);
        assert_eq!(bench.say(sync), [""; 0], "said once");
        assert_eq!(bench.read("011000"), 0x11);
        assert_eq!(bench.statusword() & 0x6F, 0x27, "it goes on");
        let mut heard = bench.say("080#");
        heard.sort();
        assert_eq!(heard.len(), 2, "{heard:?}");
        assert_eq!(heard[0], NO_ERROR);
        assert!(heard[1].starts_with("382#3712"), "{heard:?}");
    }
}

#[test]
fn a_drive_trips_once_at_its_time() {
    let mut bench = Bench::booted(Epos4Config { trips_at: Some(Instant::ZERO + Duration::from_secs(1)), ..config() });
    bench.cyclic();
    let start = bench.read("646000");
    while bench.now < Instant::ZERO + Duration::from_millis(990) {
        bench.follow(1, |_| start);
    }
    assert_eq!((bench.statusword() & 0x6F, bench.read("3F6000")), (0x27, 0));
    bench.follow(10, |_| start);
    assert_eq!((bench.statusword() & 0x4F, bench.read("3F6000")), (0x08, 0x2310));
    check_reset(&mut bench);
    bench.enable(8);
    bench.follow(20, |_| start);
    assert_eq!((bench.statusword() & 0x6F, bench.read("3F6000")), (0x27, 0));
}
