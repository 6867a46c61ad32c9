//! Start-stop cycles: a cell is started on pseudo-terminals, and its processes get random signals at random moments.
//! Nothing may be left behind: no process, no terminal, no link and no file.
//!
//! `clock/start_stop_cycles.rs` makes some cycles. `cargo bench -p mrroc-tests --bench start_stop -- --cycles 10000` makes more.
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use can::clock;

/// Environment variable that marks the processes of a place. Children inherit it.
const MARK: &str = "MRROC_START_STOP";

/// Longest wait for the start or the end of a process.
const DEADLINE: Duration = Duration::from_secs(30);

/// Interval of looks.
const LOOK: Duration = Duration::from_millis(5);

/// Signals that end a process. The last one cannot be handled.
const SIGNALS: [&str; 4] = ["INT", "TERM", "HUP", "KILL"];

const KILL: usize = 3;

/// Latest moment of a signal after the start of a run, s.
const LATEST: f64 = 2.5;

/// SplitMix64: a small seeded generator with the same results on all platforms.
#[derive(Clone, Debug)]
pub struct Random(pub u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, end: usize) -> usize {
        (self.next() % end as u64) as usize
    }

    fn seconds(&mut self, most: f64) -> Duration {
        Duration::from_secs_f64(most * (self.next() >> 11) as f64 / (1_u64 << 53) as f64)
    }
}

/// What a cycle starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// A run with its drives in the same process.
    Emulated,
    /// A run on an emulator behind an slcan adapter.
    Slcan,
    /// A run on an emulator of axis controllers, with a guardian process.
    Serial,
}

/// Counts of cycles.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Cycles of each kind: emulated, slcan, serial.
    pub kinds: [u64; 3],
    /// Signals to all processes: INT, TERM, HUP, KILL.
    pub signals: [u64; 4],
    /// Runs that ended by a signal that they do not handle yet.
    pub early: u64,
    /// Links that killed emulators left, which the next emulator replaces.
    pub replaced: u64,
    /// Longest time from the end of run and emulator until no process was left.
    pub slowest: Duration,
}

impl Tally {
    pub fn add(&mut self, other: &Self) {
        self.kinds.iter_mut().zip(other.kinds).for_each(|(sum, count)| *sum += count);
        self.signals.iter_mut().zip(other.signals).for_each(|(sum, count)| *sum += count);
        self.early += other.early;
        self.replaced += other.replaced;
        self.slowest = self.slowest.max(other.slowest);
    }
}

/// A directory in which cycles run one after another.
pub struct Place {
    program: PathBuf,
    cells: PathBuf,
    directory: PathBuf,
    mark: String,
    random: Random,
    pub tally: Tally,
}

/// A process whose output goes to a file.
struct Started {
    child: Child,
    output: PathBuf,
}

impl Place {
    /// `program` is `mrroc`, and `directory` an existing empty directory.
    pub fn new(program: &Path, cells: &Path, directory: &Path, seed: u64) -> Self {
        Self {
            program: program.to_owned(),
            cells: cells.to_owned(),
            directory: directory.to_owned(),
            mark: format!("{}-{seed}", std::process::id()),
            random: Random(seed),
            tally: Tally::default(),
        }
    }

    /// One cycle. An error says what was left behind.
    pub fn cycle(&mut self) -> Result<(), String> {
        let kind = [Kind::Emulated, Kind::Slcan, Kind::Serial][self.random.below(3)];
        self.tally.kinds[kind as usize] += 1;
        let cell = self.cells.join(if kind == Kind::Serial { "irb6-serial.toml" } else { "irb6.toml" });
        let cell = cell.to_string_lossy().into_owned();
        let links = self.directory.join(if kind == Kind::Serial { "ttys" } else { "adapters" });
        let at = links.join("can0").to_string_lossy().into_owned();
        let ttys = links.to_string_lossy().into_owned();
        fs::create_dir_all(&links).map_err(|error| error.to_string())?;
        let emulator = match kind {
            Kind::Emulated => None,
            Kind::Slcan => Some(self.start("emulate", &["emulate", &cell, "--slcan", &at])?),
            Kind::Serial => Some(self.start("emulate", &["emulate", &cell, "--serial", &ttys])?),
        };
        let mut emulator = match emulator {
            Some(mut emulator) => {
                emulator.wait_for("Ctrl-C ends it")?;
                Some(emulator)
            }
            None => None,
        };
        let on = format!("slcan:{at}");
        let mut run = match kind {
            Kind::Emulated => self.start("run", &["run", &cell, "--json"])?,
            Kind::Slcan => self.start("run", &["run", &cell, "--bench=card", "--can", &on, "--json"])?,
            Kind::Serial => self.start("run", &["run", &cell, "--bench=card", "--serial", &ttys, "--json"])?,
        };
        wait(self.random.seconds(LATEST));
        let first = self.random.below(4) == 0;
        let mut killed = false;
        if let Some(emulator) = emulator.as_mut().filter(|_| first) {
            killed = self.end(emulator)?;
        }
        self.end(&mut run)?;
        if let Some(emulator) = emulator.as_mut().filter(|_| !first) {
            killed = self.end(emulator)?;
        }
        self.nothing_runs()?;
        // A run with its drives in the same process has no links, and does not replace any.
        let found = if kind == Kind::Emulated { Vec::new() } else { names(&links)? };
        if !found.is_empty() && !killed {
            return Err(format!("{kind:?}: links are left: {found:?}"));
        }
        self.tally.replaced += found.len() as u64;
        let expected = ["adapters", "ttys", "emulate.out", "run.out"];
        for name in names(&self.directory)? {
            // Runs on a card keep the last seconds before a fault.
            let flight = name.ends_with(".mcap") || name.ends_with(".log");
            if flight {
                fs::remove_file(self.directory.join(&name)).map_err(|error| error.to_string())?;
            } else if !expected.contains(&name.as_str()) {
                return Err(format!("{kind:?}: {name} is left"));
            }
        }
        Ok(())
    }

    /// Ends the cycles: a last emulator of each kind replaces what killed ones left, and is ended by SIGINT.
    pub fn finish(&mut self) -> Result<(), String> {
        for (cell, option, links) in [("irb6-serial", "--serial", "ttys"), ("irb6", "--slcan", "adapters")] {
            let links = self.directory.join(links);
            fs::create_dir_all(&links).map_err(|error| error.to_string())?;
            let at = if option == "--slcan" { links.join("can0") } else { links.clone() };
            let cell = self.cells.join(cell).with_extension("toml").to_string_lossy().into_owned();
            let mut emulator = self.start("emulate", &["emulate", &cell, option, &at.to_string_lossy()])?;
            emulator.wait_for("Ctrl-C ends it")?;
            emulator.signal("INT")?;
            let status = emulator.ended()?;
            let found = names(&links)?;
            if !status.success() || !found.is_empty() {
                return Err(format!("the last emulator ended with {status} and left {found:?}: {}", emulator.said()));
            }
        }
        self.nothing_runs()
    }

    fn start(&self, name: &str, arguments: &[&str]) -> Result<Started, String> {
        let output = self.directory.join(format!("{name}.out"));
        let file = File::create(&output).map_err(|error| format!("{}: {error}", output.display()))?;
        let errors = file.try_clone().map_err(|error| error.to_string())?;
        let mut command = Command::new(&self.program);
        command.args(arguments).current_dir(&self.directory).env(MARK, &self.mark);
        command.stdin(Stdio::null()).stdout(file).stderr(errors);
        let child = command.spawn().map_err(|error| format!("{}: {error}", self.program.display()))?;
        Ok(Started { child, output })
    }

    /// Sends a random signal and waits for the end. Returns whether the process was killed.
    fn end(&mut self, started: &mut Started) -> Result<bool, String> {
        let number = self.random.below(SIGNALS.len());
        self.tally.signals[number] += 1;
        // The process may have ended by itself, for example because its emulator has.
        if started.child.try_wait().map_err(|error| error.to_string())?.is_none() {
            started.signal(SIGNALS[number])?;
        }
        let status = started.ended()?;
        if status.code().is_none() && number != KILL {
            self.tally.early += 1;
        }
        Ok(number == KILL)
    }

    /// Waits until no process of this place is left.
    fn nothing_runs(&mut self) -> Result<(), String> {
        let began = clock::now();
        loop {
            let left = marked(&self.mark);
            if left.is_empty() {
                self.tally.slowest = self.tally.slowest.max(clock::now().since(began));
                return Ok(());
            }
            if clock::now().since(began) > DEADLINE {
                return Err(format!("processes are left: {left:?}"));
            }
            wait(LOOK);
        }
    }
}

impl Started {
    fn signal(&self, name: &str) -> Result<(), String> {
        let kill = format!("kill -{name} {}", self.child.id());
        // A process that has ended is not yet waited for and takes the signal.
        let sent = Command::new("sh").args(["-c", &kill]).status().map_err(|error| error.to_string())?;
        if sent.success() { Ok(()) } else { Err(format!("{kill} fails")) }
    }

    fn ended(&mut self) -> Result<ExitStatus, String> {
        let end = clock::now() + DEADLINE;
        loop {
            match self.child.try_wait() {
                Ok(Some(status)) => return Ok(status),
                Ok(None) if clock::now() < end => wait(LOOK),
                Ok(None) => return Err(format!("a process does not end: {}", self.said())),
                Err(error) => return Err(error.to_string()),
            }
        }
    }

    fn wait_for(&mut self, word: &str) -> Result<(), String> {
        let end = clock::now() + DEADLINE;
        while !self.said().contains(word) {
            let ended = self.child.try_wait().map_err(|error| error.to_string())?;
            if ended.is_some() || clock::now() >= end {
                return Err(format!("a process does not start: {ended:?} {}", self.said()));
            }
            wait(LOOK);
        }
        Ok(())
    }

    fn said(&self) -> String {
        fs::read_to_string(&self.output).unwrap_or_default()
    }
}

impl Drop for Started {
    fn drop(&mut self) {
        // Both calls fail if the process has ended, which does no harm.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn wait(duration: Duration) {
    clock::sleep_until(clock::now() + duration);
}

/// Names of the entries of a directory.
fn names(directory: &Path) -> Result<Vec<String>, String> {
    let entries = fs::read_dir(directory).map_err(|error| format!("{}: {error}", directory.display()))?;
    Ok(entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect())
}

/// Processes that inherited a mark, with their names. A process that has ended and is not waited for has no environment.
fn marked(mark: &str) -> Vec<String> {
    let mark = format!("{MARK}={mark}").into_bytes();
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    let is_marked = |path: &PathBuf| {
        let variables = fs::read(path.join("environ")).unwrap_or_default();
        variables.split(|byte| *byte == 0).any(|variable| variable == mark)
    };
    let name = |path: PathBuf| {
        let name = fs::read_to_string(path.join("comm")).unwrap_or_default();
        format!("{} {}", path.display(), name.trim())
    };
    processes.map(|entry| entry.path()).filter(is_marked).map(name).collect()
}

/// Abstract sockets and files of shared memory of the whole host that have the name of this program.
pub fn resources() -> Vec<String> {
    let sockets = fs::read_to_string("/proc/net/unix").unwrap_or_default();
    let sockets = sockets.lines().filter_map(|line| line.split(' ').next_back());
    let sockets = sockets.filter(|name| name.starts_with('@') && name.contains("mrroc")).map(str::to_owned);
    let shared = names(Path::new("/dev/shm")).unwrap_or_default();
    let mut found: Vec<_> = sockets.chain(shared.into_iter().filter(|name| name.contains("mrroc"))).collect();
    found.sort();
    found
}
