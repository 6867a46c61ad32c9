//! Virtual sensors: readings for the image `V`, computed from what came over a wire.
//!
//! A [`VirtualSensor`] has no thread and does no input or output. It reads latest values of a device. One of three
//! [shells](Shell) decides when it works. [`Sensors`] is the bundle of one agent, with at most one sensor per type of
//! readings.
//!
//! Read [`VirtualSensor`] first, then [`DigitalInputs`] as an example.

mod digital;
mod jog;
mod operator;
#[cfg(test)]
mod tests;

use std::any::{Any, TypeId};
use std::time::Duration;

use can::Instant;

use crate::generator::{Message, Received, Sample, SensorReading};

pub use digital::DigitalInputs;
pub use jog::{JogCommand, JogHandle, JogPanel, JogReading};
pub use operator::{
    Asking, Operator, OperatorAnswer, OperatorCommand, OperatorError, OperatorLink, OperatorPanel, Question, Reaction,
};

/// A sensor as an agent sees it.
pub trait VirtualSensor: Send + 'static {
    /// The reading.
    type Reading: SensorReading;
    /// Command of a generator to the sensor (6). `()` for a sensor without commands.
    type Command: Message;

    /// Takes a command of a generator.
    fn configure(&mut self, _command: &Self::Command) {}

    /// Begins a reading at `now`. Not called by the shell [`Shell::NonInteractive`].
    fn initiate(&mut self, _now: Instant) {}

    /// The reading with the time of its measurement, once there is one.
    fn poll(&mut self, now: Instant) -> Option<(Instant, Self::Reading)>;
}

/// When a virtual sensor works.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shell {
    /// The sensor works by itself. Each step reads the latest reading.
    #[default]
    NonInteractive,
    /// Each step begins a reading for the next step. The next step waits for it.
    Interactive,
    /// Each step begins a reading for the next step. The next step takes the reading if it is there.
    InteractiveWithoutWait,
}

/// The virtual sensors of one agent.
#[derive(Default)]
pub struct Sensors(Vec<Box<dyn Installed>>);

/// A sensor in its shell.
trait Installed: Send {
    fn reading_type(&self) -> TypeId;
    /// The present [`Received`].
    fn received(&self) -> &dyn Any;
    fn age(&self) -> Option<Duration>;
    fn configure(&mut self, command: &dyn Any) -> bool;
    fn begin(&mut self);
    fn initiate(&mut self, now: Instant);
    fn poll(&mut self, now: Instant);
    fn is_ready(&self) -> bool;
}

struct Shelled<S: VirtualSensor> {
    sensor: S,
    shell: Shell,
    /// Period in macrosteps, and macrosteps left until the next reading.
    period: u16,
    left: u16,
    /// Whether a reading is awaited.
    awaited: bool,
    received: Received<S::Reading>,
    /// Whether a step has taken the last reading.
    seen: bool,
}

impl Sensors {
    /// Adds a sensor that is read every `period` macrosteps. Replaces a sensor with readings of the same type.
    pub fn install<S: VirtualSensor>(&mut self, sensor: S, shell: Shell, period: u16) {
        self.0.retain(|other| other.reading_type() != TypeId::of::<S::Reading>());
        let (received, left) = (Received::None, 0);
        self.0.push(Box::new(Shelled {
            sensor,
            shell,
            period: period.max(1),
            left,
            awaited: false,
            received,
            seen: false,
        }));
    }

    /// Begins an instruction. Readings of earlier instructions are forgotten.
    pub(crate) fn begin(&mut self) {
        self.0.iter_mut().for_each(|sensor| sensor.begin());
    }

    /// Begins the readings for the next step. The last readings count as seen.
    pub(crate) fn initiate(&mut self, now: Instant) {
        self.0.iter_mut().for_each(|sensor| sensor.initiate(now));
    }

    /// Takes readings, and updates their ages.
    pub(crate) fn poll(&mut self, now: Instant) {
        self.0.iter_mut().for_each(|sensor| sensor.poll(now));
    }

    /// Whether the next step need not wait.
    pub(crate) fn are_ready(&self) -> bool {
        self.0.iter().all(|sensor| sensor.is_ready())
    }

    /// What came from the sensor with readings of this type, as a [`Received`], and its age.
    pub(crate) fn reading(&self, reading: TypeId) -> Option<(&dyn Any, Option<Duration>)> {
        let sensor = self.0.iter().find(|sensor| sensor.reading_type() == reading)?;
        Some((sensor.received(), sensor.age()))
    }

    /// Passes a command to the sensor that takes it. Returns whether there is one.
    pub(crate) fn configure(&mut self, command: &dyn Any) -> bool {
        self.0.iter_mut().any(|sensor| sensor.configure(command))
    }
}

impl<S: VirtualSensor> Installed for Shelled<S> {
    fn reading_type(&self) -> TypeId {
        TypeId::of::<S::Reading>()
    }

    fn received(&self) -> &dyn Any {
        &self.received
    }

    fn age(&self) -> Option<Duration> {
        self.received.sample().map(|sample| sample.age)
    }

    fn configure(&mut self, command: &dyn Any) -> bool {
        command.downcast_ref().map(|command| self.sensor.configure(command)).is_some()
    }

    fn begin(&mut self) {
        (self.received, self.left, self.awaited) = (Received::None, 0, false);
    }

    fn initiate(&mut self, now: Instant) {
        self.seen = true;
        self.received = self.received.at(now, true);
        if self.left > 0 {
            self.left -= 1;
            return;
        }
        self.left = self.period - 1;
        if !self.awaited {
            self.awaited = true;
            if self.shell != Shell::NonInteractive {
                self.sensor.initiate(now);
            }
        }
    }

    fn poll(&mut self, now: Instant) {
        // A sensor that works by itself is read anew until the step, so that the step gets the latest reading.
        let reading = if self.awaited { self.sensor.poll(now) } else { None };
        if let Some((at, value)) = reading {
            let known = self.received.sample().is_some_and(|sample| sample.at == at);
            self.received = Received::New(Sample { at, age: now.since(at), value });
            self.seen &= known;
            self.awaited = self.shell == Shell::NonInteractive && self.left == 0;
        }
        self.received = self.received.at(now, self.seen);
    }

    fn is_ready(&self) -> bool {
        self.shell != Shell::Interactive || !self.awaited
    }
}

impl<T: Copy> Sample<T> {
    /// The same sample at time `now`.
    pub(crate) fn aged(self, now: Instant) -> Self {
        Self { age: now.since(self.at), ..self }
    }
}
