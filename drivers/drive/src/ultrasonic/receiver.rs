//! Reception of the replies of an ultrasonic matrix, byte by byte.

use serial::ultrasonic::{MAX_REPLY, START, crc};

/// Reception of frames. Bytes between two frames are skipped and counted.
#[derive(Clone, Debug)]
pub(super) struct Receiver {
    /// Length and body so far.
    bytes: [u8; 1 + MAX_REPLY],
    /// Number of bytes since the start of the frame; `None` before the start.
    count: Option<usize>,
    /// Bytes that belonged to no valid frame.
    pub(super) skipped: u32,
}

impl Receiver {
    pub(super) fn new() -> Self {
        Self { bytes: [0; 1 + MAX_REPLY], count: None, skipped: 0 }
    }

    /// Forgets a frame that has not ended. Its bytes count as skipped.
    pub(super) fn restart(&mut self) {
        self.skip(self.count.map_or(0, |count| count + 1));
        self.count = None;
    }

    /// Whether a frame has begun and not ended.
    pub(super) fn is_within(&self) -> bool {
        self.count.is_some()
    }

    fn skip(&mut self, bytes: usize) {
        self.skipped = self.skipped.saturating_add(bytes as u32);
    }

    /// Takes a byte. Returns the body of the valid frame that ends with the byte.
    pub(super) fn receive(&mut self, byte: u8) -> Option<&[u8]> {
        let Some(count) = self.count else {
            if byte == START {
                self.count = Some(0);
            } else {
                self.skip(1);
            }
            return None;
        };
        let length = if count == 0 { usize::from(byte) } else { usize::from(self.bytes[0]) };
        if length == 0 || length > MAX_REPLY {
            self.skip(if byte == START { 1 } else { 2 });
            self.count = (byte == START).then_some(0);
            return None;
        }
        if count <= length {
            self.bytes[count] = byte;
            self.count = Some(count + 1);
            return None;
        }
        self.count = None;
        if crc(&self.bytes[..=length]) == byte {
            return Some(&self.bytes[1..=length]);
        }
        self.skip(length + 3);
        None
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serial::ultrasonic::{FRAME, encode};

    use super::*;

    fn frame(body: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0; body.len() + FRAME];
        encode(body, &mut bytes).unwrap();
        bytes
    }

    fn bodies(receiver: &mut Receiver, bytes: &[u8]) -> Vec<Vec<u8>> {
        bytes.iter().filter_map(|byte| receiver.receive(*byte).map(<[u8]>::to_vec)).collect()
    }

    proptest! {
        #[test]
        fn a_frame_after_other_bytes_is_received(
            before in proptest::collection::vec(any::<u8>().prop_filter("no start", |it| *it != START), 0..20),
            body in proptest::collection::vec(any::<u8>(), 1..MAX_REPLY),
        ) {
            let mut receiver = Receiver::new();
            let bytes = [&before[..], &frame(&body)].concat();
            prop_assert_eq!(bodies(&mut receiver, &bytes), vec![body]);
            prop_assert_eq!(receiver.skipped as usize, before.len());
        }

        #[test]
        fn a_frame_with_a_flipped_bit_is_not_received(
            body in proptest::collection::vec(any::<u8>(), 1..40),
            at in any::<prop::sample::Index>(),
            bit in 0..8_u32,
        ) {
            let mut bytes = frame(&body);
            // The CRC covers everything after the start.
            let index = 1 + at.index(bytes.len() - 1);
            bytes[index] ^= 1_u8 << bit;
            let mut receiver = Receiver::new();
            // A frame of another length within the bytes needs a valid CRC by chance.
            prop_assert!(bodies(&mut receiver, &bytes).iter().all(|found| *found != body));
        }

        #[test]
        fn any_bytes_leave_a_receiver_that_takes_the_next_frame(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let mut receiver = Receiver::new();
            bodies(&mut receiver, &bytes);
            receiver.restart();
            prop_assert_eq!(bodies(&mut receiver, &frame(&[3, 1])), vec![vec![3, 1]]);
        }
    }
}
