//! Node-IDs.

use std::fmt;

/// The address of a node on its bus, 1 ..= 127 (CiA 301 §7.3.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(u8);

impl NodeId {
    /// The smallest node-ID, 1.
    pub const MIN: Self = Self(1);
    /// The largest node-ID, 127.
    pub const MAX: Self = Self(127);

    /// `None` for 0 and above 127.
    pub const fn new(raw: u8) -> Option<Self> {
        if raw >= 1 && raw <= 127 { Some(Self(raw)) } else { None }
    }

    /// The number.
    pub const fn raw(self) -> u8 {
        self.0
    }

    /// All node-IDs in ascending order.
    pub fn all() -> impl Iterator<Item = Self> {
        (1..=127).map(Self)
    }
}

impl fmt::Display for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_1_to_127_is_a_node() {
        for raw in 0..=u8::MAX {
            assert_eq!(NodeId::new(raw).map(NodeId::raw), (1..=127).contains(&raw).then_some(raw));
        }
        assert_eq!(NodeId::all().count(), 127);
    }
}
