//! Faults during motion. Each case ends with the arm at rest and the fault named. The motion after the fault stays
//! within the braking distance.

use std::cell::RefCell;
use std::f64::consts::TAU;
use std::rc::Rc;
use std::time::Duration;

use can::candump::Direction;
use can::{Frame, Instant, StandardId};
use canopen::cia402::ModeOfOperation;
use canopen::emcy::Emergency;
use drive::Fault;
use hil::{Device, PlantConfig, PlantFault, WorldFault};
use kit::cell::{Rig, Setup, traced};
use kit::motion::Motion;
use servo::{MAX_AXES, Macrostep, Order, Phase, StopCause};

use crate::watch::Watcher;

/// Longest motion after a fault is latched, rad: braking from full speed at the IRb-6's 1500 rad/s², plus the following
/// error and the elastic deflection of a joint.
const BRAKING: f64 = Motion::VELOCITY * Motion::VELOCITY / (2.0 * 1500.0) + 1.0;

/// The axis and the cause for which an arm that runs `motion` is stopped.
fn fault_of(rig: &mut Rig, motion: &mut Motion) -> (u8, StopCause) {
    let fault = rig.fault_within(Motion::LONGEST, motion, BRAKING);
    (fault.axis.expect("the fault is of an axis"), fault.cause)
}

/// Resets the fault and enables again. Asserts that no motor moves farther than taking up its load requires.
fn resume(rig: &mut Rig) {
    let before = rig.angles();
    rig.order(Order::ResetFault);
    rig.cycle();
    rig.until(Motion::LONGEST, "reset", |rig| rig.phase() == Phase::Off && rig.servo.fault(0).is_none());
    rig.stand_by(Order::Enable);
    for _ in 0..100 {
        rig.cycle();
    }
    for (axis, (before, after)) in before.iter().zip(rig.angles()).enumerate() {
        let jump = (after - before).abs();
        assert!(jump < 0.1, "axis {axis} jumped by {jump:.3} rad");
    }
}

/// The IRb-6 with an obstacle 35 rad above the home position of its column.
fn blocked() -> Setup {
    Setup::of("irb6").with_plant(|axis, plant| {
        if let (0, PlantConfig::Physical(motor)) = (axis, &mut plant.plant) {
            let stops = motor.end_stops.as_mut().expect("the preset has end stops");
            stops.positive = plant.index_angle + 35.0;
        }
    })
}

#[test]
fn a_silent_drive_is_ridden_through_for_as_long_as_the_cell_allows() {
    let mut rig = Setup::of("irb6").bring_up();
    let tolerated = rig.cell.bus[0].tolerated_missing;
    rig.home();
    let mut motion = rig.in_motion();
    for (periods, silent) in [(1, false), (tolerated, false), (tolerated + 1, true)] {
        let missed = rig.missed_answers();
        rig.unplug(2, true);
        for _ in 0..periods {
            rig.feed(&mut motion);
            rig.cycle();
        }
        if silent {
            break;
        }
        rig.unplug(2, false);
        for _ in 0..20 {
            rig.feed(&mut motion);
            rig.cycle();
        }
        assert_eq!(rig.missed_answers() - missed, u64::from(periods));
        assert_eq!(rig.servo.fault(0), None);
        assert_eq!(rig.phase(), Phase::Moving);
    }
    rig.cycle();
    let cycles = tolerated + 1;
    let expected = StopCause::Drive(Fault::Silent { node: 3, cycles });
    let fault = rig.servo.fault(0).expect("one cycle more is a fault");
    assert_eq!((fault.axis, fault.cause), (Some(2), expected));
    // A drive that is plugged in before it misses the host's heartbeat keeps its position and can be enabled again.
    rig.unplug(2, false);
    assert_eq!(fault_of(&mut rig, &mut motion), (2, expected));
    resume(&mut rig);
}

#[test]
fn a_blocked_motor_trips_its_drive() {
    let over_current = blocked();
    let block = over_current.plant;
    let over_current = Setup {
        plant: Box::new(move |axis, plant| {
            block(axis, plant);
            if axis == 0 {
                plant.amplifier.trip_current = 16.0;
            }
        }),
        ..over_current
    };
    // Over-current, and following error.
    for (setup, code) in [(over_current, 0x2310), (blocked(), 0x8611)] {
        let mut rig = setup.bring_up();
        rig.home();
        let mut motion = rig.in_motion();
        let expected = StopCause::Drive(Fault::Drive { node: 1, code });
        assert_eq!(fault_of(&mut rig, &mut motion), (0, expected));
    }
}

#[test]
fn the_servo_sees_a_blocked_motor_that_its_drive_overlooks() {
    let mut setup = blocked();
    let allowed = setup.cell.robot[0].axis[0].following_error;
    let watcher = Watcher::new();
    let watch = watcher.clone();
    setup.port = Box::new(move |port| watch.wrap(port));
    let mut rig = setup.bring_up();
    rig.home();
    // An SDO request widens the window of the drive: 0x6065 of node 1 is 1 000 000 increments.
    let request = StandardId::new(0x601).unwrap();
    let widen = Frame::new(request, &[0x23, 0x65, 0x60, 0, 0x40, 0x42, 0x0F, 0]);
    watcher.lock().foreign.push(widen.unwrap());
    rig.cycle();
    let mut motion = rig.in_motion();
    let (axis, cause) = fault_of(&mut rig, &mut motion);
    // The drive is at its limit of the current, beyond the rated torque.
    let StopCause::Blocked { torque, limit, behind, stands: false } = cause else {
        panic!("{cause}");
    };
    assert_eq!((axis, limit), (0, rig.cell.robot[0].axis[0].drive.as_ref().unwrap().rated_torque));
    assert!(torque > limit, "{torque}");
    let more = Motion::VELOCITY * rig.period.as_secs_f64();
    assert!(behind > allowed && behind < allowed + 2.0 * more, "{behind}");
    resume(&mut rig);
}

#[test]
fn a_mode_of_operation_that_a_service_command_changes_stops_the_arm() {
    let watcher = Watcher::new();
    let watch = watcher.clone();
    let mut setup = Setup::of("irb6");
    setup.port = Box::new(move |port| watch.wrap(port));
    let mut rig = setup.bring_up();
    rig.home();
    let mut motion = rig.in_motion();
    // An SDO request sets 0x6060 of node 2 to 3: profile velocity.
    let request = StandardId::new(0x602).unwrap();
    let change = Frame::new(request, &[0x2F, 0x60, 0x60, 0, 3, 0, 0, 0]);
    watcher.lock().foreign.push(change.unwrap());
    let changed_at = rig.now;
    let expected = StopCause::Drive(Fault::ModeChanged {
        node: 2,
        expected: ModeOfOperation::CyclicSynchronousPosition,
        found: ModeOfOperation::ProfileVelocity,
    });
    for _ in 0..5 {
        rig.feed(&mut motion);
        rig.cycle();
    }
    let fault = rig.servo.fault(0).expect("it shows at once");
    assert_eq!((fault.axis, fault.cause), (Some(1), expected));
    assert!(rig.now.since(changed_at) <= 5 * rig.period);
    assert_eq!(fault_of(&mut rig, &mut motion), (1, expected));
    resume(&mut rig);
}

#[test]
fn refused_set_points_are_dropped_and_never_sent_later() {
    let watcher = Watcher::new();
    let watch = watcher.clone();
    let mut setup = Setup::of("irb6");
    setup.port = Box::new(move |port| watch.wrap(port));
    let mut rig = setup.bring_up();
    rig.home();
    let mut motion = rig.in_motion();
    let (watch, scales) = (watcher.clone(), rig.scales.clone());
    rig.after_cycle = Box::new(move |record| {
        for frame in &watch.lock().taken {
            let Some(axis) = frame
                .standard_data_id()
                .and_then(|id| id.raw().checked_sub(0x201))
                .filter(|&axis| usize::from(axis) < scales.len())
                .map(usize::from)
            else {
                continue;
            };
            let target = i32::from_le_bytes(frame.data()[2..].try_into().unwrap());
            let commanded = scales[axis].increments(record.axis[axis].commanded);
            assert_eq!(Some(target), commanded.map(|increments| increments.0));
        }
    });
    // Number of accepted frames, and the numbers of set-points and SYNCs that are lost as a consequence.
    for (room, set_points, syncs) in [(0, 5, 1), (1, 5, 0), (3, 3, 0), (6, 0, 0)] {
        let before = rig.servo.group_counters().next().unwrap();
        watcher.lock().room = room;
        for _ in 0..2 {
            rig.feed(&mut motion);
            rig.cycle();
        }
        watcher.lock().room = usize::MAX;
        for _ in 0..10 {
            rig.feed(&mut motion);
            rig.cycle();
        }
        let after = rig.servo.group_counters().next().unwrap();
        let dropped = after.dropped_setpoints - before.dropped_setpoints;
        assert_eq!(dropped, 2 * set_points, "room for {room}");
        let dropped = after.dropped_syncs - before.dropped_syncs;
        assert_eq!(dropped, 2 * syncs, "room for {room}");
    }
    rig.follow(&mut motion, |rig| rig.phase() == Phase::Standing);
}

/// A device that sends the host's heartbeat in the host's place.
struct Forger {
    heartbeat: Frame,
    period: Duration,
    next: Instant,
}

impl Device for Forger {
    fn handle(&mut self, _: &Frame, _: Instant) {}

    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        (now >= self.next).then(|| {
            self.next = now + self.period;
            self.heartbeat
        })
    }

    fn poll_timeout(&self) -> Option<Instant> {
        Some(self.next)
    }

    fn handle_timeout(&mut self, _: Instant) {}
}

#[test]
fn drives_whose_host_dies_stop_by_themselves() {
    // Each drive detects the loss by itself and reports it: heartbeat error.
    die(false, 0x8130);
}

#[test]
fn drives_whose_host_dies_stop_although_its_heartbeat_is_forged() {
    // RPDO time-out.
    die(true, 0x8250);
}

/// Lets the host die in motion, and asserts that each drive stops by itself and reports `code`.
fn die(forged: bool, code: u16) {
    let (mut rig, mut trace) = traced(Setup::of("irb6"));
    let emergencies = Rc::new(RefCell::new(Vec::new()));
    let heard = emergencies.clone();
    rig.after_cycle = Box::new(move |_| {
        while let Some(traced) = trace.read() {
            let emergency = Emergency::decode(&traced.frame);
            heard.borrow_mut().extend(emergency.map(|found| (found.node.raw(), found.code)));
        }
    });
    rig.home();
    assert_eq!(*emergencies.borrow(), []);
    let mut motion = rig.in_motion();
    let (watched, nodes) = (rig.heartbeat() * 3, rig.scales.len());
    let died_at = rig.angles();
    if forged {
        let heartbeat = Frame::new(StandardId::new(0x77F).expect("an identifier"), &[0x05]).expect("a frame");
        let period = rig.heartbeat();
        rig.attach(Box::new(Forger { heartbeat, period, next: rig.now + rig.period }));
    }
    let braking = Duration::from_secs_f64(Motion::VELOCITY / 1500.0);
    let end = rig.now + watched + braking;
    while rig.now < end {
        rig.pass();
    }
    let stopped_at = rig.angles();
    for _ in 0..500 {
        rig.pass();
    }
    for axis in 0..nodes {
        let late = (rig.angle(axis) - stopped_at[axis]).abs();
        assert!(late < 0.01, "axis {axis} moved {late:.3} rad late");
        let way = (rig.angle(axis) - died_at[axis]).abs();
        assert!(way < BRAKING, "axis {axis} went on for {way:.2} rad");
    }
    let (_, cause) = fault_of(&mut rig, &mut motion);
    assert!(matches!(cause, StopCause::Drive(_)), "{cause}");
    let expected: Vec<_> = (1..=nodes as u8).map(|node| (node, code)).collect();
    assert_eq!(emergencies.borrow()[..nodes], expected);
    // The drives stayed operational. A reset is therefore sufficient, and the power returns without a jump.
    rig.order(Order::ResetFault);
    rig.until(Duration::from_secs(1), "reset", |rig| rig.servo.fault(0).is_none());
    let before = rig.angles();
    rig.order(Order::Enable);
    rig.until(Duration::from_secs(5), "on again", |rig| rig.phase() == Phase::Standing);
    for (axis, before) in before.into_iter().enumerate() {
        let moved = (rig.angle(axis) - before).abs();
        assert!(moved < 0.1, "axis {axis} moved {moved:.3} rad when it was enabled");
    }
}

/// Name of the case, change of the macrostep, and check of the cause of the refusal.
type BadStep = (&'static str, fn(&mut Macrostep), fn(&StopCause) -> bool);

#[test]
fn what_may_not_be_commanded_never_reaches_the_bus() {
    let bad: [BadStep; 6] = [
        ("NaN", |step| step.position[3] = f64::NAN, |cause| matches!(cause, StopCause::NotFinite)),
        ("endless", |step| step.velocity[0] = f64::INFINITY, |cause| matches!(cause, StopCause::NotFinite)),
        ("beyond", |step| step.position[0] += 8.0, |cause| matches!(cause, StopCause::NoRoomToStop { .. })),
        ("too fast", |step| step.position[4] -= 200.0, |cause| matches!(cause, StopCause::VelocityLimit { .. })),
        (
            "too hard",
            |step| (step.steps, step.position[1]) = (2, step.position[1] + 0.5),
            |cause| matches!(cause, StopCause::AccelerationLimit { .. } | StopCause::VelocityLimit { .. }),
        ),
        ("nothing", |step| step.steps = 0, |cause| matches!(cause, StopCause::Malformed { .. })),
    ];
    let mut setup = Setup::of("irb6");
    let home = setup.cell.robot[0].arm().unwrap().robot().home()[0];
    setup.cell.robot[0].axis[0].max_position = Some(home + 7.0);
    let (mut rig, mut trace) = traced(setup);
    let highest = rig.scales[0].increments(home + 7.0).unwrap().0;
    rig.after_cycle = Box::new(move |record| {
        for axis in record.axis {
            assert!(axis.commanded.is_finite());
        }
        while let Some(traced) = trace.read() {
            let id = traced.frame.standard_data_id().map(|id| id.raw());
            if (id, traced.direction) == (Some(0x201), Direction::Sent) {
                let target = i32::from_le_bytes(traced.frame.data()[2..].try_into().unwrap());
                assert!(target <= highest, "{target} of {highest}");
            }
        }
    });
    rig.home();
    for (name, spoil, expected) in bad {
        let before = rig.last.axis;
        let mut step = Macrostep {
            number: 1,
            steps: 500,
            report_at: 1,
            position: before.map(|axis| axis.commanded),
            velocity: [0.0; MAX_AXES],
            acceleration: None,
            torque: [0.0; MAX_AXES],
            law: None,
            continues_law: false,
        };
        spoil(&mut step);
        rig.order(Order::Move(step));
        rig.until(Motion::LONGEST, name, |rig| rig.servo.fault(0).is_some());
        let cause = rig.servo.fault(0).unwrap().cause;
        assert!(expected(&cause), "{name}: {cause}");
        rig.until(Motion::LONGEST, name, |rig| rig.phase() == Phase::Faulted);
        resume(&mut rig);
    }
}

#[test]
fn a_stop_request_brakes_within_the_limits_and_switches_off() {
    let mut rig = Setup::of("irb6").bring_up();
    rig.home();
    let dt = rig.period.as_secs_f64();
    let limit = rig.cell.robot[0].axis[0].max_acceleration;
    let mut last = [rig.last; 2];
    rig.after_cycle = Box::new(move |record| {
        for axis in 0..5 {
            let [before, now] = last.map(|record| record.axis[axis].commanded);
            let acceleration = (record.axis[axis].commanded - 2.0 * now + before) / (dt * dt);
            assert!(acceleration.abs() <= limit * 1.001, "{acceleration} rad/s²");
        }
        last = [last[1], *record];
    });
    rig.in_motion();
    let start = rig.angles();
    rig.servo.stop_request().request();
    rig.until(Motion::LONGEST, "off", |rig| rig.servo.is_off());
    assert_eq!((rig.phase(), rig.servo.fault(0)), (Phase::Off, None));
    rig.after_cycle = Box::new(|_| {});
    rig.at_rest(&start, BRAKING);
    let count = TAU / 4000.0;
    let measured = rig.last.axis[0].measured;
    assert!((measured - rig.angle(0)).abs() <= 2.0 * count);
}

#[test]
fn after_an_encoder_that_stood_still_in_motion_the_arm_must_be_homed_again() {
    for cell in ["irb6", "irb6-serial"] {
        let mut rig = Setup::of(cell).bring_up();
        rig.home();
        let mut motion = rig.in_motion();
        let fault = WorldFault::Plant { drive: rig.drives[1], fault: PlantFault::EncoderFrozen };
        let in_effect = rig.world.begin_fault(&fault, rig.now);
        let found = rig.fault_within(Motion::LONGEST, &mut motion, 10.0 * BRAKING);
        assert_eq!(found.axis, Some(1), "{cell}: {found}");
        rig.world.end_fault(&in_effect, rig.now);
        rig.order(Order::ResetFault);
        rig.cycle();
        rig.until(Motion::LONGEST, "reset", |rig| rig.phase() == Phase::Off && rig.servo.fault(0).is_none());
        rig.stand_by(Order::Enable);
        assert!(!rig.is_homed(), "{cell}, after {found}");
        rig.stand_by(Order::Home);
        assert!(rig.is_homed(), "{cell}");
    }
}
