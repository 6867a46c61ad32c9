//! Text files of a run with one row per line. A file that cannot be written ends with its last whole row, and the run
//! goes on.

use std::fmt;
use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use can::Instant;
use serde::Serialize;

use crate::{outputs, streams};

/// Bytes that are kept before they are written.
const BUFFER: usize = 1 << 16;

/// A file of a run that lacks entries.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IncompleteFile {
    /// The option that asked for the file.
    pub option: &'static str,
    /// The file.
    pub path: PathBuf,
    /// Number of the entries that it lacks.
    pub lost: u64,
    /// What the entries are: rows, frames, events or messages.
    pub entries: &'static str,
    /// Time of the first lost entry, s, in the time that the file has; null if the time is not known.
    pub first_loss_s: Option<f64>,
    /// Why they are lost.
    pub error: String,
    /// What to do next.
    pub check: &'static str,
}

impl fmt::Display for IncompleteFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { option, path, lost, entries, error, check, .. } = self;
        write!(f, "{option}: {}: lacks {lost} {entries}", path.display())?;
        if let Some(first) = self.first_loss_s {
            write!(f, ", the first at {first:.3} s")?;
        }
        write!(f, ": {error}: {check}")
    }
}

/// Name of a file of a run: its option, its path, and what its entries are called.
#[derive(Clone, Debug)]
pub(crate) struct FileName {
    pub(crate) option: &'static str,
    pub(crate) path: PathBuf,
    pub(crate) entries: &'static str,
}

impl FileName {
    pub(crate) fn new(option: &'static str, path: &Path, entries: &'static str) -> Self {
        Self { option, path: path.to_owned(), entries }
    }

    /// Warns that the file ends here, and begins its report.
    pub(crate) fn ends(&self, error: &io::Error, first: Option<Instant>) -> IncompleteFile {
        let incomplete = IncompleteFile { first_loss_s: first.map(seconds), ..self.fails(error) };
        streams::warn(format_args!(
            "mrroc: {}: {}: {}: the file ends here, and the run goes on: {}",
            self.option,
            self.path.display(),
            incomplete.error,
            incomplete.check
        ));
        incomplete
    }

    /// The report of a file that cannot be written.
    pub(crate) fn fails(&self, error: &io::Error) -> IncompleteFile {
        self.incomplete(error, remedy(error.kind()))
    }

    /// The report of a file that lacks `lost` entries, because the file was too slow.
    pub(crate) fn too_slow(&self, lost: u64) -> IncompleteFile {
        let check = "name a file on a faster disk";
        IncompleteFile { lost, ..self.incomplete(&"the file was too slow", check) }
    }

    fn incomplete(&self, error: &dyn fmt::Display, check: &'static str) -> IncompleteFile {
        IncompleteFile {
            option: self.option,
            path: self.path.clone(),
            lost: 0,
            entries: self.entries,
            first_loss_s: None,
            error: error.to_string(),
            check,
        }
    }
}

fn seconds(time: Instant) -> f64 {
    time.since(Instant::ZERO).as_secs_f64()
}

/// What to do next.
fn remedy(kind: io::ErrorKind) -> &'static str {
    match kind {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge => {
            "free space on the disk, or name a file on another disk, and repeat the run"
        }
        io::ErrorKind::BrokenPipe => {
            "the program that reads the file has ended: let it read to the end, and repeat the run"
        }
        _ => "check the disk of the file, and repeat the run",
    }
}

/// A text file under way.
pub(crate) struct RowFile {
    name: FileName,
    file: File,
    buffer: Vec<u8>,
    /// Times of the rows in the buffer.
    times: Vec<Instant>,
    incomplete: Option<IncompleteFile>,
}

impl RowFile {
    /// A file that begins with `head`, which is written at once.
    pub(crate) fn new(name: FileName, mut file: File, head: &str) -> io::Result<Self> {
        if let Err(error) = file.write_all(head.as_bytes()) {
            outputs::remove(&name.path, &file);
            return Err(error);
        }
        Ok(Self { name, file, buffer: Vec::with_capacity(BUFFER), times: Vec::new(), incomplete: None })
    }

    /// Adds the row of `time`. `write` writes its text without the end of the line.
    pub(crate) fn row(&mut self, time: Instant, write: impl FnOnce(&mut Vec<u8>) -> io::Result<()>) {
        if let Some(incomplete) = &mut self.incomplete {
            incomplete.lost += 1;
            return;
        }
        // A vector grows as needed, so writing to it cannot fail.
        let _ = write(&mut self.buffer);
        self.buffer.push(b'\n');
        self.times.push(time);
        if self.buffer.len() >= BUFFER {
            self.flush();
        }
    }

    /// Writes the rows so far. The first failure ends the file, with a warning.
    pub(crate) fn flush(&mut self) {
        let mut done = 0;
        while self.incomplete.is_none() && done < self.buffer.len() {
            match self.file.write(&self.buffer[done..]) {
                Ok(0) => self.end(&io::Error::from(io::ErrorKind::WriteZero), done),
                Ok(count) => done += count,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => self.end(&error, done),
            }
        }
        self.buffer.clear();
        self.times.clear();
    }

    /// Ends the file after `done` bytes of the buffer.
    fn end(&mut self, error: &io::Error, done: usize) {
        let written = &self.buffer[..done];
        let rows = written.iter().filter(|&&byte| byte == b'\n').count();
        let part = written.iter().rev().take_while(|&&byte| byte != b'\n').count();
        // A pipe or a device keeps the part of a row.
        if let Ok(end) = self.file.seek(SeekFrom::Current(-(part as i64))) {
            let _ = self.file.set_len(end);
        }
        let lost = (self.times.len() - rows) as u64;
        self.incomplete = Some(IncompleteFile { lost, ..self.name.ends(error, self.times.get(rows).copied()) });
    }

    /// Writes the rest. `dropped`: further rows that found no room before they came here. Returns the report of the file if
    /// the file is incomplete.
    pub(crate) fn finish(mut self, dropped: u64) -> Option<IncompleteFile> {
        self.flush();
        match self.incomplete {
            Some(incomplete) => Some(IncompleteFile { lost: incomplete.lost + dropped, ..incomplete }),
            None => (dropped > 0).then(|| self.name.too_slow(dropped)),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::fd::OwnedFd;
    use std::os::unix::net::UnixStream;

    use super::*;

    #[test]
    fn a_file_that_fails_ends_with_its_last_whole_row_and_counts_the_others() {
        let (end, mut reader) = UnixStream::pair().unwrap();
        let file = File::from(OwnedFd::from(end));
        let name = FileName::new("--it", Path::new("/there/it.csv"), "rows");
        let mut rows = RowFile::new(name, file, "head\n").unwrap();
        let row = |rows: &mut RowFile, second: u64| {
            rows.row(Instant::from_nanos(second * 1_000_000_000), |text| write!(text, "{second}"));
        };
        (0..3).for_each(|second| row(&mut rows, second));
        rows.flush();
        let mut read = [0; 11];
        io::Read::read_exact(&mut reader, &mut read).unwrap();
        assert_eq!(&read, b"head\n0\n1\n2\n");
        drop(reader);
        (3..7).for_each(|second| row(&mut rows, second));
        rows.flush();
        (7..9).for_each(|second| row(&mut rows, second));
        let report = rows.finish(1).unwrap().to_string();
        assert!(report.starts_with("--it: /there/it.csv: lacks 7 rows, the first at 3.000 s: Broken pipe"), "{report}");
        assert!(report.ends_with("repeat the run"), "{report}");
    }

    #[test]
    fn a_file_that_lost_nothing_is_not_reported() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("it.csv");
        let name = FileName::new("--it", &path, "rows");
        let mut rows = RowFile::new(name.clone(), File::create(&path).unwrap(), "head\n").unwrap();
        rows.row(Instant::ZERO, |text| write!(text, "1"));
        assert_eq!(rows.finish(0), None);
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "head\n1\n");
        let slow = RowFile::new(name, File::create(&path).unwrap(), "").unwrap().finish(5).unwrap();
        assert_eq!((slow.lost, slow.first_loss_s), (5, None));
    }
}
