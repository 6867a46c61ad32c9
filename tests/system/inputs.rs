//! Invalid input files: FIFOs, devices, endless files and very large files.

use std::fs::{self, File};
use std::path::Path;
use std::process::Command;

use kit::mrroc::{Directory, binary, example, mrroc, text};
use kit::refusals::refused;

/// Creates a FIFO that has no writer.
fn fifo(path: &Path) {
    let made = Command::new("mkfifo").arg(path).status();
    assert!(made.expect("mkfifo runs").success());
}

#[test]
fn a_cell_that_is_no_regular_file_is_refused_at_once_by_every_command() {
    let directory = Directory::new();
    let pipe = directory.path("cell.toml");
    fifo(&pipe);
    let (pipe, here) = (pipe.to_str().unwrap(), directory.path("."));
    let commands: [&[&str]; 8] = [
        &["check"],
        &["run"],
        &["emulate"],
        &["doctor"],
        &["urdf", "--robot", "irb6", "--cell"],
        &["jitter", "--cell"],
        &["identify", "--axis", "column"],
        &["kinematics", "fk", "--robot", "irb6", "--joints", "0", "--cell"],
    ];
    for command in commands {
        let run = mrroc(command.iter().chain([&pipe]));
        refused(&run, &["cell.toml: is a FIFO or a pipe, must be a regular file"]);
        let run = mrroc(command.iter().chain([&"/dev/zero"]));
        refused(&run, &["/dev/zero: is a device, must be a regular file"]);
        let run = mrroc(command.iter().chain([&here.to_str().unwrap()]));
        refused(&run, &["is a directory, must be a regular file"]);
    }
}

#[test]
fn data_sheets_and_records_that_are_no_regular_files_are_refused_at_once() {
    let directory = Directory::new();
    let pipe = directory.path("pipe");
    fifo(&pipe);
    for (file, what) in [("pipe", "a FIFO or a pipe"), ("/dev/zero", "a device")] {
        let cell = directory.cell("irb6", |cell| {
            cell.robot[0].axis[0].drive.as_mut().unwrap().dcf = Some(file.into());
        });
        let check = mrroc(["check".as_ref(), cell.as_os_str()]);
        let place = format!("{}:", cell.display());
        let said = format!("{file}: is {what}, must be a regular file");
        refused(&check, &[&place, "robot[0].axis[0].drive.dcf: ", &said]);
        let path = directory.path(file);
        let eds = path.to_str().unwrap();
        let sdo = ["sdo", "read", "--can", "nosuch0", "--eds", eds, "1", "0x1018:01"];
        refused(&mrroc(sdo), &[&said]);
        let state = ["doctor", "--undo", "--state", eds];
        let doctor = mrroc(state);
        assert_eq!(doctor.status.code(), Some(2), "{doctor:?}");
        assert!(doctor.stderr.contains(&said), "{doctor:?}");
    }
}

#[test]
fn a_file_beyond_its_limit_is_refused_without_being_read_whole() {
    let directory = Directory::new();
    // The file occupies no space on the disk.
    let endless = directory.path("endless");
    File::create(&endless).unwrap().set_len(1 << 40).unwrap();
    let check = mrroc(["check".as_ref(), endless.as_os_str()]);
    refused(&check, &["endless: has more than 1048576 bytes"]);
    let cell = directory.cell("irb6", |cell| {
        cell.robot[0].axis[0].drive.as_mut().unwrap().dcf = Some("endless".into());
    });
    let check = mrroc(["check".as_ref(), cell.as_os_str()]);
    refused(&check, &["drive.dcf: ", "endless: has more than 4194304 bytes"]);
    let doctor = ["doctor", "--undo", "--state", endless.to_str().unwrap()];
    refused(&mrroc(doctor), &["endless: has more than 1048576 bytes"]);
}

/// Checks a cell in an address space of 200 MB, and returns the message.
fn check_in_little_memory(cell: &Path) -> String {
    let script = "ulimit -v 204800 && exec \"$0\" check \"$1\"";
    let output = Command::new("sh").args(["-c", script]).arg(binary()).arg(cell).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{}: {said:.300}", cell.display());
    assert!(said.len() < 1000, "{said:.1000}");
    said
}

#[test]
fn a_check_takes_less_than_200_mb_whatever_the_file() {
    let directory = Directory::new();
    let most = 1 << 20;
    let filled = |begin: &str, unit: &str, end: &str| {
        let count = (most - begin.len() - end.len()) / unit.len();
        format!("{begin}{}{end}", unit.repeat(count))
    };
    let few = |begin: &str, unit: &str, end: &str| {
        let elements = unit.matches(['.', ',', '=', '[', '{']).count();
        format!("{begin}{}{end}", unit.repeat(65_000 / elements))
    };
    let numbered = |unit: &str| (0..16_000).map(|at| unit.replace('#', &at.to_string())).collect();
    let tables: String = numbered("[t#]\na = 1\n");
    let dotted: String = numbered("a#.b.c = 1\n");
    let programs = few("", "[[robot.program]]\nmeet = \"a\"\n", "");
    let cases = [
        ("new lines", filled("", "\n", "")),
        ("spaces", filled("", " ", "")),
        ("comments", filled("", "#\n", "")),
        ("brackets", filled("x = ", "[", "")),
        ("closed brackets", filled("x = [", "[],", "]")),
        ("quotes", filled("x = [", "'',", "]")),
        ("dots", filled("x", ".x", " = 1")),
        ("tables", tables),
        ("dotted tables", dotted),
        ("meetings", programs),
        ("inline tables", few("x = [", "{a=1},", "]")),
        ("nested tables", few("x = [", "{a.b.c.d.e.f=1},", "]")),
        ("numbers", few("x = [", "1,", "]")),
        ("a long string", filled("name = \"", "x", "\"")),
        ("a long key", filled("", "x", " = 1")),
        ("a long number", filled("period_us = ", "9", "")),
        ("bytes", "\u{fffd}".repeat(300_000)),
    ];
    for (what, text) in cases {
        let said = check_in_little_memory(&directory.write("large.toml", &text));
        assert!(said.contains("large.toml:"), "{what}: {said}");
    }
    let most = 4 << 20;
    let object = "[#]\nParameterName=x\nObjectType=9\nCompactSubObj=254\nDataType=7\nAccessType=rw\n";
    let objects: String = (0x2000..0x6000).map(|at| object.replace('#', &format!("{at:04X}"))).collect();
    let sections: String = (0..500_000).map(|at| format!("[{at:x}]\n")).collect();
    let keys: String = (0..500_000).map(|at| format!("{at:x}=\n")).collect();
    let sheets = [
        ("objects", objects),
        ("sections", sections),
        ("keys", format!("[a]\n{keys}")),
        ("new lines", "\n".repeat(most)),
    ];
    for (what, sheet) in sheets {
        directory.write("motor.dcf", &sheet[..sheet.len().min(most)]);
        let cell = directory.cell("irb6", |cell| {
            for axis in &mut cell.robot[0].axis {
                axis.drive.as_mut().unwrap().dcf = Some("motor.dcf".into());
            }
        });
        let said = check_in_little_memory(&cell);
        assert!(said.contains("motor.dcf"), "{what}: {said}");
    }
}

#[test]
fn nothing_of_a_file_acts_on_the_terminal() {
    let directory = Directory::new();
    let cell = text("irb6");
    let spoilt = [
        cell.replacen("name = \"column\"", "name = \"\\u001b[2J\\u0007\"", 1),
        cell.replacen("node = 1", "\"\\u001b]0;title\\u0007\" = 1", 1),
        cell.replacen("node = 1", "node = \u{1b}[31m", 1),
        cell.replacen("vendor = 0xFB", "vendor = 0xFB, dcf = \"\\u202Ecfd.rotom\"", 1),
        cell.replacen("interface = \"can0\"", "interface = \"\\u009b2J\"", 1),
        format!("# \u{1b}[2J\n{cell}").replacen("period_us = 2000", "period_us = 0", 1),
    ];
    for text in spoilt {
        let file = directory.write("cell.toml", &text);
        let check = mrroc(["check".as_ref(), file.as_os_str()]);
        refused(&check, &["cell.toml:"]);
        let acts = |c: char| c != '\n' && (c.is_control() || ('\u{202a}'..='\u{202e}').contains(&c));
        assert!(!check.stderr.contains(acts), "{:?}", check.stderr);
    }
    let check = mrroc(["check", "\u{1b}[2Jno-such-cell.toml"]);
    refused(&check, &["\\u{1b}[2Jno-such-cell.toml: No such file"]);
}

#[test]
fn bytes_that_are_no_text_are_refused_with_their_line() {
    let directory = Directory::new();
    let mut bytes = fs::read(example("irb6")).unwrap();
    let at = bytes.iter().position(|&byte| byte == b'n').unwrap();
    let line = bytes[..at].iter().filter(|&&byte| byte == b'\n').count() + 1;
    bytes[at] = 0xE9;
    let file = directory.path("latin.toml");
    fs::write(&file, &bytes).unwrap();
    let place = format!("{}:{line}: ", file.display());
    let check = mrroc(["check".as_ref(), file.as_os_str()]);
    refused(&check, &[&place, "the byte 0xe9 is no UTF-8 text"]);
}
