//! The frames of a bus, for the calculation of the bus load.

use std::time::Duration;

use can::StandardId;
use can::schedule::Sender;
use canopen::NodeId;
use canopen::pdo::PdoNumber;
use canopen::{cia401, cob};

use super::needs_sync;
use crate::cia401::IoConfig;
use crate::cia402::{AxisConfig, GroupConfig, SHOWN_APART, request_len};
use crate::wrench::WrenchNodeConfig;

/// One kind of frame that a host or its nodes send, for the calculation of the bus load.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Traffic {
    /// Its identifier.
    pub cob_id: StandardId,
    /// Bytes of payload.
    pub bytes: u8,
    /// Its sender.
    pub sender: Sender,
    /// Shortest time between two such frames.
    pub period: Duration,
    /// Whether the frame must end within the cycle in which its sender queues it.
    pub cyclic: bool,
    /// Description of the frame.
    pub what: &'static str,
}

/// All traffic of a bus during operation, except EMCY. SYNC is a part of the traffic if a node needs SYNC.
///
/// Service frames occur only during a change of mode. The result counts service frames at their greatest rate: one
/// request and one answer per cycle. Inputs count at the rate that their inhibit time permits, and outputs as if they
/// changed in every cycle.
pub fn traffic(
    config: &GroupConfig,
    axes: &[AxisConfig],
    io: &[IoConfig],
    sensors: &[WrenchNodeConfig],
) -> Vec<Traffic> {
    let frame = |cob_id, bytes, sender, period, what| Traffic { cob_id, bytes, sender, period, cyclic: false, what };
    let cyclic =
        |cob_id, bytes, sender, what| Traffic { cyclic: true, ..frame(cob_id, bytes, sender, config.period, what) };
    let (cycle, heartbeat) = (config.period, config.heartbeat_period);
    let alive = |node: NodeId| frame(cob::heartbeat(node), 1, Sender::Node(node.raw()), heartbeat, "heartbeat");
    let mut traffic = Vec::new();
    if needs_sync(axes, io) || sensors.iter().any(WrenchNodeConfig::needs_sync) {
        traffic.push(cyclic(cob::SYNC, 0, Sender::Host, "SYNC"));
    }
    traffic.push(Traffic { sender: Sender::Host, what: "host heartbeat", ..alive(config.host_node) });
    for &AxisConfig { node, mode, emergency_input, .. } in axes {
        let (length, drive) = (request_len(mode) as u8, Sender::Node(node.raw()));
        let [answer, shown] = [PdoNumber::One, PdoNumber::Two].map(|number| cob::tpdo(number, node));
        traffic.extend([
            cyclic(cob::rpdo(PdoNumber::One, node), length, Sender::Host, "set-point"),
            cyclic(answer, 8, drive, "answer"),
            frame(shown, 1, drive, SHOWN_APART, "mode of operation"),
            alive(node),
        ]);
        let inputs = cob::tpdo(PdoNumber::Three, node);
        traffic.extend(emergency_input.map(|_| cyclic(inputs, 4, drive, "digital inputs")));
    }
    for &IoConfig { node, inputs, outputs, inhibit_time, .. } in io {
        let [rpdo, tpdo] = [cob::rpdo(PdoNumber::One, node), cob::tpdo(PdoNumber::One, node)];
        let outputs = frame(rpdo, cia401::blocks(outputs), Sender::Host, cycle, "outputs");
        let inputs = frame(tpdo, cia401::blocks(inputs), Sender::Node(node.raw()), inhibit_time, "inputs");
        traffic.extend([outputs, inputs].into_iter().filter(|frame| frame.bytes > 0));
        traffic.push(alive(node));
    }
    traffic.extend(sensors.iter().flat_map(|sensor| sensor.samples(config)));
    traffic.extend(sensors.iter().map(|sensor| alive(sensor.node)));
    if let Some(&AxisConfig { node, .. }) = axes.first() {
        traffic.extend([
            frame(cob::sdo_request(node), 8, Sender::Host, cycle, "service request"),
            frame(cob::sdo_response(node), 8, Sender::Node(node.raw()), cycle, "service answer"),
        ]);
    }
    traffic
}
