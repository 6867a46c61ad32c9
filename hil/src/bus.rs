//! A CAN bus with true timing: arbitration by identifier, exact frame lengths, one frame at a time.
//!
//! When the bus becomes free, the pending frame with the identifier of the highest priority is sent next. The
//! duration of the frame follows from its content, stuff bits included. Every other node receives the frame at the
//! end of its last bit, three bits before the bus is free again. Events are processed in the order of their times.
//! The order at one instant is: time-outs of devices, the end of a frame, the start of the next frame. The same input
//! gives the same frames at the same instants.
//!
//! [`FrameFault`] and [`HostFault`] are the faults of the wire and of the controller of the host. Left out: other errors
//! on the wire, error counters of the devices, and bit errors of nodes that send the same identifier. A single
//! node transmits as if its frames were acknowledged. Of two nodes that send the same identifier at once, the node
//! attached first wins.
//!
//! Nothing allocates once the queues have reached their working size. Read [`VirtualBus::advance`] first.

mod faults;

pub use faults::{FrameFault, Frames, HostFault};

use std::collections::VecDeque;
use std::time::Duration;

use can::timing::{Bitrate, INTERMISSION, bits_on_wire};
use can::{Frame, Id, Instant, Received, VirtualPeer, virtual_port};

use crate::{Device, DeviceFault};
use faults::{BusFaults, ERROR_FRAME, HeldFrame, report};

/// Capacity of a device's transmit queue on the bus. Further frames wait inside the device.
const QUEUE: usize = 32;

/// A bus with its nodes: ports of the host, and devices.
// Different threads may advance two buses. Two buses therefore share no cache line.
#[repr(align(128))]
pub struct VirtualBus {
    bitrate: Bitrate,
    hosts: Vec<VirtualPeer>,
    devices: Vec<Attached>,
    now: Instant,
    /// End of the intermission after the last frame.
    free_at: Instant,
    on_wire: Option<Transmission>,
    faults: BusFaults,
}

struct Attached {
    device: Box<dyn Device>,
    /// Frames that the device wants to send, with the times since which they are pending.
    pending: VecDeque<Received>,
    time_out: Option<Instant>,
    /// The device is cut off the bus. It goes on by itself.
    unplugged: bool,
}

#[derive(Clone, Copy)]
struct Transmission {
    frame: Frame,
    sender: End,
    ends: Instant,
    bits: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum End {
    Host(usize),
    Device(usize),
    /// A node that is not part of the cell.
    Foreign(usize),
}

impl VirtualBus {
    /// An idle bus without nodes, at [`Instant::ZERO`].
    pub fn new(bitrate: Bitrate) -> Self {
        Self {
            bitrate,
            hosts: Vec::new(),
            devices: Vec::new(),
            now: Instant::ZERO,
            free_at: Instant::ZERO,
            on_wire: None,
            faults: BusFaults::default(),
        }
    }

    /// Adds a node of the host. Its frames become pending at the time they were handed over.
    pub fn attach_host(&mut self, peer: VirtualPeer) {
        self.hosts.push(peer);
    }

    /// Replaces the first node of the host: another program opens the interface. A frame of the old node on the wire is
    /// cut off.
    pub fn replace_host(&mut self, mut peer: VirtualPeer) {
        self.on_wire = self.on_wire.filter(|wire| wire.sender != End::Host(0));
        self.faults.adapter.clear();
        peer.set_blind(self.faults.holds);
        match self.hosts.first_mut() {
            Some(host) => *host = peer,
            None => self.hosts.push(peer),
        }
    }

    /// Adds a device and returns its number on this bus, counted from 0.
    pub fn attach_device(&mut self, device: Box<dyn Device>) -> usize {
        let mut attached =
            Attached { device, pending: VecDeque::with_capacity(QUEUE), time_out: None, unplugged: false };
        attached.collect(self.now);
        self.devices.push(attached);
        self.devices.len() - 1
    }

    /// A device by the number that [`VirtualBus::attach_device`] gave it.
    pub fn device(&self, number: usize) -> Option<&dyn Device> {
        self.devices.get(number).map(|attached| attached.device.as_ref())
    }

    /// A device, to change its faults.
    pub(crate) fn device_mut(&mut self, number: usize) -> Option<&mut dyn Device> {
        self.devices.get_mut(number).map(|attached| attached.device.as_mut())
    }

    /// Applies `change` to a device at `now`, after advancing the bus to `now`. Returns `None` if there is no such
    /// device. Frames that the device sends afterwards are pending from `now`.
    pub fn change_device<R>(
        &mut self,
        number: usize,
        now: Instant,
        change: impl FnOnce(&mut dyn Device) -> R,
    ) -> Option<R> {
        self.advance(now);
        let attached = self.devices.get_mut(number)?;
        let result = change(attached.device.as_mut());
        attached.collect(self.now);
        Some(result)
    }

    /// Begins a fault of frames at `now`, and returns its number. Each frame that the fault concerns is damaged with this
    /// probability, and at most `count` frames are. `seed` determines which.
    pub fn begin_frame_fault(
        &mut self,
        frames: Frames,
        fault: FrameFault,
        (probability, count, seed): (f64, Option<u32>, u64),
    ) -> u64 {
        self.faults.add(frames, fault, probability, count, seed)
    }

    /// Ends a fault of frames at `now`. A frame that waits for the next frame is delivered.
    pub fn end_frame_fault(&mut self, number: u64, now: Instant) {
        // The numbers of the other foreign nodes change.
        self.on_wire = self.on_wire.filter(|wire| !matches!(wire.sender, End::Foreign(_)));
        self.faults.remove(number, now);
    }

    /// Whether fault `number` of frames is in effect and has damaged a frame.
    pub(crate) fn has_damaged(&self, number: u64) -> bool {
        self.faults.has_damaged(number)
    }

    /// Begins or ends a fault of the controller or the interface of the first host at `now`.
    pub fn set_host_fault(&mut self, fault: HostFault, on: bool, now: Instant) {
        let Some(host) = self.hosts.first_mut() else {
            return;
        };
        match fault {
            HostFault::Down => host.set_down(on),
            HostFault::QueueFull => host.set_full(on),
            HostFault::ErrorPassive => {}
            HostFault::Removed if on => {
                // An end without a port takes the place of the old end.
                let (_, gone) = virtual_port(1);
                self.replace_host(gone);
                return;
            }
            HostFault::Removed => return,
            HostFault::BusOff | HostFault::Unacknowledged => self.faults.cut_off = on,
            HostFault::Held => {
                self.faults.holds = on;
                host.set_blind(on || !self.faults.adapter.is_empty());
            }
        }
        if fault == HostFault::BusOff {
            // The kernel discards the frames of a controller that leaves the bus.
            while host.take_sent().is_some() {}
            self.faults.adapter.clear();
            host.set_blind(self.faults.holds);
        }
        if on && self.faults.cut_off {
            self.on_wire = self.on_wire.filter(|wire| wire.sender != End::Host(0));
        }
        let said = match (fault, on) {
            (HostFault::BusOff, true) => report::bus_off(),
            (HostFault::BusOff, false) => report::restarted(),
            (HostFault::ErrorPassive, true) => report::passive(),
            (HostFault::Unacknowledged, true) => report::unacknowledged(),
            (HostFault::ErrorPassive | HostFault::Unacknowledged, false) => report::active(),
            (HostFault::Down | HostFault::QueueFull | HostFault::Held | HostFault::Removed, _) => return,
        };
        host.deliver(Received { frame: said, at: now }, 0);
    }

    /// Lets a node that is not part of the cell send a frame at `at`, and again after each time `every`. Returns the number
    /// of the fault for [`end_frame_fault`](Self::end_frame_fault).
    pub fn begin_foreign(&mut self, frame: Frame, at: Instant, every: Option<Duration>) -> u64 {
        self.faults.add_foreign(frame, at, every)
    }

    /// Begins or ends a fault of a device at `now`, after advancing the bus to `now`. Returns whether there is a device
    /// of this number that has the fault.
    pub fn set_device_fault(&mut self, number: usize, fault: DeviceFault, on: bool, now: Instant) -> bool {
        self.advance(now);
        let Some(attached) = self.devices.get_mut(number) else {
            return false;
        };
        let known = if fault == DeviceFault::Unplugged {
            attached.unplugged = on;
            true
        } else {
            attached.device.set_fault(fault, on, now)
        };
        attached.collect(now);
        known
    }

    /// The devices.
    pub(crate) fn devices(&self) -> impl Iterator<Item = &dyn Device> {
        self.devices.iter().map(|attached| attached.device.as_ref())
    }

    /// Advances the motors of the scene's robots and belts to `now`. The events of the bus before `now` have been
    /// processed.
    /// Returns whether a device may have something to send.
    pub(crate) fn advance_mechanics(&mut self, now: Instant) -> bool {
        let mut changed = false;
        for attached in &mut self.devices {
            if attached.device.advance_mechanics(now) {
                attached.collect(now);
                changed = true;
            }
        }
        changed
    }

    /// Lets the devices read what the scene computed in its step at `now`. Returns whether a device may have something to
    /// send or requests another time-out.
    pub(crate) fn sense(&mut self, now: Instant) -> bool {
        let mut changed = false;
        for attached in &mut self.devices {
            if attached.device.sense(now) {
                attached.collect(now);
                changed = true;
            }
        }
        changed
    }

    /// Processes all events up to and including `until`. A frame that lasts longer stays on the wire.
    ///
    /// May be called ahead of time if the host sends nothing before `until`. A frame sent for a past instant becomes
    /// pending at once.
    pub fn advance(&mut self, until: Instant) {
        self.advance_to(until);
    }

    /// As [`VirtualBus::advance`]. Returns the time of the next event known then; [`Instant::FAR_FUTURE`] without one.
    pub(crate) fn advance_to(&mut self, until: Instant) -> Instant {
        self.fill_adapter();
        let next = loop {
            let Some((at, event)) = self.next() else {
                break Instant::FAR_FUTURE;
            };
            if at > until {
                break at;
            }
            self.now = self.now.max(at);
            match event {
                BusEvent::TimeOut => self.time_out(),
                BusEvent::HeldFrame => self.deliver_held(),
                BusEvent::FrameEnd => self.end_frame(),
                BusEvent::FrameStart => self.start_frame(),
            }
        };
        self.now = self.now.max(until);
        next
    }

    /// Time of the next event known now: the instant up to which a waiting test bench can advance.
    pub fn next_event(&self) -> Option<Instant> {
        self.next().map(|(at, _)| at)
    }

    fn next(&self) -> Option<(Instant, BusEvent)> {
        let time_out = self.devices.iter().filter_map(|attached| attached.time_out).min();
        let wire = match self.on_wire {
            Some(transmission) => Some((transmission.ends, BusEvent::FrameEnd)),
            None => self.heads().map(|(_, head)| head.at).min().map(|at| (at.max(self.free_at), BusEvent::FrameStart)),
        };
        let wire = match self.faults.next_held() {
            Some(at) if wire.as_ref().is_none_or(|(wire_at, _)| at <= *wire_at) => Some((at, BusEvent::HeldFrame)),
            _ => wire,
        };
        match time_out {
            Some(at) if wire.as_ref().is_none_or(|(wire_at, _)| at <= *wire_at) => Some((at, BusEvent::TimeOut)),
            _ => wire,
        }
    }

    /// The frame that each node would send next.
    fn heads(&self) -> impl Iterator<Item = (End, &Received)> {
        let hosts = self.hosts.iter().enumerate();
        let devices = self.devices.iter().enumerate();
        let silent = self.faults.cut_off || self.faults.holds;
        let first = self.faults.adapter.front();
        hosts
            .filter(move |(at, _)| !(silent && *at == 0))
            .filter_map(move |(at, host)| {
                Some((End::Host(at), first.filter(|_| at == 0).or_else(|| host.peek_sent())?))
            })
            .chain(devices.filter_map(|(at, device)| Some((End::Device(at), device.pending.front()?))))
            .chain(self.faults.foreign.iter().enumerate().map(|(at, foreign)| (End::Foreign(at), &foreign.next)))
    }

    fn time_out(&mut self) {
        let now = self.now;
        for attached in &mut self.devices {
            if attached.time_out.is_some_and(|at| at <= now) {
                attached.device.handle_timeout(now);
                attached.collect(now);
                // A device that requests time-outs without end must not stop time.
                if attached.time_out.is_some_and(|at| at <= now) {
                    attached.time_out = Some(now + self.bitrate.duration(1));
                }
            }
        }
    }

    fn start_frame(&mut self) {
        let strongest = self
            .heads()
            .filter(|(_, head)| head.at <= self.now)
            .min_by_key(|(_, head)| arbitration_field(&head.frame))
            .map(|(sender, head)| (sender, *head));
        let Some((sender, head)) = strongest else {
            return;
        };
        let bits = match sender {
            End::Host(at) if at > 0 || self.faults.adapter.is_empty() => self.hosts[at].bits_of_sent(),
            End::Host(_) | End::Device(_) | End::Foreign(_) => bits_on_wire(&head.frame),
        };
        if bits == 0 {
            // An error frame is a report of the host's controller and is not transmitted.
            self.remove(sender);
            return;
        }
        let ends = self.now + self.bitrate.duration(bits - INTERMISSION);
        self.free_at = self.now + self.bitrate.duration(bits);
        self.on_wire = Some(Transmission { frame: head.frame, sender, ends, bits });
    }

    fn end_frame(&mut self) {
        let Some(ended) = self.on_wire.take() else {
            return;
        };
        let received = Received { frame: ended.frame, at: ended.ends };
        let Some((fault, number)) = self.faults.strike(&ended.frame, ended.sender) else {
            self.remove(ended.sender);
            return self.deliver(received, ended.sender, ended.bits);
        };
        let sender = ended.sender;
        let held = |due| HeldFrame { due, received, sender, fault: number };
        match fault {
            FrameFault::Corrupted => {
                // The sender keeps the frame for its next attempt.
                self.free_at = ended.ends + self.bitrate.duration(ERROR_FRAME);
                for host in &mut self.hosts {
                    host.deliver(Received { frame: report::bus_error(), at: ended.ends }, ERROR_FRAME);
                }
                return self.collect_all(ended.ends);
            }
            FrameFault::Lost => {}
            FrameFault::Late(late) => self.faults.held.push(held(Some(ended.ends + late))),
            FrameFault::Duplicated => {
                self.faults.held.push(held(Some(ended.ends + self.bitrate.duration(ended.bits))));
                self.remove(sender);
                return self.deliver(received, sender, ended.bits);
            }
            FrameFault::Swapped if self.faults.waits(number) => {
                self.remove(sender);
                self.deliver(received, sender, ended.bits);
                return self.faults.release(number, ended.ends);
            }
            FrameFault::Swapped => self.faults.held.push(held(None)),
        }
        self.remove(sender);
        self.collect_all(ended.ends);
    }

    /// Delivers the held frames that are due.
    fn deliver_held(&mut self) {
        while let Some(held) = self.faults.take_held(self.now) {
            let received = Received { at: self.now, ..held.received };
            self.deliver(received, held.sender, bits_on_wire(&received.frame));
        }
    }

    /// Lets the adapter of the first host take its frames, while it holds frames or has not sent all of them.
    fn fill_adapter(&mut self) {
        let BusFaults { holds, adapter, .. } = &mut self.faults;
        if let Some(host) = self.hosts.first_mut().filter(|_| *holds || !adapter.is_empty()) {
            adapter.extend(std::iter::from_fn(|| host.take_sent()));
        }
    }

    /// Hands a frame to all nodes except its sender.
    fn deliver(&mut self, received: Received, sender: End, bits: u32) {
        let Received { frame, at } = received;
        for (number, host) in self.hosts.iter_mut().enumerate() {
            if sender != End::Host(number) && !(self.faults.cut_off && number == 0) {
                // A host with a full queue loses the frame and counts the loss, as the driver of a CAN card does.
                host.deliver(received, bits);
            }
        }
        for (number, attached) in self.devices.iter_mut().enumerate() {
            if sender == End::Device(number) || attached.unplugged {
                attached.collect(at);
            } else if attached.device.hears(&frame) {
                attached.device.handle(&frame, at);
                attached.collect(at);
            }
        }
    }

    fn collect_all(&mut self, now: Instant) {
        self.devices.iter_mut().for_each(|attached| attached.collect(now));
    }

    fn remove(&mut self, sender: End) {
        match sender {
            End::Host(0) if !self.faults.adapter.is_empty() => {
                self.faults.adapter.pop_front();
                if self.faults.adapter.is_empty() && !self.faults.holds {
                    self.hosts[0].set_blind(false);
                }
            }
            End::Host(at) => _ = self.hosts[at].take_sent(),
            End::Device(at) => self.devices[at].pop_pending(),
            End::Foreign(at) => self.faults.sent_foreign(at, self.now),
        }
    }
}

enum BusEvent {
    TimeOut,
    HeldFrame,
    FrameEnd,
    FrameStart,
}

impl Attached {
    fn pop_pending(&mut self) {
        self.pending.pop_front();
        if self.pending.is_empty() {
            // The next frame uses the same memory, which is in the cache of the processor.
            self.pending.clear();
        }
    }

    fn collect(&mut self, now: Instant) {
        while self.pending.len() < QUEUE {
            let Some(frame) = self.device.poll_transmit(now) else {
                break;
            };
            self.pending.push_back(Received { frame, at: now });
        }
        if self.unplugged {
            // Nobody hears these frames. The real controller would repeat the first one for ever.
            self.pending.clear();
        }
        self.time_out = self.device.poll_timeout();
    }
}

/// The bits by which frames compete, first on the wire highest; a dominant bit is 0 and wins.
///
/// Standard: identifier, RTR, IDE 0. Extended: the identifier's upper 11 bits, SRR 1, IDE 1, its
/// lower 18 bits, RTR.
fn arbitration_field(frame: &Frame) -> u32 {
    let remote = u32::from(frame.is_remote());
    match frame.id() {
        Some(Id::Standard(id)) => u32::from(id.raw()) << 21 | remote << 20,
        Some(Id::Extended(id)) => {
            let id = id.raw();
            (id >> 18) << 21 | 0b11 << 19 | (id & 0x3_FFFF) << 1 | remote
        }
        None => 0,
    }
}

#[cfg(test)]
mod tests;
