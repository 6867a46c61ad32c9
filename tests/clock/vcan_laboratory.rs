//! The whole laboratory on virtual interfaces and pseudo-terminals. `tests/run` runs this test when no other test loads the
//! host.

use kit::bench::{on_vcan_within, patient_turn};
use kit::meetings::left_meetings;
use kit::mrroc::Directory;
use kit::slow::slower_laboratory;

use crate::cells_on_vcan::{LONGEST, RECORD, completes};

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
