//! Warnings: errors that drives and I/O nodes report without a fault, and oddities of their answers, counted and bounded.

use std::time::Duration;

use can::counted;
use canopen::Object;
use canopen::cia402::FaultTable;
use thiserror::Error;

/// An irregularity without a fault since the start of operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("node {node}: {cause}")]
pub struct Warning {
    /// Time from the start of operation to the first report.
    pub after: Duration,
    /// Node-ID.
    pub node: u8,
    /// What was irregular.
    pub cause: WarningCause,
    /// How often.
    pub count: u64,
}

/// Cause of a warning.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum WarningCause {
    /// The node reported an error by EMCY.
    #[error("EMCY {code:#06x} ({text}), error register {register:#04x}", text = .table.text(*.code))]
    Emergency {
        /// Error code.
        code: u16,
        /// Meaning of the error code.
        table: FaultTable,
        /// Object 0x1001.
        register: u8,
    },
    /// All answers of the node come late, and the loop permits it. The count says how often this was found.
    #[error("answers come {latency:.1?} after their SYNC, {} late", counted(*.periods, "period"))]
    Late {
        /// Periods by which the answers come later than in the period of their SYNC.
        periods: u32,
        /// Longest latency found.
        latency: Duration,
    },
    /// Answers of the node came without a SYNC: frames come twice, or another node sends the same identifier. The count is the
    /// number of these answers.
    #[error("an answer without a SYNC: a frame came twice, or another node sends the same identifier")]
    Surplus,
    /// The software position limits of the drive (0x607D) lie within the positions of the cell.
    #[error(
        "the drive stops its motor at its software position limits {low} and {high} (0x607D), the cell moves it from \
         {least} to {most} counts: widen the limits, or switch them off"
    )]
    SoftwareLimits {
        /// Lower limit of the drive, counts.
        low: i32,
        /// Upper limit of the drive, counts.
        high: i32,
        /// Least position of the cell, counts.
        least: i32,
        /// Greatest position of the cell, counts.
        most: i32,
    },
    /// The node lacks object 0x1029:01, so that its reaction to the loss of the host is not known.
    #[error(
        "no object 0x1029:01, so it is not known whether the drive leaves operational without the heartbeat of the host: \
         against frames that a buffer held, only SYNC without set-points protects; check the drive's reaction"
    )]
    NoErrorBehaviour,
    /// Values that can only be read differ from the device configuration file.
    #[error(
        "{different} of {} {} from the device configuration file, the first is {first}",
        counted(*.values, "read-only value"),
        if *.different == 1 { "differs" } else { "differ" }
    )]
    Compared {
        /// Number of compared values.
        values: u32,
        /// Number of values that differ.
        different: u32,
        /// The first object that differs.
        first: Object,
    },
    /// The statusword of a drive has the bit `Statusword::WARNING`. The count says how often it was set.
    #[error("the drive has a warning (statusword bit 7): read its error history, object 0x1003")]
    Reported,
    /// The statusword of a drive that is on, and does not search for its reference, has the bit
    /// `Statusword::INTERNAL_LIMIT`. The count says how often it was set.
    #[error(
        "an internal limit of the drive is in force (statusword bit 11): check its limits of position, velocity and \
         torque, and its limit switches"
    )]
    Limited,
}

impl WarningCause {
    /// Error code and error register of an EMCY.
    pub fn emergency(&self) -> Option<(u16, u8)> {
        match *self {
            Self::Emergency { code, register, .. } => Some((code, register)),
            Self::Late { .. }
            | Self::Surplus
            | Self::Reported
            | Self::Limited
            | Self::SoftwareLimits { .. }
            | Self::NoErrorBehaviour
            | Self::Compared { .. } => None,
        }
    }

    /// Whether both causes count as one.
    fn is_kind(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Emergency { code, register, .. }, Self::Emergency { code: other, register: also, .. }) => {
                (code, register) == (other, also)
            }
            (Self::Late { periods, .. }, Self::Late { periods: other, .. }) => periods == other,
            (Self::Surplus, Self::Surplus)
            | (Self::Reported, Self::Reported)
            | (Self::Limited, Self::Limited)
            | (Self::SoftwareLimits { .. }, Self::SoftwareLimits { .. })
            | (Self::NoErrorBehaviour, Self::NoErrorBehaviour)
            | (Self::Compared { .. }, Self::Compared { .. }) => true,
            (
                Self::Emergency { .. }
                | Self::Late { .. }
                | Self::Surplus
                | Self::Reported
                | Self::Limited
                | Self::SoftwareLimits { .. }
                | Self::NoErrorBehaviour
                | Self::Compared { .. },
                _,
            ) => false,
        }
    }
}

/// The warnings of a group: the first [`KEPT`](Self::KEPT) different ones, and the number of reports that had no room.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Warnings {
    kept: Vec<Warning>,
    omitted: u64,
}

impl Warnings {
    /// Greatest number of different warnings.
    pub const KEPT: usize = 32;

    pub(crate) const NONE: Self = Self { kept: Vec::new(), omitted: 0 };

    /// No warning, with reserved room for later ones.
    pub(crate) fn with_room() -> Self {
        Self { kept: Vec::with_capacity(Self::KEPT), omitted: 0 }
    }

    pub(crate) fn clear(&mut self) {
        self.kept.clear();
        self.omitted = 0;
    }

    /// Adds a report. A report of the same node and kind as an earlier one increases its count.
    pub(crate) fn add(&mut self, warning: Warning) {
        let is_same = |kept: &Warning| kept.node == warning.node && kept.cause.is_kind(&warning.cause);
        match self.kept.iter().position(is_same) {
            Some(index) => {
                let same = &mut self.kept[index];
                same.count += warning.count;
                if let (WarningCause::Late { latency, .. }, WarningCause::Late { latency: found, .. }) =
                    (&mut same.cause, warning.cause)
                {
                    *latency = found.max(*latency);
                }
            }
            None if self.kept.len() < Self::KEPT => self.kept.push(warning),
            None => self.omitted += warning.count,
        }
    }

    /// Removes the last report of `code` by `node`, because the drive has a fault of this code.
    pub(crate) fn explain(&mut self, node: u8, code: u16) {
        let explained = |kept: &Warning| {
            let emergency = matches!(kept.cause, WarningCause::Emergency { code: reported, .. } if reported == code);
            kept.node == node && emergency
        };
        let Some(last) = self.kept.iter().rposition(explained) else { return };
        self.kept[last].count -= 1;
        if self.kept[last].count == 0 {
            self.kept.remove(last);
        }
    }

    /// The warnings, in the order of their first report.
    pub fn iter(&self) -> impl Iterator<Item = &Warning> {
        self.kept.iter()
    }

    /// Reports for which there was no room.
    pub fn omitted(&self) -> u64 {
        self.omitted
    }
}
