//! Checks of a cell file beyond its structure.

mod assembly;
mod axis;
mod buses;
mod camera;
mod can_force_sensor;
mod conveyor;
mod device;
mod force;
mod force_law;
mod homing;
mod io;
mod meetings;
mod position_loop;
mod program;
mod robots;
mod scene;
mod touch;
mod ultrasonic;
mod weight;
mod workpiece;

use servo::KeyError;

use super::error::{Path, Step};
use super::{Cell, Range, out_of_range, text};
use crate::guardian::LONGEST_SILENCE_MS;
use can::counted;

/// Greatest number of robots of a cell, and of buses and bundles together.
const MOST: usize = 32;

/// Greatest numbers of robots, buses, ultrasonic matrices, force sensors, cameras, conveyors and devices of other crates.
#[cfg(test)]
pub(crate) const fn most_devices() -> [usize; 7] {
    [MOST, MOST, ultrasonic::MOST, force::MOST, camera::MOST, conveyor::MOST, device::MOST]
}

/// The first value that is refused, and why.
type Checked = Result<(), (Path, String)>;

pub(super) fn check(cell: &Cell) -> Checked {
    let top = &Path::default();
    name(top, "name", &cell.name)?;
    // The range of object 0x60C2 of an EPOS4 in its usual unit.
    within(top, "period_us", cell.period_us, Range::new(1_000.0, 100_000.0, "µs"))?;
    if !cell.period_us.is_multiple_of(1000) {
        let period = cell.period_us;
        let why = format!("is {period}, must be a multiple of 1000 (µs), the drives' unit of the interpolation period");
        return refused(top, "period_us", why);
    }
    within(top, "macrostep", cell.macrostep, Range::new(1.0, 1000.0, "periods"))?;
    within(top, "max_missed_in_row", cell.max_missed_in_row, Range::new(1.0, 1e6, "periods"))?;
    if let Some(silence) = cell.guardian_ms {
        let guards = !cell.serial.is_empty() || cell.bus.iter().any(|bus| bus.guarded) || cell.watchdog.is_some();
        let because = "without axis controllers on serial lines, a guarded bus or a watchdog";
        no_effect(top, "guardian_ms", !guards, because)?;
        within(top, "guardian_ms", silence, Range::new(2e-3 * f64::from(cell.period_us), LONGEST_SILENCE_MS, "ms"))?;
    }
    if let Some(watchdog) = &cell.watchdog {
        buses::text(top, "watchdog", watchdog)?;
    }
    cell.realtime.check(cell.period()).map_err(|refusal| by_servo(&top.then("realtime"), refusal))?;
    buses::check(cell)?;
    within(top, "flight_recorder_s", cell.flight_recorder_s, Range::new(0.0, 600.0, "s"))?;
    within(top, "meeting_timeout_s", cell.meeting_timeout_s, Range::new(1.0, 86_400.0, "s"))?;
    robots::check(cell)?;
    buses::check_used(cell)?;
    io::check(cell)?;
    force::check(cell)?;
    force_law::check(cell)?;
    ultrasonic::check(cell)?;
    camera::check(cell)?;
    device::check(cell)?;
    scene::check(cell)?;
    meetings::check(cell)?;
    assembly::check(cell)?;
    buses::check_interfaces(cell)
}

/// What the servo refuses of a table at `path`.
fn by_servo(path: &Path, refusal: KeyError) -> (Path, String) {
    let path = refusal.key.split('.').fold(path.clone(), |path, key| path.then(key));
    (path, refusal.reason.to_string())
}

/// Refuses the value of `key` in the table or list at `path`.
fn refused(path: &Path, key: impl Into<Step>, why: impl Into<String>) -> Checked {
    Err((path.then(key), why.into()))
}

/// Checks that the value of `key` is in `range`.
fn within(path: &Path, key: impl Into<Step>, value: impl Into<f64>, range: Range) -> Checked {
    let value = value.into();
    if range.has(value) { Ok(()) } else { refused(path, key, out_of_range(value, range)) }
}

/// Checks that a text is a name: without characters that are special in a path, a table, a line of CSV or an option.
fn name(path: &Path, key: &'static str, name: &str) -> Checked {
    let first = |c: char| c.is_ascii_alphanumeric();
    let other = |c: char| first(c) || matches!(c, '-' | '_');
    if name.starts_with(first) && name.chars().all(other) && name.len() <= 64 {
        return Ok(());
    }
    let why = format!(
        "is {}, must be a name: 1 to 64 letters of A to Z, digits, - and _, of which the first is a letter or a digit",
        text::quoted(name)
    );
    refused(path, key, why)
}

/// Refuses a key that has no effect at its place.
fn no_effect(path: &Path, key: &'static str, given: bool, because: &str) -> Checked {
    if given { refused(path, key, format!("has no effect {because}: leave it out")) } else { Ok(()) }
}

/// Refuses an empty list, and a list of more than `most` elements.
fn some(path: &Path, key: &'static str, found: usize, most: usize, what: &str) -> Checked {
    match found {
        0 => refused(path, key, format!("has no {what}, must have at least one")),
        _ if found > most => refused(path, key, format!("has {found} {what}, may have {most}")),
        _ => Ok(()),
    }
}

/// Refuses a list of another length than `expected`. `what` is the noun of one element.
fn count(path: Path, found: usize, expected: usize, what: &str) -> Checked {
    if found == expected { Ok(()) } else { Err((path, format!("has {}, must have {expected}", counted(found, what)))) }
}

/// Refuses a `what` for the value of `key` in element `index` of the list at `list`, if an earlier element has the same.
fn unique<T: PartialEq>(
    list: &Path,
    key: &'static str,
    index: usize,
    values: impl IntoIterator<Item = T>,
    what: impl FnOnce(&T) -> String,
) -> Checked {
    let values: Vec<_> = values.into_iter().take(index + 1).collect();
    match values.iter().position(|value| *value == values[index]) {
        Some(first) if first < index => {
            refused(&list.then(index), key, twice(&what(&values[index]), &list.then(first)))
        }
        _ => Ok(()),
    }
}

fn twice(what: &str, first: &impl std::fmt::Display) -> String {
    format!("{what} is used twice, first by {first}")
}
