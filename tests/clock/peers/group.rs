//! Independent drives in this project's drive group: switched on, homed, moved and switched off.

use std::time::Duration;

use can::{SocketCanOptions, SocketCanPort, clock};
use drive::bus::CanBus;
use drive::cia402::{AxisConfig, GroupConfig};
use drive::{AxisCommand, AxisState, DriveGroup, Finite, Homing, Power, Setpoint};

use super::host::PATIENCE;
use crate::vcan::Stage;

/// Runs drives with the configuration of the cell's first axis. Each entry of `changes` modifies one drive. The drives
/// reach set-points at once.
pub(super) fn run_as_drives(stage: &Stage, changes: &[&dyn Fn(&mut AxisConfig)]) {
    // Long time limits, because a Python process shares the processor.
    let config = GroupConfig { period: Duration::from_millis(20), tolerated_missing: 50, ..stage.cell.group_config(0) };
    let axis = |change: &&dyn Fn(&mut AxisConfig)| {
        let mut axis = stage.cell.robot[0].axis[0].drive_config(0.0);
        change(&mut axis);
        axis
    };
    let axes: Vec<_> = changes.iter().map(axis).collect();
    let port = SocketCanPort::open(stage.interface, &SocketCanOptions::default()).unwrap();
    let period = config.period;
    let mut group = CanBus::new(port, config, &axes).unwrap();
    let mut now = clock::now();
    let end = now + PATIENCE;
    while group.bring_up(now).map(Result::unwrap).is_pending() {
        assert!(now < end, "not up");
        now += Duration::from_millis(1);
        clock::sleep_until(now);
    }
    let mut states = vec![AxisState::default(); axes.len()];
    let mut cycles = |command: &dyn Fn(usize) -> AxisCommand, done: &dyn Fn(&AxisState) -> bool| {
        let mut now = clock::now();
        for cycle in 0..500 {
            group.read(now, &mut states);
            let faulted = states.iter().any(|state| state.fault.is_some());
            assert!(!faulted, "{states:?}");
            if states.iter().all(done) {
                return states.clone();
            }
            group.write(now, &vec![command(cycle); states.len()]);
            group.send(now);
            now += period;
            clock::sleep_until(now);
        }
        panic!("not reached: {states:?}");
    };
    cycles(&|_| AxisCommand::Stand, &|state| state.power == Power::On);
    let homed = cycles(&|_| AxisCommand::Home, &|state| state.homing == Homing::Attained);
    assert!(homed.iter().all(|state| state.increments.0 == 0));
    // One turn up, then half a turn back. Each drive reaches its set-point to an increment.
    let way = |cycle: usize| {
        let turn = std::f64::consts::TAU;
        let after = cycle as f64 / 100.0;
        turn * if after < 1.0 { after } else { (2.0 - after).max(0.5) }
    };
    let follow = |cycle| AxisCommand::Follow(Setpoint::Position(Finite::new(way(cycle)).unwrap()));
    let drive = stage.cell.robot[0].axis[0].drive.as_ref().unwrap();
    let counts = i64::from(drive.counts_per_revolution);
    let full = |state: &AxisState| i64::from(state.increments.0) == counts;
    cycles(&|cycle| follow(cycle.min(100)), &full);
    let stood = cycles(&|cycle| follow(cycle + 100), &|state| i64::from(state.increments.0) == counts / 2);
    assert!(stood.iter().all(|state| state.following));
    cycles(&|_| AxisCommand::Off, &|state| state.power == Power::Off);
    let counters = group.counters();
    assert_eq!((counters.unexpected, counters.dropped_syncs), (0, 0), "{counters:?}");
}
