//! MCAP files: chunks that are completed on the disk twice per second.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};

use can::Instant;
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Compression, WriteOptions, Writer};

use super::schema::{PACKAGE, Schema as _};
use super::{messages, samples};

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

/// Profile of the files. MCAP leaves names that begin with `x-` to applications.
pub(super) const PROFILE: &str = "x-mrroc";

/// Key of the version of the messages in the metadata, and this version.
pub(super) const VERSION: (&str, &str) = ("messages", "2");

/// Key of the UTC of the recording's zero in the metadata.
pub(super) const UTC: &str = "utc_of_zero";

/// Profile of earlier files with the same messages, whose metadata have no version.
pub(super) const PROFILE_WITHOUT_VERSION: &str = "mrroc-2";

/// Profile of earlier files with the same messages, which do not count them.
pub(super) const PROFILE_WITHOUT_END: &str = "mrroc-1";

/// A channel of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Channel {
    pub(super) topic: String,
    /// Name of the message.
    pub(super) message: &'static str,
    /// Metadata of the channel in the file.
    pub(super) metadata: BTreeMap<String, String>,
}

/// What a recording says of itself: texts by name, and the files that the run has read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Facts {
    pub(super) texts: BTreeMap<String, String>,
    /// UTC of the zero of the recording's times, ns since 1970; `None` in lockstep, where times follow no clock.
    pub(super) utc_of_zero: Option<u64>,
    /// Files by path.
    pub(super) files: Vec<(String, Vec<u8>)>,
}

/// Date and time of day of `nanos` since 1970 in UTC, as in RFC 3339.
fn utc_text(nanos: u64) -> String {
    let (seconds, nanos) = (nanos / 1_000_000_000, nanos % 1_000_000_000);
    let (days, second) = (seconds / 86_400, seconds % 86_400);
    // Years begin in March, so that the leap day is the last day of its year. Day 0 is 1 March of year 0.
    let days = days + 719_468;
    let (era, day) = (days / 146_097, days % 146_097);
    let year = (day - day / 1_460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day = day - (153 * month + 2) / 5 + 1;
    let (year, month) = if month < 10 { (year, month + 3) } else { (year + 1, month - 9) };
    let (year, hour, minute, second) = (year + 400 * era, second / 3600, second / 60 % 60, second % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{nanos:09}Z")
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
        let mut metadata = facts.texts.clone();
        metadata.insert(VERSION.0.to_owned(), VERSION.1.to_owned());
        metadata.extend(facts.utc_of_zero.map(|nanos| (UTC.to_owned(), utc_text(nanos))));
        writer.write_metadata(&Metadata { name: METADATA.to_owned(), metadata })?;
        for (name, data) in &facts.files {
            writer.attach(&mcap::Attachment {
                log_time: 0,
                create_time: facts.utc_of_zero.unwrap_or(0),
                name: name.clone(),
                media_type: "text/plain".to_owned(),
                data: Cow::Borrowed(data),
            })?;
        }
        let (usual, of_samples) = (messages::descriptors(), samples::descriptors());
        for (index, channel) in channels.iter().enumerate() {
            let is_sample = channel.message == samples::DeviceSample::NAME;
            let descriptors = if is_sample { &of_samples } else { &usual };
            let schema = writer.add_schema(&format!("{PACKAGE}.{}", channel.message), "protobuf", descriptors)?;
            let id = writer.add_channel(schema, &channel.topic, "protobuf", &channel.metadata)?;
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

#[cfg(test)]
mod tests {
    use std::fs;

    use mcap::read::LinearReader;
    use mcap::records::Record;

    use super::*;

    #[test]
    fn a_time_is_written_as_date_and_time_of_day() {
        for (nanos, text) in [
            (0, "1970-01-01T00:00:00.000000000Z"),
            (951_782_400_000_000_000, "2000-02-29T00:00:00.000000000Z"),
            (1_795_242_630_522_011_007, "2026-11-21T06:30:30.522011007Z"),
            (4_107_542_399_999_999_999, "2100-02-28T23:59:59.999999999Z"),
            (4_107_542_400_000_000_000, "2100-03-01T00:00:00.000000000Z"),
        ] {
            assert_eq!(utc_text(nanos), text);
        }
    }

    #[test]
    fn a_recording_with_an_unknown_kind_of_device_names_kind_and_crate() {
        let texts = BTreeMap::from([("device range".to_owned(), "acme-range of the crate acme".to_owned())]);
        let refused = Facts { texts, ..Facts::default() }.check_devices().unwrap_err().to_string();
        let said = "device range is of kind acme-range of the crate acme, which this program does not know: replay by a \
                    program with it";
        assert_eq!(refused, said);
        assert!(Facts::default().check_devices().is_ok());
        assert_eq!(super::super::kind_of("range of the crate x of the crate acme"), "range of the crate x");
    }

    /// Profile, metadata, and create time of the attachment of a file without messages.
    fn written(utc_of_zero: Option<u64>) -> (String, BTreeMap<String, String>, u64) {
        let texts = BTreeMap::from([("bench".to_owned(), "card".to_owned())]);
        let facts = Facts { texts, utc_of_zero, files: vec![("cell.toml".to_owned(), b"name".to_vec())] };
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("r.mcap");
        McapFile::new(File::create(&path).unwrap(), &facts, &[]).unwrap().finish(true).unwrap();
        let (mut profile, mut metadata, mut created) = (String::new(), BTreeMap::new(), None);
        for record in LinearReader::new(&fs::read(path).unwrap()).unwrap() {
            match record.unwrap() {
                Record::Header(header) => profile = header.profile,
                Record::Metadata(found) if found.name == METADATA => metadata = found.metadata,
                Record::Attachment { header, .. } => created = Some(header.create_time),
                _ => {}
            }
        }
        (profile, metadata, created.unwrap())
    }

    #[test]
    fn a_recording_has_the_utc_of_its_zero_and_a_recording_in_lockstep_has_no_time_of_day() {
        let (profile, metadata, created) = written(Some(1_795_242_630_522_011_007));
        assert_eq!((profile.as_str(), created), ("x-mrroc", 1_795_242_630_522_011_007));
        assert_eq!(metadata["utc_of_zero"], "2026-11-21T06:30:30.522011007Z");
        assert_eq!(metadata["messages"], "2");
        let (profile, metadata, created) = written(None);
        assert_eq!((profile.as_str(), created, metadata.get("utc_of_zero")), ("x-mrroc", 0, None));
    }
}
