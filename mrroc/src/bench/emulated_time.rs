//! The time of emulated devices: the clock, without the times at which their machine stood still.

use std::time::Duration;

use can::Instant;

/// A wait that overshoots by more than this is taken for a standstill of the whole (virtual) machine, including the
/// hosts of the devices. A busy machine causes shorter delays.
const STANDSTILL: Duration = Duration::from_millis(100);

/// Difference between the clock and the time of the devices. During a standstill of the machine, an arm did not move,
/// and the drives must not detect silence.
#[derive(Clone, Copy, Debug, Default)]
pub struct EmulatedTime(Duration);

impl EmulatedTime {
    /// A time that is zero when the clock shows `start`.
    pub fn since(start: Instant) -> Self {
        Self(start.since(Instant::ZERO))
    }

    /// The time of the devices when the clock shows `clock`.
    pub fn at(self, clock: Instant) -> Instant {
        clock - self.0
    }

    /// The clock at the device time `time`, if no standstill occurs before.
    pub fn clock(self, time: Instant) -> Instant {
        time + self.0
    }

    /// Notes the end of a wait that was to end when the clock shows `until`. `came` is the time of the event that
    /// ended the wait, or the present time if there was none.
    pub fn waited(&mut self, until: Instant, came: Instant) {
        let late = came.since(until);
        if late >= STANDSTILL {
            self.0 += late;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_standstill_of_the_machine_is_no_time_of_the_devices() {
        let at = |millis| Instant::ZERO + Duration::from_millis(millis);
        let mut time = EmulatedTime::since(at(1000));
        for (until, came, clock, shown) in [
            // In time, and early.
            (1050, 1050, 1050, 50),
            (1100, 1070, 1070, 70),
            // A busy machine.
            (1100, 1199, 1199, 199),
            // A standstill of 0.9 s. An event long before it was handled shows that the machine did not stand still.
            (1200, 2100, 2100, 200),
            (2150, 2150, 3000, 1100),
        ] {
            time.waited(at(until), at(came));
            assert_eq!(time.at(at(clock)), at(shown));
            assert_eq!(time.clock(at(shown)), at(clock));
        }
        assert_eq!(time.at(at(10)), Instant::ZERO);
    }
}
