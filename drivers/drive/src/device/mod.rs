//! Devices whose kind another crate adds, for example a sensor with a protocol of its own.
//!
//! A kind declares its values ([`DeviceValue`]) and its line ([`LineConfig`]), and encodes and decodes its telegrams
//! ([`LineDriver`]). [`DeviceOnLine`] is the drive group of every kind, and handles bring-up, intervals, time-outs,
//! lost and torn answers, ranges of values and faults. The controller reads the device through its [`DeviceLink`].
//! [`DeviceSamples`] carries each sample to the files of a run. Link and samples do not depend on the line.
//!
//! # The cycle
//! A cycle reads once, and writes a query if the last exchange has ended and the interval of the device has passed. A
//! query without a valid answer within its time is lost. The next query then waits until the line was quiet for twice
//! that time, so that a late answer is not taken for the answer to another query. A driver whose answers carry the
//! number of their query compares the number, and the line needs one reading without bytes ([`LineConfig::numbered`]).
//! Without numbers, one reading without bytes precedes each query, so that a repeated answer is not taken for the answer
//! to the next query. A copy that comes after that reading cannot be told from the answer.
//!
//! A device without queries sends by itself: its samples have a time limit too, and one is missing per interval. Samples
//! of the time before bring-up, before the first cycle or before a reset are dropped.
//!
//! # Faults
//! A fault is latched until [`DeviceLink::reset_fault`] or the next bring-up. During a fault the state keeps the last
//! sample, and [`DeviceState::measured`] returns `None`. A requested reset takes effect with the next valid sample.
//!
//! | fault | condition |
//! |---|---|
//! | [`Silent`](DeviceFault::Silent) | more than the tolerated samples in a row are missing |
//! | [`Garbage`](DeviceFault::Garbage) | the same, and at least one reading among them was no valid answer |
//! | [`Refused`](DeviceFault::Refused) | the device refused a query |
//! | [`Line`](DeviceFault::Line) | the line failed |
//!
//! A fault of a device does not stop any axis: the task that reads the device must stop the axes.
//!
//! # Bring-up
//! Bring-up ends with the first valid sample. A device that is absent, sends garbage or refuses the query ends bring-up
//! with a [`DeviceError`].
//!
//! A rehearsal has no wire: [`RehearsedDevice`] replaces the device.

mod driver;
mod fault;
mod group;
mod rehearsed;
mod state;
#[cfg(test)]
mod tests;
mod value;

pub use driver::{LineConfig, LineDriver, MOST_QUERY, Reception};
pub use fault::{DeviceError, DeviceFault};
pub use group::{DeviceConfig, DeviceConfigError, DeviceCounters, DeviceOnLine, OpenedDevice};
pub use rehearsed::RehearsedDevice;
pub use state::{DeviceLink, DeviceSample, DeviceSamples, DeviceState};
pub use value::{DeviceValue, MOST_VALUES, count_of, names_of};
