//! An error of the class system in the report of a run of two robots.
//!
//! Errors of the other classes: tests of `mrroc/src/tasks`, and `outside.rs` for the report of a program.

use std::ffi::OsString;
use std::fs;

use ::mrroc::cell::Cell;
use canopen::sync::Sync;
use kit::bench::on_vcan;
use kit::mrroc::{Directory, Running, text};
use kit::slow;

use crate::cells_on_vcan::Interfaces;
use crate::second_controller::beside_a_master;
use crate::vcan::started;

#[test]
fn a_system_error_of_one_robot_brakes_both_and_names_robot_step_and_phase() {
    const TEST: &str = "error_classes::a_system_error_of_one_robot_brakes_both_and_names_robot_step_and_phase";
    on_vcan(TEST, |_| {
        let directory = Directory::new();
        // Motion that outlasts the test.
        let slow = text("two-irb6").replace(" velocity = 0.3", " velocity = 0.002");
        let mut cell = Cell::parse(&slow).unwrap();
        slow::shorten(&mut cell);
        let file = directory.write("cell.toml", &toml::to_string(&cell).unwrap());
        let interfaces = Interfaces::of(&cell);
        let command = |name: &str| {
            let options = interfaces.options().map(OsString::from);
            [name.into(), file.clone().into()].into_iter().chain(options)
        };
        let _emulators = started(|| Running::start(command("emulate")));
        let record = directory.path("axes.csv");
        let options = ["--bench=vcan".into(), "--json".into(), "--record".into(), record.clone().into()];
        let run = Running::start(command("run").chain(options));
        let moving = ["left", "right"].map(|robot| format!("{robot}.column,Moving,"));
        run.wait_for(&record, |text| moving.iter().all(|robot| text.matches(robot).count() > 20));
        let mut output = None;
        beside_a_master(interfaces.interface("right"), Sync::default().encode(), cell.period(), || {
            output = Some(run.output());
        });
        let output = output.unwrap();
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        let report = output.json();
        let fault = &report["faults"][0];
        assert_eq!((&fault["robot"], &fault["class"]), (&"right".into(), &"system".into()), "{report}");
        assert_eq!((&fault["instruction"], &fault["phase"]), (&2.into(), &"transfer".into()), "{report}");
        assert!(fault["step"].as_u64().is_some_and(|step| step > 0), "{report}");
        assert!(fault["what"].as_str().unwrap().contains("it sent SYNC"), "{report}");

        let record = fs::read_to_string(record).unwrap();
        let rows = record.lines().skip(1).map(|row| row.split(',').collect::<Vec<_>>());
        let left: Vec<_> = rows.filter(|row| row[2] == "left.wrist-pitch").collect();
        let phases = left.chunk_by(|one, other| one[3] == other[3]).map(|rows| rows[0][3]);
        let phases: Vec<_> = phases.skip_while(|phase| *phase != "Moving").collect();
        assert_eq!(phases[1], "Stopping", "{phases:?}");
        let end = left.last().unwrap();
        assert!(end[3] == "Off" && end[8].parse::<f64>().unwrap().abs() < 0.1, "{end:?}");
    });
}
