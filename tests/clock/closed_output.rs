//! A reader that closes the output before the answer makes a measurement or an examination of the host fail.

use kit::closed_output::is_an_error;
use kit::mrroc::{Directory, shorten};
use kit::processors;

#[test]
fn a_measurement_that_nobody_reads_is_an_error() {
    let _share = processors::take(0.3);
    let directory = Directory::new();
    let cell = directory.cell("irb6", shorten);
    is_an_error(&[
        ("doctor", Some(cell.as_os_str())),
        ("doctor --json", Some(cell.as_os_str())),
        ("jitter --duration=1s", None),
        ("jitter --duration=1s --json", None),
    ]);
}
