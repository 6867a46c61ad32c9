//! Recordings: files as they are, and files whose messages are changed while their checksums hold.

use std::io::{Cursor, Write};

use arbitrary::{Arbitrary, Unstructured};
use mcap::WriteOptions;
use mcap::read::{ChunkFlattener, Options};
use mcap::records::{MessageHeader, Record};
use mrroc::recording::{ReplayOptions, replay};

/// A short recording of a robot with one drive, which the changed files begin with.
const EXAMPLE: &[u8] = include_bytes!("../../corpus/recording/example.mcap");

/// The replay of a recording ends with a result or a reason.
pub fn recording(data: &[u8]) {
    match data {
        [number, changes @ ..] if *number < 128 => {
            if let Ok(bytes) = changed(&mut Unstructured::new(changes)) {
                run(&bytes);
            }
        }
        _ => run(data),
    }
}

fn run(bytes: &[u8]) {
    let mut file = tempfile::NamedTempFile::new().expect("a directory for temporary files");
    file.write_all(bytes).expect("room for a small file");
    match replay(file.path(), &ReplayOptions::default()) {
        Ok(replay) => assert!(!replay.to_string().is_empty()),
        Err(error) => assert!(!format!("{error:#}").is_empty()),
    }
}

/// The example with changed messages and, rarely, changed files.
fn changed(input: &mut Unstructured) -> Result<Vec<u8>, mcap::McapError> {
    let mut bytes = Cursor::new(Vec::new());
    // Without chunks, no checksum covers the messages.
    let options = WriteOptions::new().use_chunks(false).calculate_data_section_crc(false);
    let mut writer = options.disable_seeking(true).profile("mrroc-1").create(&mut bytes)?;
    let patches = Vec::<(u16, u8)>::arbitrary(input).unwrap_or_default();
    let mut changes = changes(input);
    let (mut schemas, mut number) = (std::collections::BTreeMap::new(), 0_u16);
    for record in ChunkFlattener::new_with_options(EXAMPLE, Options::IgnoreEndMagic.into())? {
        match record? {
            Record::Schema { header, data } => {
                schemas.insert(header.id, writer.add_schema(&header.name, &header.encoding, &data)?);
            }
            Record::Channel(channel) => {
                let schema = schemas[&channel.schema_id];
                writer.add_channel(schema, &channel.topic, &channel.message_encoding, &channel.metadata)?;
            }
            Record::Metadata(metadata) => writer.write_metadata(&metadata)?,
            Record::Attachment { header, data, .. } => {
                let (name, media_type) = (header.name, header.media_type);
                let (log_time, create_time) = (header.log_time, header.create_time);
                writer.attach(&mcap::Attachment { log_time, create_time, name, media_type, data })?;
            }
            Record::Message { header, data } => {
                number = number.wrapping_add(1);
                let (mut header, mut data) = (header, data.into_owned());
                let of_this = changes.iter().position(|change| change.message == number);
                let Some(change) = of_this.map(|place| changes.swap_remove(place)) else {
                    writer.write_to_known_channel(&header, &data)?;
                    continue;
                };
                apply(&change, &mut header, &mut data);
                for _ in 0..change.times {
                    writer.write_to_known_channel(&header, &data)?;
                }
            }
            _ => {}
        }
    }
    writer.finish()?;
    drop(writer);
    let mut bytes = bytes.into_inner();
    for (place, byte) in patches.into_iter().take(2) {
        let place = bytes.len() * usize::from(place) / usize::from(u16::MAX);
        if let Some(found) = bytes.get_mut(place) {
            *found = byte;
        }
    }
    Ok(bytes)
}

/// A change of one message.
struct Change {
    message: u16,
    /// Number of copies, 0 for a lost message.
    times: u8,
    place: u8,
    byte: u8,
    kind: u8,
}

fn changes(input: &mut Unstructured) -> Vec<Change> {
    let read = |(message, times, place, byte, kind): (u16, u8, u8, u8, u8)| Change {
        message: message % 700,
        times: if times < 200 { 1 } else { times % 3 },
        place,
        byte,
        kind,
    };
    let listed = Vec::<(u16, u8, u8, u8, u8)>::arbitrary(input).unwrap_or_default();
    listed.into_iter().take(32).map(read).collect()
}

fn apply(change: &Change, header: &mut MessageHeader, data: &mut Vec<u8>) {
    let place = usize::from(change.place) % (data.len() + 1);
    match change.kind % 6 {
        0..=2 => {
            if let Some(byte) = data.get_mut(place) {
                *byte = change.byte;
            }
        }
        3 => data.truncate(place),
        4 => data.insert(place, change.byte),
        _ => header.log_time = header.log_time.wrapping_add_signed((i64::from(change.byte) - 128) * 1_000_000),
    }
}
