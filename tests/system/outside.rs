//! A program of a user that is no member of the workspace.

use std::fs;
use std::process::Command;

use crate::mrroc::root;

#[test]
fn a_program_outside_the_workspace_runs_its_own_generator_in_lockstep() {
    let package = root().join("tests/outside");
    let built = Command::new(env!("CARGO"))
        .args(["run", "--quiet", "--locked", "--manifest-path"])
        .arg(package.join("Cargo.toml"))
        .arg("--config")
        .arg(package.join("profile.toml"))
        .arg("--target-dir")
        .arg(root().join("target"))
        .arg("--")
        .arg(root().join("cells/irb6.toml"))
        .output()
        .unwrap();
    let said = String::from_utf8(built.stdout).unwrap();
    let errors = String::from_utf8_lossy(&built.stderr);
    assert!(built.status.success(), "{said}{errors}");
    let error = said
        .strip_prefix("Completed, column ")
        .and_then(|rest| rest.strip_suffix(" rad rms\n"))
        .unwrap_or_else(|| panic!("{said}"));
    let error: f64 = error.parse().unwrap();
    assert!(error > 0.0 && error < 0.01, "{said}");
}

#[test]
fn such_a_program_has_one_dependency_of_ours_and_forty_lines() {
    let package = root().join("tests/outside");
    let manifest: toml::Table = fs::read_to_string(package.join("Cargo.toml"))
        .unwrap()
        .parse()
        .unwrap();
    let dependencies: Vec<_> = manifest["dependencies"]
        .as_table()
        .unwrap()
        .keys()
        .collect();
    assert_eq!(dependencies, ["mrroc"]);
    let program = fs::read_to_string(package.join("src/main.rs")).unwrap();
    assert!(program.lines().count() <= 40, "{}", program.lines().count());
}
