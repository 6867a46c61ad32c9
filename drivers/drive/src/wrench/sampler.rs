//! The part of the driver that is independent of the wire: scale, zero, age, faults and the published state.

use std::time::Duration;

use can::Instant;

use super::config::{Channel, WrenchConfig, ZeroMethod};
use super::fault::{WrenchError, WrenchFault};
use super::rate::{Comparison, Pace, Rate};
use super::state::{Requests, StatePublisher, WrenchAxis, WrenchLink, WrenchState, ZeroFailure, ZeroRequest, Zeroing};

/// Greatest difference between two samples of a zeroing, and greatest reading after a bias command, as a share of the
/// range.
pub const ZERO_SCATTER: f64 = 0.1;

/// Greatest difference between two samples that is always accepted, counts.
const LEAST_SCATTER: i64 = 4;

/// Counters of a sensor since bring-up. Counters only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WrenchCounters {
    /// Accepted samples.
    pub samples: u64,
    /// Serial line: queries without any byte of an answer in the next cycle.
    pub missing: u64,
    /// Readings or frames of wrong length.
    pub garbage: u64,
    /// Serial line: answers that were complete only after the next cycle. Their samples are dropped.
    pub late: u64,
    /// Samples with a saturated channel.
    pub saturated: u64,
    /// CAN: samples with the counter value of the previous sample.
    pub repeated: u64,
    /// CAN: lost samples. A frame of the sample is missing or late, or the counter of the sensor has a gap.
    pub lost: u64,
}

/// Samples of one sensor, from counts to the published state.
///
/// Nothing here waits or allocates. The order of calls within a cycle is:
/// 1. [`begin_of_read`](Self::begin_of_read);
/// 2. [`take`](Self::take), [`garbage`](Self::garbage) and the other events, as readings arrive;
/// 3. [`end_of_read`](Self::end_of_read), which publishes the state.
pub(super) struct Sampler {
    config: WrenchConfig,
    pace: Pace,
    state: WrenchState,
    publisher: StatePublisher,
    requests: Requests,
    /// The last request for a zero that was begun or refused.
    taken: Option<ZeroRequest>,
    /// Counts of the last sample.
    counts: [i32; 6],
    /// Counts that read as zero.
    offset: [f64; 6],
    /// Sums of the counts of the zeroing under way, and their least and greatest values.
    sums: [i64; 6],
    least: [i32; 6],
    greatest: [i32; 6],
    /// The bias command of the zeroing under way was sent.
    bias_sent: bool,
    rate: Rate,
    /// A sample was taken in this cycle.
    fresh: bool,
    /// A reset was requested. The latched fault remains until the next sample, so that no old wrench becomes valid.
    resetting: bool,
    /// Cycles since the last sample, or since the last reset.
    waited: u32,
    /// Cycles without a sample that preceded the present sample, while a later reading may still withdraw this sample.
    doubted: Option<u32>,
    /// Number of readings since the last sample that were no answer.
    garbage: u32,
    /// Number of late answers since the last sample.
    late: u32,
    /// Number of samples without all their frames since the last sample.
    incomplete: u32,
    /// Saturated samples in a row, and the first saturated channel of the last one.
    saturated: u32,
    saturated_at: Option<(WrenchAxis, i32)>,
    /// First saturated channel of the sample of this cycle that exceeded the tolerated number of saturated samples in a
    /// row.
    overload: Option<(WrenchAxis, i32)>,
    /// Error bits of the last sample, and of all samples since the last judgement.
    status: u32,
    errors: u32,
    pub(super) counters: WrenchCounters,
}

impl Sampler {
    /// A sampler before bring-up, and the controller's end of it.
    pub(super) fn new(config: &WrenchConfig, pace: Pace) -> (Self, WrenchLink) {
        let (publisher, requests, link) = WrenchLink::new();
        let sampler = Self {
            config: *config,
            pace,
            state: WrenchState::NOT_STARTED,
            publisher,
            requests,
            taken: None,
            counts: [0; 6],
            offset: [0.0; 6],
            sums: [0; 6],
            least: [i32::MAX; 6],
            greatest: [i32::MIN; 6],
            bias_sent: false,
            rate: Rate::first(pace),
            fresh: false,
            resetting: false,
            waited: 0,
            doubted: None,
            garbage: 0,
            late: 0,
            incomplete: 0,
            saturated: 0,
            saturated_at: None,
            overload: None,
            status: 0,
            errors: 0,
            counters: WrenchCounters::default(),
        };
        (sampler, link)
    }

    /// Ends operation, before bring-up. The zero of the host is cleared.
    pub(super) fn reset(&mut self) {
        let zeroing = match self.state.zeroing {
            Zeroing::None | Zeroing::Done { .. } => Zeroing::None,
            Zeroing::UnderWay { request, .. } => Zeroing::Failed { request, cause: ZeroFailure::Interrupted },
            failed @ Zeroing::Failed { .. } => failed,
        };
        self.state = WrenchState { zeroing, ..WrenchState::NOT_STARTED };
        self.offset = [0.0; 6];
        self.rate = Rate::first(self.pace);
        self.counters = WrenchCounters::default();
        self.forget_streaks();
        (self.status, self.errors, self.fresh) = (0, 0, false);
        self.publish();
    }

    /// Starts operation after bring-up. The first cycle has the last sample of bring-up.
    pub(super) fn begin(&mut self, now: Instant) {
        self.state = WrenchState { at: now, fault: None, samples: 0, ..self.state };
        self.rate = Rate::new(self.pace);
        self.counters = WrenchCounters::default();
        self.forget_streaks();
        self.errors = 0;
        // An earlier request for a reset is dropped: there is no fault to clear.
        self.requests.take_reset();
        self.publish();
    }

    fn forget_streaks(&mut self) {
        (self.garbage, self.late, self.incomplete, self.saturated) = (0, 0, 0, 0);
        (self.saturated_at, self.overload) = (None, None);
        (self.resetting, self.waited, self.doubted) = (false, 0, None);
    }

    /// Begins the reading of a cycle. A requested reset begins here, so that a sample of this cycle can end the fault.
    pub(super) fn begin_of_read(&mut self) {
        if self.requests.take_reset() {
            self.reset_fault();
        }
    }

    /// Counts a request whose answer is due by now.
    pub(super) fn requested(&mut self) {
        self.rate.requested();
    }

    /// Takes a whole sample with the time `sampled`.
    pub(super) fn take(&mut self, counts: [i32; 6], sampled: Instant) {
        self.rate.sampled(sampled);
        self.doubted = None;
        let mut channels = WrenchAxis::ALL.into_iter().zip(counts).zip(self.config.channels);
        let beyond =
            |(_, count): (WrenchAxis, i32), channel: Channel| count.unsigned_abs() >= channel.range.unsigned_abs();
        self.saturated_at = channels.find(|(read, channel)| beyond(*read, *channel)).map(|(read, _)| read);
        if self.saturated_at.is_some() {
            self.saturated = self.saturated.saturating_add(1);
            self.counters.saturated += 1;
            if self.saturated > self.config.tolerated_saturated {
                self.overload = self.saturated_at;
            }
            return;
        }
        (self.saturated, self.garbage, self.late, self.incomplete) = (0, 0, 0, 0);
        (self.counts, self.state.sampled, self.fresh) = (counts, sampled, true);
        if std::mem::take(&mut self.resetting) {
            self.state.fault = None;
        }
        self.state.samples += 1;
        self.counters.samples += 1;
        self.scale();
        if let Zeroing::UnderWay { request, samples } = self.state.zeroing {
            self.state.zeroing = self.zero(request, samples);
            if let Zeroing::Done { request, .. } = self.state.zeroing {
                self.state.zeroed = Some(request);
            }
        }
    }

    /// Adds the last sample to a zeroing that has taken `samples` samples so far.
    fn zero(&mut self, request: ZeroRequest, samples: u16) -> Zeroing {
        let ZeroMethod::Host { samples: wanted } = self.config.zero else {
            return match self.exceeding(self.counts.map(i64::from)) {
                _ if !self.bias_sent => Zeroing::UnderWay { request, samples },
                Some(axis) => Zeroing::Failed { request, cause: ZeroFailure::NotBiased { axis } },
                None => Zeroing::Done { request, samples },
            };
        };
        for (axis, counts) in self.counts.into_iter().enumerate() {
            self.least[axis] = self.least[axis].min(counts);
            self.greatest[axis] = self.greatest[axis].max(counts);
        }
        let spread = std::array::from_fn(|axis| i64::from(self.greatest[axis]) - i64::from(self.least[axis]));
        if let Some(axis) = self.exceeding(spread) {
            return Zeroing::Failed { request, cause: ZeroFailure::Unsteady { axis } };
        }
        self.sums.iter_mut().zip(self.counts).for_each(|(sum, count)| *sum += i64::from(count));
        let samples = samples + 1;
        if samples < wanted {
            return Zeroing::UnderWay { request, samples };
        }
        self.offset = self.sums.map(|sum| sum as f64 / f64::from(samples));
        self.scale();
        Zeroing::Done { request, samples }
    }

    /// The first channel with more than [`ZERO_SCATTER`] of its range, and more than the noise of a count.
    fn exceeding(&self, counts: [i64; 6]) -> Option<WrenchAxis> {
        let mut channels = WrenchAxis::ALL.into_iter().zip(counts).zip(self.config.channels);
        let exceeds = |counts: i64, range: i32| {
            counts.abs() > LEAST_SCATTER && counts.abs() as f64 > ZERO_SCATTER * f64::from(range)
        };
        channels.find(|((_, counts), channel)| exceeds(*counts, channel.range)).map(|((axis, _), _)| axis)
    }

    fn scale(&mut self) {
        for (axis, component) in self.state.wrench.iter_mut().enumerate() {
            *component = (f64::from(self.counts[axis]) - self.offset[axis]) * self.config.channels[axis].scale;
        }
    }

    /// Counts a reading of another length than an answer.
    pub(super) fn garbage(&mut self) {
        self.garbage = self.garbage.saturating_add(1);
        self.counters.garbage += 1;
    }

    /// Counts an answer that came too late for its query.
    pub(super) fn late(&mut self) {
        self.late = self.late.saturating_add(1);
        self.counters.late += 1;
    }

    /// The sample of this cycle may be older than its time: [`withdraw`](Self::withdraw) may follow in the next cycle.
    pub(super) fn doubt(&mut self) {
        self.doubted = self.fresh.then_some(self.waited);
    }

    /// The sample of the last cycle was that of an earlier query. The sample counts as missing and as a late answer.
    pub(super) fn withdraw(&mut self) {
        if let Some(waited) = self.doubted.take() {
            // The cycle of the sample counts as a cycle without a sample.
            self.waited = waited.saturating_add(1);
            self.late();
        }
    }

    /// Counts a sample without all its frames.
    pub(super) fn incomplete(&mut self) {
        self.incomplete = self.incomplete.saturating_add(1);
        self.counters.lost += 1;
    }

    /// Takes the error bits of the status field of a sample.
    pub(super) fn status(&mut self, errors: u32) {
        self.status = errors;
        self.errors |= errors;
    }

    /// Whether the bias command of the sensor is to be sent.
    pub(super) fn bias_is_due(&self) -> bool {
        let zeroing = matches!(self.state.zeroing, Zeroing::UnderWay { .. });
        zeroing && self.config.zero == ZeroMethod::Device && !self.bias_sent
    }

    /// The bias command was sent: the next sample is the first with the new zero.
    pub(super) fn biased(&mut self) {
        self.bias_sent = true;
    }

    /// Latches a fault. The first fault stays until a reset or the next bring-up. A fault ends a zeroing and a reset.
    pub(super) fn latch(&mut self, fault: WrenchFault) {
        if std::mem::take(&mut self.resetting) {
            self.state.fault = None;
        }
        if let Zeroing::UnderWay { request, .. } = self.state.zeroing {
            self.state.zeroing = Zeroing::Failed { request, cause: ZeroFailure::Interrupted };
        }
        self.state.fault.get_or_insert(fault);
    }

    /// Checks the samples of bring-up so far. Fails on an error status, and on too many saturated samples in a row.
    pub(super) fn check_samples(&self) -> Result<(), WrenchError> {
        if self.status != 0 {
            return Err(WrenchError::Status { status: self.status });
        }
        match self.saturated_at {
            Some((axis, counts)) if self.saturated > self.config.tolerated_saturated => {
                Err(WrenchError::Saturated { axis, counts })
            }
            Some(_) | None => Ok(()),
        }
    }

    /// Whether the last sample of bring-up can be used.
    pub(super) fn has_sample(&self) -> bool {
        self.fresh && self.saturated == 0
    }

    /// Returns whether samples arrive at the declared rate, which ends the bring-up of a sensor on CAN. `waited`: time
    /// since the begin of the comparison. `within`: time limit.
    pub(super) fn compare_first(&mut self, waited: Duration, within: Duration) -> Result<bool, WrenchError> {
        self.check_samples()?;
        let declared = self.pace.declared();
        match self.rate.compare() {
            Some(Comparison::Differs { found }) => Err(WrenchError::OfAnotherRate { declared, found }),
            Some(Comparison::Missing { missing, of }) => Err(WrenchError::Missing { missing, of }),
            Some(Comparison::Agrees) if self.has_sample() => Ok(true),
            Some(Comparison::Agrees) | None if waited <= within => Ok(false),
            Some(Comparison::Agrees) | None => Err(match self.rate.found() {
                Some(found) => WrenchError::OfAnotherRate { declared, found },
                None if self.incomplete > 0 => WrenchError::Incomplete { samples: self.incomplete },
                None => WrenchError::NoSamples { waited },
            }),
        }
    }

    /// Ends the reading of a cycle: checks for faults, takes a request for a zero, and publishes the state.
    pub(super) fn end_of_read(&mut self, now: Instant, cycle: u64) {
        (self.state.at, self.state.cycle) = (now, cycle);
        let fresh = std::mem::take(&mut self.fresh);
        for cycles in [&mut self.state.age, &mut self.waited] {
            *cycles = if fresh { 0 } else { cycles.saturating_add(1) };
        }
        self.judge();
        self.take_request();
        self.publish();
    }

    fn reset_fault(&mut self) {
        let Some(fault) = self.state.fault else { return };
        if self.config.zero == ZeroMethod::Device
            && fault.may_be_restart()
            && matches!(self.state.zeroing, Zeroing::Done { .. })
        {
            (self.state.zeroing, self.state.zeroed) = (Zeroing::None, None);
        }
        self.rate = Rate::new(self.pace);
        self.forget_streaks();
        self.resetting = true;
    }

    fn judge(&mut self) {
        let status = self.status | std::mem::take(&mut self.errors);
        if status != 0 {
            self.latch(WrenchFault::Status { status });
        }
        let silent = self.waited >= self.pace.silent_after(self.config.tolerated_missing);
        let saturated = self.overload.take().or(self.saturated_at.filter(|_| silent));
        if let Some((axis, counts)) = saturated {
            // The last sample within the range came before the reset.
            let still = self.resetting;
            self.latch(match still {
                true => WrenchFault::StillSaturated { axis, counts },
                false => WrenchFault::Saturated { axis, counts },
            });
        }
        let declared = self.pace.declared();
        if silent {
            let cycles = self.state.age;
            self.latch(if self.garbage > 0 {
                WrenchFault::Garbage { readings: self.garbage }
            } else if self.late > 0 {
                // A late answer is complete in the second reading after its query.
                WrenchFault::OfAnotherRate { declared, found: 2 * declared }
            } else if self.incomplete > 0 {
                WrenchFault::Incomplete { samples: self.incomplete }
            } else {
                WrenchFault::Silent { cycles }
            });
        }
        match self.rate.compare() {
            Some(Comparison::Differs { found }) => self.latch(WrenchFault::OfAnotherRate { declared, found }),
            Some(Comparison::Missing { missing, of }) => self.latch(WrenchFault::Missing { missing, of }),
            Some(Comparison::Agrees) | None => {}
        }
    }

    fn take_request(&mut self) {
        let requested = self.requests.zero();
        if requested <= self.taken {
            return;
        }
        self.taken = requested;
        if let Some(request) = requested {
            (self.sums, self.least, self.greatest) = ([0; 6], [i32::MAX; 6], [i32::MIN; 6]);
            self.bias_sent = false;
            self.state.zeroing = match self.state.fault {
                Some(_) => Zeroing::Failed { request, cause: ZeroFailure::Interrupted },
                None => Zeroing::UnderWay { request, samples: 0 },
            };
        }
    }

    /// Latches [`WrenchFault::Ended`] when the driver is dropped: the last wrench is no longer valid.
    pub(super) fn end(&mut self) {
        self.latch(WrenchFault::Ended);
        self.publish();
    }

    fn publish(&mut self) {
        self.publisher.publish(&self.state.words());
    }
}
