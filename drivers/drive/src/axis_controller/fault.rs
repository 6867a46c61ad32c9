//! Faults and errors of axis controllers.

use std::time::Duration;

use serial::LineError;
use thiserror::Error;

use super::config::Protocol;
use crate::{Fault, Refusal};

/// A latched condition of an axis controller on a serial line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum AxisControllerFault {
    /// Answers were missing, damaged or implausible for more cycles than the cell allows. A panic.
    #[error(
        "no answer to be believed for {cycles} cycles: check cable, power and a USB adapter's latency timer"
    )]
    Silent {
        /// Cycles without one.
        cycles: u32,
    },
    /// More than a quarter of the answers were missing, in gaps of which each was ridden through.
    #[error(
        "{missing} of {cycles} answers missing or late: set a USB adapter's latency timer to 1 ms, check the cable"
    )]
    Late {
        /// Answers that did not come in their cycle, or were not to be believed.
        missing: u32,
        /// Of how many, of 200 at most.
        cycles: u32,
    },
    /// The line took no set-point for more cycles than the cell allows: the drive goes on by an old one. A panic.
    #[error("set-point not taken by the line for {cycles} cycles")]
    NotSent {
        /// Cycles in a row.
        cycles: u32,
    },
    /// The line cannot be read or written. A panic, for whoever still hears it.
    #[error("{0}: open it anew")]
    Line(LineError),
    /// The counter is, and stays, where the motor cannot have moved it. A panic.
    #[error(
        "counter went from {from} to {to}, farther than the motor can move: home the axis again"
    )]
    Jumped {
        /// Where it was, increments.
        from: i32,
        /// Where it is.
        to: i32,
    },
    /// Its answers stayed the same in every bit while its set-points changed. A panic.
    #[error("the same answer for {cycles} cycles after the set-points changed")]
    Frozen {
        /// Cycles.
        cycles: u32,
    },
    /// It lost its reference without being told to: it was switched off and on.
    #[error("restarted: home the axis again")]
    Restarted,
    /// It still has the reference that it was told to forget before it seeks a new one.
    #[error(
        "kept its reference though told to forget it for {cycles} cycles: switch it off and on"
    )]
    KeepsReference {
        /// Cycles.
        cycles: u32,
    },
    /// It reports that its power stage is off or has failed.
    #[error(
        "power stage is off or has failed: check the emergency stop and the power of the cabinet"
    )]
    PowerStage,
    /// It reports that its protection against too much current acted.
    #[error("overcurrent protection acted")]
    Overcurrent,
    /// It reports its error state.
    #[error("drive is in its error state")]
    Error,
    /// Another axis panicked: this drive is told to be in error with it, to open the circuit of their cabinet.
    #[error("stopped with line {line}, whose drive may go on: see what that one reports")]
    Cabinet {
        /// The first line whose axis panicked.
        line: u8,
    },
    /// A set-point that was not sent, nor any other of its cycle.
    #[error("set-point {0}")]
    Refused(Refusal),
}

impl AxisControllerFault {
    /// Whether every drive of the group is told to open its power stage and the emergency-stop circuit of their
    /// cabinet, since nobody knows what this one does.
    pub fn is_emergency_stop(self) -> bool {
        match self {
            Self::Silent { .. }
            | Self::NotSent { .. }
            | Self::Line(_)
            | Self::Jumped { .. }
            | Self::Frozen { .. } => true,
            Self::Restarted
            | Self::Late { .. }
            | Self::KeepsReference { .. }
            | Self::PowerStage
            | Self::Overcurrent
            | Self::Error
            | Self::Cabinet { .. }
            | Self::Refused(_) => false,
        }
    }
}

/// Faults of an axis since its last reset.
///
/// The first fault is the one reported, as later ones are mostly its consequences. An emergency stop is latched also
/// when another fault came first. It never occurs without a fault.
#[derive(Clone, Copy, Debug)]
pub(super) struct FaultLatch {
    line: u8,
    first: Option<AxisControllerFault>,
    emergency_stop: Option<Origin>,
}

/// Which axis required an emergency stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Origin {
    ThisAxis,
    OtherAxis,
}

impl FaultLatch {
    pub(super) fn new(line: u8) -> Self {
        Self {
            line,
            first: None,
            emergency_stop: None,
        }
    }

    pub(super) fn latch(&mut self, fault: AxisControllerFault) {
        if fault.is_emergency_stop() {
            self.emergency_stop = Some(Origin::ThisAxis);
        }
        self.first.get_or_insert(fault);
    }

    /// Latches the emergency stop that the axis of `line` requires.
    pub(super) fn stop_with(&mut self, line: u8) {
        if self.emergency_stop.is_none() {
            self.emergency_stop = Some(Origin::OtherAxis);
            self.latch(AxisControllerFault::Cabinet { line });
        }
    }

    pub(super) fn reset(&mut self) {
        *self = Self::new(self.line);
    }

    pub(super) fn first(&self) -> Option<Fault> {
        let line = self.line;
        self.first
            .map(|fault| Fault::AxisController { line, fault })
    }

    pub(super) fn is_latched(&self) -> bool {
        self.first.is_some()
    }

    /// Whether this axis or another one of the cabinet required an emergency stop.
    pub(super) fn is_emergency_stop(&self) -> bool {
        self.emergency_stop.is_some()
    }

    /// Whether this axis itself required an emergency stop.
    pub(super) fn requires_emergency_stop(&self) -> bool {
        self.emergency_stop == Some(Origin::ThisAxis)
    }
}

/// Why an axis controller could not be brought up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum AxisControllerError {
    /// It said nothing at all.
    #[error(
        "no answer, waited {waited:.1?}: check that the cabinet is on, the cable, the baud rate, and the address"
    )]
    Silent {
        /// Time waited.
        waited: Duration,
    },
    /// Something came, and no answer was in it.
    #[error(
        "{bytes} bytes and no answer among them: check the baud rate, a USB adapter's latency timer, and what is on the line"
    )]
    Garbled {
        /// How many bytes.
        bytes: u32,
    },
    /// It answers in the other protocol.
    #[error("speaks {found:?}, the cell says {expected:?}")]
    OtherProtocol {
        /// What the cell says.
        expected: Protocol,
        /// What it speaks.
        found: Protocol,
    },
    /// It answers for another axis.
    #[error("answers as address {found}, the cell says {expected}: check which line goes where")]
    OtherAddress {
        /// What the cell says.
        expected: u8,
        /// Who answers.
        found: u8,
    },
    /// It answers, and its counter is each time somewhere else.
    #[error("its counter is at {from} and then at {to}, farther than the motor can move")]
    Unsteady {
        /// Increments.
        from: i32,
        /// Increments.
        to: i32,
    },
    /// It answers, and too late for a cycle.
    #[error(
        "{late} of {answers} answers took more than a period: set the adapter's latency timer to 1 ms, or take a card"
    )]
    Late {
        /// How many answers.
        late: usize,
        /// Of how many.
        answers: usize,
    },
    /// It answers, and has no power.
    #[error("power stage is off: switch the cabinet on and release its emergency stop")]
    PowerStage,
    /// The line cannot be read or written.
    #[error("{0}")]
    Line(LineError),
}
