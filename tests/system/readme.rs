//! The commands that the README shows, and the excerpts of cell files in the book. `tests/readme` runs the commands.

use std::fs;

use kit::mrroc::{Directory, cargo, example, mrroc, root};
use serde_json::{Value, json};

/// The programs of the workspace according to `cargo metadata`.
fn programs(metadata: &Value) -> Vec<&Value> {
    let packages = metadata["packages"].as_array().expect("a list of packages");
    let targets = packages.iter().flat_map(|package| {
        let targets = package["targets"].as_array();
        targets.expect("a list of targets")
    });
    let is_program = |target: &&Value| target["kind"] == json!(["bin"]);
    targets.filter(is_program).map(|it| &it["name"]).collect()
}

/// `cargo run` without a name fails if there are two programs.
#[test]
fn cargo_run_has_one_program_to_choose_from() {
    let metadata = cargo()
        .args(["metadata", "--no-deps", "--format-version=1", "--locked", "--offline"])
        .current_dir(root())
        .output()
        .unwrap();
    let metadata: Value = serde_json::from_slice(&metadata.stdout).unwrap();
    assert_eq!(programs(&metadata), ["mrroc"]);
}

/// Excerpts of cell files in a page of the book.
fn excerpts(page: &str) -> Vec<&str> {
    let blocks = page.split("```toml\n").skip(1);
    let blocks = blocks.map(|rest| rest.split("```").next().unwrap());
    // Excerpts of a Cargo.toml are no cell files.
    blocks.filter(|it| !it.starts_with("[dependencies]")).collect()
}

#[test]
fn excerpts_of_cell_files_in_the_book_are_accepted() {
    let directory = Directory::new();
    let irb6 = fs::read_to_string(example("irb6")).unwrap();
    let wrist = fs::read_to_string(example("irb6-wrist")).unwrap();
    // The book has a table of this name too.
    let irb6 = irb6.split("[task]").next().unwrap();
    let mut count = 0;
    for page in fs::read_dir(root().join("book/src")).unwrap() {
        let page = page.unwrap().path();
        for excerpt in excerpts(&fs::read_to_string(&page).unwrap()) {
            let base = if excerpt.starts_with("[robot.force_law]") { &*wrist } else { irb6 };
            let cell = directory.write("cell.toml", &format!("{base}\n{excerpt}"));
            let check = mrroc(["check".as_ref(), cell.as_os_str()]);
            assert_eq!(check.status.code(), Some(0), "{page:?}: {excerpt}{check:?}");
            count += 1;
        }
    }
    assert!(count >= 2, "{count} excerpts");
}

/// A page of the book.
fn page(name: &str) -> String {
    fs::read_to_string(root().join("book/src").join(name)).unwrap()
}

#[test]
fn the_book_names_the_calls_of_the_speed() {
    let page = page("first-run.md");
    for call in ["set(", "pause()", "resume()", "fraction()", "is_paused()"] {
        assert!(page.contains(call), "{call}");
    }
}

#[test]
fn the_book_states_the_limits_of_generators() {
    let source = fs::read_to_string(root().join("mrroc/src/cell/program.rs")).unwrap();
    let numbers = "const JOINT_LIMITS: (f64, f64, f64) = (1.5, 7.0, 70.0);";
    assert!(source.contains(numbers) && source.contains("const PLANNED: (f64, f64) = (0.95, 0.5);"));
    let page = page("motions.md").replace('\n', " ");
    for said in ["1.5 rad/s and 7 rad/s²", "95 % of its `max_velocity` or 50 % of its `max_acceleration`"] {
        assert!(page.contains(said), "{said}");
    }
}

#[test]
fn no_page_sends_readers_to_a_test_for_a_rule() {
    // The pages of gains have their rules and numbers themselves.
    for name in ["tuning.md", "first-run.md", "homing.md", "motions.md", "commands.md"] {
        assert!(!page(name).contains("tests/system"), "{name}");
    }
}

#[test]
fn the_teach_in_of_the_book_records_as_many_poses_as_the_page_says() {
    let page = page("teach.md");
    let orders = page.lines().find_map(|line| line.strip_prefix("printf '%s\\n' ")).unwrap();
    let orders = orders.trim_end_matches(" |").replace('\'', "\n");
    let (mut lines, mut quoted) = (Vec::new(), false);
    for part in orders.split('\n') {
        match quoted {
            true => lines.push(part),
            false => lines.extend(part.split_whitespace()),
        }
        quoted = !quoted;
    }
    assert!(lines.contains(&"done") && lines.contains(&"move column 0.3"), "{lines:?}");
    let directory = Directory::new();
    let cell = kit::teach::cell(&directory, "file = 'poses.trj'");
    let arguments = kit::teach::arguments(&cell, "teach", &["--operator", "--bench=lockstep", "--json"]);
    let mut running = kit::mrroc::Running::with_input(&lines, arguments);
    running.close_input();
    let run = running.output();
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let poses = run.json()["figures"]["poses"].as_f64().unwrap() as usize;
    let word = ["no", "one", "two", "three", "four"][poses];
    assert!(page.contains(&format!("The first three commands teach {word} poses")), "{poses} poses");
}
