//! Phases of an axis controller during operation, and the transitions between them.
//!
//! Each cycle feeds one command event to [`Phase::next`]. The answers of the drive feed [`PhaseEvent::SwitchedOn`].
//!
//! ```text
//!  Off ──Follow, Seek──► SwitchingOn ──SwitchedOn──► Following
//!                                                      │  ▲
//!                                                 Seek │  │ Follow
//!  ┌ search for a reference ───────────────────────────▼──┴──┐
//!  │  drive referenced:    Unreferencing                     │
//!  │                             │ Seek, reference forgotten │
//!  │  drive unreferenced:  SearchingIndex                    │
//!  │                             │ Seek, index found         │
//!  │                       IndexFound                        │
//!  └─────────────────────────────────────────────────────────┘
//!
//!  SwitchingOn, Following, search ──Fault──► FaultReaction
//!  every phase ──Off──► Off
//!  every phase ──EmergencyStop──► EmergencyStop
//! ```
//!
//! `FaultReaction` ends by `Off` or `EmergencyStop`. `EmergencyStop` ends by `Off` alone, which then is a reset. `Fault`
//! changes nothing in `Off`.
//!
//! [`Unreferencing`](Phase::Unreferencing), [`SearchingIndex`](Phase::SearchingIndex) and
//! [`IndexFound`](Phase::IndexFound) are the search for a reference. Motion continues by set-points meanwhile.
//!
//! Three things are independent of the phase and have types of their own: the acknowledgement of a mode by the drive
//! ([`Acknowledgement`]), missing answers (`exchange`), and the plausibility of answers (`plausibility`).

use super::telegram::{ANSWERS_TO_EFFECT, ControllerMode};

/// Phase of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// Manual mode and a zero set-point, sent in every cycle.
    Off,
    /// A zero set-point and the mode with torque, until the drive has acknowledged both.
    SwitchingOn,
    /// Torque on: the drive follows set-points.
    Following,
    /// Torque on: the drive follows set-points and is told to forget its reference. `cycles` counts the cycles in this
    /// phase, the current one included.
    Unreferencing { cycles: u32 },
    /// Torque on: the drive follows set-points and zeroes its counter at the next index pulse.
    SearchingIndex,
    /// Torque on: the index pulse has come, and the search is still commanded.
    IndexFound,
    /// Zero set-point without a change of mode, because a fault is latched.
    FaultReaction(Interrupted),
    /// Error state of the drive, which opens the emergency-stop circuit of the cabinet; sent in every cycle.
    EmergencyStop,
}

/// What a fault interrupted. The mode of the drive stays as in that phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Interrupted {
    /// Whether the drive has torque is unknown.
    SwitchingOn,
    /// The drive has torque.
    Following,
    /// The drive has torque, and an index pulse still zeroes its counter.
    SearchingIndex,
}

/// What moves an axis from phase to phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PhaseEvent {
    /// Off is commanded without an emergency stop, or a reset.
    Off,
    /// A fault that requires an emergency stop is latched.
    EmergencyStop,
    /// Another fault is latched, and torque is commanded.
    Fault,
    /// Torque is commanded without a search for a reference.
    Follow,
    /// A search for a reference is commanded. `drive_referenced`: the drive reports a reference. `index_found`: the host
    /// knows the reference, because the index pulse came in this search.
    Seek { drive_referenced: bool, index_found: bool },
    /// The drive has acknowledged the mode with torque.
    SwitchedOn,
}

impl Phase {
    /// The phase after an event, which may be the same.
    pub(super) fn next(self, event: PhaseEvent) -> Self {
        match (self, event) {
            (_, PhaseEvent::Off) => Self::Off,
            (_, PhaseEvent::EmergencyStop) => Self::EmergencyStop,

            (Self::Off, PhaseEvent::Follow | PhaseEvent::Seek { .. }) => Self::SwitchingOn,
            (Self::SwitchingOn, PhaseEvent::SwitchedOn) => Self::Following,
            (
                Self::Following | Self::Unreferencing { .. } | Self::SearchingIndex | Self::IndexFound,
                PhaseEvent::Follow,
            ) => Self::Following,

            (Self::Following, PhaseEvent::Seek { drive_referenced, .. }) => match drive_referenced {
                true => Self::Unreferencing { cycles: 1 },
                false => Self::SearchingIndex,
            },
            (Self::Unreferencing { cycles }, PhaseEvent::Seek { drive_referenced: true, .. }) => {
                Self::Unreferencing { cycles: cycles + 1 }
            }
            (
                Self::Unreferencing { .. } | Self::SearchingIndex | Self::IndexFound,
                PhaseEvent::Seek { index_found, .. },
            ) => match index_found {
                true => Self::IndexFound,
                false => Self::SearchingIndex,
            },

            (Self::SwitchingOn, PhaseEvent::Fault) => Self::FaultReaction(Interrupted::SwitchingOn),
            (Self::Following | Self::Unreferencing { .. } | Self::IndexFound, PhaseEvent::Fault) => {
                Self::FaultReaction(Interrupted::Following)
            }
            (Self::SearchingIndex, PhaseEvent::Fault) => Self::FaultReaction(Interrupted::SearchingIndex),

            (Self::FaultReaction(_) | Self::EmergencyStop, _)
            | (Self::Off, PhaseEvent::Fault | PhaseEvent::SwitchedOn)
            | (Self::SwitchingOn, PhaseEvent::Follow | PhaseEvent::Seek { .. })
            | (
                Self::Following | Self::Unreferencing { .. } | Self::SearchingIndex | Self::IndexFound,
                PhaseEvent::SwitchedOn,
            ) => self,
        }
    }

    pub(super) fn mode(self) -> ControllerMode {
        match self {
            Self::Off => ControllerMode::Manual,
            Self::EmergencyStop => ControllerMode::Error,
            Self::SearchingIndex | Self::FaultReaction(Interrupted::SearchingIndex) => ControllerMode::Index,
            Self::SwitchingOn
            | Self::Following
            | Self::Unreferencing { .. }
            | Self::IndexFound
            | Self::FaultReaction(Interrupted::SwitchingOn | Interrupted::Following) => ControllerMode::Drive,
        }
    }

    pub(super) fn follows(self) -> bool {
        self == Self::Following || self.searches()
    }

    pub(super) fn searches(self) -> bool {
        matches!(self, Self::Unreferencing { .. } | Self::SearchingIndex | Self::IndexFound)
    }

    /// Whether the drive is known to have torque.
    pub(super) fn has_torque(self) -> bool {
        self.follows() || matches!(self, Self::FaultReaction(Interrupted::Following | Interrupted::SearchingIndex))
    }

    /// Whether the drive is told to have no torque.
    pub(super) fn rests(self) -> bool {
        matches!(self, Self::Off | Self::EmergencyStop)
    }
}

/// How far a drive has acknowledged its mode. An answer does not contain the mode, so answers are counted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Acknowledgement {
    /// Telegrams sent since the mode changed.
    pub(super) telegrams: u32,
    /// Answers since the mode changed.
    pub(super) answers: u32,
    /// The mode before was to zero the counter at the index pulse.
    after_index: bool,
}

impl Acknowledgement {
    /// After bring-up, which left the drive in manual mode.
    pub(super) const BROUGHT_UP: Self = Self { telegrams: 1, answers: ANSWERS_TO_EFFECT, after_index: false };

    /// For a new mode that takes the place of `before`.
    pub(super) fn pending(before: ControllerMode) -> Self {
        Self { telegrams: 0, answers: 0, after_index: before == ControllerMode::Index }
    }

    /// Whether the drive is in its new mode.
    pub(super) fn is_complete(&self) -> bool {
        self.answers >= ANSWERS_TO_EFFECT
    }

    /// Whether the drive may still zero its counter at the index pulse, as its mode before did.
    pub(super) fn may_index(&self) -> bool {
        self.after_index && !self.is_complete()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OFF: Phase = Phase::Off;
    const ON: Phase = Phase::SwitchingOn;
    const FOLLOW: Phase = Phase::Following;
    const UNREF: Phase = Phase::Unreferencing { cycles: 1 };
    const UNREF_2: Phase = Phase::Unreferencing { cycles: 2 };
    const SEARCH: Phase = Phase::SearchingIndex;
    const FOUND: Phase = Phase::IndexFound;
    const REACT_ON: Phase = Phase::FaultReaction(Interrupted::SwitchingOn);
    const REACT: Phase = Phase::FaultReaction(Interrupted::Following);
    const REACT_IDX: Phase = Phase::FaultReaction(Interrupted::SearchingIndex);
    const STOP: Phase = Phase::EmergencyStop;

    const fn seek(drive_referenced: bool, index_found: bool) -> PhaseEvent {
        PhaseEvent::Seek { drive_referenced, index_found }
    }

    const EVENTS: [PhaseEvent; 9] = [
        PhaseEvent::Off,
        PhaseEvent::EmergencyStop,
        PhaseEvent::Fault,
        PhaseEvent::Follow,
        seek(false, false),
        seek(true, false),
        seek(false, true),
        seek(true, true),
        PhaseEvent::SwitchedOn,
    ];

    /// Phases with what each of [`EVENTS`] makes of them.
    #[rustfmt::skip]
    const TABLE: [(Phase, [Phase; 9]); 10] = [
        //           off  stop  fault      follow     seek: -    referenced found      both       switched on
        (OFF,       [OFF, STOP, OFF,       ON,        ON,        ON,        ON,        ON,        OFF]),
        (ON,        [OFF, STOP, REACT_ON,  ON,        ON,        ON,        ON,        ON,        FOLLOW]),
        (FOLLOW,    [OFF, STOP, REACT,     FOLLOW,    SEARCH,    UNREF,     SEARCH,    UNREF,     FOLLOW]),
        (UNREF,     [OFF, STOP, REACT,     FOLLOW,    SEARCH,    UNREF_2,   FOUND,     UNREF_2,   UNREF]),
        (SEARCH,    [OFF, STOP, REACT_IDX, FOLLOW,    SEARCH,    SEARCH,    FOUND,     FOUND,     SEARCH]),
        (FOUND,     [OFF, STOP, REACT,     FOLLOW,    SEARCH,    SEARCH,    FOUND,     FOUND,     FOUND]),
        (REACT_ON,  [OFF, STOP, REACT_ON,  REACT_ON,  REACT_ON,  REACT_ON,  REACT_ON,  REACT_ON,  REACT_ON]),
        (REACT,     [OFF, STOP, REACT,     REACT,     REACT,     REACT,     REACT,     REACT,     REACT]),
        (REACT_IDX, [OFF, STOP, REACT_IDX, REACT_IDX, REACT_IDX, REACT_IDX, REACT_IDX, REACT_IDX, REACT_IDX]),
        (STOP,      [OFF, STOP, STOP,      STOP,      STOP,      STOP,      STOP,      STOP,      STOP]),
    ];

    #[test]
    fn every_event_in_every_phase_leads_where_the_table_says() {
        for (row, (phase, targets)) in TABLE.into_iter().enumerate() {
            assert_eq!(row_of(phase), row, "{phase:?} stands in its own row");
            for (event, target) in EVENTS.into_iter().zip(targets) {
                assert_eq!(phase.next(event), target, "{phase:?} {event:?}");
            }
        }
    }

    /// A new phase does not compile until the table has a row for it.
    fn row_of(phase: Phase) -> usize {
        match phase {
            Phase::Off => 0,
            Phase::SwitchingOn => 1,
            Phase::Following => 2,
            Phase::Unreferencing { .. } => 3,
            Phase::SearchingIndex => 4,
            Phase::IndexFound => 5,
            Phase::FaultReaction(Interrupted::SwitchingOn) => 6,
            Phase::FaultReaction(Interrupted::Following) => 7,
            Phase::FaultReaction(Interrupted::SearchingIndex) => 8,
            Phase::EmergencyStop => 9,
        }
    }

    #[test]
    fn only_phases_with_torque_follow_and_a_fault_ends_that() {
        for (phase, _) in TABLE {
            assert!(!phase.follows() || phase.has_torque(), "{phase:?}");
            assert!(!phase.rests() || !phase.has_torque(), "{phase:?}");
            let faulted = phase.next(PhaseEvent::Fault);
            assert!(!faulted.follows(), "{phase:?}");
            assert_eq!(
                faulted.mode(),
                match phase {
                    Phase::Unreferencing { .. } | Phase::IndexFound => ControllerMode::Drive,
                    unchanged => unchanged.mode(),
                }
            );
            assert_eq!(faulted.has_torque(), phase.has_torque(), "{phase:?}");
        }
    }
}
