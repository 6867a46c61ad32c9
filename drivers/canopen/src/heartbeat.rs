//! Heartbeat and boot-up (CiA 301): a node says each producer time (object 0x1017) in which NMT
//! state it is. [`Consumer`] notices when it no longer does, [`Producer`] speaks for this host.

use std::time::Duration;

use can::{Frame, Instant};

use crate::nmt::State;
use crate::{NodeId, cob, frame};

/// A heartbeat frame, `700 + node#state`; with [`State::Initialising`] it is the boot-up frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// Who speaks.
    pub node: NodeId,
    /// Its NMT state.
    pub state: State,
}

impl Heartbeat {
    /// The frame.
    pub fn encode(self) -> Frame {
        frame(cob::heartbeat(self.node), [self.state.raw()])
    }

    /// `None` for other frames, remote frames and lengths other than one byte.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let cob::Function::Heartbeat(node) = cob::Function::of(frame.standard_data_id()?)? else {
            return None;
        };
        let &[state] = frame.data() else { return None };
        Some(Self {
            node,
            state: State::from_raw(state),
        })
    }
}

/// Watches the heartbeat of one node.
///
/// The watch begins with the first heartbeat, or with [`Consumer::start`]. A boot-up frame is a sign of life but does
/// not begin it: a node that has just booted may not produce heartbeats yet. A node that stops producing heartbeats
/// because it booted is lost when its time is over.
#[derive(Clone, Debug)]
pub struct Consumer {
    node: NodeId,
    time: Duration,
    last: Instant,
    watch: Watch,
    lost: Option<Duration>,
    recovered: Option<State>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Watch {
    NotStarted,
    Alive,
    Lost,
}

/// What became of a heartbeat. Of several losses between two polls the last is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// None came for the consumer's time; told once.
    Lost {
        /// Since the last sign of life.
        waited: Duration,
    },
    /// It is back after it was lost.
    Recovered {
        /// What the node says.
        state: State,
    },
}

impl Consumer {
    /// Watches `node`, which has to speak at least once each `time`; take it longer than the producer
    /// time by the worst delay of the bus.
    pub fn new(node: NodeId, time: Duration) -> Self {
        Self {
            node,
            time,
            last: Instant::ZERO,
            watch: Watch::NotStarted,
            lost: None,
            recovered: None,
        }
    }

    /// Starts or restarts the watch without waiting for a heartbeat.
    pub fn start(&mut self, now: Instant) {
        self.last = now;
        self.watch = Watch::Alive;
    }

    /// Whether the heartbeat is lost now.
    pub fn is_lost(&self) -> bool {
        self.watch == Watch::Lost
    }

    /// Takes a frame from the bus.
    pub fn handle(&mut self, frame: &Frame, now: Instant) {
        let Some(Heartbeat { node, state }) = Heartbeat::decode(frame) else {
            return;
        };
        if node != self.node {
            return;
        }
        self.handle_timeout(now);
        match (self.watch, state) {
            (Watch::NotStarted, State::Initialising) => return,
            (Watch::NotStarted | Watch::Alive, _) => {}
            (Watch::Lost, _) => self.recovered = Some(state),
        }
        self.start(now);
    }

    /// When the next heartbeat is overdue.
    pub fn poll_timeout(&self) -> Option<Instant> {
        (self.watch == Watch::Alive).then(|| self.last + self.time)
    }

    /// Notices at `now` that the heartbeat is overdue.
    pub fn handle_timeout(&mut self, now: Instant) {
        if self.poll_timeout().is_some_and(|deadline| now >= deadline) {
            self.watch = Watch::Lost;
            self.lost = Some(now.since(self.last));
            self.recovered = None;
        }
    }

    /// What happened, in its order.
    pub fn poll(&mut self) -> Option<Event> {
        let lost = self.lost.take().map(|waited| Event::Lost { waited });
        lost.or_else(|| {
            self.recovered
                .take()
                .map(|state| Event::Recovered { state })
        })
    }
}

/// Speaks for a node of ours, so that drives notice when this host dies (object 0x1016).
#[derive(Clone, Debug)]
pub struct Producer {
    heartbeat: Heartbeat,
    period: Duration,
    due: Instant,
}

impl Producer {
    /// Speaks as `node` each `period`, first at `now`; `None` for a period of zero.
    pub fn new(node: NodeId, period: Duration, now: Instant) -> Option<Self> {
        let heartbeat = Heartbeat {
            node,
            state: State::PreOperational,
        };
        (!period.is_zero()).then_some(Self {
            heartbeat,
            period,
            due: now,
        })
    }

    /// What it says from now on.
    pub fn set_state(&mut self, state: State) {
        self.heartbeat.state = state;
    }

    /// The heartbeat, if it is due. Periods that were missed are left out, not caught up.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        if now < self.due {
            return None;
        }
        self.due += self.period;
        if self.due <= now {
            self.due = now + self.period;
        }
        Some(self.heartbeat.encode())
    }

    /// When the next heartbeat is due.
    pub fn poll_timeout(&self) -> Option<Instant> {
        Some(self.due)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parse;

    fn node(raw: u8) -> NodeId {
        NodeId::new(raw).unwrap()
    }

    #[test]
    fn heartbeats_are_one_byte_on_0x700_plus_node() {
        let table = [
            (State::Initialising, "702#00"),
            (State::Stopped, "702#04"),
            (State::Operational, "702#05"),
            (State::PreOperational, "702#7F"),
            (State::Unknown(0x85), "702#85"),
        ];
        for (state, bytes) in table {
            let heartbeat = Heartbeat {
                node: node(2),
                state,
            };
            assert_eq!(heartbeat.encode().to_string(), bytes);
            assert_eq!(Heartbeat::decode(&heartbeat.encode()), Some(heartbeat));
        }
    }

    #[test]
    fn guarding_requests_and_wrong_lengths_are_no_heartbeats() {
        let id = cob::heartbeat(node(2));
        assert_eq!(Heartbeat::decode(&Frame::remote(id, 1).unwrap()), None);
        assert_eq!(Heartbeat::decode(&Frame::new(id, &[]).unwrap()), None);
        assert_eq!(Heartbeat::decode(&Frame::new(id, &[5, 0]).unwrap()), None);
        assert_eq!(
            Heartbeat::decode(&Frame::new(cob::SYNC, &[5]).unwrap()),
            None
        );
    }

    fn at(millis: u64) -> Instant {
        Instant::from_nanos(millis * 1_000_000)
    }

    fn consumer() -> Consumer {
        Consumer::new(node(2), Duration::from_millis(100))
    }

    fn lost(millis: u64) -> Option<Event> {
        Some(Event::Lost {
            waited: Duration::from_millis(millis),
        })
    }

    #[test]
    fn a_lost_heartbeat_is_told_once_and_its_return_too() {
        let mut consumer = consumer();
        assert_eq!(consumer.poll_timeout(), None);
        let table = [
            (0, Some("702#05"), None),
            (99, None, None),
            (100, None, lost(100)),
            (300, None, None),
            (
                310,
                Some("702#7F"),
                Some(Event::Recovered {
                    state: State::PreOperational,
                }),
            ),
            (400, Some("702#05"), None),
            (410, None, None),
            (500, None, lost(100)),
        ];
        for (millis, frame, event) in table {
            consumer.handle_timeout(at(millis));
            if let Some(frame) = frame {
                consumer.handle(&parse(frame), at(millis));
            }
            assert_eq!(consumer.poll(), event, "at {millis} ms");
            assert_eq!(consumer.poll(), None);
        }
        assert!(consumer.is_lost());
    }

    #[test]
    fn a_late_heartbeat_cannot_hide_the_loss() {
        let mut consumer = consumer();
        consumer.handle(&parse("702#05"), at(0));
        consumer.handle(&parse("702#05"), at(150));
        assert_eq!(consumer.poll(), lost(150));
        assert_eq!(
            consumer.poll(),
            Some(Event::Recovered {
                state: State::Operational
            })
        );
    }

    #[test]
    fn a_loss_after_a_return_nobody_polled_is_the_last_word() {
        let mut consumer = consumer();
        consumer.handle(&parse("702#05"), at(0));
        consumer.handle(&parse("702#05"), at(150));
        consumer.handle_timeout(at(250));
        assert_eq!(consumer.poll(), lost(100));
        assert_eq!(consumer.poll(), None);
    }

    #[test]
    fn the_watch_begins_with_a_heartbeat_or_by_hand_but_not_with_a_boot_up() {
        let mut unheard = consumer();
        for frame in ["702#00", "703#05", "602#4041600000000000"] {
            unheard.handle(&parse(frame), at(0));
            assert_eq!(unheard.poll_timeout(), None, "{frame}");
        }
        let mut started = consumer();
        started.start(at(0));
        started.handle_timeout(at(100));
        assert_eq!(started.poll(), lost(100));
    }

    #[test]
    fn a_node_that_falls_silent_by_booting_is_lost() {
        let mut consumer = consumer();
        consumer.handle(&parse("702#05"), at(0));
        consumer.handle(&parse("702#00"), at(50));
        assert_eq!(consumer.poll_timeout(), Some(at(150)));
        consumer.handle_timeout(at(150));
        assert_eq!(consumer.poll(), lost(100));
    }

    #[test]
    fn the_producer_keeps_its_grid_and_leaves_out_what_it_missed() {
        assert!(Producer::new(node(127), Duration::ZERO, at(0)).is_none());
        let mut producer = Producer::new(node(127), Duration::from_millis(10), at(5)).unwrap();
        let table = [
            (4, None),
            (5, Some("77F#7F")),
            (5, None),
            (14, None),
            (16, Some("77F#7F")),
            (24, None),
            (25, Some("77F#05")),
            (58, Some("77F#05")),
            (58, None),
            (67, None),
            (68, Some("77F#05")),
        ];
        for (millis, frame) in table {
            if millis == 25 {
                producer.set_state(State::Operational);
            }
            let sent = producer
                .poll_transmit(at(millis))
                .map(|frame| frame.to_string());
            assert_eq!(sent.as_deref(), frame, "at {millis} ms");
        }
    }
}
