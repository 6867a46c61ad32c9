//! All robots of the laboratory together: they meet in the same cycle, and each robot refuses an impossible program.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::TAU;
use std::path::Path;

use ::mrroc::cell::{Cell, Instruction, JointGenerator};
use kit::meetings::{Row, beginnings, left_meetings, record};
use kit::mrroc::{Directory, example, mrroc, text};
use kit::refusals::refused;
use serde_json::Value;

fn run(cell: &Path, record: &Path) -> Value {
    let run = mrroc([
        "run".as_ref(),
        cell.as_os_str(),
        "--bench=lockstep".as_ref(),
        "--json".as_ref(),
        "--record".as_ref(),
        record.as_os_str(),
    ]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    run.json()
}

/// Checks the reported homing offsets. Every axis starts 20 rad above its home position. The belt takes its present
/// position for home.
///
/// Tests in `homing.rs` check at the plants that each axis finds its reference to a count. The report shows the view of
/// the host: the change of the counter between two samples minus the motion of the motor in that cycle. The host takes
/// that motion from the previous cycle. For a drive on CAN the result is a second difference of three counts. Each
/// count is rounded by up to a half, so the tolerance is two counts. For a serial axis, the weight changes the velocity
/// within the cycle, so the tolerance is the motion of one cycle.
fn check_homing(reports: &[Value]) {
    let cell = Cell::parse(&text("lab")).unwrap();
    let robots = cell.robot.iter();
    let axes: Vec<_> = robots.flat_map(|robot| &robot.axis).collect();
    assert_eq!(axes.len(), reports.len());
    for (axis, report) in axes.into_iter().zip(reports) {
        let found = report["homing_offset_counts"].as_f64().unwrap();
        let turns = if axis.name == "belt" { 0.0 } else { 20.0 / TAU };
        let counts = f64::from(axis.counts_per_revolution());
        let expected = -turns * counts;
        let within = match axis.controller {
            Some(_) => 1.0 + axis.homing.zero_velocity * 2e-3 * counts / TAU,
            None => 2.0,
        };
        assert!((found - expected).abs() <= within, "{report}, expected {expected}");
    }
}

/// The same, and that every robot reached its end in the same cycle as all other robots.
fn met(log: &Path) -> BTreeMap<String, Vec<Row>> {
    let rows = left_meetings(log);
    let ends = rows.values().map(|rows| {
        let standing = beginnings(rows, "Standing");
        standing[standing.len() - 3..].to_vec()
    });
    let ends: BTreeSet<_> = ends.collect();
    assert_eq!(ends.len(), 1, "{ends:?}");
    rows
}

#[test]
fn robots_that_meet_go_on_and_arrive_in_the_same_cycle() {
    let directory = Directory::new();
    let log = directory.path("lab.csv");
    let report = run(&example("lab"), &log);
    check_homing(report["axes"].as_array().unwrap());
    let rows = met(&log);
    // The robots do not arrive at the first meeting at the same time.
    let homed: BTreeSet<_> =
        rows.values().map(|rows| rows.iter().rfind(|row| row.1 == "Homing").map(|row| row.0)).collect();
    assert!(homed.len() >= 4, "{homed:?}");
}

#[test]
fn a_gripper_homes_from_the_far_end_of_its_travel() {
    // The polynomial of the opening has its vertex at 2564 rad. Positions below the vertex belong to the other branch,
    // so the farthest start position lies just above it.
    let start = 2570.0;
    let directory = Directory::new();
    let path = directory.cell("lab", |cell| {
        cell.robot.retain(|robot| robot.name == "gripper");
        cell.robot[0].program.clear();
        cell.robot[0].axis[0].emulator.start = Some(start);
        let bus = cell.robot[0].axis[0].bus.clone();
        cell.bus.retain(|it| it.name == bus);
        cell.serial.clear();
    });
    // The gripper starts on its switch and leaves it slowly: 2260 rad at 10 rad/s.
    let report = run(&path, &directory.path("gripper.csv"));
    let found = report["axes"][0]["homing_offset_counts"].as_f64().unwrap();
    let expected = (4830.0 - start) / TAU * 128.0;
    assert!((found - expected).abs() <= 2.0, "{report}, expected {expected}");
}

#[test]
fn a_joint_without_end_comes_back_to_its_count_from_twenty_turns() {
    const TURNS: i64 = 20;
    let far = (TURNS as f64 * TAU).to_string();
    let mut cell = Cell::parse(&text("polycrank")).unwrap();
    let robot = &mut cell.robot[0];
    let Instruction::Joints(mut motion) = robot.program[0].clone() else {
        panic!("the example begins with a motion of joints");
    };
    let home = [0.0, 1.57, -1.57, 0.0, 1.57, 0.0, 0.0];
    let turned = |joint: usize| {
        let mut pose = home.to_vec();
        pose[joint] += far.parse::<f64>().unwrap();
        pose
    };
    motion.poses = vec![home.to_vec()];
    (motion.velocity, motion.acceleration) = (1.0, 1.0);
    let mut there = motion.clone();
    there.poses = vec![turned(6)];
    // Friction keeps the motor some counts away from its set-point for a while.
    let mut rest = motion.clone();
    (rest.generator, rest.duration) = (JointGenerator::JerkLimited, Some(3.0));
    let program = [motion.clone(), rest.clone(), there, motion, rest];
    robot.program = program.map(Instruction::Joints).into();
    let directory = Directory::new();
    let path = directory.write("turns.toml", &toml::to_string(&cell).unwrap());
    let log = directory.path("turns.csv");
    run(&path, &log);
    let rows = &record(&log, &["q7"])["q7"];
    let starts = beginnings(rows, "Moving");
    let before = rows.iter().find(|row| row.0 + 1 == starts[2]).unwrap();
    let after = rows.iter().rfind(|row| row.1 == "Standing").unwrap();
    assert_eq!(before.2, after.2, "commanded");
    assert_eq!(before.3, after.3, "counts");
    let farthest = rows.iter().map(|row| row.3).max().unwrap();
    let counts = TURNS * 50 * 4000;
    let there = farthest - before.3;
    assert!((there - counts).abs() <= 20, "{there} counts away");
}

/// A cell, a text in it, the replacement of the text, and the required parts of the refusal.
type Case = (&'static str, &'static str, &'static str, &'static [&'static str]);

const REFUSED: &[Case] = &[
    // The tool axis would have to pass close to the direction of axis 1, which requires an instant half turn of axis 3.
    (
        "polycrank",
        "line = { position = [0.2, 0.2, 0.8]",
        "joints = { poses = [[0.0, 1.57, -1.57, 0.0, 1.57, -1.37, 0.0]] }\n\n[[robot.program]]\nline = { \
         quaternion = [-0.014088493, 0.995004165, 0.0, -0.098834333], position = [-0.139, -0.116, 0.8158]",
        &["robot[0].program[2]", "of the path: axis q3 jumps by "],
    ),
    (
        "polycrank",
        "position = [0.2, 0.2, 0.8]",
        "position = [2.0, 0.2, 0.8]",
        &["robot[0].program[1].line", "out of reach"],
    ),
    ("rnt", "[[0.1, -0.1, 0.9,", "[[0.1, -0.1, 1.9,", &["robot[0].program[0].joints.poses[0]", "beyond its limit"]),
    ("rnt", "model = \"rnt\"\n", "model = \"rnt\"\nparameters = { rnt = RNT }\n", &["robot[0].parameters", "leg"]),
    ("irp6-track", "[[0.3, 0.4,", "[[0.3,", &["robot[0].program[0].joints.poses[0]", "6 joint values", "7"]),
    ("polycrank", "[[0.4, 1.2,", "[[nan, 1.2,", &["robot[0].program[0].joints.poses[0][0]", "finite"]),
    (
        "lab",
        "poses = [[0.08]]",
        "poses = [[0.2]]",
        &["robot[4].program[1].joints.poses[0]", "jaws", "at 0.200000 is beyond its limit 0.091"],
    ),
    (
        "lab",
        "poses = [[0.25]]",
        "poses = [[0.25, 0.3]]",
        &["robot[5].program[3].joints.poses[0]", "2 joint values", "1"],
    ),
    ("lab", "meet = \"end\"", "meet = \"never\"", &["robot[0].program[4].meet", "no robot but \"irb6\"", "\"never\""]),
];

#[test]
fn what_a_robot_of_the_laboratory_cannot_do_is_refused_before_anything_moves() {
    let directory = Directory::new();
    // Legs that are too short for the pose.
    let mut rnt = controller::robot::RntParameters::nominal();
    rnt.base_radius = 2.0;
    let rnt = toml::Value::try_from(rnt).unwrap().to_string();
    for &(name, good, bad, needles) in REFUSED {
        let text = text(name);
        assert!(text.contains(good), "{name}: {good}");
        let spoilt = text.replacen(good, &bad.replace("RNT", &rnt), 1);
        let cell = directory.write("wrong.toml", &spoilt);
        let log = directory.path("wrong.log");
        for run in [crate::cli_refusals::run_in_lockstep(&cell, &log), mrroc(["check".as_ref(), cell.as_os_str()])] {
            refused(&run, needles);
            assert!(!log.exists(), "{name}, {bad}: a bus was opened");
        }
    }
}

/// The program of an arm, instruction by instruction, and the required parts of the refusal of the last instruction:
/// the axis and the amount of the violation.
type Arm = (&'static str, &'static [&'static str], &'static str);

const ARMS: &[Arm] = &[
    // Above the column, the pose does not determine the position of the column axis.
    (
        "irb6",
        &["joints = { poses = [[0.0, -1.57, 0.0, 1.57, 0.0]] }", "line = { position = [0.0, 0.0, 1.0] }"],
        "axis column is undetermined 0.0e0 from a singular pose",
    ),
    (
        "irb6-serial",
        &["joints = { poses = [[0.0, -1.57, 0.0, 0.0, 0.0]] }", "line = { position = [3.0, 0.0, 1.0] }"],
        "1.795449 m out of reach",
    ),
    // The wrists of both IRp-6 are singular at home.
    ("irp6", &["line = { position = [0.8, 0.15, 0.4] }"], "at 0.0286 of the path: axis lower-arm jumps by "),
    (
        "irp6",
        &["joints = { poses = [[0.0, -1.57, 0.0, 0.0, 1.57, 0.0]] }", "line = { position = [3.0, 0.0, 0.3] }"],
        "1.700969 m out of reach",
    ),
    ("irp6-track", &["line = { position = [0.8, 0.15, 0.4] }"], "at 0.0286 of the path: axis lower-arm jumps by "),
    (
        "irp6-track",
        &["joints = { poses = [[0.2, 0.0, -1.57, 0.0, 0.0, 1.57, 0.0]] }", "line = { position = [0.8, 3.0, 0.3] }"],
        "0.671276 m out of reach",
    ),
    // The wrist is straight at home: a line along y needs another roll at once.
    ("rnt", &["line = { position = [0.0, 0.1, 1.1] }"], "of the path: axis wrist-roll jumps by "),
    (
        "rnt",
        &["joints = { poses = [[0.1, -0.1, 0.9, 0.0, 0.5, 0.0]] }", "line = { position = [0.0, 0.0, 5.1] }"],
        "axis leg-3: joint at 4.900000 is beyond its limit 1.200000",
    ),
    (
        "polycrank",
        &["joints = { poses = [[0.4, 1.2, -1.2, 0.2, 1.2, 0.3, 0.1]] }", "line = { position = [3.1, 0.0, 1.1] }"],
        "0.085460 m out of reach",
    ),
];

#[test]
fn a_line_out_of_reach_or_past_a_singular_pose_is_refused_with_the_axis_or_the_margin() {
    let directory = Directory::new();
    for &(name, instructions, needle) in ARMS {
        let text = text(name);
        let begins = text.find("[[robot.program]]").expect("it has a program");
        let program: String = instructions.iter().map(|it| format!("[[robot.program]]\n{it}\n")).collect();
        let cell = directory.write("line.toml", &format!("{}{program}", &text[..begins]));
        let last = format!("robot[0].program[{}]", instructions.len() - 1);
        let log = directory.path("line.log");
        for run in [crate::cli_refusals::run_in_lockstep(&cell, &log), mrroc(["check".as_ref(), cell.as_os_str()])] {
            refused(&run, &[&last, needle]);
            if needle.ends_with(" jumps by ") {
                refused(&run, &["a singular posture", "twelve digits", "or move the joints"]);
            }
            assert!(!log.exists(), "{name}: a bus was opened");
        }
    }
}

#[test]
fn every_robot_refuses_poses_of_another_length_and_poses_that_are_no_numbers() {
    let directory = Directory::new();
    let lab = Cell::parse(&text("lab")).unwrap();
    for (number, robot) in lab.robot.iter().enumerate() {
        let axes = robot.axis.len();
        let instruction = robot.program.iter().position(|it| matches!(it, Instruction::Joints(_)));
        let place = format!("robot[{number}].program[{}].joints.poses[0]", instruction.unwrap());
        let mut wrong = vec![vec![0.0; axes + 1], vec![f64::NAN; axes]];
        // An empty pose is refused as well.
        wrong.push(vec![0.0; axes - 1]);
        for pose in wrong {
            let needles = [place.as_str(), if pose.len() == axes { "finite" } else { "joint values" }];
            let cell = directory.cell("lab", |cell| {
                let Some(Instruction::Joints(motion)) = cell.robot[number].program.get_mut(instruction.unwrap()) else {
                    panic!("{place} is a motion of joints");
                };
                motion.poses[0].clone_from(&pose);
            });
            refused(&mrroc(["check".as_ref(), cell.as_os_str()]), &needles);
        }
    }
}
