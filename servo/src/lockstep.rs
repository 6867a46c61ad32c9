//! The servo in virtual time: one thread and a fixed order of calls make every run identical.

use can::Instant;
use std::task::Poll;

use crate::{NotUp, Servo};

/// Polls the bring-up of every group once a period from `start` on. After each poll, `between` is called with the time
/// of the next one. Returns the time at which the first cycle is due.
///
/// The function ends because every wait inside a group's bring-up ends. A stop request ends it at once.
pub fn bring_up(
    servo: &mut Servo,
    start: Instant,
    mut between: impl FnMut(Instant),
) -> Result<Instant, NotUp> {
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
/// A cycle consists of, in this order: `until(servo, now)`, [`Servo::step`], `controller(now)`, and `between(next)`,
/// which advances the emulated world to the time of the next cycle. The caller has to let a motion end before the run
/// ends.
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

    /// Brings up a cell, moves the effector back and forth, and stops it. Returns all records.
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
                    torque: [0.0; MAX_AXES],
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
