//! Warnings of a statusword: the bits that a drive sets beside its power state.

use canopen::cia402::Statusword;

use crate::WarningCause;

/// Bits of the last statusword, and the warning bits that were set since the last [`take`](Self::take).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StatusWarnings {
    shown: u16,
    set: u16,
}

/// Bit of the statusword and its cause.
const BITS: [(u16, WarningCause); 2] =
    [(Statusword::WARNING, WarningCause::Reported), (Statusword::INTERNAL_LIMIT, WarningCause::Limited)];

impl StatusWarnings {
    /// Takes a statusword. `limits` is whether an internal limit counts as a warning. A limit is normal for a drive
    /// that searches for its reference and runs into a switch, and for a drive that is off and stands at a switch.
    pub(super) fn look(&mut self, word: Statusword, limits: bool) {
        let counted = Statusword::WARNING | if limits { Statusword::INTERNAL_LIMIT } else { 0 };
        self.set |= word.0 & !self.shown & counted;
        self.shown = word.0;
    }

    /// The warnings since the last call.
    pub(super) fn take(&mut self) -> impl Iterator<Item = WarningCause> + use<> {
        let set = std::mem::take(&mut self.set);
        BITS.into_iter().filter(move |(bit, _)| set & bit != 0).map(|(_, cause)| cause)
    }
}
