//! Common parts of the test machines: the command, its directories, its exit status, and the end of the machine.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

mod supervisor;
mod trust;

use std::ffi::{OsStr, OsString};
use std::fs::{self, File, Permissions};
use std::io::{self, PipeReader};
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread;
use std::time::Duration;

use can::clock;
use tempfile::TempDir;
use thiserror::Error;

pub use supervisor::Cancellation;
use supervisor::Supervisor;
use trust::Distrust;

/// Paths at which a machine has file systems of its own.
const HIDDEN: [&str; 4] = ["/tmp", "/var/tmp", "/run", "/dev"];
/// Capacity of the queue of output pieces. A full queue stops the machine's writer.
const OUTPUT_PIECES: usize = 256;
/// Time allowed for the output of a killed machine to end.
const GRACE: Duration = Duration::from_secs(5);

/// Reasons why a test machine delivered no exit status of its command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum MachineError {
    /// The machine ended before the command began. The output contains the boot messages.
    #[error("the test machine did not boot")]
    BootFailed,
    /// The machine ended without the command's exit status: the kernel crashed, or the machine was killed.
    #[error("the test machine ended before its command did")]
    Died,
    #[error("the test machine was killed after {0:?}")]
    TimedOut(Duration),
    /// The machine was killed because its [`Cancellation`] was requested.
    #[error("the test machine was stopped on request")]
    Cancelled,
    /// Another user can replace files of the machine.
    #[error("{directory}, or one above it, belongs to user {user}, who can change what lies there: name another")]
    Foreign { directory: Directory, user: u32 },
    /// Other users can put other files in the place of the machine's.
    #[error("{directory}, or one above it, can be changed by other users: name another, or `chmod go-w` it")]
    Shared { directory: Directory },
    /// The kernel's command line cannot carry the name.
    #[error("{0} has a name of other signs than letters, digits and ./_-: name another")]
    Name(Directory),
    /// The host refused an operation.
    #[error("cannot {doing}: {kind}")]
    Host { doing: &'static str, kind: io::ErrorKind },
}

/// A directory that a machine works with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Directory {
    /// The directory of [`Options::output`].
    #[error("the output directory")]
    Output,
    /// The directory of temporary files, in which the machine's own directory is made.
    #[error("the directory for temporary files (TMPDIR)")]
    Temporary,
}

impl Directory {
    fn distrusted(self, why: Distrust) -> MachineError {
        match why {
            Distrust::Foreign(user) => MachineError::Foreign { directory: self, user },
            Distrust::Shared => MachineError::Shared { directory: self },
            Distrust::Unknown(kind) => MachineError::Host {
                doing: match self {
                    Self::Output => "make the output directory",
                    Self::Temporary => "look at the directory for temporary files",
                },
                kind,
            },
        }
    }
}

/// Options of a run in the test machine.
#[derive(Clone, Debug)]
pub struct Options {
    /// The program, looked up on the machine's `PATH`, and its arguments.
    pub command: Vec<OsString>,
    /// Environment of the program, in addition to `PATH` and `MRROC_OUT`, the output directory. No other variable of
    /// the host's environment is passed on.
    pub env: Vec<(OsString, OsString)>,
    /// Working directory of the program.
    pub directory: PathBuf,
    /// Further directories of the host that are visible inside, read-only, at any path.
    pub visible: Vec<PathBuf>,
    /// The one directory of the host to which the program can write. A missing directory is made. The directory is
    /// refused if other users can change its content or its path. `None` makes a directory and removes it afterwards.
    pub output: Option<PathBuf>,
    /// Memory of the machine, MiB.
    pub memory_mib: u32,
    /// Time limit from start to power-off.
    pub timeout: Duration,
    /// Ends the machine before its time limit.
    pub cancellation: Cancellation,
}

impl Options {
    /// Runs `command` in the root directory, with 256 MiB and a time limit of one minute.
    pub fn new(command: impl IntoIterator<Item = impl Into<OsString>>) -> Self {
        Self {
            command: command.into_iter().map(Into::into).collect(),
            env: Vec::new(),
            directory: PathBuf::from("/"),
            visible: Vec::new(),
            output: None,
            memory_mib: 256,
            timeout: Duration::from_secs(60),
            cancellation: Cancellation::default(),
        }
    }

    /// Visible paths that lie below file systems of the machine's own.
    pub(crate) fn hidden(&self) -> Vec<PathBuf> {
        let program = self.command.first().filter(|program| program.as_bytes().contains(&b'/'));
        let program = program.map(|program| self.directory.join(program));
        let program = program.as_deref().and_then(Path::parent);
        let directories = self.visible.iter().map(PathBuf::as_path).chain([self.directory.as_path()]).chain(program);
        let is_hidden = |place: &&Path| HIDDEN.iter().any(|hidden| place.starts_with(hidden));
        directories.filter(is_hidden).map(Path::to_owned).collect()
    }
}

/// The machine's own directory. No other user can read the directory, and it is removed with its content. The exit
/// status of the command goes to its file `status`.
pub(crate) struct Control {
    /// The path of the directory. The path contains no character that is special in a command line or a mount option.
    pub(crate) path: PathBuf,
    pub(crate) output: PathBuf,
    _directory: TempDir,
}

impl Control {
    pub(crate) fn new(machine: &str, output: Option<&Path>) -> Result<Self, MachineError> {
        let make = || {
            let directory = tempfile::Builder::new()
                .prefix(&format!("mrroc-{machine}-"))
                .permissions(Permissions::from_mode(0o700))
                .tempdir()?;
            let user = fs::symlink_metadata(directory.path())?.uid();
            let path = std::path::absolute(directory.path())?;
            Ok((directory, path, user))
        };
        let (directory, path, user) = make().map_err(host("make a temporary directory"))?;
        let here = Directory::Temporary;
        let path = trust::resolve(&path, user).map_err(|why| here.distrusted(why))?;
        let plain = |byte: &u8| byte.is_ascii_alphanumeric() || b"./_-".contains(byte);
        if !path.as_os_str().as_bytes().iter().all(plain) {
            return Err(MachineError::Name(here));
        }
        let output = output.map_or_else(|| path.join("output"), Path::to_owned);
        let output = trust::own(&output, user).map_err(|why| Directory::Output.distrusted(why))?;
        Ok(Self { path, output, _directory: directory })
    }
}

/// A machine and its directory. Dropping the value ends the machine and removes the directory.
pub(crate) struct Machine {
    // Dropped first, since the machine writes to the directory.
    supervisor: Supervisor,
    pub(crate) control: Control,
    output: Receiver<Vec<u8>>,
    cancellation: Cancellation,
}

impl Machine {
    /// Prepares a machine that `command` will start. The machine writes to a pipe and to `errors`; `None` is the same
    /// pipe. A thread runs `read`, which passes pieces of the output on until its argument returns `false`. From now
    /// on the directory is removed even if this program is killed.
    pub(crate) fn new(
        control: Control,
        command: impl IntoIterator<Item = OsString>,
        errors: Option<File>,
        read: fn(PipeReader, &mut dyn FnMut(Vec<u8>) -> bool),
        cancellation: &Cancellation,
    ) -> io::Result<Self> {
        let (reader, writer) = io::pipe()?;
        let errors = match errors {
            Some(file) => OwnedFd::from(file),
            None => writer.try_clone()?.into(),
        };
        let supervisor = Supervisor::new(&control.path, command, writer, errors, cancellation)?;
        let (pieces, output) = sync_channel(OUTPUT_PIECES);
        let read = move || read(reader, &mut |piece| pieces.send(piece).is_ok());
        thread::Builder::new().name("machine output".into()).spawn(read)?;
        Ok(Self { supervisor, control, output, cancellation: cancellation.clone() })
    }

    /// Starts the machine and shows its output until the machine ends. After `timeout` the machine is killed.
    pub(crate) fn run(&self, timeout: Duration, mut show: impl FnMut(&[u8])) -> Result<(), MachineError> {
        let deadline = clock::now() + timeout;
        self.supervisor.start().map_err(host("start the test machine"))?;
        loop {
            match self.output.recv_timeout(deadline.since(clock::now())) {
                Ok(piece) => show(&piece),
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
                Err(RecvTimeoutError::Timeout) => break,
            }
        }
        self.supervisor.kill();
        // The output just before the end is the best clue to a hang. The output ends with the last process.
        while let Ok(piece) = self.output.recv_timeout(GRACE) {
            show(&piece);
        }
        Err(MachineError::TimedOut(timeout))
    }

    /// Exit status of the command of an ended machine. Without a status, the error depends on `began`.
    pub(crate) fn result(&self, began: bool) -> Result<u8, MachineError> {
        let status = fs::read_to_string(self.control.path.join("status")).ok();
        let status = status.and_then(|status| status.trim().parse().ok());
        status.ok_or(if self.cancellation.is_requested() {
            MachineError::Cancelled
        } else if began {
            MachineError::Died
        } else {
            MachineError::BootFailed
        })
    }
}

/// Names the operation that the host refused.
pub(crate) fn host(doing: &'static str) -> impl Fn(io::Error) -> MachineError {
    move |error| MachineError::Host { doing, kind: error.kind() }
}

/// The command as a shell script, with the path of the `output` directory.
pub(crate) fn command_script(options: &Options, output: &Path) -> Vec<u8> {
    let mut script = b"cd ".to_vec();
    script.extend(quoted(options.directory.as_os_str()));
    // This limit ends the machine even if supervisor and program are both killed.
    let limit = options.timeout.as_secs() + 1;
    script.extend(format!(" || exit 126\nexec timeout --signal=KILL {limit} env").bytes());
    let output = ("MRROC_OUT".into(), output.as_os_str().to_owned());
    for (name, value) in [&output].into_iter().chain(&options.env) {
        script.push(b' ');
        script.extend(quoted(&[name.as_os_str(), value].join(OsStr::new("="))));
    }
    for word in &options.command {
        script.push(b' ');
        script.extend(quoted(word));
    }
    script.extend(b" 2>&1\n");
    script
}

/// A line of a shell script that mounts `what` at `place`, seen from `root`.
pub(crate) fn mount(what: &[u8], root: &str, place: &Path) -> Vec<u8> {
    let place = [root.as_bytes(), &quoted(place.as_os_str())].concat();
    [b"mkdir -p ", &*place, b"; mount ", what, b" ", &place, b"\n"].concat()
}

/// Quotes `word`, which may contain any byte, so that a shell reads one word with the same bytes.
pub(crate) fn quoted(word: &OsStr) -> Vec<u8> {
    [b"'", &*replaced(word, b'\'', br"'\''"), b"'"].concat()
}

/// The bytes of `text`, with each `byte` replaced by the bytes `by`.
pub(crate) fn replaced(text: &OsStr, byte: u8, by: &[u8]) -> Vec<u8> {
    let parts: Vec<&[u8]> = text.as_bytes().split(|other| *other == byte).collect();
    parts.join(by)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_survives_the_shell() {
        let options = Options {
            env: vec![("A".into(), "it's $HOME".into())],
            directory: "/a b".into(),
            ..Options::new(["echo", "", "`x`"])
        };
        let expected = concat!(
            "cd '/a b' || exit 126\n",
            r"exec timeout --signal=KILL 61 env 'MRROC_OUT=/o' 'A=it'\''s $HOME' 'echo' '' '`x`' 2>&1",
            "\n"
        );
        assert_eq!(String::from_utf8(command_script(&options, Path::new("/o"))).unwrap(), expected);
    }
}
