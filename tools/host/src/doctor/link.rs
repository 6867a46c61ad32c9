//! Data of an interface from netlink, in the format of `ip -details -json` of iproute2.
//!
//! Bit timing, restart time and error counters are available through netlink only, not below `/sys`. `ip` is part of
//! every Debian. The examination therefore needs neither a netlink library nor privileges.

use std::process::Command;

use serde::Deserialize;
use serde_json::Value;

use super::tree::output_of;

/// Arguments of `ip` for the output that [`Link::parse`] reads. The name of the interface follows.
const ARGUMENTS: [&str; 6] = ["-details", "-statistics", "-json", "link", "show", "dev"];

/// One interface.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Link {
    /// Queueing discipline.
    pub qdisc: String,
    /// Data of the kind of interface.
    #[serde(rename = "linkinfo")]
    pub info: LinkInfo,
}

/// Data of the kind of an interface.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct LinkInfo {
    /// `can`, `vcan` or `vxcan`; empty if unknown.
    #[serde(rename = "info_kind")]
    pub kind: String,
    /// Settings and state of a CAN controller.
    #[serde(rename = "info_data")]
    pub controller: Controller,
    /// Event counts since the interface was created.
    #[serde(rename = "info_xstats")]
    pub statistics: Statistics,
}

/// Settings and state of a CAN controller.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Controller {
    /// `ERROR-ACTIVE` and so on; `STOPPED` while the interface is down.
    pub state: Option<String>,
    /// Time from bus-off to the restart, ms; 0 means no automatic restart.
    pub restart_ms: u32,
    bittiming: Option<Bittiming>,
    /// Bit rate of a controller with a few fixed bit rates and without bit timing.
    bittiming_bitrate: Option<u32>,
    /// Error counters, if available.
    #[serde(rename = "berr_counter")]
    pub error_counters: Option<ErrorCounters>,
}

#[derive(Clone, Debug, Deserialize)]
struct Bittiming {
    bitrate: u32,
    /// A number, or a string that contains a number, depending on the version of iproute2.
    #[serde(default)]
    sample_point: Value,
}

/// Error counters of the controller (ISO 11898-1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub struct ErrorCounters {
    /// Transmit error counter.
    pub tx: u32,
    /// Receive error counter.
    pub rx: u32,
}

/// Event counts since the interface was created.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default)]
pub struct Statistics {
    /// Restarts after bus-off.
    pub restarts: u32,
    /// Changes to error passive.
    pub error_passive: u32,
    /// Changes to bus-off.
    pub bus_off: u32,
}

impl Link {
    /// Data from `ip`; `None` if `ip` is not installed or knows no such interface.
    pub fn of(interface: &str) -> Option<Self> {
        // The PATH of an ordinary user may lack the directories of the administrator.
        let programs = ["ip", "/usr/sbin/ip", "/sbin/ip"];
        programs
            .into_iter()
            .find_map(|program| Self::parse(&output_of(Command::new(program).args(ARGUMENTS).arg(interface))?))
    }

    /// Parses the output of `ip`; `None` if the text does not describe exactly one interface.
    pub fn parse(json: &str) -> Option<Self> {
        serde_json::from_str::<Vec<Self>>(json).ok()?.into_iter().next()
    }

    /// Bit rate, bit/s; `None` if no bit rate is set.
    pub fn bitrate(&self) -> Option<u32> {
        let data = &self.info.controller;
        let timing = data.bittiming.as_ref().map(|timing| timing.bitrate);
        timing.or(data.bittiming_bitrate).filter(|&rate| rate > 0)
    }

    /// Sample point as a share of the bit time, 0 to 1.
    pub fn sample_point(&self) -> Option<f64> {
        let point = &self.info.controller.bittiming.as_ref()?.sample_point;
        let number = || point.as_str()?.parse().ok();
        point.as_f64().or_else(number).filter(|&point| point > 0.0)
    }
}
