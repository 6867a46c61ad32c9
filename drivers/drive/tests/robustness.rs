//! Damaged lines: a hundred thousand cycles of each kind. The bench of the same name runs ten million.

#[path = "../benches/robustness/study.rs"]
mod study;

use mrroc_drive::axis_controller::Protocol;

#[test]
fn nothing_is_believed_that_the_motor_cannot_have_moved() {
    for protocol in [Protocol::Nfv2, Protocol::HiMoxa] {
        for (name, damage) in study::DAMAGES {
            let tally = study::run(protocol, damage, 100_000, 7);
            let what = format!("{protocol:?}, {name}: {tally:?}");
            println!("{what}");
            assert_eq!(tally.beyond_reach, 0, "{what}");
            assert!(tally.frames_to_find <= 2, "{what}");
            // A damaged position that was accepted, or a repeated one, is corrected by a jump at the latest.
            assert!(tally.frames_to_believe <= 3, "{what}");
            assert!(tally.accepted > 0 && tally.damaged > 0, "{what}");
        }
    }
}
