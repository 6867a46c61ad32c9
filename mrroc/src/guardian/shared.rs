//! Memory that a controller and its guardian share: words that both processes change, and the orders to the guardian.
//!
//! A memory file begins with one page of [`Words`], which both processes map. The [`Orders`] follow. The controller
//! writes the orders before the guardian starts. The guardian reads the orders once, so a controller that fails later
//! cannot change the orders.

#![expect(unsafe_code, reason = "mmap and memfd_create have no safe wrapper among our dependencies")]

use std::fmt;
use std::fs::File;
use std::io;
use std::mem::ManuallyDrop;
use std::ops::Deref;
use std::os::fd::{AsRawFd, FromRawFd, RawFd};
use std::os::unix::fs::FileExt;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU32, AtomicU64};
use std::time::Duration;

use super::GuardianConfig;

/// Bytes of a telegram.
pub(super) const LONGEST_TELEGRAM: usize = 64;

/// Lines of a guardian.
pub(super) const MOST_LINES: usize = 256;

/// Bytes of the words in the memory file: a multiple of a page of all Linux systems with pages up to 64 KiB.
const ORDERS_AT: u64 = 65_536;

/// First word of the orders: changes with their layout.
const MAGIC: u64 = 0x4d52_5247_5541_0003;

/// Words in front of the lines.
const HEAD: usize = 8;

/// Words of a line: descriptor, length, telegram.
const LINE: usize = 2 + LONGEST_TELEGRAM / 8;

/// Bytes of all orders.
pub(super) const ORDERS: usize = 8 * (HEAD + LINE * MOST_LINES);

/// What the controller tells its guardian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub(super) enum Phase {
    /// Watch.
    Run = 0,
    /// The servo thread has ended. The guardian is told soon whether the drives are off.
    Leave = 1,
    /// End. The drives are off.
    End = 2,
    /// Stop the drives, then end.
    Stop = 3,
}

impl Phase {
    /// The phase of a word. A word that is none is from a controller that fails.
    pub(super) fn of(word: u32) -> Self {
        [Self::Run, Self::Leave, Self::End].into_iter().find(|phase| *phase as u32 == word).unwrap_or(Self::Stop)
    }
}

/// Words that both processes change.
#[derive(Debug, Default)]
#[repr(C)]
pub(super) struct SharedWords {
    /// Completed servo cycles, by the controller.
    pub(super) cycles: AtomicU64,
    /// [`Phase`], by the controller.
    pub(super) phase: AtomicU32,
    /// [`Denied`], by the guardian before its first look.
    pub(super) denied: AtomicU32,
    /// Looks of the guardian at the cycles: its heartbeat.
    pub(super) looks: AtomicU64,
    /// Number of times that the guardian began to stop the drives.
    pub(super) stops: AtomicU64,
    /// Duration of the last silence that led to a stop, µs, by the guardian.
    pub(super) silence_us: AtomicU64,
}

/// The mapped words of a memory file.
#[derive(Debug)]
pub(super) struct Words(NonNull<SharedWords>);

// SAFETY: the words are atomic, and the mapping lasts until the last owner drops it.
unsafe impl Send for Words {}
// SAFETY: as above; all access is by shared references to atomics.
unsafe impl Sync for Words {}

impl Words {
    /// Maps the words of `memory`, which has at least [`ORDERS_AT`] bytes.
    pub(super) fn map(memory: RawFd) -> io::Result<Self> {
        let protection = libc::PROT_READ | libc::PROT_WRITE;
        let length = size_of::<SharedWords>();
        // SAFETY: a new mapping at an address that the kernel chooses, so no existing object is affected.
        let mapped = unsafe { libc::mmap(std::ptr::null_mut(), length, protection, libc::MAP_SHARED, memory, 0) };
        if mapped == libc::MAP_FAILED {
            return Err(io::Error::last_os_error());
        }
        NonNull::new(mapped.cast()).map(Self).ok_or_else(|| io::Error::from_raw_os_error(libc::ENOMEM))
    }
}

impl Deref for Words {
    type Target = SharedWords;

    fn deref(&self) -> &SharedWords {
        // SAFETY: a mapping is aligned to a page and as long as the words; every bit pattern is a value of its atomics. The
        // other process changes them by atomic accesses only.
        unsafe { self.0.as_ref() }
    }
}

impl Drop for Words {
    fn drop(&mut self) {
        // SAFETY: the mapping is of this value and has this length; no reference outlives the value.
        unsafe { libc::munmap(self.0.as_ptr().cast(), size_of::<SharedWords>()) };
    }
}

/// A new memory file with these orders, and its mapped words.
pub(super) fn create(orders: &Orders) -> io::Result<(File, Words)> {
    // SAFETY: the name is a string with an end, and the flags are valid.
    let descriptor = unsafe { libc::memfd_create(c"mrroc-guardian".as_ptr(), libc::MFD_CLOEXEC) };
    if descriptor < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: the descriptor is new and has no other owner.
    let file = unsafe { File::from_raw_fd(descriptor) };
    file.set_len(ORDERS_AT + ORDERS as u64)?;
    file.write_all_at(&orders.encode(), ORDERS_AT)?;
    let words = Words::map(file.as_raw_fd())?;
    Ok((file, words))
}

/// One line of a guardian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LineOrders {
    /// Descriptor in the guardian, and in the controller when the guardian starts.
    pub(super) descriptor: RawFd,
    length: usize,
    telegram: [u8; LONGEST_TELEGRAM],
}

impl LineOrders {
    const NONE: Self = Self { descriptor: -1, length: 0, telegram: [0; LONGEST_TELEGRAM] };

    /// `None` for an empty telegram, or for more than 64 bytes.
    pub(super) fn new(descriptor: RawFd, bytes: &[u8]) -> Option<Self> {
        let mut telegram = [0; LONGEST_TELEGRAM];
        telegram.get_mut(..bytes.len()).filter(|it| !it.is_empty())?.copy_from_slice(bytes);
        Some(Self { descriptor, length: bytes.len(), telegram })
    }

    pub(super) fn telegram(&self) -> &[u8] {
        &self.telegram[..self.length]
    }
}

/// Orders of a guardian, which it reads once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Orders {
    /// Silence that the guardian permits.
    pub(super) silence: Duration,
    /// Time between two looks.
    pub(super) look: Duration,
    /// Priority of the servo.
    pub(super) priority: u8,
    /// The pipe whose end is the end of the controller.
    pub(super) life: RawFd,
    /// The hardware watchdog; -1 without one.
    pub(super) watchdog: RawFd,
    /// The connection to a controller that did not start this process; -1 without one.
    pub(super) connection: RawFd,
    count: usize,
    lines: [LineOrders; MOST_LINES],
}

impl Orders {
    /// `None` for too many lines, and for neither a line nor a watchdog.
    pub(super) fn new(
        config: &GuardianConfig,
        life: RawFd,
        given: &[LineOrders],
        watchdog: Option<RawFd>,
    ) -> Option<Self> {
        let mut lines = [LineOrders::NONE; MOST_LINES];
        lines.get_mut(..given.len()).filter(|it| !it.is_empty() || watchdog.is_some())?.copy_from_slice(given);
        let watchdog = watchdog.unwrap_or(-1);
        let GuardianConfig { silence, period, priority } = *config;
        let (look, count) = (period / 2, given.len());
        Some(Self { silence, look, priority, life, watchdog, connection: -1, count, lines })
    }

    pub(super) fn lines(&self) -> &[LineOrders] {
        &self.lines[..self.count]
    }

    fn encode(&self) -> Vec<u8> {
        let nanos = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        let [life, watchdog, connection] = [self.life, self.watchdog, self.connection].map(|it| it as u64);
        let times = [nanos(self.silence), nanos(self.look)];
        let (priority, count) = (self.priority.into(), self.count as u64);
        let head: [u64; HEAD] = [MAGIC, times[0], times[1], priority, life, count, watchdog, connection];
        let mut bytes: Vec<u8> = head.iter().flat_map(|word| word.to_le_bytes()).collect();
        for line in &self.lines {
            bytes.extend((line.descriptor as u64).to_le_bytes());
            bytes.extend((line.length as u64).to_le_bytes());
            bytes.extend(line.telegram);
        }
        bytes
    }

    /// Decodes the orders without an allocation; `None` for what no controller of this version wrote.
    fn decode(bytes: &[u8; ORDERS]) -> Option<Self> {
        let word = |index: usize| {
            let bytes = bytes[8 * index..][..8].try_into().expect("a word has eight bytes");
            u64::from_le_bytes(bytes)
        };
        if word(0) != MAGIC {
            return None;
        }
        let mut lines = [LineOrders::NONE; MOST_LINES];
        for (index, line) in lines.iter_mut().enumerate() {
            let first = HEAD + LINE * index;
            line.descriptor = word(first) as RawFd;
            line.length = usize::try_from(word(first + 1)).ok().filter(|length| *length <= LONGEST_TELEGRAM)?;
            line.telegram.copy_from_slice(&bytes[8 * (first + 2)..][..LONGEST_TELEGRAM]);
        }
        Some(Self {
            silence: Duration::from_nanos(word(1)),
            look: Duration::from_nanos(word(2)),
            priority: u8::try_from(word(3)).ok()?,
            life: word(4) as RawFd,
            count: usize::try_from(word(5)).ok().filter(|count| *count <= MOST_LINES)?,
            watchdog: word(6) as RawFd,
            connection: word(7) as RawFd,
            lines,
        })
    }

    /// Gives the orders of the memory file `memory` this `connection`, and the numbers that its descriptors have `here`.
    pub(super) fn renumber(memory: RawFd, connection: RawFd, here: impl Fn(RawFd) -> Option<RawFd>) -> io::Result<()> {
        let unknown = || io::Error::from(io::ErrorKind::InvalidData);
        let mut orders = Self::read(memory).ok_or_else(unknown)?;
        let count = orders.count;
        let lines = orders.lines[..count].iter_mut().map(|line| &mut line.descriptor);
        let watchdog = (orders.watchdog >= 0).then_some(&mut orders.watchdog);
        for descriptor in lines.chain(watchdog).chain([&mut orders.life]) {
            *descriptor = here(*descriptor).ok_or_else(unknown)?;
        }
        orders.connection = connection;
        // SAFETY: the descriptor stays open, and the file that would close it is never dropped.
        let file = ManuallyDrop::new(unsafe { File::from_raw_fd(memory) });
        file.write_all_at(&orders.encode(), ORDERS_AT)
    }

    /// Reads the orders of the memory file with descriptor `memory`, without an allocation.
    pub(super) fn read(memory: RawFd) -> Option<Self> {
        let mut bytes = [0; ORDERS];
        // SAFETY: the buffer is writable and as long as stated. A descriptor that is none is an error.
        let count = unsafe { libc::pread(memory, bytes.as_mut_ptr().cast(), ORDERS, ORDERS_AT as libc::off_t) };
        if usize::try_from(count) == Ok(ORDERS) { Self::decode(&bytes) } else { None }
    }
}

/// What the host denied to a guardian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Denied(u32);

impl Denied {
    /// A priority above the servo.
    pub(super) const PRIORITY: u32 = 1;
    /// Locked memory.
    pub(super) const MEMORY: u32 = 2;

    pub(super) fn of(word: u32) -> Option<Self> {
        (word != 0).then_some(Self(word))
    }
}

impl fmt::Display for Denied {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = [(Self::PRIORITY, "a SCHED_FIFO priority above the servo"), (Self::MEMORY, "locked memory")];
        let mut separator = "";
        for (_, name) in parts.into_iter().filter(|(bit, _)| self.0 & bit != 0) {
            write!(f, "{separator}{name}")?;
            separator = ", ";
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: GuardianConfig =
        GuardianConfig { silence: Duration::from_millis(9), period: Duration::from_millis(2), priority: 80 };

    #[test]
    fn orders_are_read_as_they_were_written_and_others_are_refused() {
        let line = |descriptor, bytes: &[u8]| LineOrders::new(descriptor, bytes).unwrap();
        let lines = [line(7, &[1, 2, 3]), line(9, &[0x55; LONGEST_TELEGRAM])];
        let orders = Orders::new(&CONFIG, 5, &lines, Some(3)).unwrap();
        let (file, _words) = create(&orders).unwrap();
        let read = Orders::read(file.as_raw_fd()).unwrap();
        assert_eq!(read, orders);
        assert_eq!(read.lines(), lines);
        assert_eq!((read.look, read.life, read.watchdog), (Duration::from_millis(1), 5, 3));
        assert_eq!(Orders::read(-1), None);
        for (at, byte) in [(0, 0), (8 * 5 + 1, 2), (8 * 9, 65)] {
            let mut bytes: [u8; ORDERS] = orders.encode().try_into().unwrap();
            bytes[at] = byte;
            assert_eq!(Orders::decode(&bytes), None, "byte {at}");
        }
        let here = |number| (number != 8).then_some(number + 20);
        Orders::renumber(file.as_raw_fd(), 30, here).unwrap();
        let moved = Orders::read(file.as_raw_fd()).unwrap();
        let numbers: Vec<_> = moved.lines().iter().map(|line| line.descriptor).collect();
        assert_eq!((numbers, moved.life, moved.watchdog, moved.connection), (vec![27, 29], 25, 23, 30));
        assert!(Orders::renumber(file.as_raw_fd(), 30, |_| None).is_err(), "a descriptor that was not sent");
        assert_eq!(Orders::new(&CONFIG, 5, &[], None), None);
        assert!(Orders::new(&CONFIG, 5, &[], Some(3)).is_some());
        assert_eq!(Orders::new(&CONFIG, 5, &[lines[0]; MOST_LINES + 1], None), None);
        assert_eq!((LineOrders::new(3, &[]), LineOrders::new(3, &[0; 65])), (None, None));
    }

    #[test]
    fn a_word_that_is_no_phase_stops_the_drives() {
        for phase in [Phase::Run, Phase::Leave, Phase::End, Phase::Stop] {
            assert_eq!(Phase::of(phase as u32), phase);
        }
        assert_eq!(Phase::of(77), Phase::Stop);
    }

    #[test]
    fn denied_requests_are_listed() {
        let text = |word| Denied::of(word).map(|denied| denied.to_string());
        assert_eq!(text(0), None);
        assert_eq!(text(2).as_deref(), Some("locked memory"));
        assert_eq!(text(3).as_deref(), Some("a SCHED_FIFO priority above the servo, locked memory"));
    }
}
