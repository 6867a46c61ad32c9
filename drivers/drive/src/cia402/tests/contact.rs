//! A contact of the emergency stop at a digital input of a drive.

use std::time::Duration;

use super::bench::*;
use crate::EmergencyStop;
use crate::cia402::{AxisConfig, GroupConfig};

const STAND: [AxisCommand; 2] = [AxisCommand::Stand; 2];
const CLOSED: &str = "382#0000010000";

/// Two drives, of which node 2 has the contact at bit 16, with these inputs at bring-up.
fn bench(inputs: [u8; 4]) -> Bench {
    bench_with(group_config(), inputs)
}

fn bench_with(config: GroupConfig, inputs: [u8; 4]) -> Bench {
    let contact = AxisConfig { emergency_input: Some(16), ..axis_config(2) };
    let mut bench = Bench::new(config, &[axis_config(1), contact]);
    bench.stores[1].put(0x60FD, 0, &inputs);
    (0..=3).for_each(|subindex| bench.stores[1].put(0x1A02, subindex, if subindex == 0 { &[1] } else { &[0; 4] }));
    bench
}

fn up() -> Bench {
    let mut bench = bench([0, 0, 1, 0]);
    assert_eq!(bench.bring_up(), Ok(()));
    bench
}

fn cycle(bench: &mut Bench, inputs: &[&str]) -> Option<EmergencyStop> {
    let mut answers = bench.answers(0x0740, 1_000);
    answers.extend(inputs.iter().map(|text| (*text).to_owned()));
    bench.cycle(&answers, &STAND);
    bench.group.emergency_stop()
}

fn stop(known: bool) -> Option<EmergencyStop> {
    Some(EmergencyStop { node: 2, input: 16, known })
}

#[test]
fn an_open_contact_demands_a_stop_until_it_is_closed() {
    let mut bench = up();
    assert_eq!(bench.group.emergency_stop(), None, "bring-up read a closed contact");
    assert_eq!(cycle(&mut bench, &["382#00000100"]), None);
    assert_eq!(cycle(&mut bench, &["382#FFFFFEFF"]), stop(true), "every other input is set");
    assert_eq!(cycle(&mut bench, &["382#00000100"]), None);
    // A frame of another length, and the inputs of a drive without a contact, are unexpected.
    let before = bench.group.counters().unexpected;
    assert_eq!(cycle(&mut bench, &[CLOSED, "381#00000100"]), None);
    assert_eq!(bench.group.counters().unexpected, before + 2);
}

#[test]
fn a_contact_that_is_open_at_bring_up_demands_a_stop_at_once() {
    let mut bench = bench([0xFF, 0xFF, 0xFE, 0xFF]);
    assert_eq!(bench.bring_up(), Ok(()));
    assert_eq!(bench.group.emergency_stop(), stop(true));
}

#[test]
fn a_level_that_is_not_known_demands_a_stop() {
    let mut bench = up();
    cycle(&mut bench, &["382#00000100"]);
    // Two missing frames are tolerated.
    let stops: Vec<_> = (0..4).map(|_| cycle(&mut bench, NONE)).collect();
    assert_eq!(stops, [None, None, stop(false), stop(false)]);
    assert_eq!(cycle(&mut bench, &["382#00000100"]), None);
    // A drive that left the state operational, and is back.
    assert_eq!(cycle(&mut bench, &["382#00000100", "702#7F"]), stop(false));
    assert_eq!(cycle(&mut bench, &["382#00000100", "702#05"]), None);
    // A drive that booted may send its inputs before it is configured.
    assert_eq!(cycle(&mut bench, &["382#00000100", "702#00"]), stop(false));
    assert_eq!(cycle(&mut bench, &["382#00000100"]), stop(false));
}

#[test]
fn the_level_is_not_known_during_the_recovery_of_the_drive() {
    let config = GroupConfig { heartbeat_period: Duration::from_millis(10), ..group_config() };
    let mut bench = bench_with(config, [0, 0, 1, 0]);
    assert_eq!(bench.bring_up(), Ok(()));
    let inputs_alone = |bench: &mut Bench, command| {
        bench.cycle(&["181#4007E80300000000", "382#00000100"], &[AxisCommand::Off, command]);
        (bench.states[1].recovering, bench.group.emergency_stop())
    };
    // No answer and no heartbeat for longer than 30 ms.
    (0..20).for_each(|_| _ = inputs_alone(&mut bench, AxisCommand::Off));
    assert_eq!(inputs_alone(&mut bench, AxisCommand::ResetFault), (false, None));
    assert_eq!(inputs_alone(&mut bench, AxisCommand::ResetFault), (true, stop(false)));
}

#[test]
fn the_inputs_are_sent_at_every_sync_and_a_drive_that_cannot_is_refused() {
    let mut bench = up();
    let objects = |bench: &Bench, subindex| bench.stores[1].objects[&(0x1A02, subindex)].clone();
    assert_eq!((objects(&bench, 0), objects(&bench, 1)), (vec![1], vec![0x20, 0, 0xFD, 0x60]));
    let of = |bench: &Bench, subindex| bench.stores[1].objects[&(0x1802, subindex)].clone();
    assert_eq!((of(&bench, 1), of(&bench, 2)), (vec![0x82, 0x03, 0, 0x40], vec![1]));
    bench = self::bench([0, 0, 1, 0]);
    bench.stores[1].aborts.insert((0x1A02, 1), 0x0604_0041);
    let refused = bench.bring_up().unwrap_err();
    assert_eq!(
        refused.to_string(),
        "node 2: 0x1a02:01 refused 0x60fd0020: 0x06040041 (object cannot be mapped to the PDO)"
    );
    bench = self::bench([0, 0, 1, 0]);
    bench.stores[1].objects.remove(&(0x60FD, 0));
    let refused = bench.bring_up().unwrap_err();
    assert!(refused.to_string().starts_with("node 2: 0x60fd:00 refused"), "{refused}");
}
