//! Checks of buses and bundles of serial lines.

use super::{Checked, MOST, first_same, name, refused, some, twice, within};
use crate::cell::error::Problem;
use crate::cell::text::quoted;
use crate::cell::{Cell, Path, Range};

pub(super) fn check(cell: &Cell) -> Checked {
    let groups = cell.bus.len() + cell.serial.len();
    let what = "buses, and no serial lines either";
    if groups == 0 {
        return some(&Path::default().then("bus"), 0, MOST, what);
    }
    some(
        &Path::default().then("bus"),
        groups,
        MOST,
        "buses and bundles of serial lines",
    )?;
    check_buses(cell)?;
    check_serial(cell)
}

/// A drive group needs at least one axis.
pub(super) fn check_used(cell: &Cell) -> Checked {
    for (group, group_name) in cell.groups().enumerate() {
        if cell.axes_on(group).next().is_none() {
            let path = match group.checked_sub(cell.bus.len()) {
                None => Path::default().then("bus").then(group),
                Some(bundle) => Path::default().then("serial").then(bundle),
            };
            let why =
                format!("no axis has bus = {group_name:?}: leave it out, or name it in an axis");
            return refused(path, why);
        }
    }
    Ok(())
}

fn check_buses(cell: &Cell) -> Checked {
    let buses = Path::default().then("bus");
    for (index, bus) in cell.bus.iter().enumerate() {
        let path = buses.then(index);
        name(&path.then("name"), &bus.name)?;
        let before = &cell.bus[..index];
        if let Some(first) = first_same(before.iter().map(|it| &it.name), &&bus.name) {
            let problem = twice(format!("bus {:?}", bus.name), &buses.then(first));
            return Err((path.then("name"), problem));
        }
        text(&path.then("interface"), &bus.interface)?;
        if let Some(first) = first_same(before.iter().map(|it| &it.interface), &&bus.interface) {
            let what = format!("interface {}", quoted(&bus.interface));
            return Err((path.then("interface"), twice(what, &buses.then(first))));
        }
        if can::timing::Bitrate::from_kbps(bus.bitrate_kbps).is_none() {
            let expected = "10 to 1000 (kbit/s) with a bit time of whole nanoseconds";
            let value = f64::from(bus.bitrate_kbps);
            return Err((
                path.then("bitrate_kbps"),
                Problem::NoneOf { value, expected },
            ));
        }
        let ranges = [
            ("host_node", u32::from(bus.host_node), (1.0, 127.0, "")),
            (
                "heartbeat_ms",
                u32::from(bus.heartbeat_ms),
                (1.0, 10_000.0, "ms"),
            ),
            (
                "tolerated_missing",
                bus.tolerated_missing,
                (0.0, 1000.0, "cycles"),
            ),
            ("sdo_timeout_ms", bus.sdo_timeout_ms, (1.0, 60_000.0, "ms")),
            (
                "boot_timeout_ms",
                bus.boot_timeout_ms,
                (1.0, 60_000.0, "ms"),
            ),
        ];
        for (key, value, (low, high, unit)) in ranges {
            within(
                &path.then(key),
                f64::from(value),
                Range::new(low, high, unit),
            )?;
        }
    }
    Ok(())
}

fn check_serial(cell: &Cell) -> Checked {
    let bundles = Path::default().then("serial");
    for (index, bundle) in cell.serial.iter().enumerate() {
        let path = bundles.then(index);
        name(&path.then("name"), &bundle.name)?;
        if let Some(first) = first_same(cell.bus.iter().map(|it| &it.name), &&bundle.name) {
            let first = Path::default().then("bus").then(first);
            return Err((
                path.then("name"),
                twice(format!("bus {:?}", bundle.name), &first),
            ));
        }
        let before = cell.serial[..index].iter().map(|it| &it.name);
        if let Some(first) = first_same(before, &&bundle.name) {
            let problem = twice(format!("bus {:?}", bundle.name), &bundles.then(first));
            return Err((path.then("name"), problem));
        }
        let latency = bundle.emulated_latency_ms.unwrap_or(1);
        let ranges = [
            ("baud", bundle.baud, (9_600.0, 4e6, "bit/s")),
            (
                "tolerated_missing",
                bundle.tolerated_missing,
                (1.0, 10.0, "cycles"),
            ),
            (
                "answer_timeout_ms",
                bundle.answer_timeout_ms,
                (1.0, 1000.0, "ms"),
            ),
            ("emulated_latency_ms", latency, (1.0, 255.0, "ms")),
        ];
        for (key, value, (low, high, unit)) in ranges {
            within(
                &path.then(key),
                f64::from(value),
                Range::new(low, high, unit),
            )?;
        }
    }
    Ok(())
}

/// Checks that a text can be the path of a device or the name of an interface.
pub(super) fn text(path: &Path, text: &str) -> Checked {
    if text.is_empty() {
        return refused(path.clone(), "is empty");
    }
    if text.chars().any(char::is_control) {
        let why = format!("is {}, must have no control characters", quoted(text));
        return refused(path.clone(), why);
    }
    if text.len() > 4096 {
        let why = format!("is {}, must have at most 4096 bytes", quoted(text));
        return refused(path.clone(), why);
    }
    Ok(())
}
