//! No cycle of a servo thread uses the heap, however the thread waits.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use kit::allocations::count;
use kit::cell::{Rig, Setup};
use kit::processors;
use servo::thread;
use servo::thread::{CellTime, Realtime, Wait};

#[test]
fn a_servo_thread_does_not_use_the_heap_however_it_waits() {
    let _share = processors::take(0.25);
    const CYCLES: u64 = 500;
    for (cell, wait) in [("irb6", Wait::Hybrid), ("irb6", Wait::Plain), ("irb6-serial", Wait::Hybrid)] {
        let mut rig = Setup::of(cell).bring_up();
        rig.home();
        let Rig { servo, mut world, now, link, .. } = rig;
        let realtime = Realtime {
            wait,
            // Of all the other tests too.
            lock_memory: false,
            ..Realtime::PLAIN
        };
        let used = Arc::new(AtomicU64::new(0));
        let uses = used.clone();
        // Heap use is counted everywhere except in the world that advances after a cycle.
        let mut counted = None;
        let between = move |next| {
            uses.fetch_add(count() - counted.unwrap_or(count()), Ordering::Relaxed);
            world.advance(next);
            counted = Some(count());
        };
        let first = servo.counters().cycles;
        let until = move |servo: &servo::Servo| servo.counters().cycles >= first + CYCLES;
        let finished = thread::run(servo, realtime, CellTime::Nominal(now), between, until).unwrap();
        drop(link);
        assert_eq!(finished.panicked, None);
        assert!(finished.servo.is_off(), "{cell}: {finished:?}");
        assert_eq!(used.load(Ordering::Relaxed), 0, "{cell}, {wait:?}");
    }
}
