//! Robots of a user's own: from a description in URDF to a cell that is checked, runs and is replayed.

use std::fmt::Write as _;

use ::faults::{FaultOptions, fault_table};
use ::mrroc::cell::CellFile;
use kit::mrroc::{Directory, Output, example, mrroc};
use kit::refusals::refused;

/// A joint of a written description: kind, translation and roll of its frame, lower and upper limit.
type Joint = (&'static str, [f64; 3], f64, [f64; 2]);

const QUARTER: f64 = std::f64::consts::FRAC_PI_2;

/// SCARA: two parallel axes, a quill, and its rotation.
const SCARA: &[Joint] = &[
    ("revolute", [0.0, 0.0, 0.4], 0.0, [-2.4, 2.4]),
    ("revolute", [0.35, 0.0, 0.0], 0.0, [-2.5, 2.5]),
    ("prismatic", [0.25, 0.0, 0.0], 0.0, [-0.2, 0.0]),
    ("continuous", [0.0, 0.0, 0.0], 0.0, [0.0, 0.0]),
];

/// Three sliding axes across each other.
const GANTRY: &[Joint] = &[
    ("prismatic", [0.0, 0.0, 1.0], 0.0, [-0.5, 0.5]),
    ("prismatic", [0.0, 0.0, 0.0], -QUARTER, [-0.5, 0.5]),
    ("prismatic", [0.0, 0.0, 0.0], QUARTER, [-0.3, 0.3]),
];

/// One axis.
const TURNTABLE: &[Joint] = &[("continuous", [0.0, 0.0, 0.2], 0.0, [0.0, 0.0])];

/// Seven axes in the manner of an arm with an elbow (public parameters of the Panda, without its flange).
const REDUNDANT: &[Joint] = &[
    ("revolute", [0.0, 0.0, 0.333], 0.0, [-2.8973, 2.8973]),
    ("revolute", [0.0, 0.0, 0.0], -QUARTER, [-1.7628, 1.7628]),
    ("revolute", [0.0, -0.316, 0.0], QUARTER, [-2.8973, 2.8973]),
    ("revolute", [0.0825, 0.0, 0.0], QUARTER, [-3.0718, -0.0698]),
    ("revolute", [-0.0825, 0.384, 0.0], -QUARTER, [-2.8973, 2.8973]),
    ("revolute", [0.0, 0.0, 0.0], QUARTER, [-0.0175, 3.7525]),
    ("revolute", [0.088, 0.0, 0.0], QUARTER, [-2.8973, 2.8973]),
];

/// A description of these joints. Links have masses if `heavy`.
fn described(joints: &[Joint], heavy: bool) -> String {
    let mut text = "<robot name=\"written\">\n<link name=\"link0\"/>\n".to_owned();
    for (number, (kind, [x, y, z], roll, [lower, upper])) in joints.iter().enumerate() {
        let next = number + 1;
        let mass = match heavy {
            true => {
                "<inertial><origin xyz=\"0.05 0 0.05\"/><mass value=\"2\"/><inertia ixx=\"0.01\" ixy=\"0\" ixz=\"0\" \
                 iyy=\"0.01\" iyz=\"0\" izz=\"0.01\"/></inertial>"
            }
            false => "",
        };
        let _ = writeln!(
            text,
            "<joint name=\"j{next}\" type=\"{kind}\"><parent link=\"link{number}\"/><child link=\"link{next}\"/>\
             <origin xyz=\"{x} {y} {z}\" rpy=\"{roll} 0 0\"/><axis xyz=\"0 0 1\"/>\
             <limit lower=\"{lower}\" upper=\"{upper}\" effort=\"0\" velocity=\"0\"/></joint>\n\
             <link name=\"link{next}\">{mass}</link>"
        );
    }
    text + "</robot>\n"
}

/// Writes `description` and the cell of it, and returns the path of the cell.
fn new_cell(folder: &Directory, name: &str, description: &str) -> String {
    let urdf = folder.path(&format!("{name}.urdf"));
    std::fs::write(&urdf, description).unwrap();
    let cell = folder.path(&format!("{name}.toml"));
    let (urdf, cell) = (urdf.to_str().unwrap(), cell.to_str().unwrap());
    let made = mrroc(["new", cell, "--urdf", urdf]);
    assert_eq!(made.status.code(), Some(0), "{name}: {made:?}");
    cell.to_owned()
}

fn succeeds(words: &[&str]) -> Output {
    let output = mrroc(words.iter().copied());
    assert_eq!(output.status.code(), Some(0), "{words:?}: {output:?}");
    output
}

#[test]
fn a_written_cell_is_ready_without_an_edit_and_its_arm_moves() {
    let folder = Directory::new();
    let puma = std::fs::read_to_string(example("puma560").with_extension("urdf")).unwrap();
    let mut arms = vec![("puma".to_owned(), puma, 6)];
    for (name, joints) in [("scara", SCARA), ("gantry", GANTRY), ("turntable", TURNTABLE), ("redundant", REDUNDANT)] {
        for (weight, heavy) in [("light", false), ("heavy", true)] {
            arms.push((format!("{name}-{weight}"), described(joints, heavy), joints.len()));
        }
    }
    for (name, description, axes) in arms {
        let cell = new_cell(&folder, &name, &description);
        let checked = succeeds(&["check", &cell]);
        assert!(checked.stdout.contains(&format!("robot arm: {axes} ax")), "{name}: {}", checked.stdout);
        assert!(checked.stdout.contains("is ready"), "{name}: {}", checked.stdout);
        let recording = folder.path(&format!("{name}.mcap"));
        let recording = recording.to_str().unwrap();
        let run = succeeds(&["run", &cell, "--bench", "lockstep", "--json", "--record", recording]).json();
        assert_eq!(run["outcome"], "completed", "{name}: {run}");
        assert_eq!(run["axes"].as_array().unwrap().len(), axes, "{name}");
        // The recording carries the description.
        std::fs::remove_file(folder.path(&format!("{name}.urdf"))).unwrap();
        succeeds(&["replay", recording]);
    }
}

#[test]
fn a_cell_is_not_replaced_and_a_bad_description_is_refused_with_its_line() {
    let folder = Directory::new();
    let cell = new_cell(&folder, "scara", &described(SCARA, false));
    let urdf = cell.replace(".toml", ".urdf");
    refused(&mrroc(["new", &cell, "--urdf", &urdf]), &["scara.toml", "File exists"]);
    refused(&mrroc(["new"]), &["CELL and --urdf FILE are needed", "standard input is no terminal"]);
    refused(&mrroc(["new", &cell]), &["standard input is no terminal"]);
    refused(&mrroc(["new", &cell, "--urdf", "package://arms/a.urdf"]), &["add --package arms=DIR"]);
    std::fs::write(&urdf, described(SCARA, false).replacen("prismatic", "planar", 1)).unwrap();
    let other = folder.path("other.toml");
    refused(&mrroc(["new", other.to_str().unwrap(), "--urdf", &urdf]), &["scara.urdf:", "joint \"j3\" is planar"]);
    assert!(!other.exists());
    refused(&mrroc(["check", &cell]), &["scara.toml:", "robot[0].chain.urdf: scara.urdf:", "is planar"]);
    std::fs::remove_file(&urdf).unwrap();
    refused(&mrroc(["check", &cell]), &["robot[0].chain.urdf: scara.urdf: ", "No such file"]);
}

#[test]
fn a_robot_has_a_model_or_a_chain() {
    let folder = Directory::new();
    let cell = new_cell(&folder, "scara", &described(SCARA, false));
    let text = std::fs::read_to_string(&cell).unwrap();
    for (changed, said) in [
        (
            text.replacen("name = \"arm\"", "name = \"arm\"\nmodel = \"irb6\"", 1),
            "robot[0].model: has no effect beside chain",
        ),
        (text.replacen("joint_at_home", "joint_at_hom", 1), "joint_at_hom"),
        (
            text.replacen("[[robot.chain.joint]]\nname = \"j1\"\n", "[[robot.chain.joint]]\nname = \"j0\"\n", 1),
            "must be a joint of scara.urdf: j1, j2, j3, j4",
        ),
    ] {
        if changed == text {
            continue;
        }
        std::fs::write(&cell, changed).unwrap();
        refused(&mrroc(["check", &cell]), &["scara.toml:", said]);
    }
}

#[test]
fn a_table_of_joints_and_a_description_are_one_arm_whose_kinematics_agree() {
    let folder = Directory::new();
    let description = std::fs::read_to_string(example("puma560").with_extension("urdf")).unwrap();
    let described = new_cell(&folder, "puma", &description);
    let table = example("puma560");
    let of = |robot: &str, cell: &str, words: &str| {
        let words = format!("kinematics {words} --robot {robot} --cell {cell} --json");
        succeeds(&words.split(' ').collect::<Vec<_>>()).json()
    };
    let ask = |words: &str| of("puma560", table.to_str().unwrap(), words);
    let numbers = |value: &serde_json::Value| -> Vec<f64> {
        value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
    };
    let list = |numbers: &[f64]| numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
    let joints = [0.3, 0.7, -0.9, 0.4, 0.5, -0.6];
    let pose = ask(&format!("fk --joints {}", list(&joints)));
    let same = of("arm", &described, &format!("fk --joints {}", list(&joints)));
    for key in ["position", "quaternion"] {
        for (one, other) in numbers(&pose[key]).into_iter().zip(numbers(&same[key])) {
            assert!((one - other).abs() < 1e-8, "{key}: {one} and {other}, with nine digits of the angles in the file");
        }
    }
    let (position, quaternion) = (list(&numbers(&pose["position"])), list(&numbers(&pose["quaternion"])));
    let found = ask(&format!("ik --position {position} --quaternion {quaternion} --near {}", list(&joints)));
    let solutions = found["solutions"].as_array().unwrap();
    let first = numbers(&solutions[0]);
    for (found, expected) in first.iter().zip(joints) {
        assert!((found - expected).abs() < 1e-7, "{first:?}");
    }
}

#[test]
fn a_check_says_how_the_arm_is_solved_and_what_its_emulation_lacks() {
    let folder = Directory::new();
    let said = |name: &str, joints, heavy| {
        let cell = new_cell(&folder, name, &described(joints, heavy));
        succeeds(&["check", &cell]).stdout
    };
    let scara = said("scara", SCARA, false);
    assert!(scara.contains("inverse kinematics in closed form: SCARA"), "{scara}");
    assert!(scara.contains("no link has a mass: each emulated axis moves a load of its own"), "{scara}");
    let redundant = said("redundant", REDUNDANT, true);
    assert!(redundant.contains("inverse kinematics by a numerical search"), "{redundant}");
    assert!(!redundant.contains("mass"), "{redundant}");
}

/// Rows of the fault table of a described robot. Its drives, weight and speeds differ from those of the built-in
/// robots.
#[test]
fn faults_of_a_heavy_and_slow_arm_end_within_their_bounds() {
    let file = CellFile::read(example("puma560")).unwrap();
    let faults = [
        "supply sags",
        "brake does not hold",
        "collision",
        "encoder jumps by the smallest step, at top speed",
        "encoder jumps by 1.5 smallest steps, at top speed",
        "encoder jumps by ten smallest steps, at top speed",
    ];
    let fault = faults.map(str::to_owned).to_vec();
    let table = fault_table(&file, &FaultOptions { fault, ..FaultOptions::default() }).unwrap();
    assert!(table.played() >= 17, "{table}");
    let red: Vec<_> = table.red().map(|row| (row.fault, row.phase.name(), &row.reasons)).collect();
    assert!(red.is_empty(), "{red:?}");
    // The motors hold an arm that falls. A fault that shows in a motion is detected.
    let results = table.rows.iter().filter_map(|row| Some((row.fault, row.result.as_ref()?)));
    let results: Vec<_> = results.filter(|(_, result)| result.detection.is_some()).collect();
    let count = |fault: &str| results.iter().filter(|(of, _)| *of == fault).count();
    let held = results.iter().filter(|(of, result)| *of == "brake does not hold" && result.recovery == "stop");
    assert!(held.count() >= 5, "{table}");
    assert!(count("supply sags") >= 3 && count("collision") >= 3, "{table}");
}
