//! The whole laboratory on virtual interfaces and pseudo-terminals.

use kit::bench::in_uml;
use kit::meetings::left_meetings;
use kit::slow::slower_laboratory;

use crate::cells_on_vcan::{LONGEST, completes};

#[test]
fn the_whole_laboratory_completes_on_five_buses_and_five_lines() {
    const TEST: &str = "vcan_laboratory::the_whole_laboratory_completes_on_five_buses_and_five_lines";
    in_uml(LONGEST, TEST, |_| {
        // A machine that misses deadlines delays the ends of the motions by some cycles.
        completes("lab", slower_laboratory, |record| drop(left_meetings(record)));
    });
}
