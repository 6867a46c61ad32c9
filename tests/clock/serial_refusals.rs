//! Refusals for ttys: one line that names the problem, its place and its cause.

use std::fs;
use std::os::unix::fs::symlink;

use hil::Pty;
use kit::mrroc::{Directory, mrroc, text};
use kit::refusals::refused;
use kit::{PERIOD, by_the_clock};
use serial::{Settings, Tty};

#[test]
fn a_line_that_cannot_be_used_is_refused_by_its_axis() {
    by_the_clock(0.2, PERIOD, || {
        let directory = Directory::new();
        let cell = directory.write("cell.toml", &text("irb6-serial"));
        let axes = ["column", "lower-arm", "upper-arm", "wrist-pitch", "wrist-roll"];
        let ptys: Vec<Pty> = axes.iter().map(|_| Pty::open().unwrap()).collect();
        let ttys = directory.path("ttys");
        fs::create_dir(&ttys).unwrap();
        for (axis, pty) in axes.iter().zip(&ptys) {
            symlink(pty.path(), ttys.join(axis)).unwrap();
        }
        let run = |bench: &str| {
            mrroc(["run".as_ref(), cell.as_os_str(), bench.as_ref(), "--serial".as_ref(), ttys.as_os_str()])
        };
        // No emulator serves the other ends.
        refused(&run("--bench=card"), &["bus arm, axis column: ", "no answer", "baud rate"]);
        // Root may open a tty that another process uses exclusively.
        let held = Tty::open(ttys.join("column"), Settings::AXIS_CONTROLLER).unwrap();
        let busy = run("--bench=card");
        if !busy.stderr.contains("no answer") {
            refused(&busy, &["axis column: ", "in use by another process"]);
        }
        drop(held);
        fs::remove_file(ttys.join("lower-arm")).unwrap();
        refused(&run("--bench=card"), &["axis lower-arm: ", "no such device"]);
        fs::write(ttys.join("lower-arm"), "no tty").unwrap();
        refused(&run("--bench=card"), &["axis lower-arm: ", "not a tty"]);
        // On a bench of pseudo-terminals, a real tty is refused before it is opened.
        refused(&run("--bench=vcan"), &["lower-arm may be hardware", "--bench card"]);
    });
}
