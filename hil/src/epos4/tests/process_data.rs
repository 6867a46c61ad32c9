//! The parameters of PDOs: timers, identifiers, mappings, and changes of parameters while PDOs are exchanged.

use super::*;

const RANGE: u32 = 0x0609_0030;
const NO_ERROR: &str = "082#0000000000000000";
const OVERDUE: &str = "082#5082110000000000";

fn count(frames: &[String], id: &str) -> usize {
    frames.iter().filter(|frame| frame.starts_with(id)).count()
}

#[test]
fn the_inhibit_time_holds_the_event_timer_back() {
    // Inhibit time and event timer, ms, and the number of transmissions within 3 s after the first.
    for (inhibit, timer, expected) in [(300, 50, 10), (50, 300, 10), (0, 100, 30), (300, 0, 0)] {
        let mut bench = Bench::booted(config());
        bench.write("001801", 0xC000_0182, 4);
        bench.write("001803", 10 * inhibit, 2);
        bench.write("001805", timer, 2);
        bench.write("001801", 0x4000_0182, 4);
        assert_eq!(bench.say("000#0102"), ["182#4006"]);
        let sent = count(&bench.run(3000), "182#");
        assert_eq!(sent, expected, "{inhibit} ms, {timer} ms");
    }
}

#[test]
fn a_change_within_the_inhibit_time_is_sent_at_its_end() {
    let mut bench = Bench::booted(config());
    bench.write("001801", 0xC000_0182, 4);
    bench.write("001803", 205, 2);
    bench.write("001801", 0x4000_0182, 4);
    let begun = bench.now;
    bench.port.send(begun, &[parse("000#0102")]).unwrap();
    let first = bench.run_micros(5_000)[0].at;
    bench.say("202#0600");
    let second = bench.run_micros(30_000)[0];
    assert_eq!(second.frame.to_string(), "182#2106");
    let apart = second.at.since(first).as_micros();
    assert!((20_490..=20_600).contains(&apart), "{apart} µs");
}

#[test]
fn a_good_rpdo_ends_no_error_of_another() {
    let mut bench = Bench::booted(config());
    bench.write("076000", 0, 2);
    bench.write("001405", 1000, 2);
    bench.write("011405", 10, 2);
    bench.write("011401", 0x0000_0302, 4);
    bench.say("000#0102");
    bench.say("202#0600");
    bench.say("302#060001");
    let heard = bench.run(30);
    assert_eq!(heard, [OVERDUE]);
    assert_eq!(bench.say("202#0600"), [""; 0]);
    assert_eq!(bench.read("011000"), 0x11);
    // The reception of another RPDO does not end the error of a too short RPDO either.
    assert_eq!(bench.say("302#06"), ["082#1082110000000000"]);
    assert_eq!(bench.say("202#0600"), [""; 0]);
    assert_eq!(bench.read("011000"), 0x11);
    assert_eq!(bench.say("302#060001"), [NO_ERROR]);
    assert_eq!(bench.read("011000"), 0);
}

#[test]
fn an_rpdo_that_is_not_watched_any_more_is_not_overdue() {
    // The event timer is switched off, then the PDO itself.
    for (object, value, bytes) in [("021405", 0_u32, 2), ("021401", 0x8000_0402, 4)] {
        let mut bench = Bench::booted(config());
        bench.write("076000", 0, 2);
        bench.write("021405", 10, 2);
        bench.write("021401", 0x0000_0402, 4);
        bench.say("000#0102");
        bench.say("402#060000000000");
        assert_eq!(bench.run(30), [OVERDUE]);
        let specifier = 0x23 | (4 - bytes as u8) << 2;
        let data = value.to_le_bytes().map(|byte| format!("{byte:02X}"));
        let answers = bench.say(&format!("602#{specifier:02X}{object}{}", data.concat()));
        assert!(answers.contains(&NO_ERROR.to_owned()), "{object}: {answers:?}");
        assert_eq!(bench.read("011000"), 0, "{object}");
    }
}

#[test]
fn an_rpdo_whose_watch_is_given_another_time_stays_watched() {
    for (time, silence) in [(20, 40), (100, 120)] {
        let mut bench = Bench::booted(config());
        bench.write("076000", 0, 2);
        bench.write("021405", 50, 2);
        bench.write("021401", 0x0000_0402, 4);
        bench.say("000#0102");
        bench.say("402#060000000000");
        bench.write("021405", time, 2);
        assert_eq!(bench.run(silence), [OVERDUE], "{time} ms");
    }
}

#[test]
fn an_identifier_of_11_bits_has_no_further_bits() {
    let mut bench = Bench::booted(config());
    for (object, own) in [("001401", 0x202), ("011401", 0x302), ("001801", 0x182)] {
        for invalid in [0, 0x8000_0000_u32] {
            for bit in 11..=29 {
                let value = invalid | 1 << bit | own;
                assert_eq!(bench.refusal(object, value, 4), RANGE, "{object} {value:#010x}");
            }
        }
        assert_eq!(bench.refusal(object, 0x8000_0000 | own, 4), 0, "{object}");
        assert_eq!(bench.refusal(object, 0x4000_0000 | own, 4), 0, "{object}");
    }
}

#[test]
fn writing_one_pdo_leaves_the_others_as_they_are() {
    let mut bench = Bench::booted(config());
    // TPDO1 at every third SYNC, TPDO2 on events, RPDO3 at SYNC.
    bench.write("001802", 3, 1);
    bench.write("011801", 0x4000_0282, 4);
    bench.write("021402", 1, 1);
    bench.write("021401", 0x0000_0402, 4);
    assert_eq!(bench.say("000#0102"), ["282#400601"]);
    for object in ["031402", "031802"] {
        assert_eq!(bench.say("080#"), [""; 0]);
        assert_eq!(bench.say("080#"), [""; 0]);
        assert_eq!(bench.say("402#060044332211"), [""; 0]);
        let answers = bench.say(&format!("602#2F{object}01000000"));
        assert_eq!(answers, [format!("582#60{object}00000000")], "no other PDO is sent");
        let heard = bench.say("080#");
        assert_eq!(count(&heard, "182#"), 1, "{object}: {heard:?}");
        assert_eq!(bench.read("7A6000"), 0x1122_3344, "{object}");
        bench.write("7A6000", 0, 4);
        // The statusword in TPDO2 has changed once.
        bench.say("202#0000");
    }
}

#[test]
fn a_change_of_timers_sends_no_pdo() {
    let mut bench = Bench::booted(config());
    assert_eq!(bench.say("000#0102"), ["182#4006"]);
    for (object, value) in [("001805", "2C01"), ("001802", "FE00"), ("001402", "FE00")] {
        let specifier = if object == "001805" { "2B" } else { "2F" };
        let answers = bench.say(&format!("602#{specifier}{object}{value}0000"));
        assert_eq!(answers, [format!("582#60{object}00000000")]);
    }
}

#[test]
fn a_mapping_has_room_for_twelve_entries_and_eight_bytes() {
    let length = 0x0604_0042;
    let mut bench = Bench::booted(config());
    assert_eq!(bench.refusal("011600", 0, 1), 0);
    for sub in 1..=12 {
        let object = format!("0116{sub:02X}");
        assert_eq!(bench.refusal(&object, 0x0005_0008, 4), 0, "entry {sub}");
    }
    assert_eq!(bench.refusal("01160D", 0x0005_0008, 4), 0x0609_0011);
    for count in 9..=12 {
        assert_eq!(bench.refusal("011600", count, 1), length, "{count} entries");
    }
    for count in [13, 64, 65, 0xFE, 0xFF] {
        assert_eq!(bench.refusal("011600", count, 1), RANGE, "{count} entries");
    }
    assert_eq!(bench.refusal("011600", 8, 1), 0);
    // A count larger than the number of mapped objects.
    assert_eq!(bench.refusal("011A00", 0, 1), 0);
    assert_eq!(bench.refusal("011A00", 3, 1), 0x0602_0000);
    assert_eq!(bench.refusal("011A00", 9, 1), length);
}
