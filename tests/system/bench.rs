//! Where a test's bus is.
//!
//! `HIL_CAN=can0` runs the tests on that interface of this host. Without it, each boots a user-mode
//! Linux and runs there on `vcan0`; a host without that kernel fails the test, unless
//! `MRROC_LEAVE_OUT=vcan` says that it may be left out.
//!
//! Tests of cards are the same with `HIL_CARDS=can0,can1`, two cards on one bus, in a PC that QEMU emulates, and
//! with `MRROC_LEAVE_OUT=qemu`.

use std::env;
use std::fmt::{Debug, Display};
use std::time::Duration;

use hil::{qemu, uml};

use crate::mrroc;

/// Runs `body` on a SocketCAN interface, whose name it is given.
///
/// `test` is the calling test's own path, such as `socketcan::frames_come_back`: inside the test
/// machine this binary runs it again, and the machine is given two minutes for it.
pub(crate) fn on_vcan(test: &str, body: impl FnOnce(&str)) {
    on_vcan_within(Duration::from_secs(120), test, body);
}

/// The same, with another time for the test machine.
pub(crate) fn on_vcan_within(timeout: Duration, test: &str, body: impl FnOnce(&str)) {
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

/// Runs `body` on two cards of one bus, whose names it is given; like [`on_vcan`], in less than three minutes.
pub(crate) fn on_cards(test: &str, body: impl FnOnce(&str, &str)) {
    mrroc::binary();
    if let Some(cards) = env::var("HIL_CARDS").ok().filter(|cards| !cards.is_empty()) {
        let (here, there) = cards.split_once(',').expect("HIL_CARDS has two names");
        return body(here, there);
    }
    if let Some(kernel) = kernel(test) {
        let timeout = Duration::from_secs(170);
        let options = again(test, ("HIL_CARDS", "can0,can1"), timeout);
        let mut output = Vec::new();
        let outcome = qemu::run(&kernel, &options, &mut output);
        judge(test, &outcome, &output);
    }
}

/// The kernel that QEMU boots; `None` if `test` is to be left out for want of that, panics as [`left_out`] does.
pub(crate) fn kernel(test: &str) -> Option<qemu::Kernel> {
    qemu::Kernel::below(&mrroc::root().join("target/qemu"))
        .inspect_err(|error| may_leave_out("qemu", test, error))
        .ok()
}

/// This binary, to run `test` again in a test machine.
fn again(test: &str, (variable, value): (&str, &str), timeout: Duration) -> uml::Options {
    let binary = env::current_exe().expect("a test binary knows its own path");
    uml::Options {
        env: vec![(variable.into(), value.into())],
        directory: env::current_dir().expect("cargo runs tests in the package's directory"),
        // The example cells are there.
        visible: vec![mrroc::root().to_owned()],
        timeout,
        ..uml::Options::new([
            binary.as_os_str(),
            test.as_ref(),
            "--exact".as_ref(),
            "--nocapture".as_ref(),
        ])
    }
}

/// Panics unless the test passed in its machine.
fn judge<E: Debug + PartialEq>(test: &str, outcome: &Result<u8, E>, output: &[u8]) {
    let output = String::from_utf8_lossy(output);
    // A path that names no test passes in silence.
    let ran = output.contains("1 passed");
    assert!(
        *outcome == Ok(0) && ran,
        "{test} in the test machine: {outcome:?}\n{output}"
    );
    print!("{output}");
}

/// Whether `test` is to be left out for want of user-mode Linux; panics if it is wanting and
/// `MRROC_LEAVE_OUT` does not say so.
pub(crate) fn left_out(test: &str) -> bool {
    let wanting = uml::installed().err();
    wanting
        .inspect(|error| may_leave_out("vcan", test, error))
        .is_some()
}

/// Says that `test` is left out for want of `what`; panics if `MRROC_LEAVE_OUT` does not ask for that.
pub(crate) fn may_leave_out(what: &str, test: &str, wanting: &dyn Display) {
    let allowed = env::var("MRROC_LEAVE_OUT").unwrap_or_default();
    assert!(
        allowed.split(',').any(|bench| bench == what),
        "{wanting}; or leave these tests out with MRROC_LEAVE_OUT={what}"
    );
    eprintln!("left out: {what} ({test})");
}
