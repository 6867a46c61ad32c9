//! TIME (CiA 301): the frame that tells the nodes which day and time it is.

use std::time::Duration;

use can::Frame;

use crate::{cob, frame, payload};

/// From the beginning of Unix time, 1970-01-01, to that of CANopen, 1984-01-01.
pub const EPOCH: Duration = Duration::from_secs(5113 * 86_400);

const DAY_MS: u128 = 86_400_000;

/// Days since 1984-01-01 and milliseconds after midnight (CiA 301 TIME_OF_DAY).
///
/// Which time zone, and what of leap seconds, is up to those who use it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TimeOfDay {
    days: u16,
    millis: u32,
}

impl TimeOfDay {
    /// The largest number of milliseconds that 28 bits hold; a day has 86_400_000.
    pub const MAX_MILLIS: u32 = 0x0FFF_FFFF;

    /// `None` above [`TimeOfDay::MAX_MILLIS`].
    pub const fn new(days: u16, millis: u32) -> Option<Self> {
        if millis <= Self::MAX_MILLIS {
            Some(Self { days, millis })
        } else {
            None
        }
    }

    /// Days since 1984-01-01.
    pub const fn days(self) -> u16 {
        self.days
    }

    /// Milliseconds after midnight.
    pub const fn millis(self) -> u32 {
        self.millis
    }

    /// From the time since 1984-01-01, of which whole milliseconds are kept; `None` after 65_535 days, in the
    /// year 2163.
    pub fn from_duration(since_1984: Duration) -> Option<Self> {
        let millis = since_1984.as_millis();
        Some(Self {
            days: u16::try_from(millis / DAY_MS).ok()?,
            millis: (millis % DAY_MS) as u32,
        })
    }

    /// The time since 1984-01-01.
    pub fn to_duration(self) -> Duration {
        Duration::from_secs(u64::from(self.days) * 86_400)
            + Duration::from_millis(self.millis.into())
    }

    /// The frame, for programs of one's own that send the time.
    pub fn encode(self) -> Frame {
        let [a, b, c, d] = self.millis.to_le_bytes();
        let [low, high] = self.days.to_le_bytes();
        frame(cob::TIME, [a, b, c, d, low, high])
    }

    /// `None` for other frames and lengths other than 6 bytes. The four bits that are reserved are ignored.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let &[a, b, c, d, low, high] = payload(frame, cob::TIME)? else {
            return None;
        };
        let millis = u32::from_le_bytes([a, b, c, d]) & Self::MAX_MILLIS;
        Self::new(u16::from_le_bytes([low, high]), millis)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parse;

    #[test]
    fn time_is_four_bytes_of_milliseconds_and_two_of_days() {
        let table = [
            (0, 0, "100#000000000000"),
            (1, 86_399_999, "100#FF5B26050100"),
            (0x3D1F, 0x0123_4567, "100#674523011F3D"),
            (u16::MAX, TimeOfDay::MAX_MILLIS, "100#FFFFFF0FFFFF"),
        ];
        for (days, millis, bytes) in table {
            let time = TimeOfDay::new(days, millis).unwrap();
            assert_eq!(time.encode().to_string(), bytes);
            assert_eq!(TimeOfDay::decode(&parse(bytes)), Some(time));
            assert_eq!((time.days(), time.millis()), (days, millis));
        }
        assert_eq!(TimeOfDay::new(0, TimeOfDay::MAX_MILLIS + 1), None);
    }

    #[test]
    fn reserved_bits_are_ignored_and_other_frames_refused() {
        let time = TimeOfDay::new(1, 2);
        assert_eq!(TimeOfDay::decode(&parse("100#020000F00100")), time);
        for text in ["100#0200000001", "100#02000000010000", "080#020000000100"] {
            assert_eq!(TimeOfDay::decode(&parse(text)), None, "{text}");
        }
    }

    #[test]
    fn time_counts_from_the_first_day_of_1984() {
        // 2026-11-21 10:49:56.250 UTC.
        let unix = Duration::from_millis(1_795_258_196_250);
        let time = TimeOfDay::from_duration(unix - EPOCH).unwrap();
        assert_eq!((time.days(), time.millis()), (15_665, 38_996_250));
        assert_eq!(time.to_duration(), unix - EPOCH);
        let last = Duration::from_secs(65_536 * 86_400) - Duration::from_millis(1);
        assert_eq!(
            TimeOfDay::from_duration(last),
            TimeOfDay::new(65_535, 86_399_999)
        );
        assert_eq!(
            TimeOfDay::from_duration(last + Duration::from_millis(1)),
            None
        );
        let fraction = Duration::from_micros(1_999);
        assert_eq!(TimeOfDay::from_duration(fraction), TimeOfDay::new(0, 1));
    }
}
