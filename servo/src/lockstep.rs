//! The servo in virtual time: one thread and a fixed order of calls make every run identical.

use can::Instant;
use std::task::Poll;

use crate::{NotUp, Servo};

/// Polls the bring-up of every drive group once per period, from `start` on. After each poll, `between` is called with
/// the time of the next poll. Returns the time of the first cycle.
///
/// Every wait in the bring-up of a group has a time limit. A stop request ends the bring-up at the next poll.
pub fn bring_up(servo: &mut Servo, start: Instant, mut between: impl FnMut(Instant)) -> Result<Instant, NotUp> {
    let mut now = start;
    loop {
        let progress = servo.bring_up(now);
        now += servo.period();
        between(now);
        if let Poll::Ready(result) = progress {
            return result.map(|()| now);
        }
    }
}

/// Runs cycles from `start` on until `until` returns true, and returns the time of the next cycle.
///
/// Each cycle calls `until(servo, now)`, [`Servo::step`], `controller(now)` and `between(next)`, in this order.
/// `between` advances the emulated world to the time of the next cycle. `run` does not stop a motion in progress.
pub fn run(
    servo: &mut Servo,
    start: Instant,
    mut controller: impl FnMut(Instant),
    mut between: impl FnMut(Instant),
    mut until: impl FnMut(&Servo, Instant) -> bool,
) -> Instant {
    let mut now = start;
    while !until(servo, now) {
        servo.step(now);
        controller(now);
        now += servo.period();
        between(now);
    }
    now
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use drive::Homing;

    use super::*;
    use crate::{MAX_AXES, Macrostep, Order, Phase, Record, scripted};

    /// Brings up a servo, moves its effector back and forth, and requests a stop. Returns all records.
    fn run_once() -> Vec<Record> {
        let (group, world) = scripted::group(2);
        for drive in &mut world.lock().unwrap().axes {
            drive.state.homing = Homing::Attained;
        }
        let (mut servo, mut links) = Servo::new(&scripted::config(2), vec![group]).unwrap();
        let mut records = servo.record(1000);
        let start = Instant::from_nanos(5);
        let first = bring_up(&mut servo, start, |_| {}).unwrap();
        assert_eq!(first, start + scripted::PERIOD);
        let orders = &mut links[0].orders;
        orders.push(Order::Enable).unwrap();
        let stop = servo.stop_request();
        let (at, mut number) = (Cell::new(first), 0);
        let end = run(
            &mut servo,
            first,
            |now| {
                assert_eq!(at.get(), now, "the controller runs in the cycle's time");
                number += 1;
                let position = [0.01 * (number % 2) as f64; MAX_AXES];
                let velocity = [0.0; MAX_AXES];
                let macrostep = Macrostep {
                    number,
                    steps: 10,
                    report_at: 5,
                    position,
                    velocity,
                    acceleration: None,
                    torque: [0.0; MAX_AXES],
                    law: None,
                    continues_law: false,
                };
                let _ = orders.push(Order::Move(macrostep));
                if number == 200 {
                    stop.request();
                }
            },
            |next| {
                assert_eq!(next, at.get() + scripted::PERIOD);
                at.set(next);
            },
            |servo, now| now > first + 100 * scripted::PERIOD && servo.is_off(),
        );
        assert_eq!(end, at.get());
        std::iter::from_fn(|| records.pop().ok()).collect()
    }

    #[test]
    fn two_runs_are_equal_record_by_record() {
        let (one, two) = (run_once(), run_once());
        assert!(one.iter().any(|record| record.phase == Phase::Moving));
        assert_eq!(one.last().unwrap().phase, Phase::Off);
        assert_eq!(one, two);
    }
}
