//! A servo thread of another process that hangs for good.
#![expect(unsafe_code, reason = "ptrace has no safe wrapper among our dependencies")]

use std::fs;
use std::path::Path;
use std::ptr::null_mut;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::thread::JoinHandle;
use std::time::Duration;

use can::clock;

/// Time between two looks of the tracer.
const LOOK: Duration = Duration::from_millis(5);

/// Holds the servo thread of a process by ptrace, until the value is dropped or the process ends. The process can end
/// meanwhile. A thread that `strace` delays would hold its process.
pub(crate) struct Hang {
    over: Arc<AtomicBool>,
    tracer: Option<JoinHandle<()>>,
}

impl Hang {
    /// Holds the servo thread of process `process`, a descendant of this process.
    pub(crate) fn of(process: u32) -> Self {
        let thread = servo_thread(process).expect("a servo thread");
        let over = Arc::new(AtomicBool::new(false));
        let (tell, told) = sync_channel(1);
        let ends = over.clone();
        // The kernel accepts requests from the tracer only, and the end of the tracer releases the thread.
        let tracer = std::thread::spawn(move || {
            let holds = stop(thread);
            tell.send(holds).expect("the test waits");
            while holds && !ends.load(Ordering::Relaxed) && !has_ended(thread) {
                clock::sleep_until(clock::now() + LOOK);
            }
        });
        assert!(told.recv().expect("the tracer answers"), "the servo thread cannot be traced");
        Self { over, tracer: Some(tracer) }
    }
}

impl Drop for Hang {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        if let Some(tracer) = self.tracer.take() {
            // A failed tracer has failed the test.
            let _ = tracer.join();
        }
    }
}

/// Number of the servo thread that a process has now.
pub(crate) fn servo_thread(process: u32) -> Option<libc::pid_t> {
    let threads = fs::read_dir(format!("/proc/{process}/task")).expect("the process").flatten();
    let is_servo = |thread: &Path| fs::read_to_string(thread.join("comm")).is_ok_and(|name| name.trim() == "servo");
    let thread = threads.map(|entry| entry.path()).find(|thread| is_servo(thread))?;
    thread.file_name()?.to_str()?.parse().ok()
}

/// Stops a thread. Returns whether the kernel permits it.
fn stop(thread: libc::pid_t) -> bool {
    let none = null_mut::<libc::c_void>();
    // SAFETY: both requests take a number and no memory.
    unsafe {
        libc::ptrace(libc::PTRACE_SEIZE, thread, none, none) == 0
            && libc::ptrace(libc::PTRACE_INTERRUPT, thread, none, none) == 0
    }
}

/// Whether a traced thread has ended. A process ends after the tracer has asked for each traced thread.
fn has_ended(thread: libc::pid_t) -> bool {
    let mut status = 0;
    // SAFETY: the call stores one number.
    let found = unsafe { libc::waitpid(thread, &raw mut status, libc::__WALL | libc::WNOHANG) };
    found < 0 || found == thread && (libc::WIFEXITED(status) || libc::WIFSIGNALED(status))
}
