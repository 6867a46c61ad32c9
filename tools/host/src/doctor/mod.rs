//! `mrroc doctor`: checks whether this host can run a cell, and proposes corrections.
//!
//! The command changes nothing without `--fix`. Each subject has a module of pure functions from the data of
//! `tree::Tree` and a few system calls to verdicts. Every result is a `finding::Finding`, and the worst verdict is
//! the exit status. Corrections that need no person are part of the finding as `fix::Fix`es.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

mod admissible;
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
use serde::Serialize;
use servo::thread::{Denial, set_deadline, set_fifo};

use finding::{Finding, Verdict};
use link::Link;
use mrroc::bench::interfaces::Interface;
use mrroc::bench::sensor_lines;
use mrroc::cell::{Cell, CellFile, Realtime, Scheduler};
use mrroc::streams;
use record::Record;
use tree::Tree;

pub use cpu::stolen_ticks;

/// Time over which the steal time is measured.
const WATCH: Duration = Duration::from_secs(1);

/// Exit status in the help text of the command.
const EXIT_STATUS: &str = "Exit status: 0 ready; 1 usable with warnings; 2 not usable, or the cell file is refused.";

/// Options of `mrroc doctor`.
#[derive(Args)]
#[command(after_help = EXIT_STATUS)]
pub struct Options {
    /// The cell file, whose CAN interfaces, serial lines and real-time settings are checked. Without a cell file, only
    /// the host and its CAN interfaces are checked.
    cell: Option<PathBuf>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
    /// Correct the settings that this command can change, and ask before each correction. Then examine the host again.
    /// No cell may run on this host during the corrections.
    #[arg(long)]
    fix: bool,
    /// Do not ask before each correction.
    #[arg(long, requires = "fix")]
    yes: bool,
    /// Undo the changes of `--fix`, the latest first. No cell may run on this host. Exit status 1 means that a change
    /// could not be undone.
    #[arg(long, conflicts_with_all = ["cell", "json", "fix"])]
    undo: bool,
    /// The record of the changes. [default: below /var/lib/mrroc, or below XDG_STATE_HOME for users other than root]
    #[arg(long, value_name = "FILE")]
    state: Option<PathBuf>,
}

/// Results of the examination.
#[derive(Serialize)]
pub struct Examined {
    cell: Option<String>,
    verdict: Verdict,
    findings: Vec<Finding>,
}

/// Examines the host, for a cell if one is given. Changes nothing.
pub fn examine_host(file: Option<&CellFile>) -> anyhow::Result<Examined> {
    let cell = file.map(|file| &file.cell);
    let findings = examine(&Tree::new("/"), cell)?;
    let worst = findings.iter().map(|finding| finding.verdict).max();
    Ok(Examined { cell: cell.map(|cell| cell.name.clone()), verdict: worst.unwrap_or(Verdict::Ok), findings })
}

/// Examines the host and prints the findings.
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
    let mut found = examine_host(file.as_ref())?;
    if options.fix {
        let mut record = Record::open(&state(&tree, options)?)?;
        let agreed = |finding: &Finding| match options.yes {
            true => Ok(true),
            false => mend::asked(finding),
        };
        mend::fix(&tree, &found.findings, &mut record, agreed)?;
        found = examine_host(file.as_ref())?;
    }
    streams::answer(&found, options.json)?;
    Ok(ExitCode::from(match found.verdict {
        Verdict::Ok => 0,
        Verdict::Warning => 1,
        Verdict::NotUsable => 2,
    }))
}

fn undo(tree: &Tree, options: &Options) -> anyhow::Result<ExitCode> {
    let path = state(tree, options)?;
    let record = path.try_exists().unwrap_or(true).then(|| Record::existing(&path)).transpose()?;
    let Some(mut record) = record.filter(|record| !record.changes().is_empty()) else {
        streams::say(format_args!("{}: nothing to put back", path.display()))?;
        return Ok(ExitCode::SUCCESS);
    };
    Ok(ExitCode::from(u8::from(mend::undo(tree, &mut record)? > 0)))
}

/// Path of the record of changes.
fn state(tree: &Tree, options: &Options) -> anyhow::Result<PathBuf> {
    const NAME: &str = "doctor-undo.json";
    if let Some(file) = &options.state {
        return Ok(file.clone());
    }
    if limits::Identity::of(tree).is_root() {
        return Ok(PathBuf::from("/var/lib/mrroc").join(NAME));
    }
    let absolute = |name| env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let directory = absolute("XDG_STATE_HOME").or_else(|| Some(absolute("HOME")?.join(".local/state")));
    Ok(directory.context("no HOME for the record of changes: --state FILE")?.join("mrroc").join(NAME))
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
        // Sends nothing; the socket is closed at once.
        let opened = SocketCanPort::open(&wanted.interface, &SocketCanOptions::default());
        let opened = match opened.map(drop) {
            // The length of the queue is a finding of its own.
            Err(OpenError::ShortQueue { .. }) => Ok(()),
            opened => opened,
        };
        findings.extend(can_interfaces::findings(tree, &wanted, opened, link.as_ref()));
    }
    for wanted in lines {
        findings.extend(serial_lines::findings(tree, &wanted));
    }

    sleep_until(end);
    let cpuinfo = tree.text("/proc/cpuinfo").unwrap_or_default();
    findings.push(cpu::steal(&cpuinfo, &before, &stat()));
    Ok(findings)
}

/// Interfaces and ttys of the cell; without a cell, the CAN interfaces of the host.
fn wanted(tree: &Tree, cell: Option<&Cell>) -> (Vec<can_interfaces::Wanted>, Vec<serial_lines::Wanted>) {
    let (mut interfaces, mut lines) = (Vec::new(), Vec::new());
    let Some(cell) = cell else {
        let of_host = can_interfaces::present(tree).into_iter().map(|interface| can_interfaces::Wanted {
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
                send_queue: cell.frames_per_cycle(index),
                servo_cpu: cell.realtime.cpu,
            }),
            Interface::Slcan { path, .. } | Interface::Epos { path, .. } => {
                lines.push(serial_lines::Wanted { of: format!("bus {}, {path}", bus.name), path });
            }
        }
    }
    for sensor in sensor_lines(cell) {
        let path = sensor.line.to_owned();
        lines.push(serial_lines::Wanted { of: format!("{} {}, {path}", sensor.what, sensor.name), path });
    }
    for bundle in cell.bus.len()..cell.groups().count() {
        lines.extend(cell.axes_on(bundle).map(|(robot, axis)| {
            let (robot, axis) = (&cell.robot[robot], &cell.robot[robot].axis[axis]);
            let path = &axis.axis_controller().line;
            serial_lines::Wanted { of: format!("axis {}.{}, {path}", robot.name, axis.name), path: path.clone() }
        }));
    }
    (interfaces, lines)
}

/// Starts a thread with the scheduling of the servo thread, and returns the answer of the host. The thread ends at
/// once.
fn try_scheduler(realtime: &Realtime, period: Duration) -> anyhow::Result<Result<(), Denial>> {
    let Realtime { scheduler, priority, .. } = *realtime;
    let asking = thread::Builder::new().spawn(move || match scheduler {
        Scheduler::Fifo => set_fifo(priority),
        Scheduler::Deadline => set_deadline(period),
    });
    let asking = asking.context("a thread to ask for its priority")?;
    Ok(asking.join().expect("asking does not panic"))
}

impl fmt::Display for Examined {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for finding in &self.findings {
            let Finding { of, what, read, why, .. } = finding;
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
        let count = |verdict| self.findings.iter().filter(|finding| finding.verdict == verdict).count();
        let whose = self.cell.as_deref().map(|cell| format!(" for {cell}")).unwrap_or_default();
        let warnings = count(Verdict::Warning);
        match self.verdict {
            Verdict::Ok => writeln!(f, "\nready{whose}"),
            Verdict::Warning => writeln!(f, "\nusable{whose}, with warnings: {warnings}"),
            Verdict::NotUsable => {
                writeln!(f, "\nnot usable{whose}: {} in the way, warnings: {warnings}", count(Verdict::NotUsable))
            }
        }
    }
}
