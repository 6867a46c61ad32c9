//! Virtual sensors: readings for the image `V`, computed from the data of devices.
//!
//! A [`VirtualSensor`] is a set of functions, which the agent calls in its own turn. The functions return at once: a sensor
//! has no thread and performs no input or output. The driver of a device exchanges frames in the servo cycle. The sensor
//! reads the latest values of the driver, and passes commands to the driver.
//!
//! [`Sensors`] are the virtual sensors of one agent. A [shell](Shell) decides for each sensor when the agent asks for a
//! reading:
//!
//! | shell | the agent asks for a reading | the next step |
//! |---|---|---|
//! | [`NonInteractive`](Shell::NonInteractive) | in every turn until the step | takes the latest reading |
//! | [`Interactive`](Shell::Interactive) | once, and polls | waits for the reading, and takes it |
//! | [`InteractiveWithoutWait`](Shell::InteractiveWithoutWait) | once, and polls | takes the reading if it is there |
//!
//! A sensor has a period in macrosteps. The first step of an instruction takes a reading, and then every `period`-th
//! step. The other steps receive the last reading as [`Received::Old`]. A reading is [`Received::New`] until a step has
//! taken the reading.
//!
//! Within one agent, each type of readings and each type of commands belongs to one sensor. [`VirtualSensor::marked`] gives
//! its own types to a second sensor of the same kind.
//!
//! Read [`VirtualSensor`] first, then [`DigitalInputs`] as an example.

mod camera;
mod digital;
mod force;
mod gates;
mod jog;
mod marked;
mod operator;
mod payload;
#[cfg(test)]
mod tests;
mod ultrasonic;
mod zeroed_weight;

use std::any::{Any, TypeId, type_name};
use std::cell::Cell;
use std::sync::{Mutex, MutexGuard, TryLockError};
use std::time::Duration;

use can::Instant;
use thiserror::Error;

use crate::generator::{EffectorImage, GeneratorError, Message, Partners, Received, Sample, SensorReading};

pub use camera::{
    Blob, BlobFinder, BlobPlace, BlobReading, BlobSearch, LEAST_AREA, LEAST_CONTRAST, Pinhole, SightError, ViewedPlane,
};
pub use digital::DigitalInputs;
pub use force::{ForceError, ForceReading, ForceSensorConfig, ForceTorque};
pub use gates::{
    GateError, GateLine, GateReading, GatesRefused, LightGates, LightGatesConfig, MAX_GATES, MAX_OBJECTS, Passage,
    Travel,
};
pub use jog::{JogCommand, JogHandle, JogPanel, JogReading};
pub use marked::Marked;
pub use operator::{
    Asking, Operator, OperatorAnswer, OperatorCommand, OperatorError, OperatorLink, OperatorPanel, OperatorTexts,
    Question, Reaction,
};
pub use payload::Payload;
pub use ultrasonic::{BoxLocator, BoxPlace, BoxReading, EchoError, MOST_SCANS, MatrixConfig};
pub use zeroed_weight::ZeroedWeight;

/// A sensor as an agent sees it.
pub trait VirtualSensor: Send + 'static {
    /// Type of the readings.
    type Reading: SensorReading;
    /// Command of a generator to the sensor (6). `()` for a sensor without commands.
    type Command: Message;

    /// Takes a command of a generator.
    fn configure(&mut self, _command: &Self::Command) {}

    /// Begins a reading at `now`. Not called by the shell [`Shell::NonInteractive`].
    fn initiate(&mut self, _now: Instant) {}

    /// The reading with the time of its measurement; `None` as long as the sensor has no reading. Must not wait.
    fn poll(&mut self, now: Instant) -> Option<(Instant, Self::Reading)>;

    /// The same sensor with readings and commands of the types [`Marked<_, M>`](Marked), for an agent that has two
    /// sensors of one kind.
    fn marked<M: 'static>(self) -> Marked<Self, M>
    where
        Self: Sized,
    {
        Marked::new(self)
    }
}

/// When the agent asks a virtual sensor for a reading. See the table of the [module](self).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shell {
    /// The sensor works by itself. A step takes the latest reading.
    #[default]
    NonInteractive,
    /// A step begins a reading for a later step, which waits for the reading.
    Interactive,
    /// A step begins a reading for a later step, which takes the reading if it is there.
    InteractiveWithoutWait,
}

/// Reasons why an agent refuses a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum SensorRefused {
    /// Another sensor of the agent has readings of the same type.
    #[error("the agent already has a sensor with readings of type {reading}: mark one of them, or remove the first")]
    SameReading {
        /// Name of the type.
        reading: &'static str,
    },
    /// Another sensor of the agent takes commands of the same type.
    #[error("the agent already has a sensor with commands of type {command}: mark one of them, or remove the first")]
    SameCommand {
        /// Name of the type.
        command: &'static str,
    },
}

/// The virtual sensors of one agent, at most one per type of readings.
///
/// The agent calls `begin` for an instruction. For each step, the agent calls `initiate`, then `poll` in every turn,
/// `is_ready` for each declared reading before the step, and `reading` in the step. `now` is the time of the last servo
/// cycle.
#[derive(Default)]
pub struct Sensors(Vec<Box<dyn Installed>>);

/// A sensor in its shell.
trait Installed: Send {
    fn reading_type(&self) -> TypeId;
    fn command_type(&self) -> TypeId;
    /// The present [`Received`], which a step takes.
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
    taken: Cell<bool>,
}

impl Sensors {
    /// Adds a sensor whose readings are taken every `period` macrosteps. A period of 0 counts as 1. Refuses a sensor
    /// with readings or commands of the same type as another one.
    pub fn install<S: VirtualSensor>(&mut self, sensor: S, shell: Shell, period: u16) -> Result<(), SensorRefused> {
        if self.provides(TypeId::of::<S::Reading>()) {
            return Err(SensorRefused::SameReading { reading: type_name::<S::Reading>() });
        }
        let command = TypeId::of::<S::Command>();
        if command != TypeId::of::<()>() && self.0.iter().any(|other| other.command_type() == command) {
            return Err(SensorRefused::SameCommand { command: type_name::<S::Command>() });
        }
        let (received, taken) = (Received::None, Cell::new(false));
        let period = period.max(1);
        self.0.push(Box::new(Shelled { sensor, shell, period, left: 0, awaited: false, received, taken }));
        Ok(())
    }

    /// Removes the sensor with readings of type `R`. Returns whether there was one.
    pub fn remove<R: SensorReading>(&mut self) -> bool {
        let before = self.0.len();
        self.0.retain(|sensor| sensor.reading_type() != TypeId::of::<R>());
        self.0.len() < before
    }

    /// Begins an instruction. Readings of earlier instructions are forgotten.
    pub(crate) fn begin(&mut self) {
        self.0.iter_mut().for_each(|sensor| sensor.begin());
    }

    /// Begins the readings for the next step.
    pub(crate) fn initiate(&mut self, now: Instant) {
        self.0.iter_mut().for_each(|sensor| sensor.initiate(now));
    }

    /// Receives readings, and updates their ages.
    pub(crate) fn poll(&mut self, now: Instant) {
        self.0.iter_mut().for_each(|sensor| sensor.poll(now));
    }

    /// Whether the next step need not wait for readings of this type. A step does not wait for a sensor that is missing.
    pub(crate) fn is_ready(&self, reading: TypeId) -> bool {
        self.0.iter().all(|sensor| sensor.reading_type() != reading || sensor.is_ready())
    }

    /// Whether a sensor has readings of this type.
    pub(crate) fn provides(&self, reading: TypeId) -> bool {
        self.0.iter().any(|sensor| sensor.reading_type() == reading)
    }

    /// The [`Received`] from the sensor with readings of this type, and its age.
    pub(crate) fn reading(&self, reading: TypeId) -> Option<(&dyn Any, Option<Duration>)> {
        let sensor = self.0.iter().find(|sensor| sensor.reading_type() == reading)?;
        Some((sensor.received(), sensor.age()))
    }

    /// Passes a command to the sensor with commands of this type. Returns whether the agent has such a sensor.
    pub(crate) fn configure(&mut self, command: &dyn Any) -> bool {
        self.0.iter_mut().any(|sensor| sensor.configure(command))
    }
}

/// Partners that provide only the readings for which a step need not wait. A step waits until these partners provide
/// every image that the step declares ([`Images::require`](crate::generator::Images::require)).
pub(crate) struct Prompt<'a>(pub(crate) &'a Sensors);

impl Partners for Prompt<'_> {
    fn effector(&self) -> Result<EffectorImage, GeneratorError> {
        Err(GeneratorError::NoEffector)
    }

    fn gives_readings(&self, reading: TypeId) -> bool {
        self.0.is_ready(reading)
    }

    fn gives_orders(&self, _: TypeId) -> bool {
        true
    }
}

impl<S: VirtualSensor> Installed for Shelled<S> {
    fn reading_type(&self) -> TypeId {
        TypeId::of::<S::Reading>()
    }

    fn command_type(&self) -> TypeId {
        TypeId::of::<S::Command>()
    }

    fn received(&self) -> &dyn Any {
        self.taken.set(true);
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
        self.received = self.received.at(now, self.taken.get());
        let due = self.left == 0;
        self.left = if due { self.period } else { self.left } - 1;
        if self.shell == Shell::NonInteractive {
            self.awaited = due;
        } else if due && !self.awaited {
            self.awaited = true;
            self.sensor.initiate(now);
        }
    }

    fn poll(&mut self, now: Instant) {
        let reading = if self.awaited { self.sensor.poll(now) } else { None };
        if let Some((at, value)) = reading {
            let known = self.received.sample().is_some_and(|sample| sample.at == at);
            self.received = Received::New(Sample { at, age: now.since(at), value });
            *self.taken.get_mut() &= known;
            // A non-interactive sensor is read again in every turn until the step.
            self.awaited = self.shell == Shell::NonInteractive;
        }
        self.received = self.received.at(now, self.taken.get());
    }

    fn is_ready(&self) -> bool {
        self.shell != Shell::Interactive || !self.awaited
    }
}

/// The value of a mutex; `None` while another thread has the value. A step waits for no other thread.
fn try_lock<T>(mutex: &Mutex<T>) -> Option<MutexGuard<'_, T>> {
    match mutex.try_lock() {
        Ok(guard) => Some(guard),
        Err(TryLockError::Poisoned(poisoned)) => Some(poisoned.into_inner()),
        Err(TryLockError::WouldBlock) => None,
    }
}

impl<T: Copy> Sample<T> {
    /// The same sample at time `now`.
    pub(crate) fn aged(self, now: Instant) -> Self {
        Self { age: now.since(self.at), ..self }
    }
}
