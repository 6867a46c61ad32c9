//! The shells under random times of readings, random macrosteps and random periods.

use std::sync::{Arc, Mutex};

use super::*;
use crate::random::Random;

const MILLISECOND: Duration = Duration::from_millis(1);

/// Times of all readings so far, in ascending order. The value of a reading is its index.
type Times = Arc<Mutex<Vec<Instant>>>;

/// A sensor that measures at random times by itself, or some time after each request.
struct Slow {
    random: Random,
    by_itself: bool,
    times: Times,
}

impl Slow {
    fn new(mut random: Random, by_itself: bool) -> Self {
        let mut next = Instant::ZERO;
        let measured = (0..1000).map(|_| {
            next += MILLISECOND * (1 + random.next() % 40) as u32;
            next
        });
        let times: Vec<_> = if by_itself { measured.collect() } else { Vec::new() };
        Self { random, by_itself, times: Arc::new(Mutex::new(times)) }
    }
}

impl VirtualSensor for Slow {
    type Reading = Height;
    type Command = ();

    fn initiate(&mut self, now: Instant) {
        let mut times = self.times.lock().unwrap();
        assert!(!self.by_itself && times.last().is_none_or(|last| *last <= now), "a request during a request");
        times.push(now + MILLISECOND * (1 + self.random.next() % 40) as u32);
    }

    fn poll(&mut self, now: Instant) -> Option<(Instant, Height)> {
        let times = self.times.lock().unwrap();
        let latest = times.iter().rposition(|time| *time <= now)?;
        let asked = self.by_itself || latest + 1 == times.len();
        asked.then(|| (times[latest], Height(latest as u32)))
    }
}

#[test]
fn every_step_takes_what_its_shell_promises_at_random_times() {
    for seed in 0..600 {
        let shell = [Shell::NonInteractive, Shell::Interactive, Shell::InteractiveWithoutWait][seed as usize % 3];
        let mut random = Random(seed);
        let period = 1 + (random.next() % 4) as u16;
        let slow = Slow::new(Random(!seed), shell == Shell::NonInteractive);
        let times = Arc::clone(&slow.times);
        let mut sensors = Sensors::default();
        sensors.install(slow, shell, period).unwrap();
        sensors.begin();
        let (mut now, mut last) = (Instant::ZERO, None);
        for step in 0..100_u16 {
            let case = format!("seed {seed}, {shell:?}, period {period}, step {step}");
            let due = step.is_multiple_of(period);
            sensors.initiate(now);
            sensors.poll(now);
            let end = now + MILLISECOND * (1 + random.next() % 30) as u32;
            while now < end || !ready(&sensors) {
                now += MILLISECOND;
                sensors.poll(now);
            }
            let times = times.lock().unwrap();
            let latest = times.iter().rposition(|time| *time <= now);
            // The other steps leave a sensor that works by itself alone. A reading that is late is taken in any step.
            let expected = if due || shell != Shell::NonInteractive { latest } else { last };
            let sample =
                |index: usize| Sample { at: times[index], age: now.since(times[index]), value: Height(index as u32) };
            let received = match expected.map(sample) {
                None => Received::None,
                Some(sample) if expected == last => Received::Old(sample),
                Some(sample) => Received::New(sample),
            };
            assert_eq!(reading(&sensors), received, "{case}");
            if shell == Shell::Interactive {
                assert_eq!(due, expected != last, "{case}: each period has one reading");
                assert!(now == end || due && expected.is_some_and(|index| times[index] == now), "{case}: {now:?}");
            } else {
                assert_eq!(now, end, "{case}: waited");
            }
            last = expected;
        }
        assert!(last.is_some_and(|index| index > 10), "seed {seed}: {last:?}");
    }
}
