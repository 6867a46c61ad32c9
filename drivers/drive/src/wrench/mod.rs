//! Force/torque sensors: on a serial line of their own, and on a CAN bus beside drives.
//!
//! [`SerialWrenchSensor`] is a [`DriveGroup`](crate::DriveGroup) without axes, for a sensor that answers queries.
//! [`CanBus::with_sensors`](crate::bus::CanBus::with_sensors) takes one [`WrenchNodeConfig`] per sensor on a CAN bus.
//! Both give a [`WrenchLink`], from which a controller reads a [`WrenchState`] of each cycle and requests a zero.
//!
//! # Samples
//! - **Serial.** One query leaves at the deadline of each cycle, and the answer is read in the next cycle. The time of
//!   a sample is the time at which the query has arrived: one byte after it was sent. The answer has neither header nor
//!   checksum, so a reading counts if it has exactly the length of an answer. Anything else is garbage and counted.
//!   After a missing or damaged answer the next query waits until the line is quiet.
//! - **CAN.** A sample is one set of the configured TPDOs. With SYNC, the frames of a set belong to the same SYNC,
//!   whose time is that of the sample. With an event timer, they follow each other within half a sample, and the time
//!   is the receive time of the first frame. A counter of the sensor tells new samples from repeated ones.
//!
//! # Faults
//! A fault is latched until [`WrenchLink::reset_fault`] or the next bring-up. The wrench then stays that of the last
//! sample, and [`WrenchState::measured`] returns `None`. A reset takes effect with the next sample: an old
//! wrench never becomes valid again.
//!
//! | fault | condition |
//! |---|---|
//! | [`Silent`](WrenchFault::Silent) | more than the tolerated samples in a row are missing |
//! | [`Garbage`](WrenchFault::Garbage) | the same, and at least one reading among them was no answer |
//! | [`Saturated`](WrenchFault::Saturated) | counts at or beyond the range, in more than the tolerated samples in a row |
//! | [`OfAnotherRate`](WrenchFault::OfAnotherRate) | of 64 samples, the mean period differs from the declared one by more than a quarter; or answers come a cycle late |
//! | [`Status`](WrenchFault::Status) | an error bit of a status field |
//! | [`Line`](WrenchFault::Line), [`Port`](WrenchFault::Port) and the others | the line, the bus or the node failed |
//!
//! A saturated sample is never published as a wrench. The axes of a bus do not stop by a fault of a sensor: the law or
//! the task that reads the sensor stops them.
//!
//! # Zero
//! [`WrenchLink::zero`] makes the present load read as zero, by the mean of samples in the host or by the bias command
//! of the sensor ([`ZeroMethod`]). The zero includes the weight of the tool in its present pose. Compensation of weight
//! and inertia needs kinematics and is a part of the controller.
//!
//! # Bring-up
//! Bring-up ends when a sensor has answered in time (serial), or has sent samples at the declared rate (CAN). The bus
//! sends SYNC meanwhile if a sensor needs it; no drive is enabled. A sensor that is absent, silent, saturated, of
//! another type or of another rate ends bring-up with a [`WrenchError`].
//!
//! Rehearsals have no wire. [`RehearsedWrench`] stands in for a sensor there.
//!
//! Not supported: sensors that send gauge voltages, floating-point PDOs, and a reset of a node during operation.

mod config;
mod fault;
mod node;
mod node_config;
mod program;
mod rate;
mod rehearsed;
mod sampler;
mod serial;
mod serial_bring_up;
mod state;

#[cfg(test)]
mod tests;

pub use self::serial::SerialWrenchSensor;
pub use config::{Channel, ConfigError, SerialWrenchConfig, WrenchConfig, ZeroMethod};
pub use fault::{WrenchError, WrenchFault};
pub(crate) use node::WrenchNode;
pub use node_config::{Content, NodeQuantity, Trigger, WrenchField, WrenchNodeConfig, WrenchPdo, check};
pub(crate) use program::program;
pub use rehearsed::RehearsedWrench;
pub use sampler::WrenchCounters;
pub use state::{WrenchAxis, WrenchLink, WrenchState, ZeroRequest, Zeroing};
