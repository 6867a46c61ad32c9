//! SYNC (CiA 301): the frame at which synchronous nodes latch their set-points and sample.

use can::Frame;

use crate::{cob, frame, payload};

/// A SYNC frame: empty, or one counter byte where object 0x1019 asks for it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sync {
    /// 1 ..= the value of object 0x1019; `None` where that object is 0 or absent.
    pub counter: Option<u8>,
}

impl Sync {
    /// The frame.
    pub fn encode(self) -> Frame {
        match self.counter {
            None => frame(cob::SYNC, []),
            Some(counter) => frame(cob::SYNC, [counter]),
        }
    }

    /// `None` for other frames and for more than one byte.
    pub fn decode(frame: &Frame) -> Option<Self> {
        match payload(frame, cob::SYNC)? {
            [] => Some(Self { counter: None }),
            &[counter] => Some(Self {
                counter: Some(counter),
            }),
            _ => None,
        }
    }
}

/// Makes the SYNC frames of one bus. The clock is the caller's: one SYNC per servo period.
#[derive(Clone, Debug, Default)]
pub struct Producer {
    /// Object 0x1019; 0 for no counter.
    overflow: u8,
    counter: u8,
}

impl Producer {
    /// SYNC without counter.
    pub const fn new() -> Self {
        Self {
            overflow: 0,
            counter: 0,
        }
    }

    /// SYNC that counts 1 ..= `overflow` and begins anew (object 0x1019); `None` outside 2 ..= 240.
    pub const fn with_counter(overflow: u8) -> Option<Self> {
        match overflow {
            2..=240 => Some(Self {
                overflow,
                counter: 0,
            }),
            _ => None,
        }
    }

    /// The next SYNC.
    pub const fn produce(&mut self) -> Sync {
        if self.overflow == 0 {
            return Sync { counter: None };
        }
        self.counter = self.counter % self.overflow + 1;
        Sync {
            counter: Some(self.counter),
        }
    }

    /// Begins to count from 1, as after a pause of SYNC.
    pub const fn restart(&mut self) {
        self.counter = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sync_is_empty_or_one_counter_byte() {
        for (sync, bytes) in [
            (Sync { counter: None }, "080#"),
            (Sync { counter: Some(240) }, "080#F0"),
        ] {
            assert_eq!(sync.encode().to_string(), bytes);
            assert_eq!(Sync::decode(&sync.encode()), Some(sync));
        }
        assert_eq!(Sync::decode(&Frame::new(cob::SYNC, &[1, 2]).unwrap()), None);
        assert_eq!(Sync::decode(&Frame::new(cob::TIME, &[]).unwrap()), None);
    }

    #[test]
    fn the_counter_runs_from_1_to_the_overflow_value() {
        let mut producer = Producer::with_counter(3).unwrap();
        let sent: Vec<_> = (0..7)
            .map(|_| producer.produce().encode().to_string())
            .collect();
        assert_eq!(
            sent,
            [
                "080#01", "080#02", "080#03", "080#01", "080#02", "080#03", "080#01"
            ]
        );
        producer.restart();
        assert_eq!(producer.produce(), Sync { counter: Some(1) });
        assert_eq!(Producer::new().produce(), Sync { counter: None });
        for overflow in [0, 1, 241, 255] {
            assert!(Producer::with_counter(overflow).is_none(), "{overflow}");
        }
    }
}
