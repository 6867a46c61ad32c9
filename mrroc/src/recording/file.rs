//! MCAP files: chunks that are completed on the disk twice per second.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};

use can::Instant;
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Compression, WriteOptions, Writer};

use super::messages::descriptors;
use super::schema::PACKAGE;

/// Name of the metadata of a recording.
pub(super) const METADATA: &str = "mrroc";

/// Name of the metadata behind the last message: the count of the messages by topic. A file without them is incomplete.
pub(super) const END: &str = "mrroc-end";

/// Whether the run had ended, in the metadata behind the last message.
pub(super) const ENDED: &str = "ended";

/// Most bytes of a chunk before compression.
const CHUNK: u64 = 1 << 20;

/// Number of the first channel in a file.
pub(super) const FIRST: u16 = 1;

/// Profile of the files, and version of the messages.
pub(super) const PROFILE: &str = "mrroc-2";

/// Profile of earlier files with the same messages, which do not count them.
pub(super) const PROFILE_WITHOUT_END: &str = "mrroc-1";

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
pub(super) struct McapFile {
    writer: Writer<NoSeek<Synced>>,
    /// Topic and number of messages, by channel.
    counts: Vec<(String, u64)>,
}

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
        Ok(Self { writer, counts: channels.iter().map(|channel| (channel.topic.clone(), 0)).collect() })
    }

    /// Adds a message of channel `channel`.
    pub(super) fn write(&mut self, channel: u16, time: Instant, number: u32, body: &[u8]) -> anyhow::Result<()> {
        let time = time.as_nanos();
        let header =
            MessageHeader { channel_id: channel + FIRST, sequence: number, log_time: time, publish_time: time };
        self.writer.write_to_known_channel(&header, body)?;
        self.counts[usize::from(channel)].1 += 1;
        Ok(())
    }

    /// Completes the chunk under way on the disk.
    pub(super) fn flush(&mut self) -> anyhow::Result<()> {
        Ok(self.writer.flush()?)
    }

    /// Completes the file. `ended`: no message of the run is later than those of the file.
    pub(super) fn finish(mut self, ended: bool) -> anyhow::Result<()> {
        let mut metadata: BTreeMap<_, _> =
            self.counts.iter().map(|(topic, count)| (topic.clone(), count.to_string())).collect();
        metadata.insert(ENDED.to_owned(), ended.to_string());
        self.writer.write_metadata(&Metadata { name: END.to_owned(), metadata })?;
        self.writer.finish()?;
        Ok(())
    }
}
