//! The jog panel: velocities that an operator commands, as a virtual sensor.

use can::Instant;
use drive::latest::{Latest, Publisher, latest};
use nalgebra::Vector3;
use servo::MAX_AXES;

use super::VirtualSensor;
use crate::generator::{Axes, GeneratorError, SensorReading};

/// Number, kind and values of a command.
const WORDS: usize = 2 + MAX_AXES;

/// Kinds of a command. Any other number is read as the end.
const JOINTS: u64 = 1;
const TOOL: u64 = 2;
const END: u64 = 3;

/// Command of an operator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JogCommand {
    /// Velocities of the joints, rad/s, or m/s for a linear joint.
    Joints(Axes),
    /// Velocity of the tool in its own frame.
    Tool {
        /// Velocity of the tool's origin, m/s.
        linear: Vector3<f64>,
        /// Angular velocity, rad/s.
        angular: Vector3<f64>,
    },
    /// Brakes, and ends the motion.
    End,
}

/// Reading of a [`JogPanel`]. Its time is the servo cycle in which the command was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JogReading {
    /// Number of the command, from 1; 0 before the first command, with zero velocities.
    pub number: u64,
    /// The latest command.
    pub command: JogCommand,
}

impl SensorReading for JogReading {}

/// The operator's end of a [`JogPanel`]. Dropping the handle commands [`JogCommand::End`].
#[derive(Debug)]
pub struct JogHandle {
    publisher: Publisher<WORDS>,
    number: u64,
}

impl JogHandle {
    /// Replaces the present command. The command is valid for the dead-man time of the
    /// [`Jog`](crate::generator::Jog): repeat the command to continue the motion. Refuses values that are not finite. The
    /// call neither waits nor allocates.
    pub fn command(&mut self, command: JogCommand) -> Result<(), GeneratorError> {
        let (kind, values) = match command {
            JogCommand::Joints(velocity) => (JOINTS, velocity),
            JogCommand::Tool { linear, angular } => {
                (TOOL, [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z, 0.0, 0.0])
            }
            JogCommand::End => (END, Axes::default()),
        };
        if let Some(axis) = values.iter().position(|value| !value.is_finite()) {
            return Err(GeneratorError::NotFinite { pose: 0, axis: axis as u8 });
        }
        self.number += 1;
        let mut words = [self.number, kind, 0, 0, 0, 0, 0, 0, 0, 0];
        for (word, value) in words[2..].iter_mut().zip(values) {
            *word = value.to_bits();
        }
        self.publisher.publish(&words);
        Ok(())
    }
}

impl Drop for JogHandle {
    fn drop(&mut self) {
        let _ = self.command(JogCommand::End);
    }
}

/// Virtual sensor whose reading is the latest command of a [`JogHandle`]. Install the sensor with
/// [`Shell::NonInteractive`](super::Shell::NonInteractive) and a period of one macrostep.
#[derive(Debug)]
pub struct JogPanel {
    commands: Latest<WORDS>,
    /// Number of the last command, and the time at which the command was found.
    found: Option<(u64, Instant)>,
}

impl JogPanel {
    /// A panel, and the handle of its operator.
    pub fn new() -> (Self, JogHandle) {
        let (publisher, commands) = latest([0; WORDS]);
        (Self { commands, found: None }, JogHandle { publisher, number: 0 })
    }
}

impl VirtualSensor for JogPanel {
    type Reading = JogReading;
    type Command = ();

    fn poll(&mut self, now: Instant) -> Option<(Instant, JogReading)> {
        let [number, kind, values @ ..] = self.commands.read();
        let values = values.map(f64::from_bits);
        let command = match kind {
            JOINTS => JogCommand::Joints(values),
            TOOL => {
                let [x, y, z, around_x, around_y, around_z, ..] = values;
                let angular = Vector3::new(around_x, around_y, around_z);
                JogCommand::Tool { linear: Vector3::new(x, y, z), angular }
            }
            _ if number == 0 => JogCommand::Joints(Axes::default()),
            _ => JogCommand::End,
        };
        let known = self.found.filter(|(known, _)| *known == number);
        let (_, at) = *self.found.insert(known.unwrap_or((number, now)));
        Some((at, JogReading { number, command }))
    }
}
