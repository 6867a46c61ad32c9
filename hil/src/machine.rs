//! What the test machines have in common: what to run in them, and where its exit status comes out.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use can::clock;
use thiserror::Error;

/// Where a machine has file systems of its own.
const HIDDEN: [&str; 4] = ["/tmp", "/var/tmp", "/run", "/dev"];

/// How long the output of a killed machine may take to end.
const GRACE: Duration = Duration::from_secs(5);

/// Why a test machine that was started, or was to be, did not deliver the exit status of its command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum MachineError {
    /// The machine ended before the command began; the boot's messages are in the output.
    #[error("the test machine did not boot")]
    BootFailed,
    /// The machine ended without the command's exit status: its kernel died, or it was killed.
    #[error("the test machine ended before its command did")]
    Died,
    /// It was killed at the end of its time.
    #[error("the test machine was killed after {0:?}")]
    TimedOut(Duration),
    /// The host refused something.
    #[error("cannot {doing}: {kind}")]
    Host {
        /// What was tried.
        doing: &'static str,
        /// How it failed.
        kind: io::ErrorKind,
    },
}

/// What to run in the test machine.
#[derive(Clone, Debug)]
pub struct Options {
    /// The program, looked up on the machine's `PATH`, and its arguments.
    pub command: Vec<OsString>,
    /// Environment of the program, beside `PATH` and `MRROC_OUT`, the output directory. Nothing else of
    /// the host's environment gets inside.
    pub env: Vec<(OsString, OsString)>,
    /// Working directory of the program.
    pub directory: PathBuf,
    /// Further directories of the host to be seen inside, read-only, wherever they lie.
    pub visible: Vec<PathBuf>,
    /// The one directory of the host that the program can write to; `None` makes one and removes it.
    pub output: Option<PathBuf>,
    /// Memory of the machine, MiB.
    pub memory_mib: u32,
    /// How long it may take from start to power-off.
    pub timeout: Duration,
}

impl Options {
    /// Runs `command` in the root directory, with 256 MiB for a minute at most.
    pub fn new(command: impl IntoIterator<Item = impl Into<OsString>>) -> Self {
        Self {
            command: command.into_iter().map(Into::into).collect(),
            env: Vec::new(),
            directory: PathBuf::from("/"),
            visible: Vec::new(),
            output: None,
            memory_mib: 256,
            timeout: Duration::from_secs(60),
        }
    }

    /// What is to be seen inside and lies where the machine has file systems of its own.
    pub(crate) fn hidden(&self) -> Vec<PathBuf> {
        let program = self.command.first();
        let program = program.filter(|program| program.as_bytes().contains(&b'/'));
        let program = program.map(|program| self.directory.join(program));
        let program = program.as_deref().and_then(Path::parent);
        let directories = self.visible.iter().map(PathBuf::as_path);
        let directories = directories.chain([self.directory.as_path()]).chain(program);
        let is_hidden = |place: &&Path| HIDDEN.iter().any(|hidden| place.starts_with(hidden));
        directories.filter(is_hidden).map(Path::to_owned).collect()
    }
}

/// The machine's own directory inside the output directory, removed with everything in it. The exit status
/// of the command goes to its file `status`.
pub(crate) struct Control {
    pub(crate) path: PathBuf,
    /// What to remove: the directory itself, or the whole output directory if it was made for this run.
    remove: PathBuf,
}

impl Control {
    pub(crate) fn new(machine: &str, output: Option<&Path>) -> io::Result<Self> {
        static RUNS: AtomicU32 = AtomicU32::new(0);
        let run = RUNS.fetch_add(1, Ordering::Relaxed);
        let name = format!("mrroc-{machine}-{}-{run}", std::process::id());
        let (output, made) = match output {
            Some(output) => (output.to_path_buf(), false),
            None => (std::env::temp_dir().join(&name), true),
        };
        fs::create_dir_all(&output)?;
        let output = output.canonicalize()?;
        let path = output.join(format!(".{name}"));
        let remove = if made { output } else { path.clone() };
        fs::create_dir(&path)?;
        Ok(Self { path, remove })
    }

    /// The output directory.
    pub(crate) fn output(&self) -> &Path {
        self.path.parent().expect("made in the output directory")
    }

    /// What the command ended with, of a machine that has ended; without that it matters whether the command `began`.
    pub(crate) fn result(&self, began: bool) -> Result<u8, MachineError> {
        let status = fs::read_to_string(self.path.join("status")).ok();
        let status = status.and_then(|status| status.trim().parse().ok());
        status.ok_or(if began {
            MachineError::Died
        } else {
            MachineError::BootFailed
        })
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        // Nothing can be done about a directory that somebody else holds.
        let _ = fs::remove_dir_all(&self.remove);
    }
}

/// Shows the `output` of a `machine`, which is killed when dropped, until it ends; after `timeout` it is made to.
pub(crate) fn pump<Machine>(
    machine: Machine,
    output: &Receiver<Vec<u8>>,
    timeout: Duration,
    mut show: impl FnMut(&[u8]),
) -> Result<(), MachineError> {
    let deadline = clock::now() + timeout;
    loop {
        match output.recv_timeout(deadline.since(clock::now())) {
            Ok(piece) => show(&piece),
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
            Err(RecvTimeoutError::Timeout) => break,
        }
    }
    drop(machine);
    // What was printed just before the end says most of why it hangs. The output ends with the last of the processes.
    while let Ok(piece) = output.recv_timeout(GRACE) {
        show(&piece);
    }
    Err(MachineError::TimedOut(timeout))
}

/// Says what the host refused.
pub(crate) fn host(doing: &'static str) -> impl Fn(io::Error) -> MachineError {
    move |error| MachineError::Host {
        doing,
        kind: error.kind(),
    }
}

/// The command as a shell reads it.
pub(crate) fn command_script(options: &Options) -> Vec<u8> {
    let mut script = b"cd ".to_vec();
    script.extend(quoted(options.directory.as_os_str()));
    // Should we be killed before the machine, this still ends it.
    let limit = options.timeout.as_secs() + 1;
    script.extend(format!(" || exit 126\nexec timeout --signal=KILL {limit} env").bytes());
    for (name, value) in &options.env {
        script.push(b' ');
        let mut setting = name.clone();
        setting.push("=");
        setting.push(value);
        script.extend(quoted(&setting));
    }
    for word in &options.command {
        script.push(b' ');
        script.extend(quoted(word));
    }
    script.extend(b" 2>&1\n");
    script
}

/// `word` so that a shell reads it back as one word, whatever is in it.
pub(crate) fn quoted(word: &OsStr) -> Vec<u8> {
    let mut script = vec![b'\''];
    for &byte in word.as_bytes() {
        match byte {
            b'\'' => script.extend(br"'\''"),
            other => script.push(other),
        }
    }
    script.push(b'\'');
    script
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
            r"exec timeout --signal=KILL 61 env 'A=it'\''s $HOME' 'echo' '' '`x`' 2>&1",
            "\n"
        );
        assert_eq!(
            String::from_utf8(command_script(&options)).unwrap(),
            expected
        );
    }
}
