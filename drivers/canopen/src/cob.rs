//! The identifiers of the predefined connection set (CiA 301 §7.3.3), and the function of each.
//!
//! [`Function::of`] returns the function of a received identifier. The functions below return the identifier to send.
//! A node configured to other identifiers (objects 0x1005, 0x1014, 0x14xx, 0x18xx) is not described
//! by this table.

use can::StandardId;

use crate::NodeId;
use crate::pdo::PdoNumber;

/// NMT commands, master to nodes.
pub const NMT: StandardId = id(0x000);
/// SYNC (object 0x1005).
pub const SYNC: StandardId = id(0x080);
/// Time stamp (object 0x1012).
pub const TIME: StandardId = id(0x100);
/// LSS, slaves to master (CiA 305).
pub const LSS_RESPONSE: StandardId = id(0x7E4);
/// LSS, master to slaves (CiA 305).
pub const LSS_REQUEST: StandardId = id(0x7E5);

/// EMCY of a node (object 0x1014).
pub const fn emcy(node: NodeId) -> StandardId {
    of_node(0x080, node)
}

/// A PDO that the node transmits.
pub const fn tpdo(number: PdoNumber, node: NodeId) -> StandardId {
    of_node(0x180 + 0x100 * number.offset(), node)
}

/// A PDO that the node receives.
pub const fn rpdo(number: PdoNumber, node: NodeId) -> StandardId {
    of_node(0x200 + 0x100 * number.offset(), node)
}

/// SDO, server (the node) to client.
pub const fn sdo_response(node: NodeId) -> StandardId {
    of_node(0x580, node)
}

/// SDO, client to server (the node).
pub const fn sdo_request(node: NodeId) -> StandardId {
    of_node(0x600, node)
}

/// Heartbeat and boot-up of a node.
pub const fn heartbeat(node: NodeId) -> StandardId {
    of_node(0x700, node)
}

const fn of_node(base: u16, node: NodeId) -> StandardId {
    id(base + node.raw() as u16)
}

const fn id(raw: u16) -> StandardId {
    StandardId::new(raw).expect("every identifier of the connection set has 11 bits")
}

/// Whether the identifier is restricted (CiA 301 §7.3.5), so that no PDO may use it.
pub const fn reserved(id: StandardId) -> bool {
    matches!(
        id.raw(),
        0x000..=0x07F | 0x101..=0x180 | 0x581..=0x5FF | 0x601..=0x67F | 0x6E0..=0x6FF | 0x701..=0x7FF
    )
}

/// Function of a frame by its identifier. [LSS](crate::lss) is not part of the connection set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Function {
    /// NMT command.
    Nmt,
    /// SYNC.
    Sync,
    /// EMCY of a node.
    Emcy(NodeId),
    /// Time stamp.
    Time,
    /// A PDO the node transmits.
    Tpdo(PdoNumber, NodeId),
    /// A PDO the node receives.
    Rpdo(PdoNumber, NodeId),
    /// SDO from server to client.
    SdoResponse(NodeId),
    /// SDO from client to server.
    SdoRequest(NodeId),
    /// Heartbeat or boot-up of a node.
    Heartbeat(NodeId),
}

impl Function {
    /// `None` for an identifier outside the predefined connection set.
    pub const fn of(id: StandardId) -> Option<Self> {
        let Some(node) = NodeId::new((id.raw() & 0x7F) as u8) else {
            return match id.raw() {
                0x000 => Some(Self::Nmt),
                0x080 => Some(Self::Sync),
                0x100 => Some(Self::Time),
                _ => None,
            };
        };
        Some(match id.raw() & 0x780 {
            0x080 => Self::Emcy(node),
            0x180 => Self::Tpdo(PdoNumber::One, node),
            0x200 => Self::Rpdo(PdoNumber::One, node),
            0x280 => Self::Tpdo(PdoNumber::Two, node),
            0x300 => Self::Rpdo(PdoNumber::Two, node),
            0x380 => Self::Tpdo(PdoNumber::Three, node),
            0x400 => Self::Rpdo(PdoNumber::Three, node),
            0x480 => Self::Tpdo(PdoNumber::Four, node),
            0x500 => Self::Rpdo(PdoNumber::Four, node),
            0x580 => Self::SdoResponse(node),
            0x600 => Self::SdoRequest(node),
            0x700 => Self::Heartbeat(node),
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The identifier that [`Function::of`] is to take for `function`.
    fn id(function: Function) -> StandardId {
        match function {
            Function::Nmt => NMT,
            Function::Sync => SYNC,
            Function::Time => TIME,
            Function::Emcy(node) => emcy(node),
            Function::Tpdo(number, node) => tpdo(number, node),
            Function::Rpdo(number, node) => rpdo(number, node),
            Function::SdoResponse(node) => sdo_response(node),
            Function::SdoRequest(node) => sdo_request(node),
            Function::Heartbeat(node) => heartbeat(node),
        }
    }

    #[test]
    fn identifiers_are_those_of_the_predefined_connection_set() {
        let node = NodeId::new(2).unwrap();
        let table = [
            (NMT, 0x000),
            (SYNC, 0x080),
            (TIME, 0x100),
            (LSS_RESPONSE, 0x7E4),
            (LSS_REQUEST, 0x7E5),
            (emcy(node), 0x082),
            (tpdo(PdoNumber::One, node), 0x182),
            (tpdo(PdoNumber::Four, node), 0x482),
            (rpdo(PdoNumber::One, node), 0x202),
            (rpdo(PdoNumber::Four, node), 0x502),
            (sdo_response(node), 0x582),
            (sdo_request(node), 0x602),
            (heartbeat(NodeId::MAX), 0x77F),
        ];
        for (id, raw) in table {
            assert_eq!(id.raw(), raw);
        }
    }

    #[test]
    fn function_and_identifier_agree_both_ways() {
        let mut known = 0;
        for raw in 0..=0x7FF {
            let id = StandardId::new(raw).unwrap();
            if let Some(function) = Function::of(id) {
                known += 1;
                assert_eq!(self::id(function), id);
            }
        }
        assert_eq!(known, 3 + 12 * 127);
    }

    #[test]
    fn no_pdo_of_the_connection_set_is_reserved_and_every_other_service_is() {
        for raw in 0..=0x7FF {
            let id = StandardId::new(raw).unwrap();
            match Function::of(id) {
                Some(Function::Tpdo(..) | Function::Rpdo(..)) => assert!(!reserved(id), "{id:?}"),
                // SYNC, EMCY and TIME have configurable identifiers.
                Some(Function::Sync | Function::Emcy(_) | Function::Time) => {}
                Some(_) => assert!(reserved(id), "{id:?}"),
                None => {}
            }
        }
        for raw in [0x001, 0x07F, 0x101, 0x180, 0x5FF, 0x67F, 0x6E0, 0x6FF, 0x780, 0x7FF] {
            assert!(reserved(StandardId::new(raw).unwrap()), "{raw:#x}");
        }
        for raw in [0x181, 0x580, 0x680, 0x6DF] {
            assert!(!reserved(StandardId::new(raw).unwrap()), "{raw:#x}");
        }
    }
}
