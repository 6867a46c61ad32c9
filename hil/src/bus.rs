//! A CAN bus with true timing: arbitration by identifier, exact frame lengths, one frame at a time.
//!
//! When the bus becomes free, the pending frame with the identifier of the highest priority is sent next. The
//! duration of the frame follows from its content, stuff bits included. Every other node receives the frame at the
//! end of its last bit, three bits before the bus is free again. Events are processed in the order of their times.
//! The order at one instant is: time-outs of devices, the end of a frame, the start of the next frame. The same input
//! gives the same frames at the same instants.
//!
//! Left out: errors on the wire, acknowledgement, and bit errors of nodes that send the same identifier. A single
//! node transmits as if its frames were acknowledged. Of two nodes that send the same identifier at once, the node
//! attached first wins.
//!
//! Nothing allocates once the queues have reached their working size. Read [`VirtualBus::advance`] first.

use std::collections::VecDeque;

use can::timing::{Bitrate, INTERMISSION, bits_on_wire};
use can::{Frame, Id, Instant, Received, VirtualPeer};

use crate::Device;

/// Capacity of a device's transmit queue on the bus. Further frames wait inside the device.
const QUEUE: usize = 32;

/// A bus with its nodes: ports of the host, and devices.
pub struct VirtualBus {
    bitrate: Bitrate,
    hosts: Vec<VirtualPeer>,
    devices: Vec<Attached>,
    now: Instant,
    /// End of the intermission after the last frame.
    free_at: Instant,
    on_wire: Option<Transmission>,
}

struct Attached {
    device: Box<dyn Device>,
    /// Frames that the device wants to send, with the times since which they are pending.
    pending: VecDeque<Received>,
    time_out: Option<Instant>,
}

#[derive(Clone, Copy)]
struct Transmission {
    frame: Frame,
    sender: End,
    ends: Instant,
    bits: u32,
}

#[derive(Clone, Copy, PartialEq)]
enum End {
    Host(usize),
    Device(usize),
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
        }
    }

    /// Adds a node of the host. Its frames become pending at the time they were handed over.
    pub fn attach_host(&mut self, peer: VirtualPeer) {
        self.hosts.push(peer);
    }

    /// Adds a device and returns its number on this bus, counted from 0.
    pub fn attach_device(&mut self, device: Box<dyn Device>) -> usize {
        let mut attached = Attached { device, pending: VecDeque::with_capacity(QUEUE), time_out: None };
        attached.collect(self.now);
        self.devices.push(attached);
        self.devices.len() - 1
    }

    /// A device by the number that [`VirtualBus::attach_device`] gave it.
    pub fn device(&self, number: usize) -> Option<&dyn Device> {
        self.devices.get(number).map(|attached| attached.device.as_ref())
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
        match time_out {
            Some(at) if wire.as_ref().is_none_or(|(wire_at, _)| at <= *wire_at) => Some((at, BusEvent::TimeOut)),
            _ => wire,
        }
    }

    /// The frame that each node would send next.
    fn heads(&self) -> impl Iterator<Item = (End, &Received)> {
        let hosts = self.hosts.iter().enumerate();
        let devices = self.devices.iter().enumerate();
        hosts
            .filter_map(|(at, host)| Some((End::Host(at), host.peek_sent()?)))
            .chain(devices.filter_map(|(at, device)| Some((End::Device(at), device.pending.front()?))))
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
            End::Host(at) => self.hosts[at].bits_of_sent(),
            End::Device(_) => bits_on_wire(&head.frame),
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
        self.remove(ended.sender);
        let (frame, at) = (ended.frame, ended.ends);
        for (number, host) in self.hosts.iter_mut().enumerate() {
            if ended.sender != End::Host(number) {
                // A host with a full queue loses the frame and counts the loss, as the driver of a CAN card does.
                host.deliver(Received { frame, at }, ended.bits);
            }
        }
        for (number, attached) in self.devices.iter_mut().enumerate() {
            if ended.sender != End::Device(number) {
                attached.device.handle(&frame, at);
            }
            attached.collect(at);
        }
    }

    fn remove(&mut self, sender: End) {
        match sender {
            End::Host(at) => _ = self.hosts[at].take_sent(),
            End::Device(at) => _ = self.devices[at].pending.pop_front(),
        }
    }
}

enum BusEvent {
    TimeOut,
    FrameEnd,
    FrameStart,
}

impl Attached {
    fn collect(&mut self, now: Instant) {
        while self.pending.len() < QUEUE {
            let Some(frame) = self.device.poll_transmit(now) else {
                break;
            };
            self.pending.push_back(Received { frame, at: now });
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
