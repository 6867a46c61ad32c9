//! The cycle, frame by frame.

use std::f64::consts::TAU;
use std::time::Duration;

use super::bench::*;
use crate::cia402::*;
use crate::{Finite, Homing, Power, Refusal, Setpoint};

#[test]
fn an_epos_is_enabled_word_by_word_with_the_target_where_it_stands() {
    let mut bench = Bench::up(&[2]);
    // The statuswords and controlwords of a recorded EPOS.
    let trace = [
        ("182#4007E80300000000", "202#0600E8030000", Power::Changing),
        ("182#4007E80300000000", "202#0600E8030000", Power::Changing),
        ("182#2107E90300000000", "202#0700E9030000", Power::Changing),
        ("182#2107E90300000000", "202#0700E9030000", Power::Changing),
        ("182#2307E90300000000", "202#0F00E9030000", Power::Changing),
        ("182#2307EA0300000000", "202#0F00EA030000", Power::Changing),
        ("182#3707EB0300000000", "202#0F00EB030000", Power::On),
        // The drive holds that position, even if a load moves the axis.
        ("182#3707E00300000000", "202#0F00EB030000", Power::On),
        ("182#3707D00300000000", "202#0F00EB030000", Power::On),
    ];
    for (i, (received, sent, power)) in trace.into_iter().enumerate() {
        let frames = bench.cycle(&[received], &[AxisCommand::Stand]);
        assert_eq!((i, &*frames[0], &*frames[1]), (i, "080#", sent));
        // Before the first command no transition is under way.
        let power = if i == 0 { Power::Off } else { power };
        assert_eq!((i, bench.states[0].power), (i, power));
        assert_eq!(bench.states[0].following, power == Power::On);
        assert_eq!(bench.states[0].fault, None);
    }
}

#[test]
fn a_cycle_is_one_sync_and_then_one_rpdo_per_axis() {
    let mut bench = Bench::up(&[3, 1, 2]);
    let first = bench.cycle(NONE, &[AxisCommand::Off; 3]);
    let rpdos = ["203#0000E8030000", "201#0000E8030000", "202#0000E8030000"];
    assert_eq!(first, ["080#", rpdos[0], rpdos[1], rpdos[2], "77F#05"]);
    for _ in 0..3 {
        let frames = bench.cycle(&bench.answers(0x0740, 1_000), &[AxisCommand::Off; 3]);
        assert_eq!(frames, ["080#", rpdos[0], rpdos[1], rpdos[2]]);
    }
}

#[test]
fn a_torque_at_the_rated_one_or_at_a_limit_that_the_drive_reports_is_at_its_limit() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    // Statusword with and without bit 11, and thousandths of the rated torque of 0.1 N·m.
    for (answer, expected) in [
        ("182#3707D0070000F401", None),
        ("182#370FD0070000F401", Some(0.05)),
        ("182#370FD00700002C01", None),
        ("182#3707D007000018FC", Some(-0.1)),
    ] {
        bench.cycle(&[answer], &[follow(2_001.0)]);
        let found = bench.states[0].torque_at_limit();
        assert_eq!(found.map(|(torque, _)| (torque * 1e3).round() / 1e3), expected, "{answer}");
        assert!(found.is_none_or(|(_, limit)| (limit - 0.1).abs() < 1e-12));
    }
}

#[test]
fn set_points_go_out_as_increments_and_answers_come_in_as_radians() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    let frames = bench.cycle(&["182#3707D0070000F401"], &[follow(2_001.0)]);
    assert_eq!(frames[1], "202#0F00D1070000");
    let state = bench.states[0];
    assert_eq!((state.increments.0, state.age), (2_000, 0));
    assert_eq!(state.at, bench.now - PERIOD / 2);
    assert!((state.position - TAU).abs() < 1e-12);
    assert!((state.torque - 0.05).abs() < 1e-12);
    // 1000 increments, half a turn, in 2 ms.
    assert!((state.velocity - TAU / 2.0 / 0.002).abs() < 1e-9);
    assert_eq!(state.homing, Homing::NotHomed);
}

#[test]
fn velocity_spans_the_syncs_that_were_answered() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    bench.cycle(NONE, &[AxisCommand::Stand]);
    bench.cycle(NONE, &[AxisCommand::Stand]);
    bench.cycle(&[answer(2, 0x0737, 1_030)], &[AxisCommand::Stand]);
    let expected = 30.0 / 2_000.0 * TAU / 0.006;
    assert!((bench.states[0].velocity - expected).abs() < 1e-9);
}

#[test]
fn an_answer_that_is_late_belongs_to_the_sync_before() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    bench.cycle(NONE, &[AxisCommand::Stand]);
    let sync = bench.now;
    let late = [(sync - PERIOD / 4, 1_010), (sync + PERIOD / 2, 1_020)];
    for (at, position) in late {
        let frame = frame(&answer(2, 0x0737, position));
        bench.bus.0.lock().unwrap().inbox.push_back(Received { frame, at });
    }
    bench.cycle(NONE, &[AxisCommand::Stand]);
    let expected = 10.0 / 2_000.0 * TAU / 0.002;
    assert!((bench.states[0].velocity - expected).abs() < 1e-9);
    assert_eq!(bench.group.counters().last_bus_time, PERIOD / 2);
}

#[test]
fn the_last_set_point_is_held_when_following_ends() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    bench.cycle(&bench.answers(0x0737, 1_000), &[follow(1_010.0)]);
    let frames = bench.cycle(&bench.answers(0x0737, 1_005), &[AxisCommand::Stand]);
    assert_eq!(frames[1], "202#0F00F2030000");
}

#[test]
fn velocity_and_torque_go_out_in_the_drives_units_and_rest_at_zero() {
    let finite = |value| Finite::new(value).unwrap();
    let table = [
        (CyclicMode::Csv, Setpoint::Velocity(finite(-TAU)), "202#0F00C4FFFFFF", "202#0F0000000000"),
        (
            CyclicMode::CspWithTorque,
            Setpoint::PositionWithTorque { position: finite(TAU / 2.0), torque: finite(-0.05) },
            "202#0F00E80300000CFE",
            "202#0F00E80300000000",
        ),
        (CyclicMode::Cst, Setpoint::Torque(finite(0.05)), "202#0F00F401", "202#0F000000"),
    ];
    for (mode, setpoint, following, standing) in table {
        let mut bench = Bench::up_with(group_config(), &[AxisConfig { mode, ..axis_config(2) }]);
        bench.enable();
        let command = AxisCommand::Follow(setpoint);
        let answers = bench.answers(0x0737, 1_000);
        assert_eq!(bench.cycle(&answers, &[AxisCommand::Stand])[1], standing);
        assert_eq!(bench.cycle(&answers, &[command])[1], following);
        assert_eq!(bench.cycle(&answers, &[AxisCommand::Stand])[1], standing);
    }
}

#[test]
fn one_refused_set_point_keeps_every_axis_where_it_was_told_before() {
    let finite = |value| Finite::new(value).unwrap();
    let velocity = AxisCommand::Follow(Setpoint::Velocity(finite(0.0)));
    let far = AxisCommand::Follow(Setpoint::Position(finite(1e9)));
    // Drives on CAN search for the reference by themselves.
    let seek = AxisCommand::Seek(Setpoint::Position(finite(0.0)));
    let node = 2;
    let table = [(velocity, Refusal::WrongKind), (seek, Refusal::WrongKind), (far, Refusal::OutOfRange)];
    for (command, refusal) in table {
        let mut bench = Bench::up(&[1, node]);
        bench.enable();
        let answers = bench.answers(0x0737, 1_000);
        bench.cycle(&answers, &[follow(1_001.0), follow(1_002.0)]);
        let frames = bench.cycle(&answers, &[follow(1_500.0), command]);
        assert_eq!(frames[1..], ["201#0F00E9030000", "202#0200E8030000"]);
        // The other axis follows its command; the refused axis is braked, and its set-point is ignored.
        let frames = bench.cycle(&answers, &[follow(1_003.0), command]);
        assert_eq!(frames[1..], ["201#0F00EB030000", "202#0200E8030000"]);
        assert_eq!(bench.states[0].fault, None);
        assert_eq!(bench.states[1].fault, Some(Fault::Refused { node, refusal }));
        assert!(!bench.states[1].following);
    }
}

#[test]
fn a_set_point_for_a_drive_without_torque_is_refused() {
    let mut bench = Bench::up(&[2]);
    let answers = bench.answers(0x0740, 1_000);
    bench.cycle(&answers, &[AxisCommand::Off]);
    assert_eq!(bench.cycle(&answers, &[follow(5.0)])[1], "202#0000E8030000");
    bench.cycle(&answers, &[AxisCommand::Off]);
    let fault = Fault::Refused { node: 2, refusal: Refusal::NotOn };
    assert_eq!(bench.states[0].fault, Some(fault));
}

#[test]
fn numbers_that_are_none_cannot_be_commanded() {
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert_eq!(Finite::new(value), None);
    }
}

#[test]
fn what_the_port_does_not_take_is_counted_and_never_sent_later() {
    let mut bench = Bench::up(&[1, 2]);
    bench.enable();
    let answers = bench.answers(0x0737, 1_000);
    bench.bus.0.lock().unwrap().takes = Some(2);
    let frames = bench.cycle(&answers, &[follow(1_001.0), follow(1_001.0)]);
    assert_eq!(frames, ["080#", "201#0F00E9030000"]);
    assert_eq!(bench.group.counters().dropped_setpoints, 1);
    bench.bus.0.lock().unwrap().takes = Some(0);
    assert_eq!(bench.cycle(&answers, &[follow(1_002.0), follow(1_002.0)]), NONE);
    assert_eq!(bench.group.counters().dropped_setpoints, 3);
    assert_eq!(bench.group.counters().dropped_syncs, 1);
    bench.bus.0.lock().unwrap().takes = None;
    let frames = bench.cycle(NONE, &[follow(1_003.0), follow(1_003.0)]);
    assert_eq!(frames, ["080#", "201#0F00EB030000", "202#0F00EB030000"]);
    // No SYNC requested the missing answers.
    assert_eq!(bench.group.counters().missed_answers, 0);
    assert_eq!(bench.states[0].age, 1);
}

#[test]
fn only_a_cycle_that_asked_misses_an_answer() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    bench.cycle(&bench.answers(0x0737, 1_000), &[AxisCommand::Stand]);
    for age in [1, 1, 1] {
        bench.group.read(bench.now, &mut bench.states);
        assert_eq!(bench.states[0].age, age);
    }
    assert_eq!(bench.group.counters().missed_answers, 1);
}

#[test]
fn a_batch_that_was_not_sent_is_replaced() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    bench.group.write(bench.now, &[follow(1_001.0)]);
    let frames = bench.cycle(&bench.answers(0x0737, 1_000), &[follow(1_002.0)]);
    assert_eq!(frames, ["080#", "202#0F00EA030000"]);
}

#[test]
fn our_heartbeat_is_sent_each_period_and_offered_again_if_not_taken() {
    let config = GroupConfig { heartbeat_period: Duration::from_millis(10), ..group_config() };
    let mut bench = Bench::up_with(config, &[axis_config(2)]);
    let mut beats = Vec::new();
    for i in 0..12 {
        bench.bus.0.lock().unwrap().takes = (i == 5).then_some(2);
        let answers = [answer(2, 0x0740, 0), "702#05".into()];
        let frames = bench.cycle(&answers, &[AxisCommand::Off]);
        if frames.last().unwrap() == "77F#05" {
            beats.push(i);
        }
    }
    assert_eq!(beats, [0, 6, 11]);
}

#[test]
fn frames_of_nobody_here_are_counted() {
    let mut bench = Bench::up(&[2]);
    bench.cycle(NONE, &[AxisCommand::Off]);
    let strange = ["183#4007E80300000000", "182#4007", "282#0000", "382#00", "000#0102", "7E5#04"];
    bench.cycle(&strange, &[AxisCommand::Off]);
    assert_eq!(bench.group.counters().unexpected, strange.len() as u64);
}

#[test]
fn answers_behind_more_foreign_frames_than_a_cycle_has_of_its_own_are_read_in_their_cycle() {
    let config = GroupConfig { period: Duration::from_millis(10), ..group_config() };
    let mut bench = Bench::up_with(config, &[axis_config(2)]);
    bench.enable();
    for position in 0..20 {
        let mut frames = vec!["17F#5555555555555555".to_owned(); 80];
        frames.extend(bench.answers(0x0737, position));
        bench.cycle(&frames, &[AxisCommand::Stand]);
        assert_eq!(bench.states[0].increments.0, position);
        assert_eq!((bench.states[0].age, bench.states[0].fault), (0, None));
    }
}

#[test]
fn traffic_lists_every_frame_of_a_cycle() {
    let config = group_config();
    let axes = [axis_config(1), AxisConfig { mode: CyclicMode::Cst, ..axis_config(2) }];
    let traffic = traffic(&config, &axes, &[], &[]);
    let frames: Vec<(u16, u8, u64)> =
        traffic.iter().map(|frame| (frame.cob_id.raw(), frame.bytes, frame.period.as_millis() as u64)).collect();
    let expected = [
        (0x080, 0, 2),
        (0x77F, 1, 2_000),
        (0x201, 6, 2),
        (0x181, 8, 2),
        (0x281, 1, 100),
        (0x701, 1, 2_000),
        (0x202, 4, 2),
        (0x182, 8, 2),
        (0x282, 1, 100),
        (0x702, 1, 2_000),
        (0x601, 8, 2),
        (0x581, 8, 2),
    ];
    assert_eq!(frames, expected);
}
