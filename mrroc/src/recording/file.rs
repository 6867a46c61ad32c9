//! MCAP files: chunks that are completed on the disk twice per second, and a reader for files that end anywhere.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};

use anyhow::anyhow;
use can::Instant;
use mcap::parse_record;
use mcap::records::{MessageHeader, Metadata, Record};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::write::NoSeek;
use mcap::{Compression, WriteOptions, Writer};

use super::messages::descriptors;
use super::schema::PACKAGE;

/// Name of the metadata of a recording.
const METADATA: &str = "mrroc";

/// Most bytes of a chunk before compression.
const CHUNK: u64 = 1 << 20;

/// Number of the first channel in a file.
const FIRST: u16 = 1;

/// Profile of the files, and version of the messages.
const PROFILE: &str = "mrroc-1";

/// A channel of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Channel {
    pub(super) topic: String,
    /// Name of the message.
    pub(super) message: &'static str,
}

/// What a recording says of itself: texts by name, and the files that the run has read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Facts {
    pub(super) texts: BTreeMap<String, String>,
    /// Files by path.
    pub(super) files: Vec<(String, Vec<u8>)>,
}

/// A file that counts the bytes written, and synchronises the data with the disk when it is flushed.
struct Synced(File);

impl Write for Synced {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        match self.0.sync_data() {
            // A pipe or a device has no disk.
            Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
            synchronised => synchronised,
        }
    }
}

/// An MCAP file under way.
pub(super) struct McapFile(Writer<NoSeek<Synced>>);

impl McapFile {
    /// Begins a file with its facts and channels.
    pub(super) fn new(file: File, facts: &Facts, channels: &[Channel]) -> anyhow::Result<Self> {
        let options = WriteOptions::new()
            .compression(Some(Compression::Lz4))
            .chunk_size(Some(CHUNK))
            .disable_seeking(true)
            .profile(PROFILE)
            .library(concat!("mrroc ", env!("CARGO_PKG_VERSION")));
        let mut writer = options.create(NoSeek::new(Synced(file)))?;
        writer.write_metadata(&Metadata { name: METADATA.to_owned(), metadata: facts.texts.clone() })?;
        for (name, data) in &facts.files {
            writer.attach(&mcap::Attachment {
                log_time: 0,
                create_time: 0,
                name: name.clone(),
                media_type: "text/plain".to_owned(),
                data: Cow::Borrowed(data),
            })?;
        }
        let descriptors = descriptors();
        for (index, channel) in channels.iter().enumerate() {
            let schema = writer.add_schema(&format!("{PACKAGE}.{}", channel.message), "protobuf", &descriptors)?;
            let id = writer.add_channel(schema, &channel.topic, "protobuf", &BTreeMap::new())?;
            debug_assert_eq!(usize::from(id), index + usize::from(FIRST));
        }
        writer.flush()?;
        Ok(Self(writer))
    }

    /// Adds a message of channel `channel`.
    pub(super) fn write(&mut self, channel: u16, time: Instant, number: u32, body: &[u8]) -> anyhow::Result<()> {
        let time = time.as_nanos();
        let header =
            MessageHeader { channel_id: channel + FIRST, sequence: number, log_time: time, publish_time: time };
        Ok(self.0.write_to_known_channel(&header, body)?)
    }

    /// Completes the chunk under way on the disk.
    pub(super) fn flush(&mut self) -> anyhow::Result<()> {
        Ok(self.0.flush()?)
    }

    /// Completes the file.
    pub(super) fn finish(mut self) -> anyhow::Result<()> {
        self.0.finish()?;
        Ok(())
    }
}

/// Greatest length of a record, bytes. A damaged length must not request more memory.
const LONGEST: usize = 64 << 20;

/// The bytes up to the first record whose length no file can have. The reader adds to a length without a check.
fn sound_lengths(bytes: &[u8]) -> &[u8] {
    let mut at = mcap::MAGIC.len();
    while let Some([_, length @ ..]) = bytes.get(at..).and_then(|rest| rest.first_chunk::<9>()) {
        let length = u64::from_le_bytes(*length);
        if length > 1 << 48 {
            return &bytes[..at];
        }
        at = at.saturating_add(9 + length as usize);
    }
    bytes
}

/// A message that was read.
pub(super) struct Stored {
    pub(super) channel: u16,
    pub(super) time: Instant,
    pub(super) body: Vec<u8>,
}

/// A recording that was read.
#[derive(Default)]
pub(super) struct Content {
    pub(super) facts: Facts,
    /// Topic and message name by channel.
    pub(super) channels: BTreeMap<u16, (String, String)>,
    /// The messages in the order of the file.
    pub(super) messages: Vec<Stored>,
    /// Where and why reading ended before the end of the file.
    pub(super) cut: Option<String>,
}

impl Content {
    /// Reads a recording. A file that was cut gives its whole chunks.
    pub(super) fn read(bytes: &[u8]) -> anyhow::Result<Self> {
        let options = LinearReaderOptions::default().with_skip_end_magic(true).with_validate_chunk_crcs(true);
        let mut reader = LinearReader::new_with_options(options.with_record_length_limit(LONGEST));
        let mut rest = sound_lengths(bytes);
        let (mut content, mut schemas) = (Self::default(), BTreeMap::new());
        let mut ended = false;
        while let Some(event) = reader.next_event() {
            let record = match event {
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    let (next, later) = rest.split_at(wanted.min(rest.len()));
                    reader.insert(next.len()).copy_from_slice(next);
                    reader.notify_read(next.len());
                    rest = later;
                    continue;
                }
                Ok(LinearReadEvent::Record { data, opcode }) => parse_record(opcode, data),
                Err(error) => Err(error),
            };
            match record {
                Ok(Record::Header(header)) if header.profile != PROFILE => {
                    return Err(anyhow!("the profile is {:?}, and this version reads {PROFILE:?}", header.profile));
                }
                Ok(Record::Schema { header, .. }) => {
                    schemas.insert(header.id, header.name);
                }
                Ok(Record::Channel(channel)) => {
                    let schema = schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                    content.channels.insert(channel.id.saturating_sub(FIRST), (channel.topic, schema));
                }
                Ok(Record::Metadata(metadata)) if metadata.name == METADATA => content.facts.texts = metadata.metadata,
                Ok(Record::Attachment { header, data, .. }) => {
                    content.facts.files.push((header.name, data.into_owned()));
                }
                Ok(Record::Message { header, data }) => content.messages.push(Stored {
                    channel: header.channel_id.saturating_sub(FIRST),
                    time: Instant::from_nanos(header.log_time),
                    body: data.into_owned(),
                }),
                Ok(Record::DataEnd(_)) => ended = true,
                Ok(_) => {}
                Err(error) => {
                    content.cut = Some(error.to_string());
                    break;
                }
            }
        }
        if !ended && content.cut.is_none() {
            content.cut = Some("the end is missing".to_owned());
        }
        Ok(content)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_of_a_length_that_no_file_has_ends_a_recording() {
        let mut bytes = mcap::MAGIC.to_vec();
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
            assert!(content.messages.is_empty() && content.cut.is_some(), "{length}");
        }
        let damaged: Vec<u8> = mcap::MAGIC.iter().copied().chain([0x05]).chain(u64::MAX.to_le_bytes()).collect();
        assert!(Content::read(&damaged).unwrap().cut.is_some());
    }
}
