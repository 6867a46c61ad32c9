//! The report of a run by the clock.

use kit::mrroc::{Directory, mrroc, shorten};
use kit::{PERIOD, by_the_clock};

#[test]
fn a_robot_by_the_clock_has_its_error_and_loses_no_record() {
    by_the_clock(0.3, PERIOD, || {
        let directory = Directory::new();
        let cell = directory.cell("irb6", shorten);
        let run = mrroc(["run".as_ref(), cell.as_os_str(), "--json".as_ref()]);
        let report = run.json();
        assert_eq!(report["lost_records"], 0, "{report}");
        let peak = report["robots"][0]["position_mm"]["peak"].as_f64();
        assert!(peak > Some(0.01) && peak < Some(1.0), "{report}");
    });
}
