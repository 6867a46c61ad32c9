//! Reasons why no node of a bus answers, from what its port has counted.

use std::fmt::Display;

use can::counted;
use can::{ControllerState, Counters};

/// Possible reasons why no node on `interface` answers.
pub fn reasons(interface: impl Display, counters: Counters, state: ControllerState) -> String {
    match (counters.received, state) {
        (1.., _) => format!(
            "{interface} carries other frames, so its bit rate is right: the node has another node-ID, is switched \
             off, or is stopped (a stopped node answers no SDO)"
        ),
        (0, _) if counters.dropped > 0 => format!(
            "{} from {interface} cannot be read, and no other came: check the baud rate; an slcan adapter must end lines \
             by a carriage return, and have no time stamps (Z0) or time stamps of four digits (Z1)",
            counted(counters.dropped, "line")
        ),
        (0, ControllerState::Active) if counters.errors == 0 => format!(
            "nothing at all is heard on {interface}: wrong bit rate, no power at the nodes, CAN_H and CAN_L swapped, \
             or no termination"
        ),
        (0, state) => format!(
            "the controller of {interface} is {}: nobody acknowledges its frames. Wrong bit rate, no termination, or \
             no node with power",
            state_text(state)
        ),
    }
}

/// Text of the state of a CAN controller.
pub fn state_text(state: ControllerState) -> &'static str {
    match state {
        ControllerState::Active => "error active",
        ControllerState::Warning => "at its error warning limit",
        ControllerState::Passive => "error passive",
        ControllerState::BusOff => "bus-off",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_counted_names_the_reason_of_a_silence() {
        use ControllerState::{Active, BusOff, Passive};
        let counted = |received, dropped, errors| Counters { received, dropped, errors, ..Counters::default() };
        for (counters, state, needle) in [
            (counted(0, 0, 0), Active, "nothing at all is heard on can0: wrong bit rate"),
            (counted(0, 0, 9), Active, "the controller of can0 is error active: nobody acknowledges"),
            (counted(0, 0, 9), Passive, "the controller of can0 is error passive: nobody acknowledges"),
            (counted(0, 0, 9), BusOff, "the controller of can0 is bus-off"),
            (counted(3, 0, 9), Passive, "can0 carries other frames"),
            (counted(0, 7, 0), Active, "7 lines from can0 cannot be read"),
            (counted(3, 7, 0), Active, "can0 carries other frames"),
        ] {
            let text = reasons("can0", counters, state);
            assert!(text.contains(needle), "{text}");
        }
    }
}
