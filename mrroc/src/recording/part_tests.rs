//! Recordings of a short run that lack one part at the front, in the middle or at the end. The replay finds every
//! missing part.

use std::fs;
use std::path::Path;

use mcap::MAGIC;
use mcap::records::op;

use super::damage_tests::{recorded_with, records};
use super::file::{END, METADATA};
use super::omission_tests::{Kept, found, replayed, rewritten};
use super::*;
use crate::run::Requests;
use crate::tasks::CarriedTask;

/// A record outside of chunks: opcode and contents.
type Part = (u8, Vec<u8>);

/// Bytes of opcode and length of a record.
const HEAD: usize = 9;

/// The kinds of records of a recording.
const KINDS: [(u8, &str); 13] = [
    (op::HEADER, "header"),
    (op::METADATA, "metadata"),
    (op::ATTACHMENT, "attachment"),
    (op::CHUNK, "chunk"),
    (op::MESSAGE_INDEX, "message index"),
    (op::DATA_END, "end of the messages"),
    (op::SCHEMA, "schema of the summary"),
    (op::CHANNEL, "channel of the summary"),
    (op::STATISTICS, "statistics"),
    (op::CHUNK_INDEX, "chunk index"),
    (op::ATTACHMENT_INDEX, "attachment index"),
    (op::METADATA_INDEX, "metadata index"),
    (op::SUMMARY_OFFSET, "summary offset"),
];

fn parts(bytes: &[u8]) -> Vec<Part> {
    records(bytes).into_iter().map(|(opcode, place)| (opcode, bytes[place.start + HEAD..place.end].to_vec())).collect()
}

/// A recording of `parts`. The footer names the places of the summary, and the checksums of all bytes are left out.
fn joined(parts: &[Part]) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    let mut places = [0_u64; 2];
    let mut is_behind = false;
    for (opcode, data) in parts {
        let at = bytes.len() as u64;
        if is_behind && *opcode != op::FOOTER && places[0] == 0 {
            places[0] = at;
        }
        if *opcode == op::SUMMARY_OFFSET && places[1] == 0 {
            places[1] = at;
        }
        is_behind |= *opcode == op::DATA_END;
        let data = match *opcode {
            op::DATA_END => vec![0; 4],
            op::FOOTER => [&places[0].to_le_bytes()[..], &places[1].to_le_bytes(), &[0; 4]].concat(),
            _ => data.clone(),
        };
        bytes.push(*opcode);
        bytes.extend((data.len() as u64).to_le_bytes());
        bytes.extend(data);
    }
    [bytes, MAGIC.to_vec()].concat()
}

/// First, second, middle and last of `all`.
fn places<T: Copy + PartialEq>(all: &[T]) -> Vec<T> {
    let mut chosen: Vec<T> =
        [0, 1, all.len() / 2, all.len().saturating_sub(1)].iter().filter_map(|&it| all.get(it).copied()).collect();
    chosen.dedup();
    chosen
}

/// Recordings of a run with one file and of a run with two files.
fn recordings() -> [(tempfile::TempDir, PathBuf); 2] {
    let (directory, recording) = {
        let directory = tempfile::tempdir().unwrap();
        let cells = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells");
        for name in ["puma560.toml", "puma560.urdf"] {
            fs::copy(cells.join(name), directory.path().join(name)).unwrap();
        }
        let file = CellFile::read(directory.path().join("puma560.toml")).unwrap();
        let recording = directory.path().join("run.mcap");
        let options = RunOptions { record: Some(recording.clone()), ..RunOptions::on(BenchKind::Lockstep) };
        crate::run::run(&file, &options, &Requests::default(), &CarriedTask::Home.program(), &mut |_| {}).unwrap();
        (directory, recording)
    };
    [recorded_with(None), (directory, recording)]
}

#[test]
fn a_record_left_out_is_found_whatever_its_kind_and_place() {
    for (_directory, recording) in recordings() {
        let whole = parts(&fs::read(&recording).unwrap());
        let replay = replayed(&recording, &joined(&whole)).unwrap();
        assert!(replay.is_equal() && replay.is_whole(), "{replay}");
        for (kind, name) in KINDS {
            let all: Vec<usize> = (0..whole.len()).filter(|&it| whole[it].0 == kind).collect();
            assert!(!all.is_empty(), "{name}");
            for left_out in places(&all) {
                let lacking: Vec<Part> =
                    (0..whole.len()).filter(|it| *it != left_out).map(|it| whole[it].clone()).collect();
                found(&recording, &joined(&lacking), &format!("{name} {left_out} of {all:?}"));
            }
            let lacking: Vec<Part> = whole.iter().filter(|(opcode, _)| *opcode != kind).cloned().collect();
            found(&recording, &joined(&lacking), &format!("each {name}"));
        }
        let end = whole.iter().position(|(opcode, _)| *opcode == op::DATA_END).unwrap();
        let lacking = [&whole[..=end], &whole[whole.len() - 1..]].concat();
        found(&recording, &joined(&lacking), "the summary");
    }
}

#[test]
fn a_file_that_ends_before_its_end_is_not_whole_wherever_it_ends() {
    for (_directory, recording) in recordings() {
        let bytes = fs::read(&recording).unwrap();
        let all = records(&bytes);
        for (kind, name) in KINDS.into_iter().chain([(op::FOOTER, "footer")]) {
            let of_kind: Vec<usize> = (0..all.len()).filter(|&it| all[it].0 == kind).collect();
            for number in places(&of_kind) {
                let place = &all[number].1;
                for end in [place.start, place.start + 1, place.end.midpoint(place.start), place.end - 1, place.end] {
                    found(
                        &recording,
                        &bytes[..end],
                        &format!("cut in {name} {number}: {end} of {} bytes", bytes.len()),
                    );
                }
            }
        }
        for behind in 1..=MAGIC.len() {
            found(&recording, &bytes[..bytes.len() - behind], &format!("without the last {behind} bytes"));
        }
    }
}

#[test]
fn each_number_of_the_statistics_is_judged() {
    let (_directory, recording) = recorded_with(None);
    let whole = parts(&fs::read(&recording).unwrap());
    let statistics = whole.iter().position(|(opcode, _)| *opcode == op::STATISTICS).unwrap();
    let changed = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut parts = whole.clone();
        change(&mut parts[statistics].1);
        joined(&parts)
    };
    let fields = ["messages", "schemas", "channels", "attachments", "metadata", "chunks", "first time", "last time"];
    for (field, at) in fields.into_iter().zip([0, 8, 10, 14, 18, 22, 26, 34]) {
        found(&recording, &changed(&|data| data[at] ^= 1), field);
    }
    // The counts by channel: length of all in bytes, then channel and count of each.
    let (length, entry) = (42, 10);
    let entries: Vec<usize> = (0..(whole[statistics].1.len() - length - 4) / entry).collect();
    for number in places(&entries) {
        let at = length + 4 + number * entry;
        let lacking = changed(&|data| {
            data.drain(at..at + entry);
            let rest = (data.len() - length - 4) as u32;
            data[length..length + 4].copy_from_slice(&rest.to_le_bytes());
        });
        found(&recording, &lacking, &format!("without the count of channel {number}"));
        found(&recording, &changed(&|data| data[at + 2] ^= 1), &format!("another count of channel {number}"));
    }
}

#[test]
fn each_text_of_the_metadata_and_each_file_is_needed() {
    for (_directory, recording) in recordings() {
        let bytes = fs::read(&recording).unwrap();
        let (mut texts, mut files) = (Vec::new(), Vec::new());
        rewritten(&bytes, &mut |kept| {
            match kept {
                Kept::Text(metadata, key) => texts.push((metadata.to_owned(), key.to_owned())),
                Kept::File(name) => files.push(name.to_owned()),
                Kept::Channel(_) | Kept::Message(..) => {}
            }
            true
        });
        assert!(texts.iter().any(|(name, _)| name == METADATA) && texts.iter().any(|(name, _)| name == END));
        for (metadata, key) in texts {
            let lacking = rewritten(
                &bytes,
                &mut |kept| !matches!(kept, Kept::Text(name, of) if (name, of) == (&*metadata, &*key)),
            );
            found(&recording, &lacking, &format!("{metadata} without {key}"));
        }
        for name in &files {
            let lacking = rewritten(&bytes, &mut |kept| !matches!(kept, Kept::File(it) if it == name));
            found(&recording, &lacking, &format!("without {name} of {files:?}"));
        }
    }
}

#[test]
fn a_channel_left_out_altogether_is_found() {
    for (_directory, recording) in recordings() {
        let bytes = fs::read(&recording).unwrap();
        let mut topics = Vec::new();
        rewritten(&bytes, &mut |kept| {
            if let Kept::Channel(topic) = kept {
                topics.push(topic.to_owned());
            }
            true
        });
        assert!(topics.len() > 6, "{topics:?}");
        for topic in topics {
            for has_count in [true, false] {
                let lacking = rewritten(&bytes, &mut |kept| match kept {
                    Kept::Channel(it) | Kept::Message(it, _) => it != topic,
                    Kept::Text(_, key) => has_count || key != topic,
                    Kept::File(_) => true,
                });
                found(&recording, &lacking, &format!("without {topic}, its count is there: {has_count}"));
            }
        }
    }
}

#[test]
fn metadata_counts_and_headers_are_there_once() {
    let (_directory, recording) = recorded_with(None);
    let whole = parts(&fs::read(&recording).unwrap());
    for kind in [op::HEADER, op::METADATA] {
        let all: Vec<usize> = (0..whole.len()).filter(|&it| whole[it].0 == kind).collect();
        for twice in all {
            let mut parts = whole.clone();
            parts.insert(twice, whole[twice].clone());
            found(&recording, &joined(&parts), &format!("record {twice} twice"));
        }
    }
    // A part behind the end of the messages.
    let end = whole.iter().position(|(opcode, _)| *opcode == op::DATA_END).unwrap();
    for kind in [op::CHUNK, op::METADATA, op::ATTACHMENT] {
        let place = whole.iter().rposition(|(opcode, _)| *opcode == kind).unwrap();
        let mut parts = whole.clone();
        let part = parts.remove(place);
        parts.insert(end, part);
        found(&recording, &joined(&parts), &format!("a record of kind {kind} behind the end of the messages"));
    }
}
