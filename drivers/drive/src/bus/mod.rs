//! The owner of a CAN bus: one port, one bring-up and one batch per cycle for all nodes of the bus. The nodes are
//! drives, I/O nodes and force/torque sensors.
//!
//! [`CanBus`] reads the received frames once per cycle and routes each frame by its identifier to a
//! [drive](crate::cia402), an [I/O node](crate::cia401) or a [force/torque sensor](crate::wrench). The batch of a cycle
//! is one system call. Its frames leave in this order:
//!
//! | frame | when |
//! |---|---|
//! | SYNC | every cycle, if a PDO of the bus is synchronous, except before the first stops after refused or unanswered batches, and once after missing answers to prove the age of the answers (`answer_age`) |
//! | RPDO 1 of each drive | every cycle; not after two SYNCs that no drive answered (`in_flight`) |
//! | heartbeat of the host | once per heartbeat period, and with each NMT command of the recovery of a drive |
//! | RPDO 1 of an I/O node | after the first heartbeat of the host: changed or refused levels, and with each heartbeat |
//! | SDO request, or NMT command to one node | one at most, during a change of mode or after a fault |
//!
//! Bring-up listens for another controller, resets the communication of all nodes, configures and reads back every node
//! by SDO, and starts all nodes together. Bring-up ends when every node shows the state operational, every I/O node
//! with inputs has sent its inputs, and every sensor has sent samples at its declared rate. If a sensor needs SYNC,
//! bring-up sends SYNC. Last, a SYNC that stands alone gives the latency of the answer of every drive.
//!
//! Read [`DriveGroup`] first, then [`CanBus::with_io`].

mod answer_age;
mod bring_up;
mod in_flight;
mod other_controller;
mod own_heartbeat;
mod routes;
mod sensors;
mod service;
mod start;
mod step;
mod syncs;
pub mod times;
mod traffic;

use std::task::Poll;
use std::time::Duration;

use can::{ControllerState, Frame, Instant, Port, Received};
use canopen::cia402::FaultTable;
use canopen::emcy::Emergency;
use canopen::heartbeat::Heartbeat;
use canopen::pdo::PdoNumber;
use canopen::sync::Sync;
use canopen::{cob, nmt};
use master::sdo::Client;

pub(crate) use bring_up::{Learnt, NodeBringUp, begin_transfer};
pub use other_controller::Sign;
pub(crate) use step::{Need, Step};
pub(crate) use syncs::{Syncs, needs_sync};
pub use traffic::{Traffic, traffic};

use crate::cia401::{self, IoConfig, IoFault, IoLink, IoNode};
use crate::cia402::{self, AxisConfig, Cia402Group, ConfigError, GroupConfig};
use crate::wrench::{self, WrenchLink, WrenchNode, WrenchNodeConfig};
use crate::{
    AxisCommand, AxisState, BringUpError, DriveGroup, EmergencyStop, Fault, GroupCounters, Warning, WarningCause,
    Warnings,
};
use answer_age::LoneSyncs;
use bring_up::Profile;
use in_flight::InFlight;
use own_heartbeat::OwnHeartbeat;
use routes::{Place, Routes};
use service::ServiceFrame;

/// Greatest number of SDO frames sent by one call of bring-up. A transmit queue of ten has room for them.
const SDO_FRAMES_PER_CALL: usize = 8;

/// Duration of the shortest frame at the highest bit rate: 47 bits at 1 Mbit/s.
const SHORTEST_FRAME: Duration = Duration::from_micros(47);

/// Frames of a cycle in addition to one set-point for each axis and one command for each I/O node: SYNC, the host's
/// heartbeat and a service request. A port must take all frames of a cycle at once, or set-points are dropped.
pub const BESIDE_SETPOINTS: usize = 3;

/// The owner of a CAN bus. As a [`DriveGroup`], the bus has the axes of its drives.
pub struct CanBus<P: Port> {
    port: P,
    config: GroupConfig,
    /// All nodes: the drives, the I/O nodes, then the sensors.
    members: Vec<Member>,
    routes: Routes,
    drives: Cia402Group,
    io: Vec<IoNode>,
    sensors: Vec<WrenchNode>,
    stage: Stage,
    received: Vec<Received>,
    /// During bring-up: frames that the port has not taken yet. In a cycle: SYNC, if it is needed, and the set-points.
    batch: Vec<Frame>,
    /// A service frame that the port has not taken yet.
    service: Option<ServiceFrame>,
    /// Index of the member whose SDO client sent last.
    turn: usize,
    /// Whether the nodes need SYNC.
    needs_sync: bool,
    /// SYNCs in the batch: none or one.
    batch_syncs: usize,
    in_flight: InFlight,
    syncs: Syncs,
    lone: LoneSyncs,
    /// The SYNC of this cycle is left out, to prove the age of the answers.
    leaves_out: bool,
    /// When a SYNC was left out last.
    proved_at: Option<Instant>,
    heartbeat: OwnHeartbeat,
    counters: GroupCounters,
    warnings: Warnings,
    /// End of bring-up.
    up_since: Instant,
    /// Number of the cycle, from 0 at the end of bring-up.
    cycle: u64,
}

/// A node of the bus: its bring-up, and the SDO client of bring-up and operation.
pub(crate) struct Member {
    pub(crate) bring_up: NodeBringUp,
    pub(crate) sdo: Client,
}

impl Member {
    fn new(bring_up: NodeBringUp) -> Self {
        Self { sdo: bring_up.client(), bring_up }
    }
}

/// Stage of the bus. Nothing is sent in `Listening`. Frames of another controller are detected in every stage of bring-up
/// and in operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Down,
    Listening { until: Instant },
    Configuring,
    Starting { since: Instant },
    Up,
}

impl<P: Port> CanBus<P> {
    /// A bus with drives alone. Nothing has been sent yet. States and commands come in the order of `axes`.
    pub fn new(port: P, config: GroupConfig, axes: &[AxisConfig]) -> Result<Self, ConfigError> {
        Self::with_io(port, config, axes, &[]).map(|(bus, _)| bus)
    }

    /// A bus with drives and I/O nodes. The links come in the order of `io` and may be read and written by any thread.
    ///
    /// Refuses a node-ID that occurs twice, and quantities that a node cannot hold.
    pub fn with_io(
        port: P,
        config: GroupConfig,
        axes: &[AxisConfig],
        io: &[IoConfig],
    ) -> Result<(Self, Vec<IoLink>), ConfigError> {
        config.check(axes)?;
        cia401::check(&config, axes, io)?;
        Self::assemble(port, config, axes, io, [].into_iter()).map(|(bus, io, _)| (bus, io))
    }

    /// A bus with drives, I/O nodes and force/torque sensors. Each of the three lists may be empty. The links are in
    /// the order of `io` and of `sensors`, and any thread may use them.
    ///
    /// Refuses what [`with_io`](Self::with_io) refuses, and sensors that [`wrench::check`] refuses.
    pub fn with_sensors(
        port: P,
        config: GroupConfig,
        axes: &[AxisConfig],
        io: &[IoConfig],
        sensors: &[WrenchNodeConfig],
    ) -> Result<(Self, Vec<IoLink>, Vec<WrenchLink>), wrench::ConfigError> {
        config.check(axes)?;
        if sensors.is_empty() || !(axes.is_empty() && io.is_empty()) {
            cia401::check(&config, axes, io)?;
        }
        wrench::check(&config, axes, io, sensors)?;
        let programs: Result<Vec<_>, _> = sensors.iter().map(|sensor| wrench::program(&config, sensor)).collect();
        Ok(Self::assemble(port, config, axes, io, sensors.iter().zip(programs?))?)
    }

    /// A bus of checked nodes. Each sensor comes with its steps of bring-up.
    fn assemble<'a>(
        port: P,
        config: GroupConfig,
        axes: &[AxisConfig],
        io: &[IoConfig],
        sensors: impl ExactSizeIterator<Item = (&'a WrenchNodeConfig, Vec<Step>)>,
    ) -> Result<(Self, Vec<IoLink>, Vec<WrenchLink>), ConfigError> {
        let mut members = Vec::with_capacity(axes.len() + io.len() + sensors.len());
        for axis in axes {
            let program = cia402::program(&config, axis)?;
            let configuration = axis.configuration.clone();
            let bring_up = NodeBringUp::new(&config, axis.node, Profile::Drive, program, configuration);
            members.push(Member::new(bring_up));
        }
        for node in io {
            let program = cia401::program(&config, node)?;
            let configuration = node.configuration.clone();
            members.push(Member::new(NodeBringUp::new(&config, node.node, Profile::Io, program, configuration)));
        }
        let mut inputs: usize = io.iter().map(|node| node.frames_per(config.period)).sum();
        let (mut sensor_nodes, mut sensor_links) = (Vec::new(), Vec::new());
        let mut sensor_ids = Vec::new();
        for (sensor, program) in sensors {
            let profile = Profile::Wrench(sensor.device_type);
            let configuration = sensor.configuration.clone();
            members.push(Member::new(NodeBringUp::new(&config, sensor.node, profile, program, configuration)));
            inputs += sensor.frames_per(config.period);
            let (node, link) = WrenchNode::new(&config, sensor);
            sensor_ids.push(sensor.node);
            sensor_nodes.push(node);
            sensor_links.push(link);
        }
        let (nodes, links): (Vec<_>, Vec<_>) = io.iter().map(|node| IoNode::new(&config, node)).unzip();
        let needs_sync = needs_sync(axes, io) || sensor_nodes.iter().any(WrenchNode::needs_sync);
        let nothing = Received { frame: Sync::default().encode(), at: Instant::ZERO };
        let bus = Self {
            port,
            config,
            // In a cycle each node sends at most an answer, a heartbeat, an EMCY and an SDO frame, and its inputs or
            // samples.
            received: vec![nothing; 16 + 8 * members.len() + inputs],
            batch: Vec::with_capacity(members.len().max(SDO_FRAMES_PER_CALL) + BESIDE_SETPOINTS),
            routes: Routes::new(axes.iter().map(|axis| axis.node), io.iter().map(|node| node.node), sensor_ids),
            drives: Cia402Group::new(&config, axes),
            io: nodes,
            sensors: sensor_nodes,
            members,
            stage: Stage::Down,
            service: None,
            turn: 0,
            needs_sync,
            batch_syncs: 0,
            in_flight: InFlight::default(),
            syncs: Syncs::default(),
            lone: LoneSyncs::of(axes.len()),
            leaves_out: false,
            proved_at: None,
            heartbeat: OwnHeartbeat::due_at(Instant::ZERO),
            counters: GroupCounters::default(),
            warnings: Warnings::with_room(),
            up_since: Instant::ZERO,
            cycle: 0,
        };
        Ok((bus, links, sensor_links))
    }

    /// The sign of another controller in `frame`, if any.
    fn sign(&self, frame: &Frame) -> Option<Sign> {
        Sign::of(frame, self.config.host_node, |node| self.routes.place(node).is_some())
    }

    /// Takes the warnings that bring-up found in the drives.
    fn warn_of_bring_up(&mut self) {
        for member in &self.members {
            let node = member.bring_up.node().raw();
            for cause in member.bring_up.learnt.warnings() {
                self.warnings.add(Warning { after: Duration::ZERO, node, cause, count: 1 });
            }
        }
    }

    /// Greatest number of readings in a cycle. The readings suffice for the shortest frames of a full bus in a period,
    /// and for the frames of a late cycle.
    fn readings(&self) -> usize {
        let frames = self.config.period.as_micros() / SHORTEST_FRAME.as_micros();
        2 + usize::try_from(frames).unwrap_or_default() / self.received.len()
    }

    /// Takes one frame during operation. `None` means an undecodable or unexpected frame.
    fn take(&mut self, received: Received, now: Instant) -> Option<()> {
        let Received { frame, at } = received;
        if let Some(taken) = self.take_sample(&received) {
            return taken;
        }
        if let Some(sign) = self.sign(&frame) {
            self.latch_all(Fault::OtherController { sign }, IoFault::OtherController { sign });
            return Some(());
        }
        match cob::Function::of(frame.standard_data_id()?)? {
            cob::Function::Tpdo(number, node) => match (self.routes.place(node)?, number) {
                (Place::Drive(drive), PdoNumber::One) => {
                    let bus_time = self.drives.answered(drive, frame.data(), at, &self.syncs)?;
                    self.counters.last_bus_time = bus_time.max(self.counters.last_bus_time);
                }
                (Place::Drive(drive), PdoNumber::Two) => {
                    self.drives.shows(drive, frame.data(), &mut self.members[drive])?;
                }
                (Place::Drive(drive), PdoNumber::Three) => self.drives.inputs(drive, frame.data())?,
                (Place::Io(io), PdoNumber::One) => self.io[io].inputs(frame.data(), at)?,
                (Place::Drive(_), PdoNumber::Four)
                | (Place::Io(_), PdoNumber::Two | PdoNumber::Three | PdoNumber::Four)
                | (Place::Sensor(_), _) => return None,
            },
            cob::Function::Heartbeat(node) => {
                let state = Heartbeat::decode(&frame)?.state;
                match self.routes.place(node)? {
                    Place::Drive(drive) => self.drives.heard(drive, state, at, &mut self.members[drive], now),
                    Place::Io(io) => {
                        self.io[io].heard(state, at);
                        if self.io[io].recovers() {
                            let Member { bring_up, sdo } = &mut self.members[self.drives.axes() + io];
                            bring_up.heard(state, sdo, now);
                        }
                    }
                    Place::Sensor(sensor) => self.sensors[sensor].heard(state, at),
                }
            }
            cob::Function::Emcy(node) => {
                let emergency = Emergency::decode(&frame)?;
                let (warns, table) = match self.routes.place(node)? {
                    Place::Drive(drive) => (self.drives.emergency(drive, &emergency), FaultTable::Epos4),
                    Place::Io(io) => {
                        self.io[io].emergency(&emergency, at);
                        (!emergency.is_reset(), FaultTable::Cia401)
                    }
                    Place::Sensor(_) => (!emergency.is_reset(), FaultTable::Cia401),
                };
                if warns {
                    self.warnings.add(Warning {
                        after: at.since(self.up_since),
                        node: node.raw(),
                        cause: WarningCause::Emergency {
                            code: emergency.code,
                            table,
                            register: emergency.error_register.0,
                        },
                        count: 1,
                    });
                }
            }
            cob::Function::SdoResponse(node) => {
                let sdo = &mut self.members[self.routes.member(node)?].sdo;
                sdo.handle(&frame, now);
                // The result must be known before the next frames are taken.
                if let Some(Place::Drive(drive)) = self.routes.place(node) {
                    self.drives.finish_service(drive, sdo, now);
                }
            }
            cob::Function::Nmt
            | cob::Function::Sync
            | cob::Function::Time
            | cob::Function::Rpdo(..)
            | cob::Function::SdoRequest(_) => return None,
        }
        Some(())
    }
}

impl<P: Port> DriveGroup for CanBus<P> {
    fn axes(&self) -> usize {
        self.drives.axes()
    }

    /// A drive latches a set-point at the SYNC after the one it was sent with. In CSP, the drive interpolates to the
    /// set-point over one period (0x60C2). In CSV and CST, the next sample shows the effect of one period.
    fn delay(&self) -> usize {
        cia402::DELAY
    }

    /// A call after completion or an error restarts bring-up, with [`GroupConfig::listening`] and a reset of the
    /// nodes' communication. The error of the first failing node is returned.
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
                self.cycle = 0;
                self.warnings.clear();
                self.warn_of_bring_up();
                self.proved_at = None;
                let lags = self.measured_lags();
                self.drives.begin(now, &self.members, lags.into_iter());
                self.io.iter_mut().for_each(|io| io.begin(now));
                self.sensors.iter_mut().for_each(|sensor| sensor.begin(now));
                Poll::Ready(Ok(()))
            }
            Err(error) => {
                self.stage = Stage::Down;
                self.batch.clear();
                Poll::Ready(Err(error))
            }
        }
    }

    /// The cycle with all drives off: heartbeats are read as they come, and no drive finds the host silent.
    fn wait(&mut self, now: Instant) {
        self.read(now, &mut vec![AxisState::default(); self.axes()]);
        self.write(now, &vec![AxisCommand::Off; self.axes()]);
        self.send(now);
    }

    fn read(&mut self, now: Instant, states: &mut [AxisState]) {
        self.counters.last_bus_time = Duration::ZERO;
        self.sensors.iter_mut().for_each(WrenchNode::begin_of_read);
        // Foreign frames may fill the buffer several times. Another reading follows only if the buffer was full.
        for _ in 0..self.readings() {
            match self.port.receive(now, &mut self.received) {
                Ok(count) => {
                    for i in 0..count {
                        if self.take(self.received[i], now).is_none() {
                            self.counters.unexpected += 1;
                        }
                    }
                    if count < self.received.len() {
                        break;
                    }
                }
                Err(error) => {
                    self.latch_all(Fault::Port(error), IoFault::Port(error));
                    break;
                }
            }
        }
        // Checked first, because silence is a consequence of bus-off.
        if self.port.state() == ControllerState::BusOff {
            self.latch_all(Fault::BusOff, IoFault::BusOff);
        }
        self.check_acknowledgement();
        let lost_after = self.config.heartbeat_lost_after();
        let alone = self.syncs.last.map(|last| now.since(last));
        if let Some(waited) = alone.filter(|waited| *waited > lost_after) {
            self.drives.left_alone(waited);
        }
        if let Some(waited) = self.heartbeat.missing(now, lost_after) {
            self.latch_all(Fault::HeartbeatNotSent { waited }, IoFault::HeartbeatNotSent { waited });
        }
        if let Some((drive, command)) = self.drives.recover(&mut self.members, now, self.service.is_none()) {
            self.command_node(drive, command);
            // A drive that starts must have heard the host, or it would not notice the host's silence.
            self.heartbeat.hasten(now);
        }
        let due = self.syncs.attempted;
        let warnings = (&mut self.warnings, now.since(self.up_since));
        let missed = self.drives.end_of_read(now, due, &mut self.members, warnings, states);
        if self.syncs.sent {
            self.counters.missed_answers += missed;
        }
        if due {
            self.note_answers(missed, now);
        }
        let synced = self.syncs.attempted && self.syncs.sent;
        self.sensors.iter_mut().for_each(|sensor| sensor.end_of_read(now, self.cycle, synced));
        self.syncs.attempted = false;
        for io in 0..self.io.len() {
            let member = self.drives.axes() + io;
            let command = self.io[io].recover(&mut self.members[member], now, self.service.is_none());
            if let Some(command) = command {
                self.command_node(member, command);
            }
            self.io[io].end_of_read(now, self.cycle);
        }
    }

    fn write(&mut self, now: Instant, commands: &[AxisCommand]) {
        self.consider_proof(now, commands);
        self.begin_batch();
        let conditions = self.conditions(now);
        let withheld = self.drives.write(now, commands, conditions, &mut self.members, &mut self.batch);
        self.note_setpoints(withheld, self.drives.sent_for_torque());
    }

    /// The host's heartbeat when due, outputs, and at most one service frame follow the set-points. Outputs are sent
    /// when they change and with each heartbeat. Outputs that the port does not take are sent in the next cycle. The
    /// service frame is sent again if the port does not take it.
    fn send(&mut self, now: Instant) -> bool {
        if self.batch.is_empty() && !self.leaves_out {
            self.begin_batch();
        }
        let syncs = self.batch_syncs;
        let setpoints = self.batch.len() - syncs;
        let heartbeat = self.heartbeat.is_due(now);
        if heartbeat {
            let (node, state) = (self.config.host_node, nmt::NmtState::Operational);
            self.batch.push(Heartbeat { node, state }.encode());
        }
        let before_outputs = self.batch.len();
        // A node that has not heard the host does not notice its silence.
        if self.heartbeat.watched {
            self.batch.extend(self.io.iter_mut().filter_map(|io| io.command(heartbeat)));
        }
        self.take_service(now);
        self.batch.extend(self.service.map(|service| service.frame));
        // On a bus without SYNC, the batch is empty in most cycles.
        let sent = if self.batch.is_empty() { Ok(0) } else { self.port.send(now, &self.batch) };
        let taken = sent.unwrap_or_else(|error| {
            self.latch_all(Fault::Port(error), IoFault::Port(error));
            0
        });
        if syncs > 0 {
            self.syncs.send(now, taken > 0);
            self.counters.dropped_syncs += u64::from(taken == 0);
        } else {
            self.syncs.begin_period(now, false);
        }
        self.begin_period(now, syncs > 0 && taken > 0);
        self.count_refused(taken);
        self.drives.handed_over(taken, syncs, setpoints);
        let mut outputs = taken.saturating_sub(before_outputs);
        for io in &mut self.io {
            io.handed_over(&mut outputs, now, self.cycle);
        }
        let withheld = self.withheld();
        self.counters.dropped_setpoints += (setpoints.saturating_sub(taken.saturating_sub(syncs)) + withheld) as u64;
        if heartbeat {
            let period = self.config.heartbeat_period;
            self.heartbeat.offered(now, taken >= before_outputs, period);
        }
        if taken == self.batch.len() {
            self.service = None;
        }
        self.batch.clear();
        self.cycle += 1;
        taken >= syncs + setpoints && withheld == 0
    }

    fn emergency_stop(&self) -> Option<EmergencyStop> {
        let contacts = self.drives.emergency_stops().chain(self.io.iter().filter_map(IoNode::emergency_stop));
        contacts.min_by_key(|contact| !contact.known)
    }

    fn doubt_reference(&mut self, axis: usize) {
        self.drives.doubt_reference(axis);
    }

    fn counters(&self) -> GroupCounters {
        GroupCounters { port: self.port.counters(), state: self.port.state(), ..self.counters }
    }

    fn warnings(&self) -> &Warnings {
        &self.warnings
    }
}
