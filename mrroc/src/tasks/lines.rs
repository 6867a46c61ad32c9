//! Digital inputs and outputs of a cell, as a task sees them.

use controller::sensor::DigitalInputs;
use drive::cia401::{Input, IoFault, IoLink};

/// A digital input of an I/O node.
#[derive(Clone, Debug)]
pub struct InputLine {
    link: IoLink,
    line: u8,
}

/// A digital output of an I/O node.
#[derive(Clone, Debug)]
pub struct OutputLine {
    link: IoLink,
    line: u8,
}

impl InputLine {
    pub(super) fn new(link: IoLink, line: u8) -> Self {
        Self { link, line }
    }

    /// Number of the input in its node. Generators find the input by this number in the reading of the
    /// [`sensor`](Self::sensor).
    pub fn number(&self) -> u8 {
        self.line
    }

    /// Level and edges of the input in the last servo cycle; `None` while the node has a fault.
    pub fn read(&self) -> Option<Input> {
        self.link.inputs.read().input(self.line)
    }

    /// The fault of the node in the last servo cycle.
    pub fn fault(&self) -> Option<IoFault> {
        self.link.inputs.read().fault
    }

    /// Requests a reset of the fault of the node, and does not wait. See [`IoLink::reset_fault`].
    pub fn reset_fault(&self) {
        self.link.reset_fault();
    }

    /// A virtual sensor with all inputs of the node. For two nodes, [mark](controller::sensor::VirtualSensor::marked)
    /// the sensor of each node.
    pub fn sensor(&self) -> DigitalInputs {
        DigitalInputs::new(self.link.inputs.clone(), self.link.outputs.clone())
    }
}

impl OutputLine {
    pub(super) fn new(link: IoLink, line: u8) -> Self {
        Self { link, line }
    }

    /// Number of the output in its node: the bit of its level in a command ([`Tell`](controller::generator::Tell)) of a
    /// generator to the sensor of the node.
    pub fn number(&self) -> u8 {
        self.line
    }

    /// Commands the level of the output. The next servo cycle sends the command.
    pub fn set(&self, level: bool) {
        self.link.outputs.set(self.line, level);
    }

    /// The fault of the node in the last servo cycle. The outputs of a node with a fault have their error state.
    pub fn fault(&self) -> Option<IoFault> {
        self.link.inputs.read().fault
    }

    /// Requests a reset of the fault of the node, and does not wait. See [`IoLink::reset_fault`].
    pub fn reset_fault(&self) {
        self.link.reset_fault();
    }
}
