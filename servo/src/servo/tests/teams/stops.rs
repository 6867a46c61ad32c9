//! Stops of teams.

use super::*;

/// A cause of a stop of the first member, which reaches 16 rad/s, while its partner moves by -0.6 times as much. The
/// stop of the first member alone takes 16 periods. The stop of its partner alone takes 24 periods.
#[derive(Clone, Copy)]
struct Case {
    name: &'static str,
    /// Changes the macrosteps of the first member.
    sequence: fn(&mut Vec<Macrostep>),
    /// Acts on the first member, of this index, in motion.
    act: fn(&mut Cell, usize),
    /// Phase of each member at the end.
    ends: [Phase; 2],
    /// Beginning of the cause of each member, `None` without a fault.
    causes: [Option<&'static str>; 2],
}

const PARTNER: Option<&str> = Some("Partner");
const FAULTED: [Phase; 2] = [Phase::Faulted, Phase::Standing];

/// A case of a fault of the first member.
fn fault(name: &'static str, cause: &'static str, act: fn(&mut Cell, usize)) -> Case {
    Case { name, sequence: |_| {}, act, ends: FAULTED, causes: [Some(cause), PARTNER] }
}

/// A case of a macrostep that cannot be begun or executed.
fn bad(name: &'static str, cause: &'static str, sequence: fn(&mut Vec<Macrostep>)) -> Case {
    Case { name, sequence, act: |_, _| {}, ends: FAULTED, causes: [Some(cause), PARTNER] }
}

fn cases() -> Vec<Case> {
    let unequal = Some("UnequalSteps");
    vec![
        Case {
            ends: [Phase::Standing; 2],
            causes: [None, PARTNER],
            ..fault("stop", "", |cell, first| cell.order(first, Order::Stop))
        },
        Case {
            ends: [Phase::Off, Phase::Standing],
            causes: [None, PARTNER],
            ..fault("disable", "", |cell, first| cell.order(first, Order::Disable))
        },
        Case {
            ends: [Phase::Off; 2],
            causes: [None; 2],
            ..fault("stop request", "", |cell, _| cell.servo.stop_request().request())
        },
        Case {
            ends: [Phase::Faulted; 2],
            causes: [Some("Overrun"); 2],
            ..fault("overrun", "", |cell, _| cell.servo.missed(3))
        },
        fault("drive fault", "Drive", |cell, first| {
            cell.worlds[first].lock().unwrap().axes[0].state.fault = Some(FAULT);
        }),
        fault("bus that is gone", "Drive", |cell, first| cell.worlds[first].lock().unwrap().gone = true),
        fault("blocked motor", "Frozen", |cell, first| {
            cell.worlds[first].lock().unwrap().axes[0].blocked = true;
        }),
        fault("limit switches", "LimitSwitch", |cell, first| {
            let mut world = cell.worlds[first].lock().unwrap();
            let drive = &mut world.axes[0];
            (drive.limit_above, drive.limit_below) = (Some(-1e3), Some(1e3));
        }),
        bad("starvation", "Starved", |steps| steps.truncate(12)),
        bad("acceleration", "AccelerationLimit", |steps| steps[12].position[0] += 0.3),
        bad("position", "PositionLimit", |steps| steps[12].position[0] += 1e6),
        bad("NaN", "NotFinite", |steps| steps[12].velocity[0] = f64::NAN),
        bad("no periods", "Malformed", |steps| steps[12].steps = 0),
        bad("number", "OutOfSequence", |steps| steps[12].number += 1),
        Case {
            ends: [Phase::Faulted; 2],
            causes: [unequal; 2],
            ..bad("length", "UnequalSteps", |steps| (steps[12].steps, steps[12].report_at) = (20, 20))
        },
    ]
}

/// Cycles in which a case acts: at the boundary of two macrosteps, and within a macrostep.
const CYCLES: [u32; 2] = [90, 95];

/// Positions of the first member and its partner, cycle by cycle from the last one in motion on. `first` is the index
/// of the first member. The case acts before cycle `acts`.
fn stop(case: &Case, first: usize, acts: u32) -> Vec<[f64; 2]> {
    let other = 1 - first;
    let mut accelerations = [400.0; 2];
    accelerations[first] = 1000.0;
    let mut cell = Cell::standing(&accelerations);
    cell.order_all(Order::Tie { members: 0b11 });
    let mut sequence = motion(1.0, 40);
    (case.sequence)(&mut sequence);
    sequence.into_iter().for_each(|step| cell.order(first, Order::Move(step)));
    motion(-0.6, 40).into_iter().for_each(|step| cell.order(other, Order::Move(step)));
    let (mut positions, mut teams) = (Vec::new(), vec![TeamState::Apart]);
    for cycle in 0..800 {
        if cycle == acts {
            (case.act)(&mut cell, first);
        }
        cell.run(1);
        let moving = cell.phases().iter().filter(|phase| **phase == Phase::Moving).count();
        assert_ne!(moving, 1, "{}: {:?} in cycle {cycle}", case.name, cell.phases());
        if moving > 0 {
            positions.clear();
        }
        positions.push([cell.position(first), cell.position(other)]);
        let [one, partner] = [first, other].map(|member| cell.servo.team_state(member).unwrap());
        assert!(one == partner || partner == TeamState::Parting, "{}: {one:?}, {partner:?}", case.name);
        if *teams.last().unwrap() != partner {
            teams.push(partner);
        }
    }
    let course = [TeamState::Apart, TeamState::Moving, TeamState::Parting, TeamState::Apart];
    assert_eq!(teams, course[..], "{}", case.name);
    assert_eq!([cell.phases()[first], cell.phases()[other]], case.ends, "{}", case.name);
    for (member, expected) in [(first, case.causes[0]), (other, case.causes[1])] {
        let found = cell.servo.fault(member).map(|fault| format!("{:?}", fault.cause));
        let same = match (&found, expected) {
            (Some(found), Some(expected)) => found.starts_with(expected),
            (None, None) => true,
            (Some(_), None) | (None, Some(_)) => false,
        };
        assert!(same, "{}: {found:?} instead of {expected:?}", case.name);
    }
    if case.causes[1] == PARTNER {
        assert_eq!(cell.servo.fault(other), partner(first as u8), "{}", case.name);
    }
    positions
}

#[test]
fn every_cause_at_a_boundary_or_within_a_macrostep_brakes_all_members_in_the_same_cycle_and_in_proportion() {
    for (case, acts) in cases().into_iter().flat_map(|case| CYCLES.map(|acts| (case, acts))) {
        let positions = stop(&case, 0, acts);
        assert_eq!(positions, stop(&case, 1, acts), "{}: the order of the effectors does not matter", case.name);
        let (start, end) = (positions[0], positions[positions.len() - 1]);
        // An overrun stops where the drives already stand. A drive that is gone takes no set-point.
        let ways = [0, 1].map(|member| end[member] - start[member]);
        let (overrun, gone) = (case.name == "overrun", case.name == "bus that is gone");
        let expected = if overrun { 0.0 } else { 16.0 * DT * 23.0 / 2.0 };
        let first = if gone { 0.0 } else { expected };
        assert!((ways[0] - first).abs() < 1e-9 && (ways[1] + 0.6 * expected).abs() < 1e-9, "{}: {ways:?}", case.name);
        for (cycle, at) in positions.iter().enumerate().filter(|_| !overrun && !gone) {
            let [one, other] = [0, 1].map(|member| (at[member] - start[member]) / ways[member]);
            assert!((one - other).abs() < 1e-9, "{}: {one} and {other} in cycle {cycle}", case.name);
        }
        let partner: Vec<f64> = positions.iter().map(|at| at[1]).collect();
        for three in partner.windows(3).filter(|_| !overrun) {
            let acceleration = (three[2] - 2.0 * three[1] + three[0]) / (DT * DT);
            assert!(acceleration.abs() <= 400.4, "{}: {acceleration}", case.name);
        }
    }
}

#[test]
fn no_member_begins_its_macrostep_if_that_of_a_member_cannot_be_begun() {
    let bad_position = |steps: &mut Vec<Macrostep>| steps[12].position[0] = f64::NAN;
    let longer = |steps: &mut Vec<Macrostep>| (steps[12].steps, steps[12].report_at) = (20, 20);
    let unequal = |steps, other| StopCause::UnequalSteps { number: 13, steps, other };
    type Change = fn(&mut Vec<Macrostep>);
    let cases: [(Change, [StopCause; 2]); 2] = [
        (bad_position, [StopCause::NotFinite, StopCause::Partner { effector: 0 }]),
        (longer, [unequal(20, 10), unequal(10, 20)]),
    ];
    for (change, causes) in cases {
        let mut cell = Cell::standing(&[1000.0; 2]);
        cell.order_all(Order::Tie { members: 0b11 });
        for effector in 0..2 {
            let mut sequence = motion(1.0, 40);
            if effector == 0 {
                change(&mut sequence);
            }
            sequence.into_iter().for_each(|step| cell.order(effector, Order::Move(step)));
        }
        cell.run(200);
        let begun = [0, 1].map(|member| (cell.snapshot(member).macrostep, cell.snapshot(member).team_macrostep));
        assert_eq!(begun, [(12, 12); 2], "{causes:?}");
        assert_eq!([0, 1].map(|member| cell.servo.fault(member).unwrap().cause), causes);
    }
}

#[test]
fn members_that_brake_stay_in_proportion_under_refused_batches() {
    for refused in [0, 1] {
        let mut cell = Cell::standing(&[1000.0, 400.0]);
        cell.order_all(Order::Tie { members: 0b11 });
        for (effector, scale) in [1.0, -0.6].into_iter().enumerate() {
            motion(scale, 40).into_iter().for_each(|step| cell.order(effector, Order::Move(step)));
        }
        cell.run(95);
        let start = [0, 1].map(|member| cell.position(member));
        cell.order(0, Order::Stop);
        cell.run(3);
        assert_eq!(cell.phases(), [Phase::Stopping; 2]);
        cell.worlds[refused].lock().unwrap().refuses = 2;
        while cell.phases() == [Phase::Stopping; 2] {
            cell.run(1);
            let [one, other] = [0, 1].map(|member| cell.position(member) - start[member]);
            assert!((other + 0.6 * one).abs() < 1e-9, "bus {refused} refuses: {one} {other}");
        }
        cell.run(200);
        assert_eq!(cell.phases(), [Phase::Standing; 2]);
    }
}

#[test]
fn a_loop_that_is_lost_takes_the_power_of_its_effector_and_brakes_the_partner_in_the_same_cycle() {
    for first in [0, 1] {
        let mut cell = Cell::with(&scripted::host_config(1), &[1000.0; 2]);
        cell.order_all(Order::Tie { members: 0b11 });
        for effector in 0..2 {
            motion(1.0, 40).into_iter().for_each(|step| cell.order(effector, Order::Move(step)));
        }
        cell.run(95);
        assert_eq!(cell.phases(), [Phase::Moving; 2]);
        cell.worlds[first].lock().unwrap().axes[0].backwards = true;
        while cell.phases() == [Phase::Moving; 2] {
            cell.run(1);
        }
        assert_eq!([cell.phases()[first], cell.phases()[1 - first]], [Phase::Faulted, Phase::Stopping]);
        cell.run(100);
        assert_eq!(cell.phases()[1 - first], Phase::Standing);
        assert_eq!(cell.servo.fault(1 - first), partner(first as u8));
    }
}

#[test]
fn a_stop_of_a_standing_member_drops_the_macrosteps_that_its_partner_waits_with() {
    for stop in [Order::Stop, Order::Disable] {
        let mut cell = Cell::standing(&[1000.0; 2]);
        cell.order_all(Order::Tie { members: 0b11 });
        cell.order(0, Order::Move(macrostep(1, 10, 0.01, 0.0)));
        cell.run(50);
        cell.order(1, stop);
        cell.run(1);
        cell.order(1, Order::Move(macrostep(1, 10, 0.01, 0.0)));
        cell.run(50);
        assert_eq!((cell.phases()[0], cell.position(0)), (Phase::Standing, 0.0));
        assert_eq!(cell.servo.fault(0), partner(1));
    }
}

#[test]
fn a_partner_refuses_motion_until_a_stop_or_disable_acknowledges() {
    for acknowledgement in [Order::Stop, Order::Disable] {
        let mut cell = Cell::standing(&[1000.0; 2]);
        cell.order_all(Order::Tie { members: 0b11 });
        for effector in 0..2 {
            motion(1.0, 20).into_iter().for_each(|step| cell.order(effector, Order::Move(step)));
        }
        cell.run(60);
        cell.order(1, Order::Stop);
        cell.run(1);
        while cell.links[0].reports.pop().is_ok() {}
        // Orders of before the controller has heard of the stop.
        let refused = cell.servo.counters().refused_orders;
        let stood = cell.position(0);
        cell.order(0, Order::Move(macrostep(21, 10, stood, 0.0)));
        cell.order(0, Order::Meet { members: 0b01 });
        cell.order(0, Order::Untie);
        cell.order(0, Order::Home);
        cell.run(100);
        // The 14 macrosteps that waited at the stop, and these four orders.
        assert_eq!(cell.servo.counters().refused_orders - refused, 14 + 4);
        assert_eq!((cell.phases()[0], cell.servo.fault(0)), (Phase::Standing, partner(1)));
        cell.order(0, acknowledgement);
        cell.order(0, Order::Enable);
        cell.run(20);
        assert_eq!(cell.servo.fault(0), None);
        let reports = std::iter::from_fn(|| cell.links[0].reports.pop().ok());
        assert_eq!(reports.last().unwrap().fault, None);
        let stood = cell.position(0);
        cell.order(0, Order::Move(macrostep(22, 10, stood + 0.01, 0.0)));
        cell.run(5);
        assert_eq!(cell.phases()[0], Phase::Moving);
    }
}

#[test]
fn a_fault_of_a_partner_itself_replaces_the_cause() {
    let mut cell = Cell::standing(&[1000.0; 2]);
    cell.order_all(Order::Tie { members: 0b11 });
    cell.run(1);
    cell.order(1, Order::Stop);
    cell.run(1);
    assert_eq!(cell.servo.fault(0), partner(1));
    cell.worlds[0].lock().unwrap().axes[0].state.fault = Some(FAULT);
    cell.run(5);
    assert_eq!(cell.servo.fault(0).unwrap().cause, StopCause::Drive(FAULT));
    assert_eq!(cell.phases(), [Phase::Faulted, Phase::Standing]);
}

#[test]
fn effectors_can_be_tied_again_in_the_cycle_of_a_stop() {
    let mut cell = Cell::standing(&[1000.0; 2]);
    cell.order_all(Order::Tie { members: 0b11 });
    cell.run(1);
    for order in [Order::Stop, Order::Tie { members: 0b11 }, Order::Move(macrostep(1, 10, 0.01, 0.0))] {
        cell.order_all(order);
    }
    cell.run(1);
    assert_eq!((cell.phases(), cell.team_macrosteps()), (vec![Phase::Moving; 2], vec![1; 2]));
    cell.run(50);
    assert_eq!(cell.phases(), [Phase::Standing; 2]);
    assert_eq!([0, 1].map(|effector| cell.servo.fault(effector)), [None; 2]);
}
