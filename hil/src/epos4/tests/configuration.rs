//! LSS, and block transfers of objects.

use super::*;

/// Sends one LSS request, padded with zeros, and returns the answers.
fn ask(bench: &mut Bench, request: &str) -> Vec<String> {
    let answers = bench.say(&format!("7E5#{request:0<16}"));
    let payload = |answer: String| answer.strip_prefix("7E4#").unwrap_or(&answer).to_owned();
    let bare = |answer: String| answer.trim_end_matches("00").to_owned();
    answers.into_iter().map(payload).map(bare).collect()
}

/// Sends requests and compares the answers. Both are given without trailing zeros.
fn check(bench: &mut Bench, dialogue: &[(&str, &[&str])]) {
    for (step, (request, answers)) in dialogue.iter().enumerate() {
        assert_eq!(&ask(bench, request), answers, "step {step}: {request}");
    }
}

fn unconfigured() -> Bench {
    let mut bench = Bench::new(Epos4Config { node: None, ..config() });
    assert_eq!(bench.run(200), [""; 0]);
    bench
}

const SELECT: [(&str, &[&str]); 4] =
    [("40FB000000", &[]), ("4100005061", &[]), ("4200007001", &[]), ("4302000010", &["44"])];

#[test]
fn a_unit_without_a_node_id_answers_nothing_but_lss() {
    let mut bench = unconfigured();
    for text in ["000#0100", "000#8100", "000#8200", "080#", "602#4000100000000000"] {
        assert_eq!(bench.say(text), [""; 0], "{text}");
    }
    assert_eq!(bench.run(200), [""; 0]);
    check(&mut bench, &[("4C", &["50"])]);
}

#[test]
fn a_unit_without_a_node_id_boots_when_it_was_given_one() {
    let mut bench = unconfigured();
    check(&mut bench, &SELECT);
    check(
        &mut bench,
        &[
            ("5A", &["5AFB"]),
            ("5B", &["5B00005061"]),
            ("5C", &["5C00007001"]),
            ("5D", &["5D02000010"]),
            ("5E", &["5EFF"]),
            ("1105", &["11"]),
            ("1300", &["13"]),
            ("17", &["17"]),
            ("5E", &["5EFF"]),
            ("0400", &[]),
        ],
    );
    assert_eq!(bench.run(60), ["705#00"]);
    // COB-IDs follow from the new node-ID. NMT commands to the new node-ID are executed.
    assert_eq!(bench.say("605#4014100000000000"), ["585#4314100085000000"]);
    assert_eq!(bench.say("000#0105"), ["185#4006"]);
    check(&mut bench, &[("4C", &[]), ("0401", &[]), ("5E", &["5E05"])]);
    // The node-ID was stored.
    bench.say("000#8105");
    assert_eq!(bench.run(60), ["705#00"]);
}

#[test]
fn a_new_node_id_waits_for_a_reset_of_the_communication() {
    let mut bench = Bench::booted(config());
    check(&mut bench, &[("0401", &[]), ("1107", &["11"]), ("0400", &[])]);
    assert_eq!(bench.run(60), [""; 0]);
    assert_eq!(bench.say("602#4017100000000000"), ["582#4B17100000000000"]);
    bench.say("000#8202");
    assert_eq!(bench.run(60), ["707#00"]);
    assert_eq!(bench.say("607#4000140100000000"), ["587#4300140107020000"]);
    // A reset of the communication ends configuration mode.
    check(&mut bench, &[("0401", &[]), ("5E", &["5E07"])]);
    bench.say("000#8207");
    assert_eq!(bench.run(60), ["707#00"]);
    check(&mut bench, &[("5E", &[])]);
    // The node-ID was not stored.
    bench.say("000#8107");
    assert_eq!(bench.run(60), ["702#00"]);
}

#[test]
fn a_unit_can_be_robbed_of_its_node_id() {
    let mut bench = Bench::booted(config());
    check(&mut bench, &[("0401", &[]), ("11FF", &["11"]), ("4C", &[]), ("0400", &[])]);
    bench.say("000#8202");
    assert_eq!(bench.run(60), [""; 0]);
    check(&mut bench, &[("4C", &["50"])]);
}

#[test]
fn what_a_unit_is_not_asked_it_does_not_answer() {
    let mut bench = Bench::booted(config());
    // In waiting state nothing can be configured. Wrong identity numbers, and right numbers in the wrong order,
    // select no unit.
    for request in ["1105", "1300", "1510", "17", "5A", "5E", "510000000080"] {
        check(&mut bench, &[(request, &[])]);
    }
    let another: (&str, &[&str]) = ("4303000010", &[]);
    let [vendor, product, revision, serial] = SELECT;
    let silent = |(request, _)| (request, &[] as &[&str]);
    check(&mut bench, &[vendor, product, revision, another, silent(serial), ("5E", &[])]);
    check(&mut bench, &[vendor, revision, product, silent(serial), ("5E", &[])]);
    check(&mut bench, &[product, revision, silent(serial), ("5E", &[])]);
    check(&mut bench, &[vendor, product, revision, serial, ("5E", &["5E02"])]);
    // Invalid node-IDs and bit rates.
    let refused = [
        ("1100", &["1101"][..]),
        ("1180", &["1101"]),
        ("11FE", &["1101"]),
        ("117F", &["11"]),
        ("130008", &["1301"]),
        ("130005", &["1301"]),
        ("130100", &["1301"]),
        ("130009", &["13"]),
        ("131510", &["1301"]),
        ("99", &[]),
    ];
    check(&mut bench, &refused);
}

#[test]
fn a_unit_is_identified_by_ranges() {
    // Revision 0x0170_0000, serial 0x1000_0002: the bounds, and whether the unit lies within them.
    let cases = [
        (["4800007001", "4900007001", "4A02000010", "4B02000010"], true),
        (["4800000000", "49FFFFFFFF", "4A00000000", "4BFFFFFFFF"], true),
        (["4801007001", "49FFFFFFFF", "4A00000000", "4BFFFFFFFF"], false),
        (["4800000000", "49FFFF6F01", "4A00000000", "4BFFFFFFFF"], false),
        (["4800000000", "49FFFFFFFF", "4A03000010", "4BFFFFFFFF"], false),
        (["4800000000", "49FFFFFFFF", "4A00000000", "4B01000010"], false),
    ];
    let mut bench = Bench::booted(config());
    for (bounds, within) in cases {
        let before = [("46FB000000", &[][..]), ("4700005061", &[])];
        check(&mut bench, &before);
        let answers = bounds.map(|bound| ask(&mut bench, bound));
        let answers = answers.concat();
        assert_eq!(answers, ["4F"][..usize::from(within)], "{bounds:?}");
    }
}

#[test]
fn a_fastscan_finds_the_identity_bit_by_bit() {
    let mut bench = unconfigured();
    let mut scan = |number: u32, bit: u8, sub: u8, next: u8| {
        let bytes: Vec<_> = number.to_le_bytes().map(|byte| format!("{byte:02X}")).to_vec();
        let request = format!("51{}{bit:02X}{sub:02X}{next:02X}", bytes.concat());
        match ask(&mut bench, &request).as_slice() {
            [] => false,
            [answer] if answer == "4F" => true,
            answers => panic!("{answers:?}"),
        }
    };
    assert!(scan(0, 0x80, 0, 0));
    let mut found = [0; 4];
    for sub in 0..4_u8 {
        let number = &mut found[usize::from(sub)];
        for bit in (0..32).rev() {
            if !scan(*number, bit, sub, sub) {
                *number |= 1 << bit;
            }
        }
        assert!(!scan(*number ^ 1, 0, sub, (sub + 1) % 4));
        assert!(scan(*number, 0, sub, (sub + 1) % 4));
        // The unit has gone on to the next identity number.
        assert!(!scan(*number, 0, sub, sub));
    }
    assert_eq!(found, [0x0000_00FB, 0x6150_0000, 0x0170_0000, 0x1000_0002]);
    check(&mut bench, &[("5E", &["5EFF"])]);
}

#[test]
fn a_short_object_goes_by_blocks() {
    let mut bench = Bench::booted(config());
    assert_eq!(bench.ask("A408100002000000"), "C608100005000000");
    assert_eq!(bench.ask("A300000000000000"), "8145504F53340000");
    assert_eq!(bench.ask("A2017F0000000000"), "C9A35B0000000000");
    assert_eq!(bench.ask("A100000000000000"), "nothing");
    assert_eq!(bench.ask("4041600000000000"), "4B41600040040000");
}

#[test]
fn a_long_object_goes_by_blocks_as_fast_as_the_bus_takes_it() {
    let mut bench = Bench::booted(config());
    assert_eq!(bench.ask("A4F02F027F000000"), "C6F02F02E8030000");
    bench.port.send(bench.now, &[parse("602#A300000000000000")]).unwrap();
    let asked = bench.now;
    let first = bench.run_micros(30_000);
    assert_eq!(first.len(), 127);
    let request = can::timing::bits_on_wire(&parse("602#A300000000000000"));
    let segment = can::timing::bits_on_wire(&first[0].frame);
    let carried = Bitrate::KBPS_1000.duration(request + segment - 2 * can::timing::INTERMISSION);
    let delay = config().answer_delay;
    assert_eq!(first[0].at.since(asked), carried + delay);
    // The frames follow each other without a gap, and begin after the drive's answer delay.
    let bits = |received: &Received| can::timing::bits_on_wire(&received.frame);
    let expected: u32 = first.iter().skip(1).map(bits).sum();
    let lasted = first[126].at.since(first[0].at);
    assert_eq!(lasted, Bitrate::KBPS_1000.duration(expected));
    bench.port.send(bench.now, &[parse("602#A27F7F0000000000")]).unwrap();
    let second = bench.run(30);
    assert_eq!(second.len(), 16);
    assert!(second[15].starts_with("582#90"), "{}", second[15]);
    assert_eq!(bench.ask("A2107F0000000000"), "C5D3850000000000");
    assert_eq!(bench.ask("A100000000000000"), "nothing");

    // A block download, and an upload in segments.
    assert_eq!(bench.ask("C6F02F0209000000"), "A4F02F027F000000");
    assert_eq!(bench.ask("0141424344454647"), "nothing");
    assert_eq!(bench.ask("8248490000000000"), "A2027F0000000000");
    assert_eq!(bench.ask("D5DC1A0000000000"), "A100000000000000");
    assert_eq!(bench.ask("40F02F0200000000"), "41F02F0209000000");
    assert_eq!(bench.ask("6000000000000000"), "0041424344454647");
}

#[test]
fn the_rated_torque_is_the_one_that_the_motor_was_given_in_the_unit_of_the_maker() {
    for (vendor, rated, expected) in [
        (0xFB, 0.001, 1000),
        (0xFB, 0.0063, 6300),
        (0xFB, 0.42, 420_000),
        (0xFB, 100.0, 100_000_000),
        (1, 0.42, 420),
        (1, 0.001, 1),
    ] {
        let mut bench = Bench::booted(Epos4Config { vendor, rated_torque: Some(rated), ..config() });
        let answers = bench.say("602#4076600000000000");
        let value = answers[0].strip_prefix("582#43766000").unwrap();
        let value = u32::from_str_radix(value, 16).unwrap().swap_bytes();
        // The nominal current and the torque constant are rounded to whole numbers.
        assert!(value.abs_diff(expected) <= 1 + expected / 10_000, "{rated} N·m: {value}");
    }
}
