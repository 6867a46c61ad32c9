//! Memory of searches beyond CiA 402: the result of the last search, and a counter that shows late.

use can::Instant;
use canopen::cia402::HomingStatus;

use crate::epos4::HomingDeviation;

#[derive(Clone, Copy, Debug)]
pub(super) struct HomingMemory {
    deviation: HomingDeviation,
    /// Result of the last search that ended.
    result: Option<HomingStatus>,
    /// Time of the start bit, and the result before it.
    begun: Option<(Instant, Option<HomingStatus>)>,
    /// When the position shows the counter that the search set.
    counter_due: Option<Instant>,
}

impl HomingMemory {
    pub(super) fn new(deviation: HomingDeviation) -> Self {
        Self { deviation, result: None, begun: None, counter_due: None }
    }

    /// The start bit rises at `now`. Returns whether a search begins.
    pub(super) fn begin(&mut self, now: Instant) -> bool {
        self.begun = Some((now, self.result));
        !self.deviation.never_searches
    }

    /// The drive leaves homing mode or loses its power.
    pub(super) fn leave(&mut self) {
        self.begun = None;
    }

    /// The device restarts.
    pub(super) fn restart(&mut self) {
        *self = Self::new(self.deviation);
    }

    /// The status that the drive shows in homing mode at `now`, in place of the present one.
    pub(super) fn show(&mut self, present: HomingStatus, now: Instant) -> HomingStatus {
        if matches!(present, HomingStatus::Done | HomingStatus::ErrorStanding) {
            self.result = Some(present);
        }
        let Some(time) = self.deviation.old_result else {
            return present;
        };
        let old = match self.begun {
            Some((start, old)) => old.filter(|_| now < start + time),
            None => self.result,
        };
        old.unwrap_or(present)
    }

    /// Whether the position shows a counter that a search has set. `ended`: the search has ended.
    pub(super) fn shows_counter(&mut self, ended: bool, now: Instant) -> bool {
        let late = self.deviation.counter_late;
        if ended {
            self.counter_due.get_or_insert(now + late);
        }
        let due = late.is_zero() || self.counter_due.is_some_and(|due| due <= now);
        if due {
            self.counter_due = None;
        }
        due
    }
}
