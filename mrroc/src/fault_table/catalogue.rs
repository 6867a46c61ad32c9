//! The faults of the table: what each is, where and in which phases it has a meaning, and what is expected.

use std::time::Duration;

use super::detector::Detector;
use super::phase::FaultPhase;
use crate::cell::CellFile;
use crate::scenario::{FaultKind, FaultNumbers};

/// Wire of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wire {
    Can,
    Serial,
}

/// Expected end of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Expected {
    /// The motion goes on to its end.
    Tolerated,
    /// One of these detectors stops the robot.
    By(&'static [Detector]),
    /// The motion goes on, or one of these detectors stops the robot: the seed decides.
    Either(&'static [Detector]),
}

/// Declared time from a fault to its detection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Within {
    /// The missing answers that the cell tolerates, and four periods.
    Answers,
    /// Four periods of the heartbeat.
    Heartbeat,
    /// This time.
    Time(Duration),
}

/// A fault of the table.
#[derive(Clone, Copy, Debug)]
pub(super) struct FaultCase {
    /// Name in the table.
    pub(super) name: &'static str,
    pub(super) kind: FaultKind,
    /// Wires on which the fault is played.
    pub(super) wires: &'static [Wire],
    /// Greatest number of damaged frames.
    pub(super) count: Option<u32>,
    pub(super) probability: f64,
    /// Duration; `None` until the robot is brought back.
    pub(super) lasts: Option<Duration>,
    /// Changes the numbers of the fault.
    pub(super) adapt: fn(&mut FaultNumbers),
    /// Expected end of a row on a wire in a phase, or the reason why the phase has no meaning.
    pub(super) expected: fn(Wire, FaultPhase) -> Result<Expected, &'static str>,
    pub(super) within: Within,
}

const fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

use Detector as D;
use Expected::{By, Either, Tolerated};
use FaultPhase as P;
use Wire::{Can, Serial};

const BOTH: &[Wire] = &[Can, Serial];
const CAN: &[Wire] = &[Can];
const SERIAL: &[Wire] = &[Serial];

const USUAL: FaultCase = FaultCase {
    name: "",
    kind: FaultKind::Lost,
    wires: BOTH,
    count: None,
    probability: 1.0,
    lasts: None,
    adapt: |_| {},
    expected: |_, _| Ok(Tolerated),
    within: Within::Answers,
};

/// Whether the set-points change in this phase.
fn moves(phase: FaultPhase) -> bool {
    !matches!(phase, P::Idle)
}

/// The faults, in the order of the table.
pub(super) const CASES: &[FaultCase] = &[
    FaultCase { name: "one answer lost", count: Some(1), wires: CAN, ..USUAL },
];

impl FaultCase {
    /// The numbers of the fault.
    pub(super) fn numbers(&self, usual: FaultNumbers) -> FaultNumbers {
        let mut numbers = FaultNumbers { count: self.count, probability: self.probability, ..usual };
        (self.adapt)(&mut numbers);
        numbers
    }

    /// Declared time from the fault to its detection on robot 0 of a cell.
    pub(super) fn bound(&self, file: &CellFile, axis: usize) -> Duration {
        let cell = &file.cell;
        let name = &cell.robot[0].axis[axis].bus;
        let bus = cell.bus.iter().find(|bus| bus.name == *name);
        let bundle = cell.serial.iter().find(|serial| serial.name == *name);
        let tolerated = bus.map(|bus| bus.tolerated_missing).or(bundle.map(|it| it.tolerated_missing)).unwrap_or(0);
        match self.within {
            Within::Answers => cell.period() * (tolerated + 4),
            Within::Heartbeat => ms(4 * bus.map_or(100, |bus| u64::from(bus.heartbeat_ms))),
            Within::Time(time) => time,
        }
    }
}
