//! Rules of the architecture: crates depend on each other in one direction only, and only listed files read clocks or
//! wait.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the tests' room is inside the workspace").to_owned()
}

/// Each room and the rooms it may import, by their names in the workspace.
const ARROWS: [(&str, &[&str]); 17] = [
    ("drivers/can", &[]),
    ("drivers/canopen", &["can"]),
    ("drivers/master", &["can", "canopen"]),
    ("drivers/serial", &["can"]),
    ("drivers/drive", &["can", "canopen", "master", "serial"]),
    ("servo", &["can", "drive"]),
    ("controller", &["can", "drive", "servo"]),
    ("hil", &["can", "canopen", "serial"]),
    ("mrroc", BELOW_LIBRARY),
    ("tools/descriptions", &["can", "controller", "hil", "mrroc"]),
    ("tools/faults", &["can", "serial", "drive", "servo", "controller", "hil", "mrroc"]),
    ("tools/host", &["can", "servo", "mrroc"]),
    ("tools/identify", &["can", "servo", "mrroc"]),
    ("tools/service", &["can", "canopen", "master", "serial", "drive", "hil", "mrroc"]),
    ("console", &["can", "canopen", "hil", "mrroc", "descriptions", "faults", "host", "identify", "service"]),
    ("tests", &["can", "canopen", "master", "serial", "drive", "servo", "controller", "hil", "mrroc", "faults"]),
    ("fuzz/targets", &["can", "canopen", "master", "serial", "drive", "controller", "hil", "mrroc"]),
];

/// The crates below the library for robot programs.
const BELOW_LIBRARY: &[&str] = &["can", "canopen", "master", "serial", "drive", "servo", "controller", "hil"];

/// Modules that may read clocks and wait, with the modules below them. Clippy refuses both in all others
/// (`clippy.toml`).
const RIM: [&str; 18] = [
    "console/src/emulate.rs",
    "drivers/can/src/clock.rs",
    "drivers/can/src/socketcan.rs",
    "hil/src/machine.rs",
    "hil/src/pty.rs",
    "mrroc/src/bench/bridge.rs",
    "mrroc/src/bench/bus_port.rs",
    "mrroc/src/bench/camera_wire.rs",
    "mrroc/src/bench/emulated_lines.rs",
    "mrroc/src/guardian/mod.rs",
    "mrroc/src/run/background.rs",
    "mrroc/src/run/mod.rs",
    "servo/src/thread.rs",
    "tools/host/src/doctor/mod.rs",
    "tools/host/src/jitter.rs",
    "tools/host/src/jitter/files.rs",
    "tools/identify/src/lib.rs",
    "tools/service/src/lib.rs",
];

fn forbidden_imports(room: &str, allowed: &[&str], manifest: &toml::Table) -> Vec<String> {
    let rooms: Vec<String> = manifest_names();
    let mut found = Vec::new();
    for section in ["dependencies", "dev-dependencies", "build-dependencies"] {
        let Some(table) = manifest.get(section).and_then(toml::Value::as_table) else {
            continue;
        };
        for name in table.keys().filter(|name| rooms.contains(name)) {
            if !allowed.contains(&name.as_str()) {
                found.push(format!("{room} imports {name} ({section})"));
            }
        }
    }
    found
}

fn manifest_names() -> Vec<String> {
    let manifest = read_manifest(&root().join("Cargo.toml"));
    let dependencies = manifest["workspace"]["dependencies"].as_table().expect("the workspace lists dependencies");
    let in_tree = |value: &toml::Value| value.get("path").is_some();
    dependencies.iter().filter(|(_, value)| in_tree(value)).map(|(name, _)| name.clone()).collect()
}

fn read_manifest(path: &Path) -> toml::Table {
    fs::read_to_string(path)
        .expect("every room has a manifest")
        .parse()
        .expect("cargo has read this manifest before us")
}

#[test]
fn rooms_import_one_way() {
    let workspace = read_manifest(&root().join("Cargo.toml"));
    let members: Vec<&str> =
        workspace["workspace"]["members"].as_array().unwrap().iter().map(|member| member.as_str().unwrap()).collect();
    let listed: BTreeMap<&str, &[&str]> = ARROWS.into_iter().collect();
    for member in &members {
        let allowed = listed.get(member).unwrap_or_else(|| panic!("room {member} has no row in ARROWS"));
        let found = forbidden_imports(member, allowed, &read_manifest(&root().join(member).join("Cargo.toml")));
        assert!(found.is_empty(), "forbidden imports: {found:?}");
    }
}

#[test]
fn a_forbidden_import_is_found() {
    let manifest: toml::Table =
        "[dependencies]\nhil.workspace = true\n[dev-dependencies]\nserde.workspace = true".parse().unwrap();
    assert_eq!(forbidden_imports("servo", &["can", "drive"], &manifest), ["servo imports hil (dependencies)"]);
}

/// All Rust files below a directory of the workspace.
fn sources(folder: &str) -> Vec<PathBuf> {
    let mut folders = vec![root().join(folder)];
    let mut found = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                found.push(path);
            }
        }
    }
    found
}

/// Clippy's lint against clock reads and waits, as named in an exception.
const REFUSAL: &str = "clippy::disallowed_methods";

#[test]
fn only_the_rim_is_excepted_from_the_refusal_of_clock_reads() {
    let rooms = ARROWS.into_iter().map(|(room, _)| room);
    let files = rooms.filter(|room| *room != "tests").flat_map(|room| sources(&format!("{room}/src")));
    let excepted = files.filter(|path| fs::read_to_string(path).unwrap().contains(REFUSAL));
    let root = root();
    let name = |path: PathBuf| path.strip_prefix(&root).unwrap().display().to_string();
    let mut excepted: Vec<_> = excepted.map(name).collect();
    // The tests of a crate control the timing of its threads.
    excepted.retain(|name| !name.ends_with("tests.rs"));
    excepted.sort();
    assert_eq!(excepted, RIM);
}

#[test]
fn every_function_of_the_clock_module_is_refused_outside_the_rim() {
    let refused = fs::read_to_string(root().join("clippy.toml")).unwrap();
    let clock = fs::read_to_string(root().join("drivers/can/src/clock.rs")).unwrap();
    for function in clock.lines().filter_map(|line| line.strip_prefix("pub fn ")) {
        let (name, _) = function.split_once('(').unwrap();
        let path = format!("\"mrroc_can::clock::{name}\"");
        assert!(refused.contains(&path), "{name}");
    }
}

/// Words of tests by the clock. Clippy also refuses clock reads and waits in `tests/system`.
const BY_THE_CLOCK: [&str; 13] = [
    "clippy::disallowed_methods",
    "processors::take",
    "= turn()",
    "on_vcan",
    "on_cards",
    "on_stage",
    "left_out(",
    "under_strace",
    "BenchKind::Emulated",
    "BenchKind::Vcan",
    "BenchKind::Card",
    "--bench=emulated",
    "\"--bench\", \"emulated\"",
];

/// Words of tests by the clock in a file.
fn by_the_clock(text: &str) -> Vec<&'static str> {
    BY_THE_CLOCK.into_iter().filter(|word| text.contains(word)).collect()
}

/// Tests by the clock stand in `tests/clock`.
#[test]
fn system_tests_run_in_virtual_time() {
    for path in sources("tests/system") {
        let found = by_the_clock(&fs::read_to_string(&path).unwrap());
        let this = path.ends_with("architecture.rs");
        assert!(this || found.is_empty(), "{}: {found:?} is for tests/clock", path.display());
    }
}

#[test]
fn a_test_by_the_clock_is_found() {
    assert_eq!(by_the_clock("mrroc([\"run\", cell, \"--bench=emulated\"])"), ["--bench=emulated"]);
    assert_eq!(by_the_clock("mrroc([\"run\", cell, \"--bench=lockstep\"])"), [""; 0]);
}

/// Every room that `room` imports, directly or by way of other rooms.
fn reach(room: &str) -> BTreeSet<&'static str> {
    let row = |name: &str| {
        let (_, allowed) = ARROWS
            .into_iter()
            .find(|(path, _)| *path == name || path.ends_with(&format!("/{name}")))
            .unwrap_or_else(|| panic!("room {name} has no row in ARROWS"));
        allowed
    };
    let mut found = BTreeSet::new();
    let mut open: Vec<&str> = row(room).to_vec();
    while let Some(name) = open.pop() {
        if found.insert(name) {
            open.extend(row(name));
        }
    }
    found
}

#[test]
fn emulators_cannot_name_a_state_machine_of_the_host() {
    let rooms = manifest_names();
    for host in ["master", "drive", "servo", "controller"] {
        assert!(rooms.contains(&host.to_owned()), "{host} is no room");
        assert!(!reach("hil").contains(host), "hil reaches {host}");
    }
    // The host and the emulators share frame layouts.
    assert!(reach("hil").contains("canopen") && reach("drive").contains("canopen"));
    assert!(reach("drive").contains("master"));
}

/// Greatest number of crates in a program that leaves out all features of the library, with the crates of the library.
const MOST_CRATES: usize = 120;

#[test]
fn a_program_without_features_of_the_library_needs_few_crates() {
    let tree = ["tree", "-p", "mrroc", "--no-default-features", "-e", "normal", "--prefix", "none", "--no-dedupe"];
    let output =
        Command::new(env!("CARGO")).args(tree).args(["--offline", "--locked"]).current_dir(root()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    let crates: BTreeSet<&str> = text.lines().filter(|line| !line.is_empty()).collect();
    assert!(crates.len() <= MOST_CRATES, "{} crates: {crates:?}", crates.len());
    for absent in ["clap", "indicatif", "mcap", "plotters", "prost", "schemars", "signal-hook"] {
        assert!(!crates.iter().any(|name| name.split(' ').next() == Some(absent)), "{absent} belongs to a feature");
    }
    // The list is that of a dependency graph.
    for present in ["mrroc-can", "mrroc-servo", "serde"] {
        assert!(crates.iter().any(|name| name.split(' ').next() == Some(present)), "{present} is missing");
    }
}
