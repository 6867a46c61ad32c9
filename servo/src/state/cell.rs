//! State machine of a cell.

/// State of a cell: all effectors of a [`Servo`](crate::Servo).
///
/// The drives come up, and the cell runs until a [`StopRequest`](crate::StopRequest). An open contact of the emergency
/// stop stops every effector and *locks* the cell: no reset succeeds until all contacts are closed. The effectors keep
/// their faults when the cell is unlocked, so no power returns by itself.
///
/// A request to stop brakes all effectors and switches them off (category 1). After the request, no order moves an effector
/// or gives it power. The cell ends *off*. It is *held*, with power, while the motors of an effector hold it because its brake
/// slips, and all other effectors are off.
///
/// If a stop fails, the cell is *cut*: the power of all axes is removed at once (category 0). Nothing leads out of this
/// state.
///
/// ```text
/// BringUp ──Up──▶ Running ──ContactOpens──▶ Locked ──ContactsClose──▶ Running
///
/// Running, Locked ──Stop──▶ Stopping
/// Stopping, Held ──PowerOff──▶ Off
/// Stopping, Off ──Holds──▶ Held
/// Off, Held ──PowerOn──▶ Stopping
///
/// BringUp ──Stop──▶ Off
/// any state ──Cut──▶ Cut
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CellState {
    /// The drives are identified, configured and started. No drive has power.
    #[default]
    BringUp,
    /// Cycles run, and the effectors take orders.
    Running,
    /// A contact of the emergency stop is open or not known. The effectors are stopped.
    Locked,
    /// A stop was requested: the effectors brake and are switched off.
    Stopping,
    /// A stop was requested, and all drives report that they have no power. In the bring-up, no drive was given power.
    Off,
    /// A stop was requested. The motors hold an effector because a brake does not, and all other effectors are off.
    Held,
    /// The power of all axes was removed at once.
    Cut,
}

/// Event at a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CellEvent {
    /// A cycle runs, so all drive groups are up.
    Up,
    /// A contact of the emergency stop is open or not known.
    ContactOpens,
    /// All contacts of the emergency stop are closed.
    ContactsClose,
    /// A stop was requested.
    Stop,
    /// All drives report that they have no power.
    PowerOff,
    /// A drive has power, and not for the reason that a brake slips.
    PowerOn,
    /// The motors hold an effector whose brake slips, and all other effectors are off.
    Holds,
    /// The power is removed at once.
    Cut,
}

impl CellState {
    /// The only transition function. An event without a meaning in a state changes nothing.
    pub(crate) fn next(self, event: CellEvent) -> Self {
        use CellState::{BringUp, Cut, Held, Locked, Off, Running, Stopping};
        match (self, event) {
            (_, CellEvent::Cut) => Cut,

            (BringUp, CellEvent::Up) => Running,
            (BringUp, CellEvent::Stop) => Off,

            (Running, CellEvent::ContactOpens) => Locked,
            (Locked, CellEvent::ContactsClose) => Running,
            (Running | Locked, CellEvent::Stop) => Stopping,

            (Stopping | Held, CellEvent::PowerOff) => Off,
            (Stopping | Off, CellEvent::Holds) => Held,
            (Off | Held, CellEvent::PowerOn) => Stopping,

            (BringUp | Running | Locked | Stopping | Off | Held | Cut, _) => self,
        }
    }

    /// Whether a stop of the cell was requested or carried out. No effector then moves by an order or gets power by an
    /// order.
    pub fn is_ending(self) -> bool {
        matches!(self, Self::Stopping | Self::Off | Self::Held | Self::Cut)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_state_answers_every_event_as_the_table_says() {
        use CellState::*;
        let letter = |state| match state {
            BringUp => 'B',
            Running => 'R',
            Locked => 'L',
            Stopping => 'S',
            Off => 'O',
            Held => 'H',
            Cut => 'C',
        };
        let events = [
            CellEvent::Up,
            CellEvent::ContactOpens,
            CellEvent::ContactsClose,
            CellEvent::Stop,
            CellEvent::PowerOff,
            CellEvent::PowerOn,
            CellEvent::Holds,
            CellEvent::Cut,
        ];
        let table = [
            //         Up ContactOpens ContactsClose Stop PowerOff PowerOn Holds Cut; `.` for the same state
            (BringUp, "R..O...C"),
            (Running, ".L.S...C"),
            (Locked, "..RS...C"),
            (Stopping, "....O.HC"),
            (Off, ".....SHC"),
            (Held, "....OS.C"),
            (Cut, "........"),
        ];
        for (state, expected) in table {
            let next = events.map(|event| state.next(event));
            let row: String = next.map(|next| if next == state { '.' } else { letter(next) }).iter().collect();
            assert_eq!(row, expected, "{state:?}");
        }
    }
}
