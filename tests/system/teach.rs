//! Teach-in and replay of the IRb-6 by an operator at standard input.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use controller::trajectory_file::TrajectoryFile;
use kit::mrroc::{Directory, Output, Running, mrroc};
use kit::teach::{ORDERS, arguments, cell, taught};

/// As [`teach`] in virtual time, where standard input must end.
fn teach_in_lockstep(cell: &Path, orders: &[&str], options: &[&str]) -> Output {
    let arguments = arguments(cell, "teach", &[&["--operator", "--bench=lockstep"], options].concat());
    let mut running = Running::with_input(orders, arguments);
    running.close_input();
    running.output()
}

/// Last commanded position of each axis while the robot stood, rad.
fn end(record: &Path) -> BTreeMap<String, f64> {
    let record = fs::read_to_string(record).unwrap();
    let rows = record.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let standing = rows.filter(|row| row[3] == "Standing");
    standing.map(|row| (row[2].to_owned(), row[5].parse().unwrap())).collect()
}

#[test]
fn three_taught_positions_are_replayed_to_the_same_end() {
    let directory = Directory::new();
    let cell = cell(&directory, "file = 'poses.trj'\nvelocity = 0.5\nacceleration = 0.5");
    let records = ["teach", "replay"].map(|task| directory.path(&format!("{task}.csv")));
    let [teaching, replaying] = records.each_ref().map(|path| path.to_str().unwrap());
    let out = directory.path("out");
    let options = ["--json", "--record", teaching, "--out", out.to_str().unwrap()];
    let run = teach_in_lockstep(&cell, &ORDERS, &options);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    assert_eq!(run.json()["figures"]["poses"], 3.0, "{run:?}");
    assert!(run.stderr.contains("mrroc: irb6: record, move AXIS BY, or done?\n"), "{run:?}");
    assert!(run.stderr.contains("poses.trj: 3 poses\n"), "{run:?}");
    taught(&directory.path("poses.trj"));
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("<li>poses: 3.0000</li>"), "{page}");

    let run = mrroc(arguments(&cell, "replay", &["--bench=lockstep", "--record", replaying]));
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let [teaching, replaying] = records.each_ref().map(|path| end(path));
    assert_eq!(teaching.len(), 5);
    for (axis, position) in &teaching {
        assert!((position - replaying[axis]).abs() < 1e-6, "{axis}: {position} and {}", replaying[axis]);
    }
}

#[test]
fn two_teach_ins_in_lockstep_with_the_same_lines_are_the_same_bit_for_bit() {
    let runs = ["one", "two"].map(|name| {
        let directory = Directory::new();
        let cell = cell(&directory, "file = 'poses.trj'\ncoordinates = 'motor'");
        let record = directory.path(name);
        let run = teach_in_lockstep(&cell, &ORDERS, &["--record", record.to_str().unwrap()]);
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        (fs::read(record).unwrap(), fs::read_to_string(directory.path("poses.trj")).unwrap())
    });
    assert!(runs[0].1.starts_with("MOTOR\n3\n"), "{}", runs[0].1);
    assert!(runs[0] == runs[1], "the records differ");
}

#[test]
fn with_the_drives_off_the_positions_are_measured_and_orders_to_move_are_refused() {
    let directory = Directory::new();
    let cell = cell(&directory, "file = 'poses.trj'\ndrives_on = false");
    let orders = ["perhaps", "OFF", "move column 0.1", "done", "record", "record", "done"];
    let run = teach_in_lockstep(&cell, &orders, &[]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    for text in [
        "\"perhaps\" is no answer; answers are off, cancel",
        "the drives are off: move the robot by hand",
        "no pose is recorded",
        "poses.trj: 2 poses",
    ] {
        assert!(run.stderr.contains(text), "{text}: {run:?}");
    }
    let file = TrajectoryFile::parse(&fs::read_to_string(directory.path("poses.trj")).unwrap()).unwrap();
    assert_eq!(file.poses().len(), 2);
}

#[test]
fn orders_that_cannot_be_executed_leave_the_robot_standing_and_the_operator_is_asked_again() {
    let directory = Directory::new();
    let cell = cell(&directory, "file = 'poses.trj'");
    let run = teach_in_lockstep(&cell, &["move lower-arm 3.0", "move elbow 1", "fly", "record", "done"], &[]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    assert!(run.stderr.contains("no axis \"elbow\""), "{run:?}");
    assert!(run.stderr.contains("\"fly\" is no order; orders are record, move AXIS BY, or done"), "{run:?}");
    assert!(directory.path("poses.trj").exists());
}

#[test]
fn an_input_that_ends_before_done_is_a_fault_and_the_recorded_poses_are_kept() {
    let directory = Directory::new();
    let cell = cell(&directory, "file = 'poses.trj'");
    for number in ["", "-2"] {
        let run = teach_in_lockstep(&cell, &["record", "move column 0.3", "record"], &[]);
        assert_eq!(run.status.code(), Some(1), "{run:?}");
        assert!(run.stdout.contains("the operator's input is closed"), "{run:?}");
        let part = format!("poses.trj.part{number}");
        assert!(run.stderr.contains(&format!("{part}: rename it to replay it")), "{run:?}");
        assert!(!directory.path("poses.trj").exists());
        let kept = TrajectoryFile::parse(&fs::read_to_string(directory.path(&part)).unwrap()).unwrap();
        assert_eq!(kept.poses().len(), 2);
    }
}

#[test]
fn a_part_of_an_earlier_teach_in_is_kept_and_prevents_no_other_one() {
    let directory = Directory::new();
    let cell = cell(&directory, "file = 'poses.trj'\nvelocity = 0.5\nacceleration = 0.5");
    directory.write("poses.trj.part", "of an earlier teach-in");
    let run = teach_in_lockstep(&cell, &ORDERS, &[]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    taught(&directory.path("poses.trj"));
    assert_eq!(fs::read_to_string(directory.path("poses.trj.part")).unwrap(), "of an earlier teach-in");
    assert!(!directory.path("poses.trj.part-2").exists());
}

#[test]
fn a_teach_in_replaces_no_input_of_its_run() {
    let directory = Directory::new();
    let cell = cell(&directory, "file = 'cell.toml'\nreplace = true");
    let text = fs::read_to_string(&cell).unwrap();
    let run = teach_in_lockstep(&cell, &ORDERS, &[]);
    assert_eq!(run.status.code(), Some(2), "{run:?}");
    assert!(run.stderr.contains("is the cell file: name another"), "{run:?}");
    assert_eq!(fs::read_to_string(&cell).unwrap(), text);
}

#[test]
fn check_takes_the_task_of_a_run() {
    let directory = Directory::new();
    directory.write("five.trj", "JOINT\n1\nABSOLUTE\n1 1 1 1 1\n1 1 1 1 1\n0.3 -1.5 0 0 0\njoints = inclination\n");
    directory.write("six.trj", "JOINT\n1\nABSOLUTE\n1 1 1 1 1 1\n1 1 1 1 1 1\n0 0 0 0 0 0\n");
    for (task, file, status) in [("replay", "five.trj", 0), ("replay", "six.trj", 2), ("teach", "new.trj", 0)] {
        let cell = cell(&directory, &format!("file = '{file}'"));
        let run = mrroc(["check", cell.to_str().unwrap(), "--task", task]);
        assert_eq!(run.status.code(), Some(status), "{task} {file}: {run:?}");
    }
    assert!(!directory.path("new.trj").exists());
}

#[test]
fn a_teach_in_or_a_replay_that_cannot_succeed_is_refused_before_motion() {
    let directory = Directory::new();
    let six = "JOINT\n1\nABSOLUTE\n1 1 1 1 1 1\n1 1 1 1 1 1\n0 0 0 0 0 0\n";
    let far = "JOINT\n1\nABSOLUTE\n1 1 1 1 1\n1 1 1 1 1\n9 0 0 0 0\njoints = inclination\n";
    directory.write("six.trj", six);
    directory.write("far.trj", far);
    let other = "the file belongs to another robot";
    for (task, parameters, options, refusal) in [
        ("replay", "file = 'six.trj'", &[][..], other),
        ("replay", "file = 'far.trj'", &[], "irb6"),
        ("replay", "file = 'missing.trj'", &[], "missing.trj"),
        ("replay", "", &[], "file"),
        ("replay", "file = 'six.trj'\nrobot = 'left'", &[], "the cell has no robot \"left\""),
        ("teach", "file = 'new.trj'\nvelocity = 1.5", &["--operator"], "must be above 0 and at most 1"),
        ("teach", "file = 'six.trj'", &["--operator"], "is there already"),
        ("teach", "file = 'new.trj'", &[], "run the task with --operator"),
    ] {
        let cell = cell(&directory, parameters);
        let trace = directory.path("trace");
        let options = [options, &["--bench=lockstep", "--trace", trace.to_str().unwrap()]].concat();
        let run = mrroc(arguments(&cell, task, &options));
        assert_eq!(run.status.code(), Some(2), "{task}, {parameters}: {run:?}");
        assert!(run.stderr.contains(refusal), "{task}, {parameters}: {run:?}");
        assert!(!trace.exists() && !directory.path("new.trj").exists(), "{task}, {parameters}: {run:?}");
    }
}

/// A JOINT file of the IRb-6 as MRROC++ wrote it since September 2010, with these five joints.
fn joint_file(joints: &str) -> String {
    format!("JOINT\n1\nABSOLUTE\n1 1 1 1 1\n1 1 1 1 1\n{joints}\n")
}

#[test]
fn a_joint_file_that_does_not_tell_its_joints_is_replayed_with_a_key_or_an_option_only() {
    let directory = Directory::new();
    // The inclinations 0.3, -1.5, 0.1, 0.2, 0 as relative joints.
    let relative = 0.1 + 1.5 - std::f64::consts::FRAC_PI_2;
    directory.write("relative.trj", &joint_file(&format!("0.3 -1.5 {relative} 0.1 0")));
    let of_key = |key: &str| cell(&directory, &format!("file = 'relative.trj'\n{key}"));
    let refused = mrroc(arguments(&of_key(""), "replay", &["--bench=lockstep"]));
    assert_eq!(refused.status.code(), Some(2), "{refused:?}");
    for part in
        ["relative.trj: the file does not tell", "joints = \"inclination\"", "joints = \"relative\"", "set task.joints"]
    {
        assert!(refused.stderr.contains(part), "{part}: {refused:?}");
    }
    let checked = mrroc(["check", of_key("").to_str().unwrap(), "--task", "replay"]);
    assert_eq!(checked.status.code(), Some(2), "{checked:?}");
    let record = directory.path("record.csv");
    // The option takes precedence over the key.
    for (key, options) in [("joints = 'relative'", &[][..]), ("joints = 'inclination'", &["--joints", "relative"])] {
        let options = [&["--bench=lockstep", "--force", "--record", record.to_str().unwrap()], options].concat();
        let run = mrroc(arguments(&of_key(key), "replay", &options));
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        let reached = end(&record);
        directory.write("inclinations.trj", &format!("{}joints = inclination\n", joint_file("0.3 -1.5 0.1 0.2 0")));
        let other = cell(&directory, "file = 'inclinations.trj'");
        let run =
            mrroc(arguments(&other, "replay", &["--bench=lockstep", "--force", "--record", record.to_str().unwrap()]));
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        for (axis, position) in end(&record) {
            assert!((position - reached[&axis]).abs() < 1e-6, "{axis}: {position} and {}", reached[&axis]);
        }
    }
    let contradicted = cell(&directory, "file = 'inclinations.trj'\njoints = 'relative'");
    let run = mrroc(arguments(&contradicted, "replay", &["--bench=lockstep"]));
    assert_eq!(run.status.code(), Some(2), "{run:?}");
    assert!(run.stderr.contains("contradicts the file"), "{run:?}");
    let home = mrroc(["check", of_key("").to_str().unwrap(), "--task", "home", "--joints", "relative"]);
    assert_eq!(home.status.code(), Some(2), "{home:?}");
    assert!(home.stderr.contains("--joints: the task has no trajectory file"), "{home:?}");
}

#[test]
fn a_teach_in_writes_relative_joints_on_request_and_its_file_is_replayed_without_the_key() {
    let directory = Directory::new();
    let cells = ["joints = 'relative'", ""].map(|key| (key, cell(&directory, &format!("file = 'poses.trj'\n{key}"))));
    let run = teach_in_lockstep(&cells[0].1, &ORDERS, &["--joints", "relative"]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let text = fs::read_to_string(directory.path("poses.trj")).unwrap();
    assert!(text.ends_with("\njoints = relative\n"), "{text}");
    let poses = TrajectoryFile::parse(&text).unwrap();
    // Of the taught displacements (th2 by -0.1), q3 has the opposite one.
    let [first, second] = [0, 1].map(|pose| poses.poses()[pose].position);
    assert!((second[1] - first[1] + 0.1).abs() < 1e-6 && (second[2] - first[2] - 0.1).abs() < 1e-6, "{text}");
    let run = mrroc(arguments(&cells[1].1, "replay", &["--bench=lockstep"]));
    assert_eq!(run.status.code(), Some(0), "{run:?}");
}

#[test]
fn what_a_replay_ignores_of_its_file_is_told_once() {
    let directory = Directory::new();
    let spare = format!("{}joints = inclination\n1 1 1 1 1\n", joint_file("0.3 -1.5 0.1 0.2 0"));
    directory.write("spare.trj", &spare);
    let run = mrroc(arguments(&cell(&directory, "file = 'spare.trj'"), "replay", &["--bench=lockstep"]));
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let told = "spare.trj: lines from 8 on (1) are ignored: they are behind the 1 pose of line 2";
    assert_eq!(run.stderr.matches(told).count(), 1, "{run:?}");
}

#[test]
fn a_conversion_near_a_singular_posture_is_told() {
    let directory = Directory::new();
    // The hand axis of the IRp-6 is normal to the plane of its arm.
    let near = "0.3,-1.4,0.1,0.2,0,0.5";
    let pose = mrroc(["kinematics", "fk", "--robot", "irp6", "--json", "--joints", near]).json();
    let numbers = |name: &str| -> Vec<f64> {
        pose[name].as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
    };
    let quaternion = numbers("quaternion");
    let half = quaternion[0].acos();
    let turn = quaternion[1..].iter().map(|part| part * 2.0 * half / half.sin());
    let row = numbers("position").into_iter().chain(turn).map(|number| format!("{number:.6}"));
    let row = row.collect::<Vec<_>>().join(" ");
    let text = format!("XYZ_ANGLE_AXIS\n1\nABSOLUTE\n.1 .1 .1 .1 .1 .1\n.1 .1 .1 .1 .1 .1\n{row}\n");
    let file = directory.write("tool.trj", &text);
    let convert = ["kinematics", "convert", "--robot", "irp6", "--near", near];
    let converted = mrroc(convert.map(AsRef::as_ref).into_iter().chain([file.as_os_str()]));
    assert_eq!(converted.status.code(), Some(0), "{converted:?}");
    for said in ["tool.trj: pose 1 is ", "beside a singular posture", "does not determine axis 3"] {
        assert!(converted.stderr.contains(said), "{converted:?}");
    }
}

#[test]
fn a_file_with_poses_of_the_tool_is_refused_with_the_command_that_converts_it() {
    let directory = Directory::new();
    let tool = "XYZ_ANGLE_AXIS\n1\nRELATIVE\n.1 .2 .3 .4 .5 .6\n.1 .1 .1 .1 .1 .1\n0 0 -.02 0 0 0\n";
    directory.write("tool.trj", tool);
    let cell = cell(&directory, "file = 'tool.trj'");
    let run = mrroc(arguments(&cell, "replay", &["--bench=lockstep"]));
    assert_eq!(run.status.code(), Some(2), "{run:?}");
    assert!(run.stderr.contains("convert them to JOINT by `mrroc kinematics convert`"), "{run:?}");
    let (file, cell) = (directory.path("tool.trj"), cell.to_str().unwrap().to_owned());
    let of_cell = ["kinematics", "convert", file.to_str().unwrap(), "--robot", "irb6", "--cell", &cell];
    let converted = mrroc(of_cell.into_iter().chain(["--near", "0.3,-1.5,0.1,0.2,0"]));
    assert_eq!(converted.status.code(), Some(0), "{converted:?}");
    assert!(converted.stderr.contains("the least fraction of its row"), "{converted:?}");
    directory.write("tool.trj", &converted.stdout);
    let run = mrroc(arguments(Path::new(&cell), "replay", &["--bench=lockstep"]));
    assert_eq!(run.status.code(), Some(0), "{run:?}");
}
