//! Force/torque sensors: on a serial line of their own, and on a CAN bus beside drives.
//!
//! [`SerialWrenchSensor`] is a [`DriveGroup`](crate::DriveGroup) without axes, for a sensor that answers queries.
//! [`CanBus::with_sensors`](crate::bus::CanBus::with_sensors) takes one [`WrenchNodeConfig`] per sensor on a CAN bus.
//! Both return a [`WrenchLink`]. Through this link a controller reads the [`WrenchState`] of each cycle and requests a
//! zero.
//!
//! # Samples
//! - **Serial.** One query leaves at the deadline of each cycle, and the answer is read in the next cycle. The time of
//!   a sample is the arrival time of its query: one byte time after the write. The answer has neither header nor
//!   checksum, so a reading counts if it has exactly the length of an answer. Any other reading is counted as garbage.
//!   After a missing or damaged answer the next query waits until the line is quiet. An answer up to two periods late is
//!   therefore recognised and dropped. A later answer can be taken for the answer to the next query. The following
//!   reading then has no whole answer: the sample counts as missing after all, and a fault follows as if no sample had
//!   come since the last answer in time. Only a single answer more than two periods late, followed by answers between
//!   one and two periods late, is not detected. The time of such samples is one period too late.
//! - **CAN.** A sample is one set of the configured TPDOs. With SYNC, the frames of a set belong to the same SYNC, and
//!   the time of the sample is the time of this SYNC. A frame that comes after the next SYNC makes its sample incomplete:
//!   a sample never has a frame of another SYNC. If not every frame has a counter, the driver detects such a frame by
//!   the order of the frames after a SYNC that lacked a frame. With an event timer, the frames of a set are received
//!   within half a sample period, and the time of the sample is the receive time of the first frame. A counter of the
//!   sensor distinguishes new samples from repeated samples.
//!
//! # Faults
//! A fault is latched until [`WrenchLink::reset_fault`] or the next bring-up. During a fault the state keeps the wrench
//! of the last sample, and [`WrenchState::measured`] returns `None`. A requested reset takes effect with the next sample:
//! an old wrench never becomes valid again.
//!
//! | fault | condition |
//! |---|---|
//! | [`Silent`](WrenchFault::Silent) | more than the tolerated samples in a row are missing |
//! | [`Garbage`](WrenchFault::Garbage) | the same, and at least one reading among them was no answer |
//! | [`Incomplete`](WrenchFault::Incomplete) | as `Silent`, on CAN; at least one of the samples lacked a frame |
//! | [`Saturated`](WrenchFault::Saturated) | counts at or beyond the range, in more than the tolerated samples in a row |
//! | [`OfAnotherRate`](WrenchFault::OfAnotherRate) | of 64 samples, the mean period differs from the declared one by more than a quarter; or answers come a cycle late |
//! | [`Missing`](WrenchFault::Missing) | as `OfAnotherRate`, but most samples came at the declared rate |
//! | [`Status`](WrenchFault::Status) | an error bit of a status field |
//! | [`Line`](WrenchFault::Line), [`Port`](WrenchFault::Port) and the others | the line, the bus or the node failed |
//!
//! A saturated sample is never published as a wrench. A fault of a sensor does not stop the axes of its bus: the
//! control law or the task that reads the sensor must stop them.
//!
//! # Zero
//! After [`WrenchLink::zero`], the present load reads as zero. The zero is a mean of samples in the host, or the bias
//! command of the sensor ([`ZeroMethod`]). A zeroing fails if its samples differ by more than a tenth of the range, or
//! if the sensor reads more than a tenth of the range after its bias command ([`ZeroFailure`]). The zero includes the
//! weight of the tool in its present pose. Compensation of weight and inertia needs kinematics and is done by the
//! controller.
//!
//! # Bring-up
//! On a serial line, bring-up ends after eight answers, most of them within a period. On CAN, bring-up ends when the
//! sensor has sent samples at the declared rate. During bring-up the bus sends SYNC if a sensor needs SYNC; no drive is
//! enabled. A sensor that is absent, silent, saturated, of another type or of another rate ends bring-up with a
//! [`WrenchError`].
//!
//! A rehearsal has no wire: [`RehearsedWrench`] replaces the sensor.
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
pub use node_config::{Content, NodeQuantity, Trigger, WrenchField, WrenchNodeConfig, WrenchPdo, check, reserved};
pub(crate) use program::program;
pub use rehearsed::RehearsedWrench;
pub use sampler::{WrenchCounters, ZERO_SCATTER};
pub use state::{WrenchAxis, WrenchLink, WrenchState, ZeroFailure, ZeroRequest, Zeroing};
