//! Power states, modes of operation and homing from the host's view.

use super::*;

#[test]
fn cyclic_positions_are_followed_and_answered_at_every_sync() {
    let mut bench = Bench::booted(config());
    bench.cyclic();
    let start = bench.read("646000");
    let heard = bench.follow(500, |cycle| start + 4 * cycle as i32);
    assert_eq!(heard.len(), 500);
    assert!(heard.iter().all(|frame| frame.starts_with("382#")), "{heard:?}");
    // Operation enabled, remote, and bit 12: set-points are followed.
    assert!(heard.last().unwrap().starts_with("382#3712"), "{:?}", heard.last());
    let reached = bench.read("646000");
    let expected = start + 4 * 499;
    assert!((reached - expected).abs() < 20, "{reached} {expected}");
}

#[test]
fn a_torque_offset_is_added_in_the_cyclic_modes_of_position_and_velocity() {
    for (mode, added) in [(8, true), (9, true), (1, false), (3, false)] {
        for offset in [100, -100] {
            let mut bench = Bench::booted(config());
            bench.enable(mode);
            bench.write("B26000", offset, 2);
            let torque = i64::from(bench.read("776000") as i16);
            // The loops have already begun to compensate the offset.
            let expected = if added { 20..=100 } else { 0..=2 };
            assert!(expected.contains(&(torque * offset.signum())), "mode {mode}: {torque}");
            bench.run(500);
            let torque = i64::from(bench.read("776000") as i16);
            assert!(torque.abs() < 20, "mode {mode}: {torque}");
            bench.write("406000", 0x06, 2);
            bench.run(20);
            assert_eq!(bench.read("776000") as i16, 0, "mode {mode}");
        }
    }
}

#[test]
fn a_jump_of_the_set_point_is_a_following_error() {
    let mut bench = Bench::booted(config());
    bench.cyclic();
    let start = bench.read("646000");
    bench.follow(5, |_| start);
    let heard = bench.follow(50, |_| start + 100_000);
    // EMCY: 0x8611, generic and vendor bits. The error is announced once.
    let emergencies: Vec<_> = heard.iter().filter(|f| f.starts_with("082#")).collect();
    assert_eq!(emergencies, ["082#1186810000000000"]);
    bench.follow(500, |_| start);
    assert_eq!(bench.statusword() & 0x6F, 0x08);
    assert_eq!(bench.read("3F6000"), 0x8611);
    assert_eq!(bench.ask("4003100100000000"), "4303100111860000");
    // Bit 7 must rise. A controlword that keeps enable operation does not clear the fault.
    bench.write("406000", 0x0F, 2);
    assert_eq!(bench.statusword() & 0x6F, 0x08);
    let answers = bench.say("602#2B40600080000000");
    assert!(answers.contains(&"082#0000000000000000".to_owned()), "{answers:?}");
    assert_eq!(bench.statusword() & 0x4F, 0x40);
    assert_eq!(bench.read("011000"), 0);
}

#[test]
fn a_missing_sync_is_no_error() {
    let mut bench = Bench::booted(config());
    bench.cyclic();
    let start = bench.read("646000");
    bench.follow(5, |_| start);
    assert!(bench.run(30).is_empty());
}

#[test]
fn profile_position_acknowledges_a_set_point_and_reaches_it() {
    let mut bench = Bench::booted(config());
    bench.enable(1);
    let start = bench.read("646000");
    bench.write("7A6000", i64::from(start + 3000), 4);
    bench.write("406000", 0x1F, 2);
    let word = bench.statusword();
    assert_eq!(word & 0x1400, 0x1000, "acknowledged, not reached: {word:#06x}");
    // Another set-point waits behind the first. Its acknowledge bit stays set until there is room again.
    bench.write("406000", 0x0F, 2);
    assert_eq!(bench.statusword() & 0x1000, 0);
    bench.write("7A6000", 1000, 4);
    bench.write("406000", 0x5F, 2);
    bench.write("406000", 0x4F, 2);
    assert_eq!(bench.statusword() & 0x1000, 0x1000);
    bench.run(1000);
    assert_eq!(bench.statusword() & 0x1400, 0x0400);
    let reached = bench.read("646000");
    assert!((reached - start - 4000).abs() <= 5, "{}", reached - start);
}

#[test]
fn cyclic_velocity_and_torque_go_straight_to_their_loops() {
    let mut bench = Bench::booted(config());
    bench.enable(9);
    assert_eq!(bench.statusword() & 0x1000, 0x1000, "follows");
    bench.write("FF6000", 150, 4);
    bench.write("B16000", -50, 4);
    bench.run(300);
    assert!((bench.read("6C6000") - 100).abs() <= 3);
    bench.write("606000", 10, 1);
    bench.write("716000", -50, 2);
    bench.write("B26000", 30, 2);
    bench.run(5);
    assert_eq!(bench.read("776000") as i16, -20);
    bench.run(100);
    assert!(bench.read("6C6000") < 100);
}

#[test]
fn a_cyclic_drive_enabled_without_a_set_point_jumps_to_its_old_one() {
    let mut bench = Bench::booted(config());
    bench.write("986000", 37, 1);
    bench.write("B03000", 50_000, 4);
    bench.enable(6);
    bench.write("406000", 0x1F, 2);
    bench.run(10);
    bench.write("406000", 0x06, 2);
    bench.enable(8);
    bench.say("000#0102");
    let heard = bench.say("080#");
    assert_eq!(heard.first().unwrap(), "082#1186810000000000");
}

#[test]
fn a_command_repeated_each_cycle_brakes_as_one_given_once() {
    let mut bench = Bench::booted(config());
    bench.write("846000", 500, 4);
    bench.write("021402", 1, 1);
    bench.enable(3);
    bench.write("FF6000", 100, 4);
    bench.run(300);
    bench.say("000#0102");
    for cycle in 0..102 {
        let batch = [parse("080#"), parse("202#0700")];
        bench.port.send(bench.now, &batch).unwrap();
        bench.run(2);
        if cycle == 50 {
            let halfway = bench.read("6B6000");
            assert!((40..=60).contains(&halfway), "{halfway}");
        }
    }
    assert_eq!(bench.statusword() & 0x6F, 0x23);
}

#[test]
fn a_change_of_mode_does_not_keep_a_fault_from_its_end() {
    let mut bench = Bench::booted(config());
    bench.write("846000", 500, 4);
    bench.write("5E6000", 1, 2);
    bench.write("076000", 1, 2);
    bench.write("161001", 127 << 16 | 20, 4);
    bench.enable(3);
    bench.write("FF6000", 100, 4);
    bench.run(300);
    bench.say("77F#05");
    bench.run(50);
    assert_eq!(bench.statusword() & 0x4F, 0x0F, "reacting");
    bench.write("606000", 8, 1);
    bench.run(300);
    assert_eq!(bench.statusword() & 0x4F, 0x08);
}

#[test]
fn enabling_again_ends_the_braking() {
    let mut bench = Bench::booted(config());
    bench.write("846000", 500, 4);
    bench.enable(3);
    bench.write("FF6000", 100, 4);
    bench.run(300);
    bench.write("406000", 0x07, 2);
    bench.run(50);
    bench.write("406000", 0x0F, 2);
    bench.run(300);
    assert_eq!(bench.statusword() & 0x6F, 0x27);
    assert!((bench.read("6C6000") - 100).abs() <= 3);
}

#[test]
fn stopping_or_resetting_a_node_in_motion_stops_its_axis() {
    for (command, state) in [("000#0202", 0x07), ("000#8102", 0x40), ("000#8202", 0x07)] {
        let mut bench = Bench::booted(config());
        bench.enable(3);
        bench.write("FF6000", 100, 4);
        bench.run(200);
        bench.say(command);
        bench.run(1000);
        bench.say("000#8002");
        assert!(bench.read("6C6000").abs() <= 1, "{command}");
        assert_eq!(bench.statusword() & 0x6F, state, "{command}");
    }
}

#[test]
fn a_limit_switch_is_a_fault_from_which_one_can_drive_away() {
    let mut axis = AxisConfig::wut(Irp6Axis::ALL[0]);
    axis.positive_limit = Some(crate::plant::Switch { from: axis.start_angle + 3.0, to: f64::INFINITY, bounce: 0 });
    let mut bench = Bench::booted(Epos4Config { axis, ..Epos4Config::new(NodeId::new(2).unwrap(), axis) });
    bench.enable(3);
    bench.write("FF6000", 100, 4);
    assert_eq!(bench.run(1000), ["082#818A810000000000"]);
    assert_eq!(bench.statusword() & 0x6F, 0x08);
    assert_eq!(bench.read("FD6000"), 0b10);
    bench.write("FF6000", -100, 4);
    bench.say("602#2B40600080000000");
    bench.enable(3);
    assert_eq!(bench.run(1000), [""; 0]);
    assert_eq!(bench.read("FD6000"), 0);
}

#[test]
fn homing_sets_the_counter_and_the_referenced_bit() {
    let mut bench = Bench::booted(config());
    bench.write("986000", 11, 1);
    bench.write("996001", 200, 4);
    bench.write("996002", 60, 4);
    bench.write("B03000", 500, 4);
    bench.enable(6);
    assert_eq!(bench.statusword() & 0xB400, 0x0400, "not started");
    bench.write("406000", 0x1F, 2);
    assert_eq!(bench.statusword() & 0xB400, 0, "in progress");
    bench.run(5000);
    let word = bench.statusword();
    assert_eq!(word & 0xB400, 0x9400, "done: {word:#06x}");
    assert!((bench.read("646000") - 500).abs() <= 2, "{}", bench.read("646000"));
    // Leaving homing mode keeps the reference. A reset of the node clears the reference.
    bench.write("606000", 8, 1);
    assert_eq!(bench.statusword() & 0x8000, 0x8000);
    bench.say("000#8102");
    bench.run(60);
    assert_eq!(bench.statusword() & 0x8000, 0);
    assert_eq!(bench.read("646000"), 0);
}

#[test]
fn each_axis_of_an_irp6_is_homed_to_its_index() {
    for which in Irp6Axis::ALL {
        let axis = AxisConfig::irp6(which);
        let mut bench = Bench::booted(Epos4Config { axis, ..Epos4Config::new(NodeId::new(2).unwrap(), axis) });
        bench.write("986000", 11, 1);
        bench.write("996001", 143, 4);
        bench.write("996002", 33, 4);
        bench.enable(6);
        bench.write("406000", 0x1F, 2);
        bench.run(10_000);
        let word = bench.statusword();
        assert_eq!(word & 0xB400, 0x9400, "{which:?}: {word:#06x}");
        let counts = f64::from(bench.read("646000"));
        let device: &Epos4 = bench.world.device(bench.device).unwrap();
        let count = std::f64::consts::TAU / f64::from(axis.counts_per_revolution);
        let angle = (device.axis().angle() - axis.index_angle) / count;
        assert!((counts - angle).abs() <= 1.5, "{which:?}: {counts} at {angle}");
        assert!(counts.abs() <= 5.0, "{which:?} rests at {counts}");
    }
}

#[test]
fn a_search_that_failed_and_is_halted_shows_that_it_stands() {
    let axis = AxisConfig { home_switch: None, ..config().axis };
    let mut bench = Bench::booted(Epos4Config { axis, ..config() });
    bench.write("986000", 7, 1);
    bench.write("996001", 500, 4);
    bench.enable(6);
    bench.write("406000", 0x1F, 2);
    bench.run(60_000);
    assert_eq!(homing_bits(&mut bench) & 0x2000, 0x2000, "the search ends at a limit switch");
    bench.write("406000", 0x010F, 2);
    bench.run(1000);
    assert_eq!(homing_bits(&mut bench), 0x2400);
}

/// Bits 15, 13, 12 and 10 of the statusword.
fn homing_bits(bench: &mut Bench) -> u16 {
    bench.statusword() & 0xB400
}

#[test]
fn an_old_result_shows_until_its_time_after_the_start_bit() {
    let homing = HomingDeviation { old_result: Some(Duration::from_millis(40)), ..HomingDeviation::default() };
    let mut bench = Bench::booted(Epos4Config { homing, ..config() });
    bench.write("986000", 34, 1);
    bench.write("996002", 60, 4);
    bench.enable(6);
    assert_eq!(homing_bits(&mut bench), 0x0400, "no result before the first search");
    bench.write("406000", 0x1F, 2);
    assert_eq!(homing_bits(&mut bench), 0, "no old result");
    bench.run(10_000);
    assert_eq!(homing_bits(&mut bench), 0x9400);
    // The result outlives the mode and the power.
    bench.write("406000", 0x06, 2);
    bench.enable(8);
    bench.write("606000", 6, 1);
    assert_eq!(homing_bits(&mut bench), 0x9400);
    bench.write("406000", 0x1F, 2);
    bench.run(10);
    assert_eq!(homing_bits(&mut bench), 0x1400, "the old result");
    bench.run(40);
    assert_eq!(homing_bits(&mut bench), 0, "the new search");
}

#[test]
fn a_drive_that_never_searches_moves_nothing() {
    let homing = HomingDeviation { never_searches: true, ..HomingDeviation::default() };
    let mut bench = Bench::booted(Epos4Config { homing, ..config() });
    bench.write("986000", 34, 1);
    bench.enable(6);
    let before = bench.read("646000");
    bench.write("406000", 0x1F, 2);
    bench.run(1_000);
    assert_eq!(homing_bits(&mut bench), 0x0400);
    assert!((bench.read("646000") - before).abs() <= 1);
}

#[test]
fn a_counter_may_show_later_than_the_success() {
    let homing = HomingDeviation { counter_late: Duration::from_millis(30), ..HomingDeviation::default() };
    let mut bench = Bench::booted(Epos4Config { homing, ..config() });
    bench.write("986000", 37, 1);
    bench.write("B03000", -1234, 4);
    bench.enable(6);
    bench.write("406000", 0x1F, 2);
    assert_eq!(homing_bits(&mut bench), 0x9400);
    assert!(bench.read("646000").abs() <= 1);
    bench.run(30);
    assert!((bench.read("646000") + 1234).abs() <= 1);
}

#[test]
fn homing_in_place_moves_nothing() {
    let mut bench = Bench::booted(config());
    bench.write("986000", 37, 1);
    bench.write("B03000", -1234, 4);
    bench.enable(6);
    bench.write("406000", 0x1F, 2);
    bench.run(10);
    assert_eq!(bench.statusword() & 0xB400, 0x9400);
    let position = bench.read("646000");
    assert!((position + 1234).abs() <= 1, "{position}");
}

#[test]
fn software_limits_hold_once_the_position_is_referenced() {
    let mut bench = Bench::booted(config());
    bench.write("986000", 37, 1);
    bench.write("7D6001", -1000, 4);
    bench.write("7D6002", 1000, 4);
    bench.enable(6);
    bench.write("406000", 0x1F, 2);
    bench.run(10);
    bench.write("406000", 0x0F, 2);
    bench.write("606000", 1, 1);
    bench.write("7A6000", 1001, 4);
    let answers = bench.say("602#2B4060001F000000");
    assert!(answers.contains(&"082#828A810000000000".to_owned()), "{answers:?}");
}

#[test]
fn the_same_input_gives_the_same_frames_at_the_same_times() {
    let run = || {
        let mut bench = Bench::booted(config());
        bench.cyclic();
        let start = bench.read("646000");
        let mut all = Vec::new();
        for cycle in 0..500_i32 {
            let bytes: String =
                (start + cycle * cycle / 50).to_le_bytes().iter().map(|byte| format!("{byte:02X}")).collect();
            let batch = [parse("080#"), parse(&format!("402#0F00{bytes}"))];
            bench.port.send(bench.now, &batch).unwrap();
            all.extend(bench.run_micros(2000));
        }
        all
    };
    let first = run();
    assert_eq!(first.len(), 500);
    assert!(first == run());
}

#[test]
fn payload_handed_over_in_a_world_is_felt_by_the_drive_that_holds_it() {
    let mut axis = AxisConfig::irp6(Irp6Axis::UpperArm);
    axis.start_angle = axis.index_angle;
    let mechanism = crate::Mechanism::new(crate::MechanismConfig::Irp6);
    let mut bench = Bench::booted(Epos4Config { axis, mount: mechanism.mount(2, axis.index_angle), ..config() });
    bench.enable(1);
    let mut held = |mass: f64| {
        mechanism.set_payload(mass, [0.0; 3]);
        bench.run(500);
        let drive: &Epos4 = bench.world.device(bench.device).unwrap();
        drive.axis().feedback().torque
    };
    // 20 kg at the 0.67 m of the arm, behind a ratio of 175.1. Stiction takes up to 0.12 N·m in either direction.
    let more = held(20.0) - held(0.0);
    let weight = -9.81 * 20.0 * 0.67 / 175.1;
    assert!((more - weight).abs() < 0.24, "{more} N·m for {weight}");
}
