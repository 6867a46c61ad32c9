//! SYNC (CiA 301 §7.2.5): the frame at which synchronous nodes latch their set-points and sample.

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
            &[counter] => Some(Self { counter: Some(counter) }),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sync_is_empty_or_one_counter_byte() {
        for (sync, bytes) in [(Sync { counter: None }, "080#"), (Sync { counter: Some(240) }, "080#F0")] {
            assert_eq!(sync.encode().to_string(), bytes);
            assert_eq!(Sync::decode(&sync.encode()), Some(sync));
        }
        assert_eq!(Sync::decode(&Frame::new(cob::SYNC, &[1, 2]).unwrap()), None);
        assert_eq!(Sync::decode(&Frame::new(cob::TIME, &[]).unwrap()), None);
    }
}
