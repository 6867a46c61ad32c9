//! A long recording of a cell in lockstep, and its replay: `cargo bench -p mrroc-tests --bench recording -- irb6 --hours 8`.
//!
//! The robots repeat the programs of the cell until the virtual time has passed. Another process replays the recording,
//! files that are mostly holes, and chunks that decompress to gigabytes. The program prints a table of the peak memory
//! and the speed of each replay, and removes its files. The first argument is the name of an example cell, or the path
//! of a cell file. `--directory DIR` has room for the recording: 1.1 GB per hour of `irb6`, and 6 GB per hour of `lab`.
//! The exit status is 1 if a replay needs more than 200 MB, if the recording does not replay as equal, if a damaged file
//! does, or if the replay is slower than the recording.

#![allow(clippy::disallowed_methods, reason = "the program measures durations")]

use std::fs::{self, File};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::CellFile;
use ::mrroc::recording::{ReplayOptions, replay};
use ::mrroc::report::RunOutcome;
use ::mrroc::run::{Requests, RunOptions};
use ::mrroc::tasks::CarriedTask;
use anyhow::{Context, bail};
use kit::recordings::bomb;

/// Greatest memory of a replay, KiB.
const MOST_KIB: u64 = 200_000_000 / 1024;

/// Bytes of the holes and of the decompressed chunks.
const LARGE: u64 = 4 << 30;

/// Arguments of the program.
struct Arguments {
    cell: PathBuf,
    hours: f64,
    directory: PathBuf,
    /// A file that this process replays.
    replay: Option<PathBuf>,
}

fn arguments() -> anyhow::Result<Arguments> {
    let directory = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let mut given = Arguments { cell: PathBuf::from("irb6"), hours: 0.1, directory, replay: None };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().with_context(|| format!("{word} needs a value"));
        match word.as_str() {
            "--hours" => given.hours = value()?.parse().context("--hours")?,
            "--directory" => given.directory = value()?.into(),
            "--replay" => given.replay = Some(value()?.into()),
            // cargo bench gives this one.
            "--bench" => {}
            name if !name.starts_with('-') => given.cell = PathBuf::from(name),
            other => bail!("{other} is not known; there are CELL, --hours and --directory"),
        }
    }
    if !(given.hours > 0.0 && given.hours <= 100.0) {
        bail!("--hours is above 0 and at most 100");
    }
    if given.cell.extension().is_none() {
        let cells = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells");
        given.cell = cells.join(given.cell).with_extension("toml");
    }
    Ok(given)
}

/// Peak of the resident memory of this process, KiB.
fn peak() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?.split_whitespace().next()?.parse().ok()
}

/// What a process says of its replay of a file.
struct Replayed {
    peak_kib: u64,
    cycles: u64,
    is_good: bool,
    wall: Duration,
}

/// Replays `path` in another process of this program.
fn replayed(path: &Path) -> anyhow::Result<Replayed> {
    let began = Instant::now();
    let said = Command::new(std::env::current_exe()?).arg("--replay").arg(path).output()?;
    let wall = began.elapsed();
    let text = String::from_utf8_lossy(&said.stdout).into_owned();
    let words: Vec<&str> = text.split_whitespace().collect();
    let [peak, cycles, is_good] = words[..] else {
        bail!("{}: the replay ended without its figures: {}", path.display(), String::from_utf8_lossy(&said.stderr))
    };
    Ok(Replayed { peak_kib: peak.parse()?, cycles: cycles.parse()?, is_good: is_good == "true", wall })
}

/// Replays `path`, and says the peak of the memory, the number of cycles, and whether the recording is whole and equal.
fn replay_here(path: &Path) -> anyhow::Result<()> {
    let (cycles, is_good) = match replay(path, &ReplayOptions::default()) {
        Ok(replay) => (replay.cycles, replay.is_equal() && replay.is_whole()),
        Err(_) => (0, false),
    };
    println!("{} {cycles} {is_good}", peak().context("/proc/self/status has no VmHWM")?);
    Ok(())
}

/// Runs the programs of a cell in lockstep. Returns the number of its cycles, and their virtual time.
fn run(file: &CellFile, record: Option<&Path>) -> anyhow::Result<(u64, Duration)> {
    let options = RunOptions { record: record.map(Path::to_owned), ..RunOptions::on(BenchKind::Lockstep) };
    let program = CarriedTask::Programs.program();
    let report = ::mrroc::run::run(file, &options, &Requests::default(), &program, &mut |_| {})?;
    if report.outcome != RunOutcome::Completed {
        bail!("the run did not end: {report}");
    }
    let cycles = report.cycle.cycles;
    Ok((cycles, Duration::from_micros(cycles * u64::from(file.cell.period_us))))
}

/// The cell `path` with its programs repeated in memory, so that they take `time`. A replay does not read programs.
fn repeated(path: &Path, time: Duration) -> anyhow::Result<CellFile> {
    let mut file = CellFile::read(path)?;
    let programs: Vec<_> = file.cell.robot.iter().map(|robot| robot.program.clone()).collect();
    let repeat = |file: &mut CellFile, times: usize| {
        for (robot, program) in file.cell.robot.iter_mut().zip(&programs) {
            robot.program = std::iter::repeat_n(program, times).flatten().cloned().collect();
        }
    };
    // Once and twice the programs give the time of one repetition.
    let (_, once) = run(&file, None)?;
    repeat(&mut file, 2);
    let each = run(&file, None)?.1.saturating_sub(once).max(Duration::from_millis(1));
    let times = time.saturating_sub(once).div_duration_f64(each).ceil() as usize + 1;
    repeat(&mut file, times);
    Ok(file)
}

/// Writes `start` and then a hole.
fn with_hole(path: &Path, start: &[u8]) -> anyhow::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(start)?;
    file.set_len(start.len() as u64 + LARGE)?;
    // The last byte is not zero, so that the hole is no cut.
    file.seek(SeekFrom::End(-1))?;
    Ok(file.write_all(&[1])?)
}

fn measure(given: &Arguments) -> anyhow::Result<bool> {
    let time = Duration::from_secs_f64(3600.0 * given.hours);
    let file = repeated(&given.cell, time)?;
    let recording = given.directory.join("long.mcap");
    let log = recording.with_extension("log");
    let remove = |path: &Path| {
        let _ = fs::remove_file(path);
    };
    [&recording, &log].into_iter().for_each(|path| remove(path));
    let began = Instant::now();
    let (cycles, virtual_time) = run(&file, Some(&recording))?;
    let recorded = began.elapsed();
    remove(&log);
    let length = fs::metadata(&recording)?.len();
    let speed = |wall: Duration| virtual_time.div_duration_f64(wall);
    println!(
        "{}: {:.2} h, {} cycles, {:.1} MB, recorded at {:.1} times real time",
        given.cell.display(),
        virtual_time.as_secs_f64() / 3600.0,
        cycles,
        length as f64 / 1e6,
        speed(recorded),
    );
    println!("| file | replayed cycles | duration | times real time | peak memory |\n|---|---|---|---|---|");
    let row = |name: &str, it: &Replayed| {
        let (wall, peak) = (it.wall.as_secs_f64(), it.peak_kib as f64 * 1024.0 / 1e6);
        let speed = if it.cycles > 1 { format!("{:.1}", speed(it.wall)) } else { "-".to_owned() };
        println!("| {name} | {} | {wall:.1} s | {speed} | {peak:.1} MB |", it.cycles);
        it.peak_kib <= MOST_KIB
    };
    let whole = replayed(&recording)?;
    let mut is_good = row("the recording", &whole);
    is_good &= whole.is_good && whole.cycles == cycles && whole.wall <= recorded;

    // A short recording in front of what takes memory.
    remove(&recording);
    run(&CellFile::read(&given.cell)?, Some(&recording))?;
    let bytes = fs::read(&recording)?;
    let path = given.directory.join("large.mcap");
    let mut other = |name: &str, written: anyhow::Result<()>| -> anyhow::Result<()> {
        written?;
        let replayed = replayed(&path)?;
        is_good &= row(name, &replayed) && !replayed.is_good;
        Ok(())
    };
    other("4 GB of holes behind the first bytes", with_hole(&path, &bytes[..8]))?;
    other("4 GB of holes behind a recording", with_hole(&path, &bytes))?;
    other("4 GB of holes within a recording", with_hole(&path, &bytes[..bytes.len() / 2]))?;
    for (name, declared) in [("a chunk of 4 GB", LARGE), ("a chunk of 4 GB that says 1 MB", 1 << 20)] {
        other(name, fs::write(&path, bomb(&bytes, LARGE, declared)).map_err(Into::into))?;
    }
    [&path, &recording, &log].into_iter().for_each(|path| remove(path));
    Ok(is_good)
}

fn main() -> ExitCode {
    let done = arguments().and_then(|given| match &given.replay {
        Some(path) => replay_here(path).map(|()| true),
        None => measure(&given),
    });
    match done {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("recording: {error:#}");
            ExitCode::from(2)
        }
    }
}
