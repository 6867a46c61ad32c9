//! Evidence of a search for the reference: what statusword and counter of a drive show since the start bit.
//!
//! A drive may show the result of an earlier search until it begins the new one, for longer than a controlword takes to
//! its effect. A result counts only after a sign of the new search:
//! - the drive shows that it searches;
//! - the result differs from the one before the start bit took effect;
//! - the counter jumps to the zero of the method, faster than a search moves the motor.
//!
//! A search may also begin and end between two samples, and a method without motion shows nothing but its result. The
//! counter then decides: it must read zero where the motor stands. After a method with motion, the motor must also have
//! moved, or the axis must have had its reference before.
//!
//! After every search, the counter must agree with the zero of the method. A drive brakes behind its reference, or
//! returns to it.

use std::f64::consts::TAU;
use std::time::Duration;

use can::Instant;
use canopen::NodeId;
use canopen::cia402::{HomingMethod, HomingStatus};

use super::axis::ANSWERS_TO_EFFECT;
use super::config::{AxisConfig, GroupConfig};
use super::measurement::{ROUNDING, SHORTEST};
use super::program::MAXON;
use crate::{Fault, Increments};

/// Number of answers after the start bit that were sampled before the bit could take effect. The SYNC of the cycle
/// precedes the start bit, and the next SYNC samples before the drive acts on the bit.
const ANSWERS_BEFORE_EFFECT: u32 = 2;

/// Greatest distance between counters of a motor at rest, increments and turns of the motor; the greater one counts.
const AT_REST: (u32, f64) = (4, 1.0 / 2000.0);

/// Fraction of the search speed below which a motor counts as still.
const STILL: f64 = 0.01;

/// Factor on the search speed beyond which a displacement is a step of the counter.
const STEP: f64 = 4.0;

/// Conditions of the searches of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SearchRules {
    /// Longest time from the start bit to the first sign of a search.
    start_timeout: Duration,
    /// The reference is where the motor stands: methods 35 and 37.
    in_place: bool,
    /// Greatest distance of the counter from zero after a search, increments. `None` if the zero of the method is
    /// unknown.
    most: Option<u32>,
    /// Greatest distance between counters of a motor at rest, increments.
    at_rest: u32,
    /// Greatest speed of a motor in a search, increments/s.
    fastest: f64,
    /// Shortest time between two samples that the check for steps of the counter allows for.
    shortest: Duration,
}

/// Reason why a search failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SearchFailure {
    /// The drive reports the failure.
    Reported,
    /// No sign of a search in this time since the start bit.
    NotSeen { waited: Duration },
    /// The counter at the end, and its greatest possible distance from zero, increments.
    NotAtZero { counter: i32, most: u32 },
}

impl SearchFailure {
    /// The fault of the drive of `node`; `None` for a failure that [`Homing`](crate::Homing) tells.
    pub(super) fn fault(self, node: NodeId) -> Option<Fault> {
        let node = node.raw();
        Some(match self {
            Self::Reported => return None,
            Self::NotSeen { waited } => Fault::NoSearch { node, waited },
            Self::NotAtZero { counter, most } => Fault::NotAtZero { node, counter, most },
        })
    }
}

impl SearchRules {
    pub(super) fn new(group: &GroupConfig, axis: &AxisConfig) -> Self {
        let homing = &axis.homing;
        let method = HomingMethod(homing.method);
        let in_place = [HomingMethod::ACTUAL_POSITION, HomingMethod::ACTUAL_POSITION_OLD].contains(&method);
        let braking = homing.zero_speed * homing.zero_speed / (2.0 * homing.acceleration);
        let way = braking + homing.zero_speed * group.period.as_secs_f64() + axis.following_error;
        // Other makers give the negative numbers to methods of their own.
        let known = homing.method > 0 || axis.identity.vendor == MAXON;
        let rounding = ROUNDING as u32;
        let fastest = homing.search_speed.max(homing.zero_speed) * axis.scale.increments_per_radian().abs();
        let at_rest = axis.scale.distance(AT_REST.1 * TAU).unwrap_or(u32::MAX).max(AT_REST.0);
        Self {
            start_timeout: homing.start_timeout,
            in_place,
            most: axis.scale.distance(way).filter(|_| known).map(|way| way.saturating_add(rounding)),
            at_rest,
            fastest,
            shortest: SHORTEST * group.period,
        }
    }

    /// Whether a motor whose counter moved from `before` to `after` within `within` stands still.
    pub(super) fn is_still(&self, before: Increments, after: Increments, within: Duration) -> bool {
        distance(before, after) <= STILL * self.fastest * within.as_secs_f64() + ROUNDING
    }

    /// Whether no motor in a search moves its counter from `before` to `after` within `within`.
    fn is_step(&self, before: Increments, after: Increments, within: Duration) -> bool {
        distance(before, after) > STEP * self.fastest * within.max(self.shortest).as_secs_f64() + ROUNDING
    }

    fn agrees(&self, counter: Increments) -> bool {
        self.most.is_none_or(|most| counter.0.unsigned_abs() <= most)
    }
}

/// One answer of a drive in homing mode.
#[derive(Clone, Copy, Debug)]
pub(super) struct SearchAnswer {
    pub(super) status: HomingStatus,
    pub(super) counter: Increments,
    /// Time of the SYNC that sampled the answer.
    pub(super) sampled: Instant,
    /// Time at which the answer was received.
    pub(super) at: Instant,
}

/// What was seen of one search since its start bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Evidence {
    /// Time of the cycle that first sent the start bit.
    started: Instant,
    /// The axis had its reference before.
    referenced: bool,
    answers: u32,
    /// The status before the start bit took effect, while the drive still shows it.
    old: Option<HomingStatus>,
    /// The drive showed that it searches.
    searching: bool,
    /// A new result, or a counter that was set, shows that the drive searched.
    changed: bool,
    /// The first counter.
    first: Option<Increments>,
    last: Option<(Increments, Instant)>,
    /// The motor has moved.
    moved: bool,
    /// The counter was seen to be set.
    set: bool,
    /// Answers that show success with a counter that agrees with the zero of the method, and that disagrees.
    agreeing: u32,
    disagreeing: u32,
}

impl Evidence {
    /// A search whose start bit is sent in the cycle at `now`. `referenced`: the axis has had its reference so far.
    pub(super) fn new(now: Instant, referenced: bool) -> Self {
        Self {
            started: now,
            referenced,
            answers: 0,
            old: None,
            searching: false,
            changed: false,
            first: None,
            last: None,
            moved: false,
            set: false,
            agreeing: 0,
            disagreeing: 0,
        }
    }

    /// Whether the drive has shown that it searches, and not yet its success.
    pub(super) fn is_searching(&self) -> bool {
        self.searching && self.agreeing + self.disagreeing == 0
    }

    /// Takes an answer. Returns the end of the search, if the answer shows it. `doubted`: the counter may be wrong.
    ///
    /// A drive that has not yet started may seem to search until it stands, and then to be interrupted. An
    /// interruption is therefore accepted only once the drive had time to begin.
    pub(super) fn take(
        &mut self,
        answer: &SearchAnswer,
        rules: &SearchRules,
        doubted: bool,
    ) -> Option<Result<(), SearchFailure>> {
        let &SearchAnswer { status, counter, sampled, .. } = answer;
        self.answers = self.answers.saturating_add(1);
        let had_time = self.answers > ANSWERS_TO_EFFECT;
        self.watch_counter(answer, rules);
        self.watch_status(status, sampled);
        let begun = self.searching || self.changed;
        let counts = self.searching || self.changed && had_time;
        let waited = sampled.since(self.started);
        let late = !begun && waited > rules.start_timeout;
        let not_seen = || late.then_some(Err(SearchFailure::NotSeen { waited }));
        match status {
            HomingStatus::InProgress | HomingStatus::Attained => not_seen(),
            HomingStatus::Done if counts => self.success(counter, rules),
            HomingStatus::Done => {
                let at_rest = rules.in_place && had_time && counter.0.unsigned_abs() <= rules.at_rest;
                let unseen = late && !doubted && (self.moved || self.referenced) && rules.agrees(counter);
                if at_rest || unseen { Some(Ok(())) } else { not_seen() }
            }
            HomingStatus::Interrupted if begun && had_time => Some(Err(SearchFailure::Reported)),
            HomingStatus::ErrorMoving | HomingStatus::ErrorStanding | HomingStatus::Reserved if counts => {
                Some(Err(SearchFailure::Reported))
            }
            HomingStatus::Interrupted
            | HomingStatus::ErrorMoving
            | HomingStatus::ErrorStanding
            | HomingStatus::Reserved => not_seen(),
        }
    }

    /// A drive may show success before its position shows the new count. A counter that was not seen to be set, and is not
    /// zero, therefore has the time of a controlword's effect to be set.
    fn success(&mut self, counter: Increments, rules: &SearchRules) -> Option<Result<(), SearchFailure>> {
        let Some(most) = rules.most.filter(|_| !rules.agrees(counter)) else {
            self.agreeing += 1;
            let settled = self.set || counter.0.unsigned_abs() <= rules.at_rest;
            return (settled || self.agreeing > ANSWERS_TO_EFFECT).then_some(Ok(()));
        };
        self.disagreeing += 1;
        let failure = SearchFailure::NotAtZero { counter: counter.0, most };
        (self.disagreeing > ANSWERS_TO_EFFECT).then_some(Err(failure))
    }

    fn watch_status(&mut self, status: HomingStatus, sampled: Instant) {
        // The SYNC of the cycle that sends the start bit precedes the bit.
        self.searching |= status == HomingStatus::InProgress && sampled > self.started;
        if self.answers <= ANSWERS_BEFORE_EFFECT {
            self.old = Some(status);
            return;
        }
        self.old = self.old.filter(|old| *old == status);
        let result = !matches!(status, HomingStatus::InProgress | HomingStatus::Interrupted);
        self.changed |= result && self.old.is_none();
    }

    /// Looks for a counter that was set to the zero of the method, and for a motor that moved.
    fn watch_counter(&mut self, answer: &SearchAnswer, rules: &SearchRules) {
        let &SearchAnswer { counter, sampled, at, .. } = answer;
        let first = *self.first.get_or_insert(counter);
        self.moved |= distance(first, counter) > f64::from(rules.at_rest);
        if let Some((before, since)) = self.last.replace((counter, sampled)) {
            // Both SYNCs may have reached the drive late, as in the check of positions.
            let stepped = rules.is_step(before, counter, at.since(since));
            self.set |= stepped && rules.most.is_some() && rules.agrees(counter) && sampled > self.started;
            self.changed |= self.set;
        }
    }
}

/// Distance between two counters, increments.
fn distance(before: Increments, after: Increments) -> f64 {
    f64::from(after.0.wrapping_sub(before.0)).abs()
}

#[cfg(test)]
mod tests {
    use HomingStatus::{Attained, Done, ErrorStanding, InProgress, Interrupted};

    use super::super::tests::bench::{PERIOD, axis_config, group_config};
    use super::*;

    /// Rules of `method` for an axis whose counter may be 300 increments from zero after a search, with a start within
    /// 100 ms.
    fn rules(method: i8) -> SearchRules {
        let mut axis = axis_config(2);
        axis.homing.method = method;
        axis.homing.start_timeout = Duration::from_millis(100);
        SearchRules { most: Some(300), ..SearchRules::new(&group_config(), &axis) }
    }

    /// The answers of a drive: the number of answers with a status and a counter.
    type Answers<'a> = &'a [(usize, HomingStatus, i32)];

    /// The end of a search by `method`, and the number of the answer that showed it. `referenced`: the axis had its
    /// reference before.
    fn end(
        method: i8,
        referenced: bool,
        doubted: bool,
        answers: Answers<'_>,
    ) -> Option<(u32, Result<(), SearchFailure>)> {
        let mut evidence = Evidence::new(Instant::ZERO, referenced);
        let runs = answers.iter();
        let each = runs.flat_map(|&(count, status, counter)| std::iter::repeat_n((status, counter), count));
        (0..).zip(each).find_map(|(number, (status, counter))| {
            let sampled = Instant::ZERO + number * PERIOD;
            let answer = SearchAnswer { status, counter: Increments(counter), sampled, at: sampled + PERIOD / 2 };
            evidence.take(&answer, &rules(method), doubted).map(|end| (number + 1, end))
        })
    }

    fn check(method: i8, answers: Answers<'_>, expected: Option<(u32, Result<(), SearchFailure>)>) {
        assert_eq!(end(method, false, false, answers), expected, "method {method}: {answers:?}");
    }

    const NOT_SEEN: Result<(), SearchFailure> = Err(SearchFailure::NotSeen { waited: Duration::from_millis(102) });

    #[test]
    fn a_result_counts_after_a_search_and_an_old_one_does_not() {
        let reported = Err(SearchFailure::Reported);
        // The old result outlives the time of a controlword's effect.
        check(34, &[(20, Done, 700), (9, InProgress, 800), (1, Done, 2)], Some((30, Ok(()))));
        check(34, &[(20, ErrorStanding, 700), (9, InProgress, 800), (1, Done, 2)], Some((30, Ok(()))));
        check(34, &[(20, ErrorStanding, 700), (9, InProgress, 800), (1, ErrorStanding, 800)], Some((30, reported)));
        check(34, &[(20, ErrorStanding, 700), (9, Done, 2)], Some((21, Ok(()))));
        check(34, &[(20, Done, 700), (9, ErrorStanding, 700)], Some((21, reported)));
        // The drive clears the old result before the search.
        check(34, &[(20, Done, 700), (9, Interrupted, 700), (1, Done, 2)], Some((30, Ok(()))));
        // An old result in homing mode after the last statusword of the cyclic mode, which seems to search.
        check(34, &[(1, InProgress, 700), (20, Done, 700), (9, InProgress, 800), (1, Done, 2)], Some((31, Ok(()))));
    }

    #[test]
    fn a_drive_that_never_searches_fails_in_the_time_of_a_start() {
        for status in [Done, ErrorStanding, Interrupted, Attained] {
            check(34, &[(100, status, 700)], Some((52, NOT_SEEN)));
            check(34, &[(100, status, 0)], Some((52, NOT_SEEN)));
            check(37, &[(100, status, 700)], Some((52, NOT_SEEN)));
        }
        check(34, &[(100, InProgress, 700)], None);
    }

    #[test]
    fn a_search_between_two_samples_is_judged_by_the_counter() {
        // The counter jumps to zero while the old result shows.
        check(34, &[(9, Done, 700), (9, Done, 2)], Some((10, Ok(()))));
        check(34, &[(3, Done, 700), (9, Done, 2)], Some((5, Ok(()))));
        // A motor that moves through zero under an old result is not at its reference.
        let through: Vec<_> = (0..40).map(|number| (1, Done, 200 - 10 * number)).collect();
        check(34, &through, None);
        // The motor moved, and stands where the counter reads zero.
        check(34, &[(9, Done, 0), (3, Done, 30), (100, Done, 0)], Some((52, Ok(()))));
        assert_eq!(end(34, false, true, &[(9, Done, 0), (3, Done, 30), (100, Done, 0)]), Some((52, NOT_SEEN)));
        // Nothing moved at the zero that was known before.
        for (counter, referenced, doubted, ended) in [
            (2, true, false, Ok(())),
            (2, true, true, NOT_SEEN),
            (2, false, false, NOT_SEEN),
            (301, true, false, NOT_SEEN),
        ] {
            let answers = [(100, Done, counter)];
            assert_eq!(end(34, referenced, doubted, &answers), Some((52, ended)), "{counter} {referenced} {doubted}");
        }
        check(34, &[(9, Done, 0), (3, Done, 4), (100, Done, 0)], Some((52, NOT_SEEN)));
    }

    #[test]
    fn a_method_without_motion_is_judged_by_the_counter() {
        for method in [35, 37] {
            check(method, &[(2, Interrupted, 700), (9, Done, 0)], Some((5, Ok(()))));
            check(method, &[(9, Done, 0)], Some((5, Ok(()))));
            check(method, &[(9, Done, 30), (9, Done, 1)], Some((10, Ok(()))));
            check(method, &[(9, Done, 700), (9, Done, 0)], Some((10, Ok(()))));
        }
    }

    #[test]
    fn a_counter_that_disagrees_with_the_zero_of_its_method_is_a_failure() {
        let far = |counter| Err(SearchFailure::NotAtZero { counter, most: 300 });
        check(34, &[(9, InProgress, 700), (1, Done, 300)], Some((10, Ok(()))));
        check(34, &[(9, InProgress, 700), (9, Done, 301)], Some((14, far(301))));
        check(34, &[(9, InProgress, 700), (9, Done, -301)], Some((14, far(-301))));
        // The drive sets its counter after it shows success, also from a count near zero.
        check(34, &[(9, InProgress, 200), (4, Done, 200), (9, Done, 2)], Some((14, Ok(()))));
        check(34, &[(9, InProgress, 200), (9, Done, 200)], Some((14, Ok(()))));
        check(34, &[(9, InProgress, 700), (4, Done, 700), (9, Done, 2)], Some((14, Ok(()))));
        check(37, &[(2, Interrupted, 700), (4, Done, 700), (9, Done, 2)], Some((7, Ok(()))));
    }

    #[test]
    fn the_zero_of_another_makers_own_method_is_unknown() {
        let most = |method, vendor| {
            let mut axis = axis_config(2);
            (axis.homing.method, axis.identity.vendor) = (method, vendor);
            SearchRules::new(&group_config(), &axis).most
        };
        // Braking 0.0087 rad, a period 0.0021 rad and the following error of half a turn, and two increments.
        assert_eq!(most(34, 0x1234), Some(1_005));
        assert_eq!((most(-3, MAXON), most(-3, 0x1234)), (Some(1_005), None));
    }
}
