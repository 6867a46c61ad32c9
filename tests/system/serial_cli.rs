//! `mrroc run` on serial lines in lockstep.

use std::fs;

use ::mrroc::cell::Cell;
use kit::mrroc::{Directory, SERIAL_CELLS, example, mrroc, text};
use kit::serial::{TRACKING, completed};

/// Tolerance of the counter at the reference: the motion of one cycle at 3.5 rad/s, counts.
const CYCLE: f64 = 5.0;

#[test]
fn serial_cells_run_in_lockstep_the_same_bit_for_bit() {
    let directory = Directory::new();
    for name in SERIAL_CELLS {
        let records = ["a.csv", "b.csv"].map(|record| directory.path(record));
        for record in &records {
            let run = mrroc([
                "run".as_ref(),
                example(name).as_os_str(),
                "--bench=lockstep".as_ref(),
                "--json".as_ref(),
                "--force".as_ref(),
                "--record".as_ref(),
                record.as_os_str(),
            ]);
            let report = completed(&run, name, TRACKING);
            assert_eq!(report["buses"][0]["missed_answers"], 0, "{report}");
            let cell = Cell::parse(&text(name)).unwrap();
            let home = cell.robot[0].arm().unwrap().robot().home();
            for (axis, home) in report["axes"].as_array().unwrap().iter().zip(home.iter()) {
                let counts = 4000.0 / std::f64::consts::TAU;
                let expected = (home * counts).floor() - ((home + 20.0) * counts).floor();
                let offset = axis["homing_offset_counts"].as_f64().unwrap();
                assert!((offset - expected).abs() <= CYCLE, "{axis}, {expected}");
            }
        }
        let [first, second] = records.each_ref().map(|record| fs::read(record).unwrap());
        assert!(first == second, "{name}: the records differ");
        assert!(first.len() > 1_000_000, "{name}: {} bytes", first.len());
    }
}
