//! Several sensors of the same kind, distinguished by a type.

use std::fmt::{self, Debug, Formatter};
use std::marker::PhantomData;
use std::ops::Deref;

use can::Instant;

use super::VirtualSensor;
use crate::generator::SensorReading;

/// A sensor, a reading or a command, marked with the type `M`. `M` is any type of the user, and no value of `M` is stored.
///
/// ```
/// use drive::cia401::InputImage;
/// use mrroc_controller::generator::{Tell, V};
/// use mrroc_controller::sensor::Marked;
///
/// enum Probe {}
/// enum Gate {}
///
/// /// Images of a generator that reads two I/O nodes.
/// type Inputs = V<(Marked<InputImage, Probe>, Marked<InputImage, Gate>)>;
///
/// /// A command to the outputs of the node of the gate.
/// let open: Tell<Marked<u64, Gate>> = Tell(Marked::new(0b1));
/// ```
pub struct Marked<T, M> {
    value: T,
    marker: PhantomData<fn() -> M>,
}

impl<T, M> Marked<T, M> {
    /// Marks a value. [`VirtualSensor::marked`] marks a sensor.
    pub const fn new(value: T) -> Self {
        Self { value, marker: PhantomData }
    }
}

impl<T, M> Deref for Marked<T, M> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

// Derived traits would require the same traits of the marker.
impl<T: Copy, M> Copy for Marked<T, M> {}

impl<T: Copy, M> Clone for Marked<T, M> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T: Debug, M> Debug for Marked<T, M> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        self.value.fmt(f)
    }
}

impl<T: PartialEq, M> PartialEq for Marked<T, M> {
    fn eq(&self, other: &Self) -> bool {
        self.value == other.value
    }
}

impl<R: SensorReading, M: 'static> SensorReading for Marked<R, M> {}

impl<S: VirtualSensor, M: 'static> VirtualSensor for Marked<S, M> {
    type Reading = Marked<S::Reading, M>;
    type Command = Marked<S::Command, M>;

    fn configure(&mut self, command: &Self::Command) {
        self.value.configure(command);
    }

    fn initiate(&mut self, now: Instant) {
        self.value.initiate(now);
    }

    fn poll(&mut self, now: Instant) -> Option<(Instant, Self::Reading)> {
        self.value.poll(now).map(|(at, reading)| (at, Marked::new(reading)))
    }
}
