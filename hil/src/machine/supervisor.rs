//! The supervisor of a test machine: a process that outlives the calling program, kills the machine and removes the
//! machine's directory.

use std::ffi::OsStr;
use std::io::{self, PipeWriter, Write};
use std::os::fd::OwnedFd;
use std::path::Path;
use std::process::{Child, Command};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

const SUPERVISE: &str = include_str!("../supervise.sh");

/// Ends a test machine from another thread, for example after a signal. Serves one machine at a time.
#[derive(Clone, Debug, Default)]
pub struct Cancellation(Arc<Mutex<CancelState>>);

#[derive(Debug, Default)]
struct CancelState {
    requested: bool,
    /// Closing this pipe ends the machine.
    pipe: Option<PipeWriter>,
}

impl Cancellation {
    /// Kills the machine. A machine that has not been started yet never starts.
    pub fn cancel(&self) {
        let mut state = self.state();
        state.requested = true;
        state.pipe = None;
    }

    /// Whether the end of the machine was requested.
    pub fn is_requested(&self) -> bool {
        self.state().requested
    }

    fn state(&self) -> MutexGuard<'_, CancelState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A supervisor and its machine. Dropping the value ends both and removes the directory.
#[derive(Debug)]
pub(super) struct Supervisor {
    shell: Child,
    cancellation: Cancellation,
}

impl Supervisor {
    /// A supervisor that is ready to start `command`, the machine, and removes `directory` at the end.
    pub(super) fn new<Word: AsRef<OsStr>>(
        directory: &Path,
        command: impl IntoIterator<Item = Word>,
        stdout: impl Into<OwnedFd>,
        stderr: impl Into<OwnedFd>,
        cancellation: &Cancellation,
    ) -> io::Result<Self> {
        let (watched, pipe) = io::pipe()?;
        let shell = Command::new("setsid")
            .args(["sh", "-c", SUPERVISE, "sh"])
            .arg(directory)
            .args(command)
            .stdin(watched)
            .stdout(stdout.into())
            .stderr(stderr.into())
            .spawn()?;
        let supervisor = Self { shell, cancellation: cancellation.clone() };
        let mut state = cancellation.state();
        state.pipe = Some(pipe).filter(|_| !state.requested);
        drop(state);
        Ok(supervisor)
    }

    /// Starts the machine, unless the machine was cancelled.
    pub(super) fn start(&self) -> io::Result<()> {
        let mut state = self.cancellation.state();
        state.pipe.as_mut().map_or(Ok(()), |pipe| pipe.write_all(b"start\n"))
    }

    pub(super) fn kill(&self) {
        self.cancellation.state().pipe = None;
    }
}

impl Drop for Supervisor {
    fn drop(&mut self) {
        self.kill();
        // The wait fails only after an earlier wait for the supervisor. In that case the supervisor has already
        // ended.
        let _ = self.shell.wait();
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::io::{BufRead, BufReader, Read};

    use super::*;

    /// A supervisor of a shell that runs `script`, its output, and its directory.
    fn supervised(script: &str) -> (Supervisor, BufReader<io::PipeReader>, tempfile::TempDir) {
        let directory = tempfile::tempdir().unwrap();
        fs::write(directory.path().join("file"), "").unwrap();
        let (output, end) = io::pipe().unwrap();
        let errors = end.try_clone().unwrap();
        let command = ["sh", "-c", script];
        let cancellation = Cancellation::default();
        let supervisor = Supervisor::new(directory.path(), command, end, errors, &cancellation);
        (supervisor.unwrap(), BufReader::new(output), directory)
    }

    #[test]
    fn the_end_of_the_program_kills_every_process_and_removes_the_directory() {
        let (supervisor, mut output, directory) = supervised("sleep 1000 & trap '' HUP INT TERM; echo up; sleep 1000");
        supervisor.start().unwrap();
        let mut said = String::new();
        output.read_line(&mut said).unwrap();
        // The kernel closes the pipe in the same way when the program ends.
        supervisor.kill();
        output.read_to_string(&mut said).unwrap();
        assert_eq!(said, "up\n");
        drop(supervisor);
        assert!(!directory.path().exists());
    }

    #[test]
    fn a_machine_that_has_ended_leaves_its_directory_until_it_was_read() {
        let (supervisor, mut output, directory) = supervised("echo out; echo error >&2; exit 3");
        supervisor.start().unwrap();
        let mut said = String::new();
        output.read_to_string(&mut said).unwrap();
        assert_eq!(said, "out\nerror\n");
        assert!(directory.path().join("file").exists());
        drop(supervisor);
        assert!(!directory.path().exists());
    }

    #[test]
    fn a_machine_that_was_cancelled_before_its_start_never_starts() {
        let (supervisor, mut output, directory) = supervised("echo started");
        supervisor.cancellation.cancel();
        supervisor.start().unwrap();
        drop(supervisor);
        let mut said = String::new();
        output.read_to_string(&mut said).unwrap();
        assert_eq!(said, "");
        assert!(!directory.path().exists());
    }
}
