//! EMCY (CiA 301): what a node says the moment an error appears, and once more when it has gone.

use can::{Frame, Instant};

use crate::{NodeId, cob, frame};

/// An EMCY frame, `080 + node#code register vendor`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Emergency {
    /// Who speaks.
    pub node: NodeId,
    /// Error code; 0x0000 says that an error has gone. Texts: [`crate::cia402::FaultTable`].
    pub code: u16,
    /// Object 0x1001.
    pub error_register: ErrorRegister,
    /// Five bytes of the vendor's own.
    pub vendor: [u8; 5],
}

impl Emergency {
    /// The frame.
    pub fn encode(self) -> Frame {
        let [low, high] = self.code.to_le_bytes();
        let [a, b, c, d, e] = self.vendor;
        frame(
            cob::emcy(self.node),
            [low, high, self.error_register.0, a, b, c, d, e],
        )
    }

    /// `None` for other frames and lengths other than 8.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let cob::Function::Emcy(node) = cob::Function::of(frame.standard_data_id()?)? else {
            return None;
        };
        let &[low, high, register, a, b, c, d, e] = frame.data() else {
            return None;
        };
        Some(Self {
            node,
            code: u16::from_le_bytes([low, high]),
            error_register: ErrorRegister(register),
            vendor: [a, b, c, d, e],
        })
    }

    /// Whether it announces the end of an error instead of one.
    pub fn is_reset(&self) -> bool {
        self.code & 0xFF00 == 0
    }
}

/// Object 0x1001: which kinds of error are present.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErrorRegister(pub u8);

impl ErrorRegister {
    /// Any error at all.
    pub const GENERIC: Self = Self(1 << 0);
    /// Current.
    pub const CURRENT: Self = Self(1 << 1);
    /// Voltage.
    pub const VOLTAGE: Self = Self(1 << 2);
    /// Temperature.
    pub const TEMPERATURE: Self = Self(1 << 3);
    /// Communication.
    pub const COMMUNICATION: Self = Self(1 << 4);
    /// Specific to the device profile.
    pub const DEVICE_PROFILE: Self = Self(1 << 5);
    /// Specific to the vendor.
    pub const VENDOR: Self = Self(1 << 7);

    /// Whether all bits of `other` are set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Both together.
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// How many emergencies a [`Consumer`] keeps.
pub const HISTORY: usize = 8;

/// Listens to the emergencies of one node and keeps the last [`HISTORY`] of them.
#[derive(Clone, Debug)]
pub struct Consumer {
    node: NodeId,
    /// A ring; the emergency that arrived as number n, from 0, lies at n modulo its length.
    history: [Option<(Emergency, Instant)>; HISTORY],
    received: u64,
    polled: u64,
}

impl Consumer {
    /// Listens to `node`.
    pub const fn new(node: NodeId) -> Self {
        Self {
            node,
            history: [None; HISTORY],
            received: 0,
            polled: 0,
        }
    }

    /// Takes a frame from the bus.
    pub fn handle(&mut self, frame: &Frame, now: Instant) {
        if let Some(emergency) = Emergency::decode(frame)
            && emergency.node == self.node
        {
            self.history[slot(self.received)] = Some((emergency, now));
            self.received += 1;
        }
    }

    /// The next emergency not polled yet, oldest first. More than [`HISTORY`] between two polls
    /// overwrite the oldest; [`Consumer::received`] counts them all.
    pub fn poll(&mut self) -> Option<Emergency> {
        self.polled = self
            .polled
            .max(self.received.saturating_sub(HISTORY as u64));
        if self.polled == self.received {
            return None;
        }
        let (emergency, _) = self.history[slot(self.polled)]?;
        self.polled += 1;
        Some(emergency)
    }

    /// Emergencies received since it was made.
    pub fn received(&self) -> u64 {
        self.received
    }

    /// What it keeps with the time of arrival, newest first.
    pub fn history(&self) -> impl Iterator<Item = (Emergency, Instant)> + '_ {
        (1..=HISTORY as u64).map_while(|age| self.history[slot(self.received.checked_sub(age)?)])
    }

    /// The last emergency, unless it said that the error has gone.
    pub fn last_error(&self) -> Option<Emergency> {
        let (emergency, _) = self.history().next()?;
        (!emergency.is_reset()).then_some(emergency)
    }
}

fn slot(number: u64) -> usize {
    (number % HISTORY as u64) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parse;

    #[test]
    fn an_emergency_is_code_register_and_five_vendor_bytes() {
        let emergency = Emergency {
            node: NodeId::new(3).unwrap(),
            code: 0x8611,
            error_register: ErrorRegister::GENERIC.with(ErrorRegister::DEVICE_PROFILE),
            vendor: [1, 2, 3, 4, 5],
        };
        assert_eq!(emergency.encode().to_string(), "083#1186210102030405");
        assert_eq!(Emergency::decode(&emergency.encode()), Some(emergency));
        assert!(
            emergency
                .error_register
                .contains(ErrorRegister::DEVICE_PROFILE)
        );
        assert!(!emergency.error_register.contains(ErrorRegister::VOLTAGE));
        assert!(!emergency.is_reset());
    }

    #[test]
    fn sync_and_short_frames_are_no_emergencies() {
        assert_eq!(
            Emergency::decode(&Frame::new(cob::SYNC, &[0; 8]).unwrap()),
            None
        );
        let id = cob::emcy(NodeId::new(3).unwrap());
        for length in 0..8 {
            assert_eq!(
                Emergency::decode(&Frame::new(id, &[0; 8][..length]).unwrap()),
                None
            );
        }
    }

    #[test]
    fn emergencies_are_polled_oldest_first_and_kept_newest_first() {
        let mut consumer = Consumer::new(NodeId::new(3).unwrap());
        let frames = [
            "083#1186210102030405",
            "084#1186210000000000",
            "083#0000000000000000",
        ];
        for (nanos, frame) in frames.into_iter().enumerate() {
            consumer.handle(&parse(frame), Instant::from_nanos(nanos as u64));
            if nanos == 0 {
                assert_eq!(
                    consumer.last_error().map(|emergency| emergency.code),
                    Some(0x8611)
                );
            }
        }
        assert_eq!(consumer.last_error(), None);
        assert_eq!(consumer.poll().unwrap().code, 0x8611);
        assert_eq!(consumer.poll().unwrap().code, 0x0000);
        assert_eq!(consumer.poll(), None);
        let kept: Vec<_> = consumer
            .history()
            .map(|(emergency, at)| (emergency.code, at.as_nanos()))
            .collect();
        assert_eq!(kept, [(0x0000, 2), (0x8611, 0)]);
    }

    #[test]
    fn the_history_is_bounded_and_the_count_is_not() {
        let node = NodeId::new(3).unwrap();
        let mut consumer = Consumer::new(node);
        for code in 0x1000..0x1014 {
            let emergency = Emergency {
                node,
                code,
                error_register: ErrorRegister(1),
                vendor: [0; 5],
            };
            consumer.handle(&emergency.encode(), Instant::ZERO);
        }
        assert_eq!(consumer.received(), 20);
        let polled: Vec<_> = std::iter::from_fn(|| consumer.poll())
            .map(|it| it.code)
            .collect();
        assert_eq!(polled, (0x100C..0x1014).collect::<Vec<_>>());
        assert_eq!(consumer.history().count(), HISTORY);
    }
}
