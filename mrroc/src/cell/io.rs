//! The keys of I/O nodes: digital inputs and outputs of CiA 401 modules on CAN buses.

use std::time::Duration;

use canopen::NodeId;
use drive::bus::BESIDE_SETPOINTS;
use drive::cia401::IoConfig;
use drive::cia402::Identity;
use serde::{Deserialize, Serialize};

use super::{Cell, Parameter, defaults};

/// A CiA 401 module of digital inputs and outputs on a CAN bus, beside drives or without them.
///
/// Levels are logical: an inverted line is true while its terminal is low. An edge reaches the controller within two
/// servo periods and the inhibit time, on a bus within its budget. A filtered input takes the filter time in addition.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct IoNode {
    /// Name of the I/O node in reports.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")))]
    pub name: String,
    /// The CAN bus of the node.
    pub bus: String,
    /// Node-ID, which no drive of the bus has.
    pub node: u8,
    /// Vendor-ID, object 0x1018:01.
    pub vendor: u32,
    /// Product code, object 0x1018:02; not checked where absent.
    pub product: Option<u32>,
    /// Revision number, object 0x1018:03; not checked where absent.
    pub revision: Option<u32>,
    /// Shortest time between two frames with inputs, µs, a multiple of 100; the servo period where absent. The time
    /// bounds the bus load and the delay of an edge. Two edges of an input within this time may be lost.
    pub inhibit_us: Option<u32>,
    /// Longest time between two frames with inputs, ms. Three times without inputs are a fault of the node.
    #[serde(default = "defaults::count::<100, u16>")]
    pub event_timer_ms: u16,
    /// Further objects to write before operation, such as a filter time of the vendor.
    #[serde(default)]
    pub parameter: Vec<Parameter>,
    /// The inputs that are used.
    #[serde(default)]
    pub input: Vec<InputLine>,
    /// The outputs that are used.
    #[serde(default)]
    pub output: Vec<OutputLine>,
}

/// A digital input.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct InputLine {
    /// Name of the line, unlike that of any other line of the cell.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")))]
    pub name: String,
    /// Number of the input within the node, 0 to 63.
    pub line: u8,
    /// Whether the input is true while its terminal is low.
    #[serde(default)]
    pub inverted: bool,
    /// Whether the input is a contact of the emergency stop. While the input is false, or its node has a fault, every robot
    /// of the cell brakes, and its drives go off and stay off. A normally closed contact is true while it is closed.
    #[serde(default)]
    pub emergency_stop: bool,
    /// Whether the node filters the input (object 0x6003). The node determines the filter time.
    #[serde(default)]
    pub filtered: bool,
    /// Times at which the terminal of the emulated input changes its level, s since the emulated devices were switched
    /// on, ascending. The terminal is low before the first time. Real nodes ignore this key.
    #[serde(default)]
    pub emulated_edges_s: Vec<f64>,
}

/// A digital output.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct OutputLine {
    /// Name of the line, unlike that of any other line of the cell.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")))]
    pub name: String,
    /// Number of the output within the node, 0 to 63.
    pub line: u8,
    /// Whether the terminal is low while the output is true.
    #[serde(default)]
    pub inverted: bool,
    /// The output when the host is silent, and after a fault of the node.
    #[serde(default)]
    pub error_state: ErrorState,
}

/// The error state of an output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum ErrorState {
    /// The output becomes false. It is false before the first command.
    #[default]
    Off,
    /// The output becomes true. It is true before the first command.
    On,
    /// The output keeps its last level, also through a reset of the node. It is false before the first command.
    Keep,
}

/// Place of a line of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinePlace {
    /// Index of the I/O node in [`Cell::io`].
    pub node: usize,
    /// Number of the input or output within the node.
    pub line: u8,
}

impl Cell {
    /// Indices in [`io`](Self::io) of the I/O nodes on bus `bus`.
    pub fn io_on(&self, bus: usize) -> impl Iterator<Item = usize> {
        let name = self.bus.get(bus).map(|bus| bus.name.as_str());
        (0..self.io.len()).filter(move |&node| Some(self.io[node].bus.as_str()) == name)
    }

    /// Configurations of the I/O nodes on bus `bus`, in the order of [`io_on`](Self::io_on).
    pub fn io_configs(&self, bus: usize) -> Vec<IoConfig> {
        self.io_on(bus).map(|node| self.io[node].config(self.period())).collect()
    }

    /// Greatest number of frames that the host sends on bus `bus` in a cycle. The send queue of a port needs room for
    /// all of them.
    pub fn frames_per_cycle(&self, bus: usize) -> usize {
        self.axes_on(bus).count() + self.io_on(bus).count() + BESIDE_SETPOINTS
    }

    /// The input called `name`.
    pub fn input_line(&self, name: &str) -> Option<LinePlace> {
        let of = |(node, io): (usize, &IoNode)| {
            let input = io.input.iter().find(|input| input.name == name)?;
            Some(LinePlace { node, line: input.line })
        };
        self.io.iter().enumerate().find_map(of)
    }

    /// The output called `name`.
    pub fn output_line(&self, name: &str) -> Option<LinePlace> {
        let of = |(node, io): (usize, &IoNode)| {
            let output = io.output.iter().find(|output| output.name == name)?;
            Some(LinePlace { node, line: output.line })
        };
        self.io.iter().enumerate().find_map(of)
    }
}

impl Cell {
    /// Whether the terminal of the output called `name` is low while the output is true.
    pub fn inverts(&self, name: &str) -> bool {
        let mut outputs = self.io.iter().flat_map(|io| &io.output);
        outputs.any(|output| output.name == name && output.inverted)
    }
}

impl IoNode {
    /// Configuration of the node at the servo period `period`.
    pub fn config(&self, period: Duration) -> IoConfig {
        let inputs = |of: fn(&InputLine) -> bool| mask(self.input.iter().map(|it| (it.line, of(it))));
        let outputs = |of: fn(&OutputLine) -> bool| mask(self.output.iter().map(|it| (it.line, of(it))));
        IoConfig {
            node: NodeId::new(self.node).expect("a parsed cell has valid node-IDs"),
            identity: Identity { vendor: self.vendor, product: self.product, revision: self.revision },
            inputs: count(self.input.iter().map(|input| input.line)),
            outputs: count(self.output.iter().map(|output| output.line)),
            inhibit_time: self.inhibit_us.map_or(period, |micros| Duration::from_micros(micros.into())),
            event_timer: Duration::from_millis(self.event_timer_ms.into()),
            inverted_inputs: inputs(|input| input.inverted),
            emergency_inputs: inputs(|input| input.emergency_stop),
            filtered_inputs: inputs(|input| input.filtered),
            inverted_outputs: outputs(|output| output.inverted),
            error_mode: outputs(|output| output.error_state != ErrorState::Keep),
            error_value: outputs(|output| output.error_state == ErrorState::On),
            configuration: self.parameter.iter().map(Parameter::setting).collect(),
        }
    }

    /// Changes of level at the terminals of the emulated inputs, in the order of the file: time since power-on, input,
    /// and the level afterwards.
    pub fn emulated_edges(&self) -> impl Iterator<Item = (Duration, u8, bool)> {
        self.input.iter().flat_map(|input| {
            let levels = [true, false].into_iter().cycle();
            let edges = input.emulated_edges_s.iter().zip(levels);
            edges.map(|(at, level)| (Duration::from_secs_f64(*at), input.line, level))
        })
    }
}

/// The lines that are set, line *n* in bit *n*.
fn mask(lines: impl Iterator<Item = (u8, bool)>) -> u64 {
    lines.fold(0, |bits, (line, set)| bits | u64::from(set).checked_shl(line.into()).unwrap_or(0))
}

/// The number of lines up to the last one that is used. An output without a name is commanded low.
fn count(lines: impl Iterator<Item = u8>) -> u8 {
    lines.map(|line| line.saturating_add(1)).max().unwrap_or(0)
}
