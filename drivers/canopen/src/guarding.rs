//! Answers of node guarding (CiA 301 §7.2.8.3.2.1): the NMT state of an old device and a toggle bit.
//!
//! A guarding master asks by remote frames. No program of this project asks. Its listeners understand the answers,
//! because another master on the bus may ask. A device whose producer heartbeat time (object 0x1017) is not 0 sends
//! [heartbeats](crate::heartbeat) instead.

use can::Frame;

use crate::nmt::NmtState;
use crate::{NodeId, cob, frame};

/// One byte: the NMT state and a bit that alternates from answer to answer. A heartbeat is the same frame with the bit
/// at 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Response {
    /// The node that answers.
    pub node: NodeId,
    /// Bit 7. `false` in the first answer after a boot or a reset of the communication.
    pub toggle: bool,
    /// The NMT state of the node, bits 0 to 6.
    pub state: NmtState,
}

impl Response {
    /// The frame.
    pub fn encode(self) -> Frame {
        let byte = u8::from(self.toggle) << 7 | self.state.raw() & 0x7F;
        frame(cob::heartbeat(self.node), [byte])
    }

    /// `None` for other frames, remote frames and lengths other than one byte. A boot-up frame decodes to
    /// [`NmtState::Initialising`].
    pub fn decode(frame: &Frame) -> Option<Self> {
        let cob::Function::Heartbeat(node) = cob::Function::of(frame.standard_data_id()?)? else {
            return None;
        };
        let &[byte] = frame.data() else { return None };
        Some(Self {
            node,
            toggle: byte & 0x80 != 0,
            state: NmtState::from_raw(byte & 0x7F),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parse;

    const NODE: NodeId = NodeId::new(2).unwrap();

    #[test]
    fn an_answer_is_a_state_and_a_toggle_bit() {
        let table = [
            (false, NmtState::Operational, "702#05"),
            (true, NmtState::Operational, "702#85"),
            (true, NmtState::PreOperational, "702#FF"),
            (false, NmtState::Stopped, "702#04"),
            (false, NmtState::Initialising, "702#00"),
        ];
        for (toggle, state, bytes) in table {
            let response = Response {
                node: NODE,
                toggle,
                state,
            };
            assert_eq!(response.encode().to_string(), bytes);
            assert_eq!(Response::decode(&parse(bytes)), Some(response));
        }
        let beyond = Response {
            node: NODE,
            toggle: false,
            state: NmtState::Unknown(0x85),
        };
        assert_eq!(beyond.encode().to_string(), "702#05");
        assert_eq!(Response::decode(&parse("702#R1")), None);
        assert_eq!(Response::decode(&parse("702#0500")), None);
    }
}
