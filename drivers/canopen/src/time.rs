//! TIME (CiA 301 §7.2.6): the frame with the day and the time of day.

use can::Frame;

use crate::{cob, frame, payload};

/// Days since 1984-01-01 and milliseconds after midnight (TIME_OF_DAY, CiA 301 §7.1.6.5).
///
/// The standard leaves the time zone and leap seconds to the users.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TimeOfDay {
    /// Days since 1984-01-01.
    pub days: u16,
    /// Milliseconds after midnight, of which the frame carries 28 bits: higher bits are not sent. A day has 86_400_000.
    pub millis: u32,
}

const MILLIS: u32 = 0x0FFF_FFFF;

impl TimeOfDay {
    /// The frame.
    pub fn encode(self) -> Frame {
        let [a, b, c, d] = (self.millis & MILLIS).to_le_bytes();
        let [low, high] = self.days.to_le_bytes();
        frame(cob::TIME, [a, b, c, d, low, high])
    }

    /// `None` for other frames and lengths other than 6 bytes. The four bits that are reserved are ignored.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let &[a, b, c, d, low, high] = payload(frame, cob::TIME)? else {
            return None;
        };
        Some(Self { days: u16::from_le_bytes([low, high]), millis: u32::from_le_bytes([a, b, c, d]) & MILLIS })
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
            (u16::MAX, MILLIS, "100#FFFFFF0FFFFF"),
        ];
        for (days, millis, bytes) in table {
            let time = TimeOfDay { days, millis };
            assert_eq!(time.encode().to_string(), bytes);
            assert_eq!(TimeOfDay::decode(&parse(bytes)), Some(time));
        }
    }

    #[test]
    fn reserved_bits_are_ignored_and_other_frames_refused() {
        let time = Some(TimeOfDay { days: 1, millis: 2 });
        assert_eq!(TimeOfDay::decode(&parse("100#020000F00100")), time);
        for text in ["100#0200000001", "100#02000000010000", "080#020000000100"] {
            assert_eq!(TimeOfDay::decode(&parse(text)), None, "{text}");
        }
    }
}
