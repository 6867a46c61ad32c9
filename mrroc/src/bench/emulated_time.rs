//! The time of emulated devices: that of the clock, but for when their machine stood still.

use std::time::Duration;

use can::Instant;

/// A wait that ends so much too late is a standstill of the machine, of a virtual one as a rule, and of its hosts with it:
/// a busy one is not so late.
const STANDSTILL: Duration = Duration::from_millis(100);

/// How far the time of devices is behind the clock. An arm whose machine stood still did not move meanwhile, and what its
/// drives watch was not silent.
#[derive(Clone, Copy, Debug, Default)]
pub struct EmulatedTime(Duration);

impl EmulatedTime {
    /// The time that is zero when the clock shows `start`.
    pub fn since(start: Instant) -> Self {
        Self(start.since(Instant::ZERO))
    }

    /// The time when the clock shows `clock`.
    pub fn at(self, clock: Instant) -> Instant {
        clock - self.0
    }

    /// What the clock shows at `time`, unless the machine stands still before.
    pub fn clock(self, time: Instant) -> Instant {
        time + self.0
    }

    /// A wait that was to end when the clock shows `until` ended by something that came at `came`: by the clock itself, if
    /// nothing did.
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
            // One that stood still for 0.9 s. What came long before it was noticed shows that the machine did not.
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
