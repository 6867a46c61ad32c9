//! A test machine with CAN for hosts whose kernel has no CAN. The machine is user-mode Linux, a kernel that runs as a
//! process, and boots in about three seconds on the host's own file system.
//!
//! The machine gives three guarantees. The command inside can write to one directory of the host and to no other. The
//! command ends within its time limit. No process and no file is left behind. The last guarantee holds even if the
//! calling program is killed: the shell of `supervise.sh` outlives that program. Other users of the host can neither
//! read nor change the machine's files.
//!
//! Interface `vcan0` is up. `can-utils`, `ip` and `tc` work as on any host. The machine has one processor, and its
//! timing proves nothing. `/tmp`, `/var/tmp`, `/run` and `/dev` belong to the machine: files of the host at these
//! paths are not visible inside. Exceptions are the working directory, the program's directory and those of
//! [`Options::visible`].
//!
//! Read [`Options`], then [`run`]. The machine's first process is `uml-init.sh`.

use std::ffi::OsString;
use std::fs;
use std::io::{self, BufRead, BufReader, PipeReader, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;

use thiserror::Error;

use crate::machine::{self, Control, Machine, command_script, host};
pub use crate::machine::{Cancellation, MachineError, Options};

/// The kernel, as Debian's package `user-mode-linux` installs it.
const KERNEL: &str = "/usr/bin/linux.uml";
const MODULES: &str = "/usr/lib/uml/modules";
const INIT: &str = include_str!("uml-init.sh");
/// The library of `uml-ptrace.c`.
const PTRACE: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/uml-ptrace.so"));
/// Maximum size of the stored boot messages, which are shown if the boot fails.
const BOOT_LOG_BYTES: usize = 64 << 10;

/// Reasons why a test machine did not deliver the exit status of its command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the message says it")]
pub enum UmlError {
    #[error("{KERNEL} is missing: `apt-get install user-mode-linux`")]
    KernelMissing,
    #[error("no CAN modules in {MODULES}: `apt-get install user-mode-linux`")]
    ModulesMissing,
    #[error(transparent)]
    Machine(#[from] MachineError),
}

/// Whether the kernel and its modules are installed.
pub fn installed() -> Result<(), UmlError> {
    installed_in(Path::new(KERNEL), Path::new(MODULES))
}

fn installed_in(kernel: &Path, modules: &Path) -> Result<(), UmlError> {
    if !kernel.exists() {
        return Err(UmlError::KernelMissing);
    }
    let versions = fs::read_dir(modules).map_err(|_| UmlError::ModulesMissing)?;
    versions
        .flatten()
        .any(|version| version.path().join("kernel/net/can/can-raw.ko").exists())
        .then_some(())
        .ok_or(UmlError::ModulesMissing)
}

/// Boots a test machine, runs the command in it and returns the exit status of the command (128 + n if signal n ended
/// the command).
///
/// Both output streams of the command go to `stdout` line by line. If the boot fails, the boot messages also go to
/// `stdout`.
pub fn run(options: &Options, stdout: &mut dyn Write) -> Result<u8, UmlError> {
    installed()?;
    let control = Control::new("uml", options.output.as_deref())?;
    let machine = machine(control, options).map_err(host("start the test machine"))?;
    write(&machine.control, options).map_err(host("write the machine's directory"))?;
    let name = machine.control.path.file_name().expect("made with a name");
    let mut screen = Screen::new([name.as_bytes(), b"\n"].concat());
    machine.run(options.timeout, |line| screen.show(line, stdout))?;
    let result = machine.result(screen.part != Part::Boot);
    if result == Err(MachineError::BootFailed) {
        // The boot error is returned. A failure to write the log is ignored.
        let _ = stdout.write_all(&screen.boot_log);
        if let Ok(step) = fs::read_to_string(machine.control.path.join("failed")) {
            let _ = writeln!(stdout, "the boot failed at: {}", step.trim_end());
        }
    }
    Ok(result?)
}

/// Writes the files that the machine's first process reads.
fn write(control: &Control, options: &Options) -> io::Result<()> {
    let file = |name| control.path.join(name);
    fs::write(file("ptrace.so"), PTRACE)?;
    fs::write(file("init"), INIT)?;
    fs::set_permissions(file("init"), fs::Permissions::from_mode(0o755))?;
    fs::write(file("mounts"), mount_script(control, options)?)?;
    fs::write(file("command"), command_script(options, &control.output))
}

/// A script that mounts [`Options::hidden`], then the output directory, which may lie in one of them. Each mount names
/// a symbolic link, because a mount option cannot carry every path.
fn mount_script(control: &Control, options: &Options) -> io::Result<Vec<u8>> {
    let mut script = Vec::new();
    let mut mount = |name: &str, place: &Path, access: &str| -> io::Result<()> {
        let link = control.path.join(name);
        symlink(place, &link)?;
        let what = format!("-t hostfs -o {access},{} none", link.display());
        script.extend(machine::mount(what.as_bytes(), "", place));
        Ok(())
    };
    for (number, place) in options.hidden().iter().enumerate() {
        mount(&format!("visible-{number}"), place, "ro")?;
    }
    mount("writable", &control.output, "rw")?;
    Ok(script)
}

/// The machine, not started yet.
fn machine(control: Control, options: &Options) -> io::Result<Machine> {
    let directory = control.path.display();
    let command = [
        "env",
        &format!("LD_PRELOAD={directory}/ptrace.so"),
        KERNEL,
        "root=/dev/root",
        "rootfstype=hostfs",
        "rootflags=/",
        "ro",
        "con=null",
        "con0=null,fd:1",
        "quiet",
        &format!("mem={}M", options.memory_mib),
        &format!("uml_dir={directory}/"),
        &format!("init={directory}/init"),
    ]
    .map(OsString::from);
    Machine::new(control, command, None, read_lines, &options.cancellation)
}

fn read_lines(console: PipeReader, take: &mut dyn FnMut(Vec<u8>) -> bool) {
    let mut console = BufReader::new(console);
    loop {
        let mut line = Vec::new();
        match console.read_until(b'\n', &mut line) {
            Ok(1..) if take(line) => {}
            _ => return,
        }
    }
}

/// Separates the command's output from the kernel's messages before and behind it.
struct Screen {
    /// The line before and behind the command's output, which differs from run to run.
    mark: Vec<u8>,
    part: Part,
    boot_log: Vec<u8>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Part {
    Boot,
    Command,
    PowerOff,
}

impl Screen {
    fn new(mark: Vec<u8>) -> Self {
        Self { mark, part: Part::Boot, boot_log: Vec::new() }
    }

    fn show(&mut self, line: &[u8], stdout: &mut dyn Write) {
        // If the command's last line has no line end, the mark stands on the same line.
        let marked = line.strip_suffix(self.mark.as_slice());
        match (self.part, marked) {
            (Part::Boot, None) => {
                let room = BOOT_LOG_BYTES.saturating_sub(self.boot_log.len());
                self.boot_log.extend(&line[..line.len().min(room)]);
            }
            (Part::Boot, Some(_)) => self.part = Part::Command,
            (Part::Command, _) => {
                // The command continues even if its output cannot be written.
                let _ = stdout.write_all(marked.unwrap_or(line));
                if marked.is_some() {
                    self.part = Part::PowerOff;
                }
            }
            (Part::PowerOff, _) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_would_be_hidden_is_mounted_and_the_output_directory_last() {
        let check = |directory: &str, visible: &str, program: &str, hidden: &[&str]| {
            let options =
                Options { directory: directory.into(), visible: vec![visible.into()], ..Options::new([program]) };
            let control = Control::new("test", None).unwrap();
            let script = String::from_utf8(mount_script(&control, &options).unwrap()).unwrap();
            let mut lines = script.lines();
            let mut mounted = |name: &str, place: &Path, access: &str| {
                let link = control.path.join(name);
                assert_eq!(fs::read_link(&link).unwrap(), place);
                let (link, place) = (link.display(), place.display());
                let expected = format!("mkdir -p '{place}'; mount -t hostfs -o {access},{link} none '{place}'");
                assert_eq!(lines.next(), Some(&*expected));
            };
            for (number, place) in hidden.iter().enumerate() {
                mounted(&format!("visible-{number}"), Path::new(place), "ro");
            }
            mounted("writable", &control.output, "rw");
            assert_eq!(lines.next(), None);
        };
        check("/", "/tmpfs", "sh", &[]);
        check("/home/x", "/usr", "target/mrroc", &[]);
        check("/tmp/a b", "/usr", "sh", &["/tmp/a b"]);
        let all = ["/run/it", "/tmp/x", "/tmp/x/target"];
        check("/tmp/x", "/run/it", "target/mrroc", &all);
        check("/usr", "/", "/dev/shm/mrroc", &["/dev/shm"]);
    }

    #[test]
    fn only_what_stands_between_the_marks_is_shown() {
        let mut screen = Screen::new(b"MARK\n".to_vec());
        let mut shown = Vec::new();
        for line in ["boot\n", "MARK\n", "one\n", "twoMARK\n", "reboot: Power down\n"] {
            screen.show(line.as_bytes(), &mut shown);
        }
        assert_eq!(shown, b"one\ntwo");
        assert_eq!(screen.boot_log, b"boot\n");
    }

    #[test]
    fn what_is_not_installed_is_named_with_the_package_that_has_it() {
        let (here, nowhere) = (Path::new("/"), Path::new("/nowhere"));
        for (kernel, modules, error) in [
            (nowhere, nowhere, UmlError::KernelMissing),
            (here, nowhere, UmlError::ModulesMissing),
            (here, Path::new("/proc/self"), UmlError::ModulesMissing),
        ] {
            assert_eq!(installed_in(kernel, modules), Err(error));
            assert!(error.to_string().ends_with("`apt-get install user-mode-linux`"));
        }
    }

    #[test]
    fn the_boot_log_is_bounded() {
        let mut screen = Screen::new(b"MARK\n".to_vec());
        for _ in 0..100 {
            screen.show(&[b'x'; 1024], &mut Vec::new());
        }
        assert_eq!(screen.boot_log.len(), BOOT_LOG_BYTES);
    }
}
