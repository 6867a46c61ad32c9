//! Refusals of `--spikes`.

use kit::mrroc::{example, mrroc};
use kit::refusals::refused;

#[test]
fn a_file_that_cannot_be_written_is_refused_before_anything_moves() {
    let cell = example("irb6");
    let cell = cell.to_str().expect("a path of letters");
    let nowhere = "--spikes=/no/such/place.json";
    for (words, needle) in [
        (&["run", cell, nowhere][..], "/no/such/place.json"),
        (&["jitter", "--cell", cell, nowhere], "/no/such/place.json"),
        (&["jitter", nowhere], "/no/such/place.json"),
        (&["run", cell, "--bench=lockstep", nowhere], "lockstep"),
    ] {
        refused(&mrroc(words), &["--spikes", needle]);
    }
}
