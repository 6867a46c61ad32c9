//! Faults: silence, garbage, refusals, the line, resets and the end of the driver.

use super::*;

#[test]
fn silence_beyond_the_tolerance_is_a_fault_within_its_time() {
    let mut rig = Rig::up();
    rig.until(|state| state.scan.number == 1);
    rig.line.script().mute = u32::MAX;
    let begun = rig.now;
    let state = rig.until(|state| state.fault.is_some());
    assert_eq!(state.fault, Some(UltrasonicFault::Silent { queries: 4 }));
    let most = (config().answer_timeout(serial::ultrasonic::Request::Row(0)) + 4 * PERIOD) * 4;
    assert!(rig.now.since(begun) <= most, "{:?} of {most:?}", rig.now.since(begun));
    // The old scan is kept, and is not valid.
    assert!(state.scan.number > 0 && state.measured().is_none());
}

#[test]
fn broken_replies_beyond_the_tolerance_are_garbage() {
    let mut rig = Rig::up();
    rig.line.script().broken = u32::MAX;
    let fault = rig.until(|state| state.fault.is_some()).fault;
    assert!(matches!(fault, Some(UltrasonicFault::Garbage { readings: 4.. })), "{fault:?}");
}

#[test]
fn echoes_after_the_firing_slot_are_garbage() {
    for scan in [ScanKind::Rows, ScanKind::Pairs] {
        let mut rig = Rig::up_with(UltrasonicConfig { scan, ..config() }, Script::new(3));
        rig.line.script().late = u32::MAX;
        let fault = rig.until(|state| state.fault.is_some()).fault;
        assert!(matches!(fault, Some(UltrasonicFault::Garbage { .. })), "{fault:?}");
    }
}

#[test]
fn bytes_between_replies_are_counted_and_tolerated() {
    let mut rig = Rig::up();
    for _ in 0..50 {
        rig.line.script().outbox.extend([0xA5, 0x00, 0x7F]);
        assert_eq!(rig.cycle().fault, None);
    }
    assert!(rig.matrix.sensor_counters().scans > 2);
    assert!(rig.matrix.sensor_counters().garbage >= 100);
}

#[test]
fn a_line_that_is_never_quiet_is_garbage() {
    let mut rig = Rig::up();
    rig.line.script().mute = u32::MAX;
    let state = (0..1_000).find_map(|_| {
        rig.line.script().outbox.extend([0x00, 0x7F]);
        Some(rig.cycle()).filter(|state| state.fault.is_some())
    });
    let fault = state.and_then(|state| state.fault);
    assert!(matches!(fault, Some(UltrasonicFault::Garbage { .. })), "{fault:?}");
}

#[test]
fn a_reset_in_a_scan_begins_the_next_scan_with_its_first_query() {
    let mut rig = Rig::up();
    rig.line.script().mute = 4;
    rig.until(|state| state.fault.is_some());
    // A later row of a scan is under way.
    while !matches!(rig.line.script().heard.last().map(|body| &body[..]), Some([3, 1..=9])) {
        rig.cycle();
    }
    rig.line.script().heard.clear();
    rig.link.reset_fault();
    rig.until(|state| state.fault.is_none());
    let rows: Vec<_> = rig.line.script().heard.iter().map(|body| body[1]).collect();
    assert_eq!(rows[..3], [0, 1, 2]);
}

#[test]
fn refusals_and_a_lost_line_are_faults_at_once() {
    let mut rig = Rig::up();
    rig.line.script().refusal = Some(3);
    let state = rig.until(|state| state.fault.is_some());
    assert_eq!(state.fault, Some(UltrasonicFault::Refused { command: 3, reason: 3 }));
    let mut rig = Rig::up();
    rig.line.script().gone = true;
    assert_eq!(rig.run(1).fault, Some(UltrasonicFault::Line(LineError::Gone)));
}

#[test]
fn a_reset_ends_a_fault_with_the_next_scan() {
    let mut rig = Rig::up();
    rig.line.script().mute = 4;
    let fault = rig.until(|state| state.fault.is_some()).fault;
    // Without a request the fault stays.
    assert_eq!(rig.run(100).fault, fault);
    let scan = rig.link.read().scan.number;
    rig.link.reset_fault();
    assert_eq!(rig.run(3).fault, fault);
    let state = rig.until(|state| state.fault.is_none());
    assert_eq!((state.scan.number, state.scan.ended), (scan + 1, state.at));
    assert!(state.measured().is_some());
    // A fault that persists is latched again.
    rig.line.script().mute = u32::MAX;
    rig.until(|state| state.fault.is_some());
    rig.link.reset_fault();
    let state = rig.run(500);
    assert_eq!(state.fault, Some(UltrasonicFault::Silent { queries: 4 }));
}

#[test]
fn the_scan_of_a_driver_that_ended_is_not_valid() {
    let mut rig = Rig::up();
    rig.until(|state| state.scan.number == 1);
    let link = rig.link.clone();
    drop(rig);
    assert_eq!(link.read().fault, Some(UltrasonicFault::Ended));
}
