//! Digital inputs and outputs of an I/O node as a virtual sensor.

use can::Instant;
use drive::cia401::{InputImage, LatestInputs, OutputCommand};

use super::VirtualSensor;
use crate::generator::SensorReading;

impl SensorReading for InputImage {}

/// The inputs of an I/O node. A command is a level for each output: output *n* in bit *n*.
///
/// The reading is the image of the inputs in the last cycle, with any fault of the node. Edges have the receive times of
/// their frames. The age of the reading is the time since the last frame of the node.
pub struct DigitalInputs {
    inputs: LatestInputs,
    outputs: OutputCommand,
}

impl DigitalInputs {
    /// A sensor that reads `inputs` and commands `outputs`, the ends of a link to the node.
    pub fn new(inputs: LatestInputs, outputs: OutputCommand) -> Self {
        Self { inputs, outputs }
    }
}

impl VirtualSensor for DigitalInputs {
    type Reading = InputImage;
    type Command = u64;

    fn configure(&mut self, levels: &u64) {
        self.outputs.set_all(*levels);
    }

    fn poll(&mut self, _: Instant) -> Option<(Instant, InputImage)> {
        let image = self.inputs.read();
        Some((image.heard, image))
    }
}
