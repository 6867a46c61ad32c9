//! Recordings of runs of example cells, and their replay.

use std::fs;
use std::path::{Path, PathBuf};

use ::mrroc::cell::Cell;
use ::mrroc::recording::{Replay, ReplayOptions, replay};
use serde_json::Value;

use crate::mrroc::{Directory, Output, shorten, text};

/// A changed example cell as a file.
pub fn written(directory: &Directory, name: &str, change: impl FnOnce(&mut Cell)) -> PathBuf {
    let mut cell = Cell::parse(&text(name)).unwrap();
    shorten(&mut cell);
    change(&mut cell);
    let path = directory.path(&format!("{name}.toml"));
    fs::write(&path, toml::to_string(&cell).unwrap()).unwrap();
    path
}

/// Arguments of a run with a recording.
pub fn recorded(cell: &Path, bench: &str, recording: &Path) -> [String; 7] {
    let text = |path: &Path| path.to_str().unwrap().to_owned();
    ["run".into(), text(cell), "--bench".into(), bench.into(), "--json".into(), "--record".into(), text(recording)]
}

pub fn replayed(recording: &Path) -> Replay {
    replay(recording, &ReplayOptions::default()).unwrap()
}

pub fn cycles(report: &Value) -> u64 {
    report["cycle"]["cycles"].as_u64().unwrap()
}

/// Asserts that a run replays bit for bit, from its first to its last cycle.
pub fn replays_whole(run: &Output, recording: &Path) -> Replay {
    let replay = replayed(recording);
    assert!(replay.is_equal(), "{replay}");
    assert_eq!((replay.cycles, &replay.cut), (cycles(&run.json()), &None), "{replay}");
    assert!(replay.equal > 2 * replay.cycles, "{replay}");
    replay
}
