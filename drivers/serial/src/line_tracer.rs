//! Recording what passes over a serial line, and a line that repeats a recording.
//!
//! [`LineTracer`] wraps any line and never waits for the reader of the trace: what does not fit is counted and left
//! out. [`ReplayLine`] repeats a trace without losses.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use can::Instant;
use can::candump::Direction;
use rtrb::{Consumer, Producer, RingBuffer};

use crate::{Line, LineCounters, LineError};

/// Most bytes of one entry. A longer telegram has several entries of equal time and direction.
pub const CHUNK: usize = 48;

/// One result of a call of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineEntry {
    /// Time that the caller of the line gave.
    pub now: Instant,
    /// The call. A discard counts as sending.
    pub direction: Direction,
    /// The result.
    pub event: LineEvent,
}

/// What a call of a line resulted in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineEvent {
    /// Bytes passed.
    Bytes {
        /// Number of the bytes.
        length: u8,
        /// The bytes, filled up with zeros.
        bytes: [u8; CHUNK],
    },
    /// Bytes were offered and not accepted. The accepted bytes of the same call are traced before.
    Refused {
        /// Number of these bytes.
        count: u32,
    },
    /// The call failed.
    Failed {
        /// The error.
        error: LineError,
    },
    /// The line lost received bytes.
    Dropped {
        /// Value of [`LineCounters::dropped`].
        total: u64,
    },
}

impl LineEvent {
    /// The bytes that passed; empty for other events.
    pub fn bytes(&self) -> &[u8] {
        if let Self::Bytes { length, bytes } = self { &bytes[..usize::from(*length).min(CHUNK)] } else { &[] }
    }

    /// An event of up to [`CHUNK`] bytes; more are left out.
    pub fn of_bytes(given: &[u8]) -> Self {
        let length = given.len().min(CHUNK);
        let mut bytes = [0; CHUNK];
        bytes[..length].copy_from_slice(&given[..length]);
        Self::Bytes { length: length as u8, bytes }
    }
}

/// A line that records its results.
pub struct LineTracer<L> {
    line: L,
    trace: Producer<LineEntry>,
    lost: Arc<AtomicU64>,
    dropped: u64,
}

impl<L: Line> LineTracer<L> {
    /// Wraps `line`; the trace holds up to `capacity` entries that were not read yet.
    pub fn new(line: L, capacity: usize) -> (Self, LineTraceReader) {
        let (trace, entries) = RingBuffer::new(capacity);
        let lost = Arc::new(AtomicU64::new(0));
        let reader = LineTraceReader { entries, lost: Arc::clone(&lost) };
        (Self { line, trace, lost, dropped: 0 }, reader)
    }

    fn record(&mut self, now: Instant, direction: Direction, event: LineEvent) {
        if self.trace.push(LineEntry { now, direction, event }).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn record_bytes(&mut self, now: Instant, direction: Direction, bytes: &[u8]) {
        for chunk in bytes.chunks(CHUNK) {
            self.record(now, direction, LineEvent::of_bytes(chunk));
        }
    }
}

impl<L: Line> Line for LineTracer<L> {
    fn write(&mut self, now: Instant, bytes: &[u8]) -> Result<usize, LineError> {
        let direction = Direction::Sent;
        let written = self.line.write(now, bytes);
        match written {
            Ok(taken) => {
                self.record_bytes(now, direction, &bytes[..taken]);
                if taken < bytes.len() {
                    self.record(now, direction, LineEvent::Refused { count: (bytes.len() - taken) as u32 });
                }
            }
            Err(error) => self.record(now, direction, LineEvent::Failed { error }),
        }
        written
    }

    fn read(&mut self, now: Instant, into: &mut [u8]) -> Result<usize, LineError> {
        let direction = Direction::Received;
        let read = self.line.read(now, into);
        match read {
            Ok(count) => self.record_bytes(now, direction, &into[..count]),
            Err(error) => self.record(now, direction, LineEvent::Failed { error }),
        }
        let dropped = self.line.counters().dropped;
        if dropped != self.dropped {
            self.dropped = dropped;
            self.record(now, direction, LineEvent::Dropped { total: dropped });
        }
        read
    }

    fn discard_unsent(&mut self) {
        self.line.discard_unsent();
    }

    fn counters(&self) -> LineCounters {
        self.line.counters()
    }
}

/// The reading end of the trace of a line, for another thread.
pub struct LineTraceReader {
    entries: Consumer<LineEntry>,
    lost: Arc<AtomicU64>,
}

impl LineTraceReader {
    /// The oldest entry that was not read yet.
    pub fn read(&mut self) -> Option<LineEntry> {
        self.entries.pop().ok()
    }

    /// Entries left out of the trace since it was full.
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }
}

/// The entries that a replayed line has not repeated yet.
#[derive(Default)]
struct Trace {
    received: VecDeque<LineEntry>,
    sent: VecDeque<LineEntry>,
}

impl Trace {
    fn push(&mut self, entry: LineEntry) {
        match (entry.direction, entry.event) {
            (Direction::Received, _) => self.received.push_back(entry),
            (_, LineEvent::Refused { .. } | LineEvent::Failed { .. }) => self.sent.push_back(entry),
            _ => {}
        }
    }
}

/// A line that repeats what a [`LineTracer`] recorded.
///
/// A call at a given time reads the bytes of all calls up to this time that were not read yet. Errors and refusals
/// appear in the calls in which they were recorded. The line accepts all other bytes.
pub struct ReplayLine {
    trace: Arc<Mutex<Trace>>,
    /// Number of bytes of the first entry that were read.
    read: usize,
    counters: LineCounters,
}

/// The end of a [`ReplayLine`] that adds entries, for a trace that is longer than the memory.
pub struct LineFeed(Arc<Mutex<Trace>>);

impl LineFeed {
    /// Adds an entry. The entries come in order of time, each before the call at its time.
    pub fn push(&self, entry: LineEntry) {
        locked(&self.0).push(entry);
    }

    /// Number of entries that the line has not repeated yet.
    pub fn unread(&self) -> usize {
        let trace = locked(&self.0);
        trace.received.len() + trace.sent.len()
    }
}

impl ReplayLine {
    /// A line that repeats `entries`, in order of time.
    pub fn new(entries: impl IntoIterator<Item = LineEntry>) -> Self {
        let (line, feed) = Self::fed();
        entries.into_iter().for_each(|entry| feed.push(entry));
        line
    }

    /// A line without entries, and the end that adds them.
    pub fn fed() -> (Self, LineFeed) {
        let trace = Arc::<Mutex<Trace>>::default();
        (Self { trace: Arc::clone(&trace), read: 0, counters: LineCounters::default() }, LineFeed(trace))
    }
}

/// The trace. A panic of another user of the trace leaves whole entries.
fn locked(trace: &Mutex<Trace>) -> MutexGuard<'_, Trace> {
    trace.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Line for ReplayLine {
    fn write(&mut self, now: Instant, bytes: &[u8]) -> Result<usize, LineError> {
        let mut trace = locked(&self.trace);
        while trace.sent.front().is_some_and(|entry| entry.now < now) {
            trace.sent.pop_front();
        }
        let outcome = trace.sent.front().filter(|entry| entry.now == now).map(|entry| entry.event);
        if outcome.is_some() {
            trace.sent.pop_front();
        }
        drop(trace);
        let written = match outcome {
            Some(LineEvent::Failed { error }) => Err(error),
            Some(LineEvent::Refused { count }) => Ok(bytes.len().saturating_sub(count as usize)),
            _ => Ok(bytes.len()),
        };
        let taken = written.unwrap_or(0);
        self.counters.sent += taken as u64;
        self.counters.refused += (bytes.len() - taken) as u64;
        written
    }

    fn read(&mut self, now: Instant, into: &mut [u8]) -> Result<usize, LineError> {
        let mut count = 0;
        let mut trace = locked(&self.trace);
        while let Some(entry) = trace.received.front().filter(|entry| entry.now <= now) {
            match entry.event {
                LineEvent::Failed { error } if count == 0 => {
                    trace.received.pop_front();
                    return Err(error);
                }
                // The bytes come first, and the next call fails.
                LineEvent::Failed { .. } => break,
                LineEvent::Dropped { total } => self.counters.dropped = total,
                LineEvent::Refused { .. } => {}
                LineEvent::Bytes { .. } => {
                    let left = &entry.event.bytes()[self.read..];
                    let room = &mut into[count..];
                    let fits = left.len().min(room.len());
                    room[..fits].copy_from_slice(&left[..fits]);
                    (count, self.counters.received) = (count + fits, self.counters.received + fits as u64);
                    if fits < left.len() {
                        self.read += fits;
                        break;
                    }
                    self.read = 0;
                }
            }
            trace.received.pop_front();
        }
        Ok(count)
    }

    fn counters(&self) -> LineCounters {
        self.counters
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{TimedByte, virtual_line};

    fn at(nanos: u64) -> Instant {
        Instant::from_nanos(nanos)
    }

    /// The results of calls of each kind.
    fn calls(line: &mut impl Line, mut before: impl FnMut(u64)) -> Vec<String> {
        let mut results = Vec::new();
        for cycle in 0..5 {
            before(cycle);
            let now = at(cycle * 1000);
            let mut into = [0; 70];
            let read = line.read(now, &mut into);
            results.push(format!("{read:?} {:?}", &into[..read.unwrap_or(0)]));
            let bytes: Vec<_> = (0..cycle as u8 * 30).collect();
            results.push(format!("{:?}", line.write(now, &bytes)));
        }
        results
    }

    #[test]
    fn a_replayed_line_gives_the_results_of_the_recorded_one() {
        let (line, peer) = virtual_line(64);
        let (mut line, mut trace) = LineTracer::new(line, 64);
        let mut peer = Some(peer);
        let live = calls(&mut line, |cycle| match (cycle, &mut peer) {
            (1, Some(peer)) => {
                for byte in 0..60 {
                    peer.deliver(TimedByte { byte, at: at(1000 + u64::from(byte) * 20) });
                }
            }
            // Writing and reading fail from now on.
            (4, _) => peer = None,
            _ => {}
        });
        assert!(live.iter().any(|it| it.contains("Gone")) && live.iter().any(|it| it == "Ok(34)"), "{live:#?}");
        let mut replayed = ReplayLine::new(std::iter::from_fn(|| trace.read()));
        assert_eq!(calls(&mut replayed, |_| {}), live);
        assert_eq!(trace.lost(), 0);
    }

    #[test]
    fn a_full_trace_stops_nothing_and_counts_what_it_lacks() {
        let (line, _peer) = virtual_line(64);
        let (mut line, trace) = LineTracer::new(line, 1);
        assert_eq!(line.write(at(0), &[0; 60]), Ok(60));
        assert_eq!(trace.lost(), 1);
    }
}
