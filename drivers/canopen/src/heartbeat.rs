//! Heartbeat (CiA 301 §7.2.8.3.2.2) and boot-up (§7.2.8.3.3): the NMT state of a node, sent by the node.
//!
//! A node sends its heartbeat once per producer time (object 0x1017).

use can::Frame;

use crate::nmt::NmtState;
use crate::{NodeId, cob, frame};

/// A heartbeat frame, `700 + node#state`. The boot-up frame is a heartbeat with [`NmtState::Initialising`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// The sender.
    pub node: NodeId,
    /// The NMT state of the sender.
    pub state: NmtState,
}

impl Heartbeat {
    /// The frame.
    pub fn encode(self) -> Frame {
        frame(cob::heartbeat(self.node), [self.state.raw()])
    }

    /// `None` for other frames, remote frames and lengths other than one byte.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let cob::Function::Heartbeat(node) = cob::Function::of(frame.standard_data_id()?)? else {
            return None;
        };
        let &[state] = frame.data() else { return None };
        Some(Self {
            node,
            state: NmtState::from_raw(state),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(raw: u8) -> NodeId {
        NodeId::new(raw).unwrap()
    }

    #[test]
    fn heartbeats_are_one_byte_on_0x700_plus_node() {
        let table = [
            (NmtState::Initialising, "702#00"),
            (NmtState::Stopped, "702#04"),
            (NmtState::Operational, "702#05"),
            (NmtState::PreOperational, "702#7F"),
            (NmtState::Unknown(0x85), "702#85"),
        ];
        for (state, bytes) in table {
            let heartbeat = Heartbeat {
                node: node(2),
                state,
            };
            assert_eq!(heartbeat.encode().to_string(), bytes);
            assert_eq!(Heartbeat::decode(&heartbeat.encode()), Some(heartbeat));
        }
    }

    #[test]
    fn guarding_requests_and_wrong_lengths_are_no_heartbeats() {
        let id = cob::heartbeat(node(2));
        assert_eq!(Heartbeat::decode(&Frame::remote(id, 1).unwrap()), None);
        assert_eq!(Heartbeat::decode(&Frame::new(id, &[]).unwrap()), None);
        assert_eq!(Heartbeat::decode(&Frame::new(id, &[5, 0]).unwrap()), None);
        assert_eq!(
            Heartbeat::decode(&Frame::new(cob::SYNC, &[5]).unwrap()),
            None
        );
    }
}
