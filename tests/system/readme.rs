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
