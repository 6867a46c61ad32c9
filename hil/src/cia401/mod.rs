//! A module of digital inputs and outputs: CiA 301 and CiA 401, up to 64 inputs and 64 outputs in bytes.
//!
//! [`DigitalIo`] is a [`Device`] with the same communication as the emulated drives. Inputs have polarity, filter and
//! interrupt masks. Outputs have polarity, filter mask and error value. A bench schedules edges of inputs
//! ([`InputEdge`], [`DigitalIo::set_input`]), or connects inputs to axes ([`LightGate`]), to light gates of the scene
//! ([`BeamProbe`]) or to other levels of the scene ([`InputProbe`]). A bench reads outputs
//! with the time of their last change ([`DigitalIo::output`]).
//!
//! ```
//! # use std::time::Duration;
//! # use can::{Frame, Instant, Port, StandardId, timing::Bitrate};
//! # use canopen::NodeId;
//! # use mrroc_hil::{DigitalIo, DigitalIoConfig, World};
//! let mut world = World::new();
//! let bus = world.add_bus(Bitrate::KBPS_1000);
//! let mut port = world.host_port(bus, 64);
//! let module = DigitalIo::new(DigitalIoConfig::new(NodeId::new(5).unwrap())).unwrap();
//! let module = world.add_device(bus, Box::new(module));
//! // The module boots, the host starts it, and the first RPDO switches output 0 on.
//! let at = |millis| Instant::ZERO + Duration::from_millis(millis);
//! world.advance(at(60));
//! for (id, data) in [(0x000, [1, 5].as_slice()), (0x205, &[1])] {
//!     let frame = Frame::new(StandardId::new(id).unwrap(), data).unwrap();
//!     port.send(at(60), &[frame]).unwrap();
//! }
//! // An edge of input 3 follows at 70 ms.
//! world.change(module, at(60), |module: &mut DigitalIo| module.set_input(at(70), 3, true)).unwrap().unwrap();
//! world.advance(at(80));
//! let module: &DigitalIo = world.device(module).unwrap();
//! assert!(module.output(0).level && module.output(0).changed_at < Some(at(61)));
//! assert_eq!(module.inputs(), 0b1000);
//! ```
//!
//! The dictionary follows excerpts of CiA 401 (versions 2.0 and 2.1) and manuals of modules. The whole standard was not at
//! hand. The comments of the data sheet
//! ([`DigitalIo::eds`]) list the choices of the emulator. Left out: objects of single bits and of 16 and 32 lines,
//! analogue lines, and the sub-indices of object 0x1029 for errors of inputs and outputs.

mod config;
mod eds;
mod inputs;
mod lines;
mod outputs;
mod probe;
mod table;
#[cfg(test)]
mod tests;

use std::borrow::Cow;

use can::{Frame, Instant};
use thiserror::Error;

use crate::Device;
use crate::node::errors::{self, Error as NodeError};
use crate::node::objects::Objects;
use crate::node::{Application, Applied, Identity, Node, NodeConfig};
use crate::scene::{BeamEdge, BeamProbe};
pub use config::{DigitalIoConfig, InputEdge, LightGate, MAX_BYTES};
use inputs::Inputs;
use outputs::Outputs;
pub use outputs::{OutputProbe, OutputState};
pub use probe::InputProbe;
use table::{INPUTS, OUTPUTS, SHAPE, table};

/// Reason that a module cannot have a configuration or an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum DigitalIoError {
    #[error("{bytes} bytes of lines of one kind, at most 8 are possible")]
    TooManyBytes { bytes: u8 },
    #[error("no input {index}, the module has {inputs} inputs counted from 0")]
    NoInput { index: u8, inputs: u8 },
}

/// An emulated module of digital inputs and outputs.
pub struct DigitalIo {
    node: Node<Module>,
    /// Number of inputs.
    inputs: u8,
    beams: Vec<(u8, BeamProbe)>,
}

impl DigitalIo {
    /// A device switched on at [`DigitalIoConfig::power_on`].
    pub fn new(config: DigitalIoConfig) -> Result<Self, DigitalIoError> {
        for bytes in [config.input_bytes, config.output_bytes] {
            if bytes > MAX_BYTES {
                return Err(DigitalIoError::TooManyBytes { bytes });
            }
        }
        let inputs = 8 * config.input_bytes;
        let gates = config.light_gates.iter().map(|gate| gate.index);
        let beams = config.beams.iter().map(|(index, _)| *index);
        let probes = config.probes.iter().map(|(index, _)| *index);
        for index in gates.chain(beams).chain(config.edges.iter().map(|edge| edge.index)).chain(probes) {
            check(index, inputs)?;
        }
        let table = table(&config);
        let node = NodeConfig {
            id: config.node,
            identity: Identity {
                vendor: config.vendor,
                product: config.product,
                revision: config.revision,
                serial: config.serial,
            },
            power_on: config.power_on,
            boot_delay: config.boot_delay,
            answer_delay: config.answer_delay,
            lss_delay: std::time::Duration::ZERO,
        };
        let module = Module {
            inputs: Inputs::new(
                &table,
                config.input_bytes,
                config.filter_time,
                config.edges,
                config.light_gates,
                config.probes,
                config.power_on,
            ),
            outputs: Outputs::new(&table, config.output_bytes),
            now: config.power_on,
        };
        let objects = Objects::new(Cow::Owned(table), config.node, &[]);
        let mut node = Node::new(node, objects, module);
        node.schedule();
        Ok(Self { node, inputs, beams: config.beams })
    }

    /// Schedules a change of the terminal of input `index`, counted from 0, at time `at`. A time in the past means now.
    pub fn set_input(&mut self, at: Instant, index: u8, level: bool) -> Result<(), DigitalIoError> {
        check(index, self.inputs)?;
        if let Some(inputs) = &mut self.node.application.inputs {
            inputs.schedule(InputEdge { at, index, level });
        }
        self.node.schedule();
        Ok(())
    }

    /// Levels at the terminals of all inputs, input 0 in the lowest bit.
    pub fn inputs(&self) -> u64 {
        self.node.application.inputs.as_ref().map_or(0, |inputs| inputs.terminals)
    }

    /// Levels at the terminals of all outputs, output 0 in the lowest bit.
    pub fn outputs(&self) -> u64 {
        self.node.application.outputs.as_ref().map_or(0, |outputs| outputs.terminals)
    }

    /// Level of output `index`, counted from 0, and the time of its last change. An absent output is low.
    pub fn output(&self, index: u8) -> OutputState {
        self.node.application.outputs.as_ref().map_or(OutputState::default(), |outputs| outputs.state(index))
    }

    /// Connects a probe to the terminal of output `index`, counted from 0. The terminal of an absent output stays low.
    pub fn connect(&mut self, index: u8, probe: &OutputProbe) {
        if let Some(outputs) = &mut self.node.application.outputs {
            outputs.connect(index, probe.clone());
        }
    }

    /// Switches the supply off or on at `now`. A module without supply is silent, and its outputs are low.
    pub fn set_power(&mut self, on: bool, now: Instant) {
        self.node.set_power(on, now);
    }
}

fn check(index: u8, inputs: u8) -> Result<(), DigitalIoError> {
    if index < inputs { Ok(()) } else { Err(DigitalIoError::NoInput { index, inputs }) }
}

impl Device for DigitalIo {
    fn hears(&self, frame: &Frame) -> bool {
        self.node.hears(frame)
    }

    fn handle(&mut self, frame: &Frame, now: Instant) {
        self.node.handle(frame, now);
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        self.node.poll_transmit(now)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.node.poll_timeout()
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.node.handle_timeout(now);
    }

    /// Takes the edges of the light gates.
    fn advance_mechanics(&mut self, _now: Instant) -> bool {
        let mut taken = false;
        for (index, probe) in &self.beams {
            while let Some(BeamEdge { at, broken }) = probe.take() {
                if let Some(inputs) = &mut self.node.application.inputs {
                    inputs.schedule(InputEdge { at, index: *index, level: broken });
                }
                taken = true;
            }
        }
        if taken {
            self.node.schedule();
        }
        taken
    }

    fn sense(&mut self, now: Instant) -> bool {
        let has_changed = self.node.application.inputs.as_mut().is_some_and(|inputs| inputs.sense(now));
        if has_changed {
            self.node.schedule();
        }
        has_changed
    }
}

/// The lines of the module, as the application of its node.
#[derive(Debug)]
struct Module {
    inputs: Option<Inputs>,
    outputs: Option<Outputs>,
    now: Instant,
}

impl Module {
    fn fail_outputs(&mut self, objects: &Objects) {
        if let Some(outputs) = &mut self.outputs {
            outputs.fail(self.now, objects);
        }
    }
}

impl Application for Module {
    fn catch_up(&mut self, now: Instant, _exact: bool, objects: &mut Objects) -> Option<NodeError> {
        self.now = now;
        if let Some(inputs) = &mut self.inputs {
            inputs.advance(now, objects);
        }
        None
    }

    fn poll_timeout(&self, _event_driven: bool) -> Option<Instant> {
        self.inputs.as_ref()?.poll_timeout()
    }

    /// A lost heartbeat and an overdue RPDO set the outputs to their error value.
    fn react(&mut self, error: NodeError, objects: &mut Objects) {
        if [errors::HEARTBEAT.code, errors::RPDO_TIME_OUT.code].contains(&error.code) {
            self.fail_outputs(objects);
        }
    }

    fn faulted(&self) -> bool {
        false
    }

    fn end_connection(&mut self, objects: &mut Objects) -> Option<NodeError> {
        self.fail_outputs(objects);
        None
    }

    fn reset(&mut self, all: bool) {
        if let Some(outputs) = self.outputs.as_mut().filter(|_| all) {
            outputs.switch_off(self.now);
        }
    }

    fn start(&mut self, objects: &mut Objects) {
        if let Some(inputs) = &mut self.inputs {
            inputs.update(objects);
        }
        if let Some(outputs) = &mut self.outputs {
            outputs.start(self.now, objects);
        }
    }

    fn publish(&mut self, _objects: &mut Objects) {}

    fn synchronise(&mut self, _objects: &mut Objects, _now: Instant) {}

    fn apply(&mut self, marks: u8, objects: &mut Objects) -> Applied {
        if let Some(inputs) = self.inputs.as_mut().filter(|_| marks & INPUTS != 0) {
            inputs.update(objects);
        }
        if let Some(outputs) = &mut self.outputs {
            if marks & OUTPUTS != 0 {
                outputs.write(self.now, objects);
            } else if marks & SHAPE != 0 {
                outputs.update(self.now, objects);
            }
        }
        Applied::default()
    }
}
