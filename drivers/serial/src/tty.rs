//! A line on a tty: of a serial card, of a USB adapter, or of a pseudo-terminal.
//!
//! Each call makes one `read(2)` or `write(2)` and does not wait. No memory is allocated after opening. `tokio-serial`
//! opens and configures the device, without a reactor. Afterwards only the file descriptor is used. This file makes
//! system calls. Read [`Tty::open`] first.

#![expect(unsafe_code, reason = "system calls that no safe wrapper offers without a second one before them")]

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::mem;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, IntoRawFd};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;

use can::Instant;
use thiserror::Error;
use tokio_serial::{DataBits, FlowControl, Parity, SerialPort};

use crate::{Line, LineCounters, LineError, Settings};

/// Reason why a tty could not be opened, and the remedy.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum OpenError {
    #[error(
        "{0}: no such device: plug the adapter in and load its driver; `ls /dev/serial/by-id` lists those there are"
    )]
    Absent(Box<Path>),
    #[error(
        "{0}: permission denied: join the group that owns it, `sudo usermod -aG dialout $USER` on Debian, and log in again"
    )]
    Denied(Box<Path>),
    #[error("{0}: in use by another process: `fuser -v {0}` says which")]
    Busy(Box<Path>),
    #[error("{0}: not a tty")]
    NotATty(Box<Path>),
    #[error("{path}: cannot do {asked} baud, the nearest is {nearest}")]
    Baud { path: Box<Path>, asked: u32, nearest: u32 },
    #[error("{path}: errno {errno}")]
    Os { path: Box<Path>, errno: i32 },
}

/// A tty in raw mode, for exclusive use.
///
/// Two mechanisms exclude other processes. The first is a lock (`flock`), taken before the settings are changed. The
/// second is the exclusive flag of the kernel. It also refuses programs that ignore locks, unless they run as root. A
/// pseudo-terminal has the lock only. Its exclusive flag lasts until the last process closes the terminal, for example
/// an emulator. The flag would therefore outlive a host that is killed, whereas the lock ends with the host.
pub struct Tty {
    device: File,
    gone: bool,
    counters: LineCounters,
}

impl Tty {
    /// Opens the tty at `path`. A link in `/dev/serial/by-id` keeps its name when other adapters are plugged in. Bytes
    /// from before the opening are discarded.
    pub fn open(path: impl AsRef<Path>, settings: Settings) -> Result<Self, OpenError> {
        let path = path.as_ref();
        let port = tokio_serial::new(path.to_string_lossy(), settings.baud)
            .data_bits(DataBits::Eight)
            .parity(Parity::None)
            .stop_bits(settings.stop_bits)
            .flow_control(FlowControl::None)
            .open_native()
            .map_err(|error| why_not_opened(path, &error))?;
        let os = |error: &io::Error| OpenError::Os { path: path.into(), errno: errno(error) };
        let nearest = port.baud_rate().map_err(|error| os(&error.into()))?;
        // A receiver that samples in the middle of a bit tolerates a deviation of 4 % over ten bits.
        if nearest.abs_diff(settings.baud) > settings.baud / 25 {
            let (path, asked) = (path.into(), settings.baud);
            return Err(OpenError::Baud { path, asked, nearest });
        }
        // SAFETY: the port released the descriptor, which has no other owner.
        let device = unsafe { File::from_raw_fd(port.into_raw_fd()) };
        let fd = device.as_raw_fd();
        if is_pseudo_terminal(&device) {
            // SAFETY: the descriptor is open, and the call takes nothing.
            unsafe { libc::ioctl(fd, libc::TIOCNXCL) };
        }
        ask_for_low_latency(fd);
        // SAFETY: the descriptor is open, and both calls take plain integers.
        let set =
            unsafe { libc::fcntl(fd, libc::F_SETFL, libc::O_NONBLOCK) >= 0 && libc::tcflush(fd, libc::TCIOFLUSH) >= 0 };
        if !set {
            return Err(os(&io::Error::last_os_error()));
        }
        Ok(Self { device, gone: false, counters: LineCounters::default() })
    }

    fn moved(&mut self, result: io::Result<usize>) -> Result<usize, LineError> {
        result.or_else(|error| match errno(&error) {
            libc::EAGAIN | libc::EINTR => Ok(0),
            libc::EIO | libc::ENXIO | libc::ENODEV | libc::EBADF => {
                self.gone = true;
                Err(LineError::Gone)
            }
            other => Err(LineError::Os(other)),
        })
    }
}

impl Line for Tty {
    /// `now` is ignored, because the kernel sends at once.
    fn write(&mut self, _now: Instant, bytes: &[u8]) -> Result<usize, LineError> {
        let result = if self.gone {
            Err(LineError::Gone)
        } else {
            let written = self.device.write(bytes);
            self.moved(written)
        };
        let taken = result.unwrap_or(0);
        self.counters.sent += taken as u64;
        self.counters.refused += (bytes.len() - taken) as u64;
        result
    }

    /// `now` is ignored. Bytes that arrived after `now` are returned as well.
    fn read(&mut self, _now: Instant, into: &mut [u8]) -> Result<usize, LineError> {
        if self.gone {
            return Err(LineError::Gone);
        }
        if into.is_empty() {
            return Ok(0);
        }
        let read = self.device.read(into);
        // A raw tty without received bytes returns EAGAIN (VMIN is 1). Zero bytes mean a hang-up.
        if matches!(read, Ok(0)) {
            self.gone = true;
            return Err(LineError::Gone);
        }
        let count = self.moved(read)?;
        self.counters.received += count as u64;
        Ok(count)
    }

    /// Bytes in the buffer of an adapter cannot be discarded.
    fn discard_unsent(&mut self) {
        // SAFETY: the descriptor is open and ours. A device that is gone says so at the next write.
        unsafe { libc::tcflush(self.device.as_raw_fd(), libc::TCOFLUSH) };
    }

    /// A driver does not report bytes that it lost. [`LineCounters::dropped`] therefore stays zero.
    fn counters(&self) -> LineCounters {
        self.counters
    }
}

/// For loops that wait for several descriptors.
impl AsFd for Tty {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.device.as_fd()
    }
}

/// A tty stays exclusive as long as any process has it open, so the flag is cleared here.
impl Drop for Tty {
    fn drop(&mut self) {
        // SAFETY: the descriptor is open, and the call takes nothing.
        unsafe { libc::ioctl(self.device.as_raw_fd(), libc::TIOCNXCL) };
    }
}

fn errno(error: &io::Error) -> i32 {
    error.raw_os_error().unwrap_or(libc::EIO)
}

/// The opener does not return an error number, so this function repeats the call to obtain it.
fn why_not_opened(path: &Path, error: &tokio_serial::Error) -> OpenError {
    use tokio_serial::ErrorKind;
    let again = OpenOptions::new().read(true).write(true).custom_flags(libc::O_NOCTTY | libc::O_NONBLOCK).open(path);
    let reason = match again {
        // SAFETY: the descriptor is open.
        Ok(file) if unsafe { libc::isatty(file.as_raw_fd()) } == 0 => libc::ENOTTY,
        Ok(_) if error.kind == ErrorKind::NoDevice => libc::EBUSY,
        Ok(_) => libc::EIO,
        Err(error) => errno(&error),
    };
    let path = path.into();
    match reason {
        libc::ENOENT | libc::ENOTDIR | libc::ENXIO | libc::ENODEV => OpenError::Absent(path),
        libc::EACCES | libc::EPERM => OpenError::Denied(path),
        libc::EBUSY => OpenError::Busy(path),
        libc::ENOTTY | libc::EISDIR => OpenError::NotATty(path),
        errno => OpenError::Os { path, errno },
    }
}

/// Whether a tty is the host's end of a pseudo-terminal: major numbers 136 to 143 (Linux, `devices.txt`).
fn is_pseudo_terminal(tty: &File) -> bool {
    let device = tty.metadata().map(|found| libc::major(found.rdev()));
    device.is_ok_and(|major| (136..=143).contains(&major))
}

/// `struct serial_struct` of `linux/serial.h`.
#[repr(C)]
struct SerialStruct {
    kind: libc::c_int,
    line: libc::c_int,
    port: libc::c_uint,
    irq: libc::c_int,
    flags: libc::c_int,
    xmit_fifo_size: libc::c_int,
    custom_divisor: libc::c_int,
    baud_base: libc::c_int,
    close_delay: libc::c_ushort,
    io_type: libc::c_char,
    reserved: libc::c_char,
    hub6: libc::c_int,
    closing_wait: libc::c_ushort,
    closing_wait2: libc::c_ushort,
    iomem_base: *mut libc::c_uchar,
    iomem_reg_shift: libc::c_ushort,
    port_high: libc::c_uint,
    iomap_base: libc::c_ulong,
}

/// `ASYNC_LOW_LATENCY` of `linux/tty_flags.h`.
const LOW_LATENCY: libc::c_int = 1 << 13;

/// Asks the driver to hand bytes over as they come. Pseudo-terminals and many drivers do not support it, and a user
/// without privileges cannot change every driver: neither is an error.
fn ask_for_low_latency(fd: libc::c_int) {
    // SAFETY: plain integers and a pointer, for all of which zero is a value.
    let mut serial: SerialStruct = unsafe { mem::zeroed() };
    // SAFETY: the call fills a structure that is as large as it expects.
    if unsafe { libc::ioctl(fd, libc::TIOCGSERIAL, &raw mut serial) } < 0 {
        return;
    }
    serial.flags |= LOW_LATENCY;
    // SAFETY: the call reads such a structure.
    unsafe { libc::ioctl(fd, libc::TIOCSSERIAL, &raw const serial) };
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    /// Master end of a new pseudo-terminal, and the path of its tty.
    fn pty() -> (File, PathBuf) {
        // SAFETY: the descriptor returned is new and ours; the name fits its buffer.
        unsafe {
            let flags = libc::O_RDWR | libc::O_NOCTTY | libc::O_CLOEXEC;
            let master = libc::posix_openpt(flags);
            assert!(master >= 0 && libc::grantpt(master) == 0 && libc::unlockpt(master) == 0);
            let mut name = [0; 64];
            assert_eq!(libc::ptsname_r(master, name.as_mut_ptr(), name.len()), 0);
            let name = std::ffi::CStr::from_ptr(name.as_ptr()).to_str().unwrap();
            (File::from_raw_fd(master), name.into())
        }
    }

    fn open(path: &Path) -> Result<Tty, OpenError> {
        Tty::open(path, Settings::AXIS_CONTROLLER)
    }

    const NOW: Instant = Instant::ZERO;

    /// Reads until `count` bytes have arrived. A kernel thread transfers them from the other end.
    fn read(tty: &mut Tty, count: usize) -> Vec<u8> {
        let mut seen = Vec::new();
        while seen.len() < count {
            wait(tty);
            let mut into = [0; 512];
            let count = tty.read(NOW, &mut into).unwrap();
            seen.extend_from_slice(&into[..count]);
        }
        seen
    }

    fn wait(device: &impl AsFd) {
        let mut poll = libc::pollfd { fd: device.as_fd().as_raw_fd(), events: libc::POLLIN, revents: 0 };
        // SAFETY: one valid pollfd.
        let ready = unsafe { libc::poll(&raw mut poll, 1, 2_000) };
        assert_eq!(ready, 1, "nothing came within two seconds");
    }

    #[test]
    fn every_byte_crosses_unchanged_and_neither_call_waits() {
        let (mut master, path) = pty();
        let mut tty = open(&path).unwrap();
        let mut into = [0; 512];
        assert_eq!(tty.read(NOW, &mut into), Ok(0));
        let all: Vec<u8> = (0..=u8::MAX).collect();
        assert_eq!(tty.write(NOW, &all), Ok(256));
        let mut seen = [0; 256];
        master.read_exact(&mut seen).unwrap();
        assert_eq!(seen[..], all);
        // The byte is written last. An echo of earlier bytes would be read before it.
        master.write_all(&all).unwrap();
        assert_eq!(read(&mut tty, 256), all);
        assert_eq!(tty.read(NOW, &mut into), Ok(0));
        let (sent, received) = (tty.counters().sent, tty.counters().received);
        assert_eq!((sent, received), (256, 256));
    }

    #[test]
    fn the_line_is_set_as_asked() {
        let (_master, path) = pty();
        let tty = open(&path).unwrap();
        // SAFETY: the call fills a structure of plain integers.
        let set: libc::termios2 = unsafe {
            let mut set = mem::zeroed();
            let fd = tty.as_fd().as_raw_fd();
            assert_eq!(libc::ioctl(fd, libc::TCGETS2, &raw mut set), 0);
            set
        };
        assert_eq!((set.c_ispeed, set.c_ospeed), (921_600, 921_600));
        let framing = libc::CSIZE | libc::CSTOPB | libc::PARENB | libc::CRTSCTS;
        assert_eq!(set.c_cflag & framing, libc::CS8 | libc::CSTOPB);
        assert_eq!(set.c_lflag & (libc::ECHO | libc::ICANON), 0);
        assert_eq!((set.c_iflag & (libc::IXON | libc::ICRNL), set.c_oflag & libc::OPOST), (0, 0));
    }

    #[test]
    fn what_came_before_it_was_opened_is_not_received() {
        let (mut master, path) = pty();
        // Raw mode from here on, in which no byte waits for the end of a line.
        drop(open(&path).unwrap());
        master.write_all(b"old").unwrap();
        wait(&File::open(&path).unwrap());
        let mut into = [0; 8];
        let mut tty = open(&path).unwrap();
        assert_eq!(tty.read(NOW, &mut into), Ok(0));
        master.write_all(b"new").unwrap();
        assert_eq!(read(&mut tty, 3), b"new");
    }

    #[test]
    fn a_line_whose_device_was_unplugged_is_gone_for_good() {
        let (master, path) = pty();
        let mut tty = open(&path).unwrap();
        drop(master);
        let mut into = [0; 8];
        assert_eq!(tty.read(NOW, &mut into), Err(LineError::Gone));
        assert_eq!(tty.read(NOW, &mut into), Err(LineError::Gone));
        assert_eq!(tty.write(NOW, b"ab"), Err(LineError::Gone));
        assert_eq!(tty.counters().refused, 2);
    }

    #[test]
    fn a_full_line_refuses_what_it_does_not_take() {
        let (_master, path) = pty();
        let mut tty = open(&path).unwrap();
        let taken: usize = (0..200).map(|_| tty.write(NOW, &[0; 1_024]).unwrap()).sum();
        assert!(taken < 200 * 1_024, "nobody reads: {taken} bytes taken");
        assert_eq!(tty.write(NOW, &[0]), Ok(0));
        // Boxed, as in the drivers.
        let mut tty: Box<dyn Line> = Box::new(tty);
        tty.discard_unsent();
        assert_eq!(tty.write(NOW, &[0]), Ok(1), "there is room for the last word");
    }

    #[test]
    fn errors_say_which_device_and_what_to_do() {
        let (_master, path) = pty();
        let text = |path: &Path| match open(path) {
            Ok(_) => String::from("opened"),
            Err(error) => error.to_string(),
        };
        let held = open(&path).unwrap();
        assert!(text(&path).contains("in use by another process"), "{}", text(&path));
        drop(held);
        assert_eq!(text(&path), "opened");
        for (path, word) in
            [("/dev/serial/by-id/none", "no such device"), ("/dev/null", "not a tty"), ("/dev", "not a tty")]
        {
            let text = text(Path::new(path));
            assert!(text.starts_with(path) && text.contains(word), "{text}");
        }
        let denied = OpenError::Denied(Path::new("/dev/ttyUSB0").into()).to_string();
        assert!(denied.contains("dialout"), "{denied}");
    }

    /// Whether opening a terminal is refused to users other than root, seen from a process that has it open.
    fn is_exclusive(terminal: &File) -> bool {
        let mut exclusive: libc::c_int = 0;
        // SAFETY: the request stores one int.
        let asked = unsafe { libc::ioctl(terminal.as_raw_fd(), libc::TIOCGEXCL, &raw mut exclusive) };
        assert_eq!(asked, 0);
        exclusive != 0
    }

    /// An emulator has the host's end of its pseudo-terminal open too, so the exclusive flag would outlive a host that
    /// is killed.
    #[test]
    fn a_host_that_is_killed_leaves_a_pseudo_terminal_to_the_next() {
        let (_master, path) = pty();
        let emulators = OpenOptions::new().read(true).write(true).custom_flags(libc::O_NOCTTY).open(&path).unwrap();
        let held = mem::ManuallyDrop::new(open(&path).unwrap());
        assert!(!is_exclusive(&emulators));
        // The kernel closes the descriptors of a killed process, and does nothing else.
        // SAFETY: the owner of the descriptor is never dropped.
        assert_eq!(unsafe { libc::close(held.device.as_raw_fd()) }, 0);
        assert!(open(&path).is_ok());
    }

    #[test]
    fn nobody_opens_a_line_that_is_in_use_not_even_root() {
        let (_master, path) = pty();
        let held = open(&path).unwrap();
        for _ in 0..2 {
            let refused = open(&path).map(|_| ()).unwrap_err();
            assert_eq!(refused, OpenError::Busy(path.as_path().into()));
        }
        drop(held);
        assert!(open(&path).is_ok());
    }

    #[test]
    fn a_link_is_as_good_as_the_device() {
        let (mut master, path) = pty();
        let link = std::env::temp_dir().join(format!("mrroc-tty-{}", std::process::id()));
        std::os::unix::fs::symlink(&path, &link).unwrap();
        let tty = open(&link);
        std::fs::remove_file(&link).unwrap();
        master.write_all(b"x").unwrap();
        assert_eq!(read(&mut tty.unwrap(), 1), b"x");
    }
}
