//! No servo cycle uses the heap. [`Rig::servo_cycle`] asserts it in every cycle of every test that steps a robot. The
//! tests here cause the situations that no other test causes. The coverage of this proof is described in
//! `clock/cycle_calls.rs`.

use can::{ControllerState, Tracer};
use drive::Fault;
use drive::axis_controller::AxisControllerFault;
use hil::{LineFaults, Stuck, WireFaults};
use kit::allocations::count;
use kit::cell::{Rig, Setup};
use kit::motion::Motion;
use servo::{MAX_AXES, Macrostep, Order, Phase, StopCause};

use crate::watch::Watcher;

/// Name, cell, event during the motion, and check of the cause that the servo reports; `None` if the arm brakes without
/// a fault.
type Case = (&'static str, &'static str, fn(&mut Rig, &Watcher), fn(Option<StopCause>) -> bool);

/// Queues a macrostep that violates the limits.
fn beyond_every_limit(rig: &mut Rig, _: &Watcher) {
    rig.order(Order::Stop);
    rig.until(Motion::LONGEST, "standing", |rig| rig.phase() == Phase::Standing);
    rig.order(Order::Move(Macrostep {
        number: 1,
        steps: 1,
        report_at: 1,
        position: [1e6; MAX_AXES],
        velocity: [0.0; MAX_AXES],
        acceleration: None,
        torque: [0.0; MAX_AXES],
        law: None,
        continues_law: false,
    }));
}

fn hang(rig: &mut Rig, _: &Watcher) {
    let wire = WireFaults { stuck: Some(Stuck::Silent), ..WireFaults::default() };
    let faults = LineFaults { seed: 1, to_device: wire, to_host: wire, ..LineFaults::default() };
    rig.set_line_faults(2, &faults);
}

fn miss(rig: &mut Rig, _: &Watcher) {
    rig.servo.missed(rig.cell.max_missed_in_row + 1);
}

#[test]
fn nothing_that_ends_a_motion_uses_the_heap() {
    use StopCause as Cause;
    let cases: [Case; 10] = [
        ("missed deadlines", "irb6", miss, |cause| matches!(cause, Some(Cause::Overrun { .. }))),
        ("missed deadlines", "irb6-serial", miss, |cause| matches!(cause, Some(Cause::Overrun { .. }))),
        (
            "bus off",
            "irb6",
            |_, watcher| watcher.lock().state = Some(ControllerState::BusOff),
            |cause| matches!(cause, Some(Cause::Drive(Fault::BusOff))),
        ),
        (
            "a bus that takes nothing",
            "irb6",
            |_, watcher| watcher.lock().room = 0,
            |cause| matches!(cause, Some(Cause::Drive(Fault::NotSent { .. }))),
        ),
        (
            "a silent drive",
            "irb6",
            |rig, _| rig.unplug(2, true),
            |cause| matches!(cause, Some(Cause::Drive(Fault::Silent { .. }))),
        ),
        ("a hung line", "irb6-serial", hang, |cause| {
            matches!(cause, Some(Cause::Drive(Fault::AxisController { fault: AxisControllerFault::Silent { .. }, .. })))
        }),
        ("a limit", "irb6", beyond_every_limit, |cause| matches!(cause, Some(Cause::PositionLimit { .. }))),
        ("a limit", "irb6-serial", beyond_every_limit, |cause| matches!(cause, Some(Cause::PositionLimit { .. }))),
        ("a stop", "irb6", |rig, _| rig.servo.stop_request().request(), |cause| cause.is_none()),
        ("a stop", "irb6-serial", |rig, _| rig.servo.stop_request().request(), |cause| cause.is_none()),
    ];
    for (what, cell, happen, expected) in cases {
        let watcher = Watcher::new();
        let watch = watcher.clone();
        let mut setup = Setup::of(cell);
        // The trace counts frames beyond its capacity.
        setup.port = Box::new(move |port| watch.wrap(Tracer::new(port, 1 << 12).0));
        let mut rig = setup.bring_up();
        rig.home();
        let mut motion = rig.in_motion();
        rig.servo.missed(1);
        rig.feed(&mut motion);
        rig.cycle();
        assert_eq!(rig.phase(), Phase::Moving, "{cell}: {what}");
        happen(&mut rig, &watcher);
        rig.until(Motion::LONGEST, what, |rig| matches!(rig.phase(), Phase::Faulted | Phase::Off));
        let cause = rig.servo.fault(0).map(|fault| fault.cause);
        assert!(expected(cause), "{cell}: {what}: {cause:?}");
    }
}

#[test]
fn the_heap_is_counted() {
    let before = count();
    drop(std::hint::black_box(Box::new(1)));
    assert_eq!(count() - before, 2);
}
