//! The file of the steps of generators, and runs of the examples in lockstep.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::mrroc::{Directory, example_program};

/// The steps, the record and the report of an example in lockstep.
pub fn run(program: &str, cell: &Path) -> (String, String, Value) {
    let directory = Directory::new();
    let [steps, record] = ["steps.csv", "axes.csv"].map(|name| directory.path(name));
    let mut command = Command::new(example_program(program));
    command.arg(cell).args(["--bench", "lockstep", "--json", "--steps"]).arg(&steps);
    let output = command.arg("--record").arg(&record).output().unwrap();
    assert!(output.status.success(), "{program}: {output:?}");
    let mut report: Value = serde_json::from_slice(&output.stdout).unwrap();
    // The only time of the host.
    report.as_object_mut().unwrap().remove("realtime_factor").unwrap();
    let [steps, record] = [steps, record].map(|path| fs::read_to_string(path).unwrap());
    (steps, record, report)
}

/// A line of a file of steps.
pub struct Line<'a> {
    pub time_s: f64,
    pub agent: &'a str,
    pub instruction: u64,
    pub generator: &'a str,
    pub class: u8,
    pub macrostep: u64,
    pub event: &'a str,
    pub memory: &'a str,
}

/// The lines of a file of steps.
pub fn lines(steps: &str) -> impl Iterator<Item = Line<'_>> {
    steps.lines().skip(1).map(|line| {
        // The name of a generator is in quotes, and may have commas.
        let [before, generator, after] = line.splitn(3, '"').collect::<Vec<_>>()[..] else { panic!("{line}") };
        let [time_s, agent, instruction, ""] = before.split(',').collect::<Vec<_>>()[..] else { panic!("{line}") };
        let ["", class, macrostep, event, _, memory] = after.split(',').collect::<Vec<_>>()[..] else {
            panic!("{line}")
        };
        let number = |text: &str| text.parse().unwrap();
        let (instruction, macrostep) = (number(instruction), number(macrostep));
        let (time_s, class) = (time_s.parse().unwrap(), class.parse().unwrap());
        Line { time_s, agent, instruction, generator, class, macrostep, event, memory }
    })
}
