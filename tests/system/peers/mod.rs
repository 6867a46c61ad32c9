//! Independent peers: python-canopen, zencan, canopen-rs, durand, can-utils and the kernel's own drivers on the wires,
//! HdrHistogram on files, pinocchio over robots.
//!
//! What other hands have written from the same standards makes no mistake of ours. `tests/run` puts what these tests
//! need into `target/peers`: the Python packages of the scripts in `tests/peers`, and the programs of `tests/peers/rust`.
//! Without them these tests fail, unless `MRROC_LEAVE_OUT=peers` says that they may be left out.

mod blocks;
mod bodies;
mod clients;
mod group;
mod host;
mod latency;
mod linux;
mod master;
mod nodes;
mod serial;
mod slave;

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use crate::bench::may_leave_out;
use crate::mrroc;

/// Seconds that a script may take.
const PATIENCE: &str = "90";

/// The Python that has the packages; `None` if `test` is to be left out for want of it.
fn python(test: &str) -> Option<PathBuf> {
    let python = mrroc::root().join("target/peers/bin/python");
    if python.exists() {
        return Some(python);
    }
    let wanting = format_args!("no {}: `tests/run` makes it", python.display());
    may_leave_out("peers", test, &wanting);
    None
}

/// The programs of `tests/peers/rust` of these names; `None` if `test` is to be left out for want of one.
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

/// A bus as python-can knows it.
struct Bus<'a> {
    interface: &'a str,
    channel: &'a Path,
}

impl<'a> Bus<'a> {
    fn socketcan(interface: &'a str) -> Self {
        Self {
            interface: "socketcan",
            channel: Path::new(interface),
        }
    }

    fn slcan(tty: &'a Path) -> Self {
        Self {
            interface: "slcan",
            channel: tty,
        }
    }

    /// A script on this bus, with the emulator's data sheet.
    fn script(&self, python: &Path, name: &str) -> Command {
        let mut command = Command::new("timeout");
        command
            .args(["--signal=KILL", PATIENCE])
            .arg(python)
            .args(["-B", "-u"])
            .arg(mrroc::root().join("tests/peers").join(name))
            .args(["--interface", self.interface, "--channel"])
            .arg(self.channel)
            .arg("--eds")
            .arg(mrroc::root().join("cells/epos4-emulated.eds"));
        command
    }
}

/// Runs a script to its end, which is to be a good one.
fn judged(script: &mut Command) {
    let output = script.output().expect("timeout runs");
    let (said, complained) = (
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
    assert!(output.status.success(), "{said}\n{complained}");
    print!("{said}");
}

/// A script at work: it ends with its standard input.
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
