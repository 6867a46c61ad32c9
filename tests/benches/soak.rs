//! Soak of a cell in lockstep: `cargo bench -p mrroc-tests --bench soak -- irb6 --hours 24 --seed 1`.
//!
//! The first argument is the name of an example cell, or the path of a cell file. The program prints one table, or a
//! JSON object with `--json`. The exit status is 1 if an entry was lost, a reference changed, a failure occurred, the
//! memory grew beyond its bound, or the positions of a robot were compared less than twice.

#![allow(clippy::disallowed_methods, reason = "the program measures its duration")]

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use ::mrroc::cell::CellFile;
use faults::soak::{SoakOptions, soak};

/// Arguments of the program.
struct Arguments {
    cell: PathBuf,
    hours: f64,
    seed: u64,
    json: bool,
}

fn arguments() -> Result<Arguments, String> {
    let mut given = Arguments { cell: PathBuf::from("irb6"), hours: 0.1, seed: 1, json: false };
    let mut words = std::env::args().skip(1);
    let value = |name: &str, word: Option<String>| word.ok_or_else(|| format!("{name} needs a value"));
    while let Some(word) = words.next() {
        match word.as_str() {
            "--hours" => given.hours = value(&word, words.next())?.parse().map_err(|why| format!("--hours: {why}"))?,
            "--seed" => given.seed = value(&word, words.next())?.parse().map_err(|why| format!("--seed: {why}"))?,
            "--json" => given.json = true,
            // cargo bench gives this one.
            "--bench" => {}
            name if !name.starts_with('-') => given.cell = PathBuf::from(name),
            other => return Err(format!("{other} is not known; there are CELL, --hours, --seed and --json")),
        }
    }
    if !(given.hours > 0.0 && given.hours <= 1000.0) {
        return Err("--hours is above 0 and at most 1000".to_owned());
    }
    if given.cell.extension().is_none() {
        let cells = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells");
        given.cell = cells.join(given.cell).with_extension("toml");
    }
    Ok(given)
}

/// Memory of this process that no file backs, KiB: resident or swapped out. A busy host takes resident pages away.
fn memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let kib = |key: &str| {
        let value = status.lines().find_map(|line| line.strip_prefix(key))?;
        value.split_whitespace().next()?.parse::<u64>().ok()
    };
    Some(kib("RssAnon:")? + kib("VmSwap:")?)
}

fn main() -> ExitCode {
    let given = match arguments() {
        Ok(given) => given,
        Err(problem) => {
            eprintln!("soak: {problem}");
            return ExitCode::from(2);
        }
    };
    let file = match CellFile::read(&given.cell) {
        Ok(file) => file,
        Err(error) => {
            eprintln!("soak: {error}");
            return ExitCode::from(2);
        }
    };
    let options = SoakOptions { duration: Duration::from_secs_f64(3600.0 * given.hours), seed: given.seed };
    let mut hours = 0;
    let began = Instant::now();
    let mut progress = |at: Duration| {
        let memory = memory();
        if at.as_secs() / 3600 > hours {
            hours = at.as_secs() / 3600;
            let wall = began.elapsed().as_secs_f64();
            eprintln!("{hours} h, {:.0} times real time, {} KiB", at.as_secs_f64() / wall, memory.unwrap_or(0));
        }
        memory
    };
    match soak(&file, &options, &mut progress) {
        Ok(mut report) => {
            report.wall_s = Some(began.elapsed().as_secs_f64());
            match serde_json::to_string_pretty(&report) {
                Ok(json) if given.json => println!("{json}"),
                _ => print!("{report}"),
            }
            // A host without these figures has not shown that the memory is bounded.
            ExitCode::from(u8::from(!report.is_good() || report.memory_kib.is_none()))
        }
        Err(error) => {
            eprintln!("soak: seed {}: {error:#}", given.seed);
            ExitCode::FAILURE
        }
    }
}
