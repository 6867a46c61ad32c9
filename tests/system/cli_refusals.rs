//! Refusals of `mrroc`: one line that names the problem, its place and its cause; exit status 2; no motion.

use std::path::Path;
use std::process::Command;

use kit::mrroc::{Directory, Output, binary, enables, example, mrroc, text, trace};
use kit::refusals::refused;

pub(crate) fn run_in_lockstep(cell: &Path, log: &Path) -> Output {
    mrroc([
        "run".as_ref(),
        cell.as_os_str(),
        "--bench=lockstep".as_ref(),
        "--force".as_ref(),
        "--trace".as_ref(),
        log.as_os_str(),
    ])
}

/// The example cell with the first `good` replaced by `bad`, and the line number, from 1, of the replacement.
fn spoilt(good: &str, bad: &str) -> (String, usize) {
    let text = text("irb6");
    let at = text.find(good).unwrap_or_else(|| panic!("no {good:?} in the cell"));
    (text.replacen(good, bad, 1), text[..at].matches('\n').count() + 1)
}

/// A name, a text in the cell, the replacement of the text, and the required parts of the refusal.
type Case = (&'static str, &'static str, &'static str, &'static [&'static str]);

/// Cells with internal errors. The refusal names the line of the error.
const FILES: &[Case] = &[
    ("broken TOML", "period_us = 2000", "period_us = = 1", &["extra `=`"]),
    ("unclosed", "[[bus]]", "[[bus]", &["table"]),
    ("unknown key", "macrostep = 10", "macrosteps = 10", &["macrosteps: is an unknown key", "\"macrostep\""]),
    ("wrong type", "period_us = 2000", "period_us = \"2 ms\"", &["period_us: is \"2 ms\", must be a whole number"]),
    ("NaN", "max_velocity = 250.0", "max_velocity = nan", &["robot[0].axis[0].max_velocity: ", "finite"]),
    ("infinity", "[[0.4, ", "[[inf, ", &["robot[0].program[0].joints.poses[0][0]: ", "finite"]),
    (
        "limits upside down",
        "max_velocity = 250.0",
        "min_position = 5.0\nmax_position = -5.0\nmax_velocity = 250.0",
        &["robot[0].axis[0].min_position: ", "is 5, not below the upper limit -5"],
    ),
    (
        "duplicate node",
        "node = 2",
        "node = 1",
        &["robot[0].axis[1].node: ", "node 1 of bus \"arm\"", "twice", "robot[0].axis[0]"],
    ),
    ("unknown bus", "bus = \"arm\"", "bus = \"leg\"", &["robot[0].axis[0].bus: ", "\"leg\""]),
    ("period", "period_us = 2000", "period_us = 0", &["period_us: ", "between 1000 and 100000"]),
    (
        "unreachable pose",
        "position = [0.85, 0.0, 0.85]",
        "position = [3.0, 0.0, 0.85]",
        &["robot[0].program[1]", "m out of reach"],
    ),
    (
        "pose beyond a limit",
        "[[0.4, -1.8,",
        "[[0.4, -0.5,",
        &["robot[0].program[0]", "lower-arm", "-0.5", "beyond its limit -0.87"],
    ),
];

#[test]
fn a_wrong_cell_is_refused_at_its_line() {
    let directory = Directory::new();
    for &(name, good, bad, needles) in FILES {
        let (text, line) = spoilt(good, bad);
        let cell = directory.write("wrong.toml", &text);
        let place = format!("{}:{line}: ", cell.display());
        let log = directory.path("wrong.log");
        for run in [run_in_lockstep(&cell, &log), mrroc(["check".as_ref(), cell.as_os_str()])] {
            refused(&run, &[&[place.as_str()], needles].concat());
            assert!(!log.exists(), "{name}: a bus was opened");
        }
    }
}

#[test]
fn a_pose_is_refused_at_its_own_line() {
    let (text, line) = spoilt(" [0.0, -1.5,", "\n [0.0, -0.5,");
    let directory = Directory::new();
    let cell = directory.write("late.toml", &text);
    // The line after the first line of the motion.
    let place = format!("late.toml:{}: robot[0].program[0].joints.poses[1]: ", line + 1);
    refused(&mrroc(["check".as_ref(), cell.as_os_str()]), &[&place, "lower-arm"]);
}

/// Cells that do not match their drives. No line is known for these errors; the refusal names bus, axis and node.
const DRIVES: &[Case] = &[
    (
        "a node that never boots",
        "node = 3",
        "node = 3\nemulator = { absent = true }",
        &["bus arm, axis upper-arm: node 3: ", "never booted", "2.0s"],
    ),
    (
        "another identity",
        "node = 3",
        "node = 3\nemulator = { vendor = 0x1234 }",
        &["bus arm, axis upper-arm: node 3: ", "0x1018:01", "0x00001234", "0x000000fb"],
    ),
    (
        "an object that is not there",
        "rated_torque = 0.42 }",
        "rated_torque = 0.42, parameter = [{ index = 0x2FFF, value = 1, bytes = 4 }] }",
        &["bus arm, axis column: node 1: ", "0x2fff:00", "0x06020000", "object does not exist"],
    ),
    (
        "an object that cannot be written",
        "rated_torque = 0.42 }",
        "rated_torque = 0.42, parameter = [{ index = 0x6041, value = 1, bytes = 2 }] }",
        &["bus arm, axis column: node 1: ", "0x6041:00", "0x06010002", "read-only"],
    ),
];

#[test]
fn a_drive_that_does_not_come_up_is_refused_and_none_is_switched_on() {
    let directory = Directory::new();
    for &(name, good, bad, needles) in DRIVES {
        let cell = directory.write("drives.toml", &spoilt(good, bad).0);
        let log = directory.path("drives.log");
        refused(&run_in_lockstep(&cell, &log), needles);
        let frames = trace(&log);
        assert!(!frames.is_empty(), "{name}: the trace of the refusal is lost");
        assert_eq!(enables(&frames), 0, "{name}");
    }
}

#[test]
fn a_missing_file_is_refused_by_every_command() {
    for command in ["run", "check", "emulate"] {
        let run = mrroc([command, "no-such-cell.toml"]);
        refused(&run, &["no-such-cell.toml: ", "No such file"]);
    }
    refused(&mrroc(["run".as_ref(), kit::mrroc::root().as_os_str()]), &["directory"]);
}

#[test]
fn an_absent_interface_is_refused_by_name() {
    for bench in ["vcan", "card"] {
        let run = mrroc([
            "run".as_ref(),
            example("irb6").as_os_str(),
            "--bench".as_ref(),
            bench.as_ref(),
            "--can=nosuch0".as_ref(),
        ]);
        // If the kernel has no CAN, the line says so and names the remedy.
        refused(&run, &["bus arm: nosuch0: "]);
    }
    let run = mrroc(["emulate".as_ref(), example("irb6").as_os_str(), "--can=nosuch0".as_ref()]);
    refused(&run, &["bus arm: nosuch0: "]);
}

#[test]
fn options_that_contradict_each_other_are_refused() {
    let cell = example("irb6");
    let cases: &[(&[&str], &str)] = &[
        (&["--can=vcan0"], "--bench vcan"),
        (&["--bench=vcan", "--can=leg=vcan0"], "no bus \"leg\""),
        (&["--bench=vcan", "--set-bitrate"], "--bench card"),
        (&["--bench=lockstep", "--trace=/no/such/place.log"], "/no/such/place.log"),
        (&["--bench=lockstep", "--record=/no/such/place.csv"], "/no/such/place.csv"),
        (&["--bench=lockstep", "--speed=1e-9"], "at least 0.1 and at most 100"),
        (&["--bench=lockstep", "--speed=101"], "at least 0.1 and at most 100"),
        (&["--bench=lockstep", "--carved=/tmp"], "--carved needs a workpiece"),
    ];
    for (options, needle) in cases {
        let arguments = ["run".as_ref(), cell.as_os_str()];
        let options = options.iter().map(AsRef::as_ref);
        refused(&mrroc(arguments.into_iter().chain(options)), &[needle]);
    }
}

#[test]
fn each_bus_has_one_interface_and_each_interface_one_bus() {
    let cell = example("polycrank");
    let cases: &[(&[&str], &[&str])] = &[
        (&["--can=vcan0"], &["2 buses", "BUS=vcan0", "upper, forearm"]),
        (&["--can=leg=vcan0"], &["no bus \"leg\"", "upper, forearm"]),
        (&["--can=upper=vcan0", "--can=upper=vcan1"], &["--can upper=vcan1", "already", "--can upper=vcan0"]),
        (&["--can=upper=vcan0", "--can=forearm=vcan0"], &["bus forearm: vcan0 is that of bus upper", "BUS=IFACE"]),
        // The other bus keeps the interface of the cell file.
        (&["--can=upper=can1"], &["bus forearm: can1 is that of bus upper"]),
        (&["--can=upper=nosuch0", "--can=forearm=nosuch1"], &["bus upper: nosuch0: "]),
    ];
    let commands: [&[&str]; 2] = [&["run", "--bench=vcan"], &["emulate"]];
    for (options, needles) in cases {
        for command in commands {
            let arguments = command.iter().chain(*options).map(AsRef::as_ref);
            refused(&mrroc(arguments.chain([cell.as_os_str()])), needles);
        }
    }
    // A bus behind an adapter's tty needs no interface, so the other bus may use the interface.
    let directory = Directory::new();
    let link = format!("--slcan=forearm={}", directory.path("tty").display());
    let emulate = ["emulate", "--can=upper=can1", &link].map(AsRef::as_ref);
    refused(&mrroc(emulate.into_iter().chain([cell.as_os_str()])), &["bus upper: can1: "]);
}

#[test]
fn the_variable_of_a_guardian_ends_no_command_in_silence() {
    for value in ["", "1", "x", "99"] {
        let run = Command::new(binary()).arg("--version").env("MRROC_GUARDIAN", value).output().unwrap();
        let said = String::from_utf8(run.stderr).unwrap();
        assert_eq!(run.status.code(), Some(2), "{value:?}: {said}");
        assert!(
            said.contains("MRROC_GUARDIAN is set, but no controller has started this process"),
            "{value:?}: {said}"
        );
        assert!(said.contains("unset it"), "{value:?}: {said}");
    }
}
