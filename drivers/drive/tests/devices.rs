//! No cycle of a device of another crate allocates.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use can::Instant;
use mrroc_drive::DriveGroup;
use mrroc_drive::device::{DeviceConfig, DeviceOnLine, DeviceValue, LineConfig, LineDriver, MOST_QUERY, Reception};
use serial::{Line, LineCounters, LineError, Settings};

use crate::no_allocation::ALLOCATIONS;

const PERIOD: Duration = Duration::from_millis(2);

const VALUES: &[DeviceValue] = &[DeviceValue::new("x", "", [0.0, 255.0])];

/// Every byte is a sample, except for 0.
struct Bytes;

impl LineDriver for Bytes {
    fn query(&mut self, _now: Instant, query: &mut [u8; MOST_QUERY]) -> usize {
        query[0] = 1;
        1
    }

    fn receive(&mut self, byte: u8, _now: Instant, values: &mut [f64]) -> Reception {
        values[0] = byte.into();
        if byte == 0 { Reception::Skipped } else { Reception::Sample }
    }

    fn restart(&mut self) {}
}

/// Answers each query with a byte, with 0, or not at all.
#[derive(Clone, Copy, Default)]
struct State {
    answer: Option<u8>,
    due: bool,
    gone: bool,
}

#[derive(Clone, Default)]
struct Wire(Arc<Mutex<State>>);

impl Line for Wire {
    fn read(&mut self, _now: Instant, buffer: &mut [u8]) -> Result<usize, LineError> {
        let mut state = self.0.lock().unwrap();
        if state.gone {
            return Err(LineError::Gone);
        }
        let answer = state.answer.filter(|_| std::mem::take(&mut state.due));
        buffer[0] = answer.unwrap_or(0);
        Ok(usize::from(answer.is_some()))
    }

    fn write(&mut self, _now: Instant, bytes: &[u8]) -> Result<usize, LineError> {
        self.0.lock().unwrap().due = true;
        Ok(bytes.len())
    }

    fn counters(&self) -> LineCounters {
        LineCounters::default()
    }
}

#[test]
fn no_cycle_of_a_device_of_another_crate_allocates() {
    let answering = State { answer: Some(7), ..State::default() };
    let wire = Wire(Arc::new(Mutex::new(answering)));
    let config = DeviceConfig {
        period: PERIOD,
        line: LineConfig::polled(Settings::EPOS, 1, 1),
        values: VALUES,
        tolerated_missing: 3,
        boot_timeout: Duration::from_secs(1),
    };
    // No reader takes the samples, so their ring is soon full.
    let (mut device, link, samples) = DeviceOnLine::new(wire.clone(), Bytes, config).unwrap();
    let mut now = Instant::ZERO;
    while device.bring_up(now).map(Result::unwrap).is_pending() {
        now += PERIOD;
    }
    let states = [
        answering,
        State::default(),
        State { answer: Some(0), ..State::default() },
        State { gone: true, ..State::default() },
        answering,
    ];
    let mut faults = Vec::with_capacity(states.len());
    for state in states {
        *wire.0.lock().unwrap() = state;
        link.reset_fault();
        for _ in 0..1_500 {
            now += PERIOD;
            let before = ALLOCATIONS.get();
            device.read(now, &mut []);
            device.write(now, &[]);
            device.send(now);
            link.read();
            assert_eq!(ALLOCATIONS.get() - before, 0);
        }
        faults.extend(link.read().fault);
    }
    assert_eq!(faults.len(), 3, "{faults:?}");
    assert!(link.read().measured().is_some() && samples.lost() > 0);
}
