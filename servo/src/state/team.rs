//! State machine of a team.

/// State of a team.
///
/// An effector without partners is *apart*. A barrier ties effectors to a team. The members of a team begin each
/// macrostep in the same cycle. A stop of one member, by an order or a fault, stops all. The members brake over the same
/// number of periods, so all motors of the team stay in proportion until rest. The stop also ends the team. Each member
/// becomes apart when its own stop ends.
///
/// A motion may end while a [`CycleLaw`](crate::CycleLaw) still displaces a member. This end is no stop: the members
/// *settle* together over the same number of periods, and stay tied.
///
/// A member may untie at the end of a macrostep, also in motion. The member then moves on apart, and its partners stay
/// tied. The last member of a team is apart.
///
/// ```text
/// Apart ──Tie──▶ Tied ──Begin──▶ Moving ──Rest──▶ Tied
///                                Moving ──Settle──▶ Settling ──Rest──▶ Tied
///
/// Tied, Moving, Settling ──Stop──▶ Parting ──Rest──▶ Apart
/// Tied, Moving, Settling ──Untie──▶ Apart
/// any state ──Tie──▶ Tied
/// Settling ──Begin──▶ Moving
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TeamState {
    /// No partners.
    #[default]
    Apart,
    /// Tied, and no macrostep is under way.
    Tied,
    /// The members follow macrosteps together.
    Moving,
    /// The members brake together from the displacements of their cycle laws, and stay tied.
    Settling,
    /// A member was stopped. The members brake together, and are tied no longer.
    Parting,
}

/// Event at a team.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TeamEvent {
    /// A barrier ties the effector to its partners.
    Tie,
    /// The effector leaves its team, or all its partners have left.
    Untie,
    /// The members begin a macrostep.
    Begin,
    /// The macrosteps have ended, and a cycle law still moves a member.
    Settle,
    /// A member was stopped by an order or by a fault.
    Stop,
    /// All members stand; in [`TeamState::Parting`], this member brakes no longer.
    Rest,
}

impl TeamState {
    /// The only transition function. An event without a meaning in a state changes nothing.
    pub(crate) fn next(self, event: TeamEvent) -> Self {
        use TeamState::{Apart, Moving, Parting, Settling, Tied};
        match (self, event) {
            (_, TeamEvent::Tie) => Tied,

            (Apart, _) => Apart,
            (Tied | Moving | Settling, TeamEvent::Untie) => Apart,
            (Tied | Moving | Settling, TeamEvent::Stop) => Parting,

            (Tied | Moving | Settling, TeamEvent::Begin) => Moving,
            (Tied, TeamEvent::Settle | TeamEvent::Rest) => Tied,

            (Moving | Settling, TeamEvent::Settle) => Settling,
            (Moving | Settling, TeamEvent::Rest) => Tied,

            (Parting, TeamEvent::Untie | TeamEvent::Rest) => Apart,
            (Parting, TeamEvent::Begin | TeamEvent::Settle | TeamEvent::Stop) => Parting,
        }
    }

    /// Whether the members begin and stop their macrosteps together.
    pub(crate) fn is_tied(self) -> bool {
        matches!(self, Self::Tied | Self::Moving | Self::Settling)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_state_answers_every_event_as_the_table_says() {
        use TeamState::*;
        let letter = |state| match state {
            Apart => 'A',
            Tied => 'T',
            Moving => 'M',
            Settling => 'S',
            Parting => 'P',
        };
        let events =
            [TeamEvent::Tie, TeamEvent::Untie, TeamEvent::Begin, TeamEvent::Settle, TeamEvent::Stop, TeamEvent::Rest];
        let table = [
            //         Tie Untie Begin Settle Stop Rest; `.` for the same state
            (Apart, "T....."),
            (Tied, ".AM.P."),
            (Moving, "TA.SPT"),
            (Settling, "TAM.PT"),
            (Parting, "TA...A"),
        ];
        for (state, expected) in table {
            let next = events.map(|event| state.next(event));
            let row: String = next.map(|next| if next == state { '.' } else { letter(next) }).iter().collect();
            assert_eq!(row, expected, "{state:?}");
        }
    }
}
