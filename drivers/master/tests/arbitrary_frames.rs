//! Arbitrary statuswords: a fault reset is always a rising edge. The fuzz targets `sdo_client` and `lss_master` give
//! arbitrary frames to the other state machines.

use canopen::cia402::{Controlword, Statusword};
use mrroc_master::power::{Goal, PowerStateMachine};
use proptest::prelude::*;

proptest! {
    #[test]
    fn a_fault_reset_is_a_rising_edge_and_only_for_its_goal(
        goals in proptest::collection::vec(
            (proptest::sample::select(vec![Goal::Off, Goal::ResetFault, Goal::On]), any::<u16>()), 0..20,
        ),
    ) {
        let mut machine = PowerStateMachine::default();
        let mut last = None;
        for (goal, status) in goals {
            let word = machine.step(Statusword(status), goal);
            if word.has(Controlword::RESET) {
                prop_assert!(last.is_some_and(|last: Controlword| !last.has(Controlword::RESET)));
                prop_assert_eq!(goal, Goal::ResetFault);
            }
            last = Some(word);
        }
    }
}
