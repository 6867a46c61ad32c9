//! Random faults of a soak: which fault of the table strikes which axis, when and for how long.

use std::time::Duration;

use mrroc::cell::CellFile;
use mrroc::scenario::{FaultKind, FaultNumbers};

use crate::catalogue::{CASES, FaultCase};
use crate::origin::Origin;

/// Greatest delay of a fault after the beginning of its minute.
const DELAY: f64 = 10.0;
/// Shortest and longest duration of a fault without a duration of its own, s.
const DURATIONS: (f64, f64) = (0.2, 3.0);

/// SplitMix64: a small seeded generator with the same results on all platforms.
#[derive(Clone, Debug)]
pub(super) struct Random(pub(super) u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number from 0, below 1.
    fn share(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn below(&mut self, end: usize) -> usize {
        // A modulus prefers no number by more than one part in 2^50.
        (self.next() % end.max(1) as u64) as usize
    }
}

/// A fault of a soak.
#[derive(Clone, Debug)]
pub(super) struct PlannedFault {
    /// Number of the case in the table.
    pub(super) case: usize,
    /// Robot and axis.
    pub(super) axis: (usize, usize),
    /// Delay after the beginning of the minute.
    pub(super) delay: Duration,
    /// Duration; `None` for a fault that only new ends of the host repair.
    pub(super) lasts: Option<Duration>,
    seed: u64,
}

impl PlannedFault {
    /// A fault of the table on an axis of the cell, with equal probability of each robot and of each of its faults.
    pub(super) fn random(file: &CellFile, random: &mut Random) -> Self {
        let robots = &file.cell.robot;
        let robot = random.below(robots.len());
        let axis = random.below(robots[robot].axis.len());
        let wire = crate::wire(&file.cell, (robot, axis));
        let is_played = |case: &FaultCase| case.wires.contains(&wire) && emulated(case).is_some();
        let cases: Vec<_> = (0..CASES.len()).filter(|case| is_played(&CASES[*case])).collect();
        let case = cases[random.below(cases.len())];
        let delay = Duration::from_secs_f64(DELAY * random.share());
        let (least, most) = DURATIONS;
        let lasts = Duration::from_secs_f64(least + (most - least) * random.share());
        let seed = random.next();
        let lasts = match CASES[case] {
            FaultCase { origin: Origin::Emulated(FaultKind::HangUp), .. } => None,
            FaultCase { lasts: Some(own), .. } => Some(own),
            _ => Some(lasts),
        };
        Self { case, axis: (robot, axis), delay, lasts, seed }
    }

    /// Kind of the fault.
    pub(super) fn kind(&self) -> FaultKind {
        emulated(self.case()).expect("only these cases are planned")
    }

    pub(super) fn case(&self) -> &'static FaultCase {
        &CASES[self.case]
    }

    pub(super) fn numbers(&self) -> FaultNumbers {
        FaultNumbers { seed: self.seed, ..self.case().numbers() }
    }
}

/// Kind of a fault of the emulators. `None` for the other faults of the table, for a removed interface and for held frames:
/// without them, the plans of the published runs stay as they are.
fn emulated(case: &FaultCase) -> Option<FaultKind> {
    match case.origin {
        _ if !case.in_soak => None,
        Origin::Emulated(FaultKind::InterfaceRemoved | FaultKind::HostHeld) => None,
        Origin::Emulated(kind) => Some(kind),
        Origin::Deadlines(_) | Origin::EmergencyStop | Origin::Generator(_) => None,
    }
}
