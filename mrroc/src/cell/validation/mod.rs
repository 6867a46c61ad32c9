//! Checks of a cell file beyond its structure.

mod assembly;
mod axis;
mod buses;
mod homing;
mod meetings;
mod position_loop;
mod program;
mod robots;
mod weight;

use servo::{KeyError, KeyProblem};

use super::error::Problem;
use super::locate::Path;
use super::{Cell, Range};

/// Greatest number of robots of a cell, and of buses and bundles together.
const MOST: usize = 32;

type Checked = Result<(), (Path, Problem)>;

pub(super) fn check(cell: &Cell) -> Checked {
    let top = Path::default();
    name(&top.then("name"), &cell.name)?;
    // The range of object 0x60C2 of an EPOS4 in its usual unit.
    let period = Range::new(1_000.0, 100_000.0, "µs");
    within(&top.then("period_us"), f64::from(cell.period_us), period)?;
    if !cell.period_us.is_multiple_of(1000) {
        let expected = "a multiple of 1000 (µs), the drives' unit of the interpolation period";
        let value = f64::from(cell.period_us);
        return Err((top.then("period_us"), Problem::NoneOf { value, expected }));
    }
    let macrostep = Range::new(1.0, 1000.0, "periods");
    within(&top.then("macrostep"), f64::from(cell.macrostep), macrostep)?;
    let missed = f64::from(cell.max_missed_in_row);
    let range = Range::new(1.0, 1e6, "periods");
    within(&top.then("max_missed_in_row"), missed, range)?;
    let realtime = cell.realtime.check(cell.period());
    realtime.map_err(|refusal| by_servo(&top.then("realtime"), refusal))?;
    buses::check(cell)?;
    let timeout = f64::from(cell.meeting_timeout_s);
    let range = Range::new(1.0, 86_400.0, "s");
    within(&top.then("meeting_timeout_s"), timeout, range)?;
    robots::check(cell)?;
    buses::check_used(cell)?;
    meetings::check(cell)?;
    assembly::check(cell)
}

/// What the servo refuses of a table at `path`.
fn by_servo(path: &Path, refusal: KeyError) -> (Path, Problem) {
    let path = refusal
        .key
        .split('.')
        .fold(path.clone(), |path, key| path.then(key));
    let problem = match refusal.reason {
        KeyProblem::OutOfRange { value, range } => Problem::OutOfRange { value, range },
        KeyProblem::NoEffect { because } => Problem::NoEffect { because },
        KeyProblem::Conflict(why) => Problem::Refused(why.into()),
    };
    (path, problem)
}

/// Checks that `value` is in `range`.
fn within(path: &Path, value: f64, range: Range) -> Checked {
    if range.has(value) {
        Ok(())
    } else {
        Err((path.clone(), Problem::OutOfRange { value, range }))
    }
}

/// Checks that a text is a name: without characters that are special in a path, a table, a line of CSV or an option.
fn name(path: &Path, text: &str) -> Checked {
    let first = |c: char| c.is_ascii_alphanumeric();
    let other = |c: char| first(c) || matches!(c, '-' | '_');
    if text.starts_with(first) && text.chars().all(other) && text.len() <= 64 {
        Ok(())
    } else {
        Err((path.clone(), Problem::NotName(text.to_owned())))
    }
}

/// Refuses a key that has no effect at its place.
fn no_effect(path: &Path, given: bool, because: &'static str) -> Checked {
    if given {
        Err((path.clone(), Problem::NoEffect { because }))
    } else {
        Ok(())
    }
}

/// Refuses an empty list, and a list of more than `most` elements.
fn some(path: &Path, found: usize, most: usize, what: &'static str) -> Checked {
    match found {
        0 => Err((path.clone(), Problem::None { what })),
        _ if found > most => Err((path.clone(), Problem::TooMany { found, most, what })),
        _ => Ok(()),
    }
}

/// The index of the first element of `before` that equals `this`.
fn first_same<T: PartialEq>(before: impl IntoIterator<Item = T>, this: &T) -> Option<usize> {
    before.into_iter().position(|other| other == *this)
}

fn twice(what: String, first: &Path) -> Problem {
    Problem::Twice {
        what,
        first: first.to_string(),
    }
}

fn refused(path: Path, why: impl Into<String>) -> Checked {
    Err((path, Problem::Refused(why.into())))
}
