//! Faults of one axis.

use super::*;

#[test]
fn a_fault_while_switching_on_leaves_power_unknown() {
    for protocol in BOTH {
        let mut rig = Rig::up(Drive::new(protocol, 8));
        rig.cycle(AxisCommand::Stand);
        // Refused, because the drive has no torque yet.
        rig.cycle(AxisCommand::Follow(raw(protocol, 100)));
        let state = rig.run(8, AxisCommand::Stand);
        assert_eq!(state.power, Power::Changing, "{protocol:?}");
        assert_eq!(rig.run(4, AxisCommand::Off).power, Power::Off);
    }
}

#[test]
fn answers_that_come_in_heaps_are_a_fault_and_rare_gaps_are_none() {
    for protocol in BOTH {
        // One answer in `every` is missing.
        for (every, right) in [(3, false), (5, true)] {
            let mut rig = Rig::on(Drive::new(protocol, 8));
            for cycle in 0..1_000 {
                let held: Vec<u8> = match cycle % every {
                    0 => rig.drive().outbox.drain(..).collect(),
                    _ => Vec::new(),
                };
                rig.cycle(AxisCommand::Stand);
                // The late answer arrives with the next one.
                let newer: Vec<u8> = rig.drive().outbox.drain(..).collect();
                rig.drive().outbox.extend(held.into_iter().chain(newer));
            }
            let late = matches!(rig.fault(), Some(AxisControllerFault::Late { .. }));
            assert_eq!((late, rig.fault().is_none()), (!right, right), "{protocol:?} {every}");
        }
    }
}

#[test]
fn what_a_drive_reports_counts_when_two_answers_show_it() {
    let cases = [
        (Status::POWER_STAGE_FAULT, AxisControllerFault::PowerStage),
        (Status::OVERCURRENT, AxisControllerFault::Overcurrent),
        (Status::ERROR, AxisControllerFault::Error),
    ];
    for (protocol, (bit, fault)) in BOTH.into_iter().flat_map(|p| cases.map(|case| (p, case))) {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().status = bit;
        rig.cycle(AxisCommand::Stand);
        rig.drive().status = 0;
        rig.run(3, AxisCommand::Stand);
        assert_eq!(rig.fault(), None, "{protocol:?}: one answer is no fault");
        rig.drive().status = bit;
        rig.run(4, AxisCommand::Follow(raw(protocol, 100)));
        assert_eq!(rig.fault(), Some(fault), "{protocol:?}");
        assert_eq!(rig.drive().setpoint, 0);
        // Off keeps the fault, although manual mode cleared it in the drive.
        rig.drive().status = 0;
        rig.run(4, AxisCommand::Off);
        assert_eq!(rig.fault(), Some(fault));
        rig.run(2, AxisCommand::ResetFault);
        assert_eq!(rig.fault(), None);
    }
}

#[test]
fn a_restarted_drive_is_a_fault_and_stays_off() {
    for protocol in BOTH {
        for position in [1_000, 0] {
            let mut rig = Rig::on(Drive { position, status: Status::SYNCHRONIZED, ..Drive::new(protocol, 8) });
            rig.drive().restart();
            let state = rig.run(5, AxisCommand::Stand);
            assert_eq!(rig.fault(), Some(AxisControllerFault::Restarted), "{protocol:?}");
            assert_eq!(state.homing, Homing::NotHomed);
            assert_eq!(rig.drive().mode, Mode::Manual, "nobody gave it torque again");
        }
    }
}

#[test]
fn no_set_point_follows_what_may_be_a_restart() {
    let follow = AxisCommand::Follow(raw(Protocol::HiMoxa, 300));
    for position in [1_000, 0] {
        let mut rig = Rig::on(Drive { position, status: Status::SYNCHRONIZED, ..Drive::new(Protocol::HiMoxa, 8) });
        rig.run(3, follow);
        rig.drive().restart();
        // This cycle requests the first answer after the restart.
        rig.cycle(follow);
        for _ in 0..6 {
            rig.cycle(follow);
            assert_eq!(rig.drive().setpoint, 0, "from {position}");
        }
        assert_eq!(rig.fault(), Some(AxisControllerFault::Restarted));
    }
    // A damaged position costs one set-point.
    let mut rig = Rig::on(Drive::new(Protocol::HiMoxa, 8));
    rig.drive().position = 90_000;
    rig.cycle(follow);
    rig.drive().position = 1_000;
    let setpoints = [(); 3].map(|()| {
        rig.cycle(follow);
        rig.drive().setpoint
    });
    assert_eq!((setpoints, rig.fault()), ([0, 300, 300], None));
}

#[test]
fn a_reference_that_a_drive_keeps_is_a_fault_and_costs_every_other_set_point_at_most() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive {
            status: Status::SYNCHRONIZED,
            keeps_reference: true,
            velocity: 5,
            ..Drive::new(protocol, 8)
        });
        let mut since_setpoint = 0;
        for cycle in 0.. {
            assert!(cycle < 40, "{protocol:?}");
            rig.drive().setpoint = 0;
            rig.cycle(AxisCommand::Seek(raw(protocol, 200)));
            if rig.fault().is_some() {
                break;
            }
            let taken = rig.drive().setpoint == 200;
            since_setpoint = if taken { 0 } else { since_setpoint + 1 };
            assert!(cycle >= 25 || since_setpoint <= 1, "{protocol:?} {cycle}");
        }
        let kept = AxisControllerFault::KeepsReference { cycles: 25 };
        assert_eq!(rig.fault(), Some(kept), "{protocol:?}");
        assert_eq!(rig.drive().setpoint, 0);
    }
}

#[test]
fn a_fault_stays_for_as_long_as_the_drive_reports_it() {
    for protocol in BOTH {
        let mut rig = Rig::on(Drive::new(protocol, 8));
        rig.drive().status = Status::POWER_STAGE_FAULT;
        rig.run(4, AxisCommand::Stand);
        for _ in 0..10 {
            assert!(rig.cycle(AxisCommand::ResetFault).fault.is_some());
        }
        rig.drive().status = 0;
        assert_eq!(rig.run(4, AxisCommand::ResetFault).fault, None);
    }
}
