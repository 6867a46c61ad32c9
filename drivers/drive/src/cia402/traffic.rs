//! The frames of a group, for the calculation of the bus load.

use std::time::Duration;

use can::StandardId;
use canopen::cob;
use canopen::pdo::PdoNumber;

use super::config::{AxisConfig, GroupConfig};
use super::process_data;

/// One kind of frame that a group or its drives send, for the calculation of the bus load.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Traffic {
    /// Its identifier.
    pub cob_id: StandardId,
    /// Bytes of payload.
    pub bytes: u8,
    /// Shortest time between two such frames.
    pub period: Duration,
    /// Description of the frame.
    pub what: &'static str,
}

/// All traffic of a group during operation, except EMCY. Service frames occur only during a change of mode. The
/// result counts them at their greatest rate: one request and one answer per cycle.
pub fn traffic(config: &GroupConfig, axes: &[AxisConfig]) -> Vec<Traffic> {
    let cycle = |cob_id, bytes, what| Traffic {
        cob_id,
        bytes,
        period: config.period,
        what,
    };
    let heartbeat = |node, what| Traffic {
        cob_id: cob::heartbeat(node),
        bytes: 1,
        period: config.heartbeat_period,
        what,
    };
    let mut traffic = vec![
        cycle(cob::SYNC, 0, "SYNC"),
        heartbeat(config.host_node, "host heartbeat"),
    ];
    for axis in axes {
        let request = process_data::request_len(axis.mode) as u8;
        traffic.extend([
            cycle(cob::rpdo(PdoNumber::One, axis.node), request, "set-point"),
            cycle(cob::tpdo(PdoNumber::One, axis.node), 8, "answer"),
            Traffic {
                cob_id: cob::tpdo(PdoNumber::Two, axis.node),
                bytes: 1,
                period: process_data::SHOWN_APART,
                what: "mode of operation",
            },
            heartbeat(axis.node, "heartbeat"),
        ]);
    }
    if let Some(axis) = axes.first() {
        traffic.extend([
            cycle(cob::sdo_request(axis.node), 8, "service request"),
            cycle(cob::sdo_response(axis.node), 8, "service answer"),
        ]);
    }
    traffic
}
