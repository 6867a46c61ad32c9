//! Bring-up, frame by frame.

use std::task::Poll;
use std::time::Duration;

use can::{Instant, PortError, Received};
use canopen::Object;

use super::bench::*;
use crate::cia402::*;
use crate::{Homing, Power};

/// Writes to node 2, in order. Each write is read back before the next.
const TOLD: &[&str] = &[
    // Voltage off, then the cell's own parameter.
    "602#2B40600000000000",
    "602#23013001D0070000",
    // The drive watches the host's heartbeat and produces its own.
    "602#2B171000D0070000",
    "602#2316100170177F00",
    // On loss of the host, the drive brakes at 6000 rpm/s and holds.
    "602#2B07600003000000",
    "602#2B5A600006000000",
    "602#2385600070170000",
    // 2 times 10^-3 s.
    "602#2FC2600102000000",
    "602#2FC26002FD000000",
    // Following error 1000 increments; homing by method 37, 60 rpm, 10 rpm, 600 rpm/s.
    "602#23656000E8030000",
    "602#2F98600025000000",
    "602#239960013C000000",
    "602#239960020A000000",
    "602#239A600058020000",
    // The homed counter reads zero, without a motion away from the reference.
    "602#23B0300000000000",
    "602#23B1300000000000",
    // RPDO 2 to 4, and TPDO 3 and 4, are switched off.
    "602#2301140102030080",
    "602#2302140102040080",
    "602#2303140102050080",
    "602#23021801820300C0",
    "602#23031801820400C0",
    // RPDO 1: controlword and target position, at every SYNC, without a deadline.
    "602#2300140102020080",
    "602#2F00160000000000",
    "602#2300160110004060",
    "602#2300160220007A60",
    "602#2F00160002000000",
    "602#2F00140201000000",
    "602#2B00140570170000",
    "602#2300140102020000",
    // TPDO 1: statusword, position, torque, at every SYNC, not inhibited.
    "602#23001801820100C0",
    "602#2F001A0000000000",
    "602#23001A0110004160",
    "602#23001A0220006460",
    "602#23001A0310007760",
    "602#2F001A0003000000",
    "602#2F00180201000000",
    "602#2B00180300000000",
    "602#2300180182010040",
    // TPDO 2: mode of operation, sent on change, at least 100 ms apart.
    "602#23011801820200C0",
    "602#2F011A0000000000",
    "602#23011A0108006160",
    "602#2F011A0001000000",
    "602#2F011802FF000000",
    "602#2B011803E8030000",
    "602#2B01180500000000",
    "602#2301180182020040",
    // CSP.
    "602#2F60600008000000",
];

#[test]
fn an_epos4_is_asked_and_told_this_frame_by_frame() {
    let mut bench = Bench::new(group_config(), &[axis_config(2)]);
    assert_eq!(bench.bring_up(), Ok(()));
    let mut expected = vec!["000#8202".to_owned()];
    // Device type, vendor, product, supported modes.
    for object in ["001000", "181001", "181002", "026500"] {
        expected.push(format!("602#40{object}00000000"));
    }
    for told in TOLD {
        expected.push((*told).to_owned());
        expected.push(format!("602#40{}00000000", &told[6..12]));
        if told.starts_with("602#230130") {
            // Limits of the ramps, which this store lacks.
            expected.extend(["C56000", "C66000"].map(|object| format!("602#40{object}00000000")));
        }
        if told.starts_with("602#239A60") {
            // Objects after the reaction to a lost connection, which this store lacks. An EPOS4 lacks the home offset.
            for lacking in [
                "2F29100100000000",
                "4029100100000000",
                "2B5B600001000000",
                "2B5C600001000000",
                "2B5D600001000000",
                "2B5E600000000000",
                "2B66600000000000",
                "237B600100000000",
                "237B600200000000",
                "2F7E600000000000",
                "2384600070170000",
                "2B86600000000000",
                "23B0600000000000",
                "23B1600000000000",
                "2BB2600000000000",
                "237C600000000000",
            ] {
                expected.push(format!("602#{lacking}"));
            }
        }
        if told.starts_with("602#23B13000") {
            // Objects that must agree with the cell, none of which this store has: gear, feed, encoder, main sensor,
            // rated torque.
            for object in ["916001", "916002", "926001", "926002", "8F6001", "8F6002", "003005", "766000"] {
                expected.push(format!("602#40{object}00000000"));
            }
        }
    }
    // Mode shown, statusword, position, error code.
    for object in ["616000", "416000", "646000", "3F6000"] {
        expected.push(format!("602#40{object}00000000"));
    }
    // The start, and a SYNC that stands alone.
    expected.extend(["000#0102", "080#"].map(str::to_owned));
    assert_eq!(sent(&bench), expected);
}

#[test]
fn velocity_and_torque_drives_get_their_own_target() {
    let table = [
        (CyclicMode::Csv, "602#230016022000FF60", "602#2F60600009000000"),
        (CyclicMode::CspWithTorque, "602#230016031000B260", "602#2F60600008000000"),
        (CyclicMode::Cst, "602#2300160210007160", "602#2F6060000A000000"),
    ];
    for (mode, mapped, told) in table {
        let mut bench = Bench::new(group_config(), &[AxisConfig { mode, ..axis_config(2) }]);
        assert_eq!(bench.bring_up(), Ok(()));
        let sent = sent(&bench);
        assert!(sent.iter().any(|frame| frame == mapped));
        assert!(sent.iter().any(|frame| frame == told));
    }
}

#[test]
fn after_it_nothing_is_enabled_and_the_position_is_known() {
    let mut bench = Bench::new(group_config(), &[axis_config(2)]);
    bench.stores[0].put(0x6041, 0, &[0x40, 0x86]);
    assert_eq!(bench.bring_up(), Ok(()));
    let up = bench.now;
    assert_eq!(bench.cycle(NONE, &[AxisCommand::Off])[1], "202#0000E8030000");
    let state = bench.states[0];
    assert_eq!((state.power, state.fault, state.increments.0), (Power::Off, None, 1_000));
    assert_eq!(state.at, up, "the end of bring-up counts as the last answer");
    // Bit 15: the drive kept its reference.
    assert_eq!(state.homing, Homing::Attained);
}

#[test]
fn a_drive_in_fault_comes_up_with_the_fault_latched() {
    let mut bench = Bench::new(group_config(), &[axis_config(2)]);
    bench.stores[0].put(0x6041, 0, &[0x08, 0x02]);
    bench.stores[0].put(0x603F, 0, &[0x20, 0x73]);
    assert_eq!(bench.bring_up(), Ok(()));
    bench.cycle(NONE, &[AxisCommand::Off]);
    assert_eq!(bench.states[0].fault, Some(Fault::Drive { node: 2, code: 0x7320 }));
}

#[test]
fn offsets_that_a_host_before_left_are_taken_away_in_every_mode() {
    for mode in [CyclicMode::Csp, CyclicMode::CspWithTorque, CyclicMode::Csv, CyclicMode::Cst] {
        let mut axis = axis_config(2);
        axis.mode = mode;
        let mut bench = Bench::new(group_config(), &[axis]);
        let offsets = [(0x60B0, 4), (0x60B1, 4), (0x60B2, 2)];
        for (index, size) in offsets {
            bench.stores[0].put(index, 0, &[1; 4][..size]);
        }
        assert_eq!(bench.bring_up(), Ok(()));
        for (index, size) in offsets {
            let left = &bench.stores[0].objects[&(index, 0)];
            assert_eq!(left[..], [0; 4][..size], "{mode:?} {index:#x}");
        }
    }
}

#[test]
fn a_node_that_does_not_announce_its_boot_is_found_by_asking() {
    let mut bench = Bench::new(group_config(), &[axis_config(2)]);
    bench.stores[0].boots = false;
    assert_eq!(bench.bring_up(), Ok(()));
}

#[test]
fn a_node_that_boots_again_is_configured_again_and_not_for_ever() {
    for (boots, result) in [(1, Ok(())), (9, Err(()))] {
        let mut bench = Bench::new(group_config(), &[axis_config(2)]);
        let mut calls = 0;
        let ended = loop {
            if let Poll::Ready(ended) = bench.group.bring_up(bench.now) {
                break ended;
            }
            bench.answer_syncs();
            bench.serve();
            bench.now += PERIOD;
            calls += u32::from(sent(&bench) != NONE);
            if calls > 0 && calls % 20 == 0 && calls / 20 <= boots {
                let booted = Received { frame: frame("702#00"), at: bench.now };
                bench.bus.0.lock().unwrap().inbox.push_back(booted);
            }
        };
        assert_eq!(ended.map_err(|_| ()), result);
        assert!(matches!(ended, Ok(()) | Err(BringUpError::NeverBooted { node: 2, .. })));
        let vendor = sent(&bench).iter().filter(|frame| **frame == "602#4018100100000000").count();
        assert_eq!(vendor, if boots == 1 { 2 } else { 4 });
    }
}

#[test]
fn drives_come_up_side_by_side_with_few_frames_a_call() {
    let time = |nodes: u8, takes| {
        let axes: Vec<AxisConfig> = (1..=nodes).map(axis_config).collect();
        let mut bench = Bench::new(group_config(), &axes);
        bench.bus.0.lock().unwrap().takes = takes;
        let mut most = 0;
        loop {
            let before = sent(&bench).len();
            let ended = bench.group.bring_up(bench.now);
            let sdo = sent(&bench)[before..].iter().filter(|frame| frame.starts_with('6')).count();
            most = most.max(sdo);
            if ended.is_ready() {
                assert_eq!(ended, Poll::Ready(Ok(())));
                return (bench.now.as_nanos() / PERIOD.as_nanos() as u64, most);
            }
            bench.answer_syncs();
            bench.serve();
            bench.now += PERIOD;
        }
    };
    assert_eq!(time(1, None).1, 1);
    assert_eq!((time(6, None).0, time(6, None).1), (time(1, None).0, 6));
    assert_eq!(time(12, None).1, 8);
    // A port that takes one frame at a time loses no frame.
    assert_eq!(time(2, Some(1)).1, 1);
}

#[test]
fn a_mode_that_is_not_supported_is_named() {
    let error = BringUpError::ModeUnsupported { node: 2, mode: 8, supported: 0x325 };
    let told = "node 2: mode 8 (cyclic synchronous position) is not supported (0x6502 is 0x00000325)";
    assert_eq!(error.to_string(), told);
}

#[test]
fn a_drive_that_sends_no_heartbeat_is_not_said_to_be_in_another_state() {
    let error = BringUpError::NotOperational { node: 2, waited: Duration::from_millis(1500) };
    assert_eq!(error.to_string(), "node 2: no heartbeat showed the state operational, waited 1.5s");
}

#[test]
fn every_failure_names_the_node_and_what_it_said() {
    type Break = fn(&mut Store);
    let node = 2;
    let table: &[(Break, BringUpError)] = &[
        (
            |store| (store.boots, store.mute) = (false, Some((0x1000, 0))),
            BringUpError::NeverBooted { node, waited: Duration::from_millis(1_002) },
        ),
        (
            |store| store.put(0x1000, 0, &[0x91, 0x01, 0x0F, 0x00]),
            BringUpError::NotADrive { node, device_type: 0x000F_0191 },
        ),
        (
            |store| store.put(0x1018, 1, &[0xFC, 0, 0, 0]),
            BringUpError::WrongIdentity { node, subindex: 1, expected: 0xFB, found: 0xFC },
        ),
        (
            |store| store.put(0x1018, 2, &[0, 0, 0x50, 0x61]),
            BringUpError::WrongIdentity { node, subindex: 2, expected: 0x6050_0000, found: 0x6150_0000 },
        ),
        (
            |store| store.put(0x6502, 0, &[0x25, 0x03, 0, 0]),
            BringUpError::ModeUnsupported { node, mode: 8, supported: 0x325 },
        ),
        (
            |store| store.put(0x6502, 0, &[0x85, 0x03, 0, 0]),
            BringUpError::ModeUnsupported { node, mode: 6, supported: 0x385 },
        ),
        (
            |store| store.put(0x1018, 1, &[0xFB, 0]),
            BringUpError::Aborted { node, object: Object::new(0x1018, 1), code: 0x0607_0010 },
        ),
        (
            |store| _ = store.aborts.insert((0x60C2, 1), 0x0609_0030),
            BringUpError::WriteRefused { node, object: Object::new(0x60C2, 1), written: 2, code: 0x0609_0030 },
        ),
        (
            |store| _ = store.objects.remove(&(0x6007, 0)),
            BringUpError::WriteRefused { node, object: Object::new(0x6007, 0), written: 3, code: 0x0602_0000 },
        ),
        (
            |store| store.forgetful = Some((0x6007, 0)),
            BringUpError::ReadBack { node, object: Object::new(0x6007, 0), written: 3, found: 1 },
        ),
        (
            |store| store.mute = Some((0x6085, 0)),
            // Two requests, 100 ms each.
            BringUpError::TimedOut { node, object: Object::new(0x6085, 0), waited: Duration::from_millis(200) },
        ),
        (|store| store.starts = false, BringUpError::NotOperational { node, waited: Duration::from_millis(3_002) }),
    ];
    for (break_it, error) in table {
        let mut bench = Bench::new(group_config(), &[axis_config(1), axis_config(node)]);
        break_it(&mut bench.stores[1]);
        assert_eq!(bench.bring_up(), Err(*error));
        let sent = sent(&bench);
        let started = matches!(error, BringUpError::NotOperational { .. });
        assert_eq!(sent.iter().any(|frame| frame.starts_with("000#01")), started, "{error}");
        // No RPDO, and no controlword except the one that removes the voltage.
        assert!(sent.iter().all(|frame| frame.starts_with("000") || frame.starts_with('6')));
        assert!(!sent.iter().any(|frame| frame.contains("#2B406000") && !frame.ends_with("00000000")));
        // Once repaired, the group comes up from the start.
        bench.stores[1] = Store::epos4(node);
        assert_eq!(bench.bring_up(), Ok(()), "{error}");
    }
}

#[test]
fn a_mode_that_never_shows_ends_the_wait() {
    let mut bench = Bench::new(group_config(), &[axis_config(2)]);
    bench.stores[0].shows_modes = false;
    let error = BringUpError::ReadBack { node: 2, object: Object::new(0x6061, 0), written: 8, found: 1 };
    assert_eq!(bench.bring_up(), Err(error));
    let waited = bench.now.since(Instant::ZERO + group_config().listening());
    assert!(waited < Duration::from_secs(1));
}

#[test]
fn a_port_that_is_down_fails_it() {
    let mut bench = Bench::new(group_config(), &[axis_config(2)]);
    bench.bus.0.lock().unwrap().error = Some(PortError::Down);
    assert_eq!(bench.bring_up(), Err(BringUpError::Port(PortError::Down)));
}

#[test]
fn configurations_that_cannot_work_are_refused() {
    let ms = Duration::from_millis;
    let with = |change: fn(&mut GroupConfig, &mut Vec<AxisConfig>)| {
        let (mut config, mut axes) = (group_config(), vec![axis_config(1), axis_config(2)]);
        change(&mut config, &mut axes);
        CanBus::new(BusEnd::default(), config, &axes).err()
    };
    let out_of_range = |quantity| Some(ConfigError::OutOfRange { node: 2, quantity });
    assert_eq!(with(|_, _| {}), None);
    assert_eq!(with(|config, _| config.period = Duration::from_micros(2_500)), None);
    let table = [
        (with(|_, axes| axes.clear()), Some(ConfigError::NoNodes)),
        (with(|_, axes| axes[1].node = node(1)), Some(ConfigError::DuplicateNode(1))),
        (with(|config, _| config.host_node = node(2)), Some(ConfigError::DuplicateNode(2))),
        (
            with(|config, _| config.period = Duration::from_micros(1_001)),
            Some(ConfigError::Period(Duration::from_micros(1_001))),
        ),
        (with(|config, _| config.period = Duration::ZERO), Some(ConfigError::Period(Duration::ZERO))),
        (
            with(|config, _| config.heartbeat_period = Duration::from_millis(21_846)),
            Some(ConfigError::HeartbeatPeriod(ms(21_846))),
        ),
        (
            with(|config, _| config.heartbeat_period = Duration::from_micros(1_500)),
            Some(ConfigError::HeartbeatPeriod(Duration::from_micros(1_500))),
        ),
        (with(|_, axes| axes[1].rated_torque = 0.0), out_of_range(Quantity::RatedTorque)),
        (with(|_, axes| axes[1].following_error = f64::NAN), out_of_range(Quantity::FollowingError)),
        (with(|_, axes| axes[1].quick_stop_deceleration = -1.0), out_of_range(Quantity::QuickStopDeceleration)),
        (with(|_, axes| axes[1].homing.zero_speed = 0.01), out_of_range(Quantity::ZeroSpeed)),
        (with(|_, axes| axes[1].emergency_input = Some(31)), None),
        (with(|_, axes| axes[1].emergency_input = Some(32)), out_of_range(Quantity::EmergencyInput)),
    ];
    for (found, expected) in table {
        assert_eq!(found, expected);
    }
}

/// A node may start by itself (object 0x1F80), or boot between the command and its execution.
#[test]
fn a_node_that_boots_after_its_start_fails_it_although_it_shows_operational() {
    for frames in [&["702#00", "702#05"][..], &["702#05", "702#00", "702#05"]] {
        let mut bench = Bench::new(group_config(), &[axis_config(2), axis_config(3)]);
        bench.stores[0].starts = false;
        bench.stores[1].starts = false;
        let mut since_start = 0;
        let result = (0..5_000).find_map(|_| {
            if let Poll::Ready(result) = bench.group.bring_up(bench.now) {
                return Some(result);
            }
            bench.serve();
            bench.now += PERIOD;
            let at = bench.now;
            let mut bus = bench.bus.0.lock().unwrap();
            since_start += usize::from(bus.sent.contains(&frame("000#0102")));
            // One frame of node 2 per call, then node 3 is operational.
            let heard = match since_start {
                0 => return None,
                call => *frames.get(call - 1).unwrap_or(&"703#05"),
            };
            bus.inbox.push_back(Received { frame: frame(heard), at });
            None
        });
        assert!(matches!(result, Some(Err(BringUpError::NotOperational { node: 2, .. }))), "{frames:?}: {result:?}");
    }
}

/// A node without its configuration must not be taken for a configured one.
#[test]
fn a_node_that_boots_while_others_still_start_fails_it() {
    let mut bench = Bench::new(group_config(), &[axis_config(2), axis_config(3)]);
    bench.stores[1].starts = false;
    let mut since_start = 0;
    let result = (0..5_000).find_map(|_| {
        if let Poll::Ready(result) = bench.group.bring_up(bench.now) {
            return Some(result);
        }
        bench.serve();
        bench.now += PERIOD;
        let at = bench.now;
        let mut bus = bench.bus.0.lock().unwrap();
        since_start += u32::from(bus.sent.contains(&frame("000#0102")));
        let heard = match since_start {
            3 => "702#00",
            5 => "703#05",
            _ => return None,
        };
        bus.inbox.push_back(Received { frame: frame(heard), at });
        None
    });
    assert!(matches!(result, Some(Err(BringUpError::NotOperational { node: 2, .. }))), "{result:?}");
}
