//! Objects of one byte per sub-index as the bits of all lines of a module.

use canopen::Object;

use crate::node::objects::Objects;
use crate::node::table::{Entry, Slot};

/// The bytes of one object, from sub-index 1: line `n` is bit `n % 8` of byte `n / 8`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lines {
    first: Slot,
    bytes: u8,
}

impl Lines {
    /// `None` if the module has no line of the kind.
    pub(super) fn of(table: &[Entry], index: u16, bytes: u8) -> Option<Self> {
        let first = Slot::find(table, Object::new(index, 1))?;
        Some(Self { first, bytes })
    }

    pub(super) fn slots(&self) -> impl Iterator<Item = Slot> + use<> {
        let first = self.first;
        (0..u16::from(self.bytes)).map(move |byte| first.plus(byte))
    }

    /// The bits of all lines, line 0 lowest. Bits beyond the lines are zero.
    pub(super) fn get(&self, objects: &Objects) -> u64 {
        let bytes = (0..).step_by(8).zip(self.slots());
        bytes.fold(0, |bits, (shift, slot)| bits | u64::from(objects.u(slot)) << shift)
    }

    pub(super) fn set(&self, bits: u64, objects: &mut Objects) {
        for (byte, slot) in bits.to_le_bytes().into_iter().zip(self.slots()) {
            objects.set(slot, byte.into());
        }
    }
}

/// A line as a bit of 64; zero beyond the 64 lines.
pub(super) fn bit(index: u8) -> u64 {
    1_u64.checked_shl(index.into()).unwrap_or(0)
}
