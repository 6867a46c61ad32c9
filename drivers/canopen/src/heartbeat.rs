//! Heartbeat (CiA 301 §7.2.8.3.2.2) and boot-up (§7.2.8.3.3): the NMT state of a node, sent by the node.
//!
//! A node sends its heartbeat once per producer time (object 0x1017). An old device sends the same frame with a toggle bit
//! as its answer to node guarding (§7.2.8.3.2.1). A guarding master asks by remote frames. No program of this project
//! asks. Its listeners understand the answers, because another master on the bus may ask.

use can::Frame;

use crate::nmt::NmtState;
use crate::{NodeId, cob, frame};

/// A heartbeat frame, `700 + node#state`. The boot-up frame is a heartbeat with [`NmtState::Initialising`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// The sender.
    pub node: NodeId,
    /// The NMT state of the sender. For an answer to node guarding, read [`Self::guarded`].
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
        Some(Self { node, state: NmtState::from_raw(state) })
    }

    /// The frame read as an answer to node guarding: the NMT state of bits 0 to 6, and the toggle bit. The toggle bit, bit
    /// 7, alternates from answer to answer. The bit is `false` in the first answer after a boot or a reset of the
    /// communication, and in every heartbeat.
    pub const fn guarded(self) -> (NmtState, bool) {
        let byte = self.state.raw();
        (NmtState::from_raw(byte & 0x7F), byte & 0x80 != 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parse;

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
            let heartbeat = Heartbeat { node: node(2), state };
            assert_eq!(heartbeat.encode().to_string(), bytes);
            assert_eq!(Heartbeat::decode(&heartbeat.encode()), Some(heartbeat));
        }
    }

    #[test]
    fn an_answer_to_node_guarding_is_a_state_and_a_toggle_bit() {
        let table = [
            (false, NmtState::Operational, "702#05"),
            (true, NmtState::Operational, "702#85"),
            (true, NmtState::PreOperational, "702#FF"),
            (false, NmtState::Stopped, "702#04"),
            (false, NmtState::Initialising, "702#00"),
        ];
        for (toggle, state, bytes) in table {
            let heartbeat = Heartbeat::decode(&parse(bytes)).unwrap();
            assert_eq!(heartbeat.node, node(2));
            assert_eq!(heartbeat.guarded(), (state, toggle));
        }
    }

    #[test]
    fn guarding_requests_and_wrong_lengths_are_no_heartbeats() {
        let id = cob::heartbeat(node(2));
        assert_eq!(Heartbeat::decode(&Frame::remote(id, 1).unwrap()), None);
        assert_eq!(Heartbeat::decode(&Frame::new(id, &[]).unwrap()), None);
        assert_eq!(Heartbeat::decode(&Frame::new(id, &[5, 0]).unwrap()), None);
        assert_eq!(Heartbeat::decode(&Frame::new(cob::SYNC, &[5]).unwrap()), None);
    }
}
