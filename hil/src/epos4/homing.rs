//! The search for a reference (CiA 402-2 §11.3): direction, events, and conditions of failure.
//!
//! A search is a sequence of phases, each of which a method may leave out:
//!
//! ```text
//! seek the switch or stop ──▶ turn and leave it ──▶ go on to the index ──▶ found
//! ```
//!
//! Home switch methods turn once at a limit switch. A second limit switch, or no index within two motor turns, ends
//! the search as failed. The reference of a switch is the position at which the switch opens as the axis leaves. The
//! reference of a stop is the position at which the current has exceeded its threshold for 5 ms. The documents that
//! were read do not define EPOS4's reaction to a missing switch or index.

use canopen::cia402::HomingMethod;

use crate::Feedback;

/// Time for which the current must stay above the threshold, s.
const STOP_TIME: f64 = 5e-3;
/// Time for which a switch must stay closed before its opening counts, s. Contacts bounce when the axis enters the
/// switch. After a turn at a limit switch the axis enters and leaves in the same direction, so that a bounce could be
/// taken for the opening.
const SETTLING: f64 = 5e-3;
/// Number of motor turns within which an index must come.
const INDEX_TURNS: f64 = 2.0;

/// Next move of the search. The sign of the value is the direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Progress {
    /// Move at the speed for switches (0x6099:1) in this direction.
    Fast(f64),
    /// Move at the speed for the zero (0x6099:2) in this direction.
    Slow(f64),
    /// Move as in [`Progress::Slow`], with the index latch armed again from here.
    ArmIndex(f64),
    /// The reference, as a count of the raw counter.
    Found(i32),
    Failed,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Search {
    sought: Sought,
    index: bool,
    /// Direction of the first move. The axis leaves a switch or stop in the opposite direction.
    initial: f64,
    phase: Phase,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Sought {
    Nothing,
    Limit,
    Home,
    Stop,
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    Seek {
        direction: f64,
        pressing: f64,
    },
    /// Time for which the switch was closed at first, and time for which it has been open since, s.
    Leave {
        closed_for: f64,
        open_for: f64,
    },
    Index {
        direction: f64,
        begun_at: Option<i32>,
    },
    /// The reference is the present position.
    Here,
}

/// Inputs of a search in addition to the sensors.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surroundings {
    /// Demanded velocity, counts/s.
    pub(super) velocity: f64,
    /// Torque that indicates a stop, N·m.
    pub(super) stop_torque: f64,
    /// Counts of one motor turn.
    pub(super) turn: f64,
    /// Time since the last step, s.
    pub(super) dt: f64,
}

impl Search {
    /// A search by `method`; `None` for a method that EPOS4 does not have.
    pub(super) fn new(method: HomingMethod) -> Option<Self> {
        use HomingMethod as M;
        let (sought, initial, index) = match method {
            M::ACTUAL_POSITION => (Sought::Nothing, 0.0, false),
            M::INDEX_POSITIVE => (Sought::Nothing, 1.0, true),
            M::INDEX_NEGATIVE => (Sought::Nothing, -1.0, true),
            M::HOME_POSITIVE => (Sought::Home, 1.0, false),
            M::HOME_POSITIVE_INDEX => (Sought::Home, 1.0, true),
            M::HOME_NEGATIVE => (Sought::Home, -1.0, false),
            M::HOME_NEGATIVE_INDEX => (Sought::Home, -1.0, true),
            M::POSITIVE_LIMIT => (Sought::Limit, 1.0, false),
            M::POSITIVE_LIMIT_INDEX => (Sought::Limit, 1.0, true),
            M::NEGATIVE_LIMIT => (Sought::Limit, -1.0, false),
            M::NEGATIVE_LIMIT_INDEX => (Sought::Limit, -1.0, true),
            M::CURRENT_POSITIVE => (Sought::Stop, 1.0, false),
            M::CURRENT_POSITIVE_INDEX => (Sought::Stop, 1.0, true),
            M::CURRENT_NEGATIVE => (Sought::Stop, -1.0, false),
            M::CURRENT_NEGATIVE_INDEX => (Sought::Stop, -1.0, true),
            _ => return None,
        };
        let phase = match (sought, index) {
            (Sought::Nothing, false) => Phase::Here,
            (Sought::Nothing, true) => Phase::Index { direction: initial, begun_at: None },
            _ => Phase::Seek { direction: initial, pressing: 0.0 },
        };
        Some(Self { sought, index, initial, phase })
    }

    /// Whether the search drives the axis against a stop, so that the axis falls behind its set-points.
    pub(super) fn feels_for_stop(&self) -> bool {
        self.sought == Sought::Stop
    }

    /// Evaluates the sensors and returns the next move.
    pub(super) fn step(&mut self, feedback: &Feedback, around: &Surroundings) -> Progress {
        match &mut self.phase {
            Phase::Here => Progress::Found(feedback.counts),
            Phase::Seek { direction, pressing } => {
                *pressing = if feedback.torque.abs() > around.stop_torque { *pressing + around.dt } else { 0.0 };
                let limit = limit_ahead(feedback, *direction);
                let found = match self.sought {
                    Sought::Home => feedback.home_switch,
                    Sought::Limit => limit,
                    Sought::Stop => *pressing >= STOP_TIME,
                    Sought::Nothing => true,
                };
                if found && self.sought == Sought::Stop {
                    return self.reference(feedback.counts);
                }
                if found {
                    // The switch of a standing axis does not bounce.
                    let stands = around.velocity == 0.0;
                    self.phase = Phase::Leave { closed_for: if stands { SETTLING } else { 0.0 }, open_for: 0.0 };
                    return Progress::Slow(-self.initial);
                }
                if limit && self.sought == Sought::Home {
                    if *direction != self.initial {
                        return Progress::Failed;
                    }
                    *direction = -self.initial;
                }
                Progress::Fast(*direction)
            }
            Phase::Leave { closed_for, open_for } => {
                let direction = -self.initial;
                let closed = match self.sought {
                    Sought::Home => feedback.home_switch,
                    _ => limit_ahead(feedback, self.initial),
                };
                let leaving = around.velocity * direction > 0.0;
                let settled = *closed_for >= SETTLING;
                if closed {
                    *closed_for += around.dt;
                    *open_for = 0.0;
                } else if settled && leaving {
                    return self.reference(feedback.counts);
                } else if !settled {
                    *closed_for = 0.0;
                    *open_for += around.dt;
                }
                if *open_for >= SETTLING {
                    // The axis turned round on the edge of the switch.
                    self.phase = Phase::Seek { direction: self.initial, pressing: 0.0 };
                    Progress::Fast(self.initial)
                } else if leaving && limit_ahead(feedback, direction) {
                    Progress::Failed
                } else {
                    Progress::Slow(direction)
                }
            }
            Phase::Index { direction, begun_at: begun_at @ None } => {
                *begun_at = Some(feedback.counts);
                Progress::ArmIndex(*direction)
            }
            Phase::Index { direction, begun_at: Some(begun_at) } => {
                let way = f64::from(feedback.counts.wrapping_sub(*begun_at)).abs();
                match feedback.index {
                    Some(index) => Progress::Found(index),
                    None if way > INDEX_TURNS * around.turn => Progress::Failed,
                    None if limit_ahead(feedback, *direction) => Progress::Failed,
                    None => Progress::Slow(*direction),
                }
            }
        }
    }

    /// Handles the switch or stop at `counts`: it is the reference, or the search goes on to the index.
    fn reference(&mut self, counts: i32) -> Progress {
        if !self.index {
            return Progress::Found(counts);
        }
        self.phase = Phase::Index { direction: -self.initial, begun_at: Some(counts) };
        Progress::ArmIndex(-self.initial)
    }
}

fn limit_ahead(feedback: &Feedback, direction: f64) -> bool {
    if direction > 0.0 { feedback.positive_limit } else { feedback.negative_limit }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A scripted axis: 1000 counts a turn with an index at 300 of each, limits at ±5000, the home switch from 1000
    /// to 2000, stops at ±6000. The axis follows each command exactly, in steps of one millisecond.
    struct Scripted {
        counts: f64,
        velocity: f64,
        latched: Option<i32>,
        home: bool,
        limits: bool,
        index: bool,
        /// Bounce time of the home switch, ms, and the time since its last edge, ms.
        bounce: u32,
        since: u32,
    }

    impl Scripted {
        fn at(counts: f64) -> Self {
            Self { counts, velocity: 0.0, latched: None, home: true, limits: true, index: true, bounce: 0, since: 100 }
        }

        fn pressed(&self) -> bool {
            self.home && (1000.0..=2000.0).contains(&self.counts)
        }

        fn feedback(&self) -> Feedback {
            Feedback {
                counts: self.counts as i32,
                velocity: self.velocity,
                torque: if self.counts.abs() >= 6000.0 { 1.0 } else { 0.1 },
                current: 0.0,
                index: self.latched,
                home_switch: self.pressed() && (self.since >= self.bounce || self.since.is_multiple_of(2)),
                negative_limit: self.limits && self.counts <= -5000.0,
                positive_limit: self.limits && self.counts >= 5000.0,
                trip: None,
            }
        }

        fn go(&mut self, velocity: f64) {
            let before = (self.counts - 300.0) / 1000.0;
            let pressed = self.pressed();
            self.velocity = velocity;
            self.counts = (self.counts + velocity).clamp(-6000.0, 6000.0);
            let after = (self.counts - 300.0) / 1000.0;
            let passed = before.max(after).floor();
            if self.index && passed > before.min(after) {
                self.latched = Some(passed as i32 * 1000 + 300);
            }
            self.since = if self.pressed() == pressed { self.since + 1 } else { 0 };
        }

        /// The reference that a method finds; `None` if the method fails.
        fn home(mut self, method: i8) -> Option<i32> {
            let mut search = Search::new(HomingMethod(method)).unwrap();
            for _ in 0..100_000 {
                let around = Surroundings { velocity: self.velocity, stop_torque: 0.5, turn: 1000.0, dt: 1e-3 };
                match search.step(&self.feedback(), &around) {
                    Progress::Fast(direction) => self.go(20.0 * direction),
                    Progress::Slow(direction) => self.go(direction),
                    Progress::ArmIndex(direction) => {
                        self.latched = None;
                        self.go(direction);
                    }
                    Progress::Found(counts) => return Some(counts),
                    Progress::Failed => return None,
                }
            }
            panic!("method {method} does not end");
        }
    }

    #[test]
    fn each_method_finds_its_reference_from_anywhere() {
        // Method, start position, and reference found. Switches open one count past their edge.
        let table = [
            (37, 1234.0, 1234),
            (34, 0.0, 300),
            (34, 301.0, 1300),
            (33, 0.0, -700),
            (33, 1299.0, 300),
            (17, 0.0, -4999),
            (17, -5500.0, -4999),
            (1, 0.0, -4700),
            (18, 0.0, 4999),
            (2, 0.0, 4300),
            // The home switch is ahead, at the axis, or behind. In the last case the axis turns at the limit switch.
            (23, 0.0, 999),
            (23, 1500.0, 999),
            (23, 3000.0, 999),
            (7, 0.0, 300),
            (7, 3000.0, 300),
            (27, 3000.0, 2001),
            (27, 1500.0, 2001),
            (27, 0.0, 2001),
            (11, 3000.0, 2300),
            (11, 0.0, 2300),
            (-3, 0.0, 6000),
            (-4, 0.0, -6000),
            (-1, 0.0, 5300),
            (-2, 0.0, -5700),
        ];
        for (method, start, expected) in table {
            let mut axis = Scripted::at(start);
            axis.limits = method > 0;
            assert_eq!(axis.home(method), Some(expected), "method {method} from {start}");
        }
    }

    #[test]
    fn a_chattering_switch_leads_to_the_same_reference_from_either_side() {
        for bounce in [0, 2, 4] {
            for (method, start, expected) in
                [(11, 3000.0, 2300), (11, 2010.0, 2300), (11, 1500.0, 2300), (11, 0.0, 2300), (7, 4000.0, 300)]
            {
                let mut axis = Scripted::at(start);
                axis.bounce = bounce;
                let found = axis.home(method);
                assert_eq!(found, Some(expected), "{method} from {start}, {bounce} ms");
            }
        }
    }

    #[test]
    fn a_search_without_its_switch_or_index_fails() {
        for method in [7, 11, 23, 27] {
            let mut axis = Scripted::at(0.0);
            axis.home = false;
            assert_eq!(axis.home(method), None, "method {method}");
        }
        for method in [33, 34, 1, 2, 7, 11] {
            let mut axis = Scripted::at(0.0);
            axis.index = false;
            assert_eq!(axis.home(method), None, "method {method}");
        }
    }

    #[test]
    fn methods_that_epos4_lacks_are_none() {
        for method in i8::MIN..=i8::MAX {
            let method = HomingMethod(method);
            let known = HomingMethod::EPOS4.contains(&method);
            assert_eq!(Search::new(method).is_some(), known, "{method:?}");
        }
    }
}
