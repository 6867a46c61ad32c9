//! The power state machine (CiA 402-2 §8.2), the device's side.
//!
//! ```text
//!  switch on disabled ──2──▶ ready to switch on ──3──▶ switched on ──4──▶ operation enabled
//!    ▲   ▲   ▲      ◀──7───        ▲   ◀──6───          │  ▲   ◀──5──────    │    │
//!    │   │   └────────────────10───┼────────────────────┘  │                 │    11
//!    │   │                         └───────8───────────────┼─────────────────┘    ▼
//!    │   └──────────────9───────────────────────────(operation enabled)   quick stop active
//!    └──12────────────────────────────────────────────────────────────────────────┘  (16 back)
//!  any ──13──▶ fault reaction active ──14──▶ fault ──15──▶ switch on disabled
//! ```
//!
//! Transitions 2 to 12 and 16 answer a controlword, see [`on_command`]. Transition 13 answers a fault, see
//! [`on_fault`]. An option code determines the ramp on which a transition brakes first. During a ramp of 0x605B or
//! 0x605C the statusword still shows operation enabled. EPOS4's documents do not define the statusword during these
//! ramps.

use canopen::cia402::{PowerCommand, PowerState};

/// Ramp to standstill before a transition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Brake {
    /// Profile deceleration, 0x6084.
    SlowDown,
    /// Quick stop deceleration, 0x6085.
    QuickStop,
    /// Maximum deceleration within the limits of current and voltage.
    AtLimits,
}

/// Option codes 0x605A to 0x605E (CiA 402-2 §8.4.5 to §8.4.9).
#[derive(Clone, Copy, Debug)]
pub(super) struct Options {
    pub(super) quick_stop: i32,
    pub(super) shutdown: i32,
    pub(super) disable_operation: i32,
    pub(super) fault_reaction: i32,
}

/// Result of a command or a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Transition {
    /// The state from now on.
    pub(super) now: PowerState,
    pub(super) brake: Option<Brake>,
    /// The state after standstill.
    pub(super) then: PowerState,
}

impl Transition {
    const fn to(state: PowerState) -> Self {
        Self { now: state, brake: None, then: state }
    }

    const fn braking(now: PowerState, brake: Brake, then: PowerState) -> Self {
        Self { now, brake: Some(brake), then }
    }
}

/// The transition for a controlword's command (CiA 402-2 §8.4.1), if any.
pub(super) fn on_command(state: PowerState, command: PowerCommand, options: &Options) -> Option<Transition> {
    use PowerState::*;
    let disabled = Transition::to(SwitchOnDisabled);
    Some(match (state, command) {
        (ReadyToSwitchOn | SwitchedOn, PowerCommand::DisableVoltage | PowerCommand::QuickStop)
        | (OperationEnabled | QuickStopActive, PowerCommand::DisableVoltage) => disabled,
        (SwitchOnDisabled | SwitchedOn, PowerCommand::Shutdown) => Transition::to(ReadyToSwitchOn),
        (ReadyToSwitchOn, PowerCommand::SwitchOn | PowerCommand::EnableOperation) => Transition::to(SwitchedOn),
        (SwitchedOn | OperationEnabled, PowerCommand::EnableOperation) => Transition::to(OperationEnabled),
        (OperationEnabled, PowerCommand::Shutdown) => match options.shutdown {
            1 => Transition::braking(OperationEnabled, Brake::SlowDown, ReadyToSwitchOn),
            _ => Transition::to(ReadyToSwitchOn),
        },
        (OperationEnabled, PowerCommand::SwitchOn) => match options.disable_operation {
            1 => Transition::braking(OperationEnabled, Brake::SlowDown, SwitchedOn),
            _ => Transition::to(SwitchedOn),
        },
        (OperationEnabled, PowerCommand::QuickStop) => match options.quick_stop {
            1 => Transition::braking(QuickStopActive, Brake::SlowDown, SwitchOnDisabled),
            2 => Transition::braking(QuickStopActive, Brake::QuickStop, SwitchOnDisabled),
            3 | 4 => Transition::braking(QuickStopActive, Brake::AtLimits, SwitchOnDisabled),
            5 => Transition::braking(QuickStopActive, Brake::SlowDown, QuickStopActive),
            6 => Transition::braking(QuickStopActive, Brake::QuickStop, QuickStopActive),
            7 | 8 => Transition::braking(QuickStopActive, Brake::AtLimits, QuickStopActive),
            _ => disabled,
        },
        (QuickStopActive, PowerCommand::EnableOperation) if options.quick_stop >= 5 => Transition::to(OperationEnabled),
        _ => return None,
    })
}

/// The transition for a fault. `at_once` omits the braking.
pub(super) fn on_fault(state: PowerState, at_once: bool, options: &Options) -> Transition {
    let brake = if options.fault_reaction == 1 { Brake::SlowDown } else { Brake::QuickStop };
    let braking = match state {
        PowerState::OperationEnabled | PowerState::QuickStopActive => options.fault_reaction != 0,
        PowerState::FaultReactionActive => true,
        _ => false,
    };
    if braking && !at_once {
        Transition::braking(PowerState::FaultReactionActive, brake, PowerState::Fault)
    } else {
        Transition::to(PowerState::Fault)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use PowerCommand as C;
    use PowerState::*;

    const OPTIONS: Options = Options { quick_stop: 6, shutdown: 0, disable_operation: 1, fault_reaction: 2 };

    #[test]
    fn every_state_answers_every_command_by_this_table() {
        // Immediate state and state after standstill, by command: disable voltage, quick stop, shutdown, switch on,
        // enable operation.
        let commands = [C::DisableVoltage, C::QuickStop, C::Shutdown, C::SwitchOn, C::EnableOperation];
        let to = |state| Some((state, state));
        let table = [
            (NotReadyToSwitchOn, [None; 5]),
            (SwitchOnDisabled, [None, None, to(ReadyToSwitchOn), None, None]),
            (ReadyToSwitchOn, [to(SwitchOnDisabled), to(SwitchOnDisabled), None, to(SwitchedOn), to(SwitchedOn)]),
            (SwitchedOn, [to(SwitchOnDisabled), to(SwitchOnDisabled), to(ReadyToSwitchOn), None, to(OperationEnabled)]),
            (
                OperationEnabled,
                [
                    to(SwitchOnDisabled),
                    to(QuickStopActive),
                    to(ReadyToSwitchOn),
                    Some((OperationEnabled, SwitchedOn)),
                    to(OperationEnabled),
                ],
            ),
            (QuickStopActive, [to(SwitchOnDisabled), None, None, None, to(OperationEnabled)]),
            (FaultReactionActive, [None; 5]),
            (Fault, [None; 5]),
        ];
        for (state, expected) in table {
            for (command, expected) in commands.into_iter().zip(expected) {
                let found = on_command(state, command, &OPTIONS);
                let found = found.map(|transition| (transition.now, transition.then));
                assert_eq!(found, expected, "{state} {command:?}");
            }
        }
    }

    #[test]
    fn option_codes_choose_the_ramp_and_where_it_ends() {
        let quick_stop = [
            (0, None, SwitchOnDisabled),
            (1, Some(Brake::SlowDown), SwitchOnDisabled),
            (2, Some(Brake::QuickStop), SwitchOnDisabled),
            (3, Some(Brake::AtLimits), SwitchOnDisabled),
            (4, Some(Brake::AtLimits), SwitchOnDisabled),
            (5, Some(Brake::SlowDown), QuickStopActive),
            (6, Some(Brake::QuickStop), QuickStopActive),
            (7, Some(Brake::AtLimits), QuickStopActive),
            (8, Some(Brake::AtLimits), QuickStopActive),
        ];
        for (option, brake, then) in quick_stop {
            let options = Options { quick_stop: option, ..OPTIONS };
            let found = on_command(OperationEnabled, C::QuickStop, &options).unwrap();
            assert_eq!((found.brake, found.then), (brake, then), "0x605A = {option}");
            // Operation can be enabled again only if the axis stays in quick stop active.
            let back = on_command(QuickStopActive, C::EnableOperation, &options);
            assert_eq!(back.is_some(), option >= 5);
        }
        for (option, brake) in [(0, None), (1, Some(Brake::SlowDown))] {
            let options = Options { shutdown: option, disable_operation: option, ..OPTIONS };
            for command in [C::Shutdown, C::SwitchOn] {
                let found = on_command(OperationEnabled, command, &options).unwrap();
                assert_eq!(found.brake, brake, "{command:?} = {option}");
            }
        }
    }

    #[test]
    fn a_fault_brakes_only_an_axis_with_power() {
        let reactions = [
            (0, false, None, Fault),
            (1, false, Some(Brake::SlowDown), FaultReactionActive),
            (2, false, Some(Brake::QuickStop), FaultReactionActive),
            (2, true, None, Fault),
        ];
        for (fault_reaction, at_once, brake, now) in reactions {
            let options = Options { fault_reaction, ..OPTIONS };
            let found = on_fault(OperationEnabled, at_once, &options);
            assert_eq!((found.brake, found.now, found.then), (brake, now, Fault));
            for state in [SwitchOnDisabled, ReadyToSwitchOn, SwitchedOn, Fault] {
                assert_eq!(on_fault(state, at_once, &options), Transition::to(Fault));
            }
        }
    }
}
