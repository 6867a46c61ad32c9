//! Agreement of `check` and `run`. A cell that is ready runs. A cell that cannot run is refused by both commands with
//! the same text, which names file, line and key.

use std::fs;
use std::path::Path;

use kit::mrroc::{Directory, Output, mrroc, shorten, text};
use kit::refusals::refused;

fn check(cell: &Path) -> Output {
    mrroc(["check".as_ref(), cell.as_os_str()])
}

fn run(cell: &Path) -> Output {
    let run = ["run".as_ref(), cell.as_os_str(), "--bench=lockstep".as_ref()];
    mrroc(run)
}

/// An example cell, a text in it, the replacement of the text, and the refused key.
type Case = (&'static str, &'static str, &'static str, &'static str);

const REFUSED: &[Case] = &[
    ("irb6", "max_acceleration = 1500.0", "max_acceleration = 1e-3", "axis[0].max_acceleration"),
    ("irb6", "max_acceleration = 1500.0", "max_acceleration = 1e9", "axis[0].max_acceleration"),
    ("irb6", "following_error = 2.0", "following_error = 1e-300", "axis[0].following_error"),
    ("irb6", "following_error = 2.0", "following_error = 1e-6", "axis[0].following_error"),
    ("irb6", "following_error = 2.0", "following_error = 1e9", "axis[0].following_error"),
    ("irb6", "following_error = 2.0", "following_error = 1e12", "axis[0].following_error"),
    ("irb6", "search_velocity = 15.0", "search_velocity = 1e-300", "axis[0].homing.search_velocity"),
    ("irb6", "search_velocity = 15.0", "search_velocity = 0.02", "axis[0].homing.search_velocity"),
    ("irb6", "zero_velocity = 3.5", "zero_velocity = 1e-9", "axis[0].homing.zero_velocity"),
    ("irb6", "acceleration = 150.0", "acceleration = 1e-6", "axis[0].homing.acceleration"),
    ("irb6", "acceleration = 150.0", "acceleration = 1e9", "axis[0].homing.acceleration"),
    ("irb6", "rated_torque = 0.42", "rated_torque = 1e-6", "axis[0].drive.rated_torque"),
    ("irb6", "rated_torque = 0.42", "rated_torque = 1e9", "axis[0].drive.rated_torque"),
    ("irb6", "method = 11", "method = 1", "axis[0].homing.method"),
    ("irb6", "method = 11", "method = 17", "axis[0].homing.method"),
    ("irb6", "method = 11", "method = 2", "axis[0].homing.method"),
    ("irb6", "period_us = 2000", "period_us = 1000000", "period_us"),
    ("irb6", "[[robot]]", "[[bus]]\nname = \"spare\"\ninterface = \"can1\"\n\n[[robot]]", "bus[1]"),
    ("irb6", "interface = \"can0\"", "interface = \"\"", "bus[0].interface"),
    ("irb6", "interface = \"can0\"", "interface = \"can 0\"", "bus[0].interface"),
    ("irb6", "interface = \"can0\"", "interface = \"can/0\"", "bus[0].interface"),
    ("irb6", "interface = \"can0\"", "interface = \"can0\\u0000\"", "bus[0].interface"),
    ("irb6", "interface = \"can0\"", "interface = \"a-name-of-16-byte\"", "bus[0].interface"),
    ("irb6", "interface = \"can0\"", "interface = \"slcan:\"", "bus[0].interface"),
    ("irb6", "interface = \"can0\"", "interface = \"epos4:/dev/ttyACM0\"", "bus[0].interface"),
    ("irb6-serial", "search_velocity = 15.0", "search_velocity = 1e-300", "axis[0].homing.search_velocity"),
    ("irb6-serial", "search_velocity = 15.0", "search_velocity = 1e-9", "axis[0].homing.search_velocity"),
    ("irb6-serial", "zero_velocity = 3.5", "zero_velocity = 1e-300", "axis[0].homing.zero_velocity"),
    ("irb6-serial", "zero_velocity = 3.5", "zero_velocity = 1e-9", "axis[0].homing.zero_velocity"),
    ("irb6-serial", "acceleration = 150.0", "acceleration = 1501.0", "axis[0].homing.acceleration"),
    ("irb6-serial", "max_velocity = 250.0", "max_velocity = 1e9", "axis[0].max_velocity"),
    ("irb6-serial", "following_error = 2.0", "following_error = 1e-9", "axis[0].following_error"),
    ("irb6-serial", "torque_constant = 0.105", "torque_constant = 1e300", "controller.torque_constant"),
    ("irb6-serial", "position_gain = 25.0", "position_gain = 1e300", "cascade.position_gain"),
    ("irb6-serial", "velocity_gain = 0.043", "velocity_gain = 0.215", "cascade.velocity_gain"),
    ("irb6-serial", "integral_rate = 10.0", "integral_rate = 500.0", "cascade.integral_rate"),
    ("irb6-serial", "line = \"/dev/ttyMI8\"", "line = \"\"", "controller.line"),
    ("irb6-touch", "bus = \"arm\"", "bus = \"leg\"", "io[0].bus"),
    ("irb6-touch", "node = 40", "node = 3", "io[0].node"),
    ("irb6-touch", "name = \"gate\"", "name = \"touch\"", "io[0].input[1].name"),
    ("irb6-touch", "line = 3", "line = 64", "io[0].input[1].line"),
    ("irb6-touch", "inhibit_us = 2000", "inhibit_us = 150", "io[0].inhibit_us"),
    ("rnt", "position_gain = 50.0", "position_gain = 1e300", "proportional.position_gain"),
    ("rnt", "position_gain = 50.0", "position_gain = 200.0", "proportional.position_gain"),
    (
        "polycrank",
        "interface = \"can1\"",
        "interface = \"slcan:/dev/ttyACM0@115200\"\n[[bus]]\nname = \"third\"\ninterface = \"slcan:/dev/ttyACM0\"",
        "bus[2]",
    ),
];

#[test]
fn what_a_run_would_refuse_a_check_refuses_with_file_line_and_key() {
    let directory = Directory::new();
    for &(example, good, bad, key) in REFUSED {
        let text = text(example);
        let at = text.find(good).unwrap_or_else(|| panic!("no {good:?}"));
        // A table inserted before another table begins on the line of the old table.
        let line = text[..at].matches('\n').count() + 1;
        let line = line + bad.rfind("[[bus]]").map_or(0, |at| bad[..at].matches('\n').count());
        let cell = directory.write("cell.toml", &text.replacen(good, bad, 1));
        let place = format!("mrroc: {}:{line}: ", cell.display());
        let (check, run) = (check(&cell), run(&cell));
        refused(&check, &[&place, key]);
        assert_eq!(check.stderr, run.stderr, "{bad}");
        let emulate = mrroc(["emulate".as_ref(), cell.as_os_str()]);
        assert_eq!(check.stderr, emulate.stderr, "{bad}");
    }
}

#[test]
fn a_period_too_long_for_a_loop_of_the_host_is_refused_at_its_gain() {
    let directory = Directory::new();
    for (example, period, key) in [
        ("irb6-serial", "6000", "controller.loop.law.cascade.velocity_gain"),
        ("irb6-hi-moxa", "10000", "controller.loop.law.cascade.velocity_gain"),
        ("rnt", "13000", "drive.loop.law.proportional.position_gain"),
    ] {
        let text = text(example).replacen("period_us = 2000", &format!("period_us = {period}"), 1);
        let cell = directory.write("cell.toml", &text);
        let said = format!("axis[0].{key}: is ");
        refused(&check(&cell), &[&said, "gain margin of 2 at this period and dead time"]);
        assert_eq!(check(&cell).stderr, run(&cell).stderr);
    }
}

#[test]
fn a_search_of_any_speed_ends_a_check_without_a_panic() {
    let directory = Directory::new();
    for key in ["search_velocity = 15.0", "zero_velocity = 3.5"] {
        for value in ["1e-300", "5e-324", "1e-9", "0.001", "1e11", "1e300"] {
            let name = key.split(' ').next().unwrap();
            let given = format!("{name} = {value}");
            let text = text("irb6-serial").replacen(key, &given, 1);
            let cell = directory.write("cell.toml", &text);
            refused(&check(&cell), &[&format!("homing.{name}: is {}", shown(value))]);
        }
    }
}

/// A number in the notation of messages.
fn shown(value: &str) -> String {
    ::mrroc::cell::Figure(value.parse().unwrap()).to_string()
}

/// Cells with values at the limits of the accepted ranges.
const ACCEPTED: &[Case] = &[
    ("irb6", "following_error = 2.0", "following_error = 0.016", ""),
    ("irb6", "following_error = 2.0", "following_error = 900.0", ""),
    ("irb6", "max_acceleration = 1500.0", "max_acceleration = 1e7", ""),
    ("irb6", "max_velocity = 250.0", "max_velocity = 9e3", ""),
    ("irb6", "rated_torque = 0.42", "rated_torque = 0.001", ""),
    ("irb6", "rated_torque = 0.42", "rated_torque = 4294.0", ""),
    ("irb6", "vendor = 0xFB", "vendor = 1", ""),
    ("irb6", "vendor = 0xFB", "vendor = 0", ""),
    ("irb6", "acceleration = 150.0", "acceleration = 1500.0", ""),
    ("irb6", "counts_per_revolution = 4000", "counts_per_revolution = 1000000", ""),
    ("irb6", "period_us = 2000", "period_us = 100000", ""),
    ("irb6", "macrostep = 10", "macrostep = 1", ""),
    ("irb6", "macrostep = 10", "macrostep = 1000", ""),
];

#[test]
fn what_a_check_calls_ready_runs() {
    let directory = Directory::new();
    for &(example, good, bad, _) in ACCEPTED {
        let short = directory.cell(example, |cell| {
            shorten(cell);
            cell.robot[0].program.truncate(1);
        });
        let text = fs::read_to_string(short).unwrap();
        let bad = match good.starts_with("vendor") {
            true => text.replacen("vendor = 251", bad, 1),
            false => text.replacen(good, bad, 1),
        };
        assert_ne!(bad, text, "{good}");
        let cell = directory.write("ends.toml", &bad);
        let (check, run) = (check(&cell), run(&cell));
        assert_eq!(check.status.code(), Some(0), "{good}: {check:?}");
        assert_eq!(run.status.code(), Some(0), "{bad}: {run:?}");
    }
}

#[test]
fn a_method_for_another_wiring_than_the_emulated_one_is_warned_of_and_runs_on_no_emulated_robot() {
    let directory = Directory::new();
    let (below, above) = ("which leaves the home switch downwards", "which turns round at a positive limit switch");
    for (example, good, bad, why) in [
        ("rnt", "method = 11", "method = 7", below),
        ("rnt", "method = 11", "method = 23", below),
        ("polycrank", "method = 11", "method = 7", above),
        ("lab", "method = 37", "method = 11", "which needs a home switch"),
    ] {
        let text = text(example);
        let line = text[..text.find(good).unwrap()].matches('\n').count() + 1;
        let cell = directory.write("cell.toml", &text.replacen(good, bad, 1));
        let problem = format!(
            "mrroc: {}:{line}: robot[{}].axis[0].homing.{}, {why}",
            cell.display(),
            if example == "lab" { 5 } else { 0 },
            bad.replace("= ", "").replacen(" ", ": is ", 1)
        );
        let check = check(&cell);
        assert_eq!(check.status.code(), Some(0), "{check:?}");
        assert!(check.stderr.starts_with(&problem), "{check:?}");
        assert!(check.stderr.contains("wired otherwise"), "{check:?}");
        refused(&run(&cell), &[&problem]);
        let emulate = mrroc(["emulate".as_ref(), cell.as_os_str()]);
        refused(&emulate, &[&problem]);
    }
}

#[test]
fn names_lead_no_file_out_of_its_directory() {
    let directory = Directory::new();
    let outside = directory.path("evil");
    let inside = directory.path("in");
    for name in ["../evil", "../../evil", "/evil", "a\\nb", ""] {
        let given = format!("name = \"{name}\"");
        let text = text("irb6-serial").replacen("name = \"column\"", &given, 1);
        let cell = directory.write("cell.toml", &text);
        let emulate = ["emulate".as_ref(), cell.as_os_str(), "--serial".as_ref(), inside.as_os_str()];
        refused(&mrroc(emulate), &["robot[0].axis[0].name: ", "must be a name"]);
        assert!(!outside.exists() && !inside.exists());
    }
}

#[test]
fn an_axis_is_called_by_its_name_in_every_refusal() {
    let directory = Directory::new();
    // The program leaves the range of the axis that the cell file gives.
    let range = "name = \"lower-arm\"\nmin_position = -10.0\nmax_position = 10.0\n";
    let text = text("irb6").replacen("name = \"lower-arm\"\n", range, 1);
    let cell = directory.write("cell.toml", &text);
    let check = check(&cell);
    refused(&check, &["robot[0].program[0]: ", "axis lower-arm: set-point"]);
    assert_eq!(check.stderr, run(&cell).stderr);
    let pose = "poses = [[0.4, -1.8,";
    let beyond = self::text("irb6").replacen(pose, "poses = [[0.4, -0.5,", 1);
    let cell = directory.write("cell.toml", &beyond);
    let check = self::check(&cell);
    refused(&check, &["joints.poses[0]: axis lower-arm: joint at -0.5"]);
    assert!(!check.stderr.contains("axis 1"), "{check:?}");
}
