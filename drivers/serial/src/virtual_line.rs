//! A line without a tty: the host holds one end, a model of the wire and its device holds the other.
//!
//! Bytes keep their order and carry times in both directions. No call waits, locks or allocates after [`virtual_line`]
//! has returned. The model is responsible for baud rate and latency.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use can::Instant;
use rtrb::{Consumer, Producer, RingBuffer};

use crate::{Line, LineCounters, LineError};

/// A byte, and the time at which the host wrote it or received it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimedByte {
    /// The byte.
    pub byte: u8,
    /// Time of writing or of delivery.
    pub at: Instant,
}

/// Creates both ends of a virtual line. Each direction holds `capacity` bytes, like the buffer of a tty.
pub fn virtual_line(capacity: usize) -> (VirtualLine, VirtualLinePeer) {
    let (to_device, written) = RingBuffer::new(capacity);
    let (to_host, arrived) = RingBuffer::new(capacity);
    let dropped = Arc::new(AtomicU64::new(0));
    let line = VirtualLine { to_device, arrived, dropped: Arc::clone(&dropped), counters: LineCounters::default() };
    let peer = VirtualLinePeer { written, to_host, dropped };
    (line, peer)
}

/// The host's end.
///
/// [`Line::write`] accepts only the bytes that fit. [`Line::read`] holds back bytes later than `now`. After the other
/// end was dropped, writing returns [`LineError::Gone`]. Reading returns it as soon as the queue is empty.
pub struct VirtualLine {
    to_device: Producer<TimedByte>,
    arrived: Consumer<TimedByte>,
    dropped: Arc<AtomicU64>,
    counters: LineCounters,
}

impl Line for VirtualLine {
    fn write(&mut self, now: Instant, bytes: &[u8]) -> Result<usize, LineError> {
        if self.to_device.is_abandoned() {
            self.counters.refused += bytes.len() as u64;
            return Err(LineError::Gone);
        }
        let mut push = |&byte: &u8| self.to_device.push(TimedByte { byte, at: now }).is_ok();
        let taken = bytes.iter().take_while(|byte| push(byte)).count();
        self.counters.sent += taken as u64;
        self.counters.refused += (bytes.len() - taken) as u64;
        Ok(taken)
    }

    fn read(&mut self, now: Instant, into: &mut [u8]) -> Result<usize, LineError> {
        // Checked before the queue is read, so that bytes delivered before the end was dropped still count.
        let gone = self.arrived.is_abandoned();
        let mut count = 0;
        while count < into.len() {
            match self.arrived.peek() {
                Ok(next) if next.at <= now => {
                    into[count] = next.byte;
                    count += 1;
                    self.arrived.pop().expect("one was peeked");
                }
                Ok(_) => break,
                Err(_) if gone && count == 0 => return Err(LineError::Gone),
                Err(_) => break,
            }
        }
        self.counters.received += count as u64;
        Ok(count)
    }

    fn counters(&self) -> LineCounters {
        LineCounters { dropped: self.dropped.load(Ordering::Relaxed), ..self.counters }
    }
}

/// The end of the wire and of its device.
pub struct VirtualLinePeer {
    written: Consumer<TimedByte>,
    to_host: Producer<TimedByte>,
    dropped: Arc<AtomicU64>,
}

impl VirtualLinePeer {
    /// The next byte that the host wrote, without removing it.
    pub fn peek(&self) -> Option<TimedByte> {
        self.written.peek().ok().copied()
    }

    /// Removes and returns the next byte that the host wrote.
    pub fn take(&mut self) -> Option<TimedByte> {
        self.written.pop().ok()
    }

    /// Delivers a byte to the host. A byte that finds no room is lost and counted, as in a full tty.
    ///
    /// Times must not decrease.
    pub fn deliver(&mut self, byte: TimedByte) {
        if self.to_host.push(byte).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Exchanges the hosts that receive the bytes of two devices. The devices still receive the bytes of their own hosts.
    pub fn swap_receivers(&mut self, other: &mut Self) {
        std::mem::swap(&mut self.to_host, &mut other.to_host);
        std::mem::swap(&mut self.dropped, &mut other.dropped);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn at(nanoseconds: u64) -> Instant {
        Instant::from_nanos(nanoseconds)
    }

    #[test]
    fn bytes_cross_in_order_and_not_before_their_time() {
        let (mut line, mut peer) = virtual_line(4);
        assert_eq!(line.write(at(1), b"abcde"), Ok(4));
        let taken: Vec<u8> = std::iter::from_fn(|| peer.take()).map(|b| b.byte).collect();
        assert_eq!(taken, b"abcd");
        for (byte, time) in [(b'x', 5), (b'y', 7)] {
            peer.deliver(TimedByte { byte, at: at(time) });
        }
        let mut into = [0; 8];
        assert_eq!(line.read(at(4), &mut into), Ok(0));
        assert_eq!(line.read(at(6), &mut into), Ok(1));
        assert_eq!(into[0], b'x');
        let expected = LineCounters { sent: 4, received: 1, refused: 1, dropped: 0 };
        assert_eq!(line.counters(), expected);
    }

    #[test]
    fn a_full_line_drops_and_counts() {
        let (line, mut peer) = virtual_line(2);
        (0..5).for_each(|byte| peer.deliver(TimedByte { byte, at: at(0) }));
        assert_eq!(line.counters().dropped, 3);
    }

    #[test]
    fn a_line_whose_other_end_is_gone_says_so_after_its_last_byte() {
        let (mut line, mut peer) = virtual_line(2);
        peer.deliver(TimedByte { byte: 9, at: at(0) });
        drop(peer);
        let mut into = [0; 2];
        assert_eq!(line.write(at(0), &[1]), Err(LineError::Gone));
        assert_eq!(line.read(at(0), &mut into), Ok(1));
        assert_eq!(line.read(at(0), &mut into), Err(LineError::Gone));
    }
}
