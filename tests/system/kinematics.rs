//! `mrroc kinematics` and `mrroc urdf`, as seen by a user and by a program.

use ::mrroc::cell::{Model, Parameters};
use controller::robot::RntParameters;
use kit::mrroc::{Directory, Output, ROBOTS, mrroc};
use kit::refusals::refused;
use serde_json::Value;

/// Runs `mrroc kinematics` with these arguments.
fn ask(words: &str) -> Output {
    mrroc(["kinematics"].into_iter().chain(words.split(' ')))
}

fn answer(words: &str) -> Value {
    let output = ask(&format!("{words} --json"));
    assert_eq!(output.status.code(), Some(0), "{words}: {output:?}");
    assert_eq!(output.stderr, "", "{words}");
    output.json()
}

fn numbers(value: &Value) -> Vec<f64> {
    let list = value.as_array().unwrap_or_else(|| panic!("{value} is no list"));
    list.iter().map(|number| number.as_f64().unwrap()).collect()
}

fn close(value: &Value, expected: &[f64], tolerance: f64) {
    let found = numbers(value);
    assert_eq!(found.len(), expected.len(), "{value}");
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() < tolerance, "{value} is not {expected}");
    }
}

fn list(numbers: &[f64]) -> String {
    let words: Vec<_> = numbers.iter().map(f64::to_string).collect();
    words.join(",")
}

#[test]
fn forward_gives_the_golden_positions_and_motors() {
    let legs = [0.953705712, 0.960914436, 0.842363921, 0.0, 50.0, 0.0];
    let irp6 = [-15.9, -5.0, -8.526944, 151.31, 314.612842, 791.0];
    let cases: [(&str, [f64; 3], &[f64]); 2] = [
        ("fk --robot rnt --joints 0.2,-0.1,0.9,0,0.5,0", [-0.109816758, -0.217444493, 1.072687360], &legs),
        ("fk --robot irp6 --joints 0,-1.5707963267948966,0,0,1.5707963267948966,0", [0.86, 0.0, 0.455], &irp6),
    ];
    for (words, position, motors) in cases {
        let found = answer(words);
        close(&found["position"], &position, 1e-9);
        close(&found["motors"], motors, 1e-6);
    }
    let rnt = answer(cases[0].0);
    close(&rnt["motors"], &legs, 1e-9);
    let turns = (legs[0] - 0.75) / 0.005;
    let angle = rnt["motor_angles"][0].as_f64().unwrap();
    assert!((angle - std::f64::consts::TAU * turns).abs() < 1e-5, "{angle}");
}

#[test]
fn forward_inverse_and_motors_agree_for_every_robot() {
    for robot in ROBOTS {
        let count = answer(&format!("limits --robot {robot}"))["joints"].as_array().unwrap().len();
        let joints = match robot {
            "rnt" => vec![-0.2, 0.1, 0.9, 0.3, -0.6, 0.2],
            "polycrank" => vec![0.3, 1.1, -0.4, 0.2, 0.9, -0.3, 0.5],
            "irp6-track" => vec![0.4, -0.3, -1.5, 0.1, 0.2, 1.1, 0.3],
            _ => [-0.3, -1.5, 0.1, 0.2, 1.1, 0.3][..count].to_vec(),
        };
        let near = list(&joints);
        let found = answer(&format!("fk --robot {robot} --joints={near}"));
        close(&found["joints"], &joints, 1e-15);
        let motors = list(&numbers(&found["motors"]));
        let back = answer(&format!("fk --robot {robot} --motors {motors}"));
        close(&back["joints"], &joints, 1e-9);

        let (position, quaternion) = (numbers(&found["position"]), numbers(&found["quaternion"]));
        let solved = answer(&format!(
            "ik --robot {robot} --position {} --quaternion {} --near {near}",
            list(&position),
            list(&quaternion)
        ));
        assert!(!solved["solutions"].as_array().unwrap().is_empty(), "{solved}");
        for solution in solved["solutions"].as_array().unwrap() {
            let again = answer(&format!("fk --robot {robot} --joints {}", list(&numbers(solution))));
            close(&again["position"], &position, 1e-9);
            for row in 0..3 {
                close(&again["rotation"][row], &numbers(&found["rotation"][row]), 1e-9);
            }
        }
        close(&solved["solutions"][0], &joints, 1e-6);

        let jacobian = answer(&format!("jacobian --robot {robot} --joints {near}"));
        let rows = jacobian["jacobian"].as_array().unwrap();
        assert_eq!(rows.len(), 6, "{jacobian}");
        assert!(rows.iter().all(|row| row.as_array().unwrap().len() == count), "{jacobian}");
        assert!(jacobian["singularity"]["margin"].as_f64().unwrap() > 1e-3, "{jacobian}");
        for question in ["fk --joints", "jacobian --joints"] {
            let text = ask(&format!("{question} {near} --robot {robot}"));
            assert!(text.stdout.lines().count() > 5, "{text:?}");
        }
    }
}

#[test]
fn forward_answers_beyond_a_limit_without_motors_and_says_which() {
    let joints = "--robot rnt --joints 0.2,-0.1,1.3,0,0.5,0";
    let found = answer(&format!("fk {joints}"));
    assert!(found["motors"].is_null() && !found["position"].is_null(), "{found}");
    let note = "no motors: axis 2: joint at 1.300000 is beyond its limit 1.200000 (rad, or m of a linear joint)";
    for found in [found, answer(&format!("jacobian {joints}"))] {
        let notes = found["notes"].as_array().unwrap();
        assert!(notes.iter().any(|found| found == note), "{notes:?}");
    }
}

#[test]
fn nominal_figures_are_called_so_wherever_they_are_told() {
    let asked = "--robot rnt --joints 0,0,0.9,0,0.5,0";
    for words in [format!("fk {asked}"), format!("jacobian {asked}"), "limits --robot rnt".into()] {
        let note = answer(&words)["notes"][0].to_string();
        assert!(note.contains("nominal"), "{words}: {note}");
        let text = ask(&words).stdout;
        assert!(text.contains("nominal"), "{words}: {text}");
    }
    let described = mrroc(["urdf", "--robot", "rnt"]).stdout;
    assert!(described.contains("nominal"), "{described}");
    assert!(answer("limits --robot irp6")["notes"].is_null());
}

#[test]
fn a_cell_brings_its_own_parameters() {
    let directory = Directory::new();
    let cell = directory.cell("irp6", |cell| {
        let mut parameters = RntParameters::nominal();
        parameters.wrist_offset = 0.3;
        let robot = &mut cell.robot[0];
        robot.name = "mill".into();
        robot.model = Some(Model::Rnt);
        robot.parameters = Some(Parameters::Rnt(parameters));
        robot.program.clear();
    });
    let cell = cell.display();
    let found = answer(&format!("fk --cell {cell} --robot mill --joints 0,0,0.9,0,0.5,0"));
    close(&found["position"], &[0.0, 0.0, 1.2], 1e-12);
    let other = ask(&format!("fk --cell {cell} --robot rnt --joints 0,0,0.9,0,0.5,0"));
    refused(&other, &["has no robot \"rnt\", only mill"]);
}

#[test]
fn golden_vectors_come_back_to_a_nanometre() {
    let half = std::f64::consts::FRAC_PI_2;
    let upright = format!("--robot irp6 --joints 0,{},0,0,{half},0", -half);
    let turned = "--robot irp6 --joints 0.3,-1.7,0.0707963268,-0.3292036732,1.1,0.6";
    let reached = [0.754232820, 0.233311552, 0.465238581];
    let cases: [(&str, [f64; 3]); 4] = [
        (&upright, [0.86, 0.0, 0.455]),
        (turned, reached),
        ("--robot rnt --joints 0.2,-0.1,0.9,0,0.5,0", [-0.109816758, -0.217444493, 1.072687360]),
        ("--robot polycrank --joints 0,0,0,0,0,0,0", [0.183, -0.296, 0.664]),
    ];
    for (words, position) in cases {
        close(&answer(&format!("fk {words}"))["position"], &position, 1e-9);
    }
    let found = answer(&format!("fk {turned}"));
    close(&found["rotation"][0], &[0.612201, 0.676525, -0.409296], 1e-6);
    let motors = [-63.3, -27.601462, 3.904375, 193.44807, 392.90807, 964.3307];
    close(&found["motors"], &motors, 1e-6);
    let polycrank = answer(&format!("fk {}", cases[3].0));
    for (row, axis) in [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]].iter().enumerate() {
        close(&polycrank["rotation"][row], axis, 1e-9);
    }
    let solved = answer(&format!(
        "ik --robot irp6 --position {} --quaternion {} --near 0,{},0,0,{half},0",
        list(&numbers(&found["position"])),
        list(&numbers(&found["quaternion"])),
        -half
    ));
    let expected = [0.3, -1.7, 0.0707963268, -0.3292036732, 1.1, 0.6];
    close(&solved["solutions"][0], &expected, 1e-9);
}

#[test]
fn lists_are_read_with_a_sign_in_front_and_spaces_between() {
    let expected = answer("fk --robot irb6 --joints=-0.3,-1.5,0.1,0.2,1.1");
    for list in ["-0.3, -1.5, 0.1, 0.2, 1.1", " -0.3 ,-1.5,0.1,0.2,1.1 ", "-3e-1,-1.5,.1,+0.2,1.1"] {
        let output = mrroc(["kinematics", "fk", "--json", "--robot", "irb6", "--joints", list]);
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        assert_eq!(output.json(), expected, "{list}");
    }
}

#[test]
fn wrong_words_are_refused_in_one_line() {
    let cases: [(&str, &[&str]); 6] = [
        ("fk --robot irp6", &["not provided: <--joints <JOINTS>|--motors <MOTORS>>; usage: mrroc"]),
        ("fk --joints 1", &["not provided: --robot <ROBOT>; usage: mrroc kinematics fk"]),
        ("fk --robot irp6 --joints 1 --motors 1", &["'--joints <JOINTS>' cannot be used with '--motors"]),
        ("ik --robot irp6 --position 1,2,3", &["not provided: --quaternion <QUATERNION>"]),
        ("fk --robot irp6 --jonts 1", &["unexpected argument '--jonts' found; tip: ", "'--joints'"]),
        ("forward --robot irp6", &["unrecognized subcommand 'forward'"]),
    ];
    for (words, needles) in cases {
        refused(&ask(words), needles);
    }
    refused(&mrroc(["run"]), &["not provided: <CELL>"]);
}

#[test]
fn joints_in_degrees_are_answered_with_a_word_about_radians() {
    let notes = |joints: &str| answer(&format!("fk --robot irp6 --joints {joints}"))["notes"].to_string();
    assert!(notes("0,-90,0,0,90,0").contains("rad and m, not degrees"));
    for within_reason in ["0,-1,0,0,20,0", "0,-1.5,0,0,-9,0"] {
        let notes = notes(within_reason);
        assert!(notes.contains("beyond its limit") && !notes.contains("degrees"), "{notes}");
    }
    let free = answer("fk --robot polycrank --joints 90,0,0,0,0,0,0")["notes"].to_string();
    assert!(!free.contains("degrees"), "a joint without end may turn: {free}");
}

#[test]
fn the_polycranks_description_stands_on_the_floor_with_axis_1_level() {
    let text = mrroc(["urdf", "--robot", "polycrank"]).stdout;
    let read = urdf_rs::read_from_string(&text).unwrap();
    let mounting = read.joints.iter().find(|joint| joint.name == "mounting").unwrap();
    assert_eq!(mounting.parent.link, "floor");
    assert_eq!(mounting.origin.xyz.0, [0.0, 0.0, 0.925]);
    let [roll, pitch, yaw] = mounting.origin.rpy.0;
    // The third column and the third row of Rz(yaw) Ry(pitch) Rx(roll).
    let z = [
        yaw.cos() * pitch.sin() * roll.cos() + yaw.sin() * roll.sin(),
        yaw.sin() * pitch.sin() * roll.cos() - yaw.cos() * roll.sin(),
        pitch.cos() * roll.cos(),
    ];
    for (found, expected) in z.into_iter().zip([0.0, 1.0, 0.0]) {
        assert!((found - expected).abs() < 1e-12, "{z:?}");
    }
    assert!((-pitch.sin() - 1.0).abs() < 1e-12, "x of the base points up: {pitch}");
}

#[test]
fn questions_without_an_answer_are_refused_in_one_line() {
    let unit = "--quaternion 1,0,0,0";
    let known = format!("\"nosuch\", only {}", Model::ALL.map(Model::name).join(", "));
    let cases: [(&str, &str); 24] = [
        ("fk --robot nosuch --joints 1", &known),
        ("fk --robot irb6 --joints 1,2", "--joints: 2 positions, and irb6 has 5 axes"),
        ("fk --robot polycrank --joints 1,2,3,4,5,6,7,8,9", "--joints: 9 positions"),
        ("fk --robot irb6 --joints 1,2,x,4,5", "--joints: \"x\" is not a number, as in a list separated by commas"),
        ("fk --robot irb6 --joints 1,2,nan,4,5", "--joints: \"nan\" is not finite"),
        ("jacobian --robot irb6 --joints -inf,2,3,4,5", "--joints: \"-inf\" is not finite"),
        ("fk --robot irb6 --motors 1,2,3,4", "--motors: 4 positions"),
        ("fk --robot rnt --motors 0.55,1.38,0.55,0,0,0", "the legs do not close: leg "),
        ("ik --robot irp6 --position 0.8,0 --quaternion 1,0,0,0", "--position: 2 numbers, not the 3"),
        ("ik --robot irp6 --position 0.8,0,0 --quaternion 0,0,0,0", "--quaternion: its norm is 0.000000"),
        ("ik --robot irp6 --position 0.8,0,0 --quaternion 1,1,0,0", "--quaternion: its norm is 1.414214"),
        ("ik --robot irp6 --position 0.8,0,0 --quaternion 1,0,0,inf", "\"inf\" is not finite"),
        ("ik --robot irp6 --position 3,0,0", "out of reach"),
        ("ik --robot rnt --position 0,0,3", "axis 2: joint at 2.800000 is beyond its limit 1.200000"),
        ("ik --robot irb6 --position 3,0,0.5 --quaternion 0,1,0,0", "1.876837 m out of reach"),
        ("ik --robot irb6 --position 0,0,1 --quaternion 0,1,0,0", "axis 0 is undetermined 0.0e0 from a singular pose"),
        ("ik --robot irp6-calibrated --position 3,0,0.5 --quaternion 0,1,0,0", "1.721342 m out of reach"),
        ("ik --robot irp6-track --position 0,3,0.5 --quaternion 0,1,0,0", "m out of reach"),
        ("ik --robot irp6-track-calibrated --position 0,3,0.5 --quaternion 0,1,0,0", "m out of reach"),
        ("ik --robot polycrank --position 3,0.2,0.8 --quaternion 0.9,0.1,0.3,0.3", "m out of reach"),
        ("ik --robot polycrank --position 3,0,0.5 --quaternion 0,1,0,0", "m out of reach"),
        ("ik --robot gripper --position 0.2,0,0", "axis 0: joint at 0.200000 is beyond its limit 0.091000"),
        ("ik --robot conveyor --position 0.2,0.1,0", "0.100000 m and 0.000000 rad off the only axis"),
        ("fk --robot conveyor --joints nan", "--joints: \"nan\" is not finite"),
    ];
    for (words, needle) in cases {
        let words = if words.starts_with("ik") && !words.contains("quaternion") {
            format!("{words} {unit}")
        } else {
            words.to_owned()
        };
        refused(&ask(&words), &[needle]);
    }
    refused(&mrroc(["urdf", "--robot", "nosuch"]), &["only irb6"]);
}

#[test]
fn a_singular_pose_as_it_is_printed_is_answered_near_the_posture() {
    for (robot, joints) in [
        ("irp6", "0.4,-1.4,0.2,0.3,0,-0.5"),
        ("irp6-track", "0.2,0.4,-1.4,0.2,0.3,0,-0.5"),
        ("rnt", "0.1,-0.2,1.0,0.4,0,0.3"),
        ("polycrank", "0.3,1.0,0.2,0.4,1.0,-1.4,0.5"),
    ] {
        let pose = answer(&format!("fk --robot {robot} --joints={joints}"));
        let digits = |name: &str| {
            let numbers = numbers(&pose[name]).into_iter().map(|number| format!("{number:.9}"));
            numbers.collect::<Vec<_>>().join(",")
        };
        let (position, quaternion) = (digits("position"), digits("quaternion"));
        let words = format!("ik --robot {robot} --position={position} --quaternion={quaternion} --near={joints}");
        let found = numbers(&answer(&words)["solutions"][0]);
        for (found, near) in found.iter().zip(joints.split(',')) {
            assert!((found - near.parse::<f64>().unwrap()).abs() < 1e-6, "{robot}: {found} near {near}");
        }
    }
}

#[test]
fn an_answer_near_a_singular_posture_says_so_and_what_to_do() {
    // The joint that the pose does not determine, counted from 0.
    for (robot, joints, axis) in [
        ("irp6", "0.3,-1.4,0.1,0.2,0,0.5", 3),
        ("irp6-track", "0.4,0.3,-1.4,0.1,0.2,0,0.5", 4),
        ("rnt", "0.1,0.05,0.95,0.7,0,0.2", 3),
    ] {
        let pose = answer(&format!("fk --robot {robot} --joints={joints}"));
        for digits in [4, 6, 9] {
            let rounded = |name: &str| {
                let numbers = numbers(&pose[name]).into_iter().map(|number| format!("{number:.digits$}"));
                numbers.collect::<Vec<_>>().join(",")
            };
            let pose = format!("--position={} --quaternion={}", rounded("position"), rounded("quaternion"));
            let words = format!("ik --robot {robot} {pose} --near={joints}");
            let found = answer(&words);
            let notes = found["notes"].to_string();
            let open = format!("does not determine axis {axis}");
            assert!(notes.contains(&open), "{robot}, {digits} digits: {found}");
            let what_to_do = "give positions and orientations with nine digits, or move the joints";
            assert_eq!(notes.contains(what_to_do), digits < 9, "{robot}, {digits} digits: {found}");
            assert_eq!(notes.contains("is that of --near"), digits == 9, "{robot}, {digits} digits: {found}");
            assert!(ask(&words).stdout.contains(&open), "{robot}");
        }
    }
    // A posture that the pose determines has no note.
    for (robot, joints) in [("irp6", "0.3,-1.4,0.1,0.2,0.5,0.5"), ("irb6", "0.3,-1.4,0.1,0.2,0.5"), ("gripper", "0.08")]
    {
        let pose = answer(&format!("fk --robot {robot} --joints={joints}"));
        let words = ["position", "quaternion"].map(|name| list(&numbers(&pose[name])));
        let [position, quaternion] = words;
        let found =
            answer(&format!("ik --robot {robot} --position={position} --quaternion={quaternion} --near={joints}"));
        assert!(!found["notes"].to_string().contains("singular"), "{found}");
    }
}

#[test]
fn a_quaternion_of_few_digits_is_normalised() {
    let of = |quaternion| {
        let words = format!("ik --robot rnt --position 0.1,0.1,1.1 --quaternion {quaternion}");
        numbers(&answer(&words)["solutions"][0])
    };
    let (rounded, exact) = (of("0.877,0,0.479,0"), of("0.8776043,0,0.4793838,0"));
    for (rounded, exact) in rounded.iter().zip(&exact) {
        assert!((rounded - exact).abs() < 2e-3, "{rounded} {exact}");
    }
}

#[test]
fn a_description_is_what_urdf_rs_reads_and_reaches_the_flange() {
    for robot in ROBOTS {
        let output = mrroc(["urdf", "--robot", robot]);
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        let read = urdf_rs::read_from_string(&output.stdout)
            .unwrap_or_else(|error| panic!("{robot}: {error}\n{}", output.stdout));
        assert_eq!(read.name, robot);
        let axes = answer(&format!("limits --robot {robot}"))["joints"].as_array().unwrap().len();
        let mounted = usize::from(robot == "polycrank");
        assert_eq!(read.joints.len(), axes + 1 + mounted, "{robot}");
        let root = if mounted == 1 { "floor" } else { "base_link" };
        let mut parent = root.to_owned();
        for joint in &read.joints {
            assert_eq!(joint.parent.link, parent, "{robot}: one chain");
            parent.clone_from(&joint.child.link);
            assert!(read.links.iter().any(|link| link.name == parent), "{robot}: {parent}");
        }
        assert_eq!(parent, "flange", "{robot}");
        for joint in read.joints.iter().filter(|joint| joint.joint_type != urdf_rs::JointType::Fixed) {
            assert!(joint.limit.effort > 0.0 && joint.limit.velocity > 0.0, "{robot}: {}", joint.name);
            let moved = read.links.iter().find(|link| link.name == joint.child.link).unwrap();
            assert!(moved.inertial.mass.value > 0.0 && !moved.collision.is_empty(), "{robot}: {}", moved.name);
        }
        assert!(read.links.iter().filter(|link| !link.visual.is_empty()).count() >= axes, "{robot}");
    }
}

/// Name, centre in the frame of the cell, m, and edges, m, of a box.
type Drawn = (&'static str, [f64; 3], [f64; 3]);

#[test]
fn a_description_from_a_cell_has_its_scene_fixed_to_the_world() {
    let bar: &[Drawn] =
        &[("plane_0", [0.0, 0.0, 0.775], [4.0, 4.0, 0.01]), ("bar_0", [1.1, 0.0, 0.8], [0.9, 0.04, 0.04])];
    // The beams of the light gates are along y of the cell.
    let belt: &[Drawn] = &[
        ("conveyor_0", [0.5, 1.2, 0.45], [1.2, 0.3, 0.1]),
        ("object_0", [0.0, 1.2, 0.53], [0.08, 0.1, 0.06]),
        ("gate_0", [0.3, 1.2, 0.53], [0.4, 0.004, 0.004]),
        ("gate_1", [0.7, 1.2, 0.53], [0.4, 0.004, 0.004]),
    ];
    let box_on_wall: &[Drawn] =
        &[("plane_0", [0.0, 0.505, 0.0], [4.0, 4.0, 0.01]), ("block_0", [0.713, 0.475, 0.887], [0.08, 0.05, 0.06])];
    let board: &[Drawn] = &[("workpiece_0", [0.67, 0.0, 0.7775], [0.08, 0.12, 0.005])];
    for (name, robot, boxes) in [
        ("two-irb6-bar", "right", bar),
        ("irb6-conveyor", "irb6", belt),
        ("irb6-sonar", "irb6", box_on_wall),
        ("irb6-milling", "irb6", board),
    ] {
        let path = kit::mrroc::example(name);
        let output = mrroc(["urdf", "--robot", robot, "--cell", path.to_str().unwrap()]);
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        let read = urdf_rs::read_from_string(&output.stdout).unwrap();
        // One tree: every link but the world is the child of one joint.
        let is_child = |link: &str| read.joints.iter().filter(|joint| joint.child.link == link).count();
        for link in &read.links {
            assert_eq!(is_child(&link.name), usize::from(link.name != "world"), "{name}: {}", link.name);
        }
        let place = |link: &str| read.joints.iter().find(|joint| joint.child.link == link).unwrap();
        let cell = ::mrroc::cell::Cell::parse(&kit::mrroc::text(name)).unwrap();
        let base = cell.robot.iter().find(|it| it.name == robot).unwrap().cell_from_base();
        let own = format!("{robot}_base_link");
        assert_eq!(place(&own).parent.link, "world");
        assert_eq!(place(&own).origin.xyz.0, <[f64; 3]>::from(base.translation.vector));
        for (link, centre, size) in boxes {
            let joint = place(link);
            assert_eq!((joint.parent.link.as_str(), &joint.joint_type), ("world", &urdf_rs::JointType::Fixed));
            let near = |found: [f64; 3], expected: &[f64; 3]| (0..3).all(|it| (found[it] - expected[it]).abs() < 1e-12);
            assert!(near(joint.origin.xyz.0, centre), "{link}: {:?}", joint.origin.xyz);
            if link.starts_with("gate") {
                let [roll, pitch, yaw] = joint.origin.rpy.0;
                let along = nalgebra::UnitQuaternion::from_euler_angles(roll, pitch, yaw) * nalgebra::Vector3::x();
                assert!((along - nalgebra::Vector3::y()).norm() < 1e-12, "{link}: {along}");
            }
            let drawn = &read.links.iter().find(|it| it.name == *link).unwrap().visual[0];
            let urdf_rs::Geometry::Box { size: found } = &drawn.geometry else {
                panic!("{link}: {:?}", drawn.geometry);
            };
            assert!(near(found.0, size), "{link}: {found:?}");
            let collides = !read.links.iter().find(|it| it.name == *link).unwrap().collision.is_empty();
            assert_eq!(collides, !link.starts_with("gate"), "{link}: light does not collide");
            assert!(drawn.material.as_ref().is_some_and(|material| material.color.is_some()), "{link}");
        }
    }
}
