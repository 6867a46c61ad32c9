//! Faults of an I/O node, and their form in the words of an image.

use std::time::Duration;

use can::{PortError, counted};
use canopen::Object;
use thiserror::Error;

use crate::bus::Sign;

/// A latched condition of an I/O node. [`IoLink::reset_fault`](super::IoLink::reset_fault) and the next bring-up clear
/// the fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum IoFault {
    /// Bring-up has not ended.
    #[error("node {node}: I/O not started")]
    NotStarted { node: u8 },
    /// The owner of the bus was dropped. The node hears no heartbeat of the host any more, and its outputs take their
    /// error state.
    #[error("node {node}: I/O ended, the bus has no controller any more")]
    Ended { node: u8 },
    /// The node sent no TPDO 1 for three event timers.
    #[error("node {node}: no inputs for {waited:.1?}")]
    InputsSilent { node: u8, waited: Duration },
    #[error("node {node}: no heartbeat for {waited:.1?}")]
    HeartbeatLost { node: u8, waited: Duration },
    /// The node booted again, or left NMT state operational. A node enters the state stopped when it hears no heartbeat
    /// of the host.
    #[error("node {node}: left operational state")]
    LeftOperational { node: u8 },
    /// A reset of the fault failed: the node did not boot, did not start, or sent no inputs.
    #[error("node {node}: reset failed: not back in operation after {waited:.1?}")]
    NotBack { node: u8, waited: Duration },
    /// A reset of the fault failed: the node did not answer for this object, refused it, or has another value. The
    /// [error](crate::BringUpError) of a bring-up has the details.
    #[error("node {node}: reset failed at object {object}")]
    NotConfigured { node: u8, object: Object },
    /// The port refused RPDO 1 for more cycles than the cell tolerates. The outputs have old levels.
    #[error("node {node}: outputs not taken by the bus for {}", counted(*.cycles, "cycle"))]
    OutputsNotSent { node: u8, cycles: u32 },
    /// The port took no heartbeat of the host for longer than the nodes wait for it.
    #[error("bus: the host's heartbeat was not sent for {waited:.1?}")]
    HeartbeatNotSent { waited: Duration },
    /// Another controller may command the outputs.
    #[error("bus: another controller is at work: it sent {sign}")]
    OtherController { sign: Sign },
    #[error("bus: {0}")]
    Port(PortError),
    /// The host's CAN controller counted too many errors and left the bus.
    #[error("bus: the controller is bus-off")]
    BusOff,
}

/// A fault as two words: its kind with the node in the second byte, and its time or number. No fault is kind 0.
pub(super) fn words(fault: Option<IoFault>) -> (u64, u64) {
    let nanos = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
    let Some(fault) = fault else { return (0, 0) };
    let (kind, node, value) = match fault {
        IoFault::NotStarted { node } => (1, node, 0),
        IoFault::Ended { node } => (2, node, 0),
        IoFault::InputsSilent { node, waited } => (3, node, nanos(waited)),
        IoFault::HeartbeatLost { node, waited } => (4, node, nanos(waited)),
        IoFault::LeftOperational { node } => (5, node, 0),
        IoFault::OutputsNotSent { node, cycles } => (6, node, u64::from(cycles)),
        IoFault::HeartbeatNotSent { waited } => (7, 0, nanos(waited)),
        IoFault::OtherController { sign: Sign::Sync } => (8, 0, 0),
        IoFault::OtherController { sign: Sign::Heartbeat { node } } => (8, node, 1),
        IoFault::OtherController { sign: Sign::Setpoint { node } } => (8, node, 2),
        IoFault::OtherController { sign: Sign::Write { node } } => (8, node, 3),
        IoFault::Port(PortError::Down) => (9, 0, 0),
        IoFault::Port(PortError::Gone) => (9, 0, 1),
        IoFault::Port(PortError::Os(errno)) => (10, 0, u64::from(errno.cast_unsigned())),
        IoFault::BusOff => (11, 0, 0),
        IoFault::NotBack { node, waited } => (12, node, nanos(waited)),
        IoFault::NotConfigured { node, object } => {
            (13, node, u64::from(object.index) << 8 | u64::from(object.subindex))
        }
    };
    (kind | u64::from(node) << 8, value)
}

/// The fault of two words of [`words`].
pub(super) fn of_words(word: u64, value: u64) -> Option<IoFault> {
    let (node, waited) = ((word >> 8) as u8, Duration::from_nanos(value));
    Some(match word as u8 {
        0 => return None,
        2 => IoFault::Ended { node },
        3 => IoFault::InputsSilent { node, waited },
        4 => IoFault::HeartbeatLost { node, waited },
        5 => IoFault::LeftOperational { node },
        6 => IoFault::OutputsNotSent { node, cycles: value as u32 },
        7 => IoFault::HeartbeatNotSent { waited },
        8 => IoFault::OtherController {
            sign: match value {
                0 => Sign::Sync,
                1 => Sign::Heartbeat { node },
                2 => Sign::Setpoint { node },
                _ => Sign::Write { node },
            },
        },
        9 => IoFault::Port(if value == 0 { PortError::Down } else { PortError::Gone }),
        10 => IoFault::Port(PortError::Os((value as u32).cast_signed())),
        11 => IoFault::BusOff,
        12 => IoFault::NotBack { node, waited },
        13 => IoFault::NotConfigured { node, object: Object::new((value >> 8) as u16, value as u8) },
        _ => IoFault::NotStarted { node },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_survives_its_two_words() {
        let (node, waited) = (5, Duration::from_micros(150_001));
        let faults = [
            IoFault::NotStarted { node },
            IoFault::Ended { node },
            IoFault::InputsSilent { node, waited },
            IoFault::HeartbeatLost { node, waited },
            IoFault::LeftOperational { node },
            IoFault::OutputsNotSent { node, cycles: u32::MAX },
            IoFault::NotBack { node, waited },
            IoFault::NotConfigured { node, object: Object::new(0x6207, 8) },
            IoFault::HeartbeatNotSent { waited },
            IoFault::OtherController { sign: Sign::Sync },
            IoFault::OtherController { sign: Sign::Heartbeat { node } },
            IoFault::OtherController { sign: Sign::Setpoint { node } },
            IoFault::OtherController { sign: Sign::Write { node } },
            IoFault::Port(PortError::Down),
            IoFault::Port(PortError::Gone),
            IoFault::Port(PortError::Os(-1)),
            IoFault::Port(PortError::Os(105)),
            IoFault::BusOff,
        ];
        for fault in faults.map(Some).into_iter().chain([None]) {
            let (word, value) = words(fault);
            assert_eq!(of_words(word, value), fault);
        }
    }
}
