//! Network management (CiA 301 §7.2.8.3.1): commands of the master, and the states of a node (§7.3.2).
//!
//! A stopped node answers no SDO request, so that the request times out and is not aborted.

use std::fmt;

use can::Frame;

use crate::{NodeId, cob, frame, payload};

/// A command of the master, by its specifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Command {
    /// Enter operational: all services work.
    Start = 0x01,
    /// Enter stopped: only NMT and error control work.
    Stop = 0x02,
    /// Enter pre-operational: all services but PDOs work.
    EnterPreOperational = 0x80,
    /// Reset the node with its application.
    ResetNode = 0x81,
    /// Reset its communication (objects 0x1000 ..= 0x1FFF) to stored values.
    ResetCommunication = 0x82,
}

impl Command {
    const ALL: [Self; 5] =
        [Self::Start, Self::Stop, Self::EnterPreOperational, Self::ResetNode, Self::ResetCommunication];

    /// To all nodes.
    pub const fn to_all(self) -> Request {
        Request { command: self, target: Target::All }
    }

    /// To one node.
    pub const fn to(self, node: NodeId) -> Request {
        Request { command: self, target: Target::Node(node) }
    }
}

/// The nodes that a command addresses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// Every node.
    All,
    /// One node.
    Node(NodeId),
}

/// An NMT frame: `000#cs node`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    /// The command.
    pub command: Command,
    /// The nodes addressed.
    pub target: Target,
}

impl Request {
    /// Whether the command addresses `node`.
    pub fn concerns(self, node: NodeId) -> bool {
        match self.target {
            Target::All => true,
            Target::Node(target) => target == node,
        }
    }

    /// The frame.
    pub fn encode(self) -> Frame {
        let target = match self.target {
            Target::All => 0,
            Target::Node(node) => node.raw(),
        };
        frame(cob::NMT, [self.command as u8, target])
    }

    /// `None` for other frames, unknown commands and node-IDs above 127: nodes ignore them.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let &[specifier, target] = payload(frame, cob::NMT)? else {
            return None;
        };
        let target = match target {
            0 => Target::All,
            raw => Target::Node(NodeId::new(raw)?),
        };
        let mut commands = Command::ALL.into_iter();
        Some(Self { command: commands.find(|command| *command as u8 == specifier)?, target })
    }
}

/// The NMT state a node reports in its heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NmtState {
    /// The node has just booted: the value of the boot-up frame.
    Initialising,
    /// Only NMT and error control work.
    Stopped,
    /// All services work.
    Operational,
    /// All services but PDOs work.
    PreOperational,
    /// A value that CiA 301 does not know.
    Unknown(u8),
}

impl NmtState {
    /// As in byte 0 of a heartbeat.
    pub const fn raw(self) -> u8 {
        match self {
            Self::Initialising => 0x00,
            Self::Stopped => 0x04,
            Self::Operational => 0x05,
            Self::PreOperational => 0x7F,
            Self::Unknown(raw) => raw,
        }
    }

    /// From byte 0 of a heartbeat.
    pub const fn from_raw(raw: u8) -> Self {
        match raw {
            0x00 => Self::Initialising,
            0x04 => Self::Stopped,
            0x05 => Self::Operational,
            0x7F => Self::PreOperational,
            raw => Self::Unknown(raw),
        }
    }
}

impl fmt::Display for NmtState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Initialising => f.write_str("initialising"),
            Self::Stopped => f.write_str("stopped"),
            Self::Operational => f.write_str("operational"),
            Self::PreOperational => f.write_str("pre-operational"),
            Self::Unknown(raw) => write!(f, "unknown ({raw:#04x})"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(raw: u8) -> NodeId {
        NodeId::new(raw).unwrap()
    }

    #[test]
    fn commands_are_two_bytes_on_identifier_zero() {
        let table = [
            (Command::Start.to_all(), "000#0100"),
            (Command::Start.to(node(2)), "000#0102"),
            (Command::Stop.to(node(127)), "000#027F"),
            (Command::EnterPreOperational.to(node(2)), "000#8002"),
            (Command::ResetNode.to_all(), "000#8100"),
            (Command::ResetCommunication.to(node(5)), "000#8205"),
        ];
        for (request, bytes) in table {
            assert_eq!(request.encode().to_string(), bytes);
            assert_eq!(Request::decode(&request.encode()), Some(request));
        }
    }

    #[test]
    fn malformed_commands_are_nobodys() {
        let cases: [&[u8]; 5] = [&[], &[0x01], &[0x01, 0x02, 0x00], &[0x03, 0x02], &[0x01, 0x80]];
        for data in cases {
            let frame = Frame::new(cob::NMT, data).unwrap();
            assert_eq!(Request::decode(&frame), None, "{frame}");
        }
        let other = Frame::new(cob::SYNC, &[0x01, 0x02]).unwrap();
        assert_eq!(Request::decode(&other), None);
    }

    #[test]
    fn a_command_to_all_concerns_everyone_and_another_one_only_its_node() {
        assert!(Command::Stop.to_all().concerns(node(9)));
        assert!(Command::Stop.to(node(9)).concerns(node(9)));
        assert!(!Command::Stop.to(node(9)).concerns(node(8)));
    }

    #[test]
    fn every_state_byte_survives_the_round_trip() {
        for raw in 0..=u8::MAX {
            assert_eq!(NmtState::from_raw(raw).raw(), raw);
        }
    }
}
