//! Start-stop cycles with random signals: `cargo bench -p mrroc-tests --bench start_stop -- --cycles 10000`.
//!
//! Places work at the same time, 4 unless `--places` says otherwise. Each has a directory of its own. `--seed` is the seed
//! of the first place. `--program` is `mrroc`; without it, the command of this profile, which must have been built.
//! Exit status 1 if anything was left behind.

#![allow(clippy::disallowed_methods, reason = "the program measures its duration")]

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use kit::start_stop::{Place, Tally, resources};

/// Arguments of the program.
struct Arguments {
    cycles: u64,
    seed: u64,
    places: u64,
    program: PathBuf,
}

fn arguments() -> Result<Arguments, String> {
    let bench = std::env::current_exe().map_err(|error| error.to_string())?;
    let profile = bench.ancestors().nth(2).ok_or("cargo puts benches into target/PROFILE/deps")?;
    let mut given = Arguments { cycles: 100, seed: 1, places: 4, program: profile.join("mrroc") };
    let mut words = std::env::args().skip(1).filter(|word| word != "--bench");
    while let Some(word) = words.next() {
        let value = words.next().ok_or_else(|| format!("{word} needs a value"))?;
        let number = || value.parse().map_err(|why| format!("{word}: {why}"));
        match word.as_str() {
            "--cycles" => given.cycles = number()?,
            "--seed" => given.seed = number()?,
            "--places" => given.places = number()?.clamp(1, 64),
            "--program" => given.program = PathBuf::from(value),
            _ => return Err(format!("{word} is not known; there are --cycles, --seed, --places and --program")),
        }
    }
    if given.program.is_file() { Ok(given) } else { Err(format!("{}: no such program", given.program.display())) }
}

fn main() -> ExitCode {
    let given = match arguments() {
        Ok(given) => given,
        Err(problem) => {
            eprintln!("start_stop: {problem}");
            return ExitCode::from(2);
        }
    };
    let cells = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells");
    let base = std::env::temp_dir().join(format!("mrroc-start-stop-{}", std::process::id()));
    let before = resources();
    let began = Instant::now();
    let done = AtomicU64::new(0);
    let work = |number: u64| -> Result<Tally, String> {
        let directory = base.join(number.to_string());
        std::fs::create_dir_all(&directory).map_err(|error| error.to_string())?;
        let mut place = Place::new(&given.program, &cells, &directory, given.seed + number);
        while done.fetch_add(1, Ordering::Relaxed) < given.cycles {
            place.cycle().map_err(|left| format!("seed {}: {left}", given.seed + number))?;
        }
        place.finish().map_err(|left| format!("seed {}: {left}", given.seed + number))?;
        Ok(place.tally)
    };
    let results: Vec<_> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..given.places).map(|number| scope.spawn(move || work(number))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap_or_else(|_| Err("a place panicked".to_owned()))).collect()
    });
    let mut tally = Tally::default();
    let mut failures = Vec::new();
    for result in results {
        match result {
            Ok(of_place) => tally.add(&of_place),
            Err(failure) => failures.push(failure),
        }
    }
    let after = resources();
    if after != before {
        failures.push(format!("on the host were {before:?}, and are {after:?}"));
    }
    // After a failure the files stay for examination.
    if failures.is_empty()
        && let Err(error) = std::fs::remove_dir_all(&base)
    {
        failures.push(format!("{}: {error}", base.display()));
    }
    let [emulated, slcan, serial] = tally.kinds;
    let [int, term, hup, kill] = tally.signals;
    println!(
        "| cycles | one process | slcan | ttys | INT | TERM | HUP | KILL | links replaced | slowest end | duration |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    println!(
        "| {} | {emulated} | {slcan} | {serial} | {int} | {term} | {hup} | {kill} | {} | {:.0} ms | {:.0} s |",
        emulated + slcan + serial,
        tally.replaced,
        1e3 * tally.slowest.as_secs_f64(),
        began.elapsed().as_secs_f64(),
    );
    failures.iter().for_each(|failure| println!("\nleft behind: {failure}"));
    ExitCode::from(u8::from(!failures.is_empty()))
}
