//! A bus that takes no frame of the host in motion, and two controllers on one bus, in virtual time.

use std::sync::{Arc, Mutex};
use std::task::Poll;
use std::time::Duration;

use can::candump::Direction;
use can::{Frame, Instant, StandardId, TraceReader};
use canopen::cob;
use drive::bus::Sign;
use drive::{BringUpError, DriveGroup, Fault};
use hil::{Device, HostFault, WorldFault};
use kit::cell::{Rig, Setup, traced};
use kit::motion::Motion;
use servo::{Order, Phase, StopCause};

/// Distance that a motor may move after the release of the bus, rad: the power goes, and the brake takes the load. A drive
/// that acts on an old set-point moves back from the end of its quick stop, by 0.8 rad.
const STANDS: f64 = 0.3;

/// All frames on the bus, with the times at which they ended.
#[derive(Clone, Default)]
struct Heard(Arc<Mutex<Vec<(Instant, Frame)>>>);

struct Listener(Heard);

impl Device for Listener {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        self.0.0.lock().unwrap().push((now, *frame));
    }
    fn poll_transmit(&mut self, _: Instant) -> Option<Frame> {
        None
    }
    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
    fn handle_timeout(&mut self, _: Instant) {}
}

/// A frame of the host: when the port took it, and when it was on the bus.
#[derive(Clone, Copy, Debug)]
struct Sent {
    taken: Instant,
    on_bus: Instant,
    frame: Frame,
}

impl Sent {
    fn is_sync(&self) -> bool {
        self.frame.standard_data_id() == Some(cob::SYNC)
    }

    /// Node and controlword of a set-point.
    fn setpoint(&self) -> Option<(u16, u16)> {
        let node = self.frame.standard_data_id()?.raw().checked_sub(0x200)?;
        (1..=127).contains(&node).then(|| (node, u16::from_le_bytes([self.frame.data()[0], self.frame.data()[1]])))
    }

    fn is_motion(&self) -> bool {
        self.is_sync() || self.setpoint().is_some()
    }
}

/// Frames that the host sent since the last call.
fn taken(trace: &mut TraceReader) -> Vec<(Instant, Frame)> {
    let traced = std::iter::from_fn(|| trace.read());
    traced.filter(|it| it.direction == Direction::Sent).map(|it| (it.at, it.frame)).collect()
}

/// Pairs the frames of the host in the order of sending. The bus keeps this order.
fn paired(taken: &[(Instant, Frame)], heard: &Heard) -> Vec<Sent> {
    let from_host = |id: StandardId| id == cob::SYNC || matches!(id.raw(), 0x201..=0x27F | 0x601..=0x67F | 0x77F);
    let heard = heard.0.lock().unwrap();
    let heard = heard.iter().filter(|(_, frame)| frame.standard_data_id().is_some_and(from_host));
    let pair = |(&(taken, frame), &(on_bus, same)): (&(Instant, Frame), &(Instant, Frame))| {
        assert_eq!(frame, same, "taken at {taken:?}, on the bus at {on_bus:?}");
        Sent { taken, on_bus, frame }
    };
    taken.iter().zip(heard).map(pair).collect()
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
fn after_a_bus_without_acknowledge_no_drive_acts_on_an_old_set_point() {
    for held in [100, 1_000, 10_000].map(Duration::from_millis) {
        let (mut rig, mut trace) = traced(Setup::of("irb6"));
        rig.home();
        let mut motion = rig.in_motion();
        taken(&mut trace);
        let heard = Heard::default();
        rig.attach(Box::new(Listener(heard.clone())));
        let fault = WorldFault::Host { bus: rig.bus(), fault: HostFault::Unacknowledged };
        let (began, mut all) = (rig.now, Vec::new());
        let in_effect = rig.world.begin_fault(&fault, rig.now);
        while rig.now < began + held {
            if rig.servo.fault(0).is_none() {
                rig.feed(&mut motion);
            }
            rig.cycle();
            all.extend(taken(&mut trace));
            let tolerated = rig.cell.bus[0].tolerated_missing;
            let late = rig.now > began + rig.period * (tolerated + 3);
            assert!(!late || rig.servo.fault(0).is_some(), "no fault after {:?}", rig.now.since(began));
        }
        let cause = rig.servo.fault(0).unwrap().cause;
        assert!(matches!(cause, StopCause::Drive(Fault::NotAcknowledged { .. })), "{held:?}: {cause}");
        let (released, stood) = (rig.now, rig.angles());
        rig.world.end_fault(&in_effect, released);
        for _ in 0..250 {
            rig.cycle();
            all.extend(taken(&mut trace));
        }
        let sent = paired(&all, &heard);
        let motion_frames: Vec<_> = sent.iter().filter(|it| it.is_motion() && it.on_bus > released).collect();
        // The frames that the controller of the host held, which no host can take back: one cycle at most.
        let old = motion_frames.iter().take_while(|it| it.on_bus.since(it.taken) > rig.period).count();
        assert!(
            motion_frames[..old].iter().all(|it| it.taken == motion_frames[0].taken),
            "{held:?}: {motion_frames:?}"
        );
        assert!(old <= 1 + stood.len(), "{held:?}: {old} old frames");
        let newer = &motion_frames[old..];
        let late = newer.iter().find(|it| it.on_bus.since(it.taken) > rig.period);
        assert!(late.is_none(), "{held:?}: {late:?}");
        // Before the next SYNC, an order to stop or to switch off replaces each old set-point.
        let before_sync: Vec<_> = newer.iter().map_while(|it| it.setpoint()).collect();
        assert_eq!(before_sync.len(), stood.len(), "{held:?}: {newer:?}");
        for (node, word) in before_sync {
            assert_ne!(word & 0x0F, 0x0F, "{held:?}: node {node} is enabled by {word:#06x}");
        }
        for (axis, (before, after)) in stood.iter().zip(rig.angles()).enumerate() {
            let moved = (after - before).abs();
            // After 0.1 s the drives have not missed the host yet, and still brake.
            let stands = moved < STANDS || held < Duration::from_secs(1);
            assert!(stands, "{held:?}: axis {axis} moved by {moved:.3} rad after the release");
        }
        resume(&mut rig);
    }
}

#[test]
fn a_full_queue_is_told_from_a_bus_without_acknowledge() {
    let mut rig = Setup::of("irb6").bring_up();
    rig.home();
    let mut motion = rig.in_motion();
    let fault = WorldFault::Host { bus: rig.bus(), fault: HostFault::QueueFull };
    let in_effect = rig.world.begin_fault(&fault, rig.now);
    while rig.servo.fault(0).is_none() {
        rig.feed(&mut motion);
        rig.cycle();
    }
    let cause = rig.servo.fault(0).unwrap().cause;
    assert!(matches!(cause, StopCause::Drive(Fault::NotSent { .. })), "{cause}");
    rig.world.end_fault(&in_effect, rig.now);
    resume(&mut rig);
}

#[test]
fn of_two_controllers_on_one_bus_the_second_is_refused_and_sends_nothing() {
    let mut rig = Setup::of("irb6").bring_up();
    rig.home();
    let mut motion = rig.in_motion();
    let mut second = rig.another_controller();
    let refused = loop {
        rig.feed(&mut motion);
        rig.cycle();
        if let Poll::Ready(result) = second.bring_up(rig.now) {
            break result;
        }
    };
    assert_eq!(refused, Err(BringUpError::OtherController { sign: Sign::Sync }));
    assert_eq!(second.counters().port.sent, 0);
    for _ in 0..50 {
        rig.feed(&mut motion);
        rig.cycle();
    }
    assert_eq!(rig.servo.fault(0), None, "the first controller goes on");
}

#[test]
fn of_two_controllers_that_start_at_once_not_both_come_up() {
    for later in [0, 1, 10, 300] {
        let mut rig = Setup::of("irb6").bring_up();
        let [mut one, mut other] = [rig.another_controller(), rig.another_controller()];
        let mut results = [Poll::Pending, Poll::Pending];
        for cycle in 0..5_000 {
            for (number, (controller, result)) in [&mut one, &mut other].into_iter().zip(&mut results).enumerate() {
                if result.is_pending() && cycle >= number * later {
                    *result = controller.bring_up(rig.now);
                }
            }
            rig.pass();
            if results.iter().all(Poll::is_ready) {
                break;
            }
        }
        let up = results.iter().filter(|result| **result == Poll::Ready(Ok(()))).count();
        assert!(up <= 1, "{later}: {results:?}");
        let refused = |it: &&Poll<_>| matches!(it, Poll::Ready(Err(BringUpError::OtherController { .. })));
        assert!(results.iter().any(|it| refused(&it)), "{later}: {results:?}");
    }
}
