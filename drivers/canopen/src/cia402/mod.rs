//! CiA 402 (IEC 61800-7-201): drives. The two words, power states, modes, homing and fault codes.
//!
//! Read [`Statusword`] and [`power`] first. What EPOS2 does differently is tolerated and said
//! where it matters.

mod fault_codes;
mod homing;
mod mode;
mod word;

pub use fault_codes::FaultTable;
pub use homing::{HomingMethod, HomingStatus, References};
pub use mode::{ModeOfOperation, SupportedModes};
pub use word::{Controlword, PowerCommand, PowerState, Statusword};
