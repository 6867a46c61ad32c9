//! Errors of the drive, beyond those of every node.

use canopen::emcy::ErrorRegister;

use crate::node::errors::{Error, Reaction, communication, error};

pub(super) const OVER_CURRENT: Error = error(0x2310, ErrorRegister::CURRENT, Reaction::Disable);
pub(super) const MOTOR_TEMPERATURE: Error = error(0x4380, ErrorRegister::TEMPERATURE, Reaction::Disable);
/// NMT stop or a reset of the communication, if object 0x6007 makes a fault of either.
pub(super) const CONNECTION_ENDED: Error = communication(0x8100);
pub(super) const FOLLOWING: Error = error(0x8611, ErrorRegister::VENDOR, Reaction::Fault);
pub(super) const NEGATIVE_LIMIT: Error = error(0x8A80, ErrorRegister::VENDOR, Reaction::Fault);
pub(super) const POSITIVE_LIMIT: Error = error(0x8A81, ErrorRegister::VENDOR, Reaction::Fault);
pub(super) const SOFTWARE_LIMIT: Error = error(0x8A82, ErrorRegister::VENDOR, Reaction::Fault);
