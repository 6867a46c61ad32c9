//! Which answers are accepted.

use super::*;

#[test]
fn what_nobody_asked_for_is_no_answer() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().full = true;
        rig.cycle(AxisCommand::Stand);
        let stale = rig.drive().last_answer.clone();
        rig.drive().outbox.extend(stale);
        assert_eq!(rig.cycle(AxisCommand::Stand).age, 1, "{protocol:?}");
        assert_eq!(rig.counters().surplus, 1);
    }
}

#[test]
fn switches_are_said_and_are_no_fault() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().status = Status::UPPER_LIMIT | Status::HOME_SWITCH;
        // Two answers of three in NFv2 have a status.
        let switches = rig.run(4, AxisCommand::Stand).switches;
        assert!(switches.upper_limit && switches.home && !switches.lower_limit);
        rig.drive().status = Status::LOWER_LIMIT;
        let switches = rig.run(4, AxisCommand::Stand).switches;
        assert!(!switches.upper_limit && !switches.home && switches.lower_limit);
        assert_eq!(rig.fault(), None);
    }
}

#[test]
fn an_implausible_answer_counts_as_missing() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().current = 22_501;
        rig.cycle(AxisCommand::Stand);
        rig.drive().current = 22_500;
        let state = rig.cycle(AxisCommand::Stand);
        assert_eq!((state.age, rig.counters().implausible), (1, 1));
        let state = rig.cycle(AxisCommand::Stand);
        assert_eq!((state.age, rig.counters().implausible), (0, 1));
        assert!((state.torque - 2.25).abs() < 1e-9);
        // A jump within the bound of velocity but beyond the bound of acceleration.
        rig.drive().position += 110;
        rig.cycle(AxisCommand::Stand);
        rig.drive().position -= 110;
        assert_eq!(rig.cycle(AxisCommand::Stand).increments.0, 1_000);
        let state = rig.cycle(AxisCommand::Stand);
        assert_eq!((state.increments.0, state.age), (1_000, 0));
    }
}

/// After truncated or inserted bytes, the second answer at the latest is accepted.
#[test]
fn torn_and_surplus_bytes_cost_two_answers_at_most() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        let length = rig.drive().last_answer.len();
        for keep in 0..length {
            rig.cycle(AxisCommand::Stand);
            rig.drive().outbox.truncate(keep);
            let ages: Vec<u32> = (0..3).map(|_| rig.cycle(AxisCommand::Stand).age).collect();
            assert_eq!(ages[0], 1, "{protocol:?} {keep}");
            assert_eq!(ages[2], 0, "{protocol:?} {keep}: {ages:?}");
        }
        for surplus in 1..2 * length {
            rig.cycle(AxisCommand::Stand);
            rig.drive().outbox.extend((0..surplus).map(|n| [0x23, 0x12, 0xED, 8][n % 4]));
            let ages: Vec<u32> = (0..3).map(|_| rig.cycle(AxisCommand::Stand).age).collect();
            assert_eq!(ages[2], 0, "{protocol:?} {surplus}: {ages:?}");
            // Bytes that look like a header hide no answer behind them.
            assert!(protocol == Protocol::HiMoxa || ages == [0; 3], "{surplus}: {ages:?}");
            assert_eq!(rig.states[0].increments.0, 1_000);
        }
        assert_eq!(rig.fault(), None);
    }
}

#[test]
fn an_answer_that_is_not_its_own_is_refused() {
    let mut nfv2 = Rig::on(Drive::new(Protocol::Nfv2, 8));
    let mut other = Drive::new(Protocol::Nfv2, 9).shared();
    for _ in 0..2 {
        let request = nfv2.drive().heard.last().unwrap().clone();
        let mut request = request;
        request[3] = 9;
        let last = request.len() - 1;
        request[last] = serial::nfv2::crc8(&request[3..last]);
        serial::Line::write(&mut other, Instant::ZERO, &request).unwrap();
        let foreign: Vec<u8> = other.drive().outbox.drain(..).collect();
        nfv2.drive().outbox = foreign.into();
        nfv2.cycle(AxisCommand::Stand);
    }
    assert_eq!((nfv2.states[0].age, nfv2.counters().foreign), (2, 2));

    let mut moxa = Rig::on(Drive::new(Protocol::HiMoxa, 8));
    moxa.drive().start = 0x2B;
    moxa.run(2, AxisCommand::Stand);
    assert_eq!((moxa.states[0].age, moxa.counters().damaged), (1, 1));

    // A drive whose start byte changes in every answer is accepted with any start byte.
    let mut restless = Rig::of(Drive::new(Protocol::HiMoxa, 8));
    while restless.group.bring_up(restless.now).is_pending() {
        restless.now += PERIOD;
        restless.drive().start += 1;
    }
    restless.drive().start += 1;
    assert_eq!(restless.run(3, AxisCommand::Off).age, 0);
}

#[test]
fn a_whole_answer_after_a_torn_one_is_believed() {
    let mut rig = Rig::on(Drive::new(Protocol::HiMoxa, 8));
    rig.drive().outbox.truncate(5);
    // A telegram is left out after the torn answer.
    let ages: Vec<u32> = (0..3).map(|_| rig.cycle(AxisCommand::Stand).age).collect();
    assert_eq!(ages, [1, 2, 0]);
}

#[test]
fn an_answer_that_was_read_in_two_parts_is_put_together() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        let rest: Vec<u8> = rig.drive().outbox.drain(5..).collect();
        assert_eq!(rig.cycle(AxisCommand::Stand).age, 1);
        let next: Vec<u8> = rig.drive().outbox.drain(..).collect();
        rig.drive().outbox.extend(rest.into_iter().chain(next));
        // The answer is late. In the older protocol no telegram was sent behind it.
        let ages = [(); 2].map(|()| rig.cycle(AxisCommand::Stand).age);
        assert_eq!(ages, if protocol == Protocol::Nfv2 { [0, 0] } else { [2, 0] }, "{protocol:?}");
        assert_eq!(rig.counters().late, 1, "{protocol:?}");
    }
}

#[test]
fn an_answer_that_comes_a_cycle_late_is_passed_over_for_the_one_behind_it() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive { velocity: 40, ..Drive::new(protocol, 8) });
        rig.run(3, AxisCommand::Stand);
        let held: Vec<u8> = rig.drive().outbox.drain(..).collect();
        assert_eq!(rig.cycle(AxisCommand::Stand).age, 1);
        if protocol == Protocol::HiMoxa {
            // The next telegram is left out.
            assert_eq!(rig.cycle(AxisCommand::Stand).age, 2);
        }
        let newer: Vec<u8> = rig.drive().outbox.drain(..).collect();
        let position = rig.drive().position - 40;
        rig.drive().outbox.extend(held.into_iter().chain(newer));
        let state = rig.cycle(AxisCommand::Stand);
        assert_eq!((state.age, state.increments.0), (0, position), "{protocol:?}");
        assert_eq!((rig.counters().late, rig.counters().surplus), (1, 0));
    }
}
