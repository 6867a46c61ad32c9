//! LSS fastscan (CiA 305).

use super::{FASTSCAN_RESET, Fastscan, Identity, Part};

/// Guesses the identity of a slave without a node-ID bit by bit, from the highest of the vendor-ID down.
///
/// ```text
///   reset ──yes──► bit 31 ─► … ─► bit 0 ─► confirm ──yes──► next part, after the last: found
///     └─no─► nobody                           └─no─► vanished
/// ```
///
/// Each bit is guessed to be 0. Silence says that it is 1 with every slave still in the scan, so
/// of several slaves the one with the smallest identity is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Scan {
    found: Identity,
    part: Part,
    step: Step,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Reset,
    Bit(u8),
    Confirm,
}

/// What follows from an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Next {
    Ask(Fastscan),
    Found(Option<Identity>),
    Vanished { part: Part, number: u32 },
}

impl Scan {
    pub(super) fn new() -> Self {
        Self {
            found: Identity::default(),
            part: Part::Vendor,
            step: Step::Reset,
        }
    }

    /// The question that is to be asked.
    pub(super) fn question(&self) -> Fastscan {
        let sub = self.part.index();
        let (bit, next) = match self.step {
            Step::Reset => (FASTSCAN_RESET, sub),
            Step::Bit(bit) => (bit, sub),
            Step::Confirm => (0, self.part.next().map_or(0, Part::index)),
        };
        Fastscan {
            number: self.found.get(self.part),
            bit,
            sub,
            next,
        }
    }

    /// Takes the answer to the question: whether any slave agreed.
    pub(super) fn answered(&mut self, agreed: bool) -> Next {
        let number = self.found.get_mut(self.part);
        self.step = match (self.step, agreed) {
            (Step::Reset, false) => return Next::Found(None),
            (Step::Reset, true) => Step::Bit(31),
            (Step::Bit(bit), agreed) => {
                if !agreed {
                    *number |= 1 << bit;
                }
                bit.checked_sub(1).map_or(Step::Confirm, Step::Bit)
            }
            (Step::Confirm, false) => {
                return Next::Vanished {
                    part: self.part,
                    number: *number,
                };
            }
            (Step::Confirm, true) => match self.part.next() {
                None => return Next::Found(Some(self.found)),
                Some(next) => {
                    self.part = next;
                    Step::Bit(31)
                }
            },
        };
        Next::Ask(self.question())
    }
}
