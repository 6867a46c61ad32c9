//! An adapter that holds the frames of the host in motion and sends them later, in virtual time.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use can::{Frame, Instant};
use canopen::cia402::{PowerState, Statusword};
use hil::{Device, HostFault, LineFaults, WorldFault};
use kit::cell::{Rig, Setup};
use kit::motion::Motion;
use servo::{Order, Phase};

/// Durations of a hold, ms: longer than the missing answers that the cells tolerate.
const HOLDS: [u64; 10] = [14, 20, 30, 50, 100, 200, 290, 350, 500, 1_000];

/// Distance of an ordinary stop from [`Motion::VELOCITY`], rad: a quick stop with 1500 rad/s², and the periods until it
/// begins.
const STOP: f64 = Motion::VELOCITY * (Motion::VELOCITY / 3_000.0 + 0.008);

/// TPDO 1 of all drives: time, node and power state.
#[derive(Clone, Default)]
struct Answers(Arc<Mutex<Vec<(Instant, u16, PowerState)>>>);

impl Device for Answers {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        let node = frame.standard_data_id().and_then(|id| id.raw().checked_sub(0x180));
        if let (Some(node @ 1..=127), [low, high, ..]) = (node, frame.data()) {
            let state = Statusword(u16::from_le_bytes([*low, *high])).power_state();
            self.0.lock().unwrap().push((now, node, state));
        }
    }
    fn poll_transmit(&mut self, _: Instant) -> Option<Frame> {
        None
    }
    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
    fn handle_timeout(&mut self, _: Instant) {}
}

impl Answers {
    /// The first drive that was enabled after `since`: it showed another state before.
    fn enabled_after(&self, since: Instant) -> Option<(Instant, u16)> {
        let answers = self.0.lock().unwrap();
        let later = answers
            .iter()
            .enumerate()
            .filter(|(_, (at, _, state))| *at > since && *state == PowerState::OperationEnabled);
        later.map(|(index, (at, node, _))| (&answers[..index], *at, *node)).find_map(|(before, at, node)| {
            let (.., state) = before.iter().rev().find(|(_, other, _)| *other == node)?;
            (*state != PowerState::OperationEnabled).then_some((at, node))
        })
    }
}

/// Holds the frames of the host in motion, and releases them. Returns the rig, the time of the release, and the angles at
/// that time.
fn hold(rig: &mut Rig, fault: &WorldFault, held: Duration) -> (Instant, Vec<f64>) {
    rig.home();
    let mut motion = rig.in_motion();
    let end = rig.now + held;
    let in_effect = rig.world.begin_fault(fault, rig.now);
    while rig.now < end {
        if rig.servo.fault(0).is_none() {
            rig.feed(&mut motion);
        }
        rig.cycle();
    }
    rig.world.end_fault(&in_effect, rig.now);
    (rig.now, rig.angles())
}

/// Greatest distance of a motor from `start` within the next half second, rad.
fn travel(rig: &mut Rig, start: &[f64]) -> f64 {
    let mut greatest: f64 = 0.0;
    for _ in 0..250 {
        rig.cycle();
        let angles = rig.angles();
        greatest = angles.iter().zip(start).map(|(angle, start)| (angle - start).abs()).fold(greatest, f64::max);
    }
    greatest
}

/// Resets the fault and enables again. Asserts that no motor moves farther than taking up its load requires.
fn resume(rig: &mut Rig) {
    rig.until(Motion::LONGEST, "stopped", |rig| rig.phase() == Phase::Faulted);
    rig.order(Order::ResetFault);
    rig.cycle();
    rig.until(Motion::LONGEST, "reset", |rig| rig.phase() == Phase::Off && rig.servo.fault(0).is_none());
    let before = rig.angles();
    rig.stand_by(Order::Enable);
    for _ in 0..100 {
        rig.cycle();
    }
    for (axis, (before, after)) in before.iter().zip(rig.angles()).enumerate() {
        assert!((after - before).abs() < 0.1, "axis {axis} jumped by {:.3} rad", after - before);
    }
}

#[test]
fn no_drive_acts_on_frames_that_an_adapter_held() {
    for held in HOLDS.map(Duration::from_millis) {
        let mut rig = Setup::of("irb6").bring_up();
        let answers = Answers::default();
        rig.attach(Box::new(answers.clone()));
        let fault = WorldFault::Host { bus: rig.bus(), fault: HostFault::Held };
        let (released, angles) = hold(&mut rig, &fault, held);
        let travel = travel(&mut rig, &angles);
        assert_eq!(answers.enabled_after(released), None, "{held:?}");
        assert!(travel < STOP, "{held:?}: {travel:.3} rad after the release");
        assert!(rig.servo.fault(0).is_some());
        resume(&mut rig);
    }
}

#[test]
fn set_points_of_at_most_two_cycles_wait_in_an_adapter() {
    let mut rig = Setup::of("irb6").bring_up();
    let counter = |rig: &Rig| rig.servo.group_counters().next().unwrap();
    rig.home();
    let mut motion = rig.in_motion();
    let before = counter(&rig);
    let fault = WorldFault::Host { bus: rig.bus(), fault: HostFault::Held };
    let in_effect = rig.world.begin_fault(&fault, rig.now);
    // A hold within the tolerated number: the motion stands meanwhile, and goes on without a step.
    let tolerated = rig.cell.bus[0].tolerated_missing;
    for _ in 0..tolerated {
        rig.feed(&mut motion);
        rig.cycle();
    }
    rig.world.end_fault(&in_effect, rig.now);
    let after = counter(&rig);
    assert_eq!(after.dropped_setpoints - before.dropped_setpoints, 5 * u64::from(tolerated - 2));
    rig.follow(&mut motion, |rig| rig.phase() == Phase::Standing);
    assert_eq!(rig.servo.fault(0), None);
}

#[test]
fn no_drive_on_a_serial_line_moves_on_telegrams_that_an_adapter_held() {
    for cell in ["irb6-serial", "irb6-hi-moxa"] {
        for held in HOLDS.map(Duration::from_millis) {
            let mut rig = Setup::of(cell).bring_up();
            let hil::DriveId::Line(line) = rig.drives[0] else { panic!("{cell} is on serial lines") };
            let fault = WorldFault::Line { line, faults: LineFaults { held: true, ..LineFaults::default() } };
            let (_, angles) = hold(&mut rig, &fault, held);
            let travel = travel(&mut rig, &angles);
            assert!(travel < STOP, "{cell} {held:?}: {travel:.3} rad after the release");
            assert!(rig.servo.fault(0).is_some());
        }
    }
}
