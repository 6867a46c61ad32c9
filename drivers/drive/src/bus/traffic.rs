//! The frames of a bus, for the calculation of the bus load.

use std::time::Duration;

use can::StandardId;
use canopen::pdo::PdoNumber;
use canopen::{cia401, cob};

use super::needs_sync;
use crate::cia401::IoConfig;
use crate::cia402::{AxisConfig, GroupConfig, SHOWN_APART, request_len};

/// One kind of frame that a host or its nodes send, for the calculation of the bus load.
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

/// All traffic of a bus during operation, except EMCY. SYNC is part of it if a node needs SYNC. Service frames occur only during a change of mode. The result
/// counts service frames at their greatest rate: one request and one answer per cycle. Inputs count at the rate that
/// their inhibit time permits, and outputs as if they changed in every cycle.
pub fn traffic(config: &GroupConfig, axes: &[AxisConfig], io: &[IoConfig]) -> Vec<Traffic> {
    let frame = |cob_id, bytes, period, what| Traffic { cob_id, bytes, period, what };
    let (cycle, heartbeat) = (config.period, config.heartbeat_period);
    let host = cob::heartbeat(config.host_node);
    let mut traffic = Vec::new();
    if needs_sync(axes, io) {
        traffic.push(frame(cob::SYNC, 0, cycle, "SYNC"));
    }
    traffic.push(frame(host, 1, heartbeat, "host heartbeat"));
    for &AxisConfig { node, mode, .. } in axes {
        let length = request_len(mode) as u8;
        let [answer, shown] = [PdoNumber::One, PdoNumber::Two].map(|number| cob::tpdo(number, node));
        traffic.extend([
            frame(cob::rpdo(PdoNumber::One, node), length, cycle, "set-point"),
            frame(answer, 8, cycle, "answer"),
            frame(shown, 1, SHOWN_APART, "mode of operation"),
            frame(cob::heartbeat(node), 1, heartbeat, "heartbeat"),
        ]);
    }
    for &IoConfig { node, inputs, outputs, inhibit_time, .. } in io {
        let rpdo = frame(cob::rpdo(PdoNumber::One, node), cia401::blocks(outputs), cycle, "outputs");
        let tpdo = frame(cob::tpdo(PdoNumber::One, node), cia401::blocks(inputs), inhibit_time, "inputs");
        traffic.extend([rpdo, tpdo].into_iter().filter(|frame| frame.bytes > 0));
        traffic.push(frame(cob::heartbeat(node), 1, heartbeat, "heartbeat"));
    }
    if let Some(&AxisConfig { node, .. }) = axes.first() {
        traffic.extend([
            frame(cob::sdo_request(node), 8, cycle, "service request"),
            frame(cob::sdo_response(node), 8, cycle, "service answer"),
        ]);
    }
    traffic
}
