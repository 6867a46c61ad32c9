//! The parts of a recording, and their comparison with its summary.
//!
//! A recording of a day has about 200,000 chunks. The comparison of the chunks with the index uses their number and a
//! checksum that does not depend on the order. The memory therefore does not grow with the file.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};

use can::counted_as;
use mcap::records::{Footer, Record, Statistics};

/// Number and checksum of entries in any order.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
struct Tally {
    count: u64,
    sum: u64,
}

impl Tally {
    fn add(&mut self, entry: impl Hash) {
        let mut hasher = DefaultHasher::new();
        entry.hash(&mut hasher);
        self.count += 1;
        self.sum = self.sum.wrapping_add(hasher.finish());
    }
}

/// Parts of each kind: the parts in the file, or the parts that the summary names.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
struct Parts {
    chunks: Tally,
    attachments: Tally,
    metadata: Tally,
    schemas: Tally,
    channels: Tally,
    /// Groups of records of one kind in the summary.
    groups: Tally,
}

/// A chunk while its index is read.
struct Chunk {
    at: u64,
    length: u64,
    messages: usize,
    /// Length of the records of the index.
    index: u64,
    /// Messages that the index has.
    indexed: usize,
}

/// Parts of a recording, and the parts that its summary names.
#[derive(Default)]
pub(super) struct Contents {
    found: Parts,
    named: Parts,
    chunk: Option<Chunk>,
    /// Number of messages by channel of the file.
    counts: BTreeMap<u16, u64>,
    /// First and last time of the messages, ns.
    times: Option<(u64, u64)>,
    statistics: Option<Statistics>,
    /// Records of one kind in the summary: opcode, place and length.
    group: Option<(u8, u64, u64)>,
    /// Place of the first record of the summary, and of its first offset.
    summary: [Option<u64>; 2],
}

impl Contents {
    /// Takes a schema of a chunk.
    pub(super) fn schema(&mut self, id: u16) {
        self.found.schemas.add(id);
    }

    /// Takes a channel of a chunk.
    pub(super) fn channel(&mut self, id: u16, topic: &str) {
        self.found.channels.add((id, topic));
    }

    /// Takes a message of a chunk.
    pub(super) fn message(&mut self, channel: u16, time: u64) {
        *self.counts.entry(channel).or_default() += 1;
        let (first, last) = self.times.unwrap_or((time, time));
        self.times = Some((first.min(time), last.max(time)));
    }

    /// Number of the messages of a channel.
    pub(super) fn count(&self, channel: u16) -> u64 {
        self.counts.get(&channel).copied().unwrap_or(0)
    }

    /// Takes the chunk of `length` bytes at `at`, with its number of messages.
    pub(super) fn chunk(&mut self, at: u64, length: u64, messages: usize) {
        self.chunk = Some(Chunk { at, length, messages, index: 0, indexed: 0 });
    }

    /// Takes a record of the index behind a chunk.
    pub(super) fn index(&mut self, length: u64, messages: usize) {
        if let Some(chunk) = &mut self.chunk {
            chunk.index += length;
            chunk.indexed += messages;
        }
    }

    pub(super) fn attachment(&mut self, at: u64, length: u64) {
        self.found.attachments.add((at, length));
    }

    pub(super) fn metadata(&mut self, at: u64, length: u64) {
        self.found.metadata.add((at, length));
    }

    /// Completes the present chunk, because a record of another kind follows. The error names missing messages.
    pub(super) fn close_chunk(&mut self) -> Result<(), String> {
        let Some(Chunk { at, length, messages, index, indexed }) = self.chunk.take() else { return Ok(()) };
        self.found.chunks.add((at, length, index));
        match indexed == messages {
            true => Ok(()),
            false => Err(format!("the index of the chunk at byte {at} has {indexed} of {messages} messages")),
        }
    }

    /// Takes a record of the summary, of `length` bytes at `at`. The error names what is missing or wrong.
    pub(super) fn summary(&mut self, at: u64, length: u64, opcode: u8, record: &Record) -> Result<(), String> {
        match record {
            Record::Schema { header, .. } => self.named.schemas.add(header.id),
            Record::Channel(channel) => self.named.channels.add((channel.id, channel.topic.as_str())),
            Record::Statistics(statistics) => self.statistics = Some(statistics.clone()),
            Record::ChunkIndex(it) => {
                self.named.chunks.add((it.chunk_start_offset, it.chunk_length, it.message_index_length));
            }
            Record::AttachmentIndex(it) => self.named.attachments.add((it.offset, it.length)),
            Record::MetadataIndex(it) => self.named.metadata.add((it.offset, it.length)),
            Record::SummaryOffset(it) => {
                self.close_group();
                self.summary[1].get_or_insert(at);
                self.named.groups.add((it.group_opcode, it.group_start, it.group_length));
                return Ok(());
            }
            Record::Footer(footer) => {
                self.close_group();
                return self.agrees(footer);
            }
            _ => return Err("a record of a kind that is not expected behind the messages".to_owned()),
        }
        self.summary[0].get_or_insert(at);
        match &mut self.group {
            Some((of, _, all)) if *of == opcode => *all += length,
            _ => {
                self.close_group();
                self.group = Some((opcode, at, length));
            }
        }
        Ok(())
    }

    fn close_group(&mut self) {
        if let Some(group) = self.group.take() {
            self.found.groups.add(group);
        }
    }

    /// Compares the summary with the parts. The error names the first difference.
    fn agrees(&self, footer: &Footer) -> Result<(), String> {
        let Some(statistics) = &self.statistics else {
            return Err("the summary or its counts are missing".to_owned());
        };
        let messages = self.counts.values().sum::<u64>();
        if messages != statistics.message_count {
            let there = counted_as(messages, "message is", "messages are");
            return Err(format!("{there} there, and the summary counts {}", statistics.message_count));
        }
        let mut by_channel = statistics.channel_message_counts.clone();
        by_channel.retain(|_, count| *count > 0);
        if self.counts != by_channel {
            return Err("the summary counts other messages by channel".to_owned());
        }
        if self.times.unwrap_or((0, 0)) != (statistics.message_start_time, statistics.message_end_time) {
            return Err("the summary has other times of the first and last message".to_owned());
        }
        let (found, named) = (&self.found, &self.named);
        for (part, found, named, count) in [
            ("schemas", found.schemas, named.schemas, statistics.schema_count.into()),
            ("channels", found.channels, named.channels, statistics.channel_count),
            ("chunks", found.chunks, named.chunks, statistics.chunk_count),
            ("attachments", found.attachments, named.attachments, statistics.attachment_count),
            ("metadata", found.metadata, named.metadata, statistics.metadata_count),
        ] {
            let (there, count) = (found.count, u64::from(count));
            if there != count {
                return Err(format!("{there} {part} are there, and the summary counts {count}"));
            }
            if found != named {
                return Err(format!("{there} {part} are there, and the summary names {} or other ones", named.count));
            }
        }
        let places = [footer.summary_start, footer.summary_offset_start].map(Some);
        if found.groups != named.groups || places != self.summary {
            return Err("the places of the summary are not those in its end".to_owned());
        }
        Ok(())
    }
}
