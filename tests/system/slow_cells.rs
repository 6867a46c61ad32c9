//! The slower laboratory of the benches by the clock, in virtual time.

use std::ffi::OsString;

use kit::mrroc::{self, Directory};
use kit::slow::{slower, slower_laboratory};
use serde_json::json;

/// Checks the properties that a run on vcan cannot separate from delays of the test machine.
#[test]
fn the_slower_laboratory_follows_its_set_points_in_virtual_time() {
    let directory = Directory::new();
    let mut cell = slower("lab", slower_laboratory);
    for axis in &mut cell.robot[0].axis {
        axis.following_error = 10.0;
    }
    let file = directory.write("cell.toml", &toml::to_string(&cell).unwrap());
    let arguments = ["--bench=lockstep", "--json"].map(OsString::from);
    let run = mrroc::mrroc(["run".into(), file.into()].into_iter().chain(arguments));
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    assert_eq!(run.json()["faults"], json!([]), "{run:?}");
}

/// The bring-up listens for three periods of the heartbeat, so the buses come up two seconds apart.
#[test]
fn buses_that_come_up_one_after_the_other_find_no_drive_silent() {
    let directory = Directory::new();
    for slow in [0, 1] {
        let cell = directory.cell("polycrank", |cell| {
            mrroc::shorten(cell);
            cell.bus[slow].heartbeat_ms = 1000;
        });
        let run = mrroc::mrroc(["run".into(), cell.into(), OsString::from("--bench=lockstep"), "--json".into()]);
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        assert_eq!(run.json()["faults"], json!([]), "{run:?}");
    }
}
