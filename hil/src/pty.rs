//! Pseudo-terminals: serial lines whose far end a host opens like a tty.
//!
//! A [`Pty`] is in raw mode from the start, so that no byte is echoed or translated before the host has configured
//! the line. The [`Pty`] stays open when the host closes its end. A [`Pty`] has no bit rate: bytes pass as fast as
//! they are read. This module is part of the rim: it makes system calls, and [`wait`] waits.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]
#![expect(unsafe_code, reason = "pseudo-terminals and waiting for several of them are system calls")]

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt, symlink};
use std::path::{Path, PathBuf};

use can::{Instant, clock};
use thiserror::Error;

/// The device's end of a pseudo-terminal. Reads and writes do not wait.
///
/// Bytes written while the host's end is closed wait for the next host that opens it. Most hosts discard them.
#[derive(Debug)]
pub struct Pty {
    master: File,
    /// While this file is open, the host may close its end without an error at the device's end.
    slave: File,
    path: PathBuf,
    link: Option<PathBuf>,
}

/// Reasons why a pseudo-terminal could not be opened, or not under the requested name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the message says it")]
pub enum PtyError {
    #[error("no pseudo-terminal can be opened (errno {0})")]
    Open(i32),
    /// The name belongs to a file that is no symbolic link. The file was left unchanged.
    #[error("the name is taken by something that is no symbolic link")]
    NameTaken,
    #[error("the name links to a terminal that is in use; end the emulator it belongs to, or remove the link")]
    InUse,
    /// The name links to a target other than a pseudo-terminal. The link was left unchanged.
    #[error("the name is a link that no emulator made; remove the link, or choose another name")]
    ForeignLink,
    #[error("the symbolic link cannot be made (errno {0})")]
    Link(i32),
}

/// Directory in which the kernel creates the host's ends.
const TERMINALS: &str = "/dev/pts/";

impl Pty {
    /// Opens a pair of ends.
    pub fn open() -> Result<Self, PtyError> {
        let open = || -> io::Result<Self> {
            let master = OpenOptions::new()
                .read(true)
                .write(true)
                .custom_flags(libc::O_NOCTTY | libc::O_NONBLOCK)
                .open("/dev/ptmx")?;
            let (number, slave) = unlock(&master)?;
            make_raw(&slave)?;
            Ok(Self { master, slave, path: PathBuf::from(format!("{TERMINALS}{number}")), link: None })
        };
        open().map_err(|error| PtyError::Open(errno(&error)))
    }

    /// Opens a pair of ends and makes `link` a symbolic link to the host's end, until this value is dropped.
    ///
    /// A running emulator holds a lock on the terminal of its link. A link without such a lock was left by an emulator
    /// that was killed, and is replaced. The link is dangling, or leads to a later terminal with the same number. Links
    /// to paths other than `/dev/pts/N` are neither followed nor replaced.
    pub fn linked(link: &Path) -> Result<Self, PtyError> {
        let left = match fs::symlink_metadata(link) {
            Ok(found) if !found.is_symlink() => return Err(PtyError::NameTaken),
            Ok(found) => Some(terminal_left(link, &found)?),
            Err(_) => None,
        };
        let mut pty = Self::open()?;
        // The lock must be held before the link shows the terminal to other emulators.
        hold(&pty.slave, mark_of(link)).map_err(|error| PtyError::Open(errno(&error)))?;
        if let Some(terminal) = left {
            remove_left(link, &terminal, &pty.path)?;
        }
        symlink(&pty.path, link).map_err(|error| match error.kind() {
            // Another emulator created the link first.
            io::ErrorKind::AlreadyExists => PtyError::InUse,
            _ => PtyError::Link(errno(&error)),
        })?;
        pty.link = Some(link.to_owned());
        Ok(pty)
    }

    /// The host's end: `/dev/pts/N`.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Fills `into` from the front with bytes written by the host. Returns 0 if there are none.
    pub fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        not_yet(self.master.read(into))
    }

    /// Number of bytes that the host can read at once.
    pub fn readable(&self) -> io::Result<usize> {
        let mut count: libc::c_int = 0;
        // SAFETY: the descriptor is open, and FIONREAD stores one int.
        checked(unsafe { libc::ioctl(self.slave.as_raw_fd(), libc::FIONREAD, &raw mut count) })?;
        Ok(count as usize)
    }

    /// Sends the front of `bytes`. Returns the number of bytes that had room: 0 while the host does not read.
    pub fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        not_yet(self.master.write(bytes))
    }
}

impl AsFd for Pty {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.master.as_fd()
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        // A link that another process redirected is left alone.
        if let Some(link) = &self.link
            && fs::read_link(link).is_ok_and(|to| to == self.path)
        {
            // An error here has no receiver.
            let _ = fs::remove_file(link);
        }
    }
}

/// Events to wait for at one end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interest {
    /// Wait until bytes can be read.
    pub read: bool,
    /// Wait until bytes can be written.
    pub write: bool,
}

/// Waits until one of `ends` is ready for its interest, or until `until`. The result states for each end whether a
/// read would return at once, also with an error or without a host. Signals do not shorten the wait.
pub fn wait<'a>(ends: impl IntoIterator<Item = (BorrowedFd<'a>, Interest)>, until: Instant) -> io::Result<Vec<bool>> {
    let waited = |(end, interest): (BorrowedFd, Interest)| {
        let read = if interest.read { libc::POLLIN } else { 0 };
        let write = if interest.write { libc::POLLOUT } else { 0 };
        libc::pollfd { fd: end.as_raw_fd(), events: read | write, revents: 0 }
    };
    let mut ends: Vec<_> = ends.into_iter().map(waited).collect();
    clock::wait(&mut ends, until).map_err(io::Error::from_raw_os_error)?;
    let readable = |end: &libc::pollfd| end.revents & !libc::POLLOUT != 0;
    Ok(ends.iter().map(readable).collect())
}

/// The number of the host's end, and the file of that end.
fn unlock(master: &File) -> io::Result<(libc::c_uint, File)> {
    let (locked, mut number): (libc::c_int, libc::c_uint) = (0, 0);
    let fd = master.as_raw_fd();
    // SAFETY: the request reads one int.
    checked(unsafe { libc::ioctl(fd, libc::TIOCSPTLCK, &raw const locked) })?;
    // SAFETY: the request writes one unsigned int.
    checked(unsafe { libc::ioctl(fd, libc::TIOCGPTN, &raw mut number) })?;
    let flags = libc::O_RDWR | libc::O_NOCTTY | libc::O_CLOEXEC;
    // SAFETY: the request takes flags by value.
    let slave = checked(unsafe { libc::ioctl(fd, libc::TIOCGPTPEER, flags) })?;
    // SAFETY: the request returned a descriptor that has no other owner.
    Ok((number, unsafe { File::from_raw_fd(slave) }))
}

fn make_raw(slave: &File) -> io::Result<()> {
    let fd = slave.as_raw_fd();
    // SAFETY: plain integers, for all of which zero is a value.
    let mut settings: libc::termios = unsafe { std::mem::zeroed() };
    // SAFETY: a valid termios to be filled.
    checked(unsafe { libc::tcgetattr(fd, &raw mut settings) })?;
    // SAFETY: a valid termios to be changed.
    unsafe { libc::cfmakeraw(&raw mut settings) };
    // SAFETY: a valid termios to be read.
    checked(unsafe { libc::tcsetattr(fd, libc::TCSANOW, &raw const settings) }).map(drop)
}

/// Marks the terminal as used by an emulator under this mark while `slave` is open. The `flock` of hosts is another lock.
fn hold(slave: &File, mark: i64) -> io::Result<()> {
    let lock = write_lock(mark);
    // SAFETY: a valid lock to be read.
    checked(unsafe { libc::fcntl(slave.as_raw_fd(), libc::F_OFD_SETLK, &raw const lock) }).map(drop)
}

/// The target of `link`, if no running emulator uses that terminal. `found` is the metadata of the link itself.
fn terminal_left(link: &Path, found: &Metadata) -> Result<PathBuf, PtyError> {
    let terminal = fs::read_link(link).map_err(|error| PtyError::Link(errno(&error)))?;
    let number = terminal.to_str().and_then(|path| path.strip_prefix(TERMINALS));
    if number.and_then(|number| number.parse::<u32>().ok()).is_none() {
        return Err(PtyError::ForeignLink);
    }
    if is_in_use(&terminal, mark_of(link), found.uid()) {
        return Err(PtyError::InUse);
    }
    Ok(terminal)
}

/// The mark of a link: the same for all emulators that make this link, and another one for another link (FNV-1a, 62 bits).
fn mark_of(link: &Path) -> i64 {
    let parent = link.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // Without a directory no link can be made, and any mark will do.
    let directory = fs::metadata(parent).map_or((0, 0), |found| (found.dev(), found.ino()));
    let name = link.file_name().unwrap_or_default().as_bytes();
    let numbers = [directory.0, directory.1].map(u64::to_le_bytes);
    let hash = numbers
        .as_flattened()
        .iter()
        .chain(name)
        .fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x100_0000_01b3));
    (hash >> 2) as i64
}

/// Whether a running emulator uses a terminal under this mark. `owner` is the user who made the link to the terminal.
fn is_in_use(terminal: &Path, mark: i64, owner: u32) -> bool {
    let opened =
        OpenOptions::new().read(true).custom_flags(libc::O_NOCTTY | libc::O_NONBLOCK | libc::O_NOFOLLOW).open(terminal);
    match opened {
        Ok(opened) => !is_pseudo_terminal(&opened) || is_held(&opened, mark),
        // The other end is closed.
        Err(error) if [Some(libc::ENOENT), Some(libc::EIO)].contains(&error.raw_os_error()) => false,
        // An emulator's terminal belongs to the user who made the link. A terminal of another user is not an
        // emulator's.
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied => {
            fs::symlink_metadata(terminal).is_ok_and(|found| found.uid() == owner)
        }
        Err(_) => true,
    }
}

/// Major numbers 136 to 143 (Linux, `devices.txt`).
fn is_pseudo_terminal(file: &File) -> bool {
    file.metadata()
        .is_ok_and(|found| found.file_type().is_char_device() && (136..=143).contains(&libc::major(found.rdev())))
}

/// Removes a link left by a killed emulator, unless another emulator has replaced the link in the meantime.
///
/// The link is first renamed. Only one of two emulators can rename the link. The renamed link is then examined again.
///
/// The terminal `own` of this emulator may have the number of the terminal that was left. The lock on it is then our own.
fn remove_left(link: &Path, terminal: &Path, own: &Path) -> Result<(), PtyError> {
    let mut aside = link.as_os_str().to_owned();
    aside.push(format!(".left-{}", std::process::id()));
    let aside = PathBuf::from(aside);
    let failed = |error: io::Error| PtyError::Link(errno(&error));
    match fs::rename(link, &aside) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        moved => moved.map_err(failed)?,
    }
    let owner = fs::symlink_metadata(&aside).map_err(failed)?.uid();
    let moved = fs::read_link(&aside).map_err(failed)?;
    let in_use = moved != terminal || (terminal != own && is_in_use(terminal, mark_of(link), owner));
    if in_use {
        symlink(moved, link).map_err(failed)?;
    }
    fs::remove_file(&aside).map_err(failed)?;
    if in_use { Err(PtyError::InUse) } else { Ok(()) }
}

/// Whether an emulator has locked a terminal under this mark.
fn is_held(terminal: &File, mark: i64) -> bool {
    let mut lock = write_lock(mark);
    // SAFETY: a valid lock to be changed.
    let asked = unsafe { libc::fcntl(terminal.as_raw_fd(), libc::F_OFD_GETLK, &raw mut lock) };
    asked < 0 || libc::c_int::from(lock.l_type) != libc::F_UNLCK
}

/// A write lock of one byte, whose offset is the mark.
fn write_lock(mark: i64) -> libc::flock {
    // SAFETY: plain integers, for all of which zero is a value.
    let mut lock: libc::flock = unsafe { std::mem::zeroed() };
    lock.l_type = libc::F_WRLCK as libc::c_short;
    (lock.l_start, lock.l_len) = (mark, 1);
    lock
}

fn checked(result: libc::c_int) -> io::Result<libc::c_int> {
    if result < 0 {
        return Err(io::Error::last_os_error());
    }
    Ok(result)
}

fn not_yet(result: io::Result<usize>) -> io::Result<usize> {
    match result {
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(0),
        result => result,
    }
}

fn errno(error: &io::Error) -> i32 {
    error.raw_os_error().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    const READ: Interest = Interest { read: true, write: false };
    const WRITE: Interest = Interest { read: false, write: true };

    fn host(path: &Path) -> File {
        OpenOptions::new().read(true).write(true).custom_flags(libc::O_NOCTTY | libc::O_NONBLOCK).open(path).unwrap()
    }

    /// Reads `count` bytes within a second.
    fn read(fd: &impl AsFd, count: usize, mut read: impl FnMut(&mut [u8]) -> usize) -> Vec<u8> {
        let end = clock::now() + Duration::from_secs(1);
        let mut got = Vec::new();
        while got.len() < count && clock::now() < end {
            let mut buffer = [0; 512];
            let count = read(&mut buffer);
            got.extend(&buffer[..count]);
            if count == 0 {
                wait([(fd.as_fd(), READ)], end).unwrap();
            }
        }
        got
    }

    #[test]
    fn every_byte_passes_unchanged_both_ways_and_nothing_is_echoed() {
        let mut pty = Pty::open().unwrap();
        let mut host = host(pty.path());
        let all: Vec<u8> = (0..=255).collect();
        host.write_all(&all).unwrap();
        let mut end = pty.master.try_clone().unwrap();
        let heard = read(&pty.as_fd(), 256, |buffer| not_yet(end.read(buffer)).unwrap());
        assert_eq!(heard, all);
        assert_eq!(pty.write(&all).unwrap(), 256);
        let mut end = host.try_clone().unwrap();
        let heard = read(&host, 256, |buffer| not_yet(end.read(buffer)).unwrap());
        assert_eq!(heard, all);
        // The host receives the bytes written, and no echo.
        assert_eq!(not_yet(host.read(&mut [0; 8])).unwrap(), 0);
        assert_eq!(pty.read(&mut [0; 8]).unwrap(), 0);
    }

    #[test]
    fn a_host_may_close_its_end_and_come_back() {
        let mut pty = Pty::open().unwrap();
        for _ in 0..2 {
            let mut host = host(pty.path());
            host.write_all(b"C\r").unwrap();
            drop(host);
            let mut end = pty.master.try_clone().unwrap();
            let heard = read(&pty, 2, |buffer| not_yet(end.read(buffer)).unwrap());
            assert_eq!(heard, b"C\r");
            assert_eq!(pty.read(&mut [0; 8]).unwrap(), 0);
        }
    }

    #[test]
    fn a_host_that_does_not_read_fills_the_line() {
        let mut pty = Pty::open().unwrap();
        let mut written = 0;
        loop {
            match pty.write(&[b'x'; 4096]).unwrap() {
                0 => break,
                count => written += count,
            }
            assert!(written < 1 << 20, "a line holds a bounded number of bytes");
        }
        assert!(written >= 1024);
    }

    #[test]
    fn waiting_ends_with_a_byte_or_at_its_time() {
        let pty = [Pty::open().unwrap(), Pty::open().unwrap()];
        let ends = || pty.iter().map(|pty| (pty.as_fd(), READ));
        let start = clock::now();
        let readable = wait(ends(), start + Duration::from_millis(20)).unwrap();
        assert_eq!(readable, [false, false]);
        assert!(clock::now() >= start + Duration::from_millis(20));
        host(pty[1].path()).write_all(b"\r").unwrap();
        let readable = wait(ends(), start + Duration::from_secs(60)).unwrap();
        assert_eq!(readable, [false, true]);
        assert!(clock::now() < start + Duration::from_secs(30));
        // Readable bytes do not wake an end without interest in reading.
        let nothing = Interest { read: false, ..READ };
        let later = clock::now() + Duration::from_millis(20);
        wait([(pty[1].as_fd(), nothing)], later).unwrap();
        assert!(clock::now() >= later);
        // There is room to write from the start.
        let ends = [(pty[0].as_fd(), WRITE)];
        let readable = wait(ends, start + Duration::from_secs(60)).unwrap();
        assert_eq!(readable, [false]);
        assert!(clock::now() < start + Duration::from_secs(30));
    }

    #[test]
    fn a_link_lives_as_long_as_its_line() {
        let directory = tempfile::tempdir().unwrap();
        let link = directory.path().join("can0");
        symlink("/dev/pts/4294967295", &link).unwrap();
        let pty = Pty::linked(&link).unwrap();
        assert_eq!(fs::read_link(&link).unwrap(), pty.path());
        drop(pty);
        assert!(fs::symlink_metadata(&link).is_err());
    }

    #[test]
    fn a_link_that_another_took_over_is_left_to_it() {
        let directory = tempfile::tempdir().unwrap();
        let link = directory.path().join("can0");
        let first = Pty::linked(&link).unwrap();
        assert_eq!(Pty::linked(&link).unwrap_err(), PtyError::InUse);
        assert_eq!(fs::read_link(&link).unwrap(), first.path());
        fs::remove_file(&link).unwrap();
        let second = Pty::linked(&link).unwrap();
        drop(first);
        assert_eq!(fs::read_link(&link).unwrap(), second.path());
    }

    /// A killed emulator leaves its link. The kernel then gives the number of its terminal to another terminal.
    #[test]
    fn a_link_to_a_terminal_that_no_emulator_holds_is_replaced() {
        let directory = tempfile::tempdir().unwrap();
        let link = directory.path().join("can0");
        let terminal = Pty::open().unwrap();
        symlink(terminal.path(), &link).unwrap();
        let pty = Pty::linked(&link).unwrap();
        assert_eq!(fs::read_link(&link).unwrap(), pty.path());
        // Neither a host that has the terminal open nor the `flock` that hosts take counts as use by an emulator.
        let host = host(pty.path());
        // SAFETY: the descriptor is open, and the call takes plain integers.
        assert_eq!(unsafe { libc::flock(host.as_raw_fd(), libc::LOCK_EX) }, 0);
        let roundabout = directory.path().join("../").join(directory.path().file_name().unwrap()).join("can0");
        for same in [&link, &roundabout] {
            assert_eq!(Pty::linked(same).unwrap_err(), PtyError::InUse);
        }
        drop(pty);
        assert!(Pty::linked(&link).is_ok());
    }

    /// Another emulator, with a link of its own, may hold the terminal that got the number.
    #[test]
    fn a_link_to_a_terminal_of_another_emulator_is_replaced_and_the_other_link_stays() {
        let directory = tempfile::tempdir().unwrap();
        let other = Pty::linked(&directory.path().join("can1")).unwrap();
        let link = directory.path().join("can0");
        symlink(other.path(), &link).unwrap();
        let pty = Pty::linked(&link).unwrap();
        assert_eq!(fs::read_link(&link).unwrap(), pty.path());
        assert_eq!(fs::read_link(directory.path().join("can1")).unwrap(), other.path());
        assert_eq!(Pty::linked(&directory.path().join("can1")).unwrap_err(), PtyError::InUse);
    }

    #[test]
    fn a_link_to_anything_but_a_pseudo_terminal_is_left_alone() {
        let directory = tempfile::tempdir().unwrap();
        let link = directory.path().join("can0");
        let fifo = directory.path().join("fifo");
        let made = std::process::Command::new("mkfifo").arg(&fifo).status();
        assert!(made.unwrap().success());
        let planted = directory.path().join("planted");
        let terminal = Pty::open().unwrap();
        symlink(terminal.path(), &planted).unwrap();
        let targets = ["/dev/null", "/tmp", "/dev/ttyUSB99", "/dev/pts/ptmx", "/dev/pts/../null"];
        let targets = targets.map(Path::new);
        for target in targets.into_iter().chain([&*fifo, &*planted]) {
            symlink(target, &link).unwrap();
            assert_eq!(Pty::linked(&link).unwrap_err(), PtyError::ForeignLink);
            assert_eq!(fs::read_link(&link).unwrap(), target);
            fs::remove_file(&link).unwrap();
        }
    }

    /// Between the examination and the removal, another emulator may replace the link. Even the number of the
    /// abandoned terminal may be used again.
    #[test]
    fn a_link_that_another_emulator_replaces_meanwhile_is_left_to_it() {
        let directory = tempfile::tempdir().unwrap();
        let link = directory.path().join("can0");
        let faster = Pty::linked(&link).unwrap();
        for left in [Path::new("/dev/pts/4294967295"), faster.path()] {
            assert_eq!(remove_left(&link, left, Path::new("/dev/pts/none")), Err(PtyError::InUse));
            assert_eq!(fs::read_link(&link).unwrap(), faster.path());
            assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1);
        }
    }

    #[test]
    fn what_is_no_link_is_not_replaced() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("can0");
        fs::write(&file, "precious").unwrap();
        assert_eq!(Pty::linked(&file).unwrap_err(), PtyError::NameTaken);
        assert_eq!(Pty::linked(directory.path()).unwrap_err(), PtyError::NameTaken);
        assert_eq!(fs::read_to_string(&file).unwrap(), "precious");
        let nowhere = directory.path().join("missing/can0");
        assert_eq!(Pty::linked(&nowhere).unwrap_err(), PtyError::Link(libc::ENOENT));
    }

    #[test]
    fn a_link_that_was_left_is_removed_also_if_its_terminal_is_our_new_one() {
        let directory = tempfile::tempdir().unwrap();
        let link = directory.path().join("axis");
        // A killed emulator left the link, and the new terminal has the number of the old one.
        let own = Pty::open().unwrap();
        hold(&own.slave, mark_of(&link)).unwrap();
        symlink(&own.path, &link).unwrap();
        // For an emulator with another terminal, the terminal is in use.
        let other = Pty::open().unwrap();
        assert_eq!(remove_left(&link, &own.path, &other.path), Err(PtyError::InUse));
        assert_eq!(fs::read_link(&link).unwrap(), own.path);
        assert_eq!(remove_left(&link, &own.path, &own.path), Ok(()));
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 0);
    }
}
