//! `mrroc doctor`: whether this host can run a cell, and what to change where it cannot.
//!
//! It changes nothing unless `--fix` asks for it. Each subject has a module of pure judgements on what [`tree::Tree`]
//! and a few system calls returned. All judgements are [`finding::Finding`]s, and the worst is the exit status. What
//! mends one without a person is in it as [`fix::Fix`]es.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

mod can_interfaces;
mod cpu;
mod finding;
mod fix;
mod kernel;
mod limits;
pub mod link;
mod mend;
mod record;
mod serial_lines;
#[cfg(test)]
mod tests;
mod tree;

use std::env;
use std::fmt;
use std::io::{self, IsTerminal};
use std::path::PathBuf;
use std::process::ExitCode;
use std::thread;
use std::time::Duration;

use anyhow::{Context, ensure};
use can::clock::{now, sleep_until};
use can::{OpenError, SocketCanOptions, SocketCanPort};
use clap::Args;
use drive::cia402;
use mrroc::cell::{Cell, Realtime, Scheduler};
use serde::Serialize;
use servo::thread::{Denial, set_deadline, set_fifo};

use finding::{Finding, Verdict};
use link::Link;
use mrroc::bench::interfaces::Interface;
use mrroc::cell_file::CellFile;
use mrroc::streams;
use record::Record;
use tree::Tree;

pub use cpu::stolen_ticks;

/// How long the steal time is watched.
const WATCH: Duration = Duration::from_secs(1);

/// What the command's help says of its exit status.
const EXIT_STATUS: &str =
    "Exit status: 0 ready; 1 usable with warnings; 2 not usable, or the cell file is refused.";

/// What to examine.
#[derive(Args)]
#[command(after_help = EXIT_STATUS)]
pub struct Options {
    /// The cell file: its CAN interfaces, serial lines and real-time needs. Without one, the host alone and the CAN
    /// interfaces it has.
    cell: Option<PathBuf>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
    /// Set what can be set, after asking for each finding; a cell must not run on this host. Then examine anew.
    #[arg(long)]
    fix: bool,
    /// Ask nothing.
    #[arg(long, requires = "fix")]
    yes: bool,
    /// Put back what `--fix` has set, the youngest change first; a cell must not run on this host. 1 if something could
    /// not be.
    #[arg(long, conflicts_with_all = ["cell", "json", "fix"])]
    undo: bool,
    /// The record of what was set, by default below /var/lib/mrroc or, for users other than root, XDG_STATE_HOME.
    #[arg(long, value_name = "FILE")]
    state: Option<PathBuf>,
}

/// Everything that was found.
#[derive(Serialize)]
struct Examined {
    cell: Option<String>,
    verdict: Verdict,
    findings: Vec<Finding>,
}

/// Examines the host and says what it found.
pub fn doctor(options: &Options) -> anyhow::Result<ExitCode> {
    let tree = Tree::new("/");
    if options.undo {
        return undo(&tree, options);
    }
    ensure!(
        !options.fix || options.yes || io::stdin().is_terminal(),
        "--fix asks on a terminal, and this is none: --yes answers for it"
    );
    let file = options.cell.as_deref().map(CellFile::read).transpose()?;
    let cell = file.as_ref().map(|file| &file.cell);
    let mut findings = examine(&tree, cell)?;
    if options.fix {
        let mut record = Record::open(&state(&tree, options)?)?;
        mend::fix(&tree, &findings, &mut record, |finding| {
            if options.yes {
                Ok(true)
            } else {
                mend::asked(finding)
            }
        })?;
        findings = examine(&tree, cell)?;
    }
    let worst = findings.iter().map(|finding| finding.verdict).max();
    let examined = Examined {
        cell: cell.map(|cell| cell.name.clone()),
        verdict: worst.unwrap_or(Verdict::Ok),
        findings,
    };
    streams::answer(&examined, options.json)?;
    Ok(ExitCode::from(match examined.verdict {
        Verdict::Ok => 0,
        Verdict::Warning => 1,
        Verdict::NotUsable => 2,
    }))
}

fn undo(tree: &Tree, options: &Options) -> anyhow::Result<ExitCode> {
    let mut record = Record::open(&state(tree, options)?)?;
    if record.changes().is_empty() {
        streams::say(format_args!(
            "{}: nothing to put back",
            record.path().display()
        ))?;
    }
    let left = mend::undo(tree, &mut record)?;
    Ok(ExitCode::from(u8::from(left > 0)))
}

/// Where the record of changes is.
fn state(tree: &Tree, options: &Options) -> anyhow::Result<PathBuf> {
    const NAME: &str = "doctor-undo.json";
    if let Some(file) = &options.state {
        return Ok(file.clone());
    }
    if limits::Identity::of(tree).is_root() {
        return Ok(PathBuf::from("/var/lib/mrroc").join(NAME));
    }
    let absolute = |name| {
        env::var_os(name)
            .map(PathBuf::from)
            .filter(|path| path.is_absolute())
    };
    let home = || Some(absolute("HOME")?.join(".local/state"));
    let directory = absolute("XDG_STATE_HOME").or_else(home);
    let directory = directory.context("no HOME for the record of changes: --state FILE")?;
    Ok(directory.join("mrroc").join(NAME))
}

fn examine(tree: &Tree, cell: Option<&Cell>) -> anyhow::Result<Vec<Finding>> {
    let realtime = cell.map_or_else(Realtime::default, |cell| cell.realtime);
    let stat = || tree.text("/proc/stat").unwrap_or_default();
    let before = stat();
    let end = now() + WATCH;

    let tried = try_scheduler(&realtime, cell.map_or(Duration::ZERO, Cell::period))?;
    let mut findings = kernel::findings(tree, cell.map(|cell| cell.period_us), tried.is_ok());
    findings.extend(limits::findings(tree, &realtime, tried));
    findings.extend(cpu::findings(tree, &realtime));
    let (interfaces, lines) = wanted(tree, cell);
    for wanted in interfaces {
        let link = Link::of(&wanted.interface);
        let opened = try_open(&wanted.interface);
        let found = can_interfaces::findings(tree, &wanted, opened, link.as_ref());
        findings.extend(found);
    }
    for wanted in lines {
        findings.extend(serial_lines::findings(tree, &wanted));
    }

    sleep_until(end);
    let cpuinfo = tree.text("/proc/cpuinfo").unwrap_or_default();
    findings.push(cpu::steal(&cpuinfo, &before, &stat()));
    Ok(findings)
}

/// The interfaces and ttys that the cell names; without a cell, the CAN interfaces that are there.
fn wanted(
    tree: &Tree,
    cell: Option<&Cell>,
) -> (Vec<can_interfaces::Wanted>, Vec<serial_lines::Wanted>) {
    let (mut interfaces, mut lines) = (Vec::new(), Vec::new());
    let Some(cell) = cell else {
        let present = can_interfaces::present(tree).into_iter();
        let of_host = present.map(|interface| can_interfaces::Wanted {
            of: interface.clone(),
            interface,
            bitrate_kbps: None,
            send_queue: SocketCanOptions::default().send_queue,
            servo_cpu: None,
        });
        return (of_host.collect(), lines);
    };
    for (index, bus) in cell.bus.iter().enumerate() {
        match Interface::parse(&bus.interface) {
            Interface::SocketCan(interface) => interfaces.push(can_interfaces::Wanted {
                of: format!("bus {}, {interface}", bus.name),
                interface,
                bitrate_kbps: Some(bus.bitrate_kbps),
                send_queue: cell.axes_on(index).count() + cia402::BESIDE_SETPOINTS,
                servo_cpu: cell.realtime.cpu,
            }),
            Interface::Slcan { path, .. } | Interface::Epos { path, .. } => {
                lines.push(serial_lines::Wanted {
                    of: format!("bus {}, {path}", bus.name),
                    path,
                });
            }
        }
    }
    for bundle in cell.bus.len()..cell.groups().count() {
        let axes = cell.axes_on(bundle);
        lines.extend(axes.map(|(robot, axis)| {
            let (robot, axis) = (&cell.robot[robot], &cell.robot[robot].axis[axis]);
            let path = &axis.axis_controller().line;
            serial_lines::Wanted {
                of: format!("axis {}.{}, {path}", robot.name, axis.name),
                path: path.clone(),
            }
        }));
    }
    (interfaces, lines)
}

/// What the scheduler says to a thread that asks for what the servo's would. It ends at once.
fn try_scheduler(realtime: &Realtime, period: Duration) -> anyhow::Result<Result<(), Denial>> {
    let Realtime {
        scheduler,
        priority,
        ..
    } = *realtime;
    let asking = thread::Builder::new().spawn(move || match scheduler {
        Scheduler::Fifo => set_fifo(priority),
        Scheduler::Deadline => set_deadline(period),
    });
    let asking = asking.context("a thread to ask for its priority")?;
    Ok(asking.join().expect("asking does not panic"))
}

/// A socket that sends nothing and is closed at once.
fn try_open(interface: &str) -> Result<(), OpenError> {
    SocketCanPort::open(interface, &SocketCanOptions::default()).map(drop)
}

impl fmt::Display for Examined {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for finding in &self.findings {
            let Finding {
                of,
                what,
                read,
                why,
                ..
            } = finding;
            let verdict = match finding.verdict {
                Verdict::Ok => "ok",
                Verdict::Warning => "warning",
                Verdict::NotUsable => "not usable",
            };
            writeln!(f, "{verdict:10}  {of}: {what}: {read}")?;
            if let Some(mend) = &finding.mend {
                writeln!(f, "{:12}why: {why}\n{:12}mend: {mend}", "", "")?;
            }
            for fix in &finding.fixes {
                writeln!(f, "{:12}--fix: {fix}", "")?;
            }
        }
        let count = |verdict| {
            let findings = self.findings.iter();
            findings
                .filter(|finding| finding.verdict == verdict)
                .count()
        };
        let whose = self.cell.as_deref().map(|cell| format!(" for {cell}"));
        let whose = whose.unwrap_or_default();
        let warnings = count(Verdict::Warning);
        match self.verdict {
            Verdict::Ok => writeln!(f, "\nready{whose}"),
            Verdict::Warning => writeln!(f, "\nusable{whose}, with warnings: {warnings}"),
            Verdict::NotUsable => writeln!(
                f,
                "\nnot usable{whose}: {} in the way, warnings: {warnings}",
                count(Verdict::NotUsable)
            ),
        }
    }
}
