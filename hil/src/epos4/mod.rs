//! An EPOS4-class axis controller: CiA 301 and CiA 402 as a maxon EPOS4 speaks them on CAN.
//!
//! [`Epos4`] is a [`Device`] with a [`PlantAxis`] and its physics. The device has LSS, boot-up, NMT, an SDO server,
//! heartbeat producer and consumer, EMCY, and four PDOs each way with strict re-mapping. The drive has power states
//! with their option codes and the modes PP, PV, HM, CSP, CSV and CST. The object dictionary is one table.
//!
//! Facts come from EPOS4's electronic data sheet and communication guide. CiA 301 and CiA 402 fill the gaps of these
//! documents, and the emulator chooses the rest. The comments of its data sheet ([`Epos4::eds`], `mrroc eds`) list
//! the choices. Further choices:
//!
//! * In the cyclic modes, bit 12 of the statusword is set while set-points are followed, as in CiA 402.
//! * When SYNCs are missing, the position stays at the last set-point. Velocity and torque continue.
//! * An error of communication ends when the missing frame is received again.
//! * Within a SYNC, TPDOs are sampled before RPDOs take effect.
//!
//! A bit rate configured by LSS is accepted without effect. Left out: storage to a file.
//!
//! The drive runs at 1 kHz. It is advanced lazily, when a frame or a time-out needs its state. A device whose host
//! sends SYNC therefore needs no computing time between SYNCs.

mod config;
mod drive;
mod eds;
mod errors;
mod heartbeats;
mod homing;
mod lss;
mod objects;
mod pdo;
mod power;
mod profile;
mod service;
mod supervision;
mod table;
#[cfg(test)]
mod tests;

use std::{collections::VecDeque, time::Duration};

use can::{Frame, Instant};
use canopen::pdo::{PdoKind, PdoNumber};
use canopen::{NodeId, cob, heartbeat::Heartbeat, nmt, sdo};

use crate::{Device, PlantAxis};
pub use config::Epos4Config;
use drive::{CHUNK, Drive};
use errors::Errors;
use heartbeats::Consumers;
use lss::Lss;
use objects::Objects;
use pdo::Pdos;
use table::{Slot, slot};

const SUB_STEP: Duration = Duration::from_micros(100);
/// Longest interval between two advances of the drive.
const LAZIEST: Duration = Duration::from_millis(20);
/// Time after which a transfer is abandoned because the client has sent nothing.
const SDO_TIME_OUT: Duration = Duration::from_secs(1);
/// Capacity of a device's transmit queue. Further frames are lost, as in a full controller.
const QUEUE: usize = 32;

/// Values of one unit that replace the table's defaults.
fn identity(config: &Epos4Config) -> [(Slot, u32); 8] {
    let amps = config.axis.amplifier.max_current;
    let torque_constant = config.axis.plant.torque_constant();
    let milliamps = |amps: f64| (amps * 1e3).round() as u32;
    let rated = config.rated_torque.unwrap_or(amps * torque_constant);
    // Nominal current in whole milliamperes. The torque constant compensates for the rounding error, which matters
    // for small motors.
    let nominal = milliamps(rated / torque_constant).max(1);
    let torque_constant = (rated / f64::from(nominal) * 1e9).round() as u32;
    let counts = config.axis.counts_per_revolution;
    [
        (slot!(VENDOR_ID), config.vendor),
        (slot!(PRODUCT_CODE), config.product),
        (slot!(REVISION), config.revision),
        (slot!(SERIAL_NUMBER), config.serial),
        (slot!(EPOS4_MAIN_SENSOR_RESOLUTION), config.main_sensor_resolution.unwrap_or(counts)),
        (slot!(EPOS4_NOMINAL_CURRENT), nominal),
        (slot!(EPOS4_NOMINAL_CURRENT).plus(1), milliamps(amps)),
        (slot!(EPOS4_TORQUE_CONSTANT), torque_constant),
    ]
}

/// An emulated axis controller.
pub struct Epos4 {
    config: Epos4Config,
    /// Node-ID of the device; `None` until LSS assigns a node-ID.
    node: Option<NodeId>,
    lss: Lss,
    objects: Objects,
    drive: Drive,
    errors: Errors,
    pdos: Pdos,
    server: sdo::Server,
    /// The answer to the last SDO request, and its due time.
    answer: Option<(Instant, Frame)>,
    /// Time at which the last requested block begins; `None` once the block has begun.
    block_at: Option<Instant>,
    queue: VecDeque<Frame>,
    /// End of the restart in progress.
    boots_at: Option<Instant>,
    heartbeat_at: Option<Instant>,
    consumers: Consumers,
    /// Time up to which the axis has been simulated.
    inner: Instant,
    last_sync: Option<Instant>,
    wake_at: Option<Instant>,
}

impl Epos4 {
    /// A device switched on at [`Epos4Config::power_on`].
    pub fn new(config: Epos4Config) -> Self {
        let boots_at = config.power_on + config.boot_delay;
        let address = lss::Identity {
            vendor: config.vendor,
            product: config.product,
            revision: config.revision,
            serial: config.serial,
        };
        Self {
            node: config.node,
            lss: Lss::new(config.node, address),
            objects: Objects::new(config.node, &identity(&config)),
            drive: Drive::new(&config),
            errors: Errors::default(),
            pdos: Pdos::NONE,
            server: sdo::Server::new(SDO_TIME_OUT),
            answer: None,
            block_at: None,
            queue: VecDeque::with_capacity(QUEUE),
            boots_at: Some(boots_at),
            heartbeat_at: None,
            consumers: Consumers::default(),
            inner: config.power_on,
            last_sync: None,
            wake_at: Some(boots_at),
            config,
        }
    }

    /// The simulated axis, including state that no drive can measure.
    pub fn axis(&self) -> &PlantAxis {
        &self.drive.axis
    }

    /// Advances the axis to `now` in whole chunks. With `exact` the remaining sub-steps are simulated as well.
    fn catch_up(&mut self, now: Instant, exact: bool) {
        loop {
            let left = now.since(self.inner);
            let steps = if left >= CHUNK * SUB_STEP {
                CHUNK
            } else if exact {
                (left.as_nanos() / SUB_STEP.as_nanos()) as u32
            } else {
                0
            };
            if steps == 0 {
                return;
            }
            self.inner += steps * SUB_STEP;
            if let Some(error) = self.drive.advance(steps, &mut self.objects) {
                self.fail(error);
            }
        }
    }

    fn send(&mut self, frame: Frame) {
        append(&mut self.queue, frame);
    }

    /// Whether the device provides services other than NMT and error control.
    fn serving(&self) -> bool {
        matches!(self.objects.nmt, nmt::NmtState::PreOperational | nmt::NmtState::Operational)
    }

    fn enter(&mut self, state: nmt::NmtState, now: Instant) {
        if self.objects.nmt == state {
            return;
        }
        self.objects.nmt = state;
        self.pdos = if state == nmt::NmtState::Operational { Pdos::read(&self.objects) } else { Pdos::NONE };
        if state == nmt::NmtState::Stopped {
            self.server.reset();
            self.answer = None;
            self.end_connection();
        }
        self.drive.publish(&mut self.objects, 0.0);
        self.announce();
        self.send_events(now);
    }

    fn manage(&mut self, command: nmt::Command, now: Instant) {
        match command {
            nmt::Command::Start => self.enter(nmt::NmtState::Operational, now),
            nmt::Command::Stop => self.enter(nmt::NmtState::Stopped, now),
            nmt::Command::EnterPreOperational => self.enter(nmt::NmtState::PreOperational, now),
            nmt::Command::ResetNode => {
                self.lss.restart();
                self.drive.restart();
                self.reset(true, now);
            }
            nmt::Command::ResetCommunication => {
                self.end_connection();
                self.reset(false, now);
            }
        }
    }

    fn reset(&mut self, all: bool, now: Instant) {
        self.lss.wait();
        self.node = self.lss.pending;
        if let Some(node) = self.node {
            self.objects.rename(node);
        }
        self.objects.reset(all);
        self.objects.nmt = nmt::NmtState::Initialising;
        // A drive in fault keeps its errors until a fault reset.
        if !self.drive.faulted() {
            self.errors.clear(&mut self.objects, |_| true);
        }
        self.errors.restart(&mut self.objects);
        self.pdos = Pdos::NONE;
        self.server.reset();
        self.answer = None;
        self.block_at = None;
        self.queue.clear();
        self.heartbeat_at = None;
        self.consumers = Consumers::default();
        self.last_sync = None;
        self.boots_at = Some(now + self.config.boot_delay);
    }

    fn boot(&mut self, now: Instant) {
        self.boots_at = None;
        if self.node.is_none() {
            // Without a node-ID the device stays in initialisation, where only LSS works.
            return;
        }
        self.objects.nmt = nmt::NmtState::PreOperational;
        self.drive.started(&mut self.objects);
        self.send_heartbeat(nmt::NmtState::Initialising);
        // The boot-up message counts as the first heartbeat (CiA 301 §7.2.8.3.2.2).
        self.heartbeat_at = self.heartbeat_period().map(|period| now + period);
        self.consumers.read(&self.objects);
        self.announce();
    }

    fn send_heartbeat(&mut self, state: nmt::NmtState) {
        if let Some(node) = self.node {
            self.send(Heartbeat { node, state }.encode());
        }
    }

    fn synchronise(&mut self, now: Instant) {
        self.catch_up(now, true);
        self.last_sync = Some(now);
        if self.objects.nmt != nmt::NmtState::Operational {
            return;
        }
        self.pdos.sample(&self.objects, now, &mut self.queue);
        self.pdos.take_effect(&mut self.objects);
        self.objects.changes.setpoint = true;
        self.settle(now);
    }

    fn send_events(&mut self, now: Instant) {
        if self.objects.nmt == nmt::NmtState::Operational {
            self.pdos.events(&self.objects, now, &mut self.queue);
        }
    }

    /// Applies the last writes to the dictionary.
    fn settle(&mut self, now: Instant) {
        let changes = std::mem::take(&mut self.objects.changes);
        if changes.producer {
            self.start_heartbeat(now);
        }
        if changes.consumers {
            self.read_consumers();
        }
        for number in PdoNumber::ALL {
            let at = usize::from(number.offset());
            if changes.received[at] {
                self.update_pdo(PdoKind::Rpdo, number);
            }
            if changes.transmitted[at] {
                self.update_pdo(PdoKind::Tpdo, number);
            }
        }
        if changes.mode {
            self.drive.change_mode(&mut self.objects);
        }
        if changes.controlword && self.drive.command(&mut self.objects) {
            self.reset_fault();
        }
        if changes.setpoint
            && let Some(error) = self.drive.latch(&self.objects)
        {
            self.fail(error);
        }
        if changes.mode || changes.controlword {
            self.drive.publish(&mut self.objects, 0.0);
        }
        self.send_events(now);
    }

    fn serve(&mut self, frame: &Frame, node: NodeId, now: Instant) {
        self.catch_up(now, false);
        let objects = &mut self.objects;
        let answer = self.server.handle_frame(frame, node, objects, now);
        self.settle(now);
        let due = now + self.config.answer_delay;
        if let Some(answer) = answer {
            self.answer = Some((due, answer));
        }
        self.block_at = self.server.transmits().then_some(due);
    }

    fn configure(&mut self, frame: &Frame, now: Instant) {
        let Some(request) = lss::Request::decode(frame) else {
            return;
        };
        if let Some(answer) = self.lss.handle(request, self.node) {
            self.send(answer.encode());
        }
        if self.node.is_none() && self.lss.given {
            self.reset(false, now);
        }
    }

    /// Latest time at which the axis has to be advanced.
    fn next_control(&self) -> Instant {
        let synchronised = self.last_sync.is_some_and(|at| self.inner.since(at) < LAZIEST);
        let alone = self.pdos.event_driven() || self.drive.powered() && !synchronised;
        self.inner + if alone { CHUNK * SUB_STEP } else { LAZIEST }
    }

    fn schedule(&mut self) {
        let timers = [
            self.consumers.poll_timeout(),
            self.boots_at,
            self.heartbeat_at,
            self.answer.as_ref().map(|(at, _)| *at),
            self.block_at,
            self.server.poll_timeout(),
            self.pdos.poll_timeout(),
        ];
        self.wake_at = Some(timers.iter().flatten().fold(self.next_control(), |first, at| first.min(*at)));
    }
}

/// Adds a frame to a transmit queue, unless the queue is full.
fn append(queue: &mut VecDeque<Frame>, frame: Frame) {
    if queue.len() < QUEUE {
        queue.push_back(frame);
    }
}

impl Device for Epos4 {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        let Some(id) = frame.standard_data_id().filter(|_| self.boots_at.is_none()) else {
            return;
        };
        if id == cob::LSS_REQUEST {
            self.configure(frame, now);
            self.schedule();
            return;
        }
        let Some(node) = self.node else {
            return;
        };
        if id == cob::SYNC {
            if self.serving() {
                self.hear_sync(frame, now);
            }
        } else if id == cob::NMT {
            let request = nmt::Request::decode(frame);
            let Some(request) = request.filter(|request| request.concerns(node)) else {
                return;
            };
            self.catch_up(now, false);
            self.manage(request.command, now);
        } else if id == cob::sdo_request(node) {
            if !self.serving() {
                return;
            }
            self.serve(frame, node, now);
        } else if !self.receive_pdo(id, frame.data(), now) {
            // All other frames are ignored, except heartbeats of monitored nodes.
            let Some(heartbeat) = Heartbeat::decode(frame) else {
                return;
            };
            if let Some(number) = self.consumers.hear(heartbeat.node, now) {
                self.regain(errors::HEARTBEAT.of(number));
            }
        }
        self.schedule();
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        let segment = |node| match self.block_at {
            None => self.server.poll_transmit(node, now),
            Some(_) => None,
        };
        self.queue.pop_front().or_else(|| self.node.and_then(segment))
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.wake_at
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.catch_up(now, false);
        if self.boots_at.is_some_and(|at| at <= now) {
            self.boot(now);
        }
        if let Some((_, frame)) = self.answer.take_if(|(at, _)| *at <= now) {
            self.send(frame);
        }
        self.block_at = self.block_at.filter(|at| *at > now);
        if let Some(abort) = self.server.handle_timeout(now)
            && let Some(node) = self.node
        {
            self.send(abort.encode(node));
        }
        self.produce_heartbeat(now);
        while let Some(number) = self.consumers.expire(now) {
            self.lose_contact(errors::HEARTBEAT.of(number), now);
        }
        while let Some(number) = self.pdos.overdue(now) {
            self.fail(errors::RPDO_TIME_OUT.of(number));
        }
        self.send_events(now);
        self.schedule();
    }
}
