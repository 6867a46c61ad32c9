//! Light gates along a line of travel, as a task declares them.

use std::time::Duration;

use can::timing::{Format, INTERMISSION, worst_case_bits};
use canopen::cia401::blocks;
use canopen::cob;
use canopen::pdo::PdoNumber;
use controller::sensor::{GateLine, LightGates, LightGatesConfig, Travel};
use serde::Deserialize;

use super::{Cell, TaskError};
use crate::bench::emulation::bitrate;
use crate::budget;

/// Light gates along a line of travel, for example in the table `task` of the cell file.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct GateTrack {
    /// The gates, in ascending order of their places. All inputs are of one I/O node, and true while a beam is broken.
    pub gate: Vec<GatePlace>,
    /// Possible direction of travel.
    #[serde(default)]
    pub direction: GateDirection,
    /// Lowest speed of an object, m/s.
    pub min_speed: f64,
    /// Greatest speed of an object, m/s.
    pub max_speed: f64,
    /// Response time of the gates: delay from the beam to the terminal of the input, µs.
    pub response_us: u32,
    /// Jitter of the gates: longest further delay, µs.
    #[serde(default)]
    pub jitter_us: u32,
}

/// Place of a light gate.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct GatePlace {
    /// Name of the input.
    pub input: String,
    /// Place of the beam on the line of travel, m.
    pub place: f64,
}

/// Possible direction of travel past light gates.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum GateDirection {
    /// Towards greater places.
    #[default]
    Forward,
    /// Towards lower places.
    Backward,
    /// Both.
    Either,
}

impl Cell {
    /// A virtual sensor of light gates. The delays of edges follow from the response of the gates, the bit rate, the
    /// worst-case traffic of the bus, and the inhibit time of the node. Refuses an unknown input, inputs of several
    /// nodes, and impossible places and speeds.
    pub fn light_gates(&self, track: &GateTrack) -> Result<LightGates, TaskError> {
        let cell = &self.file().cell;
        let mut node = None;
        let mut gates = Vec::new();
        for GatePlace { input, place } in &track.gate {
            let found = cell.input_line(input).ok_or_else(|| TaskError::UnknownInput { name: input.clone() })?;
            if *node.get_or_insert(found.node) != found.node {
                let why = "the inputs of light gates along one line are of one I/O node: wire all gates to one node";
                return Err(TaskError::Refused(anyhow::anyhow!("gate {input}: {why}")));
            }
            gates.push(GateLine { input: found.line, place: *place });
        }
        let refused = |why: anyhow::Error| TaskError::Refused(why.context("light gates"));
        let Some(node) = node else {
            return Err(refused(anyhow::anyhow!("no gates, must be at least 2")));
        };
        let config = cell.io[node].config(cell.period());
        let bus = cell.bus.iter().position(|bus| bus.name == cell.io[node].bus).expect("a parsed node is on a bus");
        let bytes = blocks(config.inputs);
        // The shortest frame has no stuff bits. Stuff bits are a part of the wait.
        let bits = 47 + 8 * u32::from(bytes);
        debug_assert!(bits <= worst_case_bits(Format::Standard, bytes));
        let frame = bitrate(self.file(), bus).duration(bits - INTERMISSION);
        let inputs = cob::tpdo(PdoNumber::One, config.node);
        let longest = budget::longest_response(self.file(), bus, inputs).map_err(refused)?;
        let config = LightGatesConfig {
            gates,
            travel: match track.direction {
                GateDirection::Forward => Travel::Forward,
                GateDirection::Backward => Travel::Backward,
                GateDirection::Either => Travel::Either,
            },
            min_speed: track.min_speed,
            max_speed: track.max_speed,
            delay: Duration::from_micros(track.response_us.into()) + frame,
            wait: longest.saturating_sub(frame) + Duration::from_micros(track.jitter_us.into()),
            inhibit_time: config.inhibit_time,
        };
        LightGates::new(self.link(node), &config).map_err(|why| refused(why.into()))
    }
}
