//! Input files of the command that are read whole: cells, data sheets, records.
//!
//! Only a regular file is opened: a FIFO has no end until its writer closes it, a device may have none. What is longer
//! than its limit is refused after so many bytes.

use std::fs::{File, Metadata};
use std::io::{self, Read};
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

use thiserror::Error;

/// Most bytes of a data sheet or a device configuration file. Those of drives have some hundred kilobytes.
pub(crate) const SHEET: usize = 4 << 20;

/// Most bytes of the record of a repair.
pub(crate) const RECORD: usize = 1 << 20;

/// Why a file cannot be read.
#[derive(Debug, Error)]
pub(crate) enum InputError {
    /// The system refuses it.
    #[error("{0}")]
    Os(#[from] io::Error),
    /// Something that has no end, or none yet.
    #[error("is {0}, must be a regular file")]
    NotRegular(&'static str),
    /// More than any such file has.
    #[error("has more than {limit} bytes, the most that such a file may have")]
    TooLong {
        /// The most.
        limit: usize,
    },
}

/// The bytes of the regular file at `path`, at most `limit`.
pub(crate) fn read(path: &Path, limit: usize) -> Result<Vec<u8>, InputError> {
    if let Some(kind) = irregular(&std::fs::metadata(path)?) {
        return Err(InputError::NotRegular(kind));
    }
    let mut bytes = Vec::new();
    let file = File::open(path)?;
    file.take(limit as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() > limit {
        return Err(InputError::TooLong { limit });
    }
    Ok(bytes)
}

/// What a file is that is no regular one.
fn irregular(metadata: &Metadata) -> Option<&'static str> {
    let kind = metadata.file_type();
    if kind.is_file() {
        None
    } else if kind.is_dir() {
        Some("a directory")
    } else if kind.is_fifo() {
        Some("a FIFO or a pipe")
    } else if kind.is_char_device() || kind.is_block_device() {
        Some("a device")
    } else {
        Some("a socket")
    }
}
