//! Homing, frame by frame.

use super::bench::*;
use crate::cia402::*;
use crate::{Finite, Homing, Power, Setpoint};
use canopen::Object;

const HOME: &[AxisCommand] = &[AxisCommand::Home];
const STAND: &[AxisCommand] = &[AxisCommand::Stand];

/// One cycle of the only axis. Returns RPDO and service frame.
fn cycle(bench: &mut Bench, statusword: u16, position: i32, command: &[AxisCommand]) -> [String; 2] {
    let mut frames = bench.cycle(&[answer(2, statusword, position)], command).into_iter().skip(1);
    [frames.next().unwrap(), frames.next().unwrap_or_default()]
}

#[test]
fn homing_runs_in_its_own_mode_and_comes_back_where_the_axis_stands() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    /// Statusword, position and command; RPDO, service frame, homing and following.
    type Step<'a> = (u16, i32, &'a [AxisCommand], &'a str, &'a str, Homing, bool);
    let steps: &[Step<'_>] = &[
        // Mode HM is commanded, then reported, while the axis stands.
        (0x0737, 1_000, HOME, "202#0F00E8030000", "602#2F60600006000000", Homing::NotHomed, true),
        (0x0737, 1_000, HOME, "202#0F00E8030000", "602#4061600000000000", Homing::InProgress, false),
        (0x0737, 1_000, HOME, "202#1F00E8030000", "", Homing::InProgress, false),
        // The drive searches and finally sets its counter to zero.
        (0x0237, 1_002, HOME, "202#1F00EA030000", "", Homing::InProgress, false),
        (0x0237, 1_004, HOME, "202#1F00EC030000", "", Homing::InProgress, false),
        (0x1237, 0, HOME, "202#1F0000000000", "", Homing::InProgress, false),
        (0x9637, 0, HOME, "202#1F0000000000", "", Homing::Attained, false),
        // Return to CSP with the present position as target.
        (0x9637, 1, STAND, "202#0F0001000000", "602#2F60600008000000", Homing::Attained, false),
        (0x9637, 2, STAND, "202#0F0002000000", "602#4061600000000000", Homing::Attained, false),
        (0x8737, 3, STAND, "202#0F0003000000", "", Homing::Attained, true),
        (0x8737, 9, STAND, "202#0F0003000000", "", Homing::Attained, true),
    ];
    for (i, &(statusword, position, command, rpdo, service, homing, following)) in steps.iter().enumerate() {
        assert_eq!((i, cycle(&mut bench, statusword, position, command)), (i, [rpdo, service].map(String::from)));
        let state = bench.states[0];
        assert_eq!((i, state.homing, state.following), (i, homing, following));
        assert_eq!((state.power, state.fault), (Power::On, None));
        // The jump of the counter to zero is not a motion.
        assert!(state.velocity.abs() < 10.0, "{}", state.velocity);
    }
}

#[test]
fn a_set_point_is_not_followed_before_the_cyclic_mode_shows() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    cycle(&mut bench, 0x0737, 1_000, HOME);
    cycle(&mut bench, 0x0737, 1_000, HOME);
    cycle(&mut bench, 0x0737, 1_000, HOME);
    cycle(&mut bench, 0x0237, 1_000, HOME);
    cycle(&mut bench, 0x0237, 1_000, HOME);
    cycle(&mut bench, 0x9637, 0, HOME);
    let command = &[follow(50.0)];
    assert_eq!(cycle(&mut bench, 0x9637, 0, command)[0], "202#0F0000000000");
    assert_eq!(cycle(&mut bench, 0x9637, 0, command)[0], "202#0F0000000000");
    assert_eq!(cycle(&mut bench, 0x9637, 0, command)[0], "202#0F0032000000");
    assert!(bench.states[0].following);
    assert_eq!(bench.states[0].fault, None);
}

#[test]
fn a_failed_search_says_so_and_may_be_tried_again() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    for statusword in [0x0737, 0x0737, 0x0737, 0x0237, 0x0237, 0x2637, 0x2637] {
        cycle(&mut bench, statusword, 1_000, HOME);
    }
    assert_eq!(bench.states[0].homing, Homing::Failed);
    // Halted, and back to CSP after standstill.
    assert_eq!(cycle(&mut bench, 0x2637, 1_000, STAND)[0], "202#0F01E8030000");
    for _ in 0..8 {
        cycle(&mut bench, 0x0737, 1_000, STAND);
    }
    assert_eq!((bench.states[0].homing, bench.states[0].following), (Homing::NotHomed, true));
    assert_eq!(cycle(&mut bench, 0x0737, 1_000, HOME)[1], "602#2F60600006000000");
}

/// Statuswords and counters of a drive while homing is commanded; the homing state at the end, and the fault.
fn home(answers: &[(usize, u16, i32)]) -> (Homing, Option<Fault>) {
    let mut axis = axis_config(2);
    (axis.homing.method, axis.following_error) = (34, 0.1);
    let mut bench = Bench::up_with(group_config(), &[axis]);
    bench.enable();
    for _ in 0..3 {
        cycle(&mut bench, 0x0737, 1_000, HOME);
    }
    for &(count, statusword, position) in answers {
        for _ in 0..count {
            cycle(&mut bench, statusword, position, HOME);
        }
    }
    (bench.states[0].homing, bench.states[0].fault)
}

#[test]
fn an_old_result_is_no_end_of_the_search() {
    // The result of an earlier homing for 20 ms, and for a second.
    for old in [0x9637, 0x1637, 0x2637] {
        assert_eq!(home(&[(10, old, 1_000)]), (Homing::InProgress, None), "{old:#06x}");
        let searched = [(10, old, 1_000), (20, 0x0237, 1_010), (1, 0x9637, 0)];
        assert_eq!(home(&searched), (Homing::Attained, None), "{old:#06x}");
        let (homing, fault) = home(&[(502, old, 1_000)]);
        assert_eq!(homing, Homing::Failed, "{old:#06x}");
        assert!(matches!(fault, Some(Fault::NoSearch { node: 2, .. })), "{fault:?}");
    }
    let fault = Fault::NoSearch { node: 2, waited: Duration::from_millis(1_002) };
    assert_eq!(fault.to_string(), "node 2: homing did not begin, no search was seen for 1.0s");
}

#[test]
fn a_counter_far_from_zero_after_the_search_is_a_fault() {
    // 0.1 rad of following error, 0.011 rad of braking, and two increments of rounding.
    let fault = Fault::NotAtZero { node: 2, counter: 38, most: 37 };
    assert_eq!(home(&[(9, 0x0237, 1_000), (9, 0x9637, 37)]), (Homing::Attained, None));
    assert_eq!(home(&[(9, 0x0237, 1_000), (5, 0x9637, 38)]), (Homing::Failed, Some(fault)));
    // A counter that the drive sets later than it shows success.
    assert_eq!(home(&[(9, 0x0237, 1_000), (3, 0x9637, 1_000), (1, 0x9637, 0)]), (Homing::Attained, None));
    let text = "node 2: homing ended at a count of 38, more than 37 from zero";
    assert_eq!(fault.to_string(), text);
}

#[test]
fn a_drive_that_lost_power_while_homing_is_taken_back_to_its_cyclic_mode() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    for statusword in [0x0737, 0x0737, 0x0737, 0x0237] {
        cycle(&mut bench, statusword, 1_000, HOME);
    }
    let frames = cycle(&mut bench, 0x0240, 1_000, HOME);
    let fault = Fault::PowerLost { node: 2, statusword: 0x0240 };
    assert_eq!((bench.states[0].fault, bench.states[0].homing), (Some(fault), Homing::InProgress));
    assert_eq!(frames, ["202#0000E8030000", "602#2F60600008000000"]);
    assert_eq!(cycle(&mut bench, 0x0240, 1_000, HOME)[1], "602#4061600000000000");
    assert_eq!(bench.states[0].homing, Homing::NotHomed);
}

/// Only a new bring-up configures a node that left the state operational or booted.
#[test]
fn a_drive_that_is_not_operational_is_not_taken_back_to_its_cyclic_mode() {
    for heartbeats in [&["702#7F"][..], &["702#00", "702#05"]] {
        let mut bench = Bench::up(&[2]);
        bench.enable();
        for statusword in [0x0737, 0x0737, 0x0737, 0x0237] {
            cycle(&mut bench, statusword, 1_000, HOME);
        }
        bench.cycle(heartbeats, STAND);
        for _ in 0..5 {
            let frames = cycle(&mut bench, 0x0240, 1_000, STAND);
            assert_eq!(frames, ["202#0000E8030000", ""].map(String::from), "{heartbeats:?}");
        }
    }
}

#[test]
fn service_frames_take_turns_one_a_cycle() {
    let nodes = [1, 2, 3];
    let mut bench = Bench::up(&nodes);
    bench.enable();
    let mut first = Vec::new();
    for _ in 0..9 {
        let frames = bench.cycle(&bench.answers(0x0737, 1_000), &[AxisCommand::Home; 3]);
        assert!(frames.len() <= 5);
        first.extend(frames.get(4).cloned());
    }
    for node in nodes {
        for object in ["2F60600006000000", "4061600000000000"] {
            assert!(first.contains(&format!("60{node}#{object}")), "{first:?}");
        }
    }
}

#[test]
fn a_service_frame_that_was_not_taken_is_offered_again() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    bench.bus.0.lock().unwrap().takes = Some(2);
    assert_eq!(cycle(&mut bench, 0x0737, 1_000, HOME)[1], "");
    bench.bus.0.lock().unwrap().takes = None;
    assert_eq!(cycle(&mut bench, 0x0737, 1_000, HOME)[1], "602#2F60600006000000");
    assert_eq!(bench.group.counters().dropped_setpoints, 0);
}

#[test]
fn a_drive_that_refuses_the_mode_or_does_not_answer_is_faulted() {
    let abort = |code| Fault::Aborted { node: 2, object: Object::new(0x6060, 0), code };
    for code in [0x0800_0022, 0x0504_0000] {
        let mut bench = Bench::up(&[2]);
        bench.enable();
        if code == 0x0504_0000 {
            bench.stores[0].mute = Some((0x6060, 0));
        } else {
            bench.stores[0].aborts.insert((0x6060, 0), code);
        }
        for _ in 0..200 {
            cycle(&mut bench, 0x0737, 1_000, HOME);
        }
        assert_eq!(bench.states[0].fault, Some(abort(code)));
        // No further request before the reset.
        let asked = cycle(&mut bench, 0x0707, 1_000, HOME);
        assert_eq!(asked, ["202#0200E8030000", ""].map(String::from));
    }
}

#[test]
fn a_drive_that_cannot_come_back_is_asked_again_after_the_reset() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    for statusword in [0x0737, 0x0737, 0x0737, 0x0237, 0x0237, 0x9637] {
        cycle(&mut bench, statusword, 0, HOME);
    }
    bench.stores[0].aborts.insert((0x6060, 0), 0x0800_0022);
    let told = |service: &str| service == "602#2F60600008000000";
    let asked = (0..20).filter(|_| told(&cycle(&mut bench, 0x9637, 0, STAND)[1])).count();
    assert_eq!(asked, 1);
    bench.stores[0].aborts.clear();
    assert!(told(&cycle(&mut bench, 0x9640, 0, &[AxisCommand::ResetFault])[1]));
    cycle(&mut bench, 0x9640, 0, &[AxisCommand::Off]);
    cycle(&mut bench, 0x9640, 0, &[AxisCommand::Off]);
    assert_eq!(bench.states[0].fault, None);
}

#[test]
fn a_mode_on_its_way_is_none_to_follow_in() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    bench.stores[0].mute = Some((0x6060, 0));
    cycle(&mut bench, 0x0737, 1_000, HOME);
    bench.stores[0].mute = None;
    // The drive may have missed the request. The request is repeated after 100 ms, and the drive changes to HM and
    // back.
    let mut services = Vec::new();
    for _ in 0..100 {
        let [rpdo, service] = cycle(&mut bench, 0x0737, 1_000, &[follow(1_100.0)]);
        let set_point = if bench.states[0].following { "4C040000" } else { "E8030000" };
        assert_eq!(rpdo, format!("202#0F00{set_point}"));
        services.extend((!service.is_empty()).then_some(service));
    }
    let times_out = "602#8060600000000405";
    let expected = [times_out, "602#2F60600006000000", "602#2F60600008000000", "602#4061600000000000"];
    assert_eq!(services, expected);
    assert_eq!(bench.states[0].fault, None);
}

#[test]
fn a_mode_that_never_shows_is_a_fault() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    bench.stores[0].shows_modes = false;
    for _ in 0..300 {
        cycle(&mut bench, 0x0737, 1_000, HOME);
    }
    assert!(matches!(bench.states[0].fault, Some(Fault::Stuck { node: 2, .. })));
}

#[test]
fn drives_that_follow_velocity_or_torque_home_as_well() {
    for (mode, told) in [(CyclicMode::Csv, "09"), (CyclicMode::Cst, "0A")] {
        let mut bench = Bench::up_with(group_config(), &[AxisConfig { mode, ..axis_config(2) }]);
        bench.enable();
        for statusword in [0x0737, 0x0737, 0x0737, 0x0237, 0x0237, 0x9637] {
            cycle(&mut bench, statusword, 0, HOME);
        }
        assert_eq!(bench.states[0].homing, Homing::Attained);
        let zero = Finite::ZERO;
        let setpoint = if mode == CyclicMode::Csv { Setpoint::Velocity(zero) } else { Setpoint::Torque(zero) };
        let service = cycle(&mut bench, 0x9637, 0, &[AxisCommand::Follow(setpoint)])[1].clone();
        assert_eq!(service, format!("602#2F606000{told}000000"));
        cycle(&mut bench, 0x9637, 0, STAND);
        cycle(&mut bench, 0x9637, 0, STAND);
        assert!(bench.states[0].following);
    }
}

#[test]
fn bit_15_is_a_reference_only_where_maxon_says_so() {
    for (vendor, homing) in [(0xFB, Homing::Attained), (0x1234, Homing::NotHomed)] {
        let mut axis = axis_config(2);
        axis.identity = Identity { vendor, product: None, revision: None };
        let mut bench = Bench::new(group_config(), &[axis]);
        bench.stores[0].put(0x1018, 1, &vendor.to_le_bytes());
        assert_eq!(bench.bring_up(), Ok(()));
        for _ in 0..2 {
            bench.cycle(&[answer(2, 0x8740, 1_000)], &[AxisCommand::Off]);
        }
        assert_eq!(bench.states[0].homing, homing, "vendor {vendor:#x}");
    }
}
