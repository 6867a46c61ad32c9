//! Transfer of histograms from the measuring thread to an ordinary thread, about one per second.
//!
//! All histograms are allocated before the measurement. Each belongs to one of the two threads at a time, so the
//! measuring thread neither allocates nor waits. If the ordinary thread lags, intervals grow longer and no count is
//! lost. The memory of a measurement does not depend on its duration.

use std::io;
use std::mem;
use std::time::Duration;

use can::Instant;
use hdrhistogram::Histogram;
use rtrb::{Consumer, Producer, RingBuffer};

use super::files::IntervalLog;

/// Histogram of times, ns.
pub(super) type Counts = Histogram<u64>;

/// Minimum length of an interval.
const INTERVAL: Duration = Duration::from_secs(1);

/// Number of histograms beside the one being filled; enough for some seconds.
const SPARE: usize = 3;

/// Largest latency of a histogram, ns. A larger latency is counted as this value, and as one beyond it.
const LATEST: u64 = 10_000_000_000;

/// Capacity of a series. A full series is halved by joining neighbours.
const TIMES: usize = 2048;

/// An empty histogram from 1 ns to 10 s with three significant digits, as [`servo::Histogram`].
pub(super) fn counts() -> Counts {
    Counts::new_with_bounds(1, LATEST, 3).expect("the bounds are constants that the library accepts")
}

/// Latencies in ns: a histogram up to 10 s, and what is beyond.
#[derive(Clone)]
pub(super) struct Latencies {
    /// Latencies above 10 s count as 10 s.
    pub counts: Counts,
    /// Number of latencies above 10 s.
    pub beyond: u64,
    /// The longest latency above 10 s; 0 if there is none.
    longest: u64,
}

impl Latencies {
    pub(super) fn empty() -> Self {
        Self { counts: counts(), beyond: 0, longest: 0 }
    }

    /// Copy of `histogram`, which has the same bins.
    pub(super) fn of(histogram: &servo::Histogram) -> Self {
        let mut counts = counts();
        for (duration, count) in histogram.bins() {
            counts.saturating_record_n(duration.as_nanos() as u64, count);
        }
        let beyond = histogram.beyond();
        let longest = if beyond > 0 { u64::try_from(histogram.max().as_nanos()).unwrap_or(u64::MAX) } else { 0 };
        Self { counts, beyond, longest }
    }

    /// Counts a latency `count` times.
    pub(super) fn record(&mut self, nanos: u64, count: u64) {
        self.counts.saturating_record_n(nanos.min(LATEST), count);
        if nanos > LATEST {
            self.beyond += count;
            self.longest = self.longest.max(nanos);
        }
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.counts.add(&other.counts).expect("all histograms have the same bounds");
        self.beyond += other.beyond;
        self.longest = self.longest.max(other.longest);
    }

    /// The true maximum, ns.
    pub(super) fn max(&self) -> u64 {
        self.counts.max().max(self.longest)
    }

    /// Number of latencies.
    pub(super) fn len(&self) -> u64 {
        self.counts.len()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.counts.is_empty()
    }

    fn reset(&mut self) {
        self.counts.reset();
        (self.beyond, self.longest) = (0, 0);
    }
}

/// Latencies of a part of a measurement.
pub(super) struct Interval {
    pub begun: Instant,
    pub ended: Instant,
    pub late: Latencies,
}

impl Interval {
    fn empty() -> Box<Self> {
        Box::new(Self { begun: Instant::ZERO, ended: Instant::ZERO, late: Latencies::empty() })
    }
}

/// Sending end, for the measuring thread.
pub(super) struct Recorder {
    filling: Box<Interval>,
    full: Producer<Box<Interval>>,
    empty: Consumer<Box<Interval>>,
}

impl Recorder {
    /// Starts a turn.
    pub(super) fn begin(&mut self, now: Instant) {
        if self.filling.late.is_empty() {
            self.filling.begun = now;
        }
    }

    /// Records the latency of one wake-up.
    pub(super) fn record(&mut self, late: Duration, now: Instant) {
        self.filling.late.record(u64::try_from(late.as_nanos()).unwrap_or(u64::MAX), 1);
        self.filling.ended = now;
        if now.since(self.filling.begun) >= INTERVAL {
            self.hand_over();
        }
    }

    /// Hands the interval over if an empty histogram is available.
    pub(super) fn hand_over(&mut self) {
        if self.filling.late.is_empty() {
            return;
        }
        if let Ok(mut next) = self.empty.pop() {
            next.begun = self.filling.ended;
            let full = mem::replace(&mut self.filling, next);
            // The queue has as many places as there are histograms.
            let _ = self.full.push(full);
        }
    }
}

/// Receiving end, for the ordinary thread: the sum of all turns of one side.
pub(super) struct Ledger<'a> {
    full: Consumer<Box<Interval>>,
    empty: Producer<Box<Interval>>,
    /// Latencies of the whole measurement.
    pub total: Latencies,
    pub series: Series,
    log: Option<IntervalLog<'a>>,
}

/// Creates both ends. `began` is time zero of the series and of the log.
pub(super) fn recording(began: Instant, log: Option<IntervalLog<'_>>) -> (Recorder, Ledger<'_>) {
    let (full, filled) = RingBuffer::new(SPARE + 1);
    let (mut emptied, empty) = RingBuffer::new(SPARE + 1);
    for _ in 0..SPARE {
        let _ = emptied.push(Interval::empty());
    }
    let recorder = Recorder { filling: Interval::empty(), full, empty };
    let ledger = Ledger { full: filled, empty: emptied, total: Latencies::empty(), series: Series::new(began), log };
    (recorder, ledger)
}

impl Ledger<'_> {
    /// Processes all intervals that were handed over.
    pub(super) fn drain(&mut self) -> io::Result<()> {
        while let Ok(mut interval) = self.full.pop() {
            self.add(&interval)?;
            interval.late.reset();
            let _ = self.empty.push(interval);
        }
        Ok(())
    }

    /// Adds an interval that was measured elsewhere.
    pub(super) fn add(&mut self, interval: &Interval) -> io::Result<()> {
        if interval.late.is_empty() {
            return Ok(());
        }
        self.total.add(&interval.late);
        self.series.add(interval);
        match &mut self.log {
            Some(log) => log.write(interval, self.series.began),
            None => Ok(()),
        }
    }
}

/// Maximum latency of each interval, in bounded memory.
pub(super) struct Series {
    began: Instant,
    /// Start and end, s, and the maximum latency between them, µs.
    pub times: Vec<[f64; 3]>,
}

impl Series {
    pub(super) fn new(began: Instant) -> Self {
        Self { began, times: Vec::with_capacity(TIMES) }
    }

    fn add(&mut self, interval: &Interval) {
        if self.times.len() == TIMES {
            let pairs = self.times.chunks(2);
            let joined = pairs.map(|pair| {
                let last = pair[pair.len() - 1];
                [pair[0][0], last[1], pair[0][2].max(last[2])]
            });
            self.times = joined.collect();
        }
        let [from, to] = [interval.begun, interval.ended].map(|at| at.since(self.began).as_secs_f64());
        self.times.push([from, to, interval.late.max() as f64 / 1e3]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK: Duration = Duration::from_millis(10);

    #[test]
    fn a_reader_that_lags_makes_intervals_longer_and_loses_none() {
        let (mut recorder, mut ledger) = recording(Instant::ZERO, None);
        let mut now = Instant::ZERO;
        recorder.begin(now);
        for cycle in 0..2000 {
            now += TICK;
            recorder.record(Duration::from_micros(cycle % 100 + 1), now);
        }
        ledger.drain().unwrap();
        assert_eq!(ledger.series.times.len(), SPARE);
        recorder.hand_over();
        ledger.drain().unwrap();
        assert_eq!(ledger.total.len(), 2000);
        let spans: Vec<_> = (ledger.series.times.iter()).map(|[from, to, _]| (to - from).round() as u32).collect();
        assert_eq!(spans, [1, 1, 1, 17]);
        assert!((ledger.total.counts.value_at_quantile(0.5) as f64 / 50e3 - 1.0).abs() < 2e-3);
    }

    #[test]
    fn a_series_of_a_week_stays_in_its_room_and_keeps_the_worst() {
        let mut series = Series::new(Instant::ZERO);
        let mut interval = Interval::empty();
        for second in 0..10 * TIMES as u64 {
            interval.late.reset();
            let late = if second == 777 { 5_000_000 } else { 1000 };
            interval.late.record(late, 1);
            interval.begun = Instant::from_nanos(second * 1_000_000_000);
            interval.ended = Instant::from_nanos((second + 1) * 1_000_000_000);
            series.add(&interval);
        }
        assert!(series.times.len() <= TIMES && series.times.len() > TIMES / 4);
        let worst = series.times.iter().max_by(|a, b| a[2].total_cmp(&b[2])).unwrap();
        assert!(worst[2] >= 5000.0 && (worst[0]..worst[1]).contains(&777.5), "{worst:?}");
    }

    #[test]
    fn latencies_beyond_the_histogram_are_counted_with_their_true_maximum() {
        let (mut recorder, mut ledger) = recording(Instant::ZERO, None);
        let mut servos = servo::Histogram::default();
        for late in [Duration::from_micros(5), Duration::from_secs(14), Duration::from_secs(12)] {
            recorder.record(late, Instant::ZERO + late);
            servos.record(late);
        }
        recorder.hand_over();
        ledger.drain().unwrap();
        for late in [&ledger.total, &Latencies::of(&servos)] {
            assert_eq!((late.len(), late.beyond, late.max()), (3, 2, 14_000_000_000));
        }
        let worst = ledger.series.times.iter().map(|interval| interval[2]).fold(0.0, f64::max);
        assert_eq!(worst, 14e6);
        // An interval that is used again has nothing of the one before.
        recorder.record(Duration::from_micros(5), Instant::ZERO + TICK);
        recorder.hand_over();
        ledger.drain().unwrap();
        assert_eq!((ledger.total.len(), ledger.total.beyond), (4, 2));
    }

    #[test]
    fn counts_of_the_servo_are_the_same_counts() {
        let (mut ours, mut servos) = (counts(), servo::Histogram::default());
        for nanos in (0..3_000_000).step_by(977) {
            ours.saturating_record(nanos);
            servos.record(Duration::from_nanos(nanos));
        }
        let copied = Latencies::of(&servos);
        for quantile in [0.5, 0.99, 0.999, 1.0] {
            let expected = ours.value_at_quantile(quantile);
            assert_eq!(copied.counts.value_at_quantile(quantile), expected);
        }
        assert_eq!(copied.len(), ours.len());
    }
}
