//! Recording what passes through a port.
//!
//! [`Tracer`] wraps any port and never waits for the reader of the trace: what does not fit is counted
//! and left out. A frame of the trace is a line of a file as a [`candump::Entry`](crate::candump::Entry). A trace
//! without losses is enough to replay the port: see [`ReplayPort`](crate::ReplayPort).

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

/// One result of a call of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TraceEntry {
    /// Time that the caller of the port gave.
    pub now: Instant,
    /// The result.
    pub event: TraceEvent,
}

/// What a call of a port resulted in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TraceEvent {
    /// A frame passed.
    Frame(Traced),
    /// Frames were offered and not accepted. The accepted frames of the same call are traced before.
    Refused {
        /// Number of these frames.
        count: u32,
    },
    /// Sending or receiving failed.
    Failed {
        /// The call that failed.
        direction: Direction,
        /// The error.
        error: PortError,
    },
    /// The state of the CAN controller changed, or frames were lost, or error frames were counted.
    Condition {
        /// The call that showed the change.
        direction: Direction,
        /// The state after the call.
        state: ControllerState,
        /// Value of [`Counters::dropped`].
        dropped: u64,
        /// Value of [`Counters::errors`].
        errors: u64,
    },
}

/// State of a port that its frames do not show.
type Condition = (ControllerState, u64, u64);

/// A port that records its results.
///
/// Error frames, which the port below consumes, are in the trace as counts.
pub struct Tracer<P> {
    port: P,
    trace: Producer<TraceEntry>,
    lost: Arc<AtomicU64>,
    condition: Condition,
}

impl<P: Port> Tracer<P> {
    /// Wraps `port`; the trace holds up to `capacity` results that were not read yet.
    pub fn new(port: P, capacity: usize) -> (Self, TraceReader) {
        let (trace, entries) = RingBuffer::new(capacity);
        let lost = Arc::new(AtomicU64::new(0));
        let reader = TraceReader { entries, lost: Arc::clone(&lost) };
        (Self { port, trace, lost, condition: Condition::default() }, reader)
    }

    fn record(&mut self, now: Instant, event: TraceEvent) {
        if self.trace.push(TraceEntry { now, event }).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Records a change of what the frames do not show.
    fn look(&mut self, now: Instant, direction: Direction) {
        let Counters { dropped, errors, .. } = self.port.counters();
        let state = self.port.state();
        if self.condition != (state, dropped, errors) {
            self.condition = (state, dropped, errors);
            self.record(now, TraceEvent::Condition { direction, state, dropped, errors });
        }
    }
}

impl<P: Port> Port for Tracer<P> {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        let direction = Direction::Sent;
        let sent = self.port.send(now, frames);
        match sent {
            Ok(taken) => {
                for &frame in &frames[..taken] {
                    self.record(now, TraceEvent::Frame(Traced { at: now, frame, direction }));
                }
                if taken < frames.len() {
                    self.record(now, TraceEvent::Refused { count: (frames.len() - taken) as u32 });
                }
            }
            Err(error) => self.record(now, TraceEvent::Failed { direction, error }),
        }
        self.look(now, direction);
        sent
    }

    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        let direction = Direction::Received;
        let received = self.port.receive(now, into);
        match received {
            Ok(count) => {
                for &Received { frame, at } in &into[..count] {
                    self.record(now, TraceEvent::Frame(Traced { at, frame, direction }));
                }
            }
            Err(error) => self.record(now, TraceEvent::Failed { direction, error }),
        }
        self.look(now, direction);
        received
    }

    fn bound_unsent(&mut self, most: usize) -> Result<(), PortError> {
        self.port.bound_unsent(most)
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
    entries: Consumer<TraceEntry>,
    lost: Arc<AtomicU64>,
}

impl TraceReader {
    /// The oldest frame that was not read yet. Other results before it are left out.
    pub fn read(&mut self) -> Option<Traced> {
        loop {
            if let TraceEvent::Frame(traced) = self.read_entry()?.event {
                return Some(traced);
            }
        }
    }

    /// The oldest result that was not read yet.
    pub fn read_entry(&mut self) -> Option<TraceEntry> {
        self.entries.pop().ok()
    }

    /// Results left out of the trace since it was full.
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
        let traced = |id, now, nanos, direction| {
            let event = TraceEvent::Frame(Traced { at: at(nanos), frame: frame(id), direction });
            Some(TraceEntry { now: at(now), event })
        };
        assert_eq!(trace.read_entry(), traced(1, 1, 1, Direction::Sent));
        assert_eq!(trace.read_entry(), traced(2, 1, 1, Direction::Sent));
        assert_eq!(trace.read_entry(), Some(TraceEntry { now: at(1), event: TraceEvent::Refused { count: 1 } }));
        assert_eq!(trace.read_entry(), traced(4, 9, 5, Direction::Received));
        assert_eq!(trace.read_entry(), None);
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
