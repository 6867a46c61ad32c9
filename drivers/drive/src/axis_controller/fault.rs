//! Faults and errors of axis controllers.

use std::time::Duration;

use can::counted;
use serial::LineError;
use thiserror::Error;

use super::config::Protocol;
use crate::{Fault, Refusal};

/// A latched condition of an axis controller on a serial line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum AxisControllerFault {
    /// Answers were missing, damaged or implausible for more cycles than the cell allows. An emergency stop.
    #[error(
        "no answer to be believed for {}: check cable, power and a USB adapter's latency timer",
        counted(*.cycles, "cycle")
    )]
    Silent { cycles: u32 },
    /// Answers came late, or late and not at all, for more cycles than the cell allows. Each belonged to an older
    /// request. An emergency stop.
    #[error(
        "answers {} late for {}: check the load of the host and a USB adapter's latency timer",
        counted(*.periods, "period"),
        counted(*.cycles, "cycle")
    )]
    Delayed { cycles: u32, periods: u32 },
    /// The last answers had the same objects, although their requests asked for different ones. An emergency stop.
    #[error("the same answer to {answers} different requests: look for what repeats it, switch the drive off and on")]
    Repeated { answers: u32 },
    /// Answers that were accepted before came again, while the motor moved on. An emergency stop.
    #[error(
        "{} again while the motor moves: check the adapter and what else is on the line",
        counted(*.answers, "old answer")
    )]
    Old { answers: u32 },
    /// Answers came in the reversed order of their requests. An emergency stop.
    #[error("answers in reversed order, {}: check the adapter and its driver", counted(*.answers, "pair"))]
    Reversed { answers: u32 },
    /// Answers were whole and had contents that contradict each other. An emergency stop.
    #[error(
        "{} with wrong contents: check cable, shield and ground, and the drive",
        counted(*.answers, "whole answer")
    )]
    Garbled { answers: u32 },
    /// The answers have the address of another drive. An emergency stop.
    #[error("answers come from address {address}: check which line goes where")]
    OtherDrive { address: u8 },
    /// The answers are those of the axis at `line`: the counters have changed places, or an answer came without a request. An
    /// emergency stop.
    #[error("answers are those of line {line}: check which line goes where, and the adapter")]
    Swapped { line: u8 },
    /// More than a quarter of the answers due, 200 at most, were missing or refused, or more than half of them missing or
    /// late, in gaps that are tolerated one by one.
    #[error(
        "{missing} of {cycles} answers missing or late: set a USB adapter's latency timer to 1 ms, check the cable"
    )]
    Late { missing: u32, cycles: u32 },
    /// The line took no set-point for more cycles than the cell allows: the drive follows an old one. An emergency stop.
    #[error("set-point not taken by the line for {}", counted(*.cycles, "cycle"))]
    NotSent { cycles: u32 },
    /// The line cannot be read or written. An emergency stop of the drives that are still connected.
    #[error("{0}: open it anew")]
    Line(LineError),
    /// The counter changed by more than the motor can move, and stays there (increments). An emergency stop.
    #[error("counter went from {from} to {to}, farther than the motor can move: home the axis again")]
    Jumped { from: i32, to: i32 },
    /// The answers stayed the same in every bit while the set-points changed. An emergency stop.
    #[error("the same answer for {} after the set-points changed", counted(*.cycles, "cycle"))]
    Frozen { cycles: u32 },
    /// The drive lost its reference without being told to: it was power-cycled.
    #[error("restarted: home the axis again")]
    Restarted,
    /// The drive keeps a reference that it was told to forget before the search for the index pulse.
    #[error("kept its reference though told to forget it for {}: switch it off and on", counted(*.cycles, "cycle"))]
    KeepsReference { cycles: u32 },
    /// The drive shows a reference in a search, but its counter was not set by the index pulse.
    #[error(
        "shows a reference at count {position}, which the index pulse has not set: switch it off and on, home again"
    )]
    NotIndexed { position: i32 },
    #[error("power stage is off or has failed: check the emergency stop and the power of the cabinet")]
    PowerStage,
    #[error("overcurrent protection acted")]
    Overcurrent,
    #[error("drive is in its error state")]
    Error,
    /// Another axis required an emergency stop: this drive is told to open the circuit of their cabinet too. `line` is the
    /// first one whose axis required the stop.
    #[error("stopped with line {line}, whose drive may go on: see what that one reports")]
    Cabinet { line: u8 },
    /// A refused set-point. The group sent no new set-point in that cycle.
    #[error("set-point {0}")]
    Refused(Refusal),
}

impl AxisControllerFault {
    /// Whether the state of the drive is unknown after this fault, so that every drive of the group is told to open its
    /// power stage and the emergency-stop circuit of the cabinet. MRROC++ calls this a hardware panic.
    #[doc(alias = "is_panic")]
    pub fn is_emergency_stop(self) -> bool {
        match self {
            Self::Silent { .. }
            | Self::NotSent { .. }
            | Self::Line(_)
            | Self::Jumped { .. }
            | Self::Frozen { .. }
            | Self::Delayed { .. }
            | Self::Old { .. }
            | Self::Reversed { .. }
            | Self::Garbled { .. }
            | Self::OtherDrive { .. }
            | Self::Swapped { .. }
            | Self::Repeated { .. } => true,
            Self::Restarted
            | Self::Late { .. }
            | Self::KeepsReference { .. }
            | Self::NotIndexed { .. }
            | Self::PowerStage
            | Self::Overcurrent
            | Self::Error
            | Self::Cabinet { .. }
            | Self::Refused(_) => false,
        }
    }

    /// Whether the drives of the cabinet have opened their power stages: an [emergency stop](Self::is_emergency_stop) by this
    /// axis or by another one.
    pub fn opens_cabinet(self) -> bool {
        self.is_emergency_stop() || matches!(self, Self::Cabinet { .. })
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
        Self { line, first: None, emergency_stop: None }
    }

    pub(super) fn latch(&mut self, fault: AxisControllerFault) {
        if fault.is_emergency_stop() {
            self.emergency_stop = Some(Origin::ThisAxis);
        }
        self.first.get_or_insert(fault);
    }

    /// Latches the emergency stop that the axis of `line` requires: this drive too is to open the circuit of the cabinet.
    pub(super) fn stop_with(&mut self, line: u8) {
        if self.emergency_stop.is_none() {
            self.emergency_stop = Some(Origin::OtherAxis);
            self.latch(AxisControllerFault::Cabinet { line });
        }
    }

    /// Clears the latched faults. The next reading latches again what the drive and the line still show.
    pub(super) fn reset(&mut self) {
        *self = Self::new(self.line);
    }

    pub(super) fn first(&self) -> Option<Fault> {
        let line = self.line;
        self.first.map(|fault| Fault::AxisController { line, fault })
    }

    /// Whether a fault is latched: the drive follows no set-point.
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
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum AxisControllerError {
    #[error("no answer, waited {waited:.1?}: check that the cabinet is on, the cable, the baud rate, and the address")]
    Silent { waited: Duration },
    #[error(
        "{} and no answer among them: check the baud rate, a USB adapter's latency timer, and what is on the line",
        counted(*.bytes, "byte")
    )]
    Garbled { bytes: u32 },
    #[error("speaks {found:?}, the cell says {expected:?}")]
    OtherProtocol { expected: Protocol, found: Protocol },
    #[error("answers as address {found}, the cell says {expected}: check which line goes where")]
    OtherAddress { expected: u8, found: u8 },
    /// The drive answers, and its counter is elsewhere in each answer (increments).
    #[error("its counter is at {from} and then at {to}, farther than the motor can move")]
    Unsteady { from: i32, to: i32 },
    /// The drive answers too late for a cycle.
    #[error(
        "{late} of {answers} answers took more than a period: set the adapter's latency timer to 1 ms, or take a card"
    )]
    Late { late: usize, answers: usize },
    #[error("power stage is off: switch the cabinet on and release its emergency stop")]
    PowerStage,
    #[error("{0}")]
    Line(LineError),
}
