//! A port that repeats the results of a trace.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::candump::Direction;
use crate::{ControllerState, Counters, Frame, Instant, Port, PortError, Received, TraceEntry, TraceEvent, Traced};

/// The entries that a replayed port has not repeated yet.
#[derive(Default)]
struct Trace {
    received: VecDeque<TraceEntry>,
    sent: VecDeque<TraceEntry>,
    conditions: VecDeque<TraceEntry>,
}

impl Trace {
    fn push(&mut self, entry: TraceEntry) {
        match entry.event {
            TraceEvent::Frame(Traced { direction: Direction::Received, .. })
            | TraceEvent::Failed { direction: Direction::Received, .. } => self.received.push_back(entry),
            TraceEvent::Refused { .. } | TraceEvent::Failed { direction: Direction::Sent, .. } => {
                self.sent.push_back(entry);
            }
            TraceEvent::Frame(Traced { direction: Direction::Sent, .. }) => {}
            TraceEvent::Condition { .. } => self.conditions.push_back(entry),
        }
    }
}

/// A port that repeats what a [`Tracer`](crate::Tracer) recorded.
///
/// A call at a given time receives the frames of all calls up to this time that were not received yet. Errors, refusals
/// and states of the CAN controller appear in the calls in which they were recorded. The port accepts all other frames
/// for sending.
pub struct ReplayPort {
    trace: Arc<Mutex<Trace>>,
    counters: Counters,
    state: ControllerState,
}

/// The end of a [`ReplayPort`] that adds entries, for a trace that is longer than the memory.
pub struct ReplayFeed(Arc<Mutex<Trace>>);

impl ReplayFeed {
    /// Adds an entry. The entries come in order of time, each before the call at its time.
    pub fn push(&self, entry: TraceEntry) {
        locked(&self.0).push(entry);
    }

    /// Number of entries that the port has not repeated yet.
    pub fn unread(&self) -> usize {
        let trace = locked(&self.0);
        trace.received.len() + trace.sent.len() + trace.conditions.len()
    }
}

impl ReplayPort {
    /// A port that repeats `entries`, in order of time.
    pub fn new(entries: impl IntoIterator<Item = TraceEntry>) -> Self {
        let (port, feed) = Self::fed();
        entries.into_iter().for_each(|entry| feed.push(entry));
        port
    }

    /// A port without entries, and the end that adds them.
    pub fn fed() -> (Self, ReplayFeed) {
        let trace = Arc::<Mutex<Trace>>::default();
        let port = Self { trace: Arc::clone(&trace), counters: Counters::default(), state: ControllerState::Active };
        (port, ReplayFeed(trace))
    }

    /// Takes the conditions that the recorded port showed by the end of this call.
    fn condition(&mut self, now: Instant, call: Direction) {
        let mut trace = locked(&self.trace);
        while let Some(&TraceEntry { now: recorded, event }) = trace.conditions.front() {
            let TraceEvent::Condition { direction, state, dropped, errors } = event else { break };
            // A cycle receives before it sends, and gives the same time to both calls.
            if recorded > now || recorded == now && call == Direction::Received && direction == Direction::Sent {
                break;
            }
            self.counters.count_state(self.state, state);
            (self.state, self.counters.dropped, self.counters.errors) = (state, dropped, errors);
            trace.conditions.pop_front();
        }
    }
}

/// The trace. A panic of another user of the trace leaves whole entries.
fn locked(trace: &Mutex<Trace>) -> MutexGuard<'_, Trace> {
    trace.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Port for ReplayPort {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        let mut trace = locked(&self.trace);
        while trace.sent.front().is_some_and(|entry| entry.now < now) {
            trace.sent.pop_front();
        }
        let outcome = trace.sent.front().filter(|entry| entry.now == now).map(|entry| entry.event);
        if outcome.is_some() {
            trace.sent.pop_front();
        }
        drop(trace);
        let sent = match outcome {
            Some(TraceEvent::Failed { error, .. }) => Err(error),
            Some(TraceEvent::Refused { count }) => Ok(frames.len().saturating_sub(count as usize)),
            _ => Ok(frames.len()),
        };
        let taken = sent.unwrap_or(0);
        self.counters.count_sent(&frames[..taken]);
        self.counters.refused += (frames.len() - taken) as u64;
        self.condition(now, Direction::Sent);
        sent
    }

    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        let mut count = 0;
        let mut failure = None;
        let mut trace = locked(&self.trace);
        while count < into.len() {
            let Some(entry) = trace.received.front().filter(|entry| entry.now <= now) else { break };
            match entry.event {
                TraceEvent::Frame(Traced { at, frame, .. }) => {
                    into[count] = Received { frame, at };
                    count += 1;
                }
                // The frames come first, and the next call fails.
                TraceEvent::Failed { .. } if count > 0 => break,
                TraceEvent::Failed { error, .. } => failure = Some(error),
                TraceEvent::Refused { .. } | TraceEvent::Condition { .. } => {}
            }
            trace.received.pop_front();
            if failure.is_some() {
                break;
            }
        }
        drop(trace);
        self.counters.count_received(&into[..count]);
        self.condition(now, Direction::Received);
        failure.map_or(Ok(count), Err)
    }

    fn counters(&self) -> Counters {
        self.counters
    }

    fn state(&self) -> ControllerState {
        self.state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::timing::bits_on_wire;
    use crate::{StandardId, Tracer, virtual_port};

    fn frame(id: u16) -> Frame {
        Frame::new(StandardId::new(id).unwrap(), &[id as u8]).unwrap()
    }

    fn at(nanos: u64) -> Instant {
        Instant::from_nanos(nanos)
    }

    /// The results of three calls of each kind.
    fn calls(port: &mut impl Port, mut before: impl FnMut(u64)) -> Vec<String> {
        let mut results = Vec::new();
        for cycle in 0..5 {
            before(cycle);
            let now = at(cycle * 100);
            let mut into = [Received { frame: frame(0), at: at(0) }; 8];
            let received = port.receive(now, &mut into);
            results.push(format!("{received:?} {:?}", &into[..received.unwrap_or(0)]));
            let frames: Vec<_> = (0..cycle as u16).map(frame).collect();
            results.push(format!("{:?} {:?} {:?}", port.send(now, &frames), port.state(), port.counters()));
        }
        results
    }

    #[test]
    fn a_replayed_port_gives_the_results_of_the_recorded_one() {
        let (port, peer) = virtual_port(4);
        let (mut port, mut trace) = Tracer::new(port, 64);
        let mut peer = Some(peer);
        let live = calls(&mut port, |cycle| match (cycle, &mut peer) {
            (0 | 2, Some(peer)) => {
                peer.deliver(Received { frame: frame(7), at: at(cycle * 100 - cycle) }, bits_on_wire(&frame(7)));
                peer.deliver(Received { frame: frame(8), at: at(cycle * 100 + 50) }, bits_on_wire(&frame(8)));
            }
            // Sending and receiving fail from now on.
            (4, _) => peer = None,
            _ => {}
        });
        assert!(
            live.iter().any(|it| it.contains("Gone")) && live.iter().any(|it| it.contains("refused: 2")),
            "{live:#?}"
        );
        let entries: Vec<_> = std::iter::from_fn(|| trace.read_entry()).collect();
        assert_eq!(calls(&mut ReplayPort::new(entries.iter().copied()), |_| {}), live);
        let (mut replayed, feed) = ReplayPort::fed();
        let of = |cycle: u64| entries.iter().filter(move |entry| entry.now == at(cycle * 100));
        assert_eq!(calls(&mut replayed, |cycle| of(cycle).for_each(|&entry| feed.push(entry))), live);
        assert_eq!(feed.unread(), 0);
    }

    #[test]
    fn a_state_found_by_sending_is_not_known_to_the_reception_before() {
        let condition = |direction| TraceEntry {
            now: at(5),
            event: TraceEvent::Condition { direction, state: ControllerState::BusOff, dropped: 1, errors: 2 },
        };
        let mut port = ReplayPort::new([condition(Direction::Sent)]);
        assert_eq!(port.receive(at(5), &mut []), Ok(0));
        assert_eq!(port.state(), ControllerState::Active);
        assert_eq!(port.send(at(5), &[]), Ok(0));
        assert_eq!((port.state(), port.counters().errors), (ControllerState::BusOff, 2));
        assert_eq!(port.counters().bus_off, 1);
        let mut port = ReplayPort::new([condition(Direction::Received)]);
        assert_eq!(port.receive(at(5), &mut []), Ok(0));
        assert_eq!(port.state(), ControllerState::BusOff);
    }
}
