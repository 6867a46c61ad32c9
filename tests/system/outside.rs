//! Programs of users: the examples of the library, and a program that is no member of the workspace. `tests/outside/run`
//! builds and runs the latter.

use std::fs;
use std::process::Command;

use kit::mrroc::{Directory, example_program, root};

#[test]
fn the_example_generator_swings_out_and_comes_back_to_where_it_began() {
    let directory = Directory::new();
    let record = directory.path("swing.csv");
    let run = Command::new(example_program("own_generator"))
        .args(["--bench", "lockstep", "--record"])
        .arg(&record)
        .current_dir(root())
        .output()
        .unwrap();
    assert!(run.status.success(), "{run:?}");
    let record = fs::read_to_string(record).unwrap();
    let moving = record.lines().filter_map(|line| {
        let fields: Vec<_> = line.split(',').collect();
        let swings = fields[2] == "column" && fields[3] == "Moving";
        swings.then(|| fields[5].parse::<f64>().unwrap())
    });
    let commanded: Vec<_> = moving.collect();
    // 200 macrosteps of ten periods.
    assert!((1990..=2000).contains(&commanded.len()), "{}", commanded.len());
    let (first, last) = (commanded[0], commanded[commanded.len() - 1]);
    assert!((first - last).abs() < 1e-3, "{first} {last}");
    let farthest = commanded.iter().map(|it| (it - first).abs()).fold(0.0, f64::max);
    // 0.5 rad of the joint, by a gear of 158.
    assert!((70.0..90.0).contains(&farthest), "{farthest}");
}

#[test]
fn the_example_of_a_retry_completes_and_lists_the_errors_that_it_handled() {
    let program = example_program("retry");
    let run = Command::new(program).args(["--bench", "lockstep", "--json"]).current_dir(root()).output().unwrap();
    assert!(run.status.success(), "{run:?}");
    let report: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!((&report["outcome"], &report["faults"]), (&"completed".into(), &serde_json::json!([])));
    let recovered = report["recovered"].as_array().unwrap();
    assert!(!recovered.is_empty(), "{report}");
    for (error, instruction) in recovered.iter().zip(2..) {
        assert_eq!((&error["robot"], &error["class"]), (&"irb6".into(), &"non-fatal".into()), "{error}");
        assert_eq!((&error["instruction"], &error["phase"]), (&instruction.into(), &"first-step".into()), "{error}");
        assert_eq!(error["step"], 0, "{error}");
        assert!(error["what"].as_str().unwrap().contains("at the least"), "{error}");
    }
}

/// The column must turn back from the side of its first target without a stop of the arm.
#[test]
fn the_example_of_replanning_turns_back_before_its_first_target() {
    let directory = Directory::new();
    let record = directory.path("record.csv");
    let program = example_program("replan");
    let arguments = ["--bench", "lockstep", "--json", "--record"];
    let run = Command::new(program).args(arguments).arg(&record).current_dir(root()).output().unwrap();
    assert!(run.status.success(), "{run:?}");
    let text = fs::read_to_string(record).unwrap();
    let column = |line: &str| {
        let fields: Vec<_> = line.split(',').collect();
        (fields[2] == "column" && fields[3] == "Moving").then(|| fields[5].parse::<f64>().unwrap())
    };
    let motor: Vec<f64> = text.lines().skip(1).filter_map(column).collect();
    let end = motor[motor.len() - 1] - motor[0];
    // The gear turns 0.8 rad and -0.3 rad of the column into motor angles of the ratio 8 to -3.
    let target = end * 0.8 / -0.3;
    let furthest = motor.iter().map(|at| (at - motor[0]) / target).fold(0.0, f64::max);
    assert!((0.05..0.95).contains(&furthest), "{furthest} of the way");
}

#[test]
fn such_a_program_has_one_dependency_of_ours_and_forty_lines() {
    let package = root().join("tests/outside");
    let manifest: toml::Table = fs::read_to_string(package.join("Cargo.toml")).unwrap().parse().unwrap();
    let dependencies: Vec<_> = manifest["dependencies"].as_table().unwrap().keys().collect();
    assert_eq!(dependencies, ["mrroc"]);
    let program = fs::read_to_string(package.join("src/main.rs")).unwrap();
    assert!(program.lines().count() <= 40, "{}", program.lines().count());
}

#[test]
fn a_program_has_the_whole_command_with_a_task_of_its_own() {
    let ask = |words: &str| {
        let program = example_program("own_command");
        Command::new(program).args(words.split(' ')).current_dir(root()).output().unwrap()
    };
    let checked = ask("check cells/irb6.toml --task wave");
    assert!(checked.status.success(), "{checked:?}");
    let run = ask("run cells/irb6.toml --task wave --bench lockstep --json");
    assert!(run.status.success(), "{run:?}");
    let report: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!(report["outcome"], "completed");
    let unknown = ask("run cells/irb6.toml --task wove --bench lockstep");
    assert_eq!(unknown.status.code(), Some(2));
    let said = String::from_utf8(unknown.stderr).unwrap();
    assert!(said.contains("programs, home, teach, replay, wave"), "{said}");
    let schema = ask("schema");
    assert_eq!(schema.stdout, fs::read(root().join("cells/cell.schema.json")).unwrap(), "other commands are there too");
}
