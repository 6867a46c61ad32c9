//! The servo thread has no page fault while another process takes memory: its memory is locked.
//!
//! The test has a process of its own, because the lock holds for all memory of a process and stays.
//!
//! A host with free memory takes no pages away, so the test also looks at new memory: pages of a locked process are
//! resident as soon as they are mapped.
//!
//! The test needs the right to lock memory. `MRROC_LEAVE_OUT=realtime` skips it.

#![allow(clippy::disallowed_methods, reason = "tests keep pace with other processes")]

use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use mrroc_servo::thread::{self, CellTime, Denial, Realtime};
use mrroc_servo::*;

mod scripted;

/// Cycles of the run, and the first of them that counts.
const CYCLES: u64 = 1_500;
const FIRST: u64 = 300;

/// Processes that fill their address space of 300 MB, again and again, until they are killed.
const HOG: &str = "ulimit -v 300000; while :; do head -c 250000000 /dev/zero | tail -c 250000000 >/dev/null; done";

/// Bytes of the new memory that the servo thread touches.
const MAPPED: usize = 1 << 20;

/// A process group, killed at the end.
struct Hog(Child);

impl Hog {
    fn new() -> Self {
        let spawned = Command::new("sh").args(["-c", HOG]).stderr(Stdio::null()).process_group(0).spawn();
        Self(spawned.expect("a shell starts"))
    }
}

impl Drop for Hog {
    #[expect(unsafe_code, reason = "the standard library kills single processes only")]
    fn drop(&mut self) {
        // SAFETY: the call takes two numbers. The leader is not awaited yet, so the number is that of its group.
        unsafe {
            libc::kill(-(self.0.id() as libc::pid_t), libc::SIGKILL);
        }
        let _ = self.0.wait();
    }
}

/// Page faults of this thread while it touches new memory for the first time.
#[expect(unsafe_code, reason = "an allocator may hand out memory that was touched before")]
fn faults_of_new_memory() -> i64 {
    let (protection, flags) = (libc::PROT_READ | libc::PROT_WRITE, libc::MAP_PRIVATE | libc::MAP_ANONYMOUS);
    // SAFETY: a new mapping, of which every access stays within its length, and which is unmapped once.
    unsafe {
        let mapped = libc::mmap(std::ptr::null_mut(), MAPPED, protection, flags, -1, 0);
        assert_ne!(mapped, libc::MAP_FAILED);
        let before = faults();
        for offset in (0..MAPPED).step_by(4096) {
            mapped.cast::<u8>().add(offset).write_volatile(1);
        }
        let counted = faults() - before;
        libc::munmap(mapped, MAPPED);
        counted
    }
}

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
    let hog = Hog::new();
    let (counted, of_new) = (Arc::new(AtomicI64::new(-1)), Arc::new(AtomicI64::new(-1)));
    let (told, told_new) = (counted.clone(), of_new.clone());
    let (mut cycle, mut before) = (0, 0);
    let until = move |_: &Servo| {
        cycle += 1;
        if cycle == FIRST {
            told_new.store(faults_of_new_memory(), Ordering::Relaxed);
            before = faults();
        }
        if cycle == CYCLES {
            told.store(faults() - before, Ordering::Relaxed);
        }
        cycle == CYCLES
    };
    let finished = thread::run(servo, Realtime::PLAIN, CellTime::Wall, |_| {}, until);
    drop(hog);
    let finished = finished.unwrap();
    let unlocked = finished.denied.iter().find(|denied| matches!(denied, Denial::LockMemory { .. }));
    assert_eq!(unlocked, None, "the test needs locked memory; MRROC_LEAVE_OUT=realtime skips it");
    assert_eq!(counted.load(Ordering::Relaxed), 0, "page faults in {} cycles", CYCLES - FIRST);
    assert_eq!(of_new.load(Ordering::Relaxed), 0, "page faults of new memory: the memory is not locked");
}
