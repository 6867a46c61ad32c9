//! The whole laboratory on virtual interfaces and pseudo-terminals. `tests/run` runs this test when no other test loads the
//! host.

use crate::bench::{on_vcan_within, patient_turn};
use crate::cells_on_vcan::{LONGEST, RECORD, completes, slower_laboratory};
use crate::lab::left_meetings;
use crate::mrroc::Directory;

#[test]
fn the_whole_laboratory_completes_on_five_buses_and_five_lines() {
    const TEST: &str = "vcan_laboratory::the_whole_laboratory_completes_on_five_buses_and_five_lines";
    let _turn = patient_turn();
    on_vcan_within(LONGEST, TEST, |_| {
        let directory = Directory::new();
        completes("lab", &directory, slower_laboratory);
        // A machine that misses deadlines delays the ends of the motions by some cycles.
        left_meetings(&directory.path(RECORD));
    });
}
