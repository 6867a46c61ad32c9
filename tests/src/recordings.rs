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

/// The recording `bytes` with a chunk of LZ4 in front of its first messages. The chunk decompresses to `size` bytes of zeros,
/// and its header says `declared`.
pub fn bomb(bytes: &[u8], size: u64, declared: u64) -> Vec<u8> {
    const CHUNK: u8 = 0x06;
    let behind = |at: usize| at + 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().expect("8 bytes")) as usize;
    let chunk_from = |mut at: usize| {
        while bytes[at] != CHUNK {
            at = behind(at);
        }
        at
    };
    // The first chunk declares the channels.
    let at = chunk_from(behind(chunk_from(8)));
    // A frame of blocks of 4 MiB. A block is a zero, and a match that repeats the zero.
    let mut frame = vec![0x04, 0x22, 0x4D, 0x18, 0x60, 0x70, 0x73];
    let (block, repeated) = (4_u64 << 20, (4_usize << 20) - 1 - 5 - 4 - 15);
    // The last five bytes of a block are no match.
    let mut coded = vec![0x1F, 0, 1, 0];
    coded.extend(std::iter::repeat_n(255, repeated / 255));
    coded.push((repeated % 255) as u8);
    coded.extend([0x50, 0, 0, 0, 0, 0]);
    for _ in 0..size / block {
        frame.extend((coded.len() as u32).to_le_bytes());
        frame.extend(&coded);
    }
    frame.extend([0; 4]);
    let mut chunk = [0; 16].to_vec();
    chunk.extend(declared.to_le_bytes());
    // No checksum.
    chunk.extend([0; 4]);
    chunk.extend([3, 0, 0, 0]);
    chunk.extend(b"lz4");
    chunk.extend((frame.len() as u64).to_le_bytes());
    chunk.extend(frame);
    [&bytes[..at], &[CHUNK], &(chunk.len() as u64).to_le_bytes(), &chunk, &bytes[at..]].concat()
}
