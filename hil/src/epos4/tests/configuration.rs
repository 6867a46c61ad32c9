//! Block transfers of objects, and the rated torque.

use super::*;

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
