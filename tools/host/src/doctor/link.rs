//! What the kernel tells of an interface through netlink, as `ip -details -json` of iproute2 writes it.
//!
//! Bit timing, restart time and error counters are in netlink only, not below `/sys`. `ip` is on every Debian, and with
//! it the examination needs neither a netlink library nor privileges.

use std::process::Command;

use serde::Deserialize;
use serde_json::Value;

use super::tree::output_of;

/// The arguments of `ip` that write what [`Link::parse`] reads; the interface's name follows.
const ARGUMENTS: [&str; 6] = ["-details", "-statistics", "-json", "link", "show", "dev"];

/// One interface.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Link {
    /// Queueing discipline.
    pub qdisc: String,
    linkinfo: LinkInfo,
}

#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
struct LinkInfo {
    info_kind: String,
    info_data: Data,
    info_xstats: Statistics,
}

#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
struct Data {
    state: Option<String>,
    restart_ms: u32,
    bittiming: Option<Bittiming>,
    /// Of controllers that have a few bit rates and no bit timing.
    bittiming_bitrate: Option<u32>,
    berr_counter: Option<ErrorCounters>,
}

#[derive(Clone, Debug, Deserialize)]
struct Bittiming {
    bitrate: u32,
    /// A number, or a string of one, as the version of iproute2 has it.
    #[serde(default)]
    sample_point: Value,
}

/// The controller's own error counters (ISO 11898-1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub struct ErrorCounters {
    /// Transmit error counter.
    pub tx: u32,
    /// Receive error counter.
    pub rx: u32,
}

/// Counts since the interface was made.
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
    /// What `ip` tells; none where it is not installed or knows no such interface.
    pub fn of(interface: &str) -> Option<Self> {
        // Where PATH has no directories of the administrator's.
        let programs = ["ip", "/usr/sbin/ip", "/sbin/ip"];
        programs.into_iter().find_map(|program| {
            let told = output_of(Command::new(program).args(ARGUMENTS).arg(interface))?;
            Self::parse(&told)
        })
    }

    /// None for what is not the description of one interface.
    pub fn parse(json: &str) -> Option<Self> {
        let links: Vec<Self> = serde_json::from_str(json).ok()?;
        links.into_iter().next()
    }

    /// `can`, `vcan`, `vxcan`; empty where it is not told.
    pub fn kind(&self) -> &str {
        &self.linkinfo.info_kind
    }

    /// `ERROR-ACTIVE` and so on, `STOPPED` while the interface is down.
    pub fn state(&self) -> Option<&str> {
        self.linkinfo.info_data.state.as_deref()
    }

    /// Bit rate, bit/s; none while it is not set.
    pub fn bitrate(&self) -> Option<u32> {
        let data = &self.linkinfo.info_data;
        let timing = data.bittiming.as_ref().map(|timing| timing.bitrate);
        timing.or(data.bittiming_bitrate).filter(|&rate| rate > 0)
    }

    /// Share of the bit before its sample, 0 to 1.
    pub fn sample_point(&self) -> Option<f64> {
        let point = &self.linkinfo.info_data.bittiming.as_ref()?.sample_point;
        let number = || point.as_str()?.parse().ok();
        point.as_f64().or_else(number).filter(|&point| point > 0.0)
    }

    /// Time from bus-off to the restart, ms; 0 for never.
    pub fn restart_ms(&self) -> u32 {
        self.linkinfo.info_data.restart_ms
    }

    /// Error counters of the controller, where it has them.
    pub fn error_counters(&self) -> Option<ErrorCounters> {
        self.linkinfo.info_data.berr_counter
    }

    /// Counts since the interface was made.
    pub fn statistics(&self) -> Statistics {
        self.linkinfo.info_xstats
    }
}
