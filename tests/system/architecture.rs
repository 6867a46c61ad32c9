//! The rooms import one way, and only the rim reads clocks or waits.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("the tests' room is inside the workspace")
        .to_owned()
}

/// Each room and the rooms it may import, by their names in the workspace.
const ARROWS: [(&str, &[&str]); 14] = [
    ("drivers/can", &[]),
    ("drivers/canopen", &["can"]),
    ("drivers/serial", &["can"]),
    ("drivers/drive", &["can", "canopen", "serial"]),
    ("servo", &["can", "drive"]),
    ("controller", &["can", "drive", "servo"]),
    ("hil", &["can", "canopen", "serial"]),
    ("mrroc", BELOW_LIBRARY),
    ("tools/descriptions", &["can", "controller", "hil", "mrroc"]),
    ("tools/host", &["can", "drive", "servo", "mrroc"]),
    ("tools/identify", &["can", "servo", "mrroc"]),
    (
        "tools/service",
        &["can", "canopen", "serial", "drive", "mrroc"],
    ),
    (
        "console",
        &[
            "can",
            "canopen",
            "hil",
            "mrroc",
            "descriptions",
            "host",
            "identify",
            "service",
        ],
    ),
    (
        "tests",
        &[
            "can",
            "canopen",
            "serial",
            "drive",
            "servo",
            "controller",
            "hil",
            "mrroc",
        ],
    ),
];

/// The rooms below the library of robot programs.
const BELOW_LIBRARY: &[&str] = &[
    "can",
    "canopen",
    "serial",
    "drive",
    "servo",
    "controller",
    "hil",
];

/// The files that read clocks or wait, and what each is for.
const RIM: [&str; 10] = [
    "drivers/can/src/clock.rs",
    "drivers/can/src/socketcan.rs",
    "servo/src/thread.rs",
    "hil/src/pty.rs",
    "hil/src/machine.rs",
    "mrroc/src/run.rs",
    "mrroc/src/bench/emulated_lines.rs",
    "mrroc/src/wire/listening.rs",
    "tools/host/src/jitter/files.rs",
    "console/src/emulate.rs",
];

const CLOCKS: [&str; 8] = [
    "Instant::now(",
    "SystemTime::now(",
    "UNIX_EPOCH.elapsed(",
    "clock_gettime(",
    "clock_nanosleep(",
    "thread::sleep(",
    "park_timeout(",
    "libc::usleep(",
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
    let dependencies = manifest["workspace"]["dependencies"]
        .as_table()
        .expect("the workspace lists dependencies");
    let in_tree = |value: &toml::Value| value.get("path").is_some();
    dependencies
        .iter()
        .filter(|(_, value)| in_tree(value))
        .map(|(name, _)| name.clone())
        .collect()
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
    let members: Vec<&str> = workspace["workspace"]["members"]
        .as_array()
        .unwrap()
        .iter()
        .map(|member| member.as_str().unwrap())
        .collect();
    let listed: BTreeMap<&str, &[&str]> = ARROWS.into_iter().collect();
    for member in &members {
        let allowed = listed
            .get(member)
            .unwrap_or_else(|| panic!("room {member} has no row in ARROWS"));
        let found = forbidden_imports(
            member,
            allowed,
            &read_manifest(&root().join(member).join("Cargo.toml")),
        );
        assert!(found.is_empty(), "forbidden imports: {found:?}");
    }
}

#[test]
fn a_forbidden_import_is_found() {
    let manifest: toml::Table =
        "[dependencies]\nhil.workspace = true\n[dev-dependencies]\nserde.workspace = true"
            .parse()
            .unwrap();
    assert_eq!(
        forbidden_imports("servo", &["can", "drive"], &manifest),
        ["servo imports hil (dependencies)"]
    );
}

fn clock_reads(file: &str, text: &str) -> Vec<String> {
    if RIM.iter().any(|rim| file.starts_with(rim)) {
        return Vec::new();
    }
    let code = |line: &&str| !line.trim_start().starts_with("//");
    let reads = |line: &&str| CLOCKS.iter().any(|clock| line.contains(clock));
    text.lines()
        .filter(code)
        .filter(reads)
        .map(|line| format!("{file}: {}", line.trim()))
        .collect()
}

/// Every Rust file below a folder of the workspace.
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

#[test]
fn only_the_rim_reads_clocks() {
    let mut found = Vec::new();
    for (room, _) in ARROWS.into_iter().filter(|(room, _)| *room != "tests") {
        for path in sources(&format!("{room}/src")) {
            let name = path
                .strip_prefix(root())
                .unwrap()
                .to_str()
                .unwrap()
                .to_owned();
            found.extend(clock_reads(&name, &fs::read_to_string(&path).unwrap()));
        }
    }
    assert!(found.is_empty(), "clock reads outside the rim: {found:#?}");
}

#[test]
fn a_clock_read_in_logic_is_found() {
    let text = "fn step() {\n    let now = std::time::Instant::now();\n    // Instant::now() in a comment\n}\n";
    assert_eq!(
        clock_reads("servo/src/cycle.rs", text),
        ["servo/src/cycle.rs: let now = std::time::Instant::now();"]
    );
    assert!(clock_reads("servo/src/thread.rs", text).is_empty());
}

/// What the host's side of a protocol is made of: an emulator that used one would agree with the driver by sharing its
/// mistakes.
const HOST_SIDE: [&str; 8] = [
    "sdo::Client",
    "PowerStateMachine",
    "next_controlword",
    "nmt::Master",
    "pdo::remap",
    "heartbeat::Consumer",
    "guarding::Guard",
    "lss::Master",
];

fn host_side_words(text: &str) -> Vec<&'static str> {
    HOST_SIDE
        .into_iter()
        .filter(|word| text.contains(word))
        .collect()
}

#[test]
fn emulators_share_layouts_with_the_drivers_and_no_state_machine() {
    for file in sources("hil/src") {
        let found = host_side_words(&fs::read_to_string(&file).unwrap());
        assert!(found.is_empty(), "{} uses {found:?}", file.display());
    }
    assert_eq!(
        host_side_words("let client = sdo::Client::new(node);"),
        ["sdo::Client"]
    );
}
