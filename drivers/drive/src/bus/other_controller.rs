//! Detection of a second controller on the bus.
//!
//! Drives follow SYNC and set-points from any sender, and accept any heartbeat under the host's node-ID. NMT commands
//! and service requests are not signs of a second controller, because service tools may send them beside a controller.

use can::Frame;
use canopen::{NodeId, cob};
use thiserror::Error;

/// A received frame that only the controller of a bus sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum Sign {
    /// SYNC.
    #[error("SYNC")]
    Sync,
    /// The heartbeat of the host's own node-ID.
    #[error("the heartbeat of node {node}")]
    Heartbeat { node: u8 },
    /// An RPDO of one of our nodes.
    #[error("a set-point of node {node}")]
    Setpoint { node: u8 },
}

impl Sign {
    /// The sign in a received frame, if any. `host` is the host's node-ID, and `is_ours`
    /// returns whether a node is a drive or an I/O node of the bus.
    pub(crate) fn of(frame: &Frame, host: NodeId, is_ours: impl FnOnce(NodeId) -> bool) -> Option<Self> {
        match cob::Function::of(frame.standard_data_id()?)? {
            cob::Function::Sync => Some(Self::Sync),
            cob::Function::Heartbeat(node) if node == host => Some(Self::Heartbeat { node: node.raw() }),
            cob::Function::Rpdo(_, node) if is_ours(node) => Some(Self::Setpoint { node: node.raw() }),
            cob::Function::Heartbeat(_)
            | cob::Function::Rpdo(..)
            | cob::Function::Nmt
            | cob::Function::Emcy(_)
            | cob::Function::Time
            | cob::Function::Tpdo(..)
            | cob::Function::SdoResponse(_)
            | cob::Function::SdoRequest(_) => None,
        }
    }
}
