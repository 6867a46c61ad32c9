//! A CANopen node: the communication that all emulated devices on a CAN bus share.
//!
//! [`Node`] is a [`Device`] with LSS, boot-up, NMT, an SDO server, heartbeat producer and consumer, EMCY, and four PDOs
//! each way with strict re-mapping. The device behind the communication is an [`Application`], for example a drive.
//! Both work on one object dictionary ([`objects::Objects`]), which is a table of rows ([`table::Entry`]).

pub(crate) mod eds;
pub(crate) mod errors;
mod heartbeats;
mod lss;
pub(crate) mod objects;
mod pdo;
mod supervision;
pub(crate) mod table;

use std::{collections::VecDeque, time::Duration};

use can::{Frame, Instant};
use canopen::pdo::{PdoKind, PdoNumber};
use canopen::{NodeId, cob, heartbeat::Heartbeat, nmt, sdo};

use crate::Device;
use errors::{Error, Errors};
use heartbeats::Consumers;
pub(crate) use lss::Identity;
use lss::Lss;
use objects::Objects;
use pdo::Pdos;

/// Time after which a transfer is abandoned because the client has sent nothing.
const SDO_TIME_OUT: Duration = Duration::from_secs(1);
/// Delay from power-on or reset to the boot-up frame of an emulated device, unless its configuration has another one.
pub const BOOT_DELAY: Duration = Duration::from_millis(50);
/// Capacity of a device's transmit queue. Further frames are lost, as in a full controller.
const QUEUE: usize = 32;

/// The device behind the communication of a [`Node`].
///
/// [`Application::catch_up`] to the present instant precedes every other call that changes the application. The only
/// exception is the reset after LSS has assigned a node-ID.
pub(crate) trait Application: Send + 'static {
    /// Advances to `now`, or to an error on the way. Called until `None`. Without `exact` the application may lag.
    fn catch_up(&mut self, now: Instant, exact: bool, objects: &mut Objects) -> Option<Error>;

    /// Advances the axis in a scene to `now`, or to the time of an error before `now`. Called until the result is
    /// `None`.
    fn advance_mechanics(&mut self, _now: Instant, _objects: &mut Objects) -> Option<Error> {
        None
    }

    /// Latest time of the next [`Application::catch_up`]; `event_driven` if a TPDO depends on changes.
    fn poll_timeout(&self, event_driven: bool) -> Option<Instant>;

    /// Reacts to an error, each time the error occurs.
    fn react(&mut self, error: Error, objects: &mut Objects);

    /// Whether a fault is latched, which keeps the present errors until a fault reset.
    fn faulted(&self) -> bool;

    /// Reacts to NMT stop and to a reset of the communication. Returns the error that this is for the application.
    fn end_connection(&mut self, objects: &mut Objects) -> Option<Error>;

    /// Begins a reset of the communication, with `all` a reset of the node. The dictionary is reset afterwards.
    fn reset(&mut self, all: bool);

    /// Ends the reset: the node boots.
    fn start(&mut self, objects: &mut Objects);

    /// Writes readable values to the dictionary.
    fn publish(&mut self, objects: &mut Objects);

    /// Takes a SYNC, before the RPDOs that wait for the SYNC take effect.
    fn synchronise(&mut self, objects: &mut Objects, now: Instant);

    /// Applies the writes of these marks.
    fn apply(&mut self, marks: u8, objects: &mut Objects) -> Applied;
}

/// Consequences of writes for the communication.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Applied {
    /// Whether a fault was reset.
    pub(crate) fault_reset: bool,
    pub(crate) error: Option<Error>,
    /// Whether readable values changed.
    pub(crate) publish: bool,
}

/// Configuration of the communication.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NodeConfig {
    /// `None`: LSS is to assign a node-ID.
    pub(crate) id: Option<NodeId>,
    pub(crate) identity: Identity,
    /// Time of power-on.
    pub(crate) power_on: Instant,
    /// Delay from power-on or reset to the boot-up frame.
    pub(crate) boot_delay: Duration,
    /// Delay from an SDO request to its answer.
    pub(crate) answer_delay: Duration,
    /// Delay from an LSS request to its answer.
    pub(crate) lss_delay: Duration,
}

/// An emulated node.
pub(crate) struct Node<A> {
    pub(crate) application: A,
    pub(crate) objects: Objects,
    boot_delay: Duration,
    answer_delay: Duration,
    lss_delay: Duration,
    /// Node-ID of the device; `None` until LSS assigns a node-ID.
    pub(crate) id: Option<NodeId>,
    lss: Lss,
    errors: Errors,
    /// Time from which the next EMCY may be sent.
    emergency_at: Instant,
    pdos: Pdos,
    server: sdo::Server,
    /// The answer to the last SDO request, and its due time.
    answer: Option<(Instant, Frame)>,
    /// The answers to LSS requests that are not due yet, and their due times.
    lss_answers: VecDeque<(Instant, Frame)>,
    /// Time at which the last requested block begins; `None` once the block has begun.
    block_at: Option<Instant>,
    queue: VecDeque<Frame>,
    /// End of the restart in progress.
    boots_at: Option<Instant>,
    /// Whether the device has a supply. A device without supply stays in its restart.
    powered: bool,
    heartbeat_at: Option<Instant>,
    consumers: Consumers,
    now: Instant,
    wake_at: Option<Instant>,
}

impl<A: Application> Node<A> {
    /// A node switched on at [`NodeConfig::power_on`].
    pub(crate) fn new(config: NodeConfig, objects: Objects, application: A) -> Self {
        let boots_at = config.power_on + config.boot_delay;
        Self {
            application,
            objects,
            boot_delay: config.boot_delay,
            answer_delay: config.answer_delay,
            lss_delay: config.lss_delay,
            id: config.id,
            lss: Lss::new(config.id, config.identity),
            errors: Errors::default(),
            emergency_at: config.power_on,
            pdos: Pdos::NONE,
            server: sdo::Server::new(SDO_TIME_OUT),
            answer: None,
            lss_answers: VecDeque::new(),
            block_at: None,
            queue: VecDeque::with_capacity(QUEUE),
            boots_at: Some(boots_at),
            powered: true,
            heartbeat_at: None,
            consumers: Consumers::default(),
            now: config.power_on,
            wake_at: Some(boots_at),
        }
    }

    /// Whether the device has booted and answers requests.
    pub(crate) fn has_booted(&self) -> bool {
        self.boots_at.is_none()
    }

    /// Advances the application to `now`, without `exact` as far as the application finds necessary.
    pub(crate) fn catch_up(&mut self, now: Instant, exact: bool) {
        self.now = now;
        while let Some(error) = self.application.catch_up(now, exact, &mut self.objects) {
            self.fail(error);
        }
    }

    /// Advances the axis in a scene to `now`. Returns whether an error occurred: the node may then have a frame to
    /// send.
    pub(crate) fn advance_mechanics(&mut self, now: Instant) -> bool {
        let mut failed = false;
        while let Some(error) = self.application.advance_mechanics(now, &mut self.objects) {
            self.now = now;
            if self.powered {
                self.fail(error);
                failed = true;
            }
        }
        if failed {
            self.schedule();
        }
        failed
    }

    fn send(&mut self, frame: Frame) {
        append(&mut self.queue, frame);
    }

    /// Whether the device provides services other than NMT and error control.
    pub(crate) fn serving(&self) -> bool {
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
        self.application.publish(&mut self.objects);
        self.announce();
        self.send_events(now);
    }

    pub(crate) fn manage(&mut self, command: nmt::Command, now: Instant) {
        match command {
            nmt::Command::Start => self.enter(nmt::NmtState::Operational, now),
            nmt::Command::Stop => self.enter(nmt::NmtState::Stopped, now),
            nmt::Command::EnterPreOperational => self.enter(nmt::NmtState::PreOperational, now),
            nmt::Command::ResetNode => {
                self.lss.restart();
                self.reset(true, now);
            }
            nmt::Command::ResetCommunication => {
                self.end_connection();
                self.reset(false, now);
            }
        }
    }

    fn reset(&mut self, all: bool, now: Instant) {
        self.application.reset(all);
        self.lss.wait();
        self.id = self.lss.pending;
        if let Some(id) = self.id {
            self.objects.rename(id);
        }
        self.objects.reset(all);
        self.objects.nmt = nmt::NmtState::Initialising;
        // A drive in fault keeps its errors until a fault reset.
        if !self.application.faulted() {
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
        self.boots_at = Some(now + self.boot_delay);
    }

    /// Switches the supply off or on. A device that is switched on restarts as after a reset of the node.
    pub(crate) fn set_power(&mut self, on: bool, now: Instant) {
        if self.powered == on {
            return;
        }
        self.catch_up(now, true);
        self.powered = on;
        self.lss.restart();
        self.reset(true, now);
        self.schedule();
    }

    /// Restarts the device by itself, as after a reset of the node.
    pub(crate) fn restart(&mut self, now: Instant) {
        self.catch_up(now, false);
        self.lss.restart();
        self.reset(true, now);
        self.schedule();
    }

    fn boot(&mut self, now: Instant) {
        self.boots_at = None;
        if self.id.is_none() {
            // Without a node-ID the device stays in initialisation, where only LSS works.
            return;
        }
        self.objects.nmt = nmt::NmtState::PreOperational;
        self.application.start(&mut self.objects);
        self.send_heartbeat(nmt::NmtState::Initialising);
        // The boot-up message counts as the first heartbeat (CiA 301 §7.2.8.3.2.2).
        self.heartbeat_at = self.objects.heartbeat_period().map(|period| now + period);
        self.consumers.read(&self.objects);
        self.announce();
    }

    fn send_heartbeat(&mut self, state: nmt::NmtState) {
        if let Some(node) = self.id {
            self.send(Heartbeat { node, state }.encode());
        }
    }

    fn synchronise(&mut self, now: Instant) {
        self.catch_up(now, true);
        self.application.synchronise(&mut self.objects, now);
        if self.objects.nmt != nmt::NmtState::Operational {
            return;
        }
        self.pdos.sample(&self.objects, now, &mut self.queue);
        self.pdos.take_effect(&mut self.objects);
        self.settle(now);
    }

    fn send_events(&mut self, now: Instant) {
        if self.objects.nmt == nmt::NmtState::Operational {
            self.pdos.events(&self.objects, now, &mut self.queue);
        }
    }

    /// Applies the last writes to the dictionary.
    pub(crate) fn settle(&mut self, now: Instant) {
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
        if changes.marks != 0 {
            let applied = self.application.apply(changes.marks, &mut self.objects);
            if applied.fault_reset {
                self.reset_fault();
            }
            if let Some(error) = applied.error {
                self.fail(error);
            }
            if applied.publish {
                self.application.publish(&mut self.objects);
            }
        }
        self.send_events(now);
    }

    fn serve(&mut self, frame: &Frame, node: NodeId, now: Instant) {
        self.catch_up(now, false);
        let objects = &mut self.objects;
        let answer = self.server.handle_frame(frame, node, objects, now);
        self.settle(now);
        let due = now + self.answer_delay;
        if let Some(answer) = answer {
            self.answer = Some((due, answer));
        }
        self.block_at = self.server.transmits().then_some(due);
    }

    fn configure(&mut self, frame: &Frame, now: Instant) {
        let Some(request) = lss::Request::decode(frame) else {
            return;
        };
        match self.lss.handle(request, self.id) {
            Some(answer) if self.lss_delay.is_zero() => self.send(answer.encode()),
            Some(answer) if self.lss_answers.len() < QUEUE => {
                self.lss_answers.push_back((now + self.lss_delay, answer.encode()));
            }
            _ => {}
        }
        if self.id.is_none() && self.lss.given {
            self.reset(false, now);
        }
    }

    /// Computes the time of the next time-out.
    pub(crate) fn schedule(&mut self) {
        if !self.powered {
            // The motor turns on without power.
            self.wake_at = self.application.poll_timeout(false);
            return;
        }
        let emergency = (self.emergency_at > self.now && self.errors.unannounced()).then_some(self.emergency_at);
        let timers = [
            self.application.poll_timeout(self.pdos.event_driven()),
            self.consumers.poll_timeout(),
            self.boots_at,
            self.heartbeat_at,
            self.answer.as_ref().map(|(at, _)| *at),
            self.lss_answers.front().map(|(at, _)| *at),
            self.block_at,
            self.server.poll_timeout(),
            self.pdos.poll_timeout(),
            emergency,
        ];
        self.wake_at = timers.into_iter().flatten().min();
    }
}

/// Adds a frame to a transmit queue, unless the queue is full.
fn append(queue: &mut VecDeque<Frame>, frame: Frame) {
    if queue.len() < QUEUE {
        queue.push_back(frame);
    }
}

impl<A: Application> Device for Node<A> {
    fn hears(&self, frame: &Frame) -> bool {
        let Some(id) = frame.standard_data_id() else {
            return false;
        };
        let error_control = 0x700..=0x77F;
        [cob::SYNC, cob::NMT, cob::LSS_REQUEST].contains(&id)
            || self.pdos.hears(id)
            || error_control.contains(&id.raw())
            || self.id.is_some_and(|node| id == cob::sdo_request(node))
    }

    fn handle(&mut self, frame: &Frame, now: Instant) {
        self.now = now;
        let Some(id) = frame.standard_data_id().filter(|_| self.has_booted()) else {
            return;
        };
        if id == cob::LSS_REQUEST {
            self.configure(frame, now);
            self.schedule();
            return;
        }
        let Some(node) = self.id else {
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
        self.queue.pop_front().or_else(|| self.id.and_then(segment))
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.wake_at
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.catch_up(now, false);
        if !self.powered {
            self.schedule();
            return;
        }
        if self.boots_at.is_some_and(|at| at <= now) {
            self.boot(now);
        }
        if let Some((_, frame)) = self.answer.take_if(|(at, _)| *at <= now) {
            self.send(frame);
        }
        while let Some(&(_, frame)) = self.lss_answers.front().filter(|(at, _)| *at <= now) {
            self.lss_answers.pop_front();
            self.send(frame);
        }
        self.block_at = self.block_at.filter(|at| *at > now);
        if let Some(abort) = self.server.handle_timeout(now)
            && let Some(node) = self.id
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
        // An EMCY may have waited for the end of the inhibit time.
        self.announce();
        self.send_events(now);
        self.schedule();
    }
}
