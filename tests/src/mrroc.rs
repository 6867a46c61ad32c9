//! The `mrroc` command as a child process: built once, run with a deadline, its output captured.

use std::cell::Cell as Shared;
use std::ffi::OsStr;
use std::fs::{self, Permissions};
use std::io::{Read, Write};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::Duration;

use ::mrroc::cell::{Cell, Wait};
use can::{candump, clock};

use crate::disturbance;

/// Upper bound for the duration of a command.
const DEADLINE: Duration = Duration::from_secs(300);

/// The example cells by name.
pub const CELLS: [&str; 2] = ["irb6", "irp6"];

/// The example cells whose drives are axis controllers on serial lines.
pub const SERIAL_CELLS: [&str; 2] = ["irb6-serial", "irb6-hi-moxa"];

/// The robots known by name.
pub const ROBOTS: [&str; 5] = ["irb6", "irp6", "irp6-track", "rnt", "polycrank"];

/// The root of the workspace.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the tests' room is inside the workspace")
}

/// The file of an example cell.
pub fn example(name: &str) -> PathBuf {
    root().join(format!("cells/{name}.toml"))
}

/// Path of the command, built in the profile and the target directory of this test. In the test machine, where nothing
/// can be built, it is the command that the host built before.
pub fn binary() -> &'static Path {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    BINARY.get_or_init(|| built("mrroc"))
}

/// The example `planted` of this package, which only the host runs.
pub fn planted() -> PathBuf {
    built("examples/planted")
}

/// An example program of the library.
pub fn example_program(name: &str) -> PathBuf {
    built(&format!("examples/{name}"))
}

/// Directory for files of tests in the target directory.
fn temporary() -> PathBuf {
    let test = std::env::current_exe().expect("a test binary knows its own path");
    let target = test.ancestors().nth(3).expect("cargo puts tests into target/<profile>/deps");
    let directory = target.join("tmp");
    // In a test machine, where nothing can be made, the directory is there.
    let _ = fs::create_dir_all(&directory);
    directory
}

/// A program of the workspace. `place` is its path in the directory of the profile. The first call builds all programs,
/// from the same libraries as the tests of the whole workspace. If the environment variable `MRROC_BUILT` is set, the
/// programs are built already.
fn built(place: &str) -> PathBuf {
    let test = std::env::current_exe().expect("a test binary knows its own path");
    let profile = test.ancestors().nth(2).expect("cargo puts tests into target/<profile>/deps");
    let program = profile.join(place);
    if ["MRROC_OUT", "MRROC_BUILT"].iter().any(|variable| std::env::var_os(variable).is_some()) {
        return program;
    }
    let name = match profile.file_name().and_then(OsStr::to_str) {
        None | Some("debug") => "dev",
        Some(name) => name,
    };
    let target = profile.parent().expect("a profile is in a directory");
    static BUILT: OnceLock<()> = OnceLock::new();
    BUILT.get_or_init(|| {
        let built = cargo()
            .args(["build", "--quiet", "--locked", "--profile", name])
            .args(["--workspace", "--bins", "--examples", "--target-dir"])
            .arg(target)
            .current_dir(root())
            .status();
        assert!(built.expect("cargo runs").success(), "the programs do not build");
    });
    program
}

/// Cargo with the environment of a user. A runner of tests may have set `RUSTC_BOOTSTRAP` for the test executables.
pub fn cargo() -> Command {
    let mut cargo = Command::new(env!("CARGO"));
    cargo.env_remove("RUSTC_BOOTSTRAP");
    cargo
}

/// Output and exit status of a command.
#[derive(Debug)]
pub struct Output {
    pub status: ExitStatus,
    pub stdout: String,
    pub stderr: String,
}

impl Output {
    /// The one JSON object that is all of stdout.
    pub fn json(&self) -> serde_json::Value {
        let value: serde_json::Value = serde_json::from_str(&self.stdout)
            .unwrap_or_else(|error| panic!("stdout is not one JSON value: {error}\n{self:?}"));
        assert!(value.is_object(), "{self:?}");
        value
    }
}

/// Runs `mrroc` to its end.
pub fn mrroc(arguments: impl IntoIterator<Item: AsRef<OsStr>>) -> Output {
    Running::start(arguments).output()
}

/// A running `mrroc`, killed if it is dropped before its end.
pub struct Running {
    child: Child,
    /// `None` if the output is not captured.
    stdout: Option<Receiver<String>>,
    stderr: Receiver<String>,
}

impl Running {
    pub fn start(arguments: impl IntoIterator<Item: AsRef<OsStr>>) -> Self {
        Self::program(binary(), arguments)
    }

    /// Starts another program of the workspace.
    pub fn program(program: &Path, arguments: impl IntoIterator<Item: AsRef<OsStr>>) -> Self {
        Self::of(Command::new(program).args(arguments))
    }

    /// `program` under `strace`, which writes every system call of every thread to `log`. If the host permits it,
    /// `strace` runs at real-time priority and `program` does not, because each of its calls waits for `strace`.
    pub fn under_strace(log: &Path, program: &Path, arguments: impl IntoIterator<Item: AsRef<OsStr>>) -> Self {
        let script = "chrt --reset-on-fork --fifo --pid 70 $$ 2>/dev/null; exec strace -f -qq -e signal=none -o \"$@\"";
        let mut strace = Command::new("sh");
        strace.args(["-c", script, "sh"]);
        Self::of(strace.arg(log).arg(program).args(arguments))
    }

    /// A copy of `mrroc` in `directory`, run by a user without privileges. If this test runs as root, the user is
    /// "nobody".
    pub fn unprivileged(directory: &Directory, arguments: impl IntoIterator<Item: AsRef<OsStr>>) -> Self {
        let copy = directory.path("mrroc");
        if !copy.exists() {
            // The user "nobody" may have no access to the directory of the original.
            fs::copy(binary(), &copy).expect("the directory is writable");
            let all = Permissions::from_mode(0o777);
            fs::set_permissions(&directory.0, all).expect("it is ours");
        }
        let root = fs::metadata("/proc/self").expect("Linux").uid() == 0;
        let mut command = Command::new(if root { "setpriv".as_ref() } else { &*copy });
        if root {
            command.args(["--reuid=65534", "--regid=65534", "--clear-groups"]);
            command.arg(&copy);
        }
        Self::of(command.args(arguments))
    }

    /// As [`Running::start`], with an address space of at most `memory` KiB. A larger allocation aborts the command.
    pub fn within(memory: u32, arguments: impl IntoIterator<Item: AsRef<OsStr>>) -> Self {
        let script = format!("ulimit -v {memory}; exec \"$@\"");
        let mut shell = Command::new("sh");
        shell.args(["-c", &script, "sh"]).arg(binary());
        Self::of(shell.args(arguments))
    }

    /// Starts `mrroc` with the standard output `stdout`. No output is captured.
    pub fn with_stdout(stdout: impl Into<Stdio>, arguments: impl IntoIterator<Item: AsRef<OsStr>>) -> Self {
        Self::spawn(Command::new(binary()).args(arguments).stdout(stdout))
    }

    /// Starts `mrroc` with lines on its standard input, which stays open until the command is dropped or has ended.
    pub fn with_input(lines: &[&str], arguments: impl IntoIterator<Item: AsRef<OsStr>>) -> Self {
        let mut running =
            Self::spawn_with(Command::new(binary()).args(arguments).stdout(Stdio::piped()).stdin(Stdio::piped()));
        let input = running.child.stdin.as_mut().expect("stdin is piped");
        lines.iter().for_each(|line| writeln!(input, "{line}").expect("the pipe has room"));
        running
    }

    /// Closes the standard input of [`Self::with_input`].
    pub fn close_input(&mut self) {
        self.child.stdin = None;
    }

    fn of(command: &mut Command) -> Self {
        Self::spawn(command.stdout(Stdio::piped()))
    }

    fn spawn(command: &mut Command) -> Self {
        Self::spawn_with(command.stdin(Stdio::null()))
    }

    fn spawn_with(command: &mut Command) -> Self {
        // A run on a card writes its last seconds to its working directory after a fault.
        if command.get_current_dir().is_none() {
            command.current_dir(temporary());
        }
        let mut child = command
            .stderr(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("{command:?} does not start: {error}"));
        disturbance::observe(child.id());
        let stdout = child.stdout.take().map(read);
        let stderr = read(child.stderr.take().expect("stderr is piped"));
        Self { child, stdout, stderr }
    }

    /// Process ID of the command.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal by its name, such as `INT`.
    pub fn signal(&self, name: &str) {
        let kill = format!("kill -{name} {}", self.child.id());
        let sent = Command::new("sh").args(["-c", &kill]).status();
        assert!(sent.expect("sh runs").success(), "{kill}");
    }

    /// Whether the command has a file open. `path` may be a symbolic link.
    pub fn has_open(&self, path: &Path) -> bool {
        let Ok(path) = path.canonicalize() else {
            return false;
        };
        let opened = fs::read_dir(format!("/proc/{}/fd", self.child.id()));
        let mut opened = opened.into_iter().flatten().flatten();
        opened.any(|fd| fs::read_link(fd.path()).is_ok_and(|open| open == path))
    }

    /// Waits until `file` satisfies `wanted`. Panics if the command ends before, or at the deadline.
    pub fn wait_for(&self, file: &Path, wanted: impl Fn(&str) -> bool) {
        if let Err(said) = self.ended_before(file, wanted) {
            panic!("mrroc ended early: {said}");
        }
    }

    /// Waits until `file` satisfies `wanted`. Returns the outputs of the command if it ends before. Panics at the
    /// deadline. Reading a long file takes time: the pauses limit the share of reading to a tenth.
    pub fn ended_before(&self, file: &Path, wanted: impl Fn(&str) -> bool) -> Result<(), String> {
        const PAUSE: Duration = Duration::from_millis(20);
        let end = clock::now() + DEADLINE;
        while clock::now() < end {
            let began = clock::now();
            if fs::read_to_string(file).is_ok_and(|text| wanted(&text)) {
                return Ok(());
            }
            let pause = PAUSE.max(10 * clock::now().since(began));
            // The outputs are available after the end of the command.
            let said = self.stdout.as_ref().unwrap_or(&self.stderr);
            if let Ok(said) = said.recv_timeout(pause) {
                return Err(format!("{said} {:?}", self.stderr.recv_timeout(DEADLINE)));
            }
        }
        panic!("{} never became what it should", file.display());
    }

    /// Waits until `file` satisfies `wanted` and stops growing.
    pub fn wait_until_stalled(&self, file: &Path, wanted: impl Fn(&str) -> bool) {
        let (length, looks) = (Shared::new(0), Shared::new(0));
        self.wait_for(file, |text| {
            let grown = length.replace(text.len()) < text.len();
            looks.set(if grown { 0 } else { looks.get() + 1 });
            wanted(text) && looks.get() > 20
        });
    }

    /// Waits for the end of a command whose output is not captured.
    pub fn status(mut self) -> ExitStatus {
        let closed = "mrroc closes its outputs in time";
        self.stderr.recv_timeout(DEADLINE).expect(closed);
        self.child.wait().expect("mrroc can be waited for")
    }

    /// Waits for the end.
    pub fn output(mut self) -> Output {
        let closed = "mrroc closes its outputs in time";
        let stdout = self.stdout.take().expect("stdout is captured");
        let stdout = stdout.recv_timeout(DEADLINE).expect(closed);
        let stderr = self.stderr.recv_timeout(DEADLINE).expect(closed);
        let status = self.child.wait().expect("mrroc can be waited for");
        disturbance::report(&stdout);
        Output { status, stdout, stderr }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // Both calls fail if the process has ended, which does no harm.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads `source` to its end.
fn read(source: impl Read + Send + 'static) -> Receiver<String> {
    let (tell, told) = mpsc::sync_channel(1);
    thread::spawn(move || {
        let text = std::io::read_to_string(source).expect("mrroc speaks UTF-8");
        // A failed test no longer receives the text.
        let _ = tell.send(text);
    });
    told
}

/// A directory that is deleted when the test ends.
pub struct Directory(PathBuf);

impl Directory {
    pub fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("mrroc-{}-{number}", std::process::id());
        let path = std::env::temp_dir().join(name);
        fs::create_dir(&path).expect("a directory of a new name");
        Self(path)
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// Writes a file and returns its path.
    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path(name);
        fs::write(&path, text).expect("the directory is writable");
        path
    }

    /// Writes an example cell that `change` has modified. Its servo thread does not spin, which would cost a quarter of a
    /// processor.
    pub fn cell(&self, example: &str, change: impl FnOnce(&mut Cell)) -> PathBuf {
        let mut cell = Cell::parse(&text(example)).expect("example cells are right");
        cell.realtime.wait = Wait::Plain;
        change(&mut cell);
        let text = toml::to_string(&cell).expect("a cell is TOML");
        self.write("cell.toml", &text)
    }
}

impl Default for Directory {
    fn default() -> Self {
        Self::new()
    }
}

impl Drop for Directory {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Names of the example cells, in the order of the alphabet.
pub fn examples() -> Vec<String> {
    let files = fs::read_dir(root().join("cells")).expect("the example cells are in the tree");
    let name = |file: std::io::Result<fs::DirEntry>| {
        let file = file.expect("the folder can be read").file_name().into_string().expect("names are UTF-8");
        file.strip_suffix(".toml").map(str::to_owned)
    };
    let mut names: Vec<_> = files.filter_map(name).collect();
    names.sort();
    names
}

/// The text of an example cell.
pub fn text(example_cell: &str) -> String {
    fs::read_to_string(example(example_cell)).expect("example cells are there")
}

/// Starts every axis close to its index pulse and homes all axes together. Homing then takes one second instead of ten.
pub fn shorten(cell: &mut Cell) {
    for robot in &mut cell.robot {
        let home = robot.arm().expect("a parsed cell has an arm").robot().home();
        for (number, axis) in robot.axis.iter_mut().enumerate() {
            axis.emulator.start = Some(home[number] - 2.5);
            axis.homing.order = 0;
        }
    }
}

/// Reads a trace written by `--trace`.
pub fn trace(path: &Path) -> Vec<candump::Entry> {
    let text = fs::read_to_string(path).expect("the trace is there");
    text.lines().map(|line| candump::Entry::parse(line.as_bytes()).expect("a trace is a candump log")).collect()
}

/// Number of RPDOs in a trace with a controlword that enables operation.
pub fn enables(trace: &[candump::Entry]) -> usize {
    let enables = |entry: &&candump::Entry| {
        let Some(can::Id::Standard(id)) = entry.frame.id() else {
            return false;
        };
        let rpdo = matches!(id.raw() & 0x780, 0x200 | 0x300 | 0x400 | 0x500);
        rpdo && entry.frame.data().first().is_some_and(|low| low & 0x0F == 0x0F)
    };
    trace.iter().filter(enables).count()
}
