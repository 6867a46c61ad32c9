//! The questions of a fastscan (CiA 305 §6.7), and the conclusions from their answers.

use canopen::lss::{FASTSCAN_RESET, Fastscan, Identity, Part};

/// Guesses the identity of a slave without a node-ID bit by bit, from the highest of the vendor-ID down.
///
/// ```text
///   reset ──yes──► nonsense 1 ──yes──► nonsense 2 ──yes──► untrue
///     └─no─► nobody    └────────no──────────┴─no─► bit 31 ─► … ─► bit 0 ─► confirm ──yes──► next part, after the
///                                                                             └─no─► vanished    last: found
/// ```
///
/// The scan asks for the bit 0. Without an answer, the bit is 1 in every slave that is still in the scan. Of several slaves
/// the scan finds the one with the smallest identity.
///
/// Both nonsense questions ask for a serial number out of turn, and the two numbers differ. A slave that answers both
/// answers any question, and its answers mean nothing. CANopenNode's slave does so in configuration mode
/// (`CO_LSSslave.c`), into which the end of a fastscan puts it.
///
/// A scan for the smallest identity above a given one looks for the longest prefix that both share. It asks, from the
/// lowest bit of the given identity upwards, whether a slave has a 1 where the given identity has a 0. The rest is
/// guessed bit by bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Scan {
    found: Identity,
    part: Part,
    step: Step,
    above: Option<Above>,
}

/// The identity above which the scan searches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Above {
    identity: Identity,
    /// The part that is to be greater; those before are the same.
    part: Part,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    /// `first` is that of the scan.
    Reset {
        first: bool,
    },
    /// A serial number out of turn.
    Nonsense(u32),
    /// The part is that of the identity above which is searched.
    Same,
    /// The part is greater in this bit, and the same above it.
    Greater(u8),
    Bit(u8),
    Confirm,
}

/// What follows from an answer. `Untrue`: a slave answers any question.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Next {
    Ask(Fastscan),
    Found(Option<Identity>),
    Vanished { part: Part, number: u32 },
    Untrue,
}

impl Scan {
    pub(super) fn new() -> Self {
        Self { found: Identity::default(), part: Part::Vendor, step: Step::Reset { first: true }, above: None }
    }

    /// A scan for the smallest identity above `identity`.
    pub(super) fn above(identity: Identity) -> Self {
        let part = Part::Serial;
        Self { above: Some(Above { identity, part }), ..Self::new() }
    }

    /// The question that is to be asked.
    pub(super) fn question(&self) -> Fastscan {
        let sub = self.part.index();
        let ask = |number, bit, next| Fastscan { number, bit, sub, next };
        let found = self.found.get(self.part);
        let confirmed = self.part.next().map_or(0, Part::index);
        match self.step {
            Step::Reset { .. } => ask(found, FASTSCAN_RESET, sub),
            Step::Nonsense(number) => {
                Fastscan { number, bit: 0, sub: Part::Serial.index(), next: Part::Serial.index() }
            }
            Step::Greater(bit) => ask(greater(found, bit), bit, sub),
            Step::Bit(bit) => ask(found, bit, sub),
            Step::Same | Step::Confirm => ask(found, 0, confirmed),
        }
    }

    /// Whether a late answer would mislead the scan if the question counted as not answered: a slave would be hidden, or
    /// the answer would confirm a wrong number.
    pub(super) fn is_misled_by_late_answers(&self) -> bool {
        match self.step {
            Step::Reset { .. } | Step::Same | Step::Bit(0) => true,
            Step::Nonsense(_) | Step::Greater(_) | Step::Bit(_) | Step::Confirm => false,
        }
    }

    /// Takes the answer to the question: whether any slave agreed.
    pub(super) fn answered(&mut self, agreed: bool) -> Next {
        match (self.step, agreed) {
            (Step::Reset { .. }, false) => return Next::Found(None),
            (Step::Reset { first: true }, true) => self.step = Step::Nonsense(0),
            (Step::Nonsense(0), true) => self.step = Step::Nonsense(u32::MAX),
            (Step::Nonsense(_), true) => return Next::Untrue,
            (Step::Reset { first: false }, true) | (Step::Nonsense(_), false) => {
                return self.begin();
            }
            (Step::Same, true) => {
                self.part = self.part.next().unwrap_or(Part::Serial);
                return self.go_up();
            }
            (Step::Same, false) => return self.shorten(),
            (Step::Greater(bit), true) => {
                let number = self.found.get_mut(self.part);
                *number = greater(*number, bit);
                self.step = bit.checked_sub(1).map_or(Step::Confirm, Step::Bit);
            }
            (Step::Greater(bit), false) => return self.raise(bit + 1),
            (Step::Bit(bit), agreed) => {
                if !agreed {
                    *self.found.get_mut(self.part) |= 1 << bit;
                }
                self.step = bit.checked_sub(1).map_or(Step::Confirm, Step::Bit);
            }
            (Step::Confirm, false) => {
                return Next::Vanished { part: self.part, number: self.found.get(self.part) };
            }
            (Step::Confirm, true) => match self.part.next() {
                None => return Next::Found(Some(self.found)),
                Some(next) => {
                    self.part = next;
                    self.step = Step::Bit(31);
                }
            },
        }
        Next::Ask(self.question())
    }

    /// Every slave waits for questions about the vendor-ID.
    fn begin(&mut self) -> Next {
        match self.above {
            None => self.ask(Step::Bit(31)),
            Some(_) => self.go_up(),
        }
    }

    /// Goes on to the part that is to be greater.
    fn go_up(&mut self) -> Next {
        let Some(Above { identity, part }) = self.above else {
            return Next::Found(None);
        };
        *self.found.get_mut(self.part) = identity.get(self.part);
        if self.part == part {
            return self.raise(0);
        }
        self.ask(Step::Same)
    }

    /// Asks for a greater part: from `bit` upwards, the lowest bit that is 0.
    fn raise(&mut self, bit: u8) -> Next {
        let number = self.found.get(self.part);
        match (bit..32).find(|bit| number >> bit & 1 == 0) {
            Some(bit) => self.ask(Step::Greater(bit)),
            None => self.shorten(),
        }
    }

    /// No slave has a greater part: the part before is to be greater.
    fn shorten(&mut self) -> Next {
        let Some(above) = &mut self.above else {
            return Next::Found(None);
        };
        let Some(index) = above.part.index().checked_sub(1) else {
            return Next::Found(None);
        };
        above.part = Part::ALL[usize::from(index)];
        self.part = Part::Vendor;
        self.found = Identity::default();
        self.ask(Step::Reset { first: false })
    }

    fn ask(&mut self, step: Step) -> Next {
        self.step = step;
        Next::Ask(self.question())
    }
}

/// `number` with `bit` set and those below cleared.
const fn greater(number: u32, bit: u8) -> u32 {
    (number >> bit | 1) << bit
}
