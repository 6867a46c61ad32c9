//! Configuration of one emulated input and output module.

use std::ops::RangeInclusive;
use std::time::Duration;

use can::Instant;
use canopen::NodeId;

use super::probe::InputProbe;
use crate::node::BOOT_DELAY;
use crate::plant::AngleProbe;
use crate::scene::BeamProbe;

/// Greatest number of bytes of inputs, and of outputs.
pub const MAX_BYTES: u8 = 8;

/// Configuration of one module.
#[derive(Clone, Debug)]
pub struct DigitalIoConfig {
    /// Node-ID of the unit. `None`: LSS is to assign a node-ID, and the unit sends nothing before.
    pub node: Option<NodeId>,
    /// Object 0x1018:1; 0 is no registered vendor.
    pub vendor: u32,
    /// Object 0x1018:2.
    pub product: u32,
    /// Object 0x1018:3.
    pub revision: u32,
    /// Object 0x1018:4.
    pub serial: u32,
    /// Bytes of inputs, at most [`MAX_BYTES`]. Zero: the module has no inputs and no object of inputs.
    pub input_bytes: u8,
    /// Bytes of outputs, at most [`MAX_BYTES`]. Zero: the module has no outputs and no object of outputs.
    pub output_bytes: u8,
    /// Time for which an input must keep a new level where object 0x6003 switches its filter on.
    pub filter_time: Duration,
    /// Time of power-on: no later than the first instant passed to the device.
    pub power_on: Instant,
    /// Delay from power-on or reset to the boot-up frame.
    pub boot_delay: Duration,
    /// Delay from an SDO request to its answer.
    pub answer_delay: Duration,
    /// Edges of inputs, in any order.
    pub edges: Vec<InputEdge>,
    /// Light gates. A gate overwrites the level of its input every millisecond. Such an input has one gate and no edges.
    pub light_gates: Vec<LightGate>,
    /// Light gates of the scene and their inputs, counted from 0. An input is high while the beam is broken. Such an input
    /// has no edges of its own.
    pub beams: Vec<(u8, BeamProbe)>,
    /// Inputs whose levels the scene of the [`World`](crate::World) computes, each with its source. Such an input has no
    /// other source. Without a scene, the level stays low.
    pub probes: Vec<(u8, InputProbe)>,
}

impl DigitalIoConfig {
    /// A module with one byte of inputs, one byte of outputs, a filter of 3 ms, and short boot and answer delays.
    pub fn new(node: NodeId) -> Self {
        Self {
            node: Some(node),
            vendor: 0,
            product: 0x0000_0401,
            revision: 0x0001_0000,
            serial: 0x2000_0000 + u32::from(node.raw()),
            input_bytes: 1,
            output_bytes: 1,
            filter_time: Duration::from_millis(3),
            power_on: Instant::ZERO,
            boot_delay: BOOT_DELAY,
            answer_delay: Duration::from_micros(300),
            edges: Vec::new(),
            light_gates: Vec::new(),
            beams: Vec::new(),
            probes: Vec::new(),
        }
    }
}

/// A scheduled change of the level at the terminal of an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputEdge {
    /// Time of the edge. The level of an input at power-on is low; an edge before power-on sets another level.
    pub at: Instant,
    /// Input, counted from 0: bit `index % 8` of byte `index / 8`.
    pub index: u8,
    /// Level after the edge: high or low.
    pub level: bool,
}

/// A light gate: an input that is high while an axis is inside an interval. The gate samples every millisecond.
#[derive(Clone, Debug)]
pub struct LightGate {
    /// Input, counted from 0.
    pub index: u8,
    /// Motor shaft of the axis.
    pub probe: AngleProbe,
    /// Angle of the motor shaft at load position 0, rad.
    pub zero_angle: f64,
    /// Motion of the load per rad of the motor shaft, rad, or m for a linear load.
    pub ratio: f64,
    /// Load positions at which the input is high, rad or m.
    pub interval: RangeInclusive<f64>,
}

impl LightGate {
    pub(super) fn level(&self) -> bool {
        self.interval.contains(&((self.probe.angle() - self.zero_angle) * self.ratio))
    }
}
