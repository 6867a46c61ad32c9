//! Tests of the drive group of devices, against a scripted device whose telegram is a start byte, a sequence number, a
//! number and their sum.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Poll;
use std::time::Duration;

use can::Instant;
use serial::{Line, LineCounters, LineError, Settings};

use super::*;
use crate::{BringUpError, DriveGroup};

const PERIOD: Duration = Duration::from_millis(2);
const VALUES: &[DeviceValue] = &[DeviceValue::new("distance", "m", [0.0, 2.0])];

/// The driver: query `[0x51]`, answer `[0xA5, number, cm, sum]`. 0xFE as number of centimetres is a refusal, 0xFD and
/// 0xFC no echo, of which the driver writes the first alone.
#[derive(Default)]
struct Driver {
    bytes: [u8; 4],
    count: usize,
    /// No query is due from this time on.
    asks_until: Option<Instant>,
}

impl LineDriver for Driver {
    fn query(&mut self, now: Instant, query: &mut [u8; MOST_QUERY]) -> usize {
        query[0] = 0x51;
        usize::from(self.asks_until.is_none_or(|until| now < until))
    }

    fn receive(&mut self, byte: u8, _now: Instant, values: &mut [f64]) -> Reception {
        if self.count == 0 && byte != 0xA5 {
            return Reception::Skipped;
        }
        self.bytes[self.count] = byte;
        self.count += 1;
        match byte {
            _ if self.count != 3 => {}
            0xFD => values[0] = f64::NAN,
            0xFC | 0xFE => {}
            cm => values[0] = f64::from(cm) / 100.0,
        }
        if self.count < 4 {
            return Reception::Pending;
        }
        self.count = 0;
        let [start, number, cm, sum] = self.bytes;
        if sum != start.wrapping_add(number).wrapping_add(cm) {
            return Reception::Skipped;
        }
        if cm == 0xFE { Reception::Refused(number) } else { Reception::Sample }
    }

    fn restart(&mut self) {
        self.count = 0;
    }
}

/// The device at the other end: answers a query after some readings.
#[derive(Default)]
struct Script {
    cm: u8,
    number: u8,
    /// Readings until an answer; queries without an answer; bytes of an answer that are sent.
    delay: usize,
    mute: bool,
    torn: Option<usize>,
    broken: bool,
    /// The further copies of each answer: readings by which their first and second halves are later.
    copies: Vec<[usize; 2]>,
    /// Each answer has another number of centimetres.
    changing: bool,
    gone: bool,
    queries: usize,
    coming: VecDeque<(usize, u8)>,
}

impl Script {
    fn answer(&mut self) {
        self.number = self.number.wrapping_add(1);
        if self.changing {
            self.cm = self.number % 200;
        }
        let sum = 0xA5_u8.wrapping_add(self.number).wrapping_add(self.cm) ^ u8::from(self.broken);
        let bytes = [0xA5, self.number, self.cm, sum];
        for (half, later) in [0, 0].iter().chain(self.copies.as_flattened()).enumerate() {
            let bytes = bytes.iter().take(self.torn.unwrap_or(4)).skip(half % 2 * 2).take(2);
            self.coming.extend(bytes.map(|byte| (self.delay + later, *byte)));
        }
    }
}

#[derive(Clone, Default)]
struct Wire(Arc<Mutex<Script>>);

impl Wire {
    fn script(&self) -> MutexGuard<'_, Script> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Line for Wire {
    fn read(&mut self, _now: Instant, buffer: &mut [u8]) -> Result<usize, LineError> {
        let mut script = self.script();
        if script.gone {
            return Err(LineError::Gone);
        }
        let mut count = 0;
        while let Some((0, byte)) = script.coming.front().copied() {
            (buffer[count], count) = (byte, count + 1);
            script.coming.pop_front();
        }
        script.coming.iter_mut().for_each(|(delay, _)| *delay = delay.saturating_sub(1));
        Ok(count)
    }

    fn write(&mut self, _now: Instant, bytes: &[u8]) -> Result<usize, LineError> {
        let mut script = self.script();
        script.queries += bytes.len();
        if !script.mute {
            script.answer();
        }
        Ok(bytes.len())
    }

    fn counters(&self) -> LineCounters {
        LineCounters::default()
    }
}

struct Rig {
    wire: Wire,
    device: DeviceOnLine<Wire, Driver>,
    link: DeviceLink,
    samples: DeviceSamples,
    now: Instant,
}

fn config() -> DeviceConfig {
    let line = LineConfig::polled(Settings { baud: 115_200, ..Settings::EPOS }, 1, 4);
    DeviceConfig { period: PERIOD, line, values: VALUES, tolerated_missing: 3, boot_timeout: Duration::from_secs(1) }
}

fn streamed() -> LineConfig {
    LineConfig::streamed(Settings::EPOS, 4, Duration::from_millis(10))
}

impl Rig {
    fn new(config: DeviceConfig, script: Script) -> Self {
        Self::driven(config, Driver::default(), script)
    }

    fn driven(config: DeviceConfig, driver: Driver, script: Script) -> Self {
        let wire = Wire(Arc::new(Mutex::new(script)));
        let (device, link, samples) = DeviceOnLine::new(wire.clone(), driver, config).unwrap();
        Self { wire, device, link, samples, now: Instant::ZERO }
    }

    fn bring_up(&mut self) -> Result<(), BringUpError> {
        loop {
            self.now += PERIOD;
            if let Poll::Ready(result) = self.device.bring_up(self.now) {
                return result;
            }
        }
    }

    fn up() -> Self {
        let mut rig = Self::new(config(), Script { cm: 30, delay: 1, ..Script::default() });
        rig.bring_up().unwrap();
        rig
    }

    /// A device that sends by itself every 10 ms.
    fn streaming() -> Self {
        let mut rig = Self::new(DeviceConfig { line: streamed(), ..config() }, Script { cm: 50, ..Script::default() });
        rig.now += PERIOD;
        assert!(rig.device.bring_up(rig.now).is_pending());
        rig.wire.script().delay = 1;
        rig.wire.script().answer();
        rig.bring_up().unwrap();
        rig.wire.script().delay = 0;
        rig
    }

    /// The queries of 100 cycles.
    fn queries(&mut self) -> usize {
        let before = self.wire.script().queries;
        for _ in 0..100 {
            self.cycle();
        }
        self.wire.script().queries - before
    }

    fn cycle(&mut self) -> DeviceState {
        self.now += PERIOD;
        self.device.read(self.now, &mut []);
        self.device.send(self.now);
        self.link.read()
    }

    fn until(&mut self, holds: impl Fn(&DeviceState) -> bool) -> DeviceState {
        for _ in 0..2_000 {
            let state = self.cycle();
            if holds(&state) {
                return state;
            }
        }
        panic!("{:?} {:?}", self.link.read(), self.device.device_counters());
    }
}

#[test]
fn samples_follow_each_other_with_their_times_and_all_reach_the_ring() {
    let mut rig = Rig::up();
    assert_eq!(rig.link.read().measured().map(|sample| sample.values[0]), Some(0.3));
    rig.wire.script().cm = 120;
    let state = rig.until(|state| state.sample.number == 5);
    let sample = state.measured().unwrap();
    assert_eq!((sample.values[0], sample.read_at), (1.2, rig.now));
    assert!(sample.not_before < sample.read_at && sample.age(rig.now) <= 2 * PERIOD, "{sample:?}");
    let numbers: Vec<_> = std::iter::from_fn(|| rig.samples.take()).map(|(_, it)| it.map(|it| it.number)).collect();
    assert_eq!(numbers, [1, 2, 3, 4, 5].map(Some));
}

#[test]
fn a_number_that_was_not_measured_is_part_of_a_valid_sample() {
    let mut rig = Rig::up();
    rig.wire.script().cm = 0xFD;
    let state = rig.until(|state| state.sample.values[0].is_nan());
    assert!(state.measured().is_some() && state.fault.is_none());
}

#[test]
fn queries_keep_the_interval_of_the_device() {
    let line = config().line.every(Duration::from_millis(20));
    let mut rig = Rig::new(DeviceConfig { line, ..config() }, Script { cm: 30, ..Script::default() });
    rig.bring_up().unwrap();
    rig.until(|state| state.sample.number == 3);
    assert_eq!(rig.queries(), 10);
    rig.wire.script().cm = 0xFE;
    rig.until(|state| state.fault.is_some());
    assert_eq!(rig.queries(), 10);
    // A lost answer delays the next query by 76 ms.
    let line = config().line.every(Duration::from_millis(100));
    let mut rig = Rig::new(DeviceConfig { line, ..config() }, Script { cm: 30, ..Script::default() });
    rig.bring_up().unwrap();
    rig.wire.script().mute = true;
    assert_eq!((0..5).map(|_| rig.queries()).sum::<usize>(), 10);
}

#[test]
fn jitter_of_the_cycle_skips_no_query_and_an_interval_is_rounded_up_to_a_period() {
    let every = |micros: u64| {
        let line = config().line.every(Duration::from_micros(micros));
        let mut rig = Rig::new(DeviceConfig { line, ..config() }, Script { cm: 30, ..Script::default() });
        rig.bring_up().unwrap();
        let before = rig.wire.script().queries;
        for cycle in 0..100_u64 {
            let jitter = Duration::from_micros(cycle * 7 % 20);
            rig.now += PERIOD;
            rig.device.read(rig.now + jitter, &mut []);
            rig.device.send(rig.now + jitter);
        }
        rig.wire.script().queries - before
    };
    assert_eq!([20_000, 10_000, 9_000].map(every), [10, 20, 20]);
}

#[test]
fn a_device_that_answers_at_once_has_the_greatest_rate() {
    for (line, periods) in [(config().line, 2), (config().line.numbered(), 1)] {
        let mut rig = Rig::new(DeviceConfig { line, ..config() }, Script { cm: 30, ..Script::default() });
        rig.bring_up().unwrap();
        let before = rig.link.read().sample.number;
        let begun = rig.now;
        rig.until(|state| state.sample.number == before + 100);
        assert_eq!(line.least_sample_time(PERIOD), periods * PERIOD);
        assert!(rig.now.since(begun).abs_diff(100 * periods * PERIOD) <= 2 * PERIOD, "{:?}", rig.now.since(begun));
    }
}

#[test]
fn a_driver_without_a_query_has_no_valid_sample_after_its_time() {
    let driver = Driver { asks_until: Some(Instant::ZERO + Duration::from_millis(100)), ..Driver::default() };
    let mut rig = Rig::driven(config(), driver, Script { cm: 30, ..Script::default() });
    rig.bring_up().unwrap();
    let state = rig.until(|state| state.fault.is_some());
    assert_eq!(state.fault, Some(DeviceFault::Silent { samples: 4 }));
    let most = config().line.loss_time(PERIOD) * 4;
    assert!(rig.now.since(Instant::ZERO + Duration::from_millis(100)) <= most, "{:?} of {most:?}", rig.now);
}

#[test]
fn bytes_that_piled_up_while_other_groups_came_up_are_no_sample() {
    let mut rig = Rig::streaming();
    for _ in 0..50 {
        rig.now += PERIOD;
        rig.wire.script().answer();
        rig.device.wait(rig.now);
    }
    assert_eq!(rig.cycle().sample.number, 1);
    let sent_at = rig.now;
    rig.wire.script().answer();
    rig.cycle();
    rig.wire.script().answer();
    let state = rig.cycle();
    assert!(state.sample.number > 1 && state.sample.not_before >= sent_at - PERIOD, "{state:?}");
    assert!(rig.device.device_counters().missing == 0);
}

#[test]
fn the_age_of_bytes_that_waited_for_a_late_cycle_is_counted_from_the_reading_before() {
    let mut rig = Rig::streaming();
    rig.cycle();
    let sent_at = rig.now;
    rig.wire.script().answer();
    rig.now += Duration::from_millis(500);
    let state = rig.cycle();
    let sample = state.measured().unwrap();
    assert!(sample.number == 2 && sample.not_before <= sent_at, "{sample:?} sent at {sent_at:?}");
}

#[test]
fn bytes_before_a_reset_do_not_end_the_fault_of_a_device_that_sends_by_itself() {
    let mut rig = Rig::streaming();
    rig.until(|state| state.fault.is_some());
    rig.wire.script().answer();
    rig.link.reset_fault();
    let requested_at = rig.now;
    assert!(rig.cycle().fault.is_some());
    rig.wire.script().delay = 2;
    rig.wire.script().answer();
    let state = rig.until(|state| state.fault.is_none());
    assert!(state.measured().unwrap().not_before > requested_at, "{state:?} requested at {requested_at:?}");
}

#[test]
fn a_device_that_sends_by_itself_misses_a_sample_per_interval() {
    let mut rig = Rig::streaming();
    let begun = rig.now;
    rig.until(|state| state.fault.is_some());
    let most = streamed().answer_timeout(PERIOD) + 3 * streamed().interval + 2 * PERIOD;
    assert!(rig.now.since(begun) <= most, "{:?} of {most:?}", rig.now.since(begun));
}

#[test]
fn a_later_copy_of_an_answer_is_not_the_answer_to_the_next_query() {
    for copies in [&[[1, 1]][..], &[[0, 1]], &[[1, 2]], &[[1, 3]], &[[1, 1], [2, 2]]] {
        let mut rig = Rig::up();
        {
            let mut script = rig.wire.script();
            script.coming.clear();
            (script.changing, script.copies, script.delay) = (true, copies.to_vec(), 0);
        }
        // The answer under way was cleared: the script begins with the query after.
        let wire = rig.wire.clone();
        rig.until(|_| wire.script().number > 2);
        let mut number = rig.link.read().sample.number;
        let mut fresh = 0;
        for _ in 0..200 {
            rig.now += PERIOD;
            rig.device.read(rig.now, &mut []);
            let sample = rig.link.read().sample;
            if sample.number > number {
                (number, fresh) = (sample.number, fresh + 1);
                assert_eq!(sample.values[0], f64::from(rig.wire.script().cm) / 100.0, "{copies:?}, sample {number}");
            }
            rig.device.send(rig.now);
        }
        // Half a copy at the time of a query costs the time of a lost answer.
        assert!(fresh >= 4, "{copies:?}: {fresh} samples");
    }
}

#[test]
fn a_number_that_the_driver_does_not_write_is_not_measured() {
    let mut rig = Rig::up();
    rig.wire.script().cm = 0xFC;
    let first = rig.link.read().sample.number;
    let state = rig.until(|state| state.sample.number == first + 3);
    assert!(state.measured().unwrap().values[0].is_nan(), "{state:?}");
}

#[test]
fn silence_beyond_the_tolerance_is_a_fault_within_its_time_and_the_last_sample_is_not_valid() {
    let mut rig = Rig::up();
    rig.wire.script().mute = true;
    let begun = rig.now;
    let state = rig.until(|state| state.fault.is_some());
    assert_eq!(state.fault, Some(DeviceFault::Silent { samples: 4 }));
    let line = config().line;
    let most = (line.answer_timeout(PERIOD) + line.quiet_time(PERIOD) + 4 * PERIOD) * 4;
    assert!(rig.now.since(begun) <= most, "{:?} of {most:?}", rig.now.since(begun));
    assert!(state.sample.number > 0 && state.measured().is_none());
    let last = std::iter::from_fn(|| rig.samples.take()).last();
    assert!(matches!(last, Some((_, None))), "{last:?}");
}

#[test]
fn torn_and_broken_answers_are_garbage_and_no_number_of_them_is_used() {
    for (torn, broken) in [(Some(3), false), (Some(1), false), (None, true)] {
        let mut rig = Rig::up();
        let number = rig.link.read().sample.number;
        {
            let mut script = rig.wire.script();
            script.coming.clear();
            (script.torn, script.broken, script.cm) = (torn, broken, 77);
        }
        let state = rig.until(|state| state.fault.is_some());
        assert!(matches!(state.fault, Some(DeviceFault::Garbage { readings: 4.. })), "{torn:?}: {:?}", state.fault);
        assert_eq!((state.sample.number, state.sample.values[0]), (number, 0.3));
    }
}

#[test]
fn an_answer_that_comes_after_its_time_is_not_the_answer_to_the_next_query() {
    let mut rig = Rig::up();
    let number = rig.link.read().sample.number;
    // An answer takes 60 ms, and its time limit is 25 ms.
    {
        let mut script = rig.wire.script();
        (script.delay, script.cm) = (30, 99);
    }
    let state = rig.until(|state| state.fault.is_some());
    assert!(matches!(state.fault, Some(DeviceFault::Garbage { .. } | DeviceFault::Silent { .. })), "{state:?}");
    assert!(state.sample.number <= number + 1 && state.sample.values[0] == 0.3, "{state:?}");
}

#[test]
fn a_repeated_answer_is_counted_and_is_no_second_sample() {
    let mut rig = Rig::up();
    rig.wire.script().copies = vec![[0, 0]];
    let before = rig.device.device_counters();
    let first = rig.link.read().sample.number;
    rig.until(|state| state.sample.number == first + 10);
    let after = rig.device.device_counters();
    assert!(after.garbage - before.garbage >= 9, "{after:?}");
}

#[test]
fn a_number_beyond_its_range_is_no_valid_answer() {
    let mut rig = Rig::up();
    rig.wire.script().cm = 240;
    let state = rig.until(|state| state.fault.is_some());
    assert!(matches!(state.fault, Some(DeviceFault::Garbage { .. })) && state.sample.values[0] == 0.3, "{state:?}");
}

#[test]
fn a_reset_takes_effect_with_the_next_sample() {
    let mut rig = Rig::up();
    rig.wire.script().mute = true;
    rig.until(|state| state.fault.is_some());
    rig.link.reset_fault();
    // The fault that persists is latched again.
    for _ in 0..400 {
        assert_eq!(rig.cycle().fault, Some(DeviceFault::Silent { samples: 4 }));
    }
    rig.wire.script().mute = false;
    for _ in 0..100 {
        assert!(rig.cycle().fault.is_some());
    }
    rig.link.reset_fault();
    let state = rig.until(|state| state.fault.is_none());
    assert!(state.measured().is_some());
}

#[test]
fn bring_up_names_what_is_at_the_other_end() {
    let error = |script: Script| match Rig::new(config(), script).bring_up() {
        Err(BringUpError::Device { error }) => error,
        other => panic!("{other:?}"),
    };
    assert!(matches!(error(Script { mute: true, ..Script::default() }), DeviceError::Absent { .. }));
    assert!(matches!(error(Script { broken: true, ..Script::default() }), DeviceError::Garbled { bytes: 4.. }));
    assert_eq!(error(Script { cm: 0xFE, number: 6, ..Script::default() }), DeviceError::Refused { code: 7 });
    assert_eq!(error(Script { gone: true, ..Script::default() }), DeviceError::Line(LineError::Gone));
}

#[test]
fn a_device_that_sends_by_itself_is_heard_and_its_silence_is_a_fault() {
    let mut rig = Rig::streaming();
    for _ in 0..10 {
        rig.wire.script().answer();
        for _ in 0..5 {
            rig.cycle();
        }
    }
    let state = rig.link.read();
    assert_eq!((state.sample.number, rig.wire.script().queries), (11, 0));
    let state = rig.until(|state| state.fault.is_some());
    assert_eq!(state.fault, Some(DeviceFault::Silent { samples: 4 }));
}

#[test]
fn the_end_of_the_driver_and_of_the_line_are_faults() {
    let mut rig = Rig::up();
    rig.wire.script().gone = true;
    assert_eq!(rig.cycle().fault, Some(DeviceFault::Line(LineError::Gone)));
    let Rig { device, link, .. } = Rig::up();
    drop(device);
    assert_eq!(link.read().fault, Some(DeviceFault::Ended));
}

#[test]
fn declarations_that_no_output_could_show_are_refused() {
    const TWICE: &[DeviceValue] = &[VALUES[0], VALUES[0]];
    const MANY: &[DeviceValue] = &[DeviceValue::new("x", "", [0.0, 1.0]).times(17)];
    const SPACED: &[DeviceValue] = &[DeviceValue::new("a b", "", [0.0, 1.0])];
    const INDEXED: &[DeviceValue] =
        &[DeviceValue::new("x", "", [0.0, 1.0]).times(2), DeviceValue::new("x_0", "", [0.0, 1.0])];
    const REVERSED: &[DeviceValue] = &[DeviceValue::new("x", "", [1.0, 0.0])];
    let bad = [
        (DeviceConfig { values: &[], ..config() }, "a sample of 0 numbers"),
        (DeviceConfig { values: MANY, ..config() }, "a sample of 17 numbers"),
        (DeviceConfig { values: TWICE, ..config() }, "the value \"distance\""),
        (DeviceConfig { values: INDEXED, ..config() }, "numbers of \"x\" and \"x_0\" with the same name"),
        (DeviceConfig { values: SPACED, ..config() }, "the value \"a b\""),
        (DeviceConfig { values: REVERSED, ..config() }, "the range 1 to 0 of x"),
        (DeviceConfig { line: LineConfig::polled(Settings::EPOS, 65, 4), ..config() }, "a query of 65 bytes"),
        (DeviceConfig { line: LineConfig::polled(Settings::EPOS, 1, 0), ..config() }, "an answer of 0 bytes"),
        (
            DeviceConfig { line: LineConfig::streamed(Settings::EPOS, 4, Duration::ZERO), ..config() },
            "an interval of 0ns",
        ),
        (
            DeviceConfig { line: LineConfig::streamed(Settings::EPOS, 400, Duration::from_millis(10)), ..config() },
            "an answer takes 34.7ms on the line",
        ),
    ];
    for (config, said) in bad {
        let error = config.check().unwrap_err().to_string();
        assert!(error.starts_with(said), "{error}");
    }
}
