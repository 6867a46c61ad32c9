//! Refusals of `mrroc jitter`.

use std::process::Command;

use kit::mrroc::{Directory, Output, binary, example, mrroc};
use kit::refusals::refused;

#[test]
fn what_is_no_cell_to_measure_is_refused() {
    let cell = example("irb6");
    let cell = cell.to_str().unwrap();
    let serial = example("irb6-serial");
    let serial = serial.to_str().unwrap();
    for (arguments, needles) in [
        (&["--cell", cell, "--period", "1500us"][..], ["--period", "a multiple of 1ms"]),
        (&["--cell", cell, "--period", "2s"], ["--period", "50us and 1s"]),
        (&["--cell", cell, "--priority", "0"], ["--priority", "between 1 and 99"]),
        (&["--cell", "/none.toml"], ["/none.toml", "No such file"]),
        (&["--bench", "vcan"], ["--bench", "--cell"]),
        (&["--load", "bus"], ["--load bus", "--cell"]),
        (&["--can", "vcan0"], ["--can", "--bench vcan"]),
        (&["--cell", cell, "--can", "vcan0"], ["--can", "--bench vcan"]),
        (&["--cell", cell, "--bench", "vcan"], ["virtual interface for bus arm", "the cell's own, can0"]),
        (&["--cell", cell, "--bench", "vcan", "--can", "lo"], ["--can lo", "CAN"]),
        (
            &["--cell", cell, "--bench=vcan", "--can=slcan:/dev/ttyACM0"],
            ["--can slcan:/dev/ttyACM0", "may be an arm's"],
        ),
        (&["--cell", serial, "--bench", "vcan"], ["serial lines", "--bench emulated"]),
    ] {
        refused(&mrroc(["jitter"].iter().chain(arguments)), &needles);
    }
}

#[test]
fn a_node_that_never_boots_is_told_with_those_that_were_heard() {
    let directory = Directory::new();
    let cell = directory.cell("irb6", |cell| cell.robot[0].axis[2].emulator.absent = true);
    let said = "axis upper-arm: node 3: never booted, waited 2.0s: heard on the bus: nodes 1, 2, 4 and 5";
    let words = ["jitter".as_ref(), "--duration=1s".as_ref(), "--cell".as_ref(), cell.as_os_str()];
    refused(&mrroc(words), &["bus arm", said]);
}

#[test]
fn what_cannot_be_measured_is_refused() {
    for (arguments, needles) in [
        (["--period", "0ms"], ["--period", "50us and 1s"]),
        (["--period", "2s"], ["--period", "50us and 1s"]),
        (["--period", "fast"], ["--period", "250us"]),
        (["--duration", "0s"], ["--duration", "ten periods"]),
        (["--priority", "0"], ["--priority", "between 1 and 99"]),
        (["--priority", "100"], ["--priority", "between 1 and 99"]),
        (["--cpu", "1023"], ["CPU 1023", "/sys/devices/system/cpu/online"]),
    ] {
        refused(&mrroc(["jitter"].iter().chain(&arguments)), &needles);
    }
}

#[test]
fn a_directory_that_cannot_be_written_is_refused_before_anything_is_measured() {
    let scratch = Directory::new();
    let file = scratch.write("file", "");
    for directory in [file.clone(), file.join("below"), "/proc/mrroc".into()] {
        let words = ["jitter", "--duration=168h", "--out"].map(AsRef::as_ref);
        let run = mrroc(words.into_iter().chain([directory.as_os_str()]));
        refused(&run, &["--out", directory.to_str().unwrap()]);
    }
}

#[test]
fn programs_that_are_not_installed_are_refused_with_their_package() {
    for (arguments, needles) in [
        (["--against", "cyclictest"], ["cyclictest", "apt install rt-tests"]),
        (["--load", "hackbench"], ["hackbench", "apt install rt-tests"]),
        (["--load", "stress-ng"], ["stress-ng", "apt install stress-ng"]),
    ] {
        let run = Command::new(binary()).arg("jitter").args(arguments).env("PATH", "").output().unwrap();
        let [stdout, stderr] = [run.stdout, run.stderr].map(|said| String::from_utf8(said).unwrap());
        refused(&Output { status: run.status, stdout, stderr }, &needles);
    }
}
