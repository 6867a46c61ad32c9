//! Steps of one example per class on benches by the clock, compared with the steps of the same cell in lockstep.
//!
//! A clock and a loaded host decide when a step takes place, and measured values decide how many steps a motion with
//! feedback has. The flow chart of the steps is the same on every bench, and so are the number and the memory of steps of
//! class 0.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::path::Path;
use std::thread;
use std::time::Duration;

use ::mrroc::cell::Cell;
use kit::bench::in_uml;
use kit::by_the_clock;
use kit::mrroc::{Directory, Output, Running, example_program, text};
use kit::slow;
use kit::steps::{self, Line, lines};
use serde_json::json;

use crate::cells_on_vcan::Interfaces;
use crate::vcan::started;

/// One example per class, 0 to 7, and an example of force control, with their cells.
const EXAMPLES: [(&str, &str); 9] = [
    ("own_generator", "irb6"),
    ("feedback", "irb6"),
    ("until_touch", "irb6-touch"),
    ("latch_edge", "irb6-touch"),
    ("dispatch", "two-irb6"),
    ("carry_bar", "two-irb6"),
    ("handshake", "irb6-touch"),
    ("raise_tray", "two-irb6-gate"),
    ("force_table", "irb6-force"),
];

/// Time limit of all runs in the test machine.
const LONGEST: Duration = Duration::from_secs(500);

/// Largest number of poses of one motion of the examples.
const MOST_POSES: usize = 2;

/// Servo period of the cells, and mean use of processors by a run.
const SLOW: Duration = Duration::from_millis(20);
const PROCESSORS: f64 = 0.2;

/// What a step does.
#[derive(Debug, PartialEq)]
struct Step<'a> {
    instruction: u64,
    generator: &'a str,
    class: u8,
    events: Vec<&'a str>,
    /// Number and digest of the memory of a step that depends on no measured value.
    unmeasured: Option<(u64, &'a str)>,
}

/// The steps of an agent without repetitions. A task that uses a sensor may plan its motions from readings: none of its
/// steps counts as unmeasured.
fn chart<'a>(file: &'a str, agent: &str) -> Vec<Step<'a>> {
    let sensed = lines(file).any(|line| line.class & 2 != 0);
    let (mut steps, mut last) = (Vec::<Step>::new(), None);
    for Line { instruction, generator, class, macrostep, event, memory, .. } in
        lines(file).filter(|line| line.agent == agent)
    {
        if last.replace((instruction, macrostep)) != Some((instruction, macrostep)) {
            let unmeasured = (class == 0 && !sensed).then_some((macrostep, ""));
            steps.push(Step { instruction, generator, class, events: Vec::new(), unmeasured });
        }
        let step = steps.last_mut().unwrap();
        step.events.push(event);
        if let Some((_, digest)) = step.unmeasured.as_mut().filter(|_| event == "commit") {
            *digest = memory;
        }
    }
    steps.dedup();
    steps
}

/// An example cell for a clock on a loaded host. Touch probe and light gate report after `edge`, s, and stay.
fn patient(cell: &mut Cell, edge: f64) {
    slow::shorten(cell);
    (cell.period_us, cell.macrostep) = (20_000, 2);
    for sensor in &mut cell.force_sensor {
        sensor.tolerated_missing = 100;
    }
    for robot in &mut cell.robot {
        if let Some(law) = &mut robot.force_law {
            law.max_age_periods = 100;
            // One row of the table.
            for key in ["in_cycle", "in_macrosteps"] {
                cell.task.insert(key.to_owned(), toml::Value::Array(Vec::new()));
            }
            cell.task.insert("rows".to_owned(), toml::Value::Array(vec![toml::Value::Integer(0)]));
        }
    }
    for io in &mut cell.io {
        io.event_timer_ms = 200;
        for input in &mut io.input {
            let closed = input.inverted.then_some(0.0);
            input.emulated_edges_s = closed.into_iter().chain([edge, 300.0]).collect();
        }
    }
}

/// Runs an example on a bench by the clock, and compares its steps with those in lockstep.
fn check(program: &str, cell: &Path, directory: &Directory, run: impl Fn(&[OsString]) -> Output) {
    let file = directory.path("clock.csv");
    let arguments = [cell.into(), "--json".into(), "--force".into(), "--steps".into(), file.clone().into()];
    let (in_lockstep, ..) = steps::run(program, cell);
    let agents: BTreeSet<_> = lines(&in_lockstep).map(|line| line.agent).collect();
    by_the_clock(PROCESSORS, SLOW, || {
        let output = run(&arguments);
        assert_eq!(output.status.code(), Some(0), "{program}: {output:?}");
        let report = output.json();
        assert_eq!((&report["outcome"], &report["faults"]), (&json!("completed"), &json!([])), "{program}: {report}");
        let by_clock = std::fs::read_to_string(&file).unwrap();
        // An emulated edge has a fixed time, which a motion of a late program may miss.
        if let Err(difference) = compare(&agents, &in_lockstep, &by_clock) {
            panic!("{program} on {}: {difference}", report["bench"]);
        }
        println!("{program} on {}: {agents:?}, {} events", report["bench"], by_clock.lines().count());
    });
}

/// Whether the charts differ as by a start of planned motions some counts elsewhere, where a search by the clock ends:
/// a motion to a pose may take a macrostep more or less.
fn start_elsewhere(expected: &[Step], found: &[Step]) -> bool {
    let alike = |one: &Step, other: &Step| {
        let [one, other] = [one, other].map(|step| (step.instruction, step.generator, step.class, &step.events));
        one == other
    };
    let expected: Vec<_> = expected.chunk_by(alike).collect();
    let found: Vec<_> = found.chunk_by(alike).collect();
    let same = |(one, other): (&&[Step], &&[Step])| {
        let permitted = if one[0].class == 0 { MOST_POSES } else { 0 };
        alike(&one[0], &other[0]) && one.len().abs_diff(other.len()) <= permitted
    };
    expected.len() == found.len() && expected.iter().zip(&found).all(same)
}

/// Compares the steps of the agents in lockstep with those of a run by the clock.
fn compare(agents: &BTreeSet<&str>, in_lockstep: &str, by_clock: &str) -> Result<(), String> {
    for agent in agents {
        let [expected, found] = [in_lockstep, by_clock].map(|file| chart(file, agent));
        if expected != found && !start_elsewhere(&expected, &found) {
            let differ = expected.iter().zip(&found).find(|(one, other)| one != other);
            return Err(format!("{agent}: {} and {} steps: {differ:#?}", expected.len(), found.len()));
        }
    }
    Ok(())
}

#[test]
fn an_example_of_each_class_has_the_steps_of_lockstep_on_emulated_buses_by_the_clock() {
    // Most of their time the programs wait.
    thread::scope(|scope| {
        for (program, cell) in EXAMPLES {
            scope.spawn(move || {
                let directory = Directory::new();
                let cell = directory.cell(cell, |cell| patient(cell, 8.0));
                let run = |arguments: &[OsString]| Running::program(&example_program(program), arguments).output();
                check(program, &cell, &directory, run);
            });
        }
    });
}

#[test]
fn an_example_has_the_steps_of_lockstep_on_pseudo_terminals_by_the_clock() {
    for program in ["own_generator", "first_program"] {
        let directory = Directory::new();
        let cell = directory.cell("irb6-serial", crate::serial_cli::patient);
        check(program, &cell, &directory, |arguments| Running::program(&example_program(program), arguments).output());
    }
}

#[test]
fn an_example_of_each_class_has_the_steps_of_lockstep_on_vcan() {
    const TEST: &str = "bench_steps::an_example_of_each_class_has_the_steps_of_lockstep_on_vcan";
    in_uml(LONGEST, TEST, |_| {
        for (program, cell) in EXAMPLES {
            let directory = Directory::new();
            let mut parsed = Cell::parse(&text(cell)).unwrap();
            patient(&mut parsed, 15.0);
            let file = directory.write("cell.toml", &toml::to_string(&parsed).unwrap());
            let interfaces = Interfaces::of(&parsed);
            check(program, &file, &directory, |arguments| {
                let mut options: Vec<_> = interfaces.options().map(OsString::from).collect();
                if !parsed.force_sensor.is_empty() {
                    let mut ttys = OsString::from("--serial=");
                    ttys.push(directory.path("ttys"));
                    options.push(ttys);
                }
                let emulate = ["emulate".into(), file.clone().into()].into_iter().chain(options.clone());
                let _emulators = started(|| Running::start(emulate));
                let arguments = arguments.iter().cloned().chain(options).chain(["--bench=vcan".into()]);
                Running::program(&example_program(program), arguments).output()
            });
        }
    });
}
