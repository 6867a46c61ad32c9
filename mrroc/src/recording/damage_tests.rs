//! Damaged and cut recordings of a short run: no panic, no difference, and no success unless all outputs are equal.

use std::fs;
use std::ops::Range;
use std::path::Path;

use super::*;
use crate::cell::Cell;
use crate::run::Requests;
use crate::tasks::CarriedTask;

/// Numbers that depend on a seed alone (SplitMix64).
struct Draw(u64);

impl Draw {
    fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % limit as u64) as usize
    }
}

/// The cell of an IRb-6 that starts close to its switches, in `directory`, with or without its program.
pub(crate) fn short_cell(directory: &Path, has_program: bool) -> CellFile {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/irb6.toml");
    let mut cell = Cell::parse(&fs::read_to_string(path).unwrap()).unwrap();
    let robot = &mut cell.robot[0];
    if !has_program {
        robot.program.clear();
    }
    near_home(robot);
    let path = directory.join("irb6.toml");
    fs::write(&path, toml::to_string(&cell).unwrap()).unwrap();
    CellFile::read(&path).unwrap()
}

/// Starts a robot close to its switches.
pub(crate) fn near_home(robot: &mut crate::cell::Robot) {
    let home = robot.arm().unwrap().robot().home();
    for (axis, home) in robot.axis.iter_mut().zip(&*home) {
        axis.emulator.start = Some(home - 2.5);
        axis.homing.order = 0;
    }
}

/// A recording in lockstep of an IRb-6 that homes, and its directory.
fn recorded() -> (tempfile::TempDir, PathBuf) {
    recorded_with(None)
}

/// The same recording, with the faults of a scenario.
pub(super) fn recorded_with(scenario: Option<&str>) -> (tempfile::TempDir, PathBuf) {
    let directory = tempfile::tempdir().unwrap();
    let recording = directory.path().join("run.mcap");
    let file = short_cell(directory.path(), false);
    let scenario = scenario.map(|text| {
        let path = directory.path().join("faults.toml");
        fs::write(&path, text).unwrap();
        path
    });
    let options = RunOptions { record: Some(recording.clone()), scenario, ..RunOptions::on(BenchKind::Lockstep) };
    crate::run::run(&file, &options, &Requests::default(), &CarriedTask::Home.program(), &mut |_| {}).unwrap();
    (directory, recording)
}

/// Replays a copy of a recording, and asserts that neither a difference nor a false success is reported. Returns the
/// replay, or the refusal.
#[track_caller]
fn checked(recording: &Path, bytes: &[u8], whole: &Replay, what: &str) -> Result<Replay, String> {
    let copy = recording.with_file_name("copy.mcap");
    fs::write(&copy, bytes).unwrap();
    let replay = replay(&copy, &ReplayOptions::default()).map_err(|error| format!("{error:#}"));
    match &replay {
        Ok(replay) => {
            assert!(replay.is_equal(), "{what}: {replay}");
            assert!(replay.cycles <= whole.cycles && replay.equal <= whole.equal, "{what}: {replay}");
            if replay.damaged.is_none() && replay.cut.is_none() {
                assert_eq!((replay.cycles, replay.equal), (whole.cycles, whole.equal), "{what}: {replay}");
            }
        }
        Err(refusal) => assert!(refusal.contains("copy.mcap"), "{what}: {refusal}"),
    }
    replay
}

/// The records outside of chunks: opcode, and place in the file with opcode and length.
pub(super) fn records(bytes: &[u8]) -> Vec<(u8, Range<usize>)> {
    let (mut found, mut at) = (Vec::new(), mcap::MAGIC.len());
    while let Some([opcode, length @ ..]) = bytes.get(at..).and_then(|rest| rest.first_chunk::<9>()) {
        let end = at + 9 + u64::from_le_bytes(*length) as usize;
        found.push((*opcode, at..end));
        at = end;
    }
    found
}

#[test]
fn a_flipped_bit_is_damage_and_no_difference() {
    let (_directory, recording) = recorded();
    let whole = replay(&recording, &ReplayOptions::default()).unwrap();
    assert!(whole.is_equal() && whole.damaged.is_none() && whole.cycles > 300, "{whole}");
    let bytes = fs::read(&recording).unwrap();
    let mut draw = Draw(14);
    // Most places are in chunks. Headers of records and the end of the file have places of their own.
    let headers: Vec<usize> = records(&bytes).iter().map(|(_, place)| place.start).collect();
    for turn in 0..240 {
        let place = match turn % 3 {
            0 => headers[draw.below(headers.len())] + draw.below(9),
            _ => draw.below(bytes.len()),
        };
        let bit = draw.below(8);
        let mut damaged = bytes.clone();
        damaged[place] ^= 1 << bit;
        let replay = checked(&recording, &damaged, &whole, &format!("byte {place}, bit {bit}"));
        if let Ok(replay) = replay {
            assert!(replay.damaged.is_some() && replay.cut.is_none(), "byte {place}, bit {bit}: {replay}");
        }
    }
}

#[test]
fn zeros_within_a_recording_are_damage_and_zeros_to_its_end_a_cut() {
    let (_directory, recording) = recorded();
    let whole = replay(&recording, &ReplayOptions::default()).unwrap();
    let bytes = fs::read(&recording).unwrap();
    for (place, length) in [(bytes.len() / 3, 4096), (bytes.len() / 2, 10_000)] {
        let chunk = records(&bytes).into_iter().find(|(opcode, record)| *opcode == 6 && record.start > place);
        let start = chunk.unwrap().1.start;
        let mut damaged = bytes.clone();
        damaged[start + 50..start + 50 + length].fill(0);
        let replay = checked(&recording, &damaged, &whole, "zeros").unwrap();
        let damage = replay.damaged.as_ref().unwrap_or_else(|| panic!("{replay}"));
        assert_eq!(damage.byte, start, "{replay}");
        let last = replay.last_cycle.unwrap_or_else(|| panic!("{replay}"));
        let said = format!("copy.mcap: damaged at byte {} ({}): replayed up to cycle {last}", damage.byte, damage.what);
        assert!(replay.to_string().contains(&said), "{replay}");
    }
    let mut zeros = bytes.clone();
    zeros[bytes.len() / 2..].fill(0);
    let replay = checked(&recording, &zeros, &whole, "zeros").unwrap();
    assert!(replay.cut.is_some() && replay.damaged.is_none() && replay.cycles > whole.cycles / 4, "{replay}");
    let last = replay.last_cycle.unwrap();
    assert!(replay.to_string().contains("the recording was cut: "), "{replay}");
    assert!(replay.to_string().contains(&format!("replayed up to cycle {last}, at {:.3} s", replay.end_s)), "{replay}");
}

#[test]
fn a_recording_without_one_of_its_chunks_is_damaged() {
    let (_directory, recording) = recorded();
    let whole = replay(&recording, &ReplayOptions::default()).unwrap();
    let bytes = fs::read(&recording).unwrap();
    let chunks: Vec<_> = records(&bytes).into_iter().filter(|(opcode, _)| *opcode == 6).collect();
    for (_, place) in [&chunks[1], &chunks[chunks.len() / 2], &chunks[chunks.len() - 1]] {
        // A file without its end has no checksum of all bytes.
        let lacking: Vec<u8> = [&bytes[..place.start], &bytes[place.end..]].concat();
        let said = checked(&recording, &lacking, &whole, "a missing chunk");
        assert!(said.is_err() || said.as_ref().is_ok_and(|replay| replay.damaged.is_some()), "{said:?}");
        let cut = &lacking[..lacking.len() * 9 / 10];
        let _ = checked(&recording, cut, &whole, "a missing chunk and a cut");
    }
}

#[test]
fn a_cut_recording_replays_up_to_its_last_whole_chunk() {
    let (_directory, recording) = recorded();
    let whole = replay(&recording, &ReplayOptions::default()).unwrap();
    let bytes = fs::read(&recording).unwrap();
    let mut draw = Draw(15);
    for _ in 0..20 {
        let length = draw.below(bytes.len());
        match checked(&recording, &bytes[..length], &whole, &format!("{length} bytes")) {
            Ok(replay) => assert!(replay.cut.is_some() && replay.damaged.is_none(), "{length} bytes: {replay}"),
            // The bring-up in lockstep is written at its end.
            Err(refusal) => assert!(length < bytes.len() / 3, "{length} bytes: {refusal}"),
        }
    }
}

#[test]
fn a_file_of_another_kind_is_no_mcap_file() {
    let (_directory, recording) = recorded();
    let said = |path: &Path| format!("{:#}", replay(path, &ReplayOptions::default()).unwrap_err());
    let log = said(&recording.with_extension("log"));
    assert!(log.contains("run.log: no MCAP file") && log.contains("run.mcap"), "{log}");
    let cell = said(&recording.with_file_name("irb6.toml"));
    assert!(cell.contains("irb6.toml: no MCAP file"), "{cell}");
    let empty = recording.with_file_name("empty.mcap");
    fs::write(&empty, "").unwrap();
    assert!(said(&empty).contains("empty.mcap: no MCAP file: the file is empty"), "{}", said(&empty));
}
