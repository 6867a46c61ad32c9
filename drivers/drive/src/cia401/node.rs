//! One I/O node during operation.

use std::time::Duration;

use can::{Frame, Instant};
use canopen::cia401::blocks;
use canopen::emcy::Emergency;
use canopen::nmt::{Command, NmtState};
use canopen::pdo::PdoNumber;
use canopen::{NodeId, cob};

use super::config::{IoConfig, mask};
use super::edges::Edge;
use super::fault::IoFault;
use super::image::{ImagePublisher, InputImage, IoError, IoLink, OutputCommand, SentOutputs};
use crate::bus::Member;
use crate::cia402::GroupConfig;
use crate::{BringUpError, EmergencyStop, Request};

/// State of one I/O node: its inputs, the outputs sent and the latched fault.
///
/// Nothing here waits or allocates. The order of calls within a cycle is:
/// 1. [`inputs`](Self::inputs), [`heard`](Self::heard) and [`emergency`](Self::emergency), as frames arrive;
/// 2. [`recover`](Self::recover);
/// 3. [`end_of_read`](Self::end_of_read), which publishes the image;
/// 4. [`command`](Self::command) and [`handed_over`](Self::handed_over).
pub(crate) struct IoNode {
    node: NodeId,
    inputs: u8,
    outputs: u8,
    inverted_inputs: u64,
    emergency_inputs: u64,
    inverted_outputs: u64,
    error_mode: u64,
    error_value: u64,
    /// Time-out for the first inputs after the start.
    inputs_within: Duration,
    inputs_lost_after: Duration,
    heartbeat_lost_after: Duration,
    tolerated_missing: u32,

    image: InputImage,
    publisher: ImagePublisher,
    commanded: OutputCommand,
    /// The last levels that the port took, over faults, resets and bring-ups; `None` before the first.
    kept: Option<u64>,
    /// The last inputs were received since the start.
    has_inputs: bool,
    /// Receive time of the last heartbeat.
    heartbeat: Instant,
    /// Time of the first cycle. Silence counts from here, because frames that came before may still wait in the port.
    since: Option<Instant>,
    operational: bool,
    /// The levels in the batch of this cycle.
    offered: Option<u64>,
    /// The last levels are to be sent again.
    repeating: bool,
    /// Cycles in a row whose output command the port did not take.
    not_sent: u32,
    reset: Request,
    recovery: Recovery,
}

/// Recovery of a node after a fault, in the steps of bring-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Recovery {
    None,
    /// The node was sent a reset of its communication at `since`, and is configured.
    Configuring {
        since: Instant,
    },
    /// The node was sent the NMT start at `started`.
    Starting {
        since: Instant,
        started: Instant,
    },
}

impl IoNode {
    /// A node that has not been brought up, and the controller's end of it.
    pub(crate) fn new(group: &GroupConfig, config: &IoConfig) -> (Self, IoLink) {
        let image = InputImage::not_started(config.node, config.inputs);
        let (publisher, link) = IoLink::new(config.node, &image, config.error_value);
        let node = Self {
            node: config.node,
            inputs: config.inputs,
            outputs: config.outputs,
            inverted_inputs: config.inverted_inputs,
            emergency_inputs: config.emergency_inputs,
            inverted_outputs: config.inverted_outputs,
            error_mode: config.error_mode,
            error_value: config.error_value,
            inputs_within: group.boot_timeout + config.event_timer,
            inputs_lost_after: config.inputs_lost_after(),
            heartbeat_lost_after: group.heartbeat_lost_after(),
            tolerated_missing: group.tolerated_missing,
            image,
            publisher,
            commanded: link.outputs.clone(),
            kept: None,
            has_inputs: false,
            heartbeat: Instant::ZERO,
            since: None,
            operational: false,
            offered: None,
            repeating: false,
            not_sent: 0,
            reset: link.reset_request(),
            recovery: Recovery::None,
        };
        (node, link)
    }

    /// Ends operation. Bring-up begins, and the outputs are commanded to their error state.
    pub(crate) fn reset(&mut self) {
        self.image = InputImage::not_started(self.node, self.inputs);
        self.publisher.publish(&self.image.words());
        self.commanded.set_all(self.error_levels());
        (self.has_inputs, self.recovery) = (false, Recovery::None);
        self.reset.take();
    }

    /// Whether the inputs are known, `waited` after the start of the node. A node without inputs needs none.
    pub(crate) fn has_inputs(&self, waited: Duration) -> Result<bool, BringUpError> {
        let known = self.has_inputs || self.inputs == 0;
        if !known && waited > self.inputs_within {
            return Err(BringUpError::NoInputs { node: self.node.raw(), waited });
        }
        Ok(known)
    }

    /// Starts operation after bring-up. Edges count from here.
    pub(crate) fn begin(&mut self, now: Instant) {
        let InputImage { levels, received, heard, .. } = self.image;
        let first = InputImage::not_started(self.node, self.inputs);
        self.image = InputImage { at: now, heard, received, levels, fault: None, ..first };
        self.publisher.publish(&self.image.words());
        self.operate();
    }

    /// Starts the commands and the watch. The outputs have their error state until the next command.
    fn operate(&mut self) {
        // Commands that were given during bring-up or a fault do not take effect.
        self.commanded.set_all(self.error_levels());
        (self.since, self.operational) = (None, true);
        (self.offered, self.repeating, self.not_sent) = (None, false, 0);
    }

    /// Levels of the outputs in the error state. An output that keeps its level has the last level sent. Before the
    /// first command all outputs have their error values.
    fn error_levels(&self) -> u64 {
        let kept = self.kept.unwrap_or(self.error_value);
        self.error_value & self.error_mode | kept & !self.error_mode
    }

    /// Whether the node is being reset after a fault.
    pub(crate) fn recovers(&self) -> bool {
        self.recovery != Recovery::None
    }

    /// Advances the reset of a fault by one cycle, and begins a requested one. `may_send`: a command of the node can be
    /// sent in this cycle. Returns the command.
    pub(crate) fn recover(&mut self, member: &mut Member, now: Instant, may_send: bool) -> Option<Command> {
        let faulted = self.image.fault.is_some();
        let requested = (may_send || !faulted) && self.reset.take();
        let Member { bring_up, sdo } = member;
        let since = match self.recovery {
            Recovery::None if !requested || !faulted => return None,
            Recovery::None => {
                sdo.reset();
                bring_up.reset(now);
                self.has_inputs = false;
                self.recovery = Recovery::Configuring { since: now };
                return Some(Command::ResetCommunication);
            }
            Recovery::Configuring { since } | Recovery::Starting { since, .. } => since,
        };
        let mut advanced = bring_up.advance(sdo, now);
        match self.recovery {
            Recovery::Configuring { since } if bring_up.configured() && may_send => {
                bring_up.start(now);
                self.recovery = Recovery::Starting { since, started: now };
                return Some(Command::Start);
            }
            Recovery::Starting { started, .. } => match self.has_inputs(now.since(started)) {
                Ok(known) if known && bring_up.operational() => {
                    self.recovery = Recovery::None;
                    (self.image.fault, self.image.error, self.image.sent) = (None, None, None);
                    self.operate();
                }
                known => advanced = advanced.and(known.map(|_| ())),
            },
            Recovery::None | Recovery::Configuring { .. } => {}
        }
        if let Err(error) = advanced {
            sdo.reset();
            let (node, waited) = (self.node.raw(), now.since(since));
            self.latch(match error.object() {
                Some(object) => IoFault::NotConfigured { node, object },
                None => IoFault::NotBack { node, waited },
            });
        }
        None
    }

    /// Takes TPDO 1, received at `at`. `None` means a payload of another length. A node that is being configured may
    /// send by its old mapping; such a frame is ignored.
    pub(crate) fn inputs(&mut self, data: &[u8], at: Instant) -> Option<()> {
        if matches!(self.recovery, Recovery::Configuring { .. }) {
            return Some(());
        }
        let length = usize::from(blocks(self.inputs));
        if length == 0 || data.len() != length {
            return None;
        }
        let mut bytes = [0; 8];
        bytes[..length].copy_from_slice(data);
        let levels = (u64::from_le_bytes(bytes) ^ self.inverted_inputs) & mask(self.inputs);
        let image = &mut self.image;
        let mut changed = if self.has_inputs { levels ^ image.levels } else { 0 };
        while changed != 0 {
            let input = changed.trailing_zeros() as usize;
            image.edges[input] += 1;
            image.last_edge[input] = at;
            let level = levels >> input & 1 == 1;
            image.history.push(Edge { input: input as u8, level, at, previous: image.received });
            changed &= changed - 1;
        }
        (image.levels, image.received, image.heard) = (levels, at, at);
        self.has_inputs = true;
        Some(())
    }

    /// Takes a heartbeat or boot-up received at `at`.
    pub(crate) fn heard(&mut self, state: NmtState, at: Instant) {
        (self.heartbeat, self.image.heard) = (at, at);
        self.operational &= state == NmtState::Operational;
    }

    /// Takes an EMCY received at `at`. The error ends when the error register is clear.
    pub(crate) fn emergency(&mut self, emergency: &Emergency, at: Instant) {
        let register = emergency.error_register.0;
        if !emergency.is_reset() {
            self.image.error = Some(IoError { code: emergency.code, register, at });
        } else if register == 0 {
            self.image.error = None;
        }
    }

    /// Ends the reading of a cycle: judges silence and publishes the image.
    pub(crate) fn end_of_read(&mut self, now: Instant, cycle: u64) {
        if !self.recovers() {
            self.watch(now);
        }
        (self.image.cycle, self.image.at) = (cycle, now);
        self.publisher.publish(&self.image.words());
    }

    /// The first input of the emergency stop that is open or not known.
    pub(crate) fn emergency_stop(&self) -> Option<EmergencyStop> {
        let known = self.image.fault.is_none();
        let open = if known { self.emergency_inputs & !self.image.levels } else { self.emergency_inputs };
        let input = open.trailing_zeros() as u8;
        (open != 0).then_some(EmergencyStop { node: self.node.raw(), input, known })
    }

    /// Latches silence, a node that left the state operational, and outputs that are not sent.
    fn watch(&mut self, now: Instant) {
        let node = self.node.raw();
        if !self.operational {
            self.latch(IoFault::LeftOperational { node });
        }
        let since = *self.since.get_or_insert(now);
        let waited = now.since(self.image.received.max(since));
        if self.inputs > 0 && waited > self.inputs_lost_after {
            self.latch(IoFault::InputsSilent { node, waited });
        }
        let waited = now.since(self.heartbeat.max(since));
        if waited > self.heartbeat_lost_after {
            self.latch(IoFault::HeartbeatLost { node, waited });
        }
        if self.not_sent > self.tolerated_missing {
            self.latch(IoFault::OutputsNotSent { node, cycles: self.not_sent });
        }
    }

    /// RPDO 1, if the outputs are to have other levels than those sent last. With `repeat`, also unchanged levels are
    /// offered until the port takes them.
    pub(crate) fn command(&mut self, repeat: bool) -> Option<Frame> {
        self.repeating |= repeat;
        let mask = mask(self.outputs);
        let last = self.image.sent.map(|sent| sent.levels);
        let levels = match self.image.fault {
            None => self.commanded.take(),
            // The error state of the node itself. A node that was never sent a command stays as it is.
            Some(_) => {
                self.kept?;
                self.error_levels()
            }
        } & mask;
        let due = self.repeating || last != Some(levels);
        self.offered = (self.outputs > 0 && due).then_some(levels);
        if self.offered.is_none() {
            self.not_sent = 0;
        }
        let length = usize::from(blocks(self.outputs));
        let bytes = (self.offered? ^ self.inverted_outputs).to_le_bytes();
        Some(Frame::new(cob::rpdo(PdoNumber::One, self.node), &bytes[..length]).expect("eight bytes fit a frame"))
    }

    /// Notes whether the port took the RPDO 1 of this node, if there was one. `taken` is the number of frames that the
    /// port took from this RPDO on. The function subtracts the RPDO.
    pub(crate) fn handed_over(&mut self, taken: &mut usize, now: Instant, cycle: u64) {
        let Some(levels) = self.offered.take() else { return };
        if *taken > 0 {
            *taken -= 1;
            self.kept = Some(levels);
            if self.image.sent.is_none_or(|sent| sent.levels != levels) {
                self.image.sent = Some(SentOutputs { levels, cycle, at: now });
            }
            (self.repeating, self.not_sent) = (false, 0);
        } else {
            self.not_sent = self.not_sent.saturating_add(1);
        }
    }

    /// Latches a fault. The first fault stays until a reset or the next bring-up. A fault during a reset ends the
    /// reset, and replaces the fault before.
    pub(crate) fn latch(&mut self, fault: IoFault) {
        if self.recovers() {
            self.image.fault = None;
            self.recovery = Recovery::None;
        }
        self.image.fault.get_or_insert(fault);
    }
}

impl Drop for IoNode {
    /// Ends the validity of the levels. The node itself notices the silence of the host, and its outputs take their
    /// error state.
    fn drop(&mut self) {
        self.latch(IoFault::Ended { node: self.node.raw() });
        self.publisher.publish(&self.image.words());
    }
}
