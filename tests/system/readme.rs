//! The commands that the README shows.

use std::process::Command;

use serde_json::{Value, json};

use crate::mrroc::root;

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
    let metadata = Command::new(env!("CARGO"))
        .args([
            "metadata",
            "--no-deps",
            "--format-version=1",
            "--locked",
            "--offline",
        ])
        .current_dir(root())
        .output()
        .unwrap();
    let metadata: Value = serde_json::from_slice(&metadata.stdout).unwrap();
    assert_eq!(programs(&metadata), ["mrroc"]);
}
