//! Drives of CiA 402 on one CAN bus in the cyclic synchronous modes, as the EPOS4 does them.
//!
//! [`Cia402Group`] brings its drives up, exchanges one RPDO and one TPDO with each per SYNC, leads
//! them through the power states and through homing, and watches them: answers, heartbeats, EMCY,
//! statuswords. What a drive does when it loses *us* is set and read back at bring-up: three host
//! heartbeats missing, and it brakes by its quick stop and holds.
//!
//! A drive watches our heartbeat from the first one on, so that none gets torque before the port took a heartbeat. A
//! heartbeat that the port does not take for three periods is a fault of every axis.
//!
//! TPDO 2 brings the mode of operation when it changes: a change that the group did not command is a fault. A drive
//! sends nothing on TPDO 2 as a rule, so that the watch costs no bus load.
//!
//! Before its first frame the group listens ([`GroupConfig::listening`]). A frame that only a controller sends, from
//! another, refuses the start; in operation such a frame is a fault of every axis ([`Sign`]).
//!
//! # What each command means
//! - [`Off`](AxisCommand::Off) takes the voltage away, also from a moving axis; who wants it
//!   braked brakes it before.
//! - [`Stand`](AxisCommand::Stand) holds the position (CSP) of the answer that first showed torque, or the
//!   last set-point followed. In CSV and CST it means velocity and torque zero, which is no
//!   standing where a load pulls: follow at once.
//! - [`Follow`](AxisCommand::Follow) before [`Power::On`] was seen, of another kind than the mode's, or
//!   beyond the drive's units is refused: [`Fault::Refused`] names the axis, and no axis of the
//!   group changes its target in that cycle. While [`AxisState::following`] is false for a change of
//!   mode, the set-point is passed over and the drive stands.
//! - [`Home`](AxisCommand::Home) changes to mode HM by service requests, at most one frame a cycle for the
//!   whole group, searches, and on leaving comes back to the cyclic mode with the target where the axis
//!   stands. An unfinished search is halted first.
//! - An axis with a latched fault is braked by its quick stop, and stays there under any command
//!   but `Off` and `ResetFault`.
//!
//! No set-point is clamped, queued or sent twice.
//!
//! # Who writes an object
//! [`AxisConfig::configuration`] is written first, then [`AxisConfig::parameters`]. Neither may hold an object that is
//! [`reserved`]: those belong to this driver, which writes and reads back its own part of them last, before operation:
//! heartbeats (0x1016:01, 0x1017), reactions (0x1029:01, 0x6007, 0x605A to 0x605E), braking (0x6084 to 0x6086, and 0x60C5
//! and 0x60C6 where they are smaller than the ramps), the interpolation period (0x60C2), the following error (0x6065,
//! 0x6066), the position range (0x607B), polarity (0x607E), event timers (0x1400:05, 0x1801:05), homing (0x6098, 0x6099, 0x609A, 0x607C and maxon's 0x30B0, 0x30B1), offsets (0x60B0 to
//! 0x60B2), process data and the mode of operation (0x6060). Of the PDOs, RPDO 1, TPDO 1 and TPDO 2 are mapped and the
//! others switched off.
//!
//! Left out: profile modes, interpolated position (EPOS2), several axes behind one node-ID. Read
//! [`DriveGroup`] first, then `axis`, `bring_up` and `program`.

mod agreement;
mod axis;
mod bring_up;
mod config;
mod homing;
mod measurement;
mod mode;
mod other_controller;
mod own_heartbeat;
mod process_data;
mod program;
mod recording;
mod reserved;
mod service;
mod setup;
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
use canopen::sdo::Client;
use canopen::sync::Sync;
use canopen::{cob, nmt};

pub use canopen::NodeId;
pub use config::{
    AxisConfig, ConfigError, CyclicMode, GroupConfig, HomingConfig, Identity, Parameter, Quantity,
    Setting,
};
pub use other_controller::Sign;
pub use process_data::pdo_setups;
pub use recording::Recording;
pub use reserved::{Reserved, reserved};
pub use traffic::Traffic;

#[cfg(doc)]
use crate::Power;
use crate::{
    AxisCommand, AxisState, BringUpError, DriveGroup, Fault, GroupCounters, Warning, Warnings,
};
use axis::Axis;
use bring_up::NodeBringUp;
use own_heartbeat::OwnHeartbeat;
use process_data::Answer;
use service::Service;
use target::{Order, Target};

/// SDO frames that one call of bring-up sends at most: what a transmit queue of ten still takes.
const SDO_FRAMES_PER_CALL: usize = 8;

/// Frames that a cycle sends beside one set-point for each axis: SYNC, our heartbeat and a service request. A
/// port must take them all at once, or set-points are dropped.
pub const BESIDE_SETPOINTS: usize = 3;

/// CiA 402 drives behind one port. The module says what it does with each command.
pub struct Cia402Group<P: Port> {
    port: P,
    config: GroupConfig,
    nodes: Vec<Node>,
    /// Index into `nodes` by node-ID.
    index: [Option<u8>; 128],
    stage: Stage,
    received: Vec<Received>,
    /// Bring-up: frames that the port has still to take. Cycle: SYNC and the set-points.
    batch: Vec<Frame>,
    /// A service frame that the port has still to take.
    service: Option<Frame>,
    /// Whose client may speak first.
    turn: usize,
    syncs: Syncs,
    heartbeat: OwnHeartbeat,
    counters: GroupCounters,
    warnings: Warnings,
    /// When bring-up was ready.
    up_since: Instant,
}

/// One drive: how it is brought up, how it runs, and the client both use.
struct Node {
    bring_up: NodeBringUp,
    axis: Axis,
    sdo: Client,
    service: Option<Service>,
    setpoint: Option<Target>,
    /// That of the last cycle.
    fault: Option<Fault>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Down,
    /// Nothing is sent; another controller would be heard.
    Listening {
        until: Instant,
    },
    Configuring,
    Starting,
    Up,
}

/// The SYNCs sent, as far as answers to them can still come.
#[derive(Clone, Copy, Debug, Default)]
struct Syncs {
    last: Option<Instant>,
    before: Option<Instant>,
    /// The last cycle was to send one.
    attempted: bool,
    /// And the port took it.
    sent: bool,
}

impl Syncs {
    /// The SYNC that an answer received at `at` belongs to: the last one sent before it. `None` for
    /// answers from so long ago that it is not known any more.
    fn of_answer(&self, at: Instant) -> Option<Instant> {
        [self.last, self.before]
            .into_iter()
            .flatten()
            .find(|sync| at >= *sync)
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
    /// A group that has sent nothing yet; states and commands come in the order of `axes`.
    pub fn new(port: P, config: GroupConfig, axes: &[AxisConfig]) -> Result<Self, ConfigError> {
        config.check(axes)?;
        let mut index = [None; 128];
        let mut nodes = Vec::with_capacity(axes.len());
        for (i, axis) in axes.iter().enumerate() {
            index[usize::from(axis.node.raw())] = Some(i as u8);
            let bring_up = NodeBringUp::new(&config, axis)?;
            let sdo = bring_up.client();
            let axis = Axis::new(&config, axis);
            nodes.push(Node {
                bring_up,
                axis,
                sdo,
                service: None,
                setpoint: None,
                fault: None,
            });
        }
        let nothing = Received {
            frame: Sync::default().encode(),
            at: Instant::ZERO,
        };
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

    /// What such a group puts on its bus during operation.
    pub fn traffic(config: &GroupConfig, axes: &[AxisConfig]) -> Vec<Traffic> {
        traffic::of(config, axes)
    }

    fn node(&mut self, node: NodeId) -> Option<&mut Node> {
        let index = self.index[usize::from(node.raw())]?;
        self.nodes.get_mut(usize::from(index))
    }

    /// What `frame` says of another controller.
    fn sign(&self, frame: &Frame) -> Option<Sign> {
        let is_ours = |node: NodeId| self.index[usize::from(node.raw())].is_some();
        Sign::of(frame, self.config.host_node, is_ours)
    }

    /// Takes one frame during operation; `None` if it was not understood or not expected.
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
                // The one that explains a fault may come before the statusword that shows the fault.
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
                // Before the frames behind it.
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
        self.nodes
            .iter_mut()
            .for_each(|node| node.axis.latch(fault));
    }

    /// The next service frame of any node, each having its turn.
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
        let nodes = self
            .nodes
            .iter()
            .map(|node| command.to(node.axis.node()).encode());
        self.batch.extend(nodes);
    }

    /// Ends the listening: whatever the nodes were told before is to be forgotten.
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
        if self.stage == Stage::Configuring
            && self.nodes.iter().all(|node| node.bring_up.configured())
        {
            self.stage = Stage::Starting;
            self.nodes
                .iter_mut()
                .for_each(|node| node.bring_up.start(now));
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
        Ok(self.stage == Stage::Starting
            && self.nodes.iter().all(|node| node.bring_up.operational()))
    }
}

impl<P: Port> DriveGroup for Cia402Group<P> {
    fn axes(&self) -> usize {
        self.nodes.len()
    }

    /// A drive latches a set-point at the SYNC after the one it was sent with. In CSP it interpolates to it over one
    /// period (0x60C2); in CSV and CST a period of acting on it is what the next sample shows.
    fn delay(&self) -> usize {
        3
    }

    /// A call after readiness or an error begins bring-up again, with [`GroupConfig::listening`] and a reset of the
    /// drives' communication.
    /// The error of the first failing axis decides.
    fn bring_up(&mut self, now: Instant) -> Poll<Result<(), BringUpError>> {
        match self.advance_bring_up(now) {
            Ok(false) => Poll::Pending,
            Ok(true) => {
                self.stage = Stage::Up;
                self.batch.clear();
                // Operation owes nothing to how bring-up was timed.
                self.turn = 0;
                self.syncs = Syncs::default();
                self.heartbeat = OwnHeartbeat::due_at(now);
                self.up_since = now;
                self.warnings.clear();
                for node in &mut self.nodes {
                    node.axis.begin(now, node.bring_up.learnt());
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
        // Before what follows from it is judged.
        if self.port.state() == ControllerState::BusOff {
            self.latch_all(Fault::BusOff);
        }
        let Syncs {
            attempted, sent, ..
        } = self.syncs;
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
            let (read, missing) = node.axis.end_of_read(now, attempted);
            *state = read;
            node.fault = read.fault;
            if let Some(Fault::Drive { node, code }) = read.fault.filter(|_| read.fault != before) {
                self.warnings.explain(node, code);
            }
            self.counters.missed_answers += u64::from(missing && sent);
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
        let watched = self.heartbeat.is_watched();
        for (node, &command) in self.nodes.iter_mut().zip(commands) {
            let order = Order {
                command,
                setpoint: node.setpoint,
                hold: refused,
                watched,
            };
            self.batch.push(node.axis.command(order, now));
            node.start_service(now);
        }
    }

    /// Behind the set-points come our heartbeat, when it is due, and at most one service frame, which
    /// alone is offered again if the port does not take it.
    fn send(&mut self, now: Instant) -> bool {
        if self.batch.is_empty() {
            self.batch.push(Sync::default().encode());
        }
        let setpoints = self.batch.len() - 1;
        let heartbeat = self.heartbeat.is_due(now);
        if heartbeat {
            let (node, state) = (self.config.host_node, nmt::State::Operational);
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
            // A SYNC alone has no set-point to lose.
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
        GroupCounters {
            port: self.port.counters(),
            ..self.counters
        }
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
        let value = result
            .map(|transfer| bring_up::number(transfer.data))
            .map_err(|error| bring_up::abort_code(error).1.0);
        self.axis.served(service, value);
    }
}
