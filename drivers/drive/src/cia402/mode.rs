//! The mode of operation of one drive: told, shown, and changed by somebody else.

use canopen::cia402::ModeOfOperation;

/// Which mode of operation the drive was told, and which it shows.
///
/// The drive is in a mode once object 0x6060 was written and object 0x6061 shows it; until then it
/// is in none that could be relied on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ModeSwitch {
    told: ModeOfOperation,
    shown: Option<ModeOfOperation>,
}

/// A service request of the mode switch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ModeRequest {
    /// Write object 0x6060.
    Tell(ModeOfOperation),
    /// Read object 0x6061.
    Look,
}

impl ModeSwitch {
    /// A drive that was brought up in `mode`.
    pub(super) fn settled(mode: ModeOfOperation) -> Self {
        Self {
            told: mode,
            shown: Some(mode),
        }
    }

    /// Whether the drive is known to be in `mode`.
    pub(super) fn is(&self, mode: ModeOfOperation) -> bool {
        self.told == mode && self.shown == Some(mode)
    }

    /// What to ask the drive next so that it gets to `wanted`.
    pub(super) fn next(&self, wanted: ModeOfOperation) -> Option<ModeRequest> {
        if self.told != wanted {
            Some(ModeRequest::Tell(wanted))
        } else if self.shown != Some(wanted) {
            Some(ModeRequest::Look)
        } else {
            None
        }
    }

    /// The drive took object 0x6060.
    pub(super) fn taken(&mut self, mode: ModeOfOperation) {
        *self = Self {
            told: mode,
            shown: None,
        };
    }

    /// The mode that the drive is known to be in; `None` on the way to another.
    pub(super) fn settled_in(&self) -> Option<ModeOfOperation> {
        self.shown.filter(|shown| *shown == self.told)
    }

    /// Somebody else has told the drive another mode.
    pub(super) fn overruled(&mut self, mode: ModeOfOperation) {
        *self = Self::settled(mode);
    }

    /// Object 0x6061 was read.
    pub(super) fn seen(&mut self, mode: ModeOfOperation) {
        self.shown = Some(mode);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ModeOfOperation::{CyclicSynchronousPosition as Csp, Homing};

    #[test]
    fn a_mode_counts_only_when_the_drive_shows_it() {
        let mut switch = ModeSwitch::settled(Csp);
        assert_eq!(switch.next(Csp), None);
        assert_eq!(switch.next(Homing), Some(ModeRequest::Tell(Homing)));
        switch.taken(Homing);
        assert!(!switch.is(Csp) && !switch.is(Homing));
        assert_eq!(switch.next(Homing), Some(ModeRequest::Look));
        switch.seen(Csp);
        assert!(!switch.is(Csp) && !switch.is(Homing));
        assert_eq!(switch.next(Homing), Some(ModeRequest::Look));
        switch.seen(Homing);
        assert!(switch.is(Homing));
        assert_eq!(switch.next(Homing), None);
    }

    #[test]
    fn a_change_of_mind_is_told_before_the_drive_is_looked_at() {
        let mut switch = ModeSwitch::settled(Csp);
        switch.taken(Homing);
        assert_eq!(switch.next(Csp), Some(ModeRequest::Tell(Csp)));
        switch.taken(Csp);
        assert!(!switch.is(Csp));
        assert_eq!(switch.next(Csp), Some(ModeRequest::Look));
    }
}
