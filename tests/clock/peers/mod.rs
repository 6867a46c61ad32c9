//! Independent peers: python-canopen, zencan, canopen-rs, durand, can-utils and the kernel's own drivers on the buses,
//! HdrHistogram for files, pinocchio for robots, SciPy for splines, toppra and Ruckig for planning.
//!
//! Independent implementations of the same standards do not share the errors of this project. `tests/run` installs the
//! requirements of these tests in `target/peers`: the Python packages of the scripts in `tests/peers`, and the programs
//! of `tests/peers/rust`. Without them these tests fail, unless `MRROC_LEAVE_OUT=peers` permits leaving them out.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use kit::bench::may_leave_out;
use kit::mrroc;

mod blocks;

mod bodies;

mod clients;

mod digital_io;

mod force;

mod force_driver;

mod group;

mod host;

mod io_driver;

mod latency;

mod lines;

mod linux;

mod master;

mod nodes;

mod recordings;

mod serial;

mod slave;

mod splines;

mod timing;

/// Time limit of a script, s.
const PATIENCE: &str = "90";

/// The Python interpreter with the packages; `None` if it is missing and `test` may be left out.
pub(crate) fn python(test: &str) -> Option<PathBuf> {
    let python = mrroc::root().join("target/peers/bin/python");
    if python.exists() {
        return Some(python);
    }
    let wanting = format_args!("no {}: `tests/run` makes it", python.display());
    may_leave_out("peers", test, &wanting);
    None
}

/// The programs of `tests/peers/rust` with these names; `None` if one is missing and `test` may be left out.
fn rust<const N: usize>(test: &str, names: [&str; N]) -> Option<[PathBuf; N]> {
    let programs = mrroc::root().join("target/peers/rust/debug");
    let programs = names.map(|name| programs.join(name));
    if let Some(missing) = programs.iter().find(|program| !program.exists()) {
        let wanting = format_args!("no {}: `tests/run` makes it", missing.display());
        may_leave_out("peers", test, &wanting);
        return None;
    }
    Some(programs)
}

/// A bus in the terms of python-can.
struct Bus<'a> {
    interface: &'a str,
    channel: &'a Path,
}

impl<'a> Bus<'a> {
    fn socketcan(interface: &'a str) -> Self {
        Self { interface: "socketcan", channel: Path::new(interface) }
    }

    fn slcan(tty: &'a Path) -> Self {
        Self { interface: "slcan", channel: tty }
    }

    /// A script on this bus, with the emulated drive's data sheet.
    fn script(&self, python: &Path, name: &str) -> Command {
        self.script_with(python, name, "epos4-emulated.eds")
    }

    /// A script on this bus, with a data sheet of `cells`.
    fn script_with(&self, python: &Path, name: &str, sheet: &str) -> Command {
        let mut command = Command::new("timeout");
        command
            .args(["--signal=KILL", PATIENCE])
            .arg(python)
            .args(["-B", "-u"])
            .arg(mrroc::root().join("tests/peers").join(name))
            .args(["--interface", self.interface, "--channel"])
            .arg(self.channel)
            .arg("--eds")
            .arg(mrroc::root().join("cells").join(sheet));
        command
    }
}

/// Runs a script to its end and asserts success.
fn judged(script: &mut Command) {
    let output = script.output().expect("timeout runs");
    let (said, complained) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{said}\n{complained}");
    print!("{said}");
}

/// A running script, which ends when its standard input is closed.
struct Script(Child);

impl Script {
    fn start(command: &mut Command) -> Self {
        Self(command.stdin(Stdio::piped()).spawn().expect("timeout runs"))
    }
}

impl Drop for Script {
    fn drop(&mut self) {
        drop(self.0.stdin.take());
        let _ = self.0.wait();
    }
}
