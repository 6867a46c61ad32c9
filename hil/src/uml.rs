//! A test machine with CAN for hosts whose kernel has none: user-mode Linux, a kernel that runs as a
//! process, booted in about three seconds on the host's own file system.
//!
//! The command inside can write to one directory of the host and nowhere else. The machine ends within its time and
//! leaves no process and no file behind. Interface `vcan0` is up; `can-utils`, `ip` and `tc` work as on any host.
//! There is one processor, and its timing proves nothing. `/tmp`, `/var/tmp`, `/run` and `/dev` are the machine's
//! own: what lies there on the host is not seen inside, but for the working directory, the program's directory and
//! those of [`Options::visible`].
//!
//! Read [`Options`], then [`run`]; the machine's first process is `uml-init.sh`.

use std::fs;
use std::io::{self, BufRead, BufReader, PipeReader, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;

use thiserror::Error;

use crate::machine::{Control, command_script, host, pump, quoted};
pub use crate::machine::{MachineError, Options};

/// The kernel, as Debian's package `user-mode-linux` installs it.
const KERNEL: &str = "/usr/bin/linux.uml";
const MODULES: &str = "/usr/lib/uml/modules";
const INIT: &str = include_str!("uml-init.sh");
/// Lines on their way from the console; a full queue stops the machine's writer.
const CONSOLE_LINES: usize = 256;
/// What is kept of the boot's messages, to be shown if it fails.
const BOOT_LOG_BYTES: usize = 64 << 10;

/// Why a test machine did not deliver the exit status of its command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum UmlError {
    /// The kernel is not installed.
    #[error("{KERNEL} is missing: `apt-get install user-mode-linux`")]
    KernelMissing,
    /// The kernel's CAN modules are not installed.
    #[error("no CAN modules in {MODULES}: `apt-get install user-mode-linux`")]
    ModulesMissing,
    /// It did not run to its end.
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

/// Boots a test machine, runs the command in it and returns its exit status (128 + n if signal n
/// ended it).
///
/// What the command prints, on either stream, goes to `stdout` line by line; so do the boot's messages
/// if the boot fails.
pub fn run(options: &Options, stdout: &mut dyn Write) -> Result<u8, UmlError> {
    installed()?;
    let control = Control::new("uml", options.output.as_deref())
        .and_then(|control| write(&control, options).map(|()| control))
        .map_err(host("write the output directory"))?;
    let (machine, console) =
        Machine::start(options, &control).map_err(host("start the test machine"))?;
    let mut screen = Screen::new(mark(&control));
    pump(machine, &console, options.timeout, |line| {
        screen.show(line, stdout);
    })?;
    let result = control.result(screen.part != Part::Boot);
    if result == Err(MachineError::BootFailed) {
        // The error is what matters; a reader who left does not.
        let _ = stdout.write_all(&screen.boot_log);
        if let Ok(step) = fs::read_to_string(control.path.join("failed")) {
            let _ = writeln!(stdout, "the boot failed at: {}", step.trim_end());
        }
    }
    Ok(result?)
}

fn write(control: &Control, options: &Options) -> io::Result<()> {
    let init = control.path.join("init");
    fs::write(&init, INIT)?;
    fs::set_permissions(&init, fs::Permissions::from_mode(0o755))?;
    fs::write(control.path.join("mounts"), mount_script(options))?;
    fs::write(control.path.join("command"), command_script(options))
}

/// The line before and behind the command's output: no other run has the same.
fn mark(control: &Control) -> Vec<u8> {
    let name = control.path.file_name().expect("made with a name");
    [name.as_bytes(), b"\n"].concat()
}

/// Mounts what is to be seen inside and would be hidden.
fn mount_script(options: &Options) -> Vec<u8> {
    let mount = |place: &PathBuf| {
        let place = quoted(place.as_os_str());
        let words: [&[u8]; 7] = [
            b"mkdir -p ",
            &place,
            b"; mount -t hostfs -r -o ",
            &place,
            b" none ",
            &place,
            b"\n",
        ];
        words.concat()
    };
    options.hidden().iter().flat_map(mount).collect()
}

/// The machine's processes, all in one group, killed and awaited on drop.
struct Machine(Child);

impl Machine {
    fn start(options: &Options, control: &Control) -> io::Result<(Self, Receiver<Vec<u8>>)> {
        let (console, output) = io::pipe()?;
        let directory = control.path.display();
        let child = Command::new("setsid")
            .arg(KERNEL)
            .args(["root=/dev/root", "rootfstype=hostfs", "rootflags=/", "ro"])
            .args(["con=null", "con0=null,fd:1", "quiet"])
            .arg(format!("mem={}M", options.memory_mib))
            .arg(format!("uml_dir={directory}/"))
            .arg(format!("init=\"{directory}/init\""))
            .stdin(Stdio::null())
            .stdout(output.try_clone()?)
            .stderr(output)
            .spawn()?;
        let machine = Self(child);
        let (lines, received) = sync_channel(CONSOLE_LINES);
        let read = move || read_lines(console, |line| lines.send(line).is_ok());
        thread::Builder::new()
            .name("uml console".into())
            .spawn(read)?;
        Ok((machine, received))
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        // The leader was not awaited yet, so its number cannot have gone to another process.
        let kill = format!("kill -s KILL -- -{}", self.0.id());
        let _ = Command::new("sh")
            .args(["-c", &kill])
            .stderr(Stdio::null())
            .status();
        let _ = self.0.wait();
    }
}

fn read_lines(console: PipeReader, mut take: impl FnMut(Vec<u8>) -> bool) {
    let mut console = BufReader::new(console);
    loop {
        let mut line = Vec::new();
        match console.read_until(b'\n', &mut line) {
            Ok(1..) if take(line) => {}
            _ => return,
        }
    }
}

/// Tells the command's output from the kernel's chatter before and behind it.
struct Screen {
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
        Self {
            mark,
            part: Part::Boot,
            boot_log: Vec::new(),
        }
    }

    fn show(&mut self, line: &[u8], stdout: &mut dyn Write) {
        // The command's last line may lack its end, and then the mark stands on it.
        let marked = line.strip_suffix(self.mark.as_slice());
        match (self.part, marked) {
            (Part::Boot, None) => {
                let room = BOOT_LOG_BYTES.saturating_sub(self.boot_log.len());
                self.boot_log.extend(&line[..line.len().min(room)]);
            }
            (Part::Boot, Some(_)) => self.part = Part::Command,
            (Part::Command, _) => {
                // The command runs on when nobody reads what it prints.
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
    fn what_would_be_hidden_is_mounted() {
        let mounts = |directory: &str, visible: &str, program: &str| {
            let options = Options {
                directory: directory.into(),
                visible: vec![visible.into()],
                ..Options::new([program])
            };
            String::from_utf8(mount_script(&options)).unwrap()
        };
        let mount = |place: &str| {
            format!("mkdir -p '{place}'; mount -t hostfs -r -o '{place}' none '{place}'\n")
        };
        assert_eq!(mounts("/", "/tmpfs", "sh"), "");
        assert_eq!(mounts("/home/x", "/usr", "target/mrroc"), "");
        assert_eq!(mounts("/tmp/a b", "/usr", "sh"), mount("/tmp/a b"));
        let all = [mount("/run/it"), mount("/tmp/x"), mount("/tmp/x/target")].concat();
        assert_eq!(mounts("/tmp/x", "/run/it", "target/mrroc"), all);
        assert_eq!(mounts("/usr", "/", "/dev/shm/mrroc"), mount("/dev/shm"));
    }

    #[test]
    fn only_what_stands_between_the_marks_is_shown() {
        let mut screen = Screen::new(b"MARK\n".to_vec());
        let mut shown = Vec::new();
        for line in [
            "boot\n",
            "MARK\n",
            "one\n",
            "twoMARK\n",
            "reboot: Power down\n",
        ] {
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
            assert!(
                error
                    .to_string()
                    .ends_with("`apt-get install user-mode-linux`")
            );
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
