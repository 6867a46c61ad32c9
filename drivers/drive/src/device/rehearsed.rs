//! A device of a rehearsal: no wire, and always the same sample.

use std::time::Duration;

use can::Instant;

use super::state::{DeviceLink, DeviceState, DriverEnds, ends};
use super::value::MOST_VALUES;

/// A device without a wire, for the ideal drives of a rehearsal. The device gives the same numbers at its rate.
pub struct RehearsedDevice {
    state: DeviceState,
    ends: DriverEnds,
    sample_time: Duration,
}

impl RehearsedDevice {
    /// A device in operation with a sample of `numbers` every `sample_time`, and the controller's end of it.
    pub fn new(numbers: &[f64], sample_time: Duration) -> (Self, DeviceLink) {
        let (mut ends, link, _) = ends(numbers.len().min(MOST_VALUES));
        let mut state = DeviceState { fault: None, ..DeviceState::NOT_STARTED };
        state.sample.values.iter_mut().zip(numbers).for_each(|(place, number)| *place = *number);
        ends.publisher.publish(&state.words());
        (Self { state, ends, sample_time }, link)
    }

    /// Advances the device by one cycle, to `now`.
    pub fn advance(&mut self, now: Instant) {
        let Self { state, ends, sample_time } = self;
        if state.sample.number == 0 || now.since(state.sample.read_at) >= *sample_time {
            state.sample.number += 1;
            (state.sample.read_at, state.sample.not_before) = (now, now);
        }
        state.at = now;
        ends.publisher.publish(&state.words());
        state.cycle += 1;
    }
}
