//! Recordings of a short run with parts left out, whose checksums, numbers and summary are sound: each is found.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::Path;

use mcap::read::ChunkFlattener;
use mcap::records::{MessageHeader, Record, op};
use mcap::{Compression, WriteOptions};

use super::damage_tests::{recorded_with, records};
use super::file::{END, FIRST, PROFILE};
use super::*;

/// A part of a recording that is rewritten.
pub(super) enum Kept<'a> {
    /// A channel, by its topic.
    Channel(&'a str),
    /// A message of a channel.
    Message(&'a str, &'a MessageHeader),
    /// A text in the metadata of this name, by its key.
    Text(&'a str, &'a str),
    /// An attachment.
    File(&'a str),
}

/// The recording `bytes`, rewritten with the parts that `keeps` selects. The messages of each channel are numbered
/// again, and the summary describes the written parts.
pub(super) fn rewritten(bytes: &[u8], keeps: &mut dyn FnMut(Kept) -> bool) -> Vec<u8> {
    let mut written = Cursor::new(Vec::new());
    let options = WriteOptions::new().compression(Some(Compression::Lz4)).disable_seeking(true).profile(PROFILE);
    let mut writer = options.create(&mut written).unwrap();
    let (mut schemas, mut channels, mut numbers) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::<u16, u32>::new());
    for record in ChunkFlattener::new(bytes).unwrap() {
        match record.unwrap() {
            Record::Schema { header, data } => {
                schemas.insert(header.id, writer.add_schema(&header.name, &header.encoding, &data).unwrap());
            }
            Record::Channel(it) if keeps(Kept::Channel(&it.topic)) => {
                let schema = schemas[&it.schema_id];
                let id = writer.add_channel(schema, &it.topic, &it.message_encoding, &it.metadata).unwrap();
                channels.insert(it.id, (id, it.topic));
            }
            Record::Metadata(mut metadata) => {
                let has_texts = !metadata.metadata.is_empty();
                metadata.metadata.retain(|key, _| keeps(Kept::Text(&metadata.name, key)));
                if !has_texts || !metadata.metadata.is_empty() {
                    writer.write_metadata(&metadata).unwrap();
                }
            }
            Record::Attachment { header, data, .. } if keeps(Kept::File(&header.name)) => {
                let (name, media_type) = (header.name, header.media_type);
                let (log_time, create_time) = (header.log_time, header.create_time);
                writer.attach(&mcap::Attachment { log_time, create_time, name, media_type, data }).unwrap();
            }
            Record::Message { mut header, data } => {
                let Some((id, topic)) = channels.get(&header.channel_id) else { continue };
                if keeps(Kept::Message(topic, &header)) {
                    let number = numbers.entry(*id).or_default();
                    *number += 1;
                    (header.channel_id, header.sequence) = (*id, *number);
                    writer.write_to_known_channel(&header, &data).unwrap();
                }
            }
            Record::DataEnd(_) => break,
            _ => {}
        }
    }
    writer.finish().unwrap();
    drop(writer);
    written.into_inner()
}

/// The recording `bytes`, rewritten with the messages that `keeps` selects. With `has_mark`, the count of the messages
/// stays unchanged.
fn with_messages(bytes: &[u8], has_mark: bool, mut keeps: impl FnMut(&str, &MessageHeader) -> bool) -> Vec<u8> {
    rewritten(bytes, &mut |kept| match kept {
        Kept::Message(topic, header) => keeps(topic, header),
        Kept::Text(name, _) => name != END || has_mark,
        Kept::Channel(_) | Kept::File(_) => true,
    })
}

/// Number of messages and last time, by topic.
fn counted(bytes: &[u8]) -> BTreeMap<String, (u32, u64)> {
    let mut counts = BTreeMap::<String, (u32, u64)>::new();
    with_messages(bytes, true, |topic, header| {
        let (count, time) = counts.entry(topic.to_owned()).or_default();
        (*count, *time) = (*count + 1, header.log_time.max(*time));
        true
    });
    counts
}

/// The replay of a changed copy of `recording`.
pub(super) fn replayed(recording: &Path, bytes: &[u8]) -> anyhow::Result<Replay> {
    let copy = recording.with_file_name("copy.mcap");
    fs::write(&copy, bytes).unwrap();
    replay(&copy, &ReplayOptions::default())
}

/// Asserts that the replay of a changed copy reports a difference, damage or a cut, or is refused.
#[track_caller]
pub(super) fn found(recording: &Path, bytes: &[u8], what: &str) {
    if let Ok(replay) = replayed(recording, bytes) {
        assert!(!replay.is_equal() || !replay.is_whole(), "{what}: {replay}");
    }
}

/// Recordings of a run that ends as its task does, and of a run that ends in a fault.
fn runs() -> [(tempfile::TempDir, PathBuf); 2] {
    let fault = "[[fault]]\nwhen = \"moving\"\nkind = \"over-current\"\naxis = \"column\"\n";
    [recorded_with(None), recorded_with(Some(fault))]
}

#[test]
fn a_recording_written_again_with_all_messages_is_equal() {
    for (_directory, recording) in runs() {
        let bytes = fs::read(&recording).unwrap();
        let replay = replayed(&recording, &with_messages(&bytes, true, |_, _| true)).unwrap();
        assert!(replay.is_equal() && replay.damaged.is_none() && replay.cut.is_none(), "{replay}");
        let faults = counted(&bytes).get("/servo/faults").map_or(0, |(count, _)| *count);
        assert!(replay.cycles > 10, "{replay}, {faults} faults");
    }
    let [_, (_directory, recording)] = runs();
    assert!(counted(&fs::read(recording).unwrap()).contains_key("/servo/faults"));
}

#[test]
fn messages_left_out_of_a_channel_are_found_at_front_middle_and_end() {
    for (_directory, recording) in runs() {
        let bytes = fs::read(&recording).unwrap();
        for (topic, (count, _)) in counted(&bytes) {
            let third = count.div_ceil(3);
            let places = [(0, 1), (third, 2 * third), (count / 2, count), (count - 1, count), (0, count)];
            let marked = places.into_iter().map(|place| (place, true)).chain([((count / 2, count), false)]);
            for ((from, to), has_mark) in marked.filter(|((from, _), _)| *from < count) {
                let mut number = 0;
                let lacking = with_messages(&bytes, has_mark, |of, _| {
                    number += u32::from(of == topic);
                    of != topic || !(from..to).contains(&(number - 1))
                });
                found(&recording, &lacking, &format!("{topic} without {from} to {to} of {count}, mark: {has_mark}"));
            }
        }
    }
}

#[test]
fn everything_left_out_after_or_before_a_time_is_found() {
    for (_directory, recording) in runs() {
        let bytes = fs::read(&recording).unwrap();
        let last = counted(&bytes).values().map(|(_, time)| *time).max().unwrap();
        for time in [last / 100, last / 3, last / 2, last - 100_000_000, last - 1_000_000, last - 1] {
            for has_mark in [true, false] {
                let lacking = with_messages(&bytes, has_mark, |_, header| header.log_time <= time);
                found(&recording, &lacking, &format!("all after {time} of {last}, mark: {has_mark}"));
                let lacking = with_messages(&bytes, has_mark, |_, header| header.log_time > time);
                found(&recording, &lacking, &format!("all before {time} of {last}, mark: {has_mark}"));
            }
        }
    }
}

#[test]
fn chunks_left_out_are_found_at_front_middle_and_end() {
    for (_directory, recording) in runs() {
        let bytes = fs::read(&recording).unwrap();
        let chunks: Vec<_> = records(&bytes).into_iter().filter(|(opcode, _)| *opcode == op::CHUNK).collect();
        for left_out in [0, 1, chunks.len() / 2, chunks.len() - 1] {
            // The whole rest of the file is as it was. A file without a checksum of all bytes has zero in its place.
            let place = chunks[left_out].1.clone();
            let mut lacking = [&bytes[..place.start], &bytes[place.end..]].concat();
            let end = records(&lacking).into_iter().find(|(opcode, _)| *opcode == op::DATA_END).unwrap().1;
            lacking[end.start + 9..end.end].fill(0);
            found(&recording, &lacking, &format!("without chunk {left_out}"));
        }
    }
}

#[test]
fn joined_recordings_and_bytes_behind_the_end_are_found() {
    let [(_directory, recording), (_other_directory, other)] = runs();
    let [bytes, other] = [&recording, &other].map(|path| fs::read(path).unwrap());
    let tails: [&[u8]; 6] = [&bytes, &other, &[0], &[0; 4096], b"text", &bytes[bytes.len() - 100..]];
    for tail in tails {
        let joined = [&bytes, tail].concat();
        let replay = replayed(&recording, &joined).unwrap();
        let damage = replay.damaged.as_ref().unwrap_or_else(|| panic!("{replay}"));
        assert_eq!(damage.byte, bytes.len(), "{replay}");
        assert!(damage.what.contains("behind the end"), "{replay}");
    }
    // The messages of both in one file.
    let all = with_messages(&bytes, true, |_, _| true);
    let end = records(&all).into_iter().find(|(opcode, _)| *opcode == op::DATA_END).unwrap().1.start;
    let chunks: Vec<u8> = records(&other)
        .into_iter()
        .filter(|(opcode, _)| *opcode == op::CHUNK)
        .flat_map(|(_, place)| other[place].to_vec())
        .collect();
    found(&recording, &[&all[..end], &chunks, &all[end..]].concat(), "chunks of another run behind the last ones");
}

#[test]
fn a_recording_that_was_never_counted_is_cut_and_what_follows_its_end_is_damage() {
    let (_directory, recording) = recorded_with(None);
    let bytes = fs::read(&recording).unwrap();
    let mut uncounted = with_messages(&bytes, false, |_, _| true);
    let place = uncounted.windows(PROFILE.len()).position(|it| it == PROFILE.as_bytes()).unwrap();
    uncounted[place..place + PROFILE.len()].copy_from_slice(file::PROFILE_WITHOUT_END.as_bytes());
    // The checksum of all bytes is left out.
    let end = records(&uncounted).into_iter().find(|(opcode, _)| *opcode == op::DATA_END).unwrap().1;
    uncounted[end.start + 9..end.end].fill(0);
    let replay = replayed(&recording, &uncounted).unwrap();
    assert!(replay.is_equal() && replay.damaged.is_none(), "{replay}");
    assert!(replay.cut.as_ref().is_some_and(|cut| cut.contains("did not count the messages")), "{replay}");
    let replay = replayed(&recording, &[uncounted.clone(), uncounted].concat()).unwrap();
    assert!(replay.damaged.is_some() && replay.cut.is_none(), "{replay}");
}

#[test]
fn recordings_of_earlier_versions_are_replayed_and_those_of_later_ones_are_refused() {
    let (_directory, recording) = recorded_with(None);
    let bytes = fs::read(&recording).unwrap();
    let replaced = |from: &str, to: &str| {
        let mut changed = bytes.clone();
        let place = changed.windows(from.len()).position(|it| it == from.as_bytes()).unwrap();
        changed[place..place + to.len()].copy_from_slice(to.as_bytes());
        // The checksums of the metadata and of all bytes are left out.
        let end = records(&changed).into_iter().find(|(opcode, _)| *opcode == op::DATA_END).unwrap().1;
        changed[end.start + 9..end.end].fill(0);
        changed
    };
    let replay = replayed(&recording, &replaced(PROFILE, file::PROFILE_WITHOUT_VERSION)).unwrap();
    assert!(replay.is_equal() && replay.damaged.is_none() && replay.cut.is_none(), "{replay}");
    let (key, _) = file::VERSION;
    let with_length = |version: &str| format!("{key}\u{1}\0\0\0{version}");
    let refusal = replayed(&recording, &replaced(&with_length("2"), &with_length("3"))).unwrap_err();
    assert!(format!("{refusal:#}").contains("the version of the messages is 3"), "{refusal:#}");
    let refusal = replayed(&recording, &replaced(PROFILE, "x-other")).unwrap_err();
    assert!(format!("{refusal:#}").contains("x-other"), "{refusal:#}");
}

#[test]
fn a_count_in_the_summary_that_differs_is_damage() {
    let (_directory, recording) = recorded_with(None);
    let bytes = fs::read(&recording).unwrap();
    let (_, statistics) = records(&bytes).into_iter().find(|(opcode, _)| *opcode == op::STATISTICS).unwrap();
    let (_, footer) = records(&bytes).into_iter().find(|(opcode, _)| *opcode == op::FOOTER).unwrap();
    let mut changed = bytes;
    changed[statistics.start + 9] ^= 1;
    // No checksum of the summary.
    changed[footer.end - 4..footer.end].fill(0);
    let replay = replayed(&recording, &changed).unwrap();
    assert!(replay.damaged.as_ref().is_some_and(|damage| damage.what.contains("the summary counts")), "{replay}");
}

#[test]
fn outputs_behind_the_last_call_are_differences() {
    for (_directory, recording) in runs() {
        let bytes = fs::read(&recording).unwrap();
        let last = counted(&bytes)["/servo/calls"].1;
        let directory = recording.parent().unwrap();
        let lacking = with_messages(&bytes, false, |topic, header| topic != "/servo/calls" || header.log_time < last);
        // A sound count of what is there.
        let path = directory.join("marked.mcap");
        mark_again(&lacking, &path);
        let replay = replay(&path, &ReplayOptions::default()).unwrap();
        assert!(!replay.is_equal() && replay.damaged.is_none(), "{replay}");
        let first = &replay.differences[0];
        assert_eq!(first.replayed, "nothing", "{replay}");
    }
}

/// Writes the messages of `bytes` to a recording with a sound count.
fn mark_again(bytes: &[u8], path: &Path) {
    let (mut facts, mut channels, mut messages) = (Facts::default(), Vec::new(), Vec::new());
    for record in ChunkFlattener::new(bytes).unwrap() {
        match record.unwrap() {
            Record::Metadata(metadata) => facts.texts = metadata.metadata,
            Record::Attachment { header, data, .. } => facts.files.push((header.name, data.into_owned())),
            Record::Channel(channel) => channels.push(file::Channel { topic: channel.topic, message: "Call" }),
            Record::Message { header, data } => messages.push((header, data.into_owned())),
            Record::DataEnd(_) => break,
            _ => {}
        }
    }
    let mut file = McapFile::new(File::create(path).unwrap(), &facts, &channels).unwrap();
    for (header, body) in messages {
        let time = Instant::from_nanos(header.log_time);
        file.write(header.channel_id - FIRST, time, header.sequence, &body).unwrap();
    }
    file.finish(true).unwrap();
}
