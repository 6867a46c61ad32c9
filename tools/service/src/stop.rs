//! `mrroc stop`: stops the controller of a cell that runs on this computer, in another process.
//!
//! The controller is the process that has claimed a CAN interface of the cell, or has locked one of its serial lines and
//! has a thread of the library's name. It gets SIGTERM: its robots brake, and their drives go off (category 1). A process
//! of another program that has locked a line gets no signal.

use std::collections::BTreeSet;
use std::fs;
use std::os::linux::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, bail};
use can::clock;
use clap::Args;
use mrroc::bench::Places;
use mrroc::bench::interfaces::Interface;
use mrroc::cell::{CellFile, printable};
use nix::sys::signal::{Signal, kill};
use nix::sys::stat::{major, minor};
use nix::unistd::Pid;

use super::say;

/// Time between two looks whether the controller has ended.
const LOOK: Duration = Duration::from_millis(20);

/// Threads of every controller: the servo, and the thread that takes signals from the beginning on.
const THREADS: [&str; 2] = ["servo", "signals"];

/// Options of `mrroc stop`.
#[derive(Args)]
pub struct Options {
    /// The cell file of the running controller.
    cell: PathBuf,
    /// The interface of a bus in place of the cell's: IFACE, or BUS=IFACE once for each of several buses.
    #[arg(long, value_name = "IFACE")]
    can: Vec<String>,
    /// The directory with the ttys of the controller, in place of the cell's lines.
    #[arg(long, value_name = "DIR")]
    serial: Option<PathBuf>,
    /// Longest wait until the controller has ended, s.
    #[arg(long, value_name = "S", default_value_t = 30)]
    timeout: u64,
}

/// Stops the controller of a cell, and waits until its process has ended. Exit status 1: the process did not end in time.
/// An error: no controller was found, or it must not be signalled.
pub fn stop(options: &Options) -> anyhow::Result<ExitCode> {
    let places = Places { can: options.can.clone(), serial: options.serial.clone(), ..Places::default() };
    let (interfaces, ttys) = places.all(&CellFile::read(&options.cell)?)?;
    let found = controllers(&interfaces, &ttys)?;
    if found.is_empty() {
        // The tty of an adapter is among the ttys.
        let cards = interfaces.iter().filter(|interface| matches!(interface, Interface::SocketCan(_)));
        let ttys = ttys.iter().map(|tty| tty.display().to_string());
        let places: Vec<_> = cards.map(ToString::to_string).chain(ttys).collect();
        bail!(
            "no process of this computer controls {}: give the --can and --serial of the run; only Ctrl-C stops a run on \
             the benches lockstep and emulated",
            places.join(", ")
        );
    }
    for &process in &found {
        kill(process, Signal::SIGTERM).with_context(|| format!("process {process} cannot be stopped"))?;
        say(format_args!("process {process}: told to stop"))?;
    }
    let deadline = clock::now() + Duration::from_secs(options.timeout);
    for process in found {
        while is_running(process) {
            if clock::now() > deadline {
                let waited = options.timeout;
                say(format_args!(
                    "process {process}: has not ended after {waited} s: press the emergency stop, then `kill -KILL {process}`"
                ))?;
                return Ok(ExitCode::from(1));
            }
            clock::sleep_until(clock::now() + LOOK);
        }
        say(format_args!("process {process}: ended"))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Whether the process exists and has not ended. A process that has ended exists until its parent asks for its status.
fn is_running(process: Pid) -> bool {
    // The state follows the name of the program, which is in parentheses and may contain any character.
    let status = fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    let state = status.rsplit_once(") ").and_then(|(_, rest)| rest.chars().next());
    !matches!(state, None | Some('Z' | 'X'))
}

/// The processes that control one of the interfaces or lines, each once.
fn controllers(interfaces: &[Interface], ttys: &[PathBuf]) -> anyhow::Result<BTreeSet<Pid>> {
    let mut found = BTreeSet::new();
    for interface in interfaces {
        // An interface that does not exist has no controller.
        if let Some(holder) = interface.controller().ok().flatten() {
            let process = holder.process().with_context(|| format!("{interface}: its controller hides its process"))?;
            found.insert(Pid::from_raw(process.cast_signed()));
        }
    }
    let locks = fs::read_to_string("/proc/locks").context("/proc/locks")?;
    for tty in ttys {
        let Some(process) = holder_of(&locks, tty) else {
            continue;
        };
        if !is_controller(process) && is_running(process) {
            let name = fs::read_to_string(format!("/proc/{process}/comm")).unwrap_or_default();
            bail!(
                "process {process} ({}) has locked {}, and is no controller of mrroc: end it by its own means",
                printable(name.trim_end()),
                tty.display()
            );
        }
        found.insert(process);
    }
    Ok(found)
}

/// Whether a process has a thread of a controller.
fn is_controller(process: Pid) -> bool {
    let tasks = fs::read_dir(format!("/proc/{process}/task")).into_iter().flatten().flatten();
    let mut names = tasks.filter_map(|task| fs::read_to_string(task.path().join("comm")).ok());
    names.any(|name| THREADS.contains(&name.trim_end()))
}

/// The process that has locked the file at `path`, by the kernel's list of locks.
fn holder_of(locks: &str, path: &Path) -> Option<Pid> {
    let file = fs::metadata(path).ok()?;
    let (major, minor) = (major(file.st_dev()), minor(file.st_dev()));
    let place = format!("{major:02x}:{minor:02x}:{}", file.st_ino());
    locks.lines().find_map(|line| {
        // `1: FLOCK  ADVISORY  WRITE 4711 00:18:5 0 EOF`
        let mut words = line.split_whitespace().skip(1);
        let (kind, process) = (words.next()?, words.nth(2)?);
        let holds = kind == "FLOCK" && words.next()? == place;
        process.parse().ok().filter(|_| holds).map(Pid::from_raw)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_holder_of_a_locked_file_is_this_process() {
        let path = std::env::temp_dir().join(format!("mrroc-lock-{}", std::process::id()));
        let file = fs::File::create_new(&path).unwrap();
        let holder = || holder_of(&fs::read_to_string("/proc/locks").unwrap(), &path);
        assert_eq!(holder(), None);
        file.lock().unwrap();
        let held = holder();
        fs::remove_file(&path).unwrap();
        assert_eq!(held, Some(Pid::this()));
        assert_eq!(holder_of("1: FLOCK ADVISORY WRITE 1 00:00:1 0 EOF", Path::new("/nowhere")), None);
    }

    #[test]
    fn a_controller_is_known_by_its_threads_and_another_process_is_refused() {
        let path = std::env::temp_dir().join(format!("mrroc-foreign-{}", std::process::id()));
        let file = fs::File::create_new(&path).unwrap();
        file.lock().unwrap();
        let ttys = [path.clone()];
        let found = || controllers(&[], &ttys);
        let refused = found().unwrap_err().to_string();
        let ((end, ended), (begin, begun)) = (std::sync::mpsc::channel::<()>(), std::sync::mpsc::channel());
        let body = move || {
            begin.send(()).unwrap();
            _ = ended.recv();
        };
        let servo = std::thread::Builder::new().name("servo".into()).spawn(body).unwrap();
        begun.recv().unwrap();
        let controls = found().unwrap();
        drop(end);
        servo.join().unwrap();
        fs::remove_file(&path).unwrap();
        assert!(refused.starts_with(&format!("process {} (", Pid::this())), "{refused}");
        assert!(refused.contains("is no controller of mrroc"), "{refused}");
        assert_eq!(controls, BTreeSet::from([Pid::this()]));
    }
}
