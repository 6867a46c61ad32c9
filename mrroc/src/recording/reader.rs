//! Reader of MCAP files that may be cut or damaged. A file that was cut ends before its end record. Damage has data
//! behind it: a checksum, a decompression, a record or the numbers of messages fail.
//!
//! The reader gives the messages chunk by chunk, and no message of the first damaged chunk or behind it. The memory is
//! that of one chunk, whatever the length of the file. The end is judged: counts of messages, and bytes behind the end.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use anyhow::{anyhow, bail};
use can::Instant;
use mcap::records::{Metadata, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapError, parse_record};
use serde::Serialize;

use super::contents::Contents;
use super::file::{
    END, ENDED, FIRST, Facts, METADATA, PROFILE, PROFILE_WITHOUT_END, PROFILE_WITHOUT_VERSION, UTC, VERSION,
};
use super::input::Input;
use crate::bench::BenchKind;
use crate::input;
use can::counted;

/// Greatest length of a record, bytes. A damaged length must not request more memory.
const LONGEST: usize = 16 << 20;

/// Greatest length of a chunk, compressed or not, bytes. A recording has chunks of little more than 1 MiB.
const LONGEST_CHUNK: usize = 8 << 20;

/// Greatest length of all files in a recording, bytes.
const FILES: usize = 64 << 20;

/// Greatest number of channels or schemas, and greatest length of their names.
const NAMES: (usize, usize) = (1 << 12, 1 << 10);

/// Bytes of opcode and length of a record.
pub(super) const HEAD: usize = 9;

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

/// How the messages of a recording end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    /// All messages of the run are there.
    Whole,
    /// All messages up to a moment of the run are there.
    UnderWay,
    /// The file was cut or is damaged before the end of its messages.
    Broken,
}

/// A recording that is read.
pub(super) struct Reader {
    input: Input,
    records: LinearReader,
    /// Place of the next record in the file, bytes.
    at: usize,
    is_over: bool,
    reading: Reading,
}

/// Why a record cannot be used.
enum Failure {
    /// The file ends within the record.
    Ended,
    /// The record is damaged.
    Damaged(String),
    /// Messages are missing.
    Missing(String),
    /// The file cannot be read at all.
    Refused(anyhow::Error),
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

impl Reader {
    /// Begins the recording `path`.
    pub(super) fn open(path: &Path) -> anyhow::Result<Self> {
        Self::new(Box::new(input::open_regular(path)?))
    }

    pub(super) fn new(source: Box<dyn Read>) -> anyhow::Result<Self> {
        let mut input = Input::new(source);
        let mut magic = [0; MAGIC.len()];
        let length = input.fill(&mut magic)?;
        if magic != *MAGIC {
            bail!(
                "no MCAP file: {}",
                if length == 0 { "the file is empty" } else { "the file does not begin as an MCAP file does" }
            );
        }
        input.begin_record();
        let options = LinearReaderOptions::default().with_emit_chunks(true).with_record_length_limit(LONGEST);
        let options = options.with_validate_data_section_crc(true).with_validate_summary_section_crc(true);
        let mut records = LinearReader::new_with_options(options);
        records.insert(MAGIC.len()).copy_from_slice(MAGIC);
        records.notify_read(MAGIC.len());
        Ok(Self { input, records, at: MAGIC.len(), is_over: false, reading: Reading::default() })
    }

    /// The messages of the next chunk that has some; `None` behind the last one that can be used.
    pub(super) fn chunk(&mut self) -> anyhow::Result<Option<Vec<Stored>>> {
        while !self.is_over {
            match self.record() {
                Ok(Some(messages)) if messages.is_empty() => {}
                Ok(Some(messages)) => return Ok(Some(messages)),
                Ok(None) => self.is_over = true,
                Err(Failure::Refused(error)) => return Err(error),
                Err(failure) => {
                    self.is_over = true;
                    self.input.skip_rest()?;
                    self.reading.end(&self.input, self.at, failure);
                }
            }
        }
        Ok(None)
    }

    /// The messages of the next record; `None` at the end of the file.
    fn record(&mut self) -> Result<Option<Vec<Stored>>, Failure> {
        loop {
            match self.records.next_event() {
                Some(Ok(LinearReadEvent::ReadRequest(wanted))) => {
                    let read = self.input.fill(self.records.insert(wanted));
                    self.records.notify_read(read.map_err(|error| Failure::Refused(error.into()))?);
                }
                Some(Ok(LinearReadEvent::Record { data, opcode })) => {
                    let messages = self.reading.record(self.at, opcode, data)?;
                    self.at += HEAD + data.len();
                    self.input.begin_record();
                    return Ok(Some(messages));
                }
                Some(Err(error)) => return Err(error.into()),
                None if !self.reading.complete => return Err(damaged("the record behind the messages is missing")),
                None => break,
            }
        }
        self.at += MAGIC.len();
        self.input.begin_record();
        let mut behind = [0; MAGIC.len()];
        match self.input.fill(&mut behind) {
            Ok(0) => Ok(None),
            Ok(_) if behind == *MAGIC => Err(damaged("another recording behind the end of this one")),
            Ok(_) => Err(damaged("bytes behind the end of the recording")),
            Err(error) => Err(Failure::Refused(error.into())),
        }
    }

    /// What the recording says of itself.
    pub(super) fn facts(&self) -> &Facts {
        &self.reading.facts
    }

    /// Topic and message name by channel.
    pub(super) fn channels(&self) -> &BTreeMap<u16, (String, String)> {
        &self.reading.channels
    }

    /// Declares channels as a chunk does.
    #[cfg(test)]
    pub(super) fn declare(&mut self, channels: impl IntoIterator<Item = (u16, (String, String))>) {
        self.reading.channels.extend(channels);
    }

    /// How the file ends before its end.
    pub(super) fn cut(&self) -> Option<&str> {
        self.reading.cut.as_deref()
    }

    /// The first damage so far.
    pub(super) fn damage(&self) -> Option<&Damage> {
        self.reading.damage.as_ref()
    }

    /// Notes damage of the chunk at `byte`, and ends the recording before this chunk.
    pub(super) fn damage_at(&mut self, byte: usize, what: String) {
        self.is_over = true;
        let reading = &mut self.reading;
        (reading.damage, reading.cut, reading.complete) = (Some(Damage { byte, what }), None, false);
    }

    /// Why the file may lack parts that a replay needs; `None` for a complete file.
    pub(super) fn missing(&self) -> Option<String> {
        let damage = self.damage().map(|Damage { byte, what }| format!("damaged at byte {byte} ({what})"));
        damage.or(self.cut().map(|cut| format!("the recording was cut: {cut}")))
    }

    /// How the messages end, after the last chunk.
    pub(super) fn end(&self) -> End {
        let mark = self.reading.mark.as_ref().filter(|_| self.reading.complete);
        match mark.map(|mark| mark.get(ENDED).is_some_and(|ended| ended == "true")) {
            Some(true) => End::Whole,
            Some(false) => End::UnderWay,
            None => End::Broken,
        }
    }
}

/// What was read so far.
#[derive(Default)]
struct Reading {
    facts: Facts,
    channels: BTreeMap<u16, (String, String)>,
    cut: Option<String>,
    damage: Option<Damage>,
    /// Whether all messages are there: the record behind them was read, and the checksum of the bytes before agrees.
    complete: bool,
    /// The metadata with the number of messages by topic.
    mark: Option<BTreeMap<String, String>>,
    profile: Option<String>,
    schemas: BTreeMap<u16, String>,
    /// Number of the last message, by channel.
    numbers: BTreeMap<u16, u32>,
    contents: Contents,
}

impl Reading {
    /// Takes a record outside of chunks, or a chunk, and gives the messages of a chunk.
    fn record(&mut self, at: usize, opcode: u8, data: &[u8]) -> Result<Vec<Stored>, Failure> {
        // The library subtracts the lengths in an attachment without a check.
        if opcode == op::ATTACHMENT && !has_attachment(data) {
            return Err(damaged("an attachment with wrong lengths"));
        }
        let mut messages = Vec::new();
        let record = parse_record(opcode, data)?;
        let (place, length) = (at as u64, (HEAD + data.len()) as u64);
        if self.complete {
            self.contents.summary(place, length, opcode, &record).map_err(Failure::Missing)?;
            return Ok(messages);
        }
        if let Record::MessageIndex(index) = record {
            self.contents.index(length, index.records.len());
            return Ok(messages);
        }
        self.contents.close_chunk().map_err(Failure::Missing)?;
        match record {
            Record::DataEnd(_) => self.data_end()?,
            Record::Header(header) => self.take_profile(header.profile)?,
            Record::Metadata(metadata) => {
                self.contents.metadata(place, length);
                self.take_metadata(metadata)?;
            }
            Record::Attachment { header, data, .. } => {
                self.contents.attachment(place, length);
                let length = self.facts.files.iter().map(|(name, data)| name.len() + data.len()).sum::<usize>();
                if length + data.len() > FILES {
                    return Err(damaged("files that are longer than those of a cell"));
                }
                self.facts.files.push((header.name, data.into_owned()));
            }
            Record::Chunk { header, .. } => {
                let (name, size) = (header.compression.len() as u64, header.compressed_size);
                if !has_length(data.len() as u64, name, size) {
                    return Err(damaged("a chunk with wrong lengths"));
                }
                self.has_facts()?;
                self.chunk(at, data, &mut messages)?;
                self.contents.chunk(place, length, messages.len());
                for message in &messages {
                    self.contents.message(message.channel.wrapping_add(FIRST), message.time.as_nanos());
                }
            }
            // Schemas, channels and messages are in chunks.
            _ => return Err(damaged("a record of a kind that is not expected here")),
        }
        Ok(messages)
    }

    /// Takes metadata. A tool that writes the file again may write the counts before the last chunk.
    fn take_metadata(&mut self, metadata: Metadata) -> Result<(), Failure> {
        let texts = metadata.metadata;
        match metadata.name.as_str() {
            METADATA if self.facts.texts.is_empty() => self.take_facts(texts),
            END if self.mark.is_none() => {
                self.mark = Some(texts);
                Ok(())
            }
            METADATA | END => Err(damaged("the metadata are there twice")),
            _ => Err(damaged("metadata of a name that is not expected here")),
        }
    }

    /// Fails if the header or a required text of the metadata is missing.
    fn has_facts(&self) -> Result<(), Failure> {
        let Some(profile) = &self.profile else { return Err(Failure::Missing("the header is missing".to_owned())) };
        let texts = &self.facts.texts;
        // In lockstep, times follow no clock.
        let has_utc = profile == PROFILE && texts.get("bench").is_none_or(|bench| bench != BenchKind::Lockstep.name());
        let mut keys = ["version", "bench", "cell"].into_iter().chain(has_utc.then_some(UTC));
        match keys.find(|key| !texts.contains_key(*key)) {
            Some(key) => Err(Failure::Missing(format!("the metadata lack {key:?}"))),
            None => Ok(()),
        }
    }

    fn take_profile(&mut self, profile: String) -> Result<(), Failure> {
        if self.profile.is_some() {
            return Err(damaged("the header is there twice"));
        }
        if ![PROFILE, PROFILE_WITHOUT_VERSION, PROFILE_WITHOUT_END].contains(&profile.as_str()) {
            let error = anyhow!("the profile is {profile:?}, and this version reads {PROFILE:?}");
            return Err(Failure::Refused(error));
        }
        self.profile = Some(profile);
        Ok(())
    }

    /// Takes the metadata of the recording. Its messages must be of the version that this version of mrroc reads.
    fn take_facts(&mut self, texts: BTreeMap<String, String>) -> Result<(), Failure> {
        let version = texts.get(VERSION.0).map_or("none", String::as_str);
        if self.profile.as_deref() == Some(PROFILE) && version != VERSION.1 {
            let read = VERSION.1;
            let error = anyhow!("the version of the messages is {version}, and this version of mrroc reads {read}");
            return Err(Failure::Refused(error));
        }
        self.facts.texts = texts;
        Ok(())
    }

    /// Takes the record behind all messages, and compares the messages with their counts.
    fn data_end(&mut self) -> Result<(), Failure> {
        let Some(mark) = &self.mark else {
            if self.profile.as_deref() != Some(PROFILE_WITHOUT_END) {
                return Err(Failure::Missing("the counts of the messages are missing behind them".to_owned()));
            }
            let cut = "the version that made the recording did not count the messages, so later ones may be missing";
            (self.cut, self.complete) = (Some(cut.to_owned()), true);
            return Ok(());
        };
        if !mark.contains_key(ENDED) {
            return Err(damaged("the counts of the messages do not say whether the run had ended"));
        }
        let topics = mark.keys().filter(|key| key.starts_with('/'));
        if let Some(topic) = topics.into_iter().find(|&topic| self.channels.values().all(|(it, _)| it != topic)) {
            return Err(Failure::Missing(format!("the channel {topic} is missing")));
        }
        for (channel, (topic, _)) in &self.channels {
            let found = self.contents.count(channel.wrapping_add(FIRST));
            let Some(written) = mark.get(topic).and_then(|count| count.parse::<u64>().ok()) else {
                return Err(damaged("a count of the messages that cannot be decoded"));
            };
            if found != written {
                return Err(Failure::Missing(format!(
                    "{found} of {} of {topic} are there",
                    counted(written, "message")
                )));
            }
        }
        self.complete = true;
        Ok(())
    }

    /// Takes the records of a chunk, after all of them agree with its checksum.
    fn chunk(&mut self, at: usize, data: &[u8], messages: &mut Vec<Stored>) -> Result<(), Failure> {
        let options = LinearReaderOptions::default().with_skip_start_magic(true).with_skip_end_magic(true);
        let options = options.with_validate_chunk_crcs(true).with_prevalidate_chunk_crcs(true);
        let mut reader = LinearReader::new_with_options(options.with_record_length_limit(LONGEST_CHUNK));
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
                    if named(&mut self.schemas, header.id, header.name.clone(), header.name.len())? {
                        self.contents.schema(header.id);
                    }
                }
                Record::Channel(channel) => {
                    let Some(schema) = self.schemas.get(&channel.schema_id).cloned() else {
                        return Err(Failure::Missing(format!("the schema of {} is missing", channel.topic)));
                    };
                    let (id, length, topic) = (channel.id.saturating_sub(FIRST), channel.topic.len(), &channel.topic);
                    if named(&mut self.channels, id, (topic.clone(), schema), length)? {
                        self.contents.channel(channel.id, topic);
                    }
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
        let first = self.facts.texts.get("whole").is_none_or(|whole| whole == "true").then_some(0);
        let before = self.numbers.insert(channel, number).or(first);
        match before.is_none_or(|before| before.wrapping_add(1) == number) {
            true => Ok(()),
            false => Err(Failure::Missing("messages are missing before this chunk".to_owned())),
        }
    }

    /// Notes how the file ends in the record at `at`. All bytes of `input` were read.
    fn end(&mut self, input: &Input, at: usize, failure: Failure) {
        let length = input.length();
        // After a power cut, a file may end with zeros in place of its last bytes.
        let has_end = input.ends_with(MAGIC) && at + MAGIC.len() < length;
        let start = input.start_of_record();
        let reaches_end = has_record(start, length - at).is_some_and(|record| at + record >= input.data());
        let what = match failure {
            Failure::Ended if !has_end && !contradicts(start) => {
                self.cut = Some(match (self.complete, at == length) {
                    (true, _) => "the file ends behind its messages".to_owned(),
                    (false, true) => "the file ends behind a record, without its end".to_owned(),
                    (false, false) => "the file ends within a record".to_owned(),
                });
                return;
            }
            Failure::Damaged(_) if !has_end && !self.complete && reaches_end => {
                self.cut = Some("the last record of the file is not complete".to_owned());
                return;
            }
            Failure::Ended => "a record with a wrong length".to_owned(),
            Failure::Damaged(what) | Failure::Missing(what) => what,
            Failure::Refused(error) => format!("{error:#}"),
        };
        self.cut = None;
        // Damage behind the messages concerns none of them.
        self.damage = Some(Damage { byte: at, what });
    }
}

/// Adds a name, and returns whether the name is new. A recording has few names, and all are short.
fn named<T: PartialEq>(names: &mut BTreeMap<u16, T>, id: u16, name: T, length: usize) -> Result<bool, Failure> {
    if length > NAMES.1 || names.len() >= NAMES.0 {
        return Err(damaged("names of channels that no recording has"));
    }
    match names.insert(id, name) {
        Some(before) if names.get(&id) != Some(&before) => Err(damaged("a channel that changes")),
        before => Ok(before.is_none()),
    }
}

/// Length of the record that begins with `start`, with its head, if the record is complete within `room` bytes.
fn has_record(start: &[u8], room: usize) -> Option<usize> {
    let [_, length @ ..] = start.first_chunk::<HEAD>()?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok()?.checked_add(HEAD)?;
    (length <= room).then_some(length)
}

/// Greatest length of the name of a compression, bytes.
const LONGEST_NAME: u64 = 32;

/// Whether the length of a chunk that is not complete contradicts its header.
fn contradicts(start: &[u8]) -> bool {
    let Some(([op::CHUNK, length @ ..], data)) = start.split_first_chunk::<HEAD>() else { return false };
    let Some(name) = data.get(28..).and_then(|rest| rest.first_chunk()) else { return false };
    let name = u64::from(u32::from_le_bytes(*name));
    // The start of the record has no room for a name that no compression has.
    let Some(size) = data.get(32 + name as usize..).and_then(|rest| rest.first_chunk()) else {
        return name > LONGEST_NAME;
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
    use std::io::Cursor;

    use super::*;

    /// Reads all messages of a file.
    fn read(bytes: Vec<u8>) -> (usize, Reader) {
        let mut reader = Reader::new(Box::new(Cursor::new(bytes))).unwrap();
        let mut messages = 0;
        while let Some(chunk) = reader.chunk().unwrap() {
            messages += chunk.len();
        }
        (messages, reader)
    }

    #[test]
    fn a_record_of_a_length_that_no_file_has_is_damage() {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([0x0F, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        for length in [u64::MAX, u64::MAX - 8, 1 << 62] {
            let damaged: Vec<u8> = bytes.iter().copied().chain([0x05]).chain(length.to_le_bytes()).collect();
            let (messages, reader) = read(damaged);
            assert_eq!((messages, reader.channels().len()), (0, 0));
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
            let (messages, reader) = read(damaged);
            assert!(messages == 0 && reader.damage().is_some(), "{length}");
        }
        let damaged: Vec<u8> = MAGIC.iter().copied().chain([0x05]).chain(u64::MAX.to_le_bytes()).collect();
        assert!(read(damaged).1.damage().is_some());
    }
}
