//! Runs of an arm whose drives are already referenced. The arm is not homed and starts at the end position of the
//! previous run.

use std::f64::consts::FRAC_PI_2;
use std::fs;
use std::path::Path;

use ::mrroc::cell::{Cell, Instruction, JointGenerator, Joints, LineInstruction};
use kit::mrroc::{Directory, Output, mrroc, shorten};
use kit::{PERIOD, by_the_clock};

use crate::serial_cli::{emulate, output_on};

/// A cell with this instruction only and long time limits, because the answers of another process are late on a loaded
/// machine.
fn cell(directory: &Directory, instruction: Instruction) -> std::path::PathBuf {
    directory.cell("irb6-serial", |cell: &mut Cell| {
        shorten(cell);
        cell.serial[0].tolerated_missing = 10;
        cell.serial[0].answer_timeout_ms = 500;
        cell.max_missed_in_row = 100;
        cell.robot[0].program = vec![instruction];
    })
}

fn joints(pose: [f64; 5]) -> Instruction {
    Instruction::Joints(Joints {
        poses: vec![pose.to_vec()],
        generator: JointGenerator::Newsmooth,
        velocity: 0.5,
        acceleration: 0.3,
        duration: None,
    })
}

/// A line with the tool horizontal, in the plane of the arm at home.
fn line() -> Instruction {
    Instruction::Line(LineInstruction {
        position: [0.7, 0.0, 1.05],
        quaternion: None,
        velocity: 0.2,
        acceleration: 0.5,
        constant_speed: false,
    })
}

fn run_on(cell: &Path, ttys: &Path, record: &Path) -> Output {
    output_on(cell, ttys, record, |_| Ok(()))
}

/// Whether the arm was in this phase.
fn has_been(record: &Path, phase: &str) -> bool {
    let record = fs::read_to_string(record).expect("the record is there");
    record.contains(&format!(",wrist-roll,{phase},"))
}

fn completed(run: &Output) {
    assert_eq!(run.status.code(), Some(0), "{run:?}");
}

#[test]
fn a_program_is_rehearsed_again_from_where_a_referenced_arm_stands() {
    by_the_clock(0.45, PERIOD, || {
        let directory = Directory::new();
        let (ttys, record) = (directory.path("ttys"), directory.path("record.csv"));
        let away = cell(&directory, joints([0.5, -1.7, 0.1, 0.4, 0.3]));
        let _emulator = emulate(&away, &ttys);
        let run = run_on(&away, &ttys, &record);
        completed(&run);
        assert!(has_been(&record, "Homing"));

        // The line is possible from home, but not from the present position.
        let path = cell(&directory, line());
        let checked = mrroc(["check".as_ref(), path.as_os_str()]);
        assert_eq!(checked.status.code(), Some(0), "{checked:?}");
        let run = run_on(&path, &ttys, &record);
        assert_eq!(run.status.code(), Some(1), "{run:?}");
        let faults = run.json()["faults"].clone();
        let text = fs::read_to_string(&path).expect("the cell is there");
        let number = text.lines().position(|line| line == "[[robot.program]]");
        let number = number.expect("it has a program") + 1;
        let place = format!("cell.toml:{number}: robot[0].program[0]: ");
        let said = faults[0]["what"].as_str().expect("a text");
        assert_eq!(faults.as_array().map(Vec::len), Some(1), "{faults}");
        assert!(said.contains(&place) && said.contains("out of the arm's plane"), "{faults}");
        assert!(!has_been(&record, "Homing") && !has_been(&record, "Moving"));

        // A motion of the joints is possible from everywhere. The line after it is possible from home.
        for instruction in [joints([0.0, -FRAC_PI_2, 0.0, 0.0, 0.0]), line()] {
            let run = run_on(&cell(&directory, instruction), &ttys, &record);
            completed(&run);
            assert!(!has_been(&record, "Homing") && has_been(&record, "Moving"));
        }
    });
}
