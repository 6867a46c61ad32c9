//! The host's end of the power state machine of drives (CiA 402-2 §8.2).
//!
//! ```text
//!                       power-on                                    any state
//!                          │ 0                                          │ 13
//!                ┌─────────▼──────────┐                      ┌──────────▼──────────┐
//!                │ NotReadyToSwitchOn │                      │ FaultReactionActive │
//!                └─────────┬──────────┘                      └──────────┬──────────┘
//!                          │ 1                                          │ 14
//!     disable    ┌─────────▼──────────┐      15 fault reset  ┌──────────▼──────────┐
//!     voltage ──►│  SwitchOnDisabled  ◄──────────────────────┤        Fault        │
//!  7, 9, 10, 12  └─────────┬──────────┘                      └─────────────────────┘
//!                          │ 2 shutdown
//!                ┌─────────▼──────────┐
//!                │  ReadyToSwitchOn   │◄─┐
//!                └─────────┬──────────┘  │ 6, 8 shutdown
//!                          │ 3 switch on │
//!                ┌─────────▼──────────┐  │
//!                │     SwitchedOn     ├──┤
//!                └────┬──────────▲────┘  │
//!  4 enable operation │          │ 5     │         11 quick stop
//!                ┌────▼──────────┴────┐  │           ┌─────────────────┐
//!                │  OperationEnabled  ├──┴──────────►│ QuickStopActive │
//!                └────────────────────┘              └─────────────────┘
//! ```
//!
//! The drive decides its state, and [`next_controlword`] alone decides the command. To switch on, the host commands
//! transitions 2, 3 and 4, one for each received statusword. Switching off removes power at once from every state. The servo
//! brakes a moving axis before. A quick stop is not commanded here. The drive starts a quick stop by itself (object
//! 0x6007, an input), and brakes without a command.
//!
//! EPOS2 shows 0x4123 and 0x4133 while its power stage is refreshed between switched on and operation enabled. Both
//! decode as switched on, so the enabling controlword is repeated.

use canopen::cia402::{Controlword, PowerState, Statusword};

/// The state to which the host leads a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Goal {
    /// No torque. A latched fault stays latched.
    #[default]
    Off,
    /// No torque, and no fault.
    ResetFault,
    /// Torque. A latched fault stays latched, and the drive off.
    On,
}

/// The word that brings a drive one step towards the goal, or keeps it there. The mode's own bits are
/// the caller's to add.
///
/// After a quick stop the way back to torque leads through switch on disabled; power is not
/// taken from an axis that still brakes, so the word waits for bit 10 of the statusword.
pub const fn next_controlword(status: Statusword, goal: Goal) -> Controlword {
    match (goal, status.power_state()) {
        (Goal::ResetFault, PowerState::Fault) => Controlword::FAULT_RESET,
        (Goal::Off | Goal::ResetFault, _) => Controlword::DISABLE_VOLTAGE,
        (Goal::On, PowerState::SwitchOnDisabled) => Controlword::SHUTDOWN,
        (Goal::On, PowerState::ReadyToSwitchOn) => Controlword::SWITCH_ON,
        (Goal::On, PowerState::SwitchedOn | PowerState::OperationEnabled) => Controlword::ENABLE_OPERATION,
        (Goal::On, PowerState::QuickStopActive) if !status.target_reached() => Controlword::QUICK_STOP,
        (
            Goal::On,
            PowerState::NotReadyToSwitchOn
            | PowerState::QuickStopActive
            | PowerState::FaultReactionActive
            | PowerState::Fault
            | PowerState::Unknown,
        ) => Controlword::DISABLE_VOLTAGE,
    }
}

/// Drives one drive to a goal: [`next_controlword`], and the rising edge that a fault reset is.
///
/// The goal holds: a drive that left the goal is led back until the caller changes the goal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PowerStateMachine {
    /// Whether the last word had bit 7 clear, so that setting it makes an edge.
    armed: bool,
}

impl PowerStateMachine {
    /// The next word to send, once per cycle. While a fault is being reset, words with bit 7 clear and
    /// set alternate, beginning with clear, so that a lost frame costs two cycles.
    pub fn step(&mut self, status: Statusword, goal: Goal) -> Controlword {
        let mut word = next_controlword(status, goal);
        if word.has(Controlword::RESET) && !self.armed {
            word = Controlword::DISABLE_VOLTAGE;
        }
        self.armed = !word.has(Controlword::RESET);
        word
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parse;
    use can::Frame;
    use canopen::pdo::PdoNumber;
    use canopen::{NodeId, cob};

    const GOALS: [Goal; 3] = [Goal::Off, Goal::ResetFault, Goal::On];

    #[test]
    fn every_state_and_goal_has_its_word() {
        use PowerState::*;
        const OFF: u16 = 0x0000;
        // Columns: off, reset fault, on.
        let table = [
            (NotReadyToSwitchOn, [OFF, OFF, OFF]),
            (SwitchOnDisabled, [OFF, OFF, 0x0006]),
            (ReadyToSwitchOn, [OFF, OFF, 0x0007]),
            (SwitchedOn, [OFF, OFF, 0x000F]),
            (OperationEnabled, [OFF, OFF, 0x000F]),
            (QuickStopActive, [OFF, OFF, 0x0002]),
            (FaultReactionActive, [OFF, OFF, OFF]),
            (Fault, [OFF, 0x0080, OFF]),
            (Unknown, [OFF, OFF, OFF]),
        ];
        for (state, words) in table {
            let status = state.bits().unwrap_or(Statusword(0x0061));
            // Bits that say nothing of the power state change nothing.
            for noise in [0x0000, 0x0110, 0x0A80, 0x4100, 0x8200] {
                let status = status.with(noise, true);
                assert_eq!(status.power_state(), state);
                assert_eq!(GOALS.map(|goal| next_controlword(status, goal).0), words, "{state} {status:?}");
            }
        }
    }

    #[test]
    fn a_quick_stop_is_left_to_brake_and_then_left() {
        assert_eq!(next_controlword(Statusword(0x0117), Goal::On), Controlword::QUICK_STOP);
        assert_eq!(next_controlword(Statusword(0x0517), Goal::On), Controlword::DISABLE_VOLTAGE);
        assert_eq!(next_controlword(Statusword(0x0117), Goal::Off), Controlword::DISABLE_VOLTAGE);
    }

    /// Statuswords as a drive sent them, each with the controlword that must follow.
    fn check(goal: Goal, trace: &[(&str, &str)]) {
        let node = NodeId::new(2).unwrap();
        let mut machine = PowerStateMachine::default();
        for (seen, sent) in trace {
            let status = parse(seen);
            assert_eq!(status.standard_data_id(), Some(cob::tpdo(PdoNumber::One, node)));
            let status = u16::from_le_bytes(status.data().try_into().unwrap());
            let word = machine.step(Statusword(status), goal);
            let command = Frame::new(cob::rpdo(PdoNumber::One, node), &word.0.to_le_bytes()).unwrap();
            assert_eq!(command.to_string(), *sent, "after {seen}");
        }
    }

    #[test]
    fn epos_is_enabled_by_these_frames() {
        let trace =
            [("182#4007", "202#0600"), ("182#2107", "202#0700"), ("182#2307", "202#0F00"), ("182#3707", "202#0F00")];
        check(Goal::On, &trace);
    }

    #[test]
    fn the_power_stage_refresh_of_epos2_is_ridden_through() {
        let trace = [
            ("182#4001", "202#0600"),
            ("182#2101", "202#0700"),
            ("182#2301", "202#0F00"),
            ("182#2341", "202#0F00"),
            ("182#3341", "202#0F00"),
            ("182#3701", "202#0F00"),
        ];
        check(Goal::On, &trace);
    }

    #[test]
    fn a_fault_reset_is_a_rising_edge_repeated_until_it_works() {
        let trace = [
            ("182#0F01", "202#0000"),
            ("182#0801", "202#8000"),
            ("182#0801", "202#0000"),
            ("182#0801", "202#8000"),
            ("182#4001", "202#0000"),
        ];
        check(Goal::ResetFault, &trace);
        // A controller before us may have left bit 7 set.
        check(Goal::ResetFault, &[("182#0801", "202#0000"), ("182#0801", "202#8000")]);
    }

    #[test]
    fn a_fault_stays_latched_unless_its_reset_is_asked_for() {
        for goal in [Goal::Off, Goal::On] {
            check(goal, &[("182#0801", "202#0000"), ("182#0801", "202#0000")]);
        }
    }
}
