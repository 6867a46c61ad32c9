//! Checks of I/O nodes.

use drive::cia401;

use super::axis::{Place, check_parameters};
use super::{Checked, name, refused, twice, unique, within};
use crate::cell::{Axis, Cell, Path, Range, quoted};

/// Latest time of an emulated edge, s.
const LATEST_EDGE: f64 = 1e6;

/// Greatest number of a line.
const LAST_LINE: f64 = 63.0;

pub(super) fn check(cell: &Cell) -> Checked {
    let nodes = Path::to("io");
    let mut names: Vec<(&str, Path)> = Vec::new();
    for (index, io) in cell.io.iter().enumerate() {
        let path = nodes.then(index);
        name(&path, "name", &io.name)?;
        unique(&nodes, "name", index, cell.io.iter().map(|it| &it.name), |name| format!("I/O node {name:?}"))?;
        check_node(cell, &path, &io.bus, io.node, "an I/O node")?;
        let earlier = cell.io[..index].iter().position(|other| other.bus == io.bus && other.node == io.node);
        if let Some(first) = earlier {
            let what = format!("node {} of bus {:?}", io.node, io.bus);
            return refused(&path, "node", twice(&what, &nodes.then(first)));
        }
        let period = f64::from(cell.period_us) / 1e3;
        let timer = Range::new(period, f64::from(u16::MAX), "ms; the servo period at the least");
        within(&path, "event_timer_ms", io.event_timer_ms, timer)?;
        check_parameters(&path, &io.parameter, cia401::reserved)?;
        if io.input.is_empty() && io.output.is_empty() {
            return refused(&nodes, index, "has no input and no output, must have one line at the least");
        }
        let inputs: Vec<_> = io.input.iter().map(|input| (input.name.as_str(), input.line)).collect();
        check_lines(&path.then("input"), &inputs, &mut names)?;
        let outputs: Vec<_> = io.output.iter().map(|output| (output.name.as_str(), output.line)).collect();
        check_lines(&path.then("output"), &outputs, &mut names)?;
        for (number, input) in io.input.iter().enumerate() {
            check_edges(&path.then("input").then(number), "emulated_edges_s", &input.emulated_edges_s)?;
        }
    }
    Ok(())
}

/// The bus is a CAN bus of the cell, and the node-ID is neither that of the host nor of a drive. `device`: the kind of the
/// node, with its article.
pub(super) fn check_node(cell: &Cell, path: &Path, name: &str, node: u8, device: &str) -> Checked {
    let bus = match Place::of(cell, name) {
        Some(Place::Bus(bus)) => bus,
        Some(Place::Serial(_)) => {
            let why = format!("{} is a bundle of serial lines: {device} is on a CAN bus", quoted(name));
            return refused(path, "bus", why);
        }
        None => return refused(path, "bus", format!("no bus is called {}", quoted(name))),
    };
    within(path, "node", node, Range::new(1.0, 127.0, ""))?;
    let what = format!("node {node} of bus {:?}", bus.name);
    if node == bus.host_node {
        return refused(path, "node", twice(&what, &"the host"));
    }
    for (robot, value) in cell.robot.iter().enumerate() {
        let same = |axis: &Axis| axis.bus == name && axis.node == node;
        if let Some(axis) = value.axis.iter().position(same) {
            return refused(path, "node", twice(&what, &Path::axis(robot, axis)));
        }
    }
    Ok(())
}

/// The names differ from all names of lines so far, and the numbers from each other.
fn check_lines<'a>(path: &Path, lines: &[(&'a str, u8)], names: &mut Vec<(&'a str, Path)>) -> Checked {
    for (index, &(line_name, line)) in lines.iter().enumerate() {
        let here = path.then(index);
        name(&here, "name", line_name)?;
        if let Some((_, first)) = names.iter().find(|(other, _)| *other == line_name) {
            return refused(&here, "name", twice(&format!("line {line_name:?}"), first));
        }
        within(&here, "line", line, Range::new(0.0, LAST_LINE, ""))?;
        unique(path, "line", index, lines.iter().map(|(_, line)| line), |line| format!("line {line}"))?;
        names.push((line_name, here));
    }
    Ok(())
}

/// The emulated edges come one after the other.
pub(super) fn check_edges(path: &Path, key: &'static str, edges: &[f64]) -> Checked {
    let path = path.then(key);
    let mut before = None;
    for (number, &at) in edges.iter().enumerate() {
        within(&path, number, at, Range::new(0.0, LATEST_EDGE, "s"))?;
        if before.is_some_and(|before| at <= before) {
            return refused(&path, number, "is not later than the edge before");
        }
        before = Some(at);
    }
    Ok(())
}
