//! Recording what passes through a port.
//!
//! [`Tracer`] wraps any port and never waits for the reader of the trace: what does not fit is counted
//! and left out. A line of a file is a [`candump::Entry`](crate::candump::Entry).

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rtrb::{Consumer, Producer, RingBuffer};

use crate::candump::Direction;
use crate::{ControllerState, Counters, Frame, Instant, Port, PortError, Received};

/// A frame that passed through a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Traced {
    /// When it was handed over for sending, or when it was received.
    pub at: Instant,
    /// The frame.
    pub frame: Frame,
    /// Which way it went.
    pub direction: Direction,
}

/// A port that records every frame it sends and receives.
///
/// Frames that the port below refuses, and error frames, which it consumes, are not in the trace.
pub struct Tracer<P> {
    port: P,
    trace: Producer<Traced>,
    lost: Arc<AtomicU64>,
}

impl<P: Port> Tracer<P> {
    /// Wraps `port`; the trace holds up to `capacity` frames that were not read yet.
    pub fn new(port: P, capacity: usize) -> (Self, TraceReader) {
        let (trace, entries) = RingBuffer::new(capacity);
        let lost = Arc::new(AtomicU64::new(0));
        let reader = TraceReader { entries, lost: Arc::clone(&lost) };
        (Self { port, trace, lost }, reader)
    }

    fn record(&mut self, at: Instant, frame: Frame, direction: Direction) {
        let traced = Traced { at, frame, direction };
        if self.trace.push(traced).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl<P: Port> Port for Tracer<P> {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        let taken = self.port.send(now, frames)?;
        for &frame in &frames[..taken] {
            self.record(now, frame, Direction::Sent);
        }
        Ok(taken)
    }

    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        let count = self.port.receive(now, into)?;
        for &Received { frame, at } in &into[..count] {
            self.record(at, frame, Direction::Received);
        }
        Ok(count)
    }

    fn counters(&self) -> Counters {
        self.port.counters()
    }

    fn state(&self) -> ControllerState {
        self.port.state()
    }
}

/// The reading end of a trace, for another thread.
pub struct TraceReader {
    entries: Consumer<Traced>,
    lost: Arc<AtomicU64>,
}

impl TraceReader {
    /// The oldest frame that was not read yet.
    pub fn read(&mut self) -> Option<Traced> {
        self.entries.pop().ok()
    }

    /// Frames left out of the trace since it was full.
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{StandardId, virtual_port};

    fn frame(id: u16) -> Frame {
        Frame::new(StandardId::new(id).unwrap(), &[]).unwrap()
    }

    fn at(nanos: u64) -> Instant {
        Instant::from_nanos(nanos)
    }

    fn received(id: u16, nanos: u64) -> Received {
        Received { frame: frame(id), at: at(nanos) }
    }

    fn receive(port: &mut impl Port, now: u64) -> Vec<Received> {
        let mut into = [received(0, 0); 4];
        let count = port.receive(at(now), &mut into).unwrap();
        into[..count].to_vec()
    }

    #[test]
    fn the_trace_holds_what_passed_and_nothing_else() {
        let (port, mut peer) = virtual_port(2);
        let (mut port, mut trace) = Tracer::new(port, 8);
        assert_eq!(port.send(at(1), &[frame(1), frame(2), frame(3)]), Ok(2));
        peer.deliver(received(4, 5), 47);
        assert_eq!(receive(&mut port, 9), [received(4, 5)]);
        let traced = |id, nanos, direction| Some(Traced { at: at(nanos), frame: frame(id), direction });
        assert_eq!(trace.read(), traced(1, 1, Direction::Sent));
        assert_eq!(trace.read(), traced(2, 1, Direction::Sent));
        assert_eq!(trace.read(), traced(4, 5, Direction::Received));
        assert_eq!(trace.read(), None);
        assert_eq!((trace.lost(), port.counters().refused), (0, 1));
    }

    #[test]
    fn a_full_trace_stops_nothing_and_counts_what_it_lacks() {
        let (port, _peer) = virtual_port(8);
        let (mut port, mut trace) = Tracer::new(port, 1);
        assert_eq!(port.send(at(1), &[frame(1), frame(2), frame(3)]), Ok(3));
        assert_eq!(trace.lost(), 2);
        assert!(trace.read().is_some());
        assert_eq!(port.send(at(2), &[frame(4)]), Ok(1));
        drop(port);
        assert_eq!(trace.read().map(|traced| traced.at), Some(at(2)));
    }
}
