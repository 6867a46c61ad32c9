//! Service requests during operation: the mode of operation, the code of a fault without EMCY, and the end of torque in
//! pre-operational.

use canopen::Object;
use canopen::cia402::{Controlword, ModeOfOperation};
use canopen::objects::{CONTROLWORD, ERROR_CODE, MODE_OF_OPERATION, MODE_OF_OPERATION_DISPLAY, STATUSWORD};
use canopen::sdo::Write;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Service {
    /// Write object 0x6060.
    Tell(ModeOfOperation),
    /// Read object 0x6061.
    Look,
    /// Read object 0x603F, after a fault without EMCY.
    ErrorCode,
    /// Write object 0x6040: disable voltage.
    SwitchOff,
    /// Read object 0x6041.
    Statusword,
}

impl Service {
    pub(super) fn object(self) -> Object {
        match self {
            Self::Tell(_) => MODE_OF_OPERATION,
            Self::Look => MODE_OF_OPERATION_DISPLAY,
            Self::ErrorCode => ERROR_CODE,
            Self::SwitchOff => CONTROLWORD,
            Self::Statusword => STATUSWORD,
        }
    }

    /// The value to write; `None` for a read.
    pub(super) fn write(self) -> Option<Write> {
        match self {
            Self::Tell(mode) => Some(Write::new(self.object(), mode.raw())),
            Self::SwitchOff => Some(Write::new(self.object(), Controlword::DISABLE_VOLTAGE.0)),
            Self::Look | Self::ErrorCode | Self::Statusword => None,
        }
    }
}

/// The commanded and the reported mode of operation of one drive.
///
/// The mode counts as reached once object 0x6060 was written and object 0x6061 shows the mode. Until then the mode is
/// unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ModeSwitch {
    told: ModeOfOperation,
    shown: Option<ModeOfOperation>,
}

impl ModeSwitch {
    /// The state after bring-up in `mode`.
    pub(super) fn settled(mode: ModeOfOperation) -> Self {
        Self { told: mode, shown: Some(mode) }
    }

    /// Whether the drive is known to be in `mode`.
    pub(super) fn is(&self, mode: ModeOfOperation) -> bool {
        self.told == mode && self.shown == Some(mode)
    }

    /// The next service request on the way to the mode `wanted`.
    pub(super) fn next(&self, wanted: ModeOfOperation) -> Option<Service> {
        if self.told != wanted {
            Some(Service::Tell(wanted))
        } else if self.shown != Some(wanted) {
            Some(Service::Look)
        } else {
            None
        }
    }

    /// Notes that the drive accepted the write of object 0x6060.
    pub(super) fn taken(&mut self, mode: ModeOfOperation) {
        *self = Self { told: mode, shown: None };
    }

    /// The mode that the drive is known to be in; `None` during a change.
    pub(super) fn settled_in(&self) -> Option<ModeOfOperation> {
        self.shown.filter(|shown| *shown == self.told)
    }

    /// Notes the value read from object 0x6061.
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
        assert_eq!(switch.next(Homing), Some(Service::Tell(Homing)));
        switch.taken(Homing);
        assert!(!switch.is(Csp) && !switch.is(Homing));
        assert_eq!(switch.next(Homing), Some(Service::Look));
        switch.seen(Csp);
        assert!(!switch.is(Csp) && !switch.is(Homing));
        assert_eq!(switch.next(Homing), Some(Service::Look));
        switch.seen(Homing);
        assert!(switch.is(Homing));
        assert_eq!(switch.next(Homing), None);
    }

    #[test]
    fn a_change_of_mind_is_told_before_the_drive_is_looked_at() {
        let mut switch = ModeSwitch::settled(Csp);
        switch.taken(Homing);
        assert_eq!(switch.next(Csp), Some(Service::Tell(Csp)));
        switch.taken(Csp);
        assert!(!switch.is(Csp));
        assert_eq!(switch.next(Csp), Some(Service::Look));
    }
}
