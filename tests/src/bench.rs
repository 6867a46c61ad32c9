//! Selection of the bus for a test.
//!
//! `HIL_CAN=can0` runs the tests on that interface of this host. Without the variable, each test boots a user-mode
//! Linux and runs there on `vcan0`. A host without that kernel fails the test, unless `MRROC_LEAVE_OUT=vcan` permits
//! leaving it out.
//!
//! The variable for tests of cards is `HIL_CARDS=can0,can1`, which names two cards on one bus. Without it, these tests
//! run in a PC that QEMU emulates; `MRROC_LEAVE_OUT=qemu` permits leaving them out.

use std::env;
use std::fmt::{Debug, Display};
use std::io::{self, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use hil::{qemu, uml};

use crate::disturbance::{NEGATIVE, by_the_clock};
use crate::mrroc;
use crate::processors::{self, ALL};

/// Mean use of processors by a test in user-mode Linux, and in a PC that QEMU emulates.
pub const UML: f64 = 0.5;
pub const QEMU: f64 = 0.9;

/// Shortest delay that disturbs a run in a test machine: the servo period of [`crate::slow`].
const UNBEARABLE: Duration = Duration::from_millis(10);

/// Time limit of a test machine.
const LONGEST: Duration = Duration::from_secs(300);

/// A body that runs on an interface, with the name of its claim.
pub type Body = (&'static str, fn(&str));

/// Runs `body` on a SocketCAN interface, by the clock. `body` receives the name of the interface.
///
/// `test` is the path of the calling test, such as `socketcan::frames_come_back`. Inside the test machine, this binary
/// runs that test again. The time limit of the test machine is five minutes.
pub fn on_vcan(test: &str, body: impl FnMut(&str)) {
    on_vcan_within(LONGEST, test, body);
}

/// As [`on_vcan`], with another time limit for the test machine.
pub fn on_vcan_within(timeout: Duration, test: &str, mut body: impl FnMut(&str)) {
    in_uml(timeout, test, |interface| by_the_clock(ALL, UNBEARABLE, || body(interface)));
}

/// Runs independent bodies, one after another, on one interface. Each has a name, by which it is reported. `run` runs a
/// body on the interface.
pub fn bodies_on_vcan<B>(test: &str, bodies: &[(&str, B)], run: impl Fn(&str, &B)) {
    in_uml(2 * LONGEST, test, |interface| {
        let run = &run;
        each(bodies.iter().map(|(name, body)| {
            let body = move || by_the_clock(ALL, UNBEARABLE, || run(interface, body));
            (*name, body)
        }));
    });
}

/// Runs all bodies, and prints the result of each. Panics at the end if one has failed.
pub fn each<'a>(bodies: impl Iterator<Item = (&'a str, impl FnOnce())>) {
    let failed: Vec<_> = bodies
        .filter_map(|(name, body)| {
            let passed = catch_unwind(AssertUnwindSafe(body)).is_ok();
            println!("{name} ... {}", if passed { "ok" } else { "FAILED" });
            (!passed).then_some(name)
        })
        .collect();
    assert!(failed.is_empty(), "failed: {failed:?}");
}

/// As [`on_vcan_within`], for a body that consists of several runs by the clock.
pub fn in_uml(timeout: Duration, test: &str, body: impl FnOnce(&str)) {
    if let Some(interface) = env::var("HIL_CAN").ok().filter(|name| !name.is_empty()) {
        return body(&interface);
    }
    if left_out(test) {
        return;
    }
    let _share = processors::take(UML);
    let options = again(test, ("HIL_CAN", "vcan0"), timeout);
    let mut output = Vec::new();
    let outcome = uml::run(&options, &mut output);
    judge(test, &outcome, &output);
}

/// A body that runs on two cards of one bus, with the name of its claim. It receives the names of the cards.
pub type BodyOnCards = (&'static str, fn(&str, &str));

/// As [`bodies_on_vcan`], on two cards of one bus.
pub fn bodies_on_cards(test: &str, bodies: &[BodyOnCards]) {
    if let Some(cards) = env::var("HIL_CARDS").ok().filter(|cards| !cards.is_empty()) {
        let (here, there) = cards.split_once(',').expect("HIL_CARDS has two names");
        let run = |body: &fn(&str, &str)| by_the_clock(ALL, 2 * UNBEARABLE, || body(here, there));
        return each(bodies.iter().map(|(name, body)| (*name, move || run(body))));
    }
    if let Some(kernel) = kernel(test) {
        let _share = processors::take(QEMU);
        let options = again(test, ("HIL_CARDS", "can0,can1"), 2 * LONGEST);
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
    for line in output.lines().filter(|line| line.contains(NEGATIVE)) {
        let _ = writeln!(io::stderr(), "{line}");
    }
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
