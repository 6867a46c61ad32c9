//! The servo thread has no page fault while another process takes memory: its memory is locked.
//!
//! The test needs the right to lock memory. `MRROC_LEAVE_OUT=realtime` skips it.

#![allow(clippy::disallowed_methods, reason = "tests keep pace with other processes")]

use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use mrroc_servo::thread::{self, CellTime, Denial, Realtime};
use mrroc_servo::*;

mod scripted;

/// Cycles of the run, and the first of them that counts.
const CYCLES: u64 = 1_500;
const FIRST: u64 = 300;

/// A process that fills its address space of 300 MB, again and again, until it is killed.
const HOG: &str = "ulimit -v 300000; while :; do head -c 250000000 /dev/zero | tail -c 250000000 >/dev/null; done";

/// Page faults of this thread, minor and major.
#[expect(unsafe_code, reason = "the counts are the kernel's to tell")]
fn faults() -> i64 {
    // SAFETY: all bytes zero is a value of the structure, which the call fills.
    unsafe {
        let mut usage: libc::rusage = std::mem::zeroed();
        assert_eq!(libc::getrusage(libc::RUSAGE_THREAD, &raw mut usage), 0);
        usage.ru_minflt + usage.ru_majflt
    }
}

#[test]
fn no_cycle_has_a_page_fault_while_another_process_takes_memory() {
    if std::env::var("MRROC_LEAVE_OUT").is_ok_and(|left_out| left_out.contains("realtime")) {
        println!("left out: MRROC_LEAVE_OUT");
        return;
    }
    let mut config = scripted::config(6);
    config.max_missed_in_row = u32::MAX;
    let (group, world) = scripted::group(6);
    // The log of the scripted drives grows.
    world.lock().unwrap().log = false;
    let (servo, mut links) = Servo::new(&config, vec![group]).unwrap();
    links[0].orders.push(Order::Enable).unwrap();
    let mut hog = Command::new("sh").args(["-c", HOG]).stderr(Stdio::null()).spawn().unwrap();
    let counted = Arc::new(AtomicI64::new(-1));
    let told = counted.clone();
    let (mut cycle, mut before) = (0, 0);
    let until = move |_: &Servo| {
        cycle += 1;
        if cycle == FIRST {
            before = faults();
        }
        if cycle == CYCLES {
            told.store(faults() - before, Ordering::Relaxed);
        }
        cycle == CYCLES
    };
    let finished = thread::run(servo, Realtime::PLAIN, CellTime::Wall, |_| {}, until);
    let _ = hog.kill();
    let _ = hog.wait();
    let finished = finished.unwrap();
    let unlocked = finished.denied.iter().find(|denied| matches!(denied, Denial::LockMemory { .. }));
    assert_eq!(unlocked, None, "the test needs locked memory; MRROC_LEAVE_OUT=realtime skips it");
    assert_eq!(counted.load(Ordering::Relaxed), 0, "page faults in {} cycles", CYCLES - FIRST);
}
