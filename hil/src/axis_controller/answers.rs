//! Faults of the answers of an emulated axis controller. The telegrams stay whole, with a right checksum.

use serial::nfv2::{START, crc8};

use crate::DeviceFault;
use crate::plant::Noise;

/// Probability that a bit of the contents of a garbled answer is inverted.
const INVERTED: f64 = 0.03;

/// Room for an answer, bytes.
const ANSWER: usize = 64;

/// Bytes of an NFv2 frame before its first item.
const HEADER: usize = 4;

/// Answers on their way to the line.
pub(super) struct Answers {
    fault: Option<DeviceFault>,
    /// The last answer without a fault, or the answer that is held.
    last: Vec<u8>,
    /// Whether the next answer is the second one of two.
    second: bool,
    garbled: Vec<u8>,
    noise: Noise,
}

impl Answers {
    pub(super) fn new() -> Self {
        let room = || Vec::with_capacity(ANSWER);
        Self { fault: None, last: room(), second: false, garbled: room(), noise: Noise::new(1) }
    }

    /// Begins or ends a fault. Returns whether it is a fault of answers.
    pub(super) fn set_fault(&mut self, fault: DeviceFault, on: bool) -> bool {
        let known = matches!(
            fault,
            DeviceFault::AnswersFrozen
                | DeviceFault::AnswersOld
                | DeviceFault::AnswersReversed
                | DeviceFault::AnswersGarbled
        );
        if known {
            self.fault = on.then_some(fault);
            // An answer was sent before, which is the first one of two old ones.
            self.second = fault == DeviceFault::AnswersOld;
            self.noise = Noise::new(1);
        }
        known
    }

    /// Passes an answer of the drive on.
    pub(super) fn pass(&mut self, answer: &[u8], mut send: impl FnMut(&[u8])) {
        let second = self.second;
        self.second = !second;
        match self.fault {
            Some(DeviceFault::AnswersFrozen) => return send(&self.last),
            Some(DeviceFault::AnswersOld) if second => return send(&self.last),
            Some(DeviceFault::AnswersReversed) if second => {
                send(answer);
                return send(&self.last);
            }
            Some(DeviceFault::AnswersReversed) => {}
            Some(DeviceFault::AnswersGarbled) => {
                self.garble(answer);
                return send(&self.garbled);
            }
            _ => send(answer),
        }
        self.last.clear();
        self.last.extend_from_slice(answer);
    }

    /// Inverts bits of flags, current and position. The start byte of the older protocol, the codes and lengths of NFv2
    /// stay right, and the CRC fits the contents.
    fn garble(&mut self, answer: &[u8]) {
        self.garbled.clear();
        self.garbled.extend_from_slice(answer);
        let Some(last) = answer.len().checked_sub(1) else {
            return;
        };
        let is_frame = answer.len() > HEADER && answer[0] == START && usize::from(answer[1]) == last;
        if !is_frame {
            (1..=last).for_each(|index| self.invert(index));
            return;
        }
        let mut item = HEADER;
        while item + 2 <= last {
            let end = (item + 2 + usize::from(answer[item + 1])).min(last);
            (item + 2..end).for_each(|index| self.invert(index));
            item = end;
        }
        self.garbled[last] = crc8(&self.garbled[3..last]);
    }

    fn invert(&mut self, index: usize) {
        for bit in 0..8 {
            let inverted = 0.5 * (self.noise.symmetric() + 1.0) < INVERTED;
            self.garbled[index] ^= u8::from(inverted) << bit;
        }
    }
}

#[cfg(test)]
mod tests {
    use serial::nfv2::Frame;

    use super::*;

    fn passed(fault: DeviceFault, answers: &[&[u8]]) -> Vec<Vec<u8>> {
        let mut out = Vec::new();
        let mut passing = Answers::new();
        passing.pass(b"0", |_| {});
        assert!(passing.set_fault(fault, true));
        answers.iter().for_each(|answer| passing.pass(answer, |bytes| out.push(bytes.to_vec())));
        out
    }

    #[test]
    fn old_answers_come_again_and_reversed_ones_change_places() {
        let answers: [&[u8]; 4] = [b"1", b"2", b"3", b"4"];
        for (fault, expected) in [
            (DeviceFault::AnswersFrozen, ["0", "0", "0", "0"]),
            (DeviceFault::AnswersOld, ["0", "2", "2", "4"]),
            (DeviceFault::AnswersReversed, ["2", "1", "4", "3"]),
        ] {
            assert_eq!(passed(fault, &answers), expected.map(|answer| answer.as_bytes().to_vec()), "{fault:?}");
        }
    }

    #[test]
    fn garbled_answers_are_whole_telegrams_with_other_contents() {
        // Position 1000, current 250 mA and status 0x0010 of the drive with address 8.
        let mut frame = serial::nfv2::FrameBuilder::new(8);
        frame.answer(serial::nfv2::Answer::Position(1000)).answer(serial::nfv2::Answer::Current(250));
        let nfv2 = frame.answer(serial::nfv2::Answer::Status(serial::nfv2::Status(0x10))).finish().unwrap().to_vec();
        let moxa = [0x23, 0x80, 0xFA, 0x00, 0xE8, 0x03, 0x00, 0x00];
        let garbled = passed(DeviceFault::AnswersGarbled, &[&nfv2[..]; 50]);
        assert!(garbled.iter().filter(|bytes| **bytes != nfv2).count() > 30);
        for bytes in garbled {
            let frame = Frame::parse(&bytes).expect("a frame with a right CRC");
            assert_eq!((frame.address, frame.answers().filter(Result::is_ok).count()), (8, 3));
        }
        let garbled = passed(DeviceFault::AnswersGarbled, &[&moxa[..]; 50]);
        assert!(garbled.iter().all(|bytes| bytes.len() == moxa.len() && bytes[0] == moxa[0]));
        assert!(garbled.iter().filter(|bytes| bytes[..] != moxa).count() > 30);
    }
}
