//! Input files of a command that are read as a whole: cells, data sheets, records.
//!
//! Only a regular file is opened. A FIFO ends only when its writer closes it, and a device may never end. A file
//! longer than its limit is refused after the limit was read.

use std::ffi::c_int;
use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::Path;

use thiserror::Error;

/// Greatest size of a data sheet or a device configuration file, bytes. Files of real drives have some hundred
/// kilobytes.
pub const SHEET: usize = 4 << 20;

/// Greatest size of the record of a repair, bytes.
pub const RECORD: usize = 1 << 20;

/// Device and inode, which identify a file regardless of its path.
pub(crate) type Identity = (u64, u64);

pub(crate) fn identity(found: &Metadata) -> Identity {
    (found.dev(), found.ino())
}

/// Why a file cannot be read.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum InputError {
    /// The system reports an error.
    #[error(transparent)]
    Os(#[from] io::Error),
    /// The file is not a regular file, and may have no end.
    #[error("is {0}, must be a regular file")]
    NotRegular(&'static str),
    /// The path is a link, and the owner of the link decides which file is read.
    #[error("is a symbolic link, must be a regular file")]
    Link,
    /// The file belongs to another user, who may have written it.
    #[error("belongs to user {owner}, must belong to user {user}, who runs this command")]
    Foreign { owner: u32, user: u32 },
    /// Other users may write to the file.
    #[error("can be written by others than its owner; check its contents, then `chmod go-w` it")]
    Writable,
    /// The file is too long.
    #[error("has more than {limit} bytes, the most that such a file may have")]
    TooLong { limit: usize },
}

/// The bytes of the regular file at `path`, at most `limit`.
pub fn read(path: &Path, limit: usize) -> Result<Vec<u8>, InputError> {
    contents(open_regular(path)?, limit)
}

/// As [`read`], with the file that was read.
pub(crate) fn read_identified(path: &Path, limit: usize) -> Result<(Vec<u8>, File), InputError> {
    let file = open_regular(path)?;
    Ok((contents(file.try_clone()?, limit)?, file))
}

/// The regular file at `path`, for a reader that keeps a part of the file at a time.
pub fn open_regular(path: &Path) -> Result<File, InputError> {
    let file = open(path, 0)?;
    match irregular(&file.metadata()?) {
        Some(kind) => Err(InputError::NotRegular(kind)),
        None => Ok(file),
    }
}

/// Opens a file for examination. The file that is examined is the one that is read, whatever the path leads to by then.
/// Neither opening nor reading it waits for another program.
fn open(path: &Path, flags: c_int) -> io::Result<File> {
    OpenOptions::new().read(true).custom_flags(flags | libc::O_NONBLOCK | libc::O_NOCTTY).open(path)
}

/// The bytes of the regular file at `path`, at most `limit`, which nobody but the user of this process can have written.
pub fn read_own(path: &Path, limit: usize) -> Result<Vec<u8>, InputError> {
    let file = open(path, libc::O_NOFOLLOW).map_err(|error| match error.raw_os_error() {
        Some(libc::ELOOP) => InputError::Link,
        _ => error.into(),
    })?;
    check_owner(&file.metadata()?, nix::unistd::geteuid().as_raw())?;
    contents(file, limit)
}

/// Refuses a file that is not regular, and a file that users other than `user` may have written.
fn check_owner(metadata: &Metadata, user: u32) -> Result<(), InputError> {
    let owner = metadata.uid();
    if let Some(kind) = irregular(metadata) {
        Err(InputError::NotRegular(kind))
    } else if owner != user {
        Err(InputError::Foreign { owner, user })
    } else if metadata.mode() & 0o022 != 0 {
        Err(InputError::Writable)
    } else {
        Ok(())
    }
}

fn contents(file: File, limit: usize) -> Result<Vec<u8>, InputError> {
    let mut bytes = Vec::new();
    file.take(limit as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() > limit {
        return Err(InputError::TooLong { limit });
    }
    Ok(bytes)
}

/// The kind of a file that is not regular.
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

#[cfg(test)]
mod tests {
    use std::fs::{self, Permissions};
    use std::os::unix::fs::{PermissionsExt, symlink};
    use std::process::Command;
    use std::sync::mpsc;
    use std::thread;
    use std::time::Duration;

    use super::*;

    #[test]
    fn only_a_regular_file_of_bounded_length_is_read() {
        let directory = tempfile::tempdir().unwrap();
        let path = |name: &str| directory.path().join(name);
        fs::write(path("file"), "text").unwrap();
        assert_eq!(read_own(&path("file"), 4).unwrap(), b"text");
        fs::create_dir(path("directory")).unwrap();
        symlink("file", path("link")).unwrap();
        symlink("nothing", path("dangling")).unwrap();
        let fifo = Command::new("mkfifo").arg(path("fifo")).status();
        assert!(fifo.unwrap().success());
        for (name, why) in [
            ("link", "is a symbolic link"),
            ("dangling", "is a symbolic link"),
            ("fifo", "is a FIFO or a pipe, must be a regular file"),
            ("directory", "is a directory, must be a regular file"),
            ("file", "has more than 3 bytes"),
        ] {
            let refused = read_own(&path(name), 3).unwrap_err().to_string();
            assert!(refused.starts_with(why), "{name}: {refused}");
        }
        for device in ["/dev/zero", "/dev/tty"] {
            assert!(read_own(Path::new(device), 3).is_err(), "{device}");
        }
    }

    /// `stat` calls /proc/kmsg a regular file of no bytes; its reader waits for the kernel's next message.
    #[test]
    fn a_file_whose_reader_would_wait_is_not_waited_for() {
        let (done, ended) = mpsc::channel();
        thread::spawn(move || done.send(read(Path::new("/proc/kmsg"), 1 << 30).is_ok()));
        // Empty, refused to this user, or read by another process: no end of the file is told.
        let ended = ended.recv_timeout(Duration::from_secs(60));
        assert_eq!(ended, Ok(false), "/proc/kmsg was waited for");
    }

    #[test]
    fn a_fifo_is_refused_whenever_it_takes_the_place_of_a_file() {
        let directory = tempfile::tempdir().unwrap();
        let path = |name: &str| directory.path().join(name);
        fs::write(path("file"), "text").unwrap();
        assert_eq!(read(&path("file"), 4).unwrap(), b"text");
        symlink("file", path("link")).unwrap();
        assert_eq!(read(&path("link"), 4).unwrap(), b"text");
        let fifo = Command::new("mkfifo").arg(path("fifo")).status();
        assert!(fifo.unwrap().success());
        let refused = read(&path("fifo"), 4).unwrap_err().to_string();
        assert!(refused.starts_with("is a FIFO"), "{refused}");
    }

    #[test]
    fn only_a_file_that_this_user_alone_can_have_written_is_read() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("file");
        fs::write(&path, "text").unwrap();
        let metadata = fs::metadata(&path).unwrap();
        let owner = metadata.uid();
        let foreign = check_owner(&metadata, owner + 1).unwrap_err().to_string();
        assert!(foreign.contains(&format!("belongs to user {owner}")), "{foreign}");
        for mode in [0o600, 0o644, 0o620, 0o602, 0o666] {
            fs::set_permissions(&path, Permissions::from_mode(mode)).unwrap();
            let read = read_own(&path, 4);
            assert_eq!(read.is_ok(), mode & 0o022 == 0, "{mode:o}: {read:?}");
        }
    }
}
