//! Checks of buses and bundles of serial lines.

use std::time::Duration;

use drive::bus::times::{least_boot_timeout, least_sdo_timeout};

use super::{Checked, MOST, name, refused, some, twice, unique, within};
use crate::cell::{Cell, Path, Range};
use crate::{bench::interfaces::Interface, cell::text::quoted};

/// Longest period of a heartbeat, ms.
const LONGEST_HEARTBEAT_MS: f64 = 1e4;

/// Longest time-out of an SDO answer and of a boot, ms.
const LONGEST_TIMEOUT_MS: f64 = 6e4;

/// Longest latency timer of a USB adapter, ms: its register has 8 bits.
const LONGEST_LATENCY_MS: f64 = 255.0;

pub(super) fn check(cell: &Cell) -> Checked {
    let groups = cell.bus.len() + cell.serial.len();
    let what = if groups == 0 { "buses, and no serial lines either" } else { "buses and bundles of serial lines" };
    some(&Path::default(), "bus", groups, MOST, what)?;
    check_buses(cell)?;
    check_serial(cell)
}

/// A bus needs an axis, an I/O node or a force sensor. A bundle of serial lines needs an axis.
pub(super) fn check_used(cell: &Cell) -> Checked {
    for (group, name) in cell.groups().take(cell.bus.len() + cell.serial.len()).enumerate() {
        if cell.axes_on(group).next().is_some() {
            continue;
        }
        let top = Path::default();
        match group.checked_sub(cell.bus.len()) {
            None if cell.io_on(group).next().is_some() || cell.sensors_on(group).next().is_some() => {}
            None => {
                let why = format!(
                    "no axis, no I/O node and no force sensor has bus = {name:?}: leave it out, or name it in one of them"
                );
                return refused(&top.then("bus"), group, why);
            }
            Some(bundle) => {
                let why = format!("no axis has bus = {name:?}: leave it out, or name it in an axis");
                return refused(&top.then("serial"), bundle, why);
            }
        }
    }
    Ok(())
}

/// Each bus has a valid interface of its own.
pub(super) fn check_interfaces(cell: &Cell) -> Checked {
    let mut taken = Vec::new();
    for (index, bus) in cell.bus.iter().enumerate() {
        let interface = Interface::parse(&bus.interface);
        let problem = match interface.check() {
            Err(problem) => Some(problem.to_string()),
            Ok(()) if matches!(interface, Interface::Epos { .. }) => {
                Some(format!("{interface} is the service port of a drive, which is no CAN bus"))
            }
            Ok(()) => (taken.iter().position(|other| *other == interface))
                .map(|first| format!("{interface} is that of bus[{first}]: give each its own")),
        };
        if let Some(problem) = problem {
            return refused(&Path::to("bus").then(index), "interface", problem);
        }
        taken.push(interface);
    }
    Ok(())
}

fn check_buses(cell: &Cell) -> Checked {
    let buses = Path::to("bus");
    for (index, bus) in cell.bus.iter().enumerate() {
        let path = buses.then(index);
        name(&path, "name", &bus.name)?;
        unique(&buses, "name", index, cell.bus.iter().map(|it| &it.name), |name| format!("bus {name:?}"))?;
        text(&path, "interface", &bus.interface)?;
        within(&path, "emulated_load", bus.emulated_load, Range::new(0.0, 0.9, ""))?;
        let interfaces = cell.bus.iter().map(|it| &it.interface);
        unique(&buses, "interface", index, interfaces, |interface| format!("interface {}", quoted(interface)))?;
        let kbps = bus.bitrate_kbps;
        if can::timing::Bitrate::from_kbps(kbps).is_none() {
            let why = format!("is {kbps}, must be 10 to 1000 (kbit/s) with a bit time of whole nanoseconds");
            return refused(&path, "bitrate_kbps", why);
        }
        let node = Range::new(1.0, 127.0, "");
        let cycles = Range::new(0.0, 1000.0, "cycles");
        within(&path, "host_node", bus.host_node, node)?;
        within(&path, "tolerated_missing", bus.tolerated_missing, cycles)?;
        check_times(cell, index, &path)?;
    }
    Ok(())
}

/// The times of bus `index` fit the servo period and the number of nodes.
fn check_times(cell: &Cell, index: usize, path: &Path) -> Checked {
    let (bus, period) = (&cell.bus[index], cell.period());
    let nodes = cell.axes_on(index).count() + cell.io_on(index).count() + cell.sensors_on(index).count();
    let at_least = |least: Duration, most, of| Range::new(least.as_secs_f64() * 1e3, most, of);
    let of = "ms, at least the servo period: the host sends one heartbeat per cycle at the most";
    within(path, "heartbeat_ms", bus.heartbeat_ms, at_least(period, LONGEST_HEARTBEAT_MS, of))?;
    let of = "ms, at least one period per node of the bus: one request leaves per cycle";
    let range = at_least(least_sdo_timeout(period, nodes), LONGEST_TIMEOUT_MS, of);
    within(path, "sdo_timeout_ms", bus.sdo_timeout_ms, range)?;
    let of = "ms: an emulated node boots in 50 ms, and answers a cycle later; real nodes take longer";
    let range = at_least(least_boot_timeout(period, nodes, hil::BOOT_DELAY), LONGEST_TIMEOUT_MS, of);
    within(path, "boot_timeout_ms", bus.boot_timeout_ms, range)
}

fn check_serial(cell: &Cell) -> Checked {
    let bundles = Path::to("serial");
    for (index, bundle) in cell.serial.iter().enumerate() {
        let path = bundles.then(index);
        name(&path, "name", &bundle.name)?;
        let what = |name: &String| format!("bus {name:?}");
        if let Some(first) = cell.bus.iter().position(|bus| bus.name == bundle.name) {
            let first = Path::to("bus").then(first);
            return refused(&path, "name", twice(&what(&bundle.name), &first));
        }
        unique(&bundles, "name", index, cell.serial.iter().map(|it| &it.name), |name| what(name))?;
        let latency = bundle.emulated_latency_ms.unwrap_or(1);
        let (bauds, cycles) = (Range::new(9_600.0, 4e6, "bit/s"), Range::new(1.0, 10.0, "cycles"));
        let second = Range::new(1.0, 1000.0, "ms");
        let timer = Range::new(1.0, LONGEST_LATENCY_MS, "ms");
        within(&path, "baud", bundle.baud, bauds)?;
        within(&path, "tolerated_missing", bundle.tolerated_missing, cycles)?;
        within(&path, "answer_timeout_ms", bundle.answer_timeout_ms, second)?;
        within(&path, "emulated_latency_ms", latency, timer)?;
        if let Some(latency) = bundle.emulated_latency_ms.filter(|it| 1_000 * it >= cell.period_us) {
            let period = cell.period_us / 1_000;
            let why = format!(
                "is {latency}, must be below the servo period of {period} ms: an answer waits for the latency timer, \
                 and has to come within a period"
            );
            return refused(&path, "emulated_latency_ms", why);
        }
    }
    Ok(())
}

/// Checks that a text can be the path of a device or the name of an interface.
pub(super) fn text(path: &Path, key: &'static str, text: &str) -> Checked {
    let why = if text.is_empty() {
        "is empty".to_owned()
    } else if text.chars().any(char::is_control) {
        format!("is {}, must have no control characters", quoted(text))
    } else if text.len() > 4096 {
        format!("is {}, must have at most 4096 bytes", quoted(text))
    } else {
        return Ok(());
    };
    refused(path, key, why)
}
