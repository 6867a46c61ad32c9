//! Evidence of what is wrong with refused answers, by which a fault of a line gets its name.
//!
//! Answers of the older protocol carry no number, no address and no checksum, and a checksum of eight bits lets damage
//! through. The contents of the answers tell the difference:
//! - An *old* answer equals one of the last accepted answers in every bit, although the motor has moved by
//!   [`LEAST_STEP`] increments since.
//! - *Reversed* answers come in one reading, and the last one is behind the one before it against the motion.
//! - A *garbled* answer has a current beyond any of this drive, a position that the next answer contradicts, or a status
//!   bit that the drive holds until manual mode and that goes by itself.
//! - An answer of *another drive* has the address of that drive. In the older protocol, the counters of two axes change
//!   places. If these agree, two loops swing against each other until a drive reports a fault: one telegram is left out
//!   before this fault counts, and an answer then is that of the drive whose line has none.
//!
//! The fault that ends the exchange with a drive names what explains more than half of the missing answers. A fault that
//! the drive reports is doubted after two flaws within some cycles: its bits may be garbled, or the loop may have followed
//! wrong positions.
//!
//! # What is not seen
//! - Old and reversed answers of a motor that is slower than [`LEAST_STEP`] increments per period. Such an answer differs
//!   by less from the one in time.
//! - Old answers with a current of zero: a motor without power may stop between two samples.
//! - A drive that answers each request with the sample of the request before it.
//! - Garbled bits of a current and of the low part of a position that the motor can have reached.
//! - Swapped answers of two axes of the older protocol whose counters and speeds agree within the plausibility check, while
//!   no drive reports a fault.

use super::fault::AxisControllerFault;
use super::stream::Answer;

/// Increments by which an old or a reversed answer must differ from the position of the motor.
const LEAST_STEP: f64 = 4.0;

/// Accepted answers that an old answer is compared with.
const REMEMBERED: usize = 8;

/// Cycles for which a flaw raises doubt, and the most that can add up.
const DOUBTED: u32 = 20;
const MOST_DOUBTED: u32 = 5 * DOUBTED;

/// What is wrong with a refused answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Flaw {
    Old,
    /// The last of two answers in one reading. The reading before had none.
    Reversed,
    Garbled,
    OtherDrive(u8),
}

/// Flaws of refused answers.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Flaws {
    old: u32,
    reversed: u32,
    garbled: u32,
    other_drive: u32,
    address: u8,
}

impl Flaws {
    pub(super) fn add(&mut self, flaw: Flaw) {
        let count = match flaw {
            Flaw::Old => &mut self.old,
            Flaw::Reversed => &mut self.reversed,
            Flaw::Garbled => &mut self.garbled,
            Flaw::OtherDrive(address) => {
                self.address = address;
                &mut self.other_drive
            }
        };
        *count = count.saturating_add(1);
    }

    /// The fault by which more than half of `missing` answers are missing.
    pub(super) fn explain(self, missing: u32) -> Option<AxisControllerFault> {
        let (explained, fault) = self.most();
        (explained.saturating_mul(2) > missing).then_some(fault)
    }

    /// The most frequent flaw as a fault, and the number of missing answers that it explains.
    fn most(self) -> (u32, AxisControllerFault) {
        let Self { old, reversed, garbled, other_drive, address } = self;
        let faults = [
            (other_drive, AxisControllerFault::OtherDrive { address }),
            (garbled, AxisControllerFault::Garbled { answers: garbled }),
            (reversed.saturating_mul(2), AxisControllerFault::Reversed { answers: reversed }),
            (old, AxisControllerFault::Old { answers: old }),
        ];
        faults.into_iter().fold(faults[0], |most, next| if next.0 > most.0 { next } else { most })
    }
}

/// Whether what a drive reports is to be believed.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Doubt {
    cycles: u32,
    flaws: Flaws,
}

impl Doubt {
    pub(super) fn add(&mut self, flaw: Flaw) {
        self.cycles = (self.cycles + DOUBTED).min(MOST_DOUBTED);
        self.flaws.add(flaw);
    }

    /// Ends a cycle.
    pub(super) fn age(&mut self) {
        self.cycles = self.cycles.saturating_sub(1);
        if self.cycles == 0 {
            self.flaws = Flaws::default();
        }
    }

    /// The fault that takes the place of what the drive reports, if two flaws were found of late.
    pub(super) fn fault(self) -> Option<AxisControllerFault> {
        (self.cycles > DOUBTED).then(|| self.flaws.most().1)
    }
}

/// The last accepted answers.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct History {
    answers: [Answer; REMEMBERED],
    count: usize,
}

impl History {
    pub(super) fn push(&mut self, answer: Answer) {
        self.answers[self.count % REMEMBERED] = answer;
        self.count = self.count.wrapping_add(1).max(1);
    }

    fn answers(&self) -> &[Answer] {
        &self.answers[..self.count.min(REMEMBERED)]
    }

    /// Whether an answer is one of these again, while the motor should be at `expected` increments and moves by `moved`
    /// increments per period.
    pub(super) fn is_old(&self, answer: Answer, expected: f64, moved: f64) -> bool {
        // The counter may wrap, which no axis of a robot reaches.
        let behind = (f64::from(answer.position.0) - expected).abs();
        let informative = answer.current.is_some_and(|current| current.0 != 0);
        informative && moved.abs() >= LEAST_STEP && behind >= LEAST_STEP && self.answers().contains(&answer)
    }

    /// Whether a position is one of these, within `reach` increments.
    pub(super) fn is_near(&self, position: i32, reach: f64) -> bool {
        let distance = |answer: &Answer| f64::from(position.wrapping_sub(answer.position.0)).abs();
        self.answers().iter().any(|answer| distance(answer) <= reach)
    }
}

/// Whether two answers of one reading are in reversed order, while the motor moves by `moved` increments per period.
pub(super) fn are_reversed(first: Answer, last: Answer, moved: f64) -> bool {
    let forwards = f64::from(last.position.0.wrapping_sub(first.position.0)) * moved.signum();
    moved.abs() >= LEAST_STEP && forwards <= -LEAST_STEP
}
