//! CiA 402 drives on one CAN bus in the cyclic synchronous modes (CiA 402-2 §17 to §19), as the EPOS4 implements them.
//!
//! [`Cia402Group`] brings its drives up and exchanges one RPDO and one TPDO with each drive per SYNC. The group leads
//! the drives through the power states and through homing. The group monitors answers, heartbeats, EMCY and
//! statuswords. Bring-up also sets and reads back the reaction of a drive that loses the host: after three missing
//! host heartbeats, the drive brakes by its quick stop and holds.
//!
//! TPDO 2 reports a change of the mode of operation. A change that the group did not command is a fault. A drive
//! normally sends nothing on TPDO 2, so the monitoring costs no bus load.
//!
//! Before its first frame the group listens ([`GroupConfig::listening`]). A frame that only another controller can
//! have sent makes the group refuse the start. In operation, such a frame is a fault of every axis ([`Sign`]).
//!
//! # Commands
//! - [`Off`](AxisCommand::Off) removes the voltage, also from a moving axis. The servo brakes the axis first where
//!   necessary.
//! - [`Stand`](AxisCommand::Stand) in CSP holds the position of the first answer that showed torque, or the last
//!   set-point followed. In CSV and CST the command means zero velocity or torque, and a load may then move the axis:
//!   follow at once.
//! - [`Follow`](AxisCommand::Follow) is refused before [`Power::On`] was seen, with the wrong kind of set-point for
//!   the mode, or beyond the drive's range. [`Fault::Refused`] names the axis, and no axis of the group changes its
//!   target in that cycle. While [`AxisState::following`] is false during a change of mode, the set-point is ignored
//!   and the drive stands.
//! - [`Home`](AxisCommand::Home) changes to mode HM by service requests and searches. The whole group sends at most
//!   one service frame a cycle. On leaving, an unfinished search is halted, and the drive returns to the cyclic mode
//!   with its present position as target.
//! - An axis with a latched fault is braked by its quick stop. Only `Off` and `ResetFault` end this state.
//!
//! No set-point is clamped, queued or sent twice.
//!
//! # Which objects are written
//!
//! [`AxisConfig::configuration`] is written first, and may hold no [`reserved`] object. Those objects belong to this
//! driver, which writes and reads back the following last, before operation:
//! - heartbeats (0x1016:01, 0x1017);
//! - reactions (0x1029:01, 0x6007, 0x605A, 0x6085);
//! - interpolation period (0x60C2);
//! - following error window (0x6065);
//! - homing (0x6098, 0x6099, 0x609A, 0x607C and maxon's 0x30B0, 0x30B1);
//! - offsets (0x60B0 to 0x60B2);
//! - process data: RPDO 1, TPDO 1 and TPDO 2 are mapped and the other PDOs switched off;
//! - mode of operation (0x6060).
//!
//! Not supported: profile modes, interpolated position (EPOS2), and several axes behind one node-ID. Read
//! [`DriveGroup`] first, then `axis`, `bring_up` and `program`.

mod agreement;
mod axis;
mod bring_up;
mod config;
mod homing;
mod measurement;
mod other_controller;
mod own_heartbeat;
mod process_data;
mod program;
mod recording;
mod reserved;
mod service;
mod target;
mod traffic;

#[cfg(test)]
mod tests;

use std::task::Poll;
use std::time::Duration;

use can::{ControllerState, Frame, Instant, Port, Received};
use canopen::emcy::Emergency;
use canopen::heartbeat::Heartbeat;
use canopen::pdo::PdoNumber;
use canopen::sync::Sync;
use canopen::{cob, nmt};
use master::sdo::Client;

pub use canopen::NodeId;
pub use config::{AxisConfig, ConfigError, CyclicMode, GroupConfig, HomingConfig, Identity, Quantity, Setting};
pub use other_controller::Sign;
pub use process_data::pdo_setups;
pub use recording::Recording;
pub use reserved::{Reserved, reserved};
pub use traffic::{Traffic, traffic};

#[cfg(doc)]
use crate::Power;
use crate::{AxisCommand, AxisState, BringUpError, DriveGroup, Fault, GroupCounters, Warning, Warnings};
use axis::CanAxis;
use bring_up::NodeBringUp;
use own_heartbeat::OwnHeartbeat;
use process_data::Answer;
use service::Service;
use target::Target;

/// Greatest number of SDO frames sent by one call of bring-up. A transmit queue of ten has room for them.
const SDO_FRAMES_PER_CALL: usize = 8;

/// Frames of a cycle in addition to one set-point for each axis: SYNC, the host's heartbeat and a service request. A
/// port must take all frames of a cycle at once, or set-points are dropped.
pub const BESIDE_SETPOINTS: usize = 3;

/// CiA 402 drives behind one port. The module documentation describes each command.
pub struct Cia402Group<P: Port> {
    port: P,
    config: GroupConfig,
    nodes: Vec<Node>,
    /// Index into `nodes` by node-ID.
    index: [Option<u8>; 128],
    stage: Stage,
    received: Vec<Received>,
    /// During bring-up: frames that the port has not taken yet. In a cycle: SYNC and the set-points.
    batch: Vec<Frame>,
    /// A service frame that the port has not taken yet.
    service: Option<Frame>,
    /// Index of the node whose SDO client sent last.
    turn: usize,
    syncs: Syncs,
    heartbeat: OwnHeartbeat,
    counters: GroupCounters,
    warnings: Warnings,
    /// End of bring-up.
    up_since: Instant,
}

/// One drive: its bring-up, its operation, and the SDO client of both.
struct Node {
    bring_up: NodeBringUp,
    axis: CanAxis,
    sdo: Client,
    service: Option<Service>,
    setpoint: Option<Target>,
    /// Fault at the end of the last cycle.
    fault: Option<Fault>,
}

/// While the group listens, nothing is sent, and frames of another controller are detected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Down,
    Listening { until: Instant },
    Configuring,
    Starting,
    Up,
}

/// The SYNCs sent to which answers may still arrive.
#[derive(Clone, Copy, Debug, Default)]
struct Syncs {
    last: Option<Instant>,
    before: Option<Instant>,
    /// The last cycle had to send a SYNC.
    attempted: bool,
    /// The port took the SYNC of the last cycle.
    sent: bool,
}

impl Syncs {
    /// The SYNC that an answer received at `at` belongs to: the last one sent before the answer. `None` if the answer
    /// is older than the last two SYNCs.
    fn of_answer(&self, at: Instant) -> Option<Instant> {
        [self.last, self.before].into_iter().flatten().find(|sync| at >= *sync)
    }

    fn send(&mut self, now: Instant, sent: bool) {
        self.attempted = true;
        self.sent = sent;
        if sent {
            self.before = self.last.replace(now);
        }
    }
}

impl<P: Port> Cia402Group<P> {
    /// A group that has sent nothing yet. States and commands come in the order of `axes`.
    pub fn new(port: P, config: GroupConfig, axes: &[AxisConfig]) -> Result<Self, ConfigError> {
        config.check(axes)?;
        let mut index = [None; 128];
        let mut nodes = Vec::with_capacity(axes.len());
        for (i, axis) in axes.iter().enumerate() {
            index[usize::from(axis.node.raw())] = Some(i as u8);
            let bring_up = NodeBringUp::new(&config, axis)?;
            let sdo = bring_up.client();
            let axis = CanAxis::new(&config, axis);
            nodes.push(Node { bring_up, axis, sdo, service: None, setpoint: None, fault: None });
        }
        let nothing = Received { frame: Sync::default().encode(), at: Instant::ZERO };
        Ok(Self {
            port,
            config,
            // A cycle brings an answer, a heartbeat, an EMCY and an SDO frame of each node at most.
            received: vec![nothing; 16 + 8 * nodes.len()],
            batch: Vec::with_capacity(nodes.len().max(SDO_FRAMES_PER_CALL) + BESIDE_SETPOINTS),
            nodes,
            index,
            stage: Stage::Down,
            service: None,
            turn: 0,
            syncs: Syncs::default(),
            heartbeat: OwnHeartbeat::due_at(Instant::ZERO),
            counters: GroupCounters::default(),
            warnings: Warnings::with_room(),
            up_since: Instant::ZERO,
        })
    }

    fn node(&mut self, node: NodeId) -> Option<&mut Node> {
        let index = self.index[usize::from(node.raw())]?;
        self.nodes.get_mut(usize::from(index))
    }

    /// The sign of another controller in `frame`, if any.
    fn sign(&self, frame: &Frame) -> Option<Sign> {
        let is_ours = |node: NodeId| self.index[usize::from(node.raw())].is_some();
        Sign::of(frame, self.config.host_node, is_ours)
    }

    /// Takes one frame during operation. `None` means an undecodable or unexpected frame.
    fn take(&mut self, Received { frame, at }: Received, now: Instant) -> Option<()> {
        if let Some(sign) = self.sign(&frame) {
            self.latch_all(Fault::OtherController { sign });
            return Some(());
        }
        match cob::Function::of(frame.standard_data_id()?)? {
            cob::Function::Tpdo(PdoNumber::One, node) => {
                let answer = Answer::decode(frame.data())?;
                let sampled = self.syncs.of_answer(at)?;
                let fresh = Some(sampled) == self.syncs.last;
                let axis = &mut self.node(node)?.axis;
                if fresh {
                    axis.in_time();
                }
                axis.answered(answer, sampled, at);
                if fresh {
                    let bus_time = &mut self.counters.last_bus_time;
                    *bus_time = at.since(sampled).max(*bus_time);
                }
            }
            cob::Function::Heartbeat(node) => {
                let state = Heartbeat::decode(&frame)?.state;
                self.node(node)?.axis.heard(state, at);
            }
            cob::Function::Emcy(node) => {
                let emergency = Emergency::decode(&frame)?;
                let axis = &mut self.node(node)?.axis;
                axis.emergency(&emergency);
                // The EMCY that explains a fault may arrive before the statusword that shows the fault.
                if !emergency.is_reset() && axis.fault() != Some(axis.drive_fault(emergency.code)) {
                    self.warnings.add(Warning {
                        after: at.since(self.up_since),
                        node: node.raw(),
                        code: emergency.code,
                        register: emergency.error_register.0,
                        count: 1,
                    });
                }
            }
            cob::Function::Tpdo(PdoNumber::Two, node) => {
                let mode = process_data::mode_shown(frame.data())?;
                self.node(node)?.axis.shows(mode);
            }
            cob::Function::SdoResponse(node) => {
                let node = self.node(node)?;
                node.sdo.handle(&frame, now);
                // The result must be known before the next frames are taken.
                node.finish_service(now);
            }
            cob::Function::Nmt
            | cob::Function::Sync
            | cob::Function::Time
            | cob::Function::Tpdo(..)
            | cob::Function::Rpdo(..)
            | cob::Function::SdoRequest(_) => return None,
        }
        Some(())
    }

    fn latch_all(&mut self, fault: Fault) {
        self.nodes.iter_mut().for_each(|node| node.axis.latch(fault));
    }

    /// The next service frame; the nodes take turns.
    fn next_sdo_frame(&mut self, now: Instant) -> Option<Frame> {
        for _ in 0..self.nodes.len() {
            self.turn = (self.turn + 1) % self.nodes.len();
            if let Some(frame) = self.nodes[self.turn].sdo.poll_transmit(now) {
                return Some(frame);
            }
        }
        None
    }

    fn order(&mut self, command: nmt::Command) {
        let nodes = self.nodes.iter().map(|node| command.to(node.axis.node()).encode());
        self.batch.extend(nodes);
    }

    /// Ends the listening and discards all earlier requests to the nodes.
    fn begin(&mut self, now: Instant) {
        self.stage = Stage::Configuring;
        self.batch.clear();
        self.service = None;
        for node in &mut self.nodes {
            node.bring_up.reset(now);
            node.sdo = node.bring_up.client();
            node.service = None;
        }
        self.order(nmt::Command::ResetCommunication);
    }

    fn advance_bring_up(&mut self, now: Instant) -> Result<bool, BringUpError> {
        if matches!(self.stage, Stage::Down | Stage::Up) {
            let until = now + self.config.listening();
            self.stage = Stage::Listening { until };
        }
        let count = self.port.receive(now, &mut self.received)?;
        let mut heard = self.received[..count].iter();
        if let Some(sign) = heard.find_map(|received| self.sign(&received.frame)) {
            return Err(BringUpError::OtherController { sign });
        }
        if let Stage::Listening { until } = self.stage {
            if now < until {
                return Ok(false);
            }
            self.begin(now);
        }
        for i in 0..count {
            let frame = self.received[i].frame;
            if let Some(heartbeat) = Heartbeat::decode(&frame)
                && let Some(Node { bring_up, sdo, .. }) = self.node(heartbeat.node)
            {
                bring_up.heard(heartbeat.state, sdo, now);
            }
            let function = frame.standard_data_id().and_then(cob::Function::of);
            if let Some(cob::Function::SdoResponse(node)) = function
                && let Some(node) = self.node(node)
            {
                node.sdo.handle(&frame, now);
            }
            if let Some(cob::Function::Tpdo(PdoNumber::Two, node)) = function
                && let Some(mode) = process_data::mode_shown(frame.data())
                && let Some(node) = self.node(node)
            {
                node.bring_up.shows(mode);
            }
        }
        for node in &mut self.nodes {
            node.bring_up.advance(&mut node.sdo, now)?;
        }
        if self.stage == Stage::Configuring && self.nodes.iter().all(|node| node.bring_up.configured()) {
            self.stage = Stage::Starting;
            self.nodes.iter_mut().for_each(|node| node.bring_up.start(now));
            self.order(nmt::Command::Start);
        }
        if self.batch.is_empty() {
            while self.batch.len() < SDO_FRAMES_PER_CALL
                && let Some(frame) = self.next_sdo_frame(now)
            {
                self.batch.push(frame);
            }
        }
        if !self.batch.is_empty() {
            let taken = self.port.send(now, &self.batch)?;
            self.batch.drain(..taken.min(self.batch.len()));
        }
        Ok(self.stage == Stage::Starting && self.nodes.iter().all(|node| node.bring_up.operational()))
    }
}

impl<P: Port> DriveGroup for Cia402Group<P> {
    fn axes(&self) -> usize {
        self.nodes.len()
    }

    /// A drive latches a set-point at the SYNC after the one it was sent with. In CSP, the drive interpolates to the
    /// set-point over one period (0x60C2). In CSV and CST, the next sample shows the effect of one period.
    fn delay(&self) -> usize {
        3
    }

    /// A call after completion or an error restarts bring-up, with [`GroupConfig::listening`] and a reset of the
    /// drives' communication. The error of the first failing axis is returned.
    fn bring_up(&mut self, now: Instant) -> Poll<Result<(), BringUpError>> {
        match self.advance_bring_up(now) {
            Ok(false) => Poll::Pending,
            Ok(true) => {
                self.stage = Stage::Up;
                self.batch.clear();
                // Operation starts from the same state, whatever the timing of bring-up.
                self.turn = 0;
                self.syncs = Syncs::default();
                self.heartbeat = OwnHeartbeat::due_at(now);
                self.up_since = now;
                self.warnings.clear();
                for node in &mut self.nodes {
                    node.axis.begin(now, node.bring_up.learnt);
                    node.fault = None;
                }
                Poll::Ready(Ok(()))
            }
            Err(error) => {
                self.stage = Stage::Down;
                self.batch.clear();
                Poll::Ready(Err(error))
            }
        }
    }

    fn read(&mut self, now: Instant, states: &mut [AxisState]) {
        self.counters.last_bus_time = Duration::ZERO;
        match self.port.receive(now, &mut self.received) {
            Ok(count) => {
                for i in 0..count {
                    if self.take(self.received[i], now).is_none() {
                        self.counters.unexpected += 1;
                    }
                }
            }
            Err(error) => self.latch_all(Fault::Port(error)),
        }
        // Checked first, because silence is a consequence of bus-off.
        if self.port.state() == ControllerState::BusOff {
            self.latch_all(Fault::BusOff);
        }
        let alone = self.syncs.last.map(|last| now.since(last));
        let lost_after = self.config.heartbeat_lost_after();
        let alone = alone.filter(|waited| *waited > lost_after);
        let unheard = self.heartbeat.missing(now, lost_after);
        for (node, state) in self.nodes.iter_mut().zip(states) {
            if let Some(waited) = alone {
                node.axis.left_alone(waited);
            }
            if let Some(waited) = unheard {
                node.axis.latch(Fault::HeartbeatNotSent { waited });
            }
            node.finish_service(now);
            let before = node.fault;
            let (read, missing) = node.axis.end_of_read(now, self.syncs.attempted);
            *state = read;
            node.fault = read.fault;
            if let Some(Fault::Drive { node, code }) = read.fault.filter(|_| read.fault != before) {
                self.warnings.explain(node, code);
            }
            self.counters.missed_answers += u64::from(missing && self.syncs.sent);
        }
        self.syncs.attempted = false;
    }

    fn write(&mut self, now: Instant, commands: &[AxisCommand]) {
        let mut refused = false;
        for (node, &command) in self.nodes.iter_mut().zip(commands) {
            node.setpoint = match node.axis.check(command) {
                Ok(setpoint) => setpoint,
                Err(refusal) => {
                    refused = true;
                    node.axis.refuse(refusal);
                    None
                }
            };
        }
        self.batch.clear();
        self.batch.push(Sync::default().encode());
        let watched = self.heartbeat.watched;
        for (node, &command) in self.nodes.iter_mut().zip(commands) {
            let frame = node.axis.command(command, node.setpoint, refused, watched, now);
            self.batch.push(frame);
            node.start_service(now);
        }
    }

    /// The host's heartbeat, when due, and at most one service frame follow the set-points. Only the service frame is
    /// sent again if the port does not take it.
    fn send(&mut self, now: Instant) -> bool {
        if self.batch.is_empty() {
            self.batch.push(Sync::default().encode());
        }
        let setpoints = self.batch.len() - 1;
        let heartbeat = self.heartbeat.is_due(now);
        if heartbeat {
            let (node, state) = (self.config.host_node, nmt::NmtState::Operational);
            self.batch.push(Heartbeat { node, state }.encode());
        }
        if self.service.is_none() {
            self.service = self.next_sdo_frame(now);
        }
        self.batch.extend(self.service);
        let taken = match self.port.send(now, &self.batch) {
            Ok(taken) => taken,
            Err(error) => {
                self.latch_all(Fault::Port(error));
                0
            }
        };
        self.syncs.send(now, taken > 0);
        for (i, node) in self.nodes.iter_mut().enumerate() {
            // A SYNC alone carries no set-point that could be lost.
            node.axis.handed_over(taken > setpoints.min(i + 1));
        }
        self.counters.dropped_syncs += u64::from(taken == 0);
        self.counters.dropped_setpoints += setpoints.saturating_sub(taken.saturating_sub(1)) as u64;
        if heartbeat {
            let period = self.config.heartbeat_period;
            self.heartbeat.offered(now, taken > setpoints + 1, period);
        }
        if taken == self.batch.len() {
            self.service = None;
        }
        self.batch.clear();
        taken > setpoints
    }

    fn counters(&self) -> GroupCounters {
        GroupCounters { port: self.port.counters(), ..self.counters }
    }

    fn warnings(&self) -> &Warnings {
        &self.warnings
    }
}

impl Node {
    fn start_service(&mut self, now: Instant) {
        if self.service.is_some() {
            return;
        }
        let Some(service) = self.axis.next_service() else {
            return;
        };
        bring_up::begin(&mut self.sdo, service.object(), service.write(), now);
        self.service = Some(service);
    }

    fn finish_service(&mut self, now: Instant) {
        self.sdo.handle_timeout(now);
        let Some(result) = self.sdo.poll() else {
            return;
        };
        let Some(service) = self.service.take() else {
            return;
        };
        let value = result.map(|transfer| canopen::number(transfer.data)).map_err(|error| error.cause.abort_code().0);
        self.axis.served(service, value);
    }
}
