//! TIME (CiA 301 §7.2.6): the frame with the day and the time of day.

use can::Frame;

use crate::{cob, frame, payload};

/// Days since 1984-01-01 and milliseconds after midnight (TIME_OF_DAY, CiA 301 §7.1.6.5).
///
/// The standard leaves the time zone and leap seconds to the users.
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

    /// The frame.
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
}
