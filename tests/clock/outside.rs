//! Programs of users by the clock.

use std::path::Path;
use std::process::Command;

use kit::mrroc::{Directory, example_program, shorten};
use kit::{PERIOD, by_the_clock};

/// A macrostep of one period leaves the controller less than a period for its answer. In a run by the clock, a longer delay
/// starves the motion, and the test repeats the run.
#[test]
fn a_generator_with_feedback_in_every_period_runs_in_lockstep_and_by_the_clock() {
    let directory = Directory::new();
    let cell = directory.cell("irb6", shorten);
    completes_in_lockstep_and_by_the_clock("feedback", &cell);
}

/// A robot that plans for 50 ms starves no other, not even one that needs a macrostep in every period.
#[test]
fn a_long_plan_of_one_robot_does_not_delay_another() {
    let directory = Directory::new();
    let cell = directory.cell("irb6", |cell| {
        shorten(cell);
        let (mut bus, mut robot) = (cell.bus[0].clone(), cell.robot[0].clone());
        (bus.name, robot.name) = ("second".into(), "second".into());
        bus.interface = "can1".into();
        robot.axis.iter_mut().for_each(|axis| axis.bus = "second".into());
        cell.bus.push(bus);
        cell.robot.push(robot);
        cell.robot.iter_mut().for_each(|robot| robot.program.clear());
    });
    completes_in_lockstep_and_by_the_clock("slow_plans", &cell);
}

fn completes_in_lockstep_and_by_the_clock(program: &str, cell: &Path) {
    let run = |bench| {
        let output = Command::new(example_program(program)).arg(cell).args(["--bench", bench]).output().unwrap();
        assert!(output.status.success(), "{output:?}");
    };
    run("lockstep");
    for _ in 0..2 {
        by_the_clock(0.4, PERIOD / 2, || run("emulated"));
    }
}
