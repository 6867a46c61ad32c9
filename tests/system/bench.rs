//! Where a test's bus is.
//!
//! `HIL_CAN=can0` runs the tests on that interface of this host. Without it, each boots a user-mode
//! Linux and runs there on `vcan0`; a host without that kernel fails the test, unless
//! `MRROC_LEAVE_OUT=vcan` says that it may be left out.

use std::env;
use std::fmt::Display;
use std::time::Duration;

use hil::uml;

/// Runs `body` on a SocketCAN interface, whose name it is given.
///
/// `test` is the calling test's own path, such as `socketcan::frames_come_back`: inside the test
/// machine this binary runs it again, and the machine is given two minutes for it.
pub(crate) fn on_vcan(test: &str, body: impl FnOnce(&str)) {
    if let Some(interface) = env::var("HIL_CAN").ok().filter(|name| !name.is_empty()) {
        return body(&interface);
    }
    if left_out(test) {
        return;
    }
    let binary = env::current_exe().expect("a test binary knows its own path");
    let options = uml::Options {
        env: vec![("HIL_CAN".into(), "vcan0".into())],
        directory: env::current_dir().expect("cargo runs tests in the package's directory"),
        // The example cells are there.
        visible: vec![concat!(env!("CARGO_MANIFEST_DIR"), "/..").into()],
        timeout: Duration::from_secs(120),
        ..uml::Options::new([
            binary.as_os_str(),
            test.as_ref(),
            "--exact".as_ref(),
            "--nocapture".as_ref(),
        ])
    };
    let mut output = Vec::new();
    let outcome = uml::run(&options, &mut output);
    let output = String::from_utf8_lossy(&output);
    // A path that names no test passes in silence.
    let ran = output.contains("1 passed");
    assert!(
        outcome == Ok(0) && ran,
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
