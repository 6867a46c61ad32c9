//! Errors of communication that end when their cause ends: cases in which other CANopen stacks kept an error for ever, or
//! cleared the error of another cause.

use super::*;

const TIME_OUT: &str = "082#5082110000000000";
const LOST: &str = "082#3081110000000000";
const NO_ERROR: &str = "082#0000000000000000";

/// CANopenNode issue 612: the time-out of an RPDO never clears.
#[test]
fn an_rpdo_time_out_ends_with_the_next_rpdo_each_time() {
    let mut bench = Bench::booted(config());
    bench.write("021405", 10, 2);
    bench.cyclic();
    let start = bench.read("646000");
    for round in 0..10 {
        bench.follow(5, |_| start);
        assert_eq!(bench.run(30), [TIME_OUT], "round {round}");
        assert_eq!(bench.read("011000"), 0x11, "round {round}");
        let heard = bench.follow(1, |_| start);
        assert!(heard.contains(&NO_ERROR.to_owned()), "round {round}: {heard:?}");
        assert_eq!((bench.read("011000"), bench.read("3F6000")), (0, 0), "round {round}");
    }
}

/// CANopenNode issue 618: two RPDOs time out, and the recovery of one clears the error of both.
#[test]
fn of_two_rpdo_time_outs_each_ends_by_its_own_rpdo() {
    let mut bench = Bench::booted(config());
    bench.write("011405", 10, 2);
    bench.write("021405", 10, 2);
    bench.write("011401", 0x0000_0302, 4);
    bench.cyclic();
    let start = bench.read("646000");
    // Both RPDOs have come, so both have a deadline. RPDO 2 holds controlword and mode.
    let second = "302#0F0008";
    bench.follow(2, |_| start);
    bench.say(second);
    let heard = bench.run(30);
    assert_eq!(heard.iter().filter(|frame| *frame == TIME_OUT).count(), 2, "{heard:?}");
    let heard = bench.follow(1, |_| start);
    assert!(!heard.contains(&NO_ERROR.to_owned()), "the other one is still missing: {heard:?}");
    bench.port.send(bench.now, &[parse(second)]).unwrap();
    let heard = bench.follow(2, |_| start);
    assert!(heard.contains(&NO_ERROR.to_owned()), "{heard:?}");
}

/// CANopenNode issue 26: after the loss of the master's heartbeat, the node obeys no NMT start until its power is cycled.
/// Issue 631: after a dead bus, the consumer never recovers.
#[test]
fn a_node_that_lost_its_master_is_started_again_by_nmt_each_time() {
    let mut bench = Bench::booted(config());
    bench.write("161001", 127 << 16 | 20, 4);
    bench.write("171000", 50, 2);
    bench.say("000#0102");
    for round in 0..10 {
        bench.say("77F#05");
        let heard = bench.run(100);
        assert!(heard.contains(&LOST.to_owned()), "round {round}: {heard:?}");
        assert_eq!(heard.last().unwrap(), "702#7F", "round {round}: pre-operational, as 0x1029 says");
        let heard = bench.say("77F#05");
        assert!(heard.contains(&NO_ERROR.to_owned()), "round {round}: {heard:?}");
        bench.say("000#0102");
        bench.port.send(bench.now, &[parse("77F#05")]).unwrap();
        assert_eq!(bench.read("011000"), 0, "round {round}");
        let heard: Vec<_> = (0..6)
            .flat_map(|_| {
                bench.port.send(bench.now, &[parse("77F#05")]).unwrap();
                bench.run(10)
            })
            .collect();
        assert!(heard.contains(&"702#05".to_owned()), "round {round}: {heard:?}");
    }
}

/// CANopenNode issue 632: an entry whose node was never there keeps the error of a node that is back.
#[test]
fn a_node_that_was_never_heard_holds_no_error_of_another() {
    let mut bench = Bench::booted(config());
    bench.write("161001", 127 << 16 | 20, 4);
    bench.write("161002", 126 << 16 | 20, 4);
    bench.say("77F#05");
    assert_eq!(bench.run(60), [LOST]);
    assert_eq!(bench.say("77F#05"), [NO_ERROR]);
    assert_eq!(bench.read("011000"), 0);
}
