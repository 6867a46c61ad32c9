//! Reader of MCAP files that may be cut or damaged. A file that was cut ends before its end record. Damage has data
//! behind it: a checksum, a decompression, a record or the numbers of messages fail.
//!
//! The reader gives the messages before the first damaged chunk, and no message of this chunk.

use std::collections::BTreeMap;

use anyhow::bail;
use can::Instant;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapError, parse_record};
use serde::Serialize;

use super::file::{FIRST, Facts, METADATA, PROFILE};

/// Greatest length of a record, bytes. A damaged length must not request more memory.
const LONGEST: usize = 64 << 20;

/// Bytes of opcode and length of a record.
const HEAD: usize = 9;

/// Bytes of the header of a chunk without the name of its compression.
const CHUNK_HEADER: u64 = 40;

/// Damage of a recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Damage {
    /// Place of the damaged record or chunk in the file, bytes.
    pub byte: usize,
    /// What is damaged.
    pub what: String,
}

/// A message that was read.
pub(super) struct Stored {
    pub(super) channel: u16,
    pub(super) time: Instant,
    pub(super) body: Vec<u8>,
    /// Place of its chunk in the file, bytes.
    pub(super) chunk: usize,
}

/// A recording that was read.
#[derive(Default)]
pub(super) struct Content {
    pub(super) facts: Facts,
    /// Topic and message name by channel.
    pub(super) channels: BTreeMap<u16, (String, String)>,
    /// The messages in the order of the file.
    pub(super) messages: Vec<Stored>,
    /// How the file ends before its end.
    pub(super) cut: Option<String>,
    /// The first damage.
    pub(super) damage: Option<Damage>,
    /// Whether all messages are there: the record behind them was read, and the checksum of the bytes before agrees.
    pub(super) complete: bool,
}

impl Content {
    /// Reads a recording. A file that was cut or damaged gives its whole chunks up to this place.
    pub(super) fn read(bytes: &[u8]) -> anyhow::Result<Self> {
        if !bytes.starts_with(MAGIC) {
            bail!(
                "no MCAP file: {}",
                if bytes.is_empty() { "the file is empty" } else { "the file does not begin as an MCAP file does" }
            );
        }
        let mut reading = Reading::default();
        if let Err((at, failure)) = reading.all(bytes) {
            reading.end(bytes, at, failure);
        }
        match reading.profile {
            Some(profile) if profile != PROFILE => {
                bail!("the profile is {profile:?}, and this version reads {PROFILE:?}")
            }
            _ => Ok(reading.content),
        }
    }

    /// Notes damage of the chunk at `byte`, and drops its messages and all later ones.
    pub(super) fn damage_at(&mut self, byte: usize, what: String) {
        self.messages.truncate(self.messages.partition_point(|message| message.chunk < byte));
        (self.damage, self.cut, self.complete) = (Some(Damage { byte, what }), None, false);
    }
}

/// Why a record cannot be used.
enum Failure {
    /// The file ends within the record.
    Ended,
    /// The record is damaged.
    Damaged(String),
}

impl From<McapError> for Failure {
    fn from(error: McapError) -> Self {
        match error {
            McapError::UnexpectedEof => Self::Ended,
            McapError::Parse(_) => Self::Damaged("a record that cannot be decoded".to_owned()),
            McapError::Io(_) => Self::Damaged("the compressed data cannot be decompressed".to_owned()),
            McapError::BadDataCrc { .. } => {
                Self::Damaged("the checksum of all bytes before differs, and no chunk is damaged".to_owned())
            }
            error => Self::Damaged(error.to_string()),
        }
    }
}

fn damaged(what: &str) -> Failure {
    Failure::Damaged(what.to_owned())
}

/// A file under way.
#[derive(Default)]
struct Reading {
    content: Content,
    profile: Option<String>,
    schemas: BTreeMap<u16, String>,
    /// Number of the last message, by channel.
    numbers: BTreeMap<u16, u32>,
}

impl Reading {
    /// Reads all records. A failure has the place of its record.
    fn all(&mut self, bytes: &[u8]) -> Result<(), (usize, Failure)> {
        let options = LinearReaderOptions::default().with_emit_chunks(true).with_record_length_limit(LONGEST);
        let options = options.with_validate_data_section_crc(true).with_validate_summary_section_crc(true);
        let mut reader = LinearReader::new_with_options(options);
        let (mut rest, mut at) = (bytes, MAGIC.len());
        while let Some(event) = reader.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    let (next, later) = rest.split_at(wanted.min(rest.len()));
                    reader.insert(next.len()).copy_from_slice(next);
                    reader.notify_read(next.len());
                    rest = later;
                }
                Ok(LinearReadEvent::Record { data, opcode }) => {
                    self.record(at, opcode, data).map_err(|failure| (at, failure))?;
                    at += HEAD + data.len();
                }
                Err(error) => return Err((at, error.into())),
            }
        }
        match self.content.complete {
            true => Ok(()),
            false => Err((at, damaged("the record behind the messages is missing"))),
        }
    }

    /// Takes a record outside of chunks, or a chunk.
    fn record(&mut self, at: usize, opcode: u8, data: &[u8]) -> Result<(), Failure> {
        // The library subtracts the lengths in an attachment without a check.
        if opcode == op::ATTACHMENT && !has_attachment(data) {
            return Err(damaged("an attachment with wrong lengths"));
        }
        match parse_record(opcode, data)? {
            // The summary repeats schemas and channels, and has indices.
            Record::Chunk { .. } if self.content.complete => return Err(damaged("a chunk behind the messages")),
            _ if self.content.complete => {}
            Record::Header(header) => self.profile = Some(header.profile),
            Record::Metadata(metadata) if metadata.name == METADATA => self.content.facts.texts = metadata.metadata,
            Record::Attachment { header, data, .. } => {
                self.content.facts.files.push((header.name, data.into_owned()));
            }
            Record::Chunk { header, .. } => {
                let (name, size) = (header.compression.len() as u64, header.compressed_size);
                if !has_length(data.len() as u64, name, size) {
                    return Err(damaged("a chunk with wrong lengths"));
                }
                let mut messages = Vec::new();
                self.chunk(at, data, &mut messages)?;
                self.content.messages.append(&mut messages);
            }
            Record::DataEnd(_) => self.content.complete = true,
            Record::MessageIndex(_) => {}
            // Schemas, channels and messages are in chunks.
            _ => return Err(damaged("a record of a kind that is not expected here")),
        }
        Ok(())
    }

    /// Takes the records of a chunk, after all of them agree with its checksum.
    fn chunk(&mut self, at: usize, data: &[u8], messages: &mut Vec<Stored>) -> Result<(), Failure> {
        let options = LinearReaderOptions::default().with_skip_start_magic(true).with_skip_end_magic(true);
        let options = options.with_validate_chunk_crcs(true).with_prevalidate_chunk_crcs(true);
        let mut reader = LinearReader::new_with_options(options.with_record_length_limit(LONGEST));
        let room = reader.insert(HEAD + data.len());
        room[0] = op::CHUNK;
        room[1..HEAD].copy_from_slice(&(data.len() as u64).to_le_bytes());
        room[HEAD..HEAD + data.len()].copy_from_slice(data);
        reader.notify_read(HEAD + data.len());
        let ended = || damaged("a chunk that ends in a record");
        while let Some(event) = reader.next_event() {
            let (opcode, data) = match event {
                Ok(LinearReadEvent::ReadRequest(_)) => {
                    reader.notify_read(0);
                    continue;
                }
                Ok(LinearReadEvent::Record { data, opcode }) => (opcode, data),
                Err(McapError::UnexpectedEof) => return Err(ended()),
                Err(error) => return Err(error.into()),
            };
            match parse_record(opcode, data)? {
                Record::Schema { header, .. } => {
                    self.schemas.insert(header.id, header.name);
                }
                Record::Channel(channel) => {
                    let schema = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                    self.content.channels.insert(channel.id.saturating_sub(FIRST), (channel.topic, schema));
                }
                Record::Message { header, data } => {
                    self.follows(header.channel_id, header.sequence)?;
                    messages.push(Stored {
                        channel: header.channel_id.saturating_sub(FIRST),
                        time: Instant::from_nanos(header.log_time),
                        body: data.into_owned(),
                        chunk: at,
                    });
                }
                _ => return Err(damaged("a chunk with a record of a kind that is not expected here")),
            }
        }
        Ok(())
    }

    /// Fails if messages of the channel are missing before message `number`. Only the last seconds of a run begin with
    /// another number than 1.
    fn follows(&mut self, channel: u16, number: u32) -> Result<(), Failure> {
        let first = self.content.facts.texts.get("whole").is_none_or(|whole| whole == "true").then_some(0);
        let before = self.numbers.insert(channel, number).or(first);
        match before.is_none_or(|before| before.wrapping_add(1) == number) {
            true => Ok(()),
            false => Err(damaged("messages are missing before this chunk")),
        }
    }

    /// Notes how the file ends in the record at `at`.
    fn end(&mut self, bytes: &[u8], at: usize, failure: Failure) {
        let content = &mut self.content;
        // After a power cut, a file may end with zeros in place of its last bytes.
        let data = bytes.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
        let has_end = bytes.ends_with(MAGIC) && at < bytes.len() - MAGIC.len();
        let reaches_end = has_record(&bytes[at..]).is_some_and(|length| at + length >= data);
        let what = match failure {
            Failure::Ended if !has_end && !contradicts(&bytes[at..]) => {
                content.cut = Some(match (content.complete, at == bytes.len()) {
                    (true, _) => "the file ends behind its messages".to_owned(),
                    (false, true) => "the file ends behind a record, without its end".to_owned(),
                    (false, false) => "the file ends within a record".to_owned(),
                });
                return;
            }
            Failure::Damaged(_) if !has_end && !content.complete && reaches_end => {
                content.cut = Some("the last record of the file is not complete".to_owned());
                return;
            }
            Failure::Ended => "a record with a wrong length".to_owned(),
            Failure::Damaged(what) => what,
        };
        let complete = content.complete;
        content.damage_at(at, what);
        // Damage behind the messages concerns none of them.
        content.complete = complete;
    }
}

/// Length of the record at the begin of `bytes` with its head, if the record is complete.
fn has_record(bytes: &[u8]) -> Option<usize> {
    let [_, length @ ..] = bytes.first_chunk::<HEAD>()?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok()?.checked_add(HEAD)?;
    (length <= bytes.len()).then_some(length)
}

/// Whether the length of a chunk that is not complete contradicts its header.
fn contradicts(bytes: &[u8]) -> bool {
    let Some(([op::CHUNK, length @ ..], data)) = bytes.split_first_chunk::<HEAD>() else { return false };
    let Some(name) = data.get(28..).and_then(|rest| rest.first_chunk()) else { return false };
    let name = u64::from(u32::from_le_bytes(*name));
    let Some(size) = data.get(32 + name as usize..).and_then(|rest| rest.first_chunk()) else {
        return name > LONGEST as u64;
    };
    !has_length(u64::from_le_bytes(*length), name, u64::from_le_bytes(*size))
}

/// Whether a chunk of `length` bytes has a compression with a name of `name` bytes, and `size` bytes of data.
fn has_length(length: u64, name: u64, size: u64) -> bool {
    size.checked_add(CHUNK_HEADER + name) == Some(length)
}

/// Whether the lengths in an attachment are those of its parts: two times, name, kind, data and checksum.
fn has_attachment(bytes: &[u8]) -> bool {
    let text = |at: usize| Some(at + 4 + u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?) as usize);
    let data = text(16).and_then(text);
    let length = data.and_then(|at| Some((at, u64::from_le_bytes(*bytes.get(at..)?.first_chunk()?))));
    length.is_some_and(|(at, length)| length.checked_add(at as u64 + 12) == Some(bytes.len() as u64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_of_a_length_that_no_file_has_is_damage() {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([0x0F, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        for length in [u64::MAX, u64::MAX - 8, 1 << 62] {
            let damaged: Vec<u8> = bytes.iter().copied().chain([0x05]).chain(length.to_le_bytes()).collect();
            let content = Content::read(&damaged).unwrap();
            assert_eq!((content.messages.len(), content.channels.len()), (0, 0));
        }
        // A message of this length in a chunk.
        for length in [1 << 20, 1 << 50, u64::MAX] {
            let message: Vec<u8> = [0x05].into_iter().chain(u64::to_le_bytes(length)).collect();
            let mut chunk = [0; 16].to_vec();
            chunk.extend((message.len() as u64).to_le_bytes());
            // Neither a checksum nor a compression.
            chunk.extend([0; 8]);
            chunk.extend((message.len() as u64).to_le_bytes());
            chunk.extend(&message);
            let head = bytes.iter().copied().chain([0x06]).chain((chunk.len() as u64).to_le_bytes());
            let damaged: Vec<u8> = head.chain(chunk).collect();
            let content = Content::read(&damaged).unwrap();
            assert!(content.messages.is_empty() && content.damage.is_some(), "{length}");
        }
        let damaged: Vec<u8> = MAGIC.iter().copied().chain([0x05]).chain(u64::MAX.to_le_bytes()).collect();
        assert!(Content::read(&damaged).unwrap().damage.is_some());
    }
}
