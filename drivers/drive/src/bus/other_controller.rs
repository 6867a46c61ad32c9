//! Detection of a second controller on the bus.
//!
//! Drives follow SYNC and set-points from any sender, and accept any heartbeat under the host's node-ID. A write to a
//! node by SDO is a sign before the end of bring-up: another controller configures the node, and both use the same SDO
//! channel. In operation, a write is no sign, because service tools may write beside a controller. NMT commands and reads
//! are never signs.

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
    /// A write to one of our nodes by SDO, during bring-up.
    #[error("a write to node {node} by SDO")]
    Write { node: u8 },
}

impl Sign {
    /// As [`of`](Self::of), before the end of bring-up: a write by SDO is a sign too.
    pub(crate) fn of_bring_up(frame: &Frame, host: NodeId, is_ours: impl Fn(NodeId) -> bool) -> Option<Self> {
        match cob::Function::of(frame.standard_data_id()?)? {
            cob::Function::SdoRequest(node) if is_ours(node) && begins_write(frame.data()) => {
                Some(Self::Write { node: node.raw() })
            }
            _ => Self::of(frame, host, is_ours),
        }
    }

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

/// Whether an SDO request initiates a download or a block download (CiA 301 §7.2.4.3).
fn begins_write(data: &[u8]) -> bool {
    data.first().is_some_and(|specifier| specifier >> 5 == 1 || specifier >> 5 == 6 && specifier & 1 == 0)
}
