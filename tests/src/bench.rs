//! Selection of the bus for a test.
//!
//! `HIL_CAN=can0` runs the tests on that interface of this host. Without the variable, each test boots a user-mode
//! Linux and runs there on `vcan0`. A host without that kernel fails the test, unless `MRROC_LEAVE_OUT=vcan` permits
//! leaving it out.
//!
//! The variable for tests of cards is `HIL_CARDS=can0,can1`, which names two cards on one bus. Without it, these tests
//! run in a PC that QEMU emulates; `MRROC_LEAVE_OUT=qemu` permits leaving them out.

use std::fmt::{Debug, Display};
use std::process::{Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use std::{env, fs};

use hil::{qemu, uml};

use crate::mrroc;

/// The turn of a test by the clock, which one test at a time holds. Its programs miss deadlines while they wait for a
/// processor, and therefore precede those of other tests, which only root may arrange. Builds the programs before.
pub fn turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    turn_of(&TURN, "-15")
}

/// The turn of a test by the clock that repeats a run after a disturbance by the host. One such test runs at the same
/// time as a test of [`turn`]. The programs of the test of [`turn`] have a higher priority.
pub fn patient_turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    turn_of(&TURN, "-8")
}

fn turn_of(turn: &'static Mutex<()>, niceness: &str) -> MutexGuard<'static, ()> {
    mrroc::binary();
    let turn = turn.lock().unwrap_or_else(PoisonError::into_inner);
    // Programs inherit the priority of the thread that starts them, which is this test's own.
    let thread = fs::read_link("/proc/thread-self").expect("Linux");
    let thread = thread.file_name().expect("PID/task/TID");
    let mut renice = Command::new("renice");
    let renice = renice.args(["-n", niceness, "-p"]).arg(thread);
    let _ = renice.stdout(Stdio::null()).stderr(Stdio::null()).status();
    turn
}

/// Runs `body` on a SocketCAN interface. `body` receives the name of the interface.
///
/// `test` is the path of the calling test, such as `socketcan::frames_come_back`. Inside the test machine, this binary
/// runs that test again. The time limit of the test machine is two minutes.
pub fn on_vcan(test: &str, body: impl FnOnce(&str)) {
    on_vcan_within(Duration::from_secs(120), test, body);
}

/// As [`on_vcan`], with another time limit for the test machine.
pub fn on_vcan_within(timeout: Duration, test: &str, body: impl FnOnce(&str)) {
    if let Some(interface) = env::var("HIL_CAN").ok().filter(|name| !name.is_empty()) {
        return body(&interface);
    }
    if left_out(test) {
        return;
    }
    let options = again(test, ("HIL_CAN", "vcan0"), timeout);
    let mut output = Vec::new();
    let outcome = uml::run(&options, &mut output);
    judge(test, &outcome, &output);
}

/// Runs `body` on two cards of one bus, whose names it receives. The time limit of the test machine is three minutes.
pub fn on_cards(test: &str, body: impl FnOnce(&str, &str)) {
    mrroc::binary();
    if let Some(cards) = env::var("HIL_CARDS").ok().filter(|cards| !cards.is_empty()) {
        let (here, there) = cards.split_once(',').expect("HIL_CARDS has two names");
        return body(here, there);
    }
    if let Some(kernel) = kernel(test) {
        let timeout = Duration::from_secs(170);
        let options = again(test, ("HIL_CARDS", "can0,can1"), timeout);
        let mut output = Vec::new();
        let outcome = qemu::run(&kernel, qemu::Clock::Host, &options, &mut output);
        judge(test, &outcome, &output);
    }
}

/// The kernel that QEMU boots. `None` if the kernel is missing and `test` may be left out; panics if it may not.
pub fn kernel(test: &str) -> Option<qemu::Kernel> {
    qemu::Kernel::below(&mrroc::root().join("target/qemu")).inspect_err(|error| may_leave_out("qemu", test, error)).ok()
}

/// Options that run `test` of this binary again in a test machine.
fn again(test: &str, (variable, value): (&str, &str), timeout: Duration) -> uml::Options {
    let binary = env::current_exe().expect("a test binary knows its own path");
    uml::Options {
        env: vec![(variable.into(), value.into())],
        directory: env::current_dir().expect("cargo runs tests in the package's directory"),
        // Directory of the example cells.
        visible: vec![mrroc::root().to_owned()],
        timeout,
        ..uml::Options::new([
            binary.as_os_str(),
            test.as_ref(),
            "--exact".as_ref(),
            "--include-ignored".as_ref(),
            "--nocapture".as_ref(),
        ])
    }
}

/// Panics unless the test passed in its machine.
fn judge<E: Debug + PartialEq>(test: &str, outcome: &Result<u8, E>, output: &[u8]) {
    let output = String::from_utf8_lossy(output);
    // The test runner does not report a path that names no test.
    let ran = output.contains("1 passed");
    assert!(*outcome == Ok(0) && ran, "{test} in the test machine: {outcome:?}\n{output}");
    print!("{output}");
}

/// Whether `test` is left out because user-mode Linux is missing. Panics if it is missing and `MRROC_LEAVE_OUT` does
/// not permit this.
pub fn left_out(test: &str) -> bool {
    let wanting = uml::installed().err();
    wanting.inspect(|error| may_leave_out("vcan", test, error)).is_some()
}

/// Reports that `test` is left out because `what` is missing. Panics if `MRROC_LEAVE_OUT` does not permit this.
pub fn may_leave_out(what: &str, test: &str, wanting: &dyn Display) {
    let allowed = env::var("MRROC_LEAVE_OUT").unwrap_or_default();
    assert!(
        allowed.split(',').any(|bench| bench == what),
        "{wanting}; or leave these tests out with MRROC_LEAVE_OUT={what}"
    );
    eprintln!("left out: {what} ({test})");
}
