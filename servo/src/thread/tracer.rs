//! Recording of the phases of the cycles around a late cycle.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use can::Instant;

use super::{Awake, LateCycle};

/// Number of cycles in a spike, and number of those after the late one.
const SHOWN: usize = 64;
const AFTER: usize = 16;

/// End times of the phases of one cycle, `CLOCK_MONOTONIC`. Each phase begins at the end of the previous one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamps {
    /// Number of the cycle, counted from 0.
    pub cycle: u64,
    /// Due time of its SYNC.
    pub deadline: Instant,
    /// End of the previous cycle; the caller has the thread from here on.
    pub called: Instant,
    /// End of the caller's work.
    pub begun: Instant,
    /// The wait for the cycle; the last wait if slots were skipped.
    pub awake: Awake,
    /// Start of reading the buses.
    pub reading: Instant,
    /// End of reading.
    pub read: Instant,
    /// End of computing.
    pub computed: Instant,
    /// End of passing the commands to the groups.
    pub written: Instant,
    /// Start of sending SYNC.
    pub sending: Instant,
    /// End of sending; the slack begins here.
    pub done: Instant,
    /// Lateness and cause of the cycle, or of the slots skipped before it if those were later.
    pub late: Option<LateCycle>,
}

impl Stamps {
    /// The phases by name, each with its end time. The first phase begins at [`Stamps::begun`], and some phases may
    /// have no duration. `begin` is the time before the wait: reading the kernel's account, or waits for skipped
    /// slots.
    pub fn phases(&self) -> [(&'static str, Instant); 8] {
        [
            ("begin", self.awake.asked_at),
            ("sleep", self.awake.woken),
            ("spin", self.reading),
            ("read", self.read),
            ("step", self.computed),
            ("write", self.written),
            ("spin", self.sending),
            ("SYNC", self.done),
        ]
    }

    /// A wait without a following cycle.
    pub fn of_wait(cycle: u64, deadline: Instant, awake: Awake, late: Option<LateCycle>) -> Self {
        let [called, begun] = [awake.asked_at; 2];
        let [reading, read, computed, written, sending, done] = [awake.at; 6];
        Self { cycle, deadline, called, begun, awake, reading, read, computed, written, sending, done, late }
    }
}

/// The recorded cycles around a late cycle or a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Spike {
    /// The late cycle; `None` if the recording was requested.
    pub late: Option<LateCycle>,
    /// Number of the late cycle, or of the last cycle before the request.
    pub cycle: u64,
    /// At most 64 cycles, the oldest first. 16 of them follow the late cycle, unless the run ended before.
    pub cycles: Vec<Stamps>,
}

impl Spike {
    /// Lateness of the spike; zero if the recording was requested.
    pub fn lateness(&self) -> Duration {
        self.late.map_or(Duration::ZERO, |late| late.late)
    }
}

/// A spike that is stored after `left` more cycles.
#[derive(Clone, Copy, Debug)]
struct Pending {
    late: Option<LateCycle>,
    cycle: u64,
    left: usize,
}

/// Keeps the cycles around the eight worst late cycles and around the last request. The size is fixed: recording does
/// not allocate.
///
/// Late cycles within 16 cycles of each other are one spike, named after the cycle with the greatest lateness. A ninth
/// spike replaces the spike with the smallest lateness, if its own is greater.
#[derive(Debug)]
pub struct Tracer {
    ring: VecDeque<Stamps>,
    late: Option<Pending>,
    asked: Option<Pending>,
    spikes: Vec<Spike>,
    /// The last requested recording.
    on_request: Spike,
    request: Arc<AtomicBool>,
}

impl Tracer {
    /// Number of spikes kept for late cycles.
    pub const KEPT: usize = 8;

    /// An empty tracer. Setting `request` stores the cycles around that moment.
    pub fn new(request: Arc<AtomicBool>) -> Self {
        let free = || Spike { late: None, cycle: 0, cycles: touched() };
        Self {
            ring: touched().into(),
            late: None,
            asked: None,
            spikes: (0..Self::KEPT).map(|_| free()).collect(),
            on_request: free(),
            request,
        }
    }

    /// Takes the stamps of one cycle.
    pub fn record(&mut self, stamps: Stamps) {
        if self.ring.len() == SHOWN {
            self.ring.pop_front();
        }
        self.ring.push_back(stamps);
        let pending = |late| Some(Pending { late, cycle: stamps.cycle, left: AFTER });
        let later = |before: Option<Pending>| before.and_then(|one| one.late).map(|one| one.late);
        if self.request.load(Ordering::Relaxed) {
            self.request.store(false, Ordering::Relaxed);
            self.asked = pending(None);
        } else {
            self.asked = self.asked.map(Pending::passed);
        }
        if stamps.late.map(|one| one.late) > later(self.late) {
            self.late = pending(stamps.late);
        } else {
            self.late = self.late.map(Pending::passed);
        }
        self.freeze(|pending| pending.left == 0);
    }

    /// Notes an interruption of the cycles. Later cycles are not shown together with earlier ones.
    pub fn pause(&mut self) {
        self.freeze(|_| true);
        self.ring.clear();
    }

    /// Stores the spikes that are due.
    fn freeze(&mut self, due: impl Fn(&Pending) -> bool) {
        if let Some(pending) = self.asked.take_if(|pending| due(pending)) {
            pending.freeze(&self.ring, &mut self.on_request);
        }
        if let Some(pending) = self.late.take_if(|pending| due(pending)) {
            let mildest = self.spikes.iter_mut().min_by_key(|spike| spike.lateness());
            let lateness = pending.late.map_or(Duration::ZERO, |late| late.late);
            if let Some(spike) = mildest.filter(|spike| spike.lateness() < lateness) {
                pending.freeze(&self.ring, spike);
            }
        }
    }

    /// The stored spikes, the greatest lateness first, and the requested recording at the end.
    pub fn finish(mut self) -> Vec<Spike> {
        self.freeze(|_| true);
        self.spikes.push(self.on_request);
        self.spikes.retain(|spike| !spike.cycles.is_empty());
        self.spikes.sort_by_key(|spike| std::cmp::Reverse(spike.lateness()));
        self.spikes
    }
}

impl Pending {
    fn passed(self) -> Self {
        let left = self.left.saturating_sub(1);
        Self { left, ..self }
    }

    fn freeze(self, ring: &VecDeque<Stamps>, into: &mut Spike) {
        (into.late, into.cycle) = (self.late, self.cycle);
        into.cycles.clear();
        let (older, newer) = ring.as_slices();
        into.cycles.extend_from_slice(older);
        into.cycles.extend_from_slice(newer);
    }
}

/// Touched memory for the cycles of one spike.
fn touched() -> Vec<Stamps> {
    let cycle = Stamps::of_wait(1, Instant::ZERO, Awake::default(), None);
    let mut cycles = vec![cycle; SHOWN];
    cycles.clear();
    cycles
}

#[cfg(test)]
mod tests {
    use super::super::Cause;
    use super::*;

    /// Cycles of 1 ms. `late` gives the lateness of some cycles in µs, `asked` the cycles followed by a request.
    fn traced(cycles: u64, late: &[(u64, u64)], asked: &[u64]) -> Vec<Spike> {
        let request = Arc::new(AtomicBool::new(false));
        let mut tracer = Tracer::new(Arc::clone(&request));
        for cycle in 0..cycles {
            let deadline = Instant::from_nanos(cycle * 1_000_000);
            let of_cycle = late.iter().find(|(number, _)| *number == cycle);
            let late = of_cycle.map(|&(cycle, micros)| LateCycle {
                cycle,
                due: Duration::ZERO,
                late: Duration::from_micros(micros),
                cause: Cause::Host,
            });
            let awake =
                Awake { asked_at: deadline, wake_up: deadline, woken: deadline, at: deadline, gap: Duration::ZERO };
            request.fetch_or(asked.contains(&cycle), Ordering::Relaxed);
            tracer.record(Stamps::of_wait(cycle, deadline, awake, late));
        }
        tracer.finish()
    }

    #[test]
    fn a_spike_is_kept_with_the_cycles_before_and_after_it() {
        // Number of cycles, late cycles and µs, requests; expected spikes: cycle, first and last cycle shown.
        type Case<'a> = (u64, &'a [(u64, u64)], &'a [u64], &'a [(u64, std::ops::RangeInclusive<u64>)]);
        let cases: [Case; 9] = [
            (200, &[], &[], &[]),
            (200, &[(100, 30)], &[], &[(100, 53..=116)]),
            // The run begins or ends near the spike.
            (200, &[(3, 30)], &[], &[(3, 0..=19)]),
            (105, &[(100, 30)], &[], &[(100, 41..=104)]),
            // Late cycles that follow belong to the same spike, which is named after the cycle
            // with the greatest lateness.
            (200, &[(100, 30), (110, 20)], &[], &[(100, 53..=116)]),
            (200, &[(100, 20), (110, 30)], &[], &[(110, 63..=126)]),
            // The worst spike comes first, a requested one last.
            (200, &[(50, 20), (100, 30)], &[], &[(100, 53..=116), (50, 3..=66)]),
            (200, &[(90, 20)], &[95], &[(90, 43..=106), (95, 48..=111)]),
            (200, &[], &[30, 120], &[(120, 73..=136)]),
        ];
        for (cycles, late, asked, expected) in cases {
            let found: Vec<_> = traced(cycles, late, asked)
                .iter()
                .map(|spike| {
                    let numbers: Vec<_> = spike.cycles.iter().map(|one| one.cycle).collect();
                    let [first, last] = [numbers[0], numbers[numbers.len() - 1]];
                    assert!(numbers.into_iter().eq(first..=last), "{late:?} {asked:?}");
                    (spike.cycle, first..=last)
                })
                .collect();
            assert_eq!(found, expected, "{cycles} {late:?} {asked:?}");
        }
    }

    #[test]
    fn of_many_spikes_the_latest_are_kept() {
        let late: Vec<_> = (0..20).map(|spike| (100 * spike, 7 * spike % 20 + 1)).collect();
        let kept = traced(2100, &late, &[]);
        let kept = kept.iter().map(|spike| spike.lateness().as_micros());
        assert!(kept.eq((13..=20).rev()));
    }
}
