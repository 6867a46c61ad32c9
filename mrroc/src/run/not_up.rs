//! Why the drives of a cell did not come up, in the words of the cell.

use std::fmt::Display;

use anyhow::anyhow;
use can::ControllerState;
use drive::wrench::WrenchError;
use drive::{BringUpError, GroupCounters};
use servo::{NotUp, Servo};

use crate::bench::silence;
use crate::cell::{CellFile, printable};
use crate::report::bus_errors;

/// Why the drives of a cell did not come up, in the words of the cell.
pub fn why_not_up(file: &CellFile, why: NotUp) -> anyhow::Error {
    let NotUp::Group(bus, error) = why else {
        return anyhow!("stopped on request");
    };
    if let Some(sensor) = file.cell.sensor_of_group(bus) {
        let cause: &dyn Display = if let BringUpError::WrenchLine { error } = &error { error } else { &error };
        return anyhow!("force sensor {}, line {}: {cause}", sensor.name, printable(sensor.tty()));
    }
    if let Some(matrix) = file.cell.matrix_of_group(bus) {
        let cause: &dyn Display = if let BringUpError::Ultrasonic { error } = &error { error } else { &error };
        return anyhow!("ultrasonic matrix {}, line {}: {cause}", matrix.name, printable(&matrix.line));
    }
    if let Some(device) = file.cell.device_of_group(bus) {
        let cause: &dyn Display = if let BringUpError::Device { error } = &error { error } else { &error };
        return anyhow!("{}, line {}: {cause}", device.title(), printable(&device.keys.line));
    }
    let axis = file.cell.axes_on(bus).enumerate().find(|&(index, (robot, axis))| match error.line() {
        Some(line) => index == line,
        None => error.node() == Some(file.cell.robot[robot].axis[axis].node),
    });
    let axis = axis.map(|(_, (robot, axis))| format!(", axis {}", file.axis_name(robot, axis)));
    let mut io = file.cell.io_on(bus).map(|node| &file.cell.io[node]);
    let io = io.find(|io| error.node() == Some(io.node)).map(|io| format!(", I/O node {}", io.name));
    let mut sensors = file.cell.sensors_on(bus);
    let sensor = sensors.find(|&sensor| error.node().is_some() && error.node() == file.cell.node_of_sensor(sensor));
    let sensor = sensor.map(|sensor| format!(", force sensor {}", file.cell.force_sensor[sensor].name));
    let name = file.cell.groups().nth(bus).expect("the servo has the groups of the cell");
    anyhow!("bus {name}{}: {error}", axis.or(io).or(sensor).unwrap_or_default())
}

/// The text of [`why_not_up`]. If a node never booted, the nodes that were heard and the errors of its bus are added.
/// `servo`: the servo whose bring-up failed.
pub fn diagnosed(file: &CellFile, servo: &Servo, why: NotUp) -> anyhow::Error {
    let error = why_not_up(file, why);
    let NotUp::Group(
        bus,
        BringUpError::NeverBooted { .. } | BringUpError::WrenchNode { error: WrenchError::Absent { .. }, .. },
    ) = why
    else {
        return error;
    };
    match servo.group_counters().nth(bus) {
        Some(counters) if bus < file.cell.bus.len() => anyhow!("{error:#}: {}", of_bus(file, bus, counters)),
        _ => error,
    }
}

/// Who was heard on bus `bus`, or why nobody was.
fn of_bus(file: &CellFile, bus: usize, counters: GroupCounters) -> String {
    let cell = &file.cell;
    let axes = cell.axes_on(bus).map(|(robot, axis)| cell.robot[robot].axis[axis].node);
    let io = cell.io_on(bus).map(|io| cell.io[io].node);
    let sensors = cell.sensors_on(bus).filter_map(|sensor| cell.node_of_sensor(sensor));
    let known: Vec<u8> = axes.chain(io).chain(sensors).collect();
    let heard: Vec<u8> = (1..128).filter(|node| counters.heard >> node & 1 == 1).collect();
    if heard.is_empty() {
        return silence::reasons(format_args!("bus {}", cell.bus[bus].name), counters.port, counters.state);
    }
    let strangers: Vec<u8> = heard.iter().copied().filter(|node| !known.contains(node)).collect();
    let strange = match &strangers[..] {
        [] => "check its node-ID, power and connector".to_owned(),
        strangers => format!("{} not in the cell: check the node-ID, power and connector", listed(strangers)),
    };
    let trouble = trouble(counters).map(|trouble| format!("; {trouble}"));
    format!("heard on the bus: {}; {strange}{}", listed(&heard), trouble.unwrap_or_default())
}

/// Errors of a bus on which nodes were heard: a bus without termination can carry some of the frames.
fn trouble(GroupCounters { port, state, .. }: GroupCounters) -> Option<String> {
    let now = (state != ControllerState::Active).then(|| format!(", now {}", silence::state_text(state)));
    (port.errors + port.passive + port.bus_off > 0 || now.is_some())
        .then(|| bus_errors([port.errors, port.passive, port.bus_off], now.as_deref().unwrap_or_default()))
}

/// `node 3`, or `nodes 3, 4 and 5`.
fn listed(nodes: &[u8]) -> String {
    let texts: Vec<_> = nodes.iter().map(u8::to_string).collect();
    match texts.split_last() {
        Some((last, [])) => format!("node {last}"),
        Some((last, rest)) => format!("nodes {} and {last}", rest.join(", ")),
        None => "no node".to_owned(),
    }
}

#[cfg(all(test, feature = "recording"))]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::*;
    use crate::bench::BenchKind;
    use crate::recording::damage_tests::short_cell;
    use crate::run::{Requests, RunOptions, run};
    use crate::tasks::CarriedTask;

    #[test]
    fn a_run_with_a_node_that_is_absent_says_which_nodes_answered() {
        let directory = tempfile::tempdir().unwrap();
        let file = short_cell(directory.path(), false);
        let mut cell: toml::Table = file.text.parse().unwrap();
        cell["robot"][0]["axis"][2]["emulator"]["absent"] = true.into();
        fs::write(&file.path, toml::to_string(&cell).unwrap()).unwrap();
        let file = CellFile::read(&file.path).unwrap();
        let options = RunOptions::on(BenchKind::Lockstep);
        let refused = run(&file, &options, &Requests::default(), &CarriedTask::Home.program(), &mut |_| {});
        assert_eq!(
            format!("{:#}", refused.unwrap_err()),
            "bus arm, axis upper-arm: node 3: never booted, waited 2.0s: heard on the bus: nodes 1, 2, 4 and 5; check \
             its node-ID, power and connector"
        );
    }

    #[test]
    fn the_refusal_of_a_node_that_never_booted_says_who_was_heard() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/irb6.toml");
        let file = CellFile::read(&path).unwrap();
        let of = |heard: &[u8]| {
            let heard = heard.iter().fold(0, |nodes, node| nodes | 1 << node);
            of_bus(&file, 0, GroupCounters { heard, ..GroupCounters::default() })
        };
        assert_eq!(of(&[1, 2, 4]), "heard on the bus: nodes 1, 2 and 4; check its node-ID, power and connector");
        assert_eq!(
            of(&[1, 17]),
            "heard on the bus: nodes 1 and 17; node 17 not in the cell: check the node-ID, power and connector"
        );
        // Errors of the bus are reported although nodes were heard.
        let port = can::Counters { received: 9, errors: 1, passive: 2, ..can::Counters::default() };
        let troubled =
            GroupCounters { heard: 1 << 2, port, state: ControllerState::Passive, ..GroupCounters::default() };
        assert_eq!(
            of_bus(&file, 0, troubled),
            "heard on the bus: node 2; check its node-ID, power and connector; 1 error frame, error passive 2 times, bus \
             off 0 times, now error passive: check bit rate, termination, cables, and power of the nodes"
        );
        assert!(of(&[]).starts_with("nothing at all is heard on bus arm: wrong bit rate"));
        let passive = GroupCounters { state: ControllerState::Passive, ..GroupCounters::default() };
        assert!(of_bus(&file, 0, passive).contains("error passive: nobody acknowledges"));
    }
}
