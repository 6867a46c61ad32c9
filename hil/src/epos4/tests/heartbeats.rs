//! Heartbeats in both directions: monitoring, the effect of a loss, and the drive's own heartbeats.

use super::*;

const HOST: i64 = 127;
const LOST: &str = "082#3081110000000000";
const RECOVERED: &str = "082#0000000000000000";

/// An entry of object 0x1016.
fn watch(node: i64, millis: i64) -> i64 {
    node << 16 | millis
}

/// A drive that is enabled and monitors its host with 50 ms, after the host's first heartbeat.
fn watched() -> Bench {
    let mut bench = Bench::booted(config());
    bench.write("161001", watch(HOST, 50), 4);
    bench.enable(1);
    assert_eq!(bench.say("77F#05"), [""; 0]);
    bench
}

/// Enables a drive that a lost heartbeat has stopped.
fn enable_again(bench: &mut Bench) {
    bench.write("406000", 0x0F, 2);
    assert_eq!(bench.statusword() & 0x6F, 0x27);
}

#[test]
fn a_second_loss_stops_the_drive_whatever_was_written_between() {
    // Writes to object 0x1016 between the losses.
    let writes: [&[(&str, i64)]; 4] = [
        &[("161001", watch(HOST, 60))],
        &[("161001", 0), ("161001", watch(HOST, 50))],
        &[("161001", 0), ("161002", watch(HOST, 50))],
        &[("161002", watch(126, 1000))],
    ];
    for writes in writes {
        for heard_first in [false, true] {
            let mut bench = watched();
            assert_eq!(bench.run(100), [LOST]);
            assert_eq!(bench.statusword() & 0x6F, 0x07);
            if heard_first {
                assert_eq!(bench.say("77F#05"), [RECOVERED]);
            }
            for &(object, value) in writes {
                bench.write(object, value, 4);
            }
            bench.say("77F#05");
            let case = format!("{writes:?}, heard first: {heard_first}");
            assert_eq!(bench.read("011000"), 0, "{case}");
            enable_again(&mut bench);
            assert_eq!(bench.run(100), [LOST], "{case}");
            assert_eq!(bench.statusword() & 0x6F, 0x07, "{case}");
            assert_eq!(bench.read("031000"), 2, "{case}");
        }
    }
}

#[test]
fn a_watch_that_is_given_another_time_goes_on() {
    for (time, silence) in [(20, 40), (200, 220)] {
        let mut bench = watched();
        bench.write("161001", watch(HOST, time), 4);
        assert_eq!(bench.run(silence), [LOST], "{time} ms");
        assert_eq!(bench.statusword() & 0x6F, 0x07, "{time} ms");
    }
}

#[test]
fn a_watch_that_ends_takes_its_error_along() {
    // The entry is cleared, is given another node, or has an invalid node-ID.
    for entry in [0, watch(126, 50), watch(200, 50)] {
        let mut bench = watched();
        assert_eq!(bench.run(100), [LOST]);
        let data = (entry as u32).to_le_bytes().map(|byte| format!("{byte:02X}"));
        let answers = bench.say(&format!("602#23161001{}", data.concat()));
        assert!(answers.contains(&RECOVERED.to_owned()), "{entry:#x}: {answers:?}");
        assert_eq!(bench.read("011000"), 0, "{entry:#x}");
        assert_eq!(bench.read("3F6000"), 0, "{entry:#x}");
    }
}

#[test]
fn a_lost_producer_stays_lost_until_it_is_heard() {
    let mut bench = watched();
    assert_eq!(bench.run(100), [LOST]);
    bench.write("161001", watch(HOST, 500), 4);
    assert_eq!(bench.read("011000"), 0x11);
    assert_eq!(bench.say("77F#05"), [RECOVERED]);
}

#[test]
fn the_loss_of_another_producer_is_another_error() {
    let mut bench = watched();
    bench.write("161002", watch(126, 200), 4);
    assert_eq!(bench.say("77E#05"), [""; 0]);
    assert_eq!(bench.run(100), [LOST]);
    enable_again(&mut bench);
    assert_eq!(bench.run(200), [LOST]);
    assert_eq!(bench.statusword() & 0x6F, 0x07);
    // The error register is clear once both nodes have sent a heartbeat again.
    assert_eq!(bench.say("77F#05"), [""; 0]);
    assert_eq!(bench.read("011000"), 0x11);
    assert_eq!(bench.say("77E#05"), [RECOVERED]);
}

#[test]
fn a_producer_is_watched_by_one_entry_only() {
    let incompatible = 0x0604_0043;
    let range = 0x0609_0030;
    let mut bench = Bench::booted(config());
    let steps = [
        ("161001", 0x007F_0032, 0),
        ("161002", 0x007F_003C, incompatible),
        // The same entry again, an entry without a time, another node, and invalid node-IDs. Such entries are unused
        // and therefore no duplicates.
        ("161001", 0x007F_003C, 0),
        ("161002", 0x007F_0000, 0),
        ("161002", 0x007E_0032, 0),
        ("161001", 0x007E_0032, incompatible),
        ("161001", 0x0000_0032, 0),
        ("161002", 0x0000_0032, 0),
        ("161001", 0x0080_0032, 0),
        ("161002", 0x0080_0032, 0),
        // Bits 24 to 31 are reserved.
        ("161001", 0x0100_0000, range),
        ("161001", 0x807F_0032, range),
    ];
    for (step, (object, value, code)) in steps.into_iter().enumerate() {
        assert_eq!(bench.refusal(object, value, 4), code, "step {step}");
    }
}

#[test]
fn a_producer_begins_at_once_and_after_a_boot_up_one_period_later() {
    let mut bench = Bench::booted(config());
    let answers = bench.say("602#2B1710000A000000");
    assert_eq!(answers, ["702#7F", "582#6017100000000000"]);
    assert_eq!(bench.run(30), ["702#7F"; 3]);
    bench.write("171000", 100, 2);
    bench.write("101001", 0x6576_6173, 4);
    bench.say("000#8102");
    assert_eq!(bench.run(60), ["702#00"]);
    assert_eq!(bench.run(85), [""; 0]);
    assert_eq!(bench.run(10), ["702#7F"]);
}

#[test]
fn a_change_of_the_watch_leaves_the_period_of_the_producer() {
    let mut bench = Bench::booted(config());
    bench.write("171000", 100, 2);
    bench.run(50);
    bench.write("161001", watch(HOST, 50), 4);
    bench.write("161001", 0, 4);
    assert_eq!(bench.run(20), [""; 0]);
    assert_eq!(bench.run(20), ["702#7F"]);
    // The heartbeat producer is switched off and sends nothing.
    bench.write("171000", 0, 2);
    assert_eq!(bench.run(300), [""; 0]);
}
