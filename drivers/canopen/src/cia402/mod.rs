//! Drives (CiA 402-2, IEC 61800-7-201): controlword, statusword, power states, modes, homing and fault codes.
//!
//! Read [`Statusword`] first. Deviations of EPOS2 are tolerated, and stated at the item concerned.

mod fault_codes;
mod homing;
mod mode;
mod word;

pub use fault_codes::{FaultTable, questions_position};
pub use homing::{HomingMethod, HomingStatus, References};
pub use mode::{ModeOfOperation, SupportedModes};
pub use word::{Controlword, PowerCommand, PowerState, Statusword};
