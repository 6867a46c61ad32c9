//! Faults of a force/torque sensor and their form in the words of a state, and errors of its bring-up.

use std::time::Duration;

use can::{PortError, counted, counted_as};
use serial::LineError;
use thiserror::Error;

use super::state::WrenchAxis;
use crate::Fault;
use crate::bus::Sign;

/// A latched condition of a force/torque sensor. [`WrenchLink::reset_fault`](super::WrenchLink::reset_fault) and the
/// next bring-up clear the fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum WrenchFault {
    /// Bring-up has not ended.
    #[error("force sensor not started")]
    NotStarted,
    /// The driver was dropped, and no longer reads the sensor.
    #[error("force sensor ended, its line or bus has no controller any more")]
    Ended,
    /// More samples in a row are missing than [`tolerated_missing`](super::WrenchConfig::tolerated_missing). `cycles`:
    /// number of servo cycles without a sample.
    #[error("no sample for {}: check cable and supply of the sensor", counted(*.cycles, "cycle"))]
    Silent { cycles: u32 },
    /// Too many samples are missing, and `readings` readings since the last sample did not have the length of an
    /// answer.
    #[error(
        "{} no answer of the sensor since the last sample: check its cable and restart it",
        counted_as(*.readings, "reading was", "readings were")
    )]
    Garbage { readings: u32 },
    /// Samples come at the declared rate, but more than a fifth of the last samples is missing.
    #[error("{missing} of {of} samples missing: check cable, adapter and load of the connection")]
    Missing { missing: u32, of: u32 },
    /// CAN: too many samples are missing, and `samples` of them lacked a frame, or had a frame after the next SYNC.
    #[error(
        "{} without all frames: reduce the load of the bus, or check the PDOs of the sensor",
        counted(*.samples, "sample")
    )]
    Incomplete { samples: u32 },
    /// The reading went beyond the configured range after readings within it: a contact of the tool, or a load that was
    /// added. The true load may be greater.
    #[error("{axis} went beyond its range to {counts} counts: look for what the tool touches, then reset the fault")]
    Saturated { axis: WrenchAxis, counts: i32 },
    /// The reading is still beyond the configured range after a reset.
    #[error(
        "{axis} is still beyond its range at {counts} counts: free the tool or take its load off, then reset again"
    )]
    StillSaturated { axis: WrenchAxis, counts: i32 },
    /// The mean period of the samples is not the declared period, or answers are late by a cycle.
    #[error(
        "a sample every {found:.1?}, declared was {declared:?}: check the rate of the sensor and of its connection"
    )]
    OfAnotherRate { declared: Duration, found: Duration },
    /// A status field of the sensor has error bits set.
    #[error("sensor reports status {status:#x}: see its data sheet")]
    Status { status: u32 },
    /// The serial line cannot be read or written.
    #[error("{0}: open the line anew")]
    Line(LineError),
    /// The node on the CAN bus sent no heartbeat.
    #[error("no heartbeat for {waited:.1?}")]
    HeartbeatLost { waited: Duration },
    /// The node on the CAN bus booted again, or left NMT state operational. A new bring-up is necessary.
    #[error("left operational state: bring the bus up again")]
    LeftOperational,
    /// The port has accepted no heartbeat of the host for longer than the nodes wait for a heartbeat.
    #[error("bus: the host's heartbeat was not sent for {waited:.1?}")]
    HeartbeatNotSent { waited: Duration },
    #[error("bus: another controller is at work: it sent {sign}")]
    OtherController { sign: Sign },
    #[error("bus: {0}")]
    Port(PortError),
    /// The host's CAN controller counted too many errors and left the bus.
    #[error("bus: the controller is bus-off")]
    BusOff,
}

impl WrenchFault {
    /// The fault of every sensor on a bus that has the fault `fault`; `None` for a fault of one drive.
    pub(crate) fn of_bus(fault: Fault) -> Option<Self> {
        Some(match fault {
            Fault::HeartbeatNotSent { waited } => Self::HeartbeatNotSent { waited },
            Fault::OtherController { sign } => Self::OtherController { sign },
            Fault::Port(error) => Self::Port(error),
            Fault::BusOff => Self::BusOff,
            Fault::Drive { .. }
            | Fault::Silent { .. }
            | Fault::Late { .. }
            | Fault::NotSent { .. }
            | Fault::NotAcknowledged { .. }
            | Fault::HeartbeatLost { .. }
            | Fault::HostLate { .. }
            | Fault::LeftOperational { .. }
            | Fault::NotBack { .. }
            | Fault::PowerLost { .. }
            | Fault::Implausible { .. }
            | Fault::NoSearch { .. }
            | Fault::NotAtZero { .. }
            | Fault::ModeChanged { .. }
            | Fault::Stuck { .. }
            | Fault::Aborted { .. }
            | Fault::Refused { .. }
            | Fault::AxisController { .. } => return None,
        })
    }

    /// Whether this fault may come from a restart of the sensor. A restart clears a zero that the sensor itself stores.
    pub(super) fn may_be_restart(self) -> bool {
        match self {
            Self::NotStarted | Self::Ended | Self::Silent { .. } | Self::Garbage { .. } | Self::Line(_) => true,
            Self::Missing { .. }
            | Self::Incomplete { .. }
            | Self::Saturated { .. }
            | Self::StillSaturated { .. }
            | Self::OfAnotherRate { .. }
            | Self::Status { .. }
            | Self::HeartbeatLost { .. }
            | Self::LeftOperational
            | Self::HeartbeatNotSent { .. }
            | Self::OtherController { .. }
            | Self::Port(_)
            | Self::BusOff => false,
        }
    }
}

/// Why a force/torque sensor could not be brought up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum WrenchError {
    /// On a serial line: no byte was received. On a CAN bus: the node sent no boot-up message and no answer.
    #[error("no answer, waited {waited:.1?}: check supply and cable of the sensor, and its {address}")]
    Absent { waited: Duration, address: &'static str },
    /// On a serial line: bytes were received, but no answer.
    #[error(
        "{} and no answer of {length} among them: check the baud rate and the device on the line",
        counted(*.bytes, "byte")
    )]
    Garbled { bytes: u32, length: usize },
    /// On a serial line: most answers took more than a period.
    #[error("{late} of {answers} answers took more than a period: set the adapter's latency timer to 1 ms")]
    Late { late: u32, answers: u32 },
    /// The device type (object 0x1000) of the node differs from the configured type.
    #[error("0x1000 is {found:#010x}, the cell expects {expected:#010x}: another device has this node-ID")]
    OfAnotherType { expected: u32, found: u32 },
    /// The node was started and sent no whole sample.
    #[error("no sample since the start, waited {waited:.1?}: check the PDOs of the sensor")]
    NoSamples { waited: Duration },
    #[error("{missing} of {of} samples missing: check cable, adapter and load of the connection")]
    Missing { missing: u32, of: u32 },
    /// Every sample lacked a frame, or had a frame after the next SYNC.
    #[error(
        "{} without all frames: reduce the load of the bus, or check the PDOs of the sensor",
        counted(*.samples, "sample")
    )]
    Incomplete { samples: u32 },
    #[error("a sample every {found:.1?}, declared was {declared:?}: set the rate of the sensor")]
    OfAnotherRate { declared: Duration, found: Duration },
    /// Too many samples in a row beyond the configured range: a contact, a load that is too heavy, or a defect.
    #[error("{axis} is saturated at {counts} counts: free the tool of contact and load, check the cable of the sensor")]
    Saturated { axis: WrenchAxis, counts: i32 },
    #[error("sensor reports status {status:#x}: see its data sheet")]
    Status { status: u32 },
    #[error("{0}")]
    Line(LineError),
}

/// A fault as three words: its kind, and two numbers. Kind 0 is no fault.
pub(super) fn words(fault: Option<WrenchFault>) -> [u64; 3] {
    let nanos = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
    let errno = |number: i32| u64::from(number.cast_unsigned());
    let Some(fault) = fault else { return [0; 3] };
    match fault {
        WrenchFault::NotStarted => [1, 0, 0],
        WrenchFault::Ended => [2, 0, 0],
        WrenchFault::Silent { cycles } => [3, u64::from(cycles), 0],
        WrenchFault::Garbage { readings } => [4, u64::from(readings), 0],
        WrenchFault::Saturated { axis, counts } => [5, axis as u64, errno(counts)],
        WrenchFault::OfAnotherRate { declared, found } => [6, nanos(declared), nanos(found)],
        WrenchFault::Status { status } => [7, u64::from(status), 0],
        WrenchFault::Line(LineError::Gone) => [8, 0, 0],
        WrenchFault::Line(LineError::Os(number)) => [8, 1, errno(number)],
        WrenchFault::HeartbeatLost { waited } => [9, nanos(waited), 0],
        WrenchFault::LeftOperational => [10, 0, 0],
        WrenchFault::HeartbeatNotSent { waited } => [11, nanos(waited), 0],
        WrenchFault::OtherController { sign: Sign::Sync } => [12, 0, 0],
        WrenchFault::OtherController { sign: Sign::Heartbeat { node } } => [12, 1, u64::from(node)],
        WrenchFault::OtherController { sign: Sign::Setpoint { node } } => [12, 2, u64::from(node)],
        WrenchFault::OtherController { sign: Sign::Write { node } } => [12, 3, u64::from(node)],
        WrenchFault::Port(PortError::Down) => [13, 0, 0],
        WrenchFault::Port(PortError::Gone) => [13, 1, 0],
        WrenchFault::Port(PortError::Os(number)) => [13, 2, errno(number)],
        WrenchFault::BusOff => [14, 0, 0],
        WrenchFault::Incomplete { samples } => [15, u64::from(samples), 0],
        WrenchFault::Missing { missing, of } => [16, u64::from(missing), u64::from(of)],
        WrenchFault::StillSaturated { axis, counts } => [17, axis as u64, errno(counts)],
    }
}

/// The fault that [`words`] has encoded.
pub(super) fn of_words([kind, a, b]: [u64; 3]) -> Option<WrenchFault> {
    let (time, number) = (Duration::from_nanos, |word: u64| (word as u32).cast_signed());
    Some(match kind {
        0 => return None,
        2 => WrenchFault::Ended,
        3 => WrenchFault::Silent { cycles: a as u32 },
        4 => WrenchFault::Garbage { readings: a as u32 },
        5 => WrenchFault::Saturated { axis: WrenchAxis::ALL[a as usize % 6], counts: number(b) },
        6 => WrenchFault::OfAnotherRate { declared: time(a), found: time(b) },
        7 => WrenchFault::Status { status: a as u32 },
        8 => WrenchFault::Line(if a == 0 { LineError::Gone } else { LineError::Os(number(b)) }),
        9 => WrenchFault::HeartbeatLost { waited: time(a) },
        10 => WrenchFault::LeftOperational,
        11 => WrenchFault::HeartbeatNotSent { waited: time(a) },
        12 => WrenchFault::OtherController {
            sign: match a {
                0 => Sign::Sync,
                1 => Sign::Heartbeat { node: b as u8 },
                2 => Sign::Setpoint { node: b as u8 },
                _ => Sign::Write { node: b as u8 },
            },
        },
        13 => WrenchFault::Port(match a {
            0 => PortError::Down,
            1 => PortError::Gone,
            _ => PortError::Os(number(b)),
        }),
        14 => WrenchFault::BusOff,
        15 => WrenchFault::Incomplete { samples: a as u32 },
        16 => WrenchFault::Missing { missing: a as u32, of: b as u32 },
        17 => WrenchFault::StillSaturated { axis: WrenchAxis::ALL[a as usize % 6], counts: number(b) },
        _ => WrenchFault::NotStarted,
    })
}

#[cfg(test)]
pub(super) mod tests {
    use proptest::prelude::*;
    use proptest::sample::select;

    use super::*;

    /// Any fault, or none.
    pub(in crate::wrench) fn any_fault() -> impl Strategy<Value = Option<WrenchFault>> {
        (0..=24_usize, any::<u32>(), any::<i32>(), any::<[u64; 2]>(), select(&WrenchAxis::ALL)).prop_map(
            |(kind, cycles, counts, [declared, found], axis)| {
                let (waited, node) = (Duration::from_nanos(declared), cycles as u8);
                [
                    WrenchFault::NotStarted,
                    WrenchFault::Ended,
                    WrenchFault::Silent { cycles },
                    WrenchFault::Garbage { readings: cycles },
                    WrenchFault::Saturated { axis, counts },
                    WrenchFault::StillSaturated { axis, counts },
                    WrenchFault::OfAnotherRate { declared: waited, found: Duration::from_nanos(found) },
                    WrenchFault::Status { status: cycles },
                    WrenchFault::Line(LineError::Gone),
                    WrenchFault::Line(LineError::Os(counts)),
                    WrenchFault::HeartbeatLost { waited },
                    WrenchFault::LeftOperational,
                    WrenchFault::HeartbeatNotSent { waited },
                    WrenchFault::OtherController { sign: Sign::Sync },
                    WrenchFault::OtherController { sign: Sign::Heartbeat { node } },
                    WrenchFault::OtherController { sign: Sign::Setpoint { node } },
                    WrenchFault::OtherController { sign: Sign::Write { node } },
                    WrenchFault::Port(PortError::Down),
                    WrenchFault::Port(PortError::Gone),
                    WrenchFault::Port(PortError::Os(counts)),
                    WrenchFault::BusOff,
                    WrenchFault::Incomplete { samples: cycles },
                    WrenchFault::Missing { missing: cycles, of: found as u32 },
                ]
                .get(kind)
                .copied()
            },
        )
    }

    proptest! {
        #[test]
        fn every_fault_survives_its_words(fault in any_fault()) {
            prop_assert_eq!(of_words(words(fault)), fault);
        }
    }
}
