//! Data sheets and device configuration files: the output of `mrroc eds`, and the effect of a DCF on a drive.

use std::fs;
use std::path::PathBuf;

use can::candump;
use canopen::NodeId;
use canopen::eds::Eds;
use hil::{CanForceSensor, CanForceSensorConfig, DigitalIo, DigitalIoConfig, TransducerConfig};
use kit::mrroc::{Directory, enables, example, mrroc, root, shorten, trace};
use kit::refusals::refused;

use crate::cli_refusals::run_in_lockstep;

fn sheet() -> String {
    let sheet = fs::read_to_string(root().join("cells/epos4-emulated.eds"));
    sheet.expect("the data sheet is beside the cells")
}

/// The emulated drive's data sheet with lines inserted below these headings, and the line number, from 1, of the first
/// insertion.
pub(crate) fn dcf(lines: &[(&str, &str)]) -> (String, usize) {
    let mut text = sheet();
    for (section, line) in lines {
        let heading = format!("[{section}]\n");
        assert!(text.contains(&heading), "{section}");
        text = text.replacen(&heading, &format!("{heading}{line}\n"), 1);
    }
    let (section, _) = lines[0];
    let at = text.find(&format!("[{section}]\n")).unwrap();
    let line = text[..at].matches('\n').count() + 2;
    (text, line)
}

/// A cell whose first axis has the DCF `motor.dcf`, with that axis changed.
pub(crate) fn cell(directory: &Directory, dcf: &str, change: Change) -> PathBuf {
    directory.write("motor.dcf", dcf);
    directory.cell("irb6", |cell| {
        shorten(cell);
        let axis = &mut cell.robot[0].axis[0];
        axis.drive.as_mut().unwrap().dcf = Some("motor.dcf".into());
        change(axis);
    })
}

/// The frames of node 1's SDO in the notation of candump.
fn sdo(trace: &[candump::Entry]) -> Vec<String> {
    let frames = trace.iter().map(|entry| entry.frame.to_string());
    let of_node_1 = |frame: &String| frame.starts_with("601#") || frame.starts_with("581#");
    frames.filter(of_node_1).collect()
}

#[test]
fn the_published_data_sheet_is_the_one_the_command_prints() {
    let cell = example("irb6");
    for axis in ["irb6.column", "irb6/column", "column", "1"] {
        let printed = mrroc(["eds".as_ref(), cell.as_os_str(), axis.as_ref()]);
        assert_eq!(printed.status.code(), Some(0), "{printed:?}");
        assert!(
            printed.stdout == sheet(),
            "cells/epos4-emulated.eds is not what the drive is: `mrroc eds cells/irb6.toml irb6/column > cells/epos4-emulated.eds`"
        );
    }
    Eds::read(sheet().as_bytes()).unwrap();
    let nobody = mrroc(["eds".as_ref(), cell.as_os_str(), "elbow".as_ref()]);
    refused(&nobody, &["no axis is called \"elbow\"", "irb6.column (node 1)"]);
    let serial = mrroc(["eds".as_ref(), example("irb6-serial").as_os_str(), "column".as_ref()]);
    refused(&serial, &["irb6-serial.toml: the cell has no drive on CAN"]);
    assert!(!serial.stderr.contains("there are"), "{serial:?}");
    // The IRb-6 has a column and a wrist roll too, on serial lines.
    let one = mrroc(["eds".as_ref(), example("lab").as_os_str(), "column".as_ref()]);
    assert_eq!(one.status.code(), Some(0), "{one:?}");
    let two = mrroc(["eds".as_ref(), example("lab").as_os_str(), "wrist-roll".as_ref()]);
    let both = "more than one axis is called \"wrist-roll\" with a drive on CAN: irp6-track.wrist-roll (node 2), \
                rnt.wrist-roll (node 4)\n";
    refused(&two, &[both]);
}

#[test]
fn the_published_data_sheet_of_the_io_module_is_the_one_of_the_emulator() {
    let node = NodeId::new(1).unwrap();
    let config = DigitalIoConfig { input_bytes: 8, output_bytes: 8, ..DigitalIoConfig::new(node) };
    is_published("cia401-emulated.eds", &DigitalIo::eds(&config));
}

#[test]
fn the_published_data_sheet_of_the_force_sensor_is_the_one_of_the_emulator() {
    let config = CanForceSensorConfig::new(NodeId::new(1).unwrap(), TransducerConfig::default());
    is_published("force-sensor-emulated.eds", &CanForceSensor::eds(&config));
}

/// Asserts that a file of `cells` has this data sheet, or writes the file.
fn is_published(name: &str, sheet: &Eds) {
    let current = sheet.to_string();
    let path = root().join("cells").join(name);
    if std::env::var_os("MRROC_WRITE_DOCS").is_some() {
        fs::write(&path, &current).unwrap();
    }
    let kept = fs::read_to_string(&path).unwrap_or_default();
    assert!(kept == current, "{} is out of date: run this test with MRROC_WRITE_DOCS=1", path.display());
}

#[test]
fn a_dcf_is_in_the_drive_before_it_is_switched_on() {
    let (text, _) = dcf(&[
        // Windows of the position, which no other part of the system sets.
        ("6067", "ParameterValue=1234"),
        ("6068", "ParameterValue=0x7B"),
        ("607Dsub1", "ParameterValue=-2000000000"),
        ("607Dsub2", "ParameterValue=0x77359400"),
        ("1018sub2", "ParameterValue=0x61500000"),
    ]);
    let directory = Directory::new();
    let cell = cell(&directory, &text, |_| {});
    let log = directory.path("run.log");
    let run = run_in_lockstep(&cell, &log);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let frames = trace(&log);
    assert!(enables(&frames) > 0);
    let sdo = sdo(&frames);
    // Ratios of CiA 402-2 for encoder, gear and feed, which no EPOS4 has.
    let absent =
        ["291001", "8F6001", "8F6002", "916001", "916002", "926001", "926002", "7B6001", "7B6002", "7E6000", "C66000"]
            .map(|object| format!("581#80{object}00000206"));
    // The time-out of the following error can be read alone.
    let read_only = "581#8066600002000106";
    let refused = |frame: &&String| frame.starts_with("581#80") && !absent.contains(frame) && *frame != read_only;
    assert_eq!(sdo.iter().find(refused), None);
    // The last answer of the drive to an upload of each object is the value that it keeps.
    let holds = |answer: &str| {
        let mut answers = sdo.iter().rev();
        answers.find(|frame| frame.len() >= 12 && frame[6..12] == answer[6..12] && frame.starts_with("581#4"))
    };
    for answer in [
        "581#43676000D2040000",
        "581#4B6860007B000000",
        "581#437D6001006CCA88",
        // Values that the drive group sets: 2 ms in units of 10^-3 s, and CSP.
        "581#4FC2600102000000",
        "581#4F60600008000000",
    ] {
        assert_eq!(holds(answer).map(String::as_str), Some(answer));
    }

    let check = mrroc(["check".as_ref(), cell.as_os_str()]);
    let line = "motor.dcf asks for 4 writes and notes 1 value more";
    assert!(check.stdout.contains(line), "{check:?}");
}

/// Change of the axis of the cell.
type Change = fn(&mut ::mrroc::cell::Axis);

/// A name, the lines inserted into the sheet, the change of the axis, and the required parts of the refusal. `@` stands
/// for file and line of the first value.
type Case = (&'static str, &'static [(&'static str, &'static str)], Change, &'static [&'static str]);

const VALUE: (&str, &str) = ("6067", "ParameterValue=1");

const REFUSALS: &[Case] = &[
    (
        "a value that does not fit",
        &[("6067", "ParameterValue=0x100000000")],
        |_| {},
        &["@", "out of range; 0 to 4294967295 fit"],
    ),
    (
        "a value beyond the object's limits",
        &[("60C2sub1", "ParameterValue=101")],
        |_| {},
        &["@", "beyond the object's limits 0 to 100"],
    ),
    (
        "two values of one object",
        &[("6067", "ParameterValue=1\nParameterValue=2")],
        |_| {},
        &["motor.dcf:", "stands on line", "already"],
    ),
    (
        "a value whose limit has no certain meaning",
        &[("60C2sub1", "ParameterValue=1\nLowLimit=x")],
        |_| {},
        &["motor.dcf:", "this key stands on line"],
    ),
    (
        "a node-ID that no node has",
        &[("Comments", "[DeviceComissioning]\nNodeID=200\n[More]"), VALUE],
        |_| {},
        &["motor.dcf:", "out of range; 1 to 127 fit"],
    ),
    (
        "no value at all",
        &[("6067", "Denotation=window")],
        |_| {},
        &["robot[0].axis[0].drive.dcf: ", "asks for no write"],
    ),
    (
        "another product than the cell's",
        &[VALUE],
        |axis| axis.drive.as_mut().unwrap().product = Some(0x6552_0000),
        &["robot[0].axis[0].drive.dcf: ", "motor.dcf", "0x61500000 (0x1018:02), the cell says 0x65520000"],
    ),
    (
        "another vendor than the cell's",
        &[VALUE],
        |axis| axis.drive.as_mut().unwrap().vendor = 0x1234,
        &["0x000000fb (0x1018:01), the cell says 0x00001234"],
    ),
    (
        "another revision than the cell's",
        &[VALUE],
        |axis| axis.drive.as_mut().unwrap().revision = Some(0x0168_0000),
        &["0x01700000 (0x1018:03), the cell says 0x01680000"],
    ),
    (
        "the file of another node",
        &[("Comments", "[DeviceComissioning]\nNodeID=2\n[More]"), VALUE],
        |_| {},
        &["is of node 2, the axis of node 1"],
    ),
    (
        "the file of another bus",
        &[("Comments", "[DeviceComissioning]\nBaudrate=500\n[More]"), VALUE],
        |_| {},
        &["is for 500 kbit/s, the bus has 1000"],
    ),
    (
        "no such file",
        &[VALUE],
        |axis| axis.drive.as_mut().unwrap().dcf = Some("missing.dcf".into()),
        &["robot[0].axis[0].drive.dcf: ", "missing.dcf: No such file"],
    ),
];

#[test]
fn a_dcf_that_cannot_be_meant_is_refused_before_a_bus_is_opened() {
    let directory = Directory::new();
    let log = directory.path("refused.log");
    for (name, lines, change, needles) in REFUSALS {
        let (text, line) = dcf(lines);
        let cell = cell(&directory, &text, *change);
        let place = format!("{}:{line}: ", directory.path("motor.dcf").display());
        let needles: Vec<&str> =
            needles.iter().map(|needle| if *needle == "@" { place.as_str() } else { *needle }).collect();
        for run in [run_in_lockstep(&cell, &log), mrroc(["check".as_ref(), cell.as_os_str()])] {
            refused(&run, &needles);
            assert!(!log.exists(), "{name}: a bus was opened");
        }
    }
}

#[test]
fn what_belongs_to_the_driver_is_refused_in_a_dcf_by_line_and_name() {
    let cases = [
        ("6040", "0x000F", "0x6040:00 (controlword) belongs to the driver: it commands the drive"),
        ("1010sub1", "0x65766173", "0x1010:01 (store all parameters) belongs to the driver"),
        ("1011sub1", "0x64616F6C", "0x1011:01 (restore all default parameters) belongs to the driver"),
        ("1016sub1", "0", "0x1016:01 (heartbeat consumer 1) belongs to the driver"),
        ("1016sub2", "0x007F0064", "0x1016:02 belongs to the driver"),
        ("6007", "0", "0x6007:00 (abort connection option code) belongs to the driver"),
        ("6085", "1", "0x6085:00 (quick stop deceleration) belongs to the driver"),
        ("6065", "0xFFFFFFFF", "0x6065:00 (following error window) belongs to the driver"),
        ("6060", "3", "0x6060:00 (modes of operation) belongs to the driver"),
        ("60C2sub1", "9", "0x60c2:01 (interpolation time period value) belongs to the driver"),
        ("1802sub2", "1", "belongs to the driver: the driver maps the process data"),
        ("1A02sub1", "0x60640020", "belongs to the driver: the driver maps the process data"),
    ];
    let directory = Directory::new();
    for (section, value, refusal) in cases {
        let (text, line) = dcf(&[(section, &format!("ParameterValue={value}"))]);
        let command = text.find(&format!("[{section}]\n")).unwrap();
        let text = text[..command].to_owned() + &text[command..].replacen("ObjFlags=1\n", "", 1);
        let cell = cell(&directory, &text, |_| {});
        let place = format!("motor.dcf:{line}: ");
        let check = mrroc(["check".as_ref(), cell.as_os_str()]);
        refused(&check, &[&place, refusal, "remove its ParameterValue"]);
        assert!(!check.stderr.contains("further"), "{check:?}");
    }
    // All lines at once. An object that a download leaves out is reported as a note.
    let (text, line) = dcf(&[
        ("6007", "ParameterValue=0"),
        ("6065", "ParameterValue=1"),
        ("6085", "ParameterValue=1\nObjFlags=1"),
        ("60C2sub1", "ParameterValue=9"),
    ]);
    let cell = cell(&directory, &text, |_| {});
    let line_of = |section: &str| {
        let at = text.find(&format!("[{section}]\n")).unwrap();
        text[..at].matches('\n').count() + 2
    };
    let told = |section: &str, object: &str| format!("{}: {object}", line_of(section));
    let others = [told("6065", "0x6065:00"), told("60C2sub1", "0x60c2:01")];
    let check = mrroc(["check".as_ref(), cell.as_os_str()]);
    refused(&check, &[&format!("motor.dcf:{line}: 0x6007:00"), &others[0], &others[1]]);
    assert!(!check.stderr.contains("0x6085:00"), "{check:?}");
}

#[test]
fn all_that_is_wrong_in_a_dcf_is_told_at_once() {
    let (text, _) = dcf(&[
        ("6007", "ParameterValue=0"),
        ("6067", "ParameterValue=0x100000000"),
        ("6068", "DownloadFile=window.bin"),
        ("1600sub0", "ParameterValue=1"),
        ("1600sub1", "ParameterValue=0x60400010"),
        // Beyond the count.
        ("1600sub2", "ParameterValue=0x607A0020"),
        ("1600sub3", "ParameterValue=0x60FF0020"),
    ]);
    let line_of = |value: &str| {
        let at = text.find(value).unwrap();
        text[..at].matches('\n').count() + 1
    };
    let mapping = ["0x60400010", "0x607A0020", "0x60FF0020"].map(|value| line_of(&format!("ParameterValue={value}")));
    let [first, second, third] = mapping;
    let others = format!(
        "0x1600:00 belongs to the driver: the driver maps the process data; the same holds for 3 further lines: \
         {first}, {second}, {third}",
    );
    let silence = format!("{}: 0x6007:00", line_of("ParameterValue=0\n"));
    let value = format!("{}: out of range; 0 to 4294967295 fit", line_of("ParameterValue=0x100000000"));
    let file = format!("{}: 0x6068:00 is to be written from a file", line_of("DownloadFile"));
    let directory = Directory::new();
    let cell = cell(&directory, &text, |_| {});
    let check = mrroc(["check".as_ref(), cell.as_os_str()]);
    refused(&check, &[&others, &silence, &value, &file, "`mrroc dcf strip`"]);
}

#[test]
fn read_only_values_are_compared_and_defaults_are_written_where_the_drive_differs() {
    let (text, _) = dcf(&[
        ("6041", "ParameterValue=0x0637"),
        ("1008", "ParameterValue=\"EPOS4\""),
        ("1018sub4", "ParameterValue=0"),
        // The defaults.
        ("6067", "ParameterValue=1000"),
        ("6068", "ParameterValue=7"),
    ]);
    let default = |section: &str| {
        let at = text.find(&format!("[{section}]\n")).unwrap();
        let rest = text[at..].split("DefaultValue=").nth(1).unwrap();
        rest.lines().next().unwrap().to_owned()
    };
    let text = text.replace("ParameterValue=1000\n", &format!("ParameterValue={}\n", default("6067")));
    let directory = Directory::new();
    let cell = cell(&directory, &text, |_| {});
    let check = mrroc(["check".as_ref(), cell.as_os_str()]);
    assert_eq!(check.status.code(), Some(0), "{check:?}");
    for line in [
        "motor.dcf asks for 2 writes and notes 1 value more",
        "1 write is of a default, made where the drive holds another value",
        "2 read-only values are compared with the drive",
    ] {
        assert!(check.stdout.contains(line), "{line}: {check:?}");
    }
    let log = directory.path("run.log");
    let run = run_in_lockstep(&cell, &log);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let sdo = sdo(&trace(&log));
    // Object 0x6067 is read and not written, object 0x6068 is written.
    let written = |object: &str| sdo.iter().any(|frame| frame.starts_with("601#2") && frame[6..12] == *object);
    let asked = |object: &str| sdo.iter().any(|frame| frame.starts_with("601#40") && frame[6..12] == *object);
    assert!(asked("676000") && !written("676000"));
    assert!(written("686000"));
    let warning = "axis column: node 1: 2 of 2 read-only values differ from the device configuration file, the first is \
                   0x1008:00";
    assert!(run.stdout.contains(warning), "{run:?}");
}

#[test]
fn a_flaw_on_which_no_value_depends_is_a_warning() {
    let (text, line) = dcf(&[("6064", "HighLimit=0x100000000"), VALUE]);
    let directory = Directory::new();
    let cell = cell(&directory, &text, |_| {});
    let log = directory.path("run.log");
    for run in [run_in_lockstep(&cell, &log), mrroc(["check".as_ref(), cell.as_os_str()])] {
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        let warning = format!("motor.dcf:{line}: out of range; -2147483648 to 2147483647 fit; no value depends on it");
        assert!(run.stderr.contains(&warning), "{run:?}");
    }
}

#[test]
fn report_and_page_of_a_run_say_what_a_dcf_asks_for_and_what_is_flawed_in_it() {
    let (text, line) = dcf(&[
        ("6064", "HighLimit=0x100000000"),
        ("6041", "ParameterValue=0x0637"),
        ("1018sub4", "ParameterValue=0"),
        ("6068", "ParameterValue=0x7B"),
    ]);
    let directory = Directory::new();
    let cell = cell(&directory, &text, |_| {});
    let run = |json: bool| {
        let out = directory.path(if json { "json" } else { "text" });
        let words = ["run".as_ref(), cell.as_os_str(), "--bench".as_ref(), "lockstep".as_ref()];
        let words = words.into_iter().chain(["--out".as_ref(), out.as_os_str()]);
        let run = mrroc(words.chain(json.then_some("--json".as_ref())));
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        (run, fs::read_to_string(out.join("report.html")).unwrap())
    };
    let flaw = format!("motor.dcf:{line}: out of range; -2147483648 to 2147483647 fit; no value depends on it");
    let (json, page) = run(true);
    let report = &json.json()["configurations"];
    assert_eq!(report.as_array().map(Vec::len), Some(1), "{json:?}");
    let of_axis = &report[0];
    assert_eq!(of_axis["axis"], "column");
    assert!(of_axis["file"].as_str().unwrap().ends_with("motor.dcf"), "{of_axis}");
    for (key, count) in [("writes", 1), ("defaults", 0), ("compared", 1), ("left_out", 1)] {
        assert_eq!(of_axis[key], count, "{key}: {of_axis}");
    }
    assert!(of_axis["warnings"][0].as_str().unwrap().ends_with(&flaw), "{of_axis}");
    let asked = "motor.dcf asks for 1 write and notes 1 value more; 1 read-only value is compared with the drive";
    for said in [asked, &flaw, "1 of 1 read-only value differs from the device configuration file"] {
        assert!(page.contains(said), "{said}: {page}");
    }
    let (printed, _) = run(false);
    assert!(printed.stdout.contains(asked), "{printed:?}");
    assert!(printed.stderr.contains(&flaw), "{printed:?}");
}

#[test]
fn a_drive_that_is_not_the_files_is_refused_and_none_is_switched_on() {
    let (text, _) = dcf(&[VALUE]);
    let listed = text.replacen("[ManufacturerObjects]\n", "[ManufacturerObjects]\n9999=0x2FFF\n", 1);
    let unknown = "\n[2FFF]\nParameterName=none\nDataType=7\nAccessType=rw\nParameterValue=1\n";
    let cases: [(String, Change, &[&str]); 2] = [
        (
            text.clone(),
            |axis| axis.emulator.revision = Some(0x0168_0000),
            &["bus arm, axis column: node 1: ", "0x1018:03 is 0x01680000", "expects 0x01700000"],
        ),
        (listed + unknown, |_| {}, &["bus arm, axis column: node 1: ", "0x2fff:00 refused", "object does not exist"]),
    ];
    let directory = Directory::new();
    for (text, change, needles) in cases {
        let cell = cell(&directory, &text, change);
        let log = directory.path("drives.log");
        refused(&run_in_lockstep(&cell, &log), needles);
        let frames = trace(&log);
        assert!(!frames.is_empty());
        assert_eq!(enables(&frames), 0);
    }
}

#[test]
fn a_drive_that_scales_otherwise_than_the_cell_is_refused_and_none_is_switched_on() {
    let cases: [(Change, Option<&[&str]>); 4] = [
        (|_| {}, None),
        (|axis| axis.emulator.rated_torque = Some(0.423), None),
        (
            |axis| axis.emulator.counts_per_revolution = Some(4096),
            Some(&[
                "bus arm, axis column: node 1: ",
                "0x3000:05 is 4096 quadrature counts per revolution, the cell says 4000",
                "correct drive.counts_per_revolution",
            ]),
        ),
        (
            |axis| axis.emulator.rated_torque = Some(2.1),
            Some(&[
                "bus arm, axis column: node 1: ",
                "0x6076:00 is 2100000 µN·m of rated torque, the cell says 420000",
                "correct drive.rated_torque",
            ]),
        ),
    ];
    let directory = Directory::new();
    let (text, _) = dcf(&[VALUE]);
    for (change, refusal) in cases {
        let cell = cell(&directory, &text, change);
        let log = directory.path("drives.log");
        let run = run_in_lockstep(&cell, &log);
        let frames = trace(&log);
        match refusal {
            None => {
                assert_eq!(run.status.code(), Some(0), "{run:?}");
                assert!(enables(&frames) > 0);
            }
            Some(needles) => {
                refused(&run, needles);
                assert!(!frames.is_empty());
                assert_eq!(enables(&frames), 0);
            }
        }
    }
}

#[test]
fn a_dcf_that_scales_otherwise_than_the_cell_is_refused() {
    let directory = Directory::new();
    let (text, _) = dcf(&[VALUE]);
    let scale = |index: &str, above: u32, below: u32| {
        let sub = |number: u8, value: u32| {
            format!("\n[{index}sub{number}]\nParameterName=of\nDataType=7\nAccessType=rw\nParameterValue={value}\n")
        };
        let head = format!("\n[{index}]\nParameterName=scale\nObjectType=9\nSubNumber=2\n");
        head + &sub(1, above) + &sub(2, below)
    };
    // The cell has 4000 counts per motor revolution, measured at the motor shaft.
    let cases = [
        (scale("608F", 4000, 1), None),
        (scale("608F", 8000, 2), None),
        (scale("6091", 1, 1), None),
        (scale("608F", 524_288, 1) + &scale("6092", 4000, 1), None),
        (scale("6092", 3600, 7), Some("0x6092 sets 3600/7 position units per shaft revolution, the cell says 4000")),
        (scale("608F", 2000, 1), Some("0x608f sets 2000 counts per revolution, the cell says 4000")),
        (scale("6091", 158, 1), Some("0x6091 sets 158 motor revolutions per shaft revolution, the cell says 1")),
    ];
    for (objects, refusal) in cases {
        let cell = cell(&directory, &format!("{text}{objects}"), |_| {});
        let run = mrroc(["check".as_ref(), cell.as_os_str()]);
        match refusal {
            None => assert_eq!(run.status.code(), Some(0), "{objects}: {run:?}"),
            Some(needle) => refused(&run, &["motor.dcf:", needle]),
        }
    }
}
