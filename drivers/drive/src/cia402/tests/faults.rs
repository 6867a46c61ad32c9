//! Faults in operation.

use std::time::Duration;

use can::{ControllerState, PortError};

use super::bench::*;
use crate::Power;
use crate::cia402::*;

const STAND: &[AxisCommand] = &[AxisCommand::Stand];
const OFF: &[AxisCommand] = &[AxisCommand::Off];
const RESET: &[AxisCommand] = &[AxisCommand::ResetFault];

fn enabled() -> Bench {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    bench
}

fn stand(bench: &mut Bench, statusword: u16) -> String {
    bench.cycle(&[answer(2, statusword, 1_000)], STAND).swap_remove(1)
}

#[test]
fn missing_answers_are_ridden_through_and_then_the_drive_is_silent() {
    let mut bench = enabled();
    for age in 1..=2 {
        bench.cycle(NONE, STAND);
        assert_eq!((bench.states[0].age, bench.states[0].fault), (age, None));
        assert_eq!(bench.states[0].increments.0, 1_000);
    }
    stand(&mut bench, 0x0737);
    assert_eq!((bench.states[0].age, bench.states[0].following), (0, true));
    for _ in 0..2 {
        bench.cycle(NONE, STAND);
    }
    let frames = bench.cycle(NONE, STAND);
    assert_eq!(bench.states[0].fault, Some(Fault::Silent { node: 2, cycles: 3 }));
    assert!(!bench.states[0].following);
    // The frames of the host may wait in a buffer, and the drive stands.
    assert_eq!(frames, ["080#"]);
    assert_eq!(bench.group.counters().missed_answers, 5);
    // A reset does not clear silence; an answer allows it.
    bench.cycle(NONE, RESET);
    bench.cycle(NONE, RESET);
    assert_eq!(bench.states[0].fault, Some(Fault::Silent { node: 2, cycles: 5 }));
    bench.cycle(&[answer(2, 0x0740, 1_000)], RESET);
    bench.cycle(&[answer(2, 0x0740, 1_000)], RESET);
    assert_eq!(bench.states[0].fault, None);
}

#[test]
fn syncs_that_the_port_never_takes_are_named_and_not_the_silence_after_them() {
    let mut bench = enabled();
    stand(&mut bench, 0x0737);
    bench.bus.0.lock().unwrap().takes = Some(0);
    // The first of these cycles still reads the answer to the last SYNC.
    bench.cycle(&bench.answers(0x0737, 1_000), STAND);
    for _ in 0..3 {
        bench.cycle(NONE, STAND);
    }
    let fault = bench.states[0].fault.unwrap();
    assert_eq!(fault, Fault::NotSent { node: 2, cycles: 3 });
    let text = "node 2: set-point not taken by the bus for 3 cycles";
    assert_eq!(fault.to_string(), text);
    assert_eq!(bench.group.counters().missed_answers, 0);
}

#[test]
fn set_points_that_the_port_does_not_take_are_ridden_through_and_then_a_fault_of_their_axis() {
    let stand = &[AxisCommand::Stand; 2];
    let mut bench = Bench::up(&[1, 2]);
    bench.enable();
    let answers = bench.answers(0x0737, 1_000);
    let mut cycles = |takes: Option<usize>, count: usize, command: &[AxisCommand]| {
        bench.bus.0.lock().unwrap().takes = takes;
        for _ in 0..count {
            bench.cycle(&answers, command);
        }
        [bench.states[0].fault, bench.states[1].fault]
    };
    // The port takes the SYNC and the first set-point; both drives continue to answer.
    assert_eq!(cycles(Some(2), 2, stand), [None, None]);
    // A set-point that is taken restarts the count.
    assert_eq!(cycles(None, 1, stand), [None, None]);
    assert_eq!(cycles(Some(2), 3, stand), [None, None]);
    let fault = Some(Fault::NotSent { node: 2, cycles: 3 });
    assert_eq!(cycles(Some(2), 1, stand), [None, fault]);
    // A reset does not clear the fault until a set-point is taken.
    let reset = &[AxisCommand::Stand, AxisCommand::ResetFault];
    let fault = Some(Fault::NotSent { node: 2, cycles: 5 });
    assert_eq!(cycles(Some(2), 2, reset), [None, fault]);
    cycles(None, 1, reset);
    assert_eq!(cycles(None, 2, reset), [None, None]);
}

#[test]
fn answers_to_an_older_sync_are_missing_ones() {
    let mut bench = enabled();
    stand(&mut bench, 0x0737);
    for age in 1..=3 {
        // Each answer came shortly before the last SYNC and belongs to the SYNC before.
        let (frame, at) = (frame(&answer(2, 0x0737, 1_000 + age)), bench.now - PERIOD / 4);
        let late = Received { frame, at };
        bench.bus.0.lock().unwrap().inbox.push_back(late);
        bench.cycle(NONE, STAND);
        // The position of a late answer is used all the same.
        assert_eq!(bench.states[0].increments.0, 1_000 + age);
        assert_eq!((bench.states[0].age, bench.states[0].at), (age as u32, at));
    }
    let silent = Fault::Silent { node: 2, cycles: 3 };
    assert_eq!(bench.states[0].fault, Some(silent));
    assert_eq!(bench.group.counters().missed_answers, 3);
    let unexpected = bench.group.counters().unexpected;
    // An answer from before the last two SYNCs cannot be attributed to a SYNC.
    let (frame, at) = (frame(&answer(2, 0x0737, 7)), bench.now - 2 * PERIOD);
    let old = Received { frame, at };
    bench.bus.0.lock().unwrap().inbox.push_back(old);
    bench.cycle(NONE, STAND);
    assert_eq!((bench.states[0].age, bench.states[0].increments.0), (4, 1_003));
    assert_eq!(bench.group.counters().unexpected, unexpected + 1);
}

#[test]
fn a_lost_heartbeat_stops_the_axis() {
    let config = GroupConfig { heartbeat_period: Duration::from_millis(10), ..group_config() };
    let mut bench = Bench::up_with(config, &[axis_config(2)]);
    bench.cycle(&["702#05".to_owned()], STAND);
    let heard = bench.now - PERIOD / 2;
    while bench.states[0].fault.is_none() {
        stand(&mut bench, 0x0740);
        assert!(bench.now.since(heard) < Duration::from_millis(40));
    }
    let waited = Duration::from_millis(31);
    assert_eq!(bench.states[0].fault, Some(Fault::HeartbeatLost { node: 2, waited }));
}

#[test]
fn a_heartbeat_is_lost_after_three_periods_and_not_at_their_end() {
    let config = GroupConfig { heartbeat_period: Duration::from_millis(10), ..group_config() };
    let mut bench = Bench::up_with(config, &[axis_config(2)]);
    // The first cycle of operation counts as a heartbeat.
    for _ in 0..=15 {
        bench.cycle(&bench.answers(0x0740, 1_000), OFF);
        assert_eq!(bench.states[0].fault, None);
    }
    bench.cycle(&bench.answers(0x0740, 1_000), OFF);
    let waited = Duration::from_millis(32);
    assert_eq!(bench.states[0].fault, Some(Fault::HeartbeatLost { node: 2, waited }));
}

#[test]
fn leaving_operational_is_a_fault_until_the_node_is_back() {
    let fault = Some(Fault::LeftOperational { node: 2 });
    for state in ["702#7F", "702#04"] {
        let mut bench = enabled();
        bench.cycle(&[answer(2, 0x0737, 1_000), state.to_owned()], STAND);
        assert_eq!(bench.states[0].fault, fault);
        // Another master starts the node before the reset.
        bench.cycle(&[answer(2, 0x0740, 1_000), "702#05".to_owned()], OFF);
        assert_eq!(bench.states[0].fault, fault);
        let sent = bench.cycle(&bench.answers(0x0740, 1_000), RESET);
        assert!(!sent.iter().any(|frame| frame.starts_with("000#")), "{sent:?}");
        bench.cycle(&bench.answers(0x0740, 1_000), OFF);
        assert_eq!((bench.states[0].fault, bench.states[0].recovering), (None, false));
    }
}

#[test]
fn a_node_that_booted_needs_bring_up() {
    let mut bench = enabled();
    bench.cycle(&["702#00"], STAND);
    bench.cycle(&[answer(2, 0x0740, 0), "702#05".to_owned()], RESET);
    bench.cycle(&bench.answers(0x0740, 0), RESET);
    assert_eq!(bench.states[0].fault, Some(Fault::LeftOperational { node: 2 }));
    assert_eq!(bench.bring_up(), Ok(()));
    bench.cycle(NONE, OFF);
    assert_eq!(bench.states[0].fault, None);
}

#[test]
fn a_drive_fault_carries_the_code_of_its_emcy_whichever_comes_first() {
    let (emcy, fault) = ("082#1186800000000000", Some(Fault::Drive { node: 2, code: 0x8611 }));
    let statusword = answer(2, 0x020F, 1_000);
    let orders: [&[&[&str]]; 3] =
        [&[&[emcy, &statusword]], &[&[&statusword, emcy]], &[&[&statusword], &[&statusword, emcy]]];
    for cycles in orders {
        let mut bench = enabled();
        for answers in cycles {
            let frames = bench.cycle(answers, STAND);
            assert_eq!(frames[1], "202#0000E8030000");
        }
        assert_eq!(bench.states[0].fault, fault);
        assert!(!bench.states[0].following);
    }
    let text = fault.unwrap().to_string();
    assert_eq!(text, "node 2: drive fault 0x8611 (following error)");
}

#[test]
fn a_fault_whose_emcy_was_lost_is_asked_for() {
    let mut bench = enabled();
    bench.stores[0].put(0x603F, 0, &[0x10, 0x23]);
    let frames = bench.cycle(&[answer(2, 0x0208, 1_000)], STAND);
    assert_eq!(frames[2], "602#403F600000000000");
    bench.cycle(&[answer(2, 0x0208, 1_000)], STAND);
    assert_eq!(bench.states[0].fault, Some(Fault::Drive { node: 2, code: 0x2310 }));
}

#[test]
fn a_drive_that_does_not_tell_its_error_code_is_asked_once() {
    for refuses in [true, false] {
        let mut bench = enabled();
        if refuses {
            bench.stores[0].aborts.insert((0x603F, 0), 0x0602_0000);
        }
        let cycles = (0..20).map(|_| bench.cycle(&[answer(2, 0x0208, 1_000)], STAND));
        let asked = cycles.filter(|frames| frames.len() > 2).count();
        assert_eq!(asked, 1);
        assert_eq!(bench.states[0].fault, Some(Fault::Drive { node: 2, code: 0 }));
    }
}

#[test]
fn a_drive_fault_is_reset_by_an_edge_and_leaves_when_the_drive_says_so() {
    let mut bench = enabled();
    let fault = Some(Fault::Drive { node: 2, code: 0x2310 });
    bench.cycle(&["082#1023020000000000".to_owned(), answer(2, 0x0208, 1_000)], STAND);
    let words: Vec<String> =
        (0..4).map(|_| bench.cycle(&[answer(2, 0x0208, 1_000)], RESET)[1][4..8].to_owned()).collect();
    assert!(words.windows(2).any(|pair| pair == ["0000", "8000"]), "{words:?}");
    assert_eq!(bench.states[0].fault, fault);
    bench.cycle(&[answer(2, 0x0240, 1_000)], RESET);
    bench.cycle(&[answer(2, 0x0240, 1_000)], OFF);
    assert_eq!(bench.states[0].fault, None);
}

#[test]
fn power_lost_unasked_is_a_fault_and_power_given_up_is_not() {
    for statusword in [0x0740, 0x0721, 0x0723, 0x0707] {
        let mut bench = enabled();
        stand(&mut bench, statusword);
        assert_eq!(bench.states[0].fault, Some(Fault::PowerLost { node: 2, statusword }));
    }
    let mut bench = enabled();
    assert_eq!(bench.cycle(&bench.answers(0x0737, 1_000), OFF)[1], "202#0000E8030000");
    bench.cycle(&bench.answers(0x0737, 1_000), OFF);
    assert_eq!(bench.states[0].power, Power::Changing);
    bench.cycle(&bench.answers(0x0740, 1_000), OFF);
    assert_eq!((bench.states[0].power, bench.states[0].fault), (Power::Off, None));
}

#[test]
fn a_loss_of_power_is_a_fault_from_the_fifth_answer_after_the_command_on() {
    let (node, statusword) = (2, 0x0740);
    for (with_torque, fault) in [(3, None), (4, Some(Fault::PowerLost { node, statusword }))] {
        let mut bench = enabled();
        bench.cycle(&bench.answers(0x0737, 1_000), OFF);
        // The first answer after the command is read in the next cycle.
        stand(&mut bench, 0x0737);
        (0..with_torque).for_each(|_| _ = stand(&mut bench, 0x0737));
        stand(&mut bench, statusword);
        assert_eq!(bench.states[0].fault, fault, "after {with_torque} answers with torque");
    }
}

#[test]
fn the_power_of_an_enabled_drive_is_on_from_the_fifth_answer_after_the_command_on() {
    let mut bench = enabled();
    let mut powers = |command| -> Vec<Power> {
        let cycle = |_| {
            bench.cycle(&bench.answers(0x0737, 1_000), command);
            bench.states[0].power
        };
        (0..8).map(cycle).collect()
    };
    let (on, changing) = (Power::On, Power::Changing);
    // Each cycle reads an answer before it takes the command.
    assert_eq!(powers(OFF), [on, changing, changing, changing, changing, changing, changing, changing]);
    assert_eq!(powers(STAND), [changing, changing, changing, changing, changing, on, on, on]);
}

#[test]
fn a_drive_that_stopped_because_it_lost_us_says_why() {
    let mut bench = enabled();
    bench.cycle(&["082#3081110000000000".to_owned(), answer(2, 0x0707, 1_000)], STAND);
    assert_eq!(bench.states[0].fault, Some(Fault::Drive { node: 2, code: 0x8130 }));
}

#[test]
fn a_moment_of_off_is_no_loss_of_power() {
    let mut bench = enabled();
    bench.cycle(&bench.answers(0x0737, 1_000), OFF);
    stand(&mut bench, 0x0737);
    for statusword in [0x0740, 0x0740, 0x0721, 0x0721, 0x0723, 0x0723, 0x0737] {
        stand(&mut bench, statusword);
        assert_eq!(bench.states[0].fault, None);
    }
    assert_eq!(bench.states[0].power, Power::On);
}

#[test]
fn a_transition_that_takes_too_long_is_a_fault() {
    let mut bench = Bench::up(&[2]);
    let mut cycles = 0;
    while bench.states[0].fault.is_none() {
        stand(&mut bench, 0x0721);
        cycles += 1;
        assert!(cycles < 300);
    }
    let waited = Duration::from_millis(502);
    let stuck = Fault::Stuck { node: 2, statusword: 0x0721, waited };
    assert_eq!(bench.states[0].fault, Some(stuck));
    // The same while the power is being switched off.
    let mut bench = enabled();
    while bench.states[0].fault.is_none() {
        bench.cycle(&bench.answers(0x0737, 1_000), OFF);
    }
    let stuck = Fault::Stuck { node: 2, statusword: 0x0737, waited };
    assert_eq!(bench.states[0].fault, Some(stuck));
}

#[test]
fn a_port_that_fails_faults_every_axis_until_it_works_again() {
    let mut bench = Bench::up(&[1, 2]);
    bench.enable();
    bench.bus.0.lock().unwrap().error = Some(PortError::Down);
    bench.cycle(NONE, &[AxisCommand::Stand; 2]);
    for state in &bench.states {
        assert_eq!(state.fault, Some(Fault::Port(PortError::Down)));
    }
    assert_eq!(bench.group.counters().dropped_setpoints, 2);
    bench.bus.0.lock().unwrap().error = None;
    bench.cycle(&bench.answers(0x0740, 1_000), &[AxisCommand::ResetFault; 2]);
    bench.cycle(&bench.answers(0x0740, 1_000), &[AxisCommand::Off; 2]);
    assert!(bench.states.iter().all(|state| state.fault.is_none()));
}

#[test]
fn a_controller_that_left_the_bus_faults_every_axis_until_it_is_back() {
    let mut bench = Bench::up(&[1, 2]);
    bench.enable();
    let mut faults = |state, answers: &[String], command| {
        bench.bus.0.lock().unwrap().state = state;
        bench.cycle(answers, &[command; 2]);
        [bench.states[0].fault, bench.states[1].fault]
    };
    let answers = [answer(1, 0x0737, 1_000), answer(2, 0x0737, 1_000)];
    let (stand, reset) = (AxisCommand::Stand, AxisCommand::ResetFault);
    for state in [ControllerState::Warning, ControllerState::Passive] {
        assert_eq!(faults(state, &answers, stand), [None; 2]);
    }
    // Bus-off is reported instead of the silence that follows, and cannot be reset while it lasts.
    for command in [stand, stand, stand, stand, reset, reset, stand] {
        let seen = faults(ControllerState::BusOff, &[], command);
        assert_eq!(seen, [Some(Fault::BusOff); 2]);
    }
    let seen = faults(ControllerState::Active, &answers, stand);
    assert_eq!(seen, [Some(Fault::BusOff); 2]);
    faults(ControllerState::Active, &answers, reset);
    assert_eq!(faults(ControllerState::Active, &answers, stand), [None; 2]);
    let text = Fault::BusOff.to_string();
    assert_eq!(text, "bus: the controller is bus-off");
}

#[test]
fn the_first_fault_stays_and_enabling_waits_for_its_reset() {
    let mut bench = enabled();
    stand(&mut bench, 0x0740);
    let lost = Some(Fault::PowerLost { node: 2, statusword: 0x0740 });
    for _ in 0..5 {
        bench.cycle(NONE, STAND);
        assert_eq!(bench.states[0].fault, lost);
    }
    assert_eq!(stand(&mut bench, 0x0740), "202#0000E8030000");
    bench.cycle(&bench.answers(0x0740, 1_000), RESET);
    // Answers were missing: a SYNC is left out once.
    assert_eq!(bench.cycle(&bench.answers(0x0740, 1_000), STAND), NONE);
    assert_eq!(stand(&mut bench, 0x0740), "202#0600E8030000");
    assert_eq!(bench.states[0].fault, None);
}

/// The drives have braked by themselves long ago. An enabling controlword would make them follow an old target.
#[test]
fn after_we_were_silent_too_long_no_drive_is_enabled_blindly() {
    let mut bench = enabled();
    stand(&mut bench, 0x0737);
    bench.now += 4 * group_config().heartbeat_period;
    // The drive holds the last set-point, which the order to stop replaces before the next SYNC.
    let frames = bench.cycle(&["702#05"], STAND);
    assert_eq!(&frames[0][..8], "202#0200");
    assert_eq!(bench.cycle(&["702#05"], STAND)[0], "080#");
    assert!(matches!(bench.states[0].fault, Some(Fault::HostLate { node: 2, .. })));
}
