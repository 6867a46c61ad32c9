//! Cycles of start and stop with random signals.

use kit::mrroc::{Directory, binary, root};
use kit::processors;
use kit::start_stop::Place;

#[test]
fn a_cell_that_is_started_and_stopped_leaves_nothing_behind() {
    let _share = processors::take(0.45);
    let directory = Directory::new();
    let place = directory.path("place");
    std::fs::create_dir(&place).unwrap();
    let mut place = Place::new(binary(), &root().join("cells"), &place, 1);
    for cycle in 0..4 {
        place.cycle().unwrap_or_else(|left| panic!("seed 1, cycle {cycle}: {left}"));
    }
    place.finish().unwrap();
    assert_eq!(place.tally.kinds.iter().sum::<u64>(), 4);
}
