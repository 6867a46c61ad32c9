//! The cycles around a late one, phase by phase.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use can::Instant;

use super::{Awake, LateCycle};

/// Cycles that a spike shows, and how many of them come after the late one.
const SHOWN: usize = 64;
const AFTER: usize = 16;

/// When the phases of one cycle ended, `CLOCK_MONOTONIC`. Each begins where the one before ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamps {
    /// Its number, from 0.
    pub cycle: u64,
    /// When its SYNC was due.
    pub deadline: Instant,
    /// The end of the cycle before it: from here on the caller had the thread.
    pub called: Instant,
    /// The caller was done.
    pub begun: Instant,
    /// The wait for it, the last one if slots were let go.
    pub awake: Awake,
    /// The buses were about to be read.
    pub reading: Instant,
    /// They were read.
    pub read: Instant,
    /// The servo had computed.
    pub computed: Instant,
    /// The commands were handed to the buses.
    pub written: Instant,
    /// SYNC was about to leave.
    pub sending: Instant,
    /// It was handed over; what follows is slack.
    pub done: Instant,
    /// How late it was and why, or the slots let go before it, if those were later.
    pub late: Option<LateCycle>,
}

impl Stamps {
    /// The phases by name, each with its end; the first begins at [`Stamps::begun`], and some may take no time.
    /// `begin` is what precedes the wait: reading the kernel's account, or waits for slots that were let go.
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

    /// A wait with nothing after it.
    pub fn of_wait(cycle: u64, deadline: Instant, awake: Awake, late: Option<LateCycle>) -> Self {
        Self {
            cycle,
            deadline,
            called: awake.asked_at,
            begun: awake.asked_at,
            awake,
            reading: awake.at,
            read: awake.at,
            computed: awake.at,
            written: awake.at,
            sending: awake.at,
            done: awake.at,
            late,
        }
    }
}

/// The cycles around one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Spike {
    /// The late cycle; `None` if they were asked for.
    pub late: Option<LateCycle>,
    /// The number of that cycle, or of the one after which they were asked for.
    pub cycle: u64,
    /// At most 64, the oldest first; 16 of them later than that one, unless the run ended before.
    pub cycles: Vec<Stamps>,
}

impl Spike {
    /// How late it was; zero if it was asked for.
    pub fn lateness(&self) -> Duration {
        self.late.map_or(Duration::ZERO, |late| late.late)
    }

    fn is_free(&self) -> bool {
        self.cycles.is_empty()
    }
}

/// What is frozen once `left` more cycles have been seen.
#[derive(Clone, Copy, Debug)]
struct Pending {
    late: Option<LateCycle>,
    cycle: u64,
    left: usize,
}

/// Keeps the cycles around the eight latest ones, and around the last request. Of fixed size: recording does not
/// allocate.
///
/// Late cycles that follow each other within 16 are one spike, named after the latest; a spike that is later than the
/// mildest of eight takes its place.
#[derive(Debug)]
pub struct Tracer {
    ring: VecDeque<Stamps>,
    late: Option<Pending>,
    asked: Option<Pending>,
    spikes: Vec<Spike>,
    /// The last one that was asked for.
    on_request: Spike,
    request: Arc<AtomicBool>,
}

impl Tracer {
    /// Spikes that are kept because of a late cycle.
    pub const KEPT: usize = 8;

    /// With nothing seen; raising `request` freezes what is seen then.
    pub fn new(request: Arc<AtomicBool>) -> Self {
        let free = || Spike {
            late: None,
            cycle: 0,
            cycles: touched(),
        };
        Self {
            ring: touched().into(),
            late: None,
            asked: None,
            spikes: (0..Self::KEPT).map(|_| free()).collect(),
            on_request: free(),
            request,
        }
    }

    /// Takes in one cycle.
    pub fn record(&mut self, stamps: Stamps) {
        if self.ring.len() == SHOWN {
            self.ring.pop_front();
        }
        self.ring.push_back(stamps);
        let pending = |late| {
            Some(Pending {
                late,
                cycle: stamps.cycle,
                left: AFTER,
            })
        };
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

    /// There are no cycles for a while; those to come are not shown beside those before.
    pub fn pause(&mut self) {
        self.freeze(|_| true);
        self.ring.clear();
    }

    /// Freezes what is due.
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

    /// What was kept: the latest first, and at the end what was asked for.
    pub fn finish(mut self) -> Vec<Spike> {
        self.freeze(|_| true);
        self.spikes.push(self.on_request);
        self.spikes.retain(|spike| !spike.is_free());
        self.spikes
            .sort_by_key(|spike| std::cmp::Reverse(spike.lateness()));
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

/// Room for the cycles of one spike whose pages are there.
fn touched() -> Vec<Stamps> {
    let zero = Instant::ZERO;
    let awake = Awake {
        asked_at: zero,
        wake_up: zero,
        woken: zero,
        at: zero,
        gap: Duration::ZERO,
    };
    let mut cycles = vec![Stamps::of_wait(1, zero, awake, None); SHOWN];
    cycles.clear();
    cycles
}

#[cfg(test)]
mod tests {
    use super::super::Cause;
    use super::*;

    /// Cycles of 1 ms, some of them late by as many µs, some followed by a request.
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
            let awake = Awake {
                asked_at: deadline,
                wake_up: deadline,
                woken: deadline,
                at: deadline,
                gap: Duration::ZERO,
            };
            request.fetch_or(asked.contains(&cycle), Ordering::Relaxed);
            tracer.record(Stamps::of_wait(cycle, deadline, awake, late));
        }
        tracer.finish()
    }

    #[test]
    fn a_spike_is_kept_with_the_cycles_before_and_after_it() {
        // Cycles, late ones by µs, requests; spikes: cycle, first and last shown.
        type Case<'a> = (
            u64,
            &'a [(u64, u64)],
            &'a [u64],
            &'a [(u64, std::ops::RangeInclusive<u64>)],
        );
        let cases: [Case; 9] = [
            (200, &[], &[], &[]),
            (200, &[(100, 30)], &[], &[(100, 53..=116)]),
            // The run begins or ends near it.
            (200, &[(3, 30)], &[], &[(3, 0..=19)]),
            (105, &[(100, 30)], &[], &[(100, 41..=104)]),
            // Those that follow are of the same spike, and name it if they are later.
            (200, &[(100, 30), (110, 20)], &[], &[(100, 53..=116)]),
            (200, &[(100, 20), (110, 30)], &[], &[(110, 63..=126)]),
            // The worst comes first, a request last.
            (
                200,
                &[(50, 20), (100, 30)],
                &[],
                &[(100, 53..=116), (50, 3..=66)],
            ),
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
        let late: Vec<_> = (0..20)
            .map(|spike| (100 * spike, 7 * spike % 20 + 1))
            .collect();
        let kept = traced(2100, &late, &[]);
        let kept = kept.iter().map(|spike| spike.lateness().as_micros());
        assert!(kept.eq((13..=20).rev()));
    }
}
