//! Node guarding (CiA 301): asking an old device by remote frames in which NMT state it is.
//!
//! CiA discourages remote frames, and many controllers and cards mishandle them: wherever a device has a
//! producer heartbeat time (object 0x1017), use the [heartbeat](crate::heartbeat) instead. A device whose
//! object 0x1017 is not 0 does not take part in guarding.

use std::time::Duration;

use can::{Frame, Id, Instant};

use crate::nmt::State;
use crate::{NodeId, cob, frame};

/// The question, a remote frame under `700 + node` for one byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    /// Who is asked.
    pub node: NodeId,
}

impl Request {
    /// The frame.
    pub fn encode(self) -> Frame {
        Frame::remote(cob::heartbeat(self.node), 1).expect("a remote frame may ask for one byte")
    }

    /// `None` for data frames and other identifiers. The length asked for does not matter.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let Some(Id::Standard(id)) = frame.id().filter(|_| frame.is_remote()) else {
            return None;
        };
        match cob::Function::of(id)? {
            cob::Function::Heartbeat(node) => Some(Self { node }),
            _ => None,
        }
    }
}

/// The answer: one byte, of which bit 7 alternates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Response {
    /// Who answers.
    pub node: NodeId,
    /// Alternates; `false` in the first answer after a boot or a reset of the communication.
    pub toggle: bool,
    /// Its NMT state, seven bits of it.
    pub state: State,
}

impl Response {
    /// The frame.
    pub fn encode(self) -> Frame {
        let byte = u8::from(self.toggle) << 7 | self.state.raw() & 0x7F;
        frame(cob::heartbeat(self.node), [byte])
    }

    /// `None` for other frames, remote frames and lengths other than one byte. A boot-up frame decodes to
    /// [`State::Initialising`].
    pub fn decode(frame: &Frame) -> Option<Self> {
        let cob::Function::Heartbeat(node) = cob::Function::of(frame.standard_data_id()?)? else {
            return None;
        };
        let &[byte] = frame.data() else { return None };
        Some(Self {
            node,
            toggle: byte & 0x80 != 0,
            state: State::from_raw(byte & 0x7F),
        })
    }
}

/// Guards one node: asks it each guard time, and notices when it no longer answers;
/// for programs of one's own.
///
/// The node's objects 0x100C (guard time, ms) and 0x100D (life time factor) are for its own watch over
/// this master; write them the same values. It is lost when it has given no answer with the right toggle bit
/// for the life time, the product of the two, since the guard began.
#[derive(Clone, Debug)]
pub struct Guard {
    node: NodeId,
    guard_time: Duration,
    life_time: Duration,
    due: Instant,
    heard: Instant,
    /// The toggle bit of the next answer; `None` before the first, which may have either.
    toggle: Option<bool>,
    state: Option<State>,
    lost: bool,
    events: Events,
}

#[derive(Clone, Copy, Debug, Default)]
struct Events {
    lost: Option<Duration>,
    toggle: bool,
    recovered: bool,
    changed: bool,
}

/// What became of a guarded node. Of several events of one kind between two polls the last is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// No answer for the life time; told once.
    Lost {
        /// Since the last answer, or since the guard began.
        waited: Duration,
    },
    /// An answer had the wrong toggle bit: one was lost, or another master asks as well. It did not count,
    /// and the next is expected to alternate with it.
    Toggle,
    /// It answers again after it was lost.
    Recovered {
        /// What it says.
        state: State,
    },
    /// It is in another state than it last said, or said its first.
    Changed {
        /// What it says.
        state: State,
    },
}

impl Guard {
    /// Guards `node` from `now` on, asking each `guard_time` (object 0x100C); it is lost after
    /// `life_time_factor` of them (object 0x100D). `None` if either is zero, which means no guarding.
    pub fn new(
        node: NodeId,
        guard_time: Duration,
        life_time_factor: u8,
        now: Instant,
    ) -> Option<Self> {
        (!guard_time.is_zero() && life_time_factor > 0).then_some(Self {
            node,
            guard_time,
            life_time: guard_time * u32::from(life_time_factor),
            due: now,
            heard: now,
            toggle: None,
            state: None,
            lost: false,
            events: Events::default(),
        })
    }

    /// What the node last said.
    pub fn state(&self) -> Option<State> {
        self.state
    }

    /// Whether it is lost now.
    pub fn is_lost(&self) -> bool {
        self.lost
    }

    /// Takes a frame from the bus.
    pub fn handle(&mut self, frame: &Frame, now: Instant) {
        let Some(Response {
            node,
            toggle,
            state,
        }) = Response::decode(frame)
        else {
            return;
        };
        if node != self.node {
            return;
        }
        self.handle_timeout(now);
        let booted = state == State::Initialising;
        let expected = if booted { None } else { self.toggle };
        // The answer to the first question after a boot has the toggle bit 0.
        self.toggle = Some(!booted && !toggle);
        if expected.is_some_and(|expected| expected != toggle) {
            self.events.toggle = true;
            return;
        }
        self.heard = now;
        if self.lost {
            self.lost = false;
            self.events.recovered = true;
        } else if self.state != Some(state) {
            self.events.changed = true;
        }
        self.state = Some(state);
    }

    /// The question, if it is due. Those that were missed are left out, not caught up.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        if now < self.due {
            return None;
        }
        self.due += self.guard_time;
        if self.due <= now {
            self.due = now + self.guard_time;
        }
        Some(Request { node: self.node }.encode())
    }

    /// When the next question is due, or the node is lost.
    pub fn poll_timeout(&self) -> Option<Instant> {
        let lost = (!self.lost).then_some(self.heard + self.life_time);
        Some(lost.map_or(self.due, |lost| lost.min(self.due)))
    }

    /// Notices at `now` that the node is lost.
    pub fn handle_timeout(&mut self, now: Instant) {
        if !self.lost && now >= self.heard + self.life_time {
            self.lost = true;
            self.events.lost = Some(now.since(self.heard));
            self.events.recovered = false;
            self.events.changed = false;
        }
    }

    /// What happened.
    pub fn poll(&mut self) -> Option<Event> {
        if let Some(waited) = self.events.lost.take() {
            return Some(Event::Lost { waited });
        }
        if std::mem::take(&mut self.events.toggle) {
            return Some(Event::Toggle);
        }
        let state = self.state?;
        if std::mem::take(&mut self.events.recovered) {
            self.events.changed = false;
            return Some(Event::Recovered { state });
        }
        std::mem::take(&mut self.events.changed).then_some(Event::Changed { state })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parse;

    const NODE: NodeId = NodeId::new(2).unwrap();

    fn at(millis: u64) -> Instant {
        Instant::from_nanos(millis * 1_000_000)
    }

    fn guard() -> Guard {
        Guard::new(NODE, Duration::from_millis(100), 3, at(0)).unwrap()
    }

    #[test]
    fn the_question_is_a_remote_frame_and_the_answer_one_byte() {
        let request = Request { node: NODE };
        assert_eq!(request.encode().to_string(), "702#R1");
        assert_eq!(Request::decode(&request.encode()), Some(request));
        assert_eq!(Request::decode(&parse("702#05")), None);
        assert_eq!(Request::decode(&Frame::remote(cob::SYNC, 1).unwrap()), None);
        let table = [
            (false, State::Operational, "702#05"),
            (true, State::Operational, "702#85"),
            (true, State::PreOperational, "702#FF"),
            (false, State::Stopped, "702#04"),
            (false, State::Initialising, "702#00"),
        ];
        for (toggle, state, bytes) in table {
            let response = Response {
                node: NODE,
                toggle,
                state,
            };
            assert_eq!(response.encode().to_string(), bytes);
            assert_eq!(Response::decode(&parse(bytes)), Some(response));
        }
        let beyond = Response {
            node: NODE,
            toggle: false,
            state: State::Unknown(0x85),
        };
        assert_eq!(beyond.encode().to_string(), "702#05");
        assert_eq!(Response::decode(&request.encode()), None);
        assert_eq!(Response::decode(&parse("702#0500")), None);
    }

    #[test]
    fn the_question_is_asked_each_guard_time_and_not_caught_up() {
        let mut guard = guard();
        let table = [
            (0, true),
            (0, false),
            (99, false),
            (105, true),
            (199, false),
            (450, true),
            (549, false),
            (550, true),
        ];
        for (millis, asked) in table {
            let sent = guard.poll_transmit(at(millis));
            assert_eq!(
                sent,
                asked.then(|| Request { node: NODE }.encode()),
                "at {millis} ms"
            );
        }
        for (millis, factor) in [(0, 3), (100, 0)] {
            assert!(Guard::new(NODE, Duration::from_millis(millis), factor, at(0)).is_none());
        }
    }

    #[test]
    fn loss_return_state_and_toggle_are_told() {
        let changed = |state| Some(Event::Changed { state });
        let mut guard = guard();
        let table = [
            // The first answer may have either toggle bit.
            (10, Some("702#FF"), changed(State::PreOperational)),
            (110, Some("702#7F"), None),
            (210, Some("702#85"), changed(State::Operational)),
            // The answer to the third was lost.
            (410, Some("702#85"), Some(Event::Toggle)),
            (509, None, None),
            (
                510,
                None,
                Some(Event::Lost {
                    waited: Duration::from_millis(300),
                }),
            ),
            (900, Some("703#05"), None),
            (
                910,
                Some("702#05"),
                Some(Event::Recovered {
                    state: State::Operational,
                }),
            ),
            // The node boots, and its toggle bit restarts.
            (950, Some("702#00"), changed(State::Initialising)),
            (1010, Some("702#7F"), changed(State::PreOperational)),
            (1110, Some("702#7F"), Some(Event::Toggle)),
            (1210, Some("702#FF"), None),
        ];
        for (millis, frame, event) in table {
            guard.handle_timeout(at(millis));
            if let Some(frame) = frame {
                guard.handle(&parse(frame), at(millis));
            }
            assert_eq!(guard.poll(), event, "at {millis} ms");
            assert_eq!(guard.poll(), None);
        }
        assert_eq!(guard.state(), Some(State::PreOperational));
        assert!(!guard.is_lost());
    }

    #[test]
    fn a_node_that_no_longer_answers_is_lost_once() {
        let mut guard = guard();
        assert_eq!(guard.poll_timeout(), Some(at(0)));
        guard.handle(&parse("702#05"), at(50));
        assert!(guard.poll().is_some());
        for millis in [0, 100, 200, 300] {
            assert!(guard.poll_transmit(at(millis)).is_some());
        }
        assert_eq!(guard.poll_timeout(), Some(at(350)));
        guard.handle_timeout(at(350));
        guard.handle_timeout(at(700));
        let waited = Duration::from_millis(300);
        assert_eq!(guard.poll(), Some(Event::Lost { waited }));
        assert_eq!(guard.poll(), None);
        assert!(guard.is_lost());
    }

    #[test]
    fn a_late_answer_cannot_hide_the_loss() {
        let mut guard = guard();
        guard.handle(&parse("702#05"), at(0));
        guard.handle(&parse("702#85"), at(300));
        let waited = Duration::from_millis(300);
        assert_eq!(guard.poll(), Some(Event::Lost { waited }));
        let state = State::Operational;
        assert_eq!(guard.poll(), Some(Event::Recovered { state }));
        assert_eq!(guard.poll(), None);
    }
}
