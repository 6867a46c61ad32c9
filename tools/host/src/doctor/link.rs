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
    /// Bit rate of a controller with a few fixed bit rates and without bit timing.
    bittiming_bitrate: Option<u32>,
    berr_counter: Option<ErrorCounters>,
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
        programs.into_iter().find_map(|program| {
            let told = output_of(Command::new(program).args(ARGUMENTS).arg(interface))?;
            Self::parse(&told)
        })
    }

    /// Parses the output of `ip`; `None` if the text does not describe exactly one interface.
    pub fn parse(json: &str) -> Option<Self> {
        let links: Vec<Self> = serde_json::from_str(json).ok()?;
        links.into_iter().next()
    }

    /// `can`, `vcan` or `vxcan`; empty if unknown.
    pub fn kind(&self) -> &str {
        &self.linkinfo.info_kind
    }

    /// `ERROR-ACTIVE` and so on; `STOPPED` while the interface is down.
    pub fn state(&self) -> Option<&str> {
        self.linkinfo.info_data.state.as_deref()
    }

    /// Bit rate, bit/s; `None` if no bit rate is set.
    pub fn bitrate(&self) -> Option<u32> {
        let data = &self.linkinfo.info_data;
        let timing = data.bittiming.as_ref().map(|timing| timing.bitrate);
        timing.or(data.bittiming_bitrate).filter(|&rate| rate > 0)
    }

    /// Sample point as a share of the bit time, 0 to 1.
    pub fn sample_point(&self) -> Option<f64> {
        let point = &self.linkinfo.info_data.bittiming.as_ref()?.sample_point;
        let number = || point.as_str()?.parse().ok();
        point.as_f64().or_else(number).filter(|&point| point > 0.0)
    }

    /// Time from bus-off to the restart, ms; 0 means no automatic restart.
    pub fn restart_ms(&self) -> u32 {
        self.linkinfo.info_data.restart_ms
    }

    /// Error counters of the controller, if available.
    pub fn error_counters(&self) -> Option<ErrorCounters> {
        self.linkinfo.info_data.berr_counter
    }

    /// Event counts since the interface was created.
    pub fn statistics(&self) -> Statistics {
        self.linkinfo.info_xstats
    }
}
