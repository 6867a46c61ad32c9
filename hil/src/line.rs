//! A serial line with true timing: each byte lasts its start, data and stop bits, in each direction.
//!
//! Both directions carry bytes simultaneously and independently. A byte reaches its receiver when its last stop bit
//! ends. Events are processed in the order of their times. The order at one instant is: the device's time-out, the
//! end of a byte to the device, the end of a byte to the host. The same input gives the same bytes at the same
//! instants.
//!
//! A USB adapter between line and host collects bytes and delivers packets of up to [`USB_PACKET`] bytes. The adapter
//! sends a packet when the packet is full or when the latency timer expires. The timer restarts with each packet, as
//! in FTDI adapters. Towards the device the emulated adapter adds no delay. Left out: the transfer on the USB itself,
//! framing and parity errors, breaks.
//!
//! [`LineFaults`] describes the faults on the wire. Read [`SerialLine::advance`] first.

mod faults;
#[cfg(test)]
mod tests;

pub use faults::{LineFaults, Stuck, WireFaults};

use std::{any::Any, collections::VecDeque, time::Duration};

use can::Instant;
use serial::{Settings, TimedByte, VirtualLinePeer};

use crate::{DeviceFault, LineDevice};
use faults::{Damage, Wire};

/// Bytes of the line in a full packet of a USB adapter. Two more bytes of the packet carry the state of the adapter.
pub const USB_PACKET: usize = 62;

/// A line with a device at one end. The host's end can be attached and detached.
// Different threads may advance two serial lines. Two serial lines therefore share no cache line.
#[repr(align(128))]
pub struct SerialLine {
    device: Box<dyn LineDevice>,
    host: Option<VirtualLinePeer>,
    now: Instant,
    time_out: Option<Instant>,
    to_device: Direction,
    to_host: Direction,
    adapter: Option<Adapter>,
    /// Delay of bytes to the host, and the time of the last delivery.
    late: Duration,
    delivered: Instant,
    /// The adapter of the host holds the bytes for the device.
    held: bool,
    /// Bytes in the adapter of the host, which holds them or has not sent all of them yet.
    waiting: VecDeque<TimedByte>,
    damage: Damage,
}

/// Counters of a line, before and after the effect of its faults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LineStatistics {
    /// Bytes that the host put on the line.
    pub to_device: u64,
    /// Bytes that the device put on the line.
    pub to_host: u64,
    /// Bytes that arrived with a changed value.
    pub corrupted: u64,
    /// Bytes that did not arrive.
    pub lost: u64,
    /// Bytes that arrived twice.
    pub duplicated: u64,
}

struct Direction {
    settings: Settings,
    /// Start of the current burst of bytes without gaps, and the number of bytes in the burst.
    burst: Instant,
    count: usize,
    free_at: Instant,
    /// The byte on the wire, with the instant at which it ends.
    on_wire: Option<TimedByte>,
    wire: Wire,
    carried: u64,
}

impl Direction {
    /// The count of a burst restarts after this number of bytes. Each restart adds a rounding error below 1 ns.
    const BURST: usize = 1000;

    fn new(settings: Settings) -> Self {
        Self {
            settings,
            burst: Instant::ZERO,
            count: 0,
            free_at: Instant::ZERO,
            on_wire: None,
            wire: Wire::default(),
            carried: 0,
        }
    }

    /// End of a byte offered at `at`, and its burst: the start and the new count.
    fn end(&self, at: Instant) -> (Instant, Instant, usize) {
        let (burst, count) = if at > self.free_at || self.count >= Self::BURST {
            (at.max(self.free_at), 1)
        } else {
            (self.burst, self.count + 1)
        };
        (burst + self.settings.line_time(count), burst, count)
    }

    fn start(&mut self, byte: u8, at: Instant) {
        if at > self.free_at {
            self.wire.begin_telegram();
        }
        (self.free_at, self.burst, self.count) = self.end(at);
        self.on_wire = Some(TimedByte { byte, at: self.free_at });
        self.carried += 1;
    }

    /// Bytes that arrive for the byte that ends now: zero, one or two.
    fn finish(&mut self, damage: &mut Damage) -> [Option<TimedByte>; 2] {
        let Some(ended) = self.on_wire.take() else {
            return [None, None];
        };
        let arrives = self.wire.carry(ended.byte, damage);
        arrives.map(|byte| byte.map(|byte| TimedByte { byte, ..ended }))
    }
}

/// A USB adapter's receive side.
struct Adapter {
    latency: Duration,
    /// Time of the last start of the timer.
    since: Instant,
    bytes: [u8; USB_PACKET],
    count: usize,
}

impl Adapter {
    fn expires(&self) -> Instant {
        self.since + self.latency
    }

    fn collect(&mut self, byte: TimedByte, host: Option<&mut VirtualLinePeer>) {
        self.bytes[self.count] = byte.byte;
        self.count += 1;
        if self.count == USB_PACKET {
            self.hand_over(byte.at, host);
        }
    }

    fn hand_over(&mut self, at: Instant, host: Option<&mut VirtualLinePeer>) {
        if let Some(host) = host {
            for &byte in &self.bytes[..self.count] {
                host.deliver(TimedByte { byte, at });
            }
        }
        self.count = 0;
        self.since = at;
    }

    fn run(&mut self, now: Instant, host: Option<&mut VirtualLinePeer>) {
        if self.count > 0 && self.expires() <= now {
            self.hand_over(self.expires(), host);
        }
        if self.count == 0 {
            let whole = now.since(self.since).as_nanos() / self.latency.as_nanos();
            // Both are below 2⁶⁴ ns.
            self.since += Duration::from_nanos((whole * self.latency.as_nanos()) as u64);
        }
    }
}

#[derive(Clone, Copy, Debug)]
enum LineEvent {
    TimeOut,
    ToDevice,
    ToHost,
    Packet,
}

impl SerialLine {
    /// An idle line at [`Instant::ZERO`]. A `latency` above zero inserts a USB adapter with such a latency timer.
    pub fn new(settings: Settings, latency: Option<Duration>, device: Box<dyn LineDevice>) -> Self {
        let latency = latency.filter(|latency| !latency.is_zero());
        let mut line = Self {
            time_out: None,
            device,
            host: None,
            now: Instant::ZERO,
            to_device: Direction::new(settings),
            to_host: Direction::new(settings),
            adapter: latency.map(|latency| Adapter { latency, since: Instant::ZERO, bytes: [0; USB_PACKET], count: 0 }),
            late: Duration::ZERO,
            delivered: Instant::ZERO,
            held: false,
            waiting: VecDeque::new(),
            damage: Damage::default(),
        };
        line.collect();
        line
    }

    /// Connects a new end of the host in place of the previous end. Bytes not yet sent by the previous end are lost.
    pub fn attach_host(&mut self, peer: VirtualLinePeer) {
        self.host = Some(peer);
    }

    /// Disconnects the host's end permanently, as an unplugged adapter or an unloaded driver does. The host's next
    /// call fails with [`LineError::Gone`](serial::LineError::Gone), and the device receives nothing more.
    pub fn hang_up(&mut self) {
        self.host = None;
    }

    /// Exchanges the hosts that receive the answers of the two devices. Both lines must have been advanced to one time.
    pub(crate) fn swap_receivers(&mut self, other: &mut Self) {
        if let (Some(one), Some(other)) = (&mut self.host, &mut other.host) {
            one.swap_receivers(other);
        }
        let delivered = self.delivered.max(other.delivered);
        (self.delivered, other.delivered) = (delivered, delivered);
    }

    /// The device as its own type, to examine its true state; `None` if the device is no `D`.
    pub fn device<D: LineDevice>(&self) -> Option<&D> {
        let device: &dyn Any = self.device.as_ref();
        device.downcast_ref()
    }

    /// Sets the faults from now on. The same faults damage the same bytes in the same way.
    pub fn set_faults(&mut self, faults: &LineFaults) {
        self.to_device.wire.set(faults.to_device, faults.seed);
        self.to_host.wire.set(faults.to_host, !faults.seed);
        (self.late, self.held) = (faults.late, faults.held);
        self.damage = Damage { left: faults.count, telegrams: 0 };
    }

    /// Number of telegrams, of both directions, that the present faults have damaged.
    pub fn damaged(&self) -> u64 {
        self.damage.telegrams
    }

    /// Passes bytes of a third party at `now`, to the host or to the device, without time on the line.
    pub fn inject(&mut self, bytes: &[u8], to_host: bool, now: Instant) {
        self.advance(now);
        for &byte in bytes {
            if to_host {
                self.deliver(TimedByte { byte, at: now }, self.late);
            } else {
                self.device.receive(byte, now);
            }
        }
        self.collect();
    }

    /// Begins or ends a fault of the device at `now`, after advancing the line to `now`. Returns whether the device has
    /// the fault.
    pub fn set_device_fault(&mut self, fault: DeviceFault, on: bool, now: Instant) -> bool {
        self.advance(now);
        let known = self.device.set_fault(fault, on, now);
        self.collect();
        known
    }

    /// The device, to change its faults.
    pub(crate) fn device_mut(&mut self) -> &mut dyn LineDevice {
        self.device.as_mut()
    }

    /// The device, of any type.
    pub(crate) fn any_device(&self) -> &dyn LineDevice {
        self.device.as_ref()
    }

    /// Delivers a byte to the host, later by `late`. Times of delivery do not decrease.
    fn deliver(&mut self, byte: TimedByte, late: Duration) {
        self.delivered = self.delivered.max(byte.at + late);
        if let Some(host) = &mut self.host {
            host.deliver(TimedByte { at: self.delivered, ..byte });
        }
    }

    /// Counters up to the last [`SerialLine::advance`].
    pub fn statistics(&self) -> LineStatistics {
        let (down, up) = (&self.to_device.wire, &self.to_host.wire);
        LineStatistics {
            to_device: self.to_device.carried,
            to_host: self.to_host.carried,
            corrupted: down.corrupted + up.corrupted,
            lost: down.lost + up.lost,
            duplicated: down.duplicated + up.duplicated,
        }
    }

    /// Advances the motors of the scene's robots and belts to `now`. The events of the line before `now` have been
    /// processed.
    /// Returns whether the device may have something to send.
    pub(crate) fn advance_mechanics(&mut self, now: Instant) -> bool {
        let changed = self.device.advance_mechanics(now);
        if changed {
            self.now = self.now.max(now);
            self.collect();
        }
        changed
    }

    /// Processes all events up to and including `until`. A byte that lasts longer stays on the wire.
    ///
    /// May be called ahead of time if the host writes nothing before `until`. Bytes written for a past instant go on
    /// the line at once.
    pub fn advance(&mut self, until: Instant) {
        self.advance_to(until);
    }

    /// As [`SerialLine::advance`]. Returns the time of the next event known then; [`Instant::FAR_FUTURE`] without one.
    pub(crate) fn advance_to(&mut self, until: Instant) -> Instant {
        self.take_from_host();
        let next = loop {
            let Some((at, event)) = self.next() else {
                break Instant::FAR_FUTURE;
            };
            if at > until {
                break at;
            }
            self.now = self.now.max(at);
            match event {
                LineEvent::TimeOut => {
                    self.device.handle_timeout(self.now);
                    self.collect();
                    // A device that requests time-outs without end must not stop time.
                    if self.time_out.is_some_and(|at| at <= self.now) {
                        self.time_out = Some(self.now + self.to_host.settings.line_time(1));
                    }
                }
                LineEvent::ToDevice => {
                    for arrived in self.to_device.finish(&mut self.damage).into_iter().flatten() {
                        self.device.receive(arrived.byte, self.now);
                    }
                    self.take_from_host();
                    self.collect();
                }
                LineEvent::ToHost => {
                    // The timer may have expired, with no byte to deliver, while the byte was on its way.
                    self.run_adapter();
                    for arrived in self.to_host.finish(&mut self.damage).into_iter().flatten() {
                        match &mut self.adapter {
                            Some(adapter) => adapter.collect(arrived, self.host.as_mut()),
                            None if self.late.is_zero() => self.deliver(arrived, Duration::ZERO),
                            None => {
                                let late = self.to_host.wire.damages(&mut self.damage);
                                self.deliver(arrived, if late { self.late } else { Duration::ZERO });
                            }
                        }
                    }
                    self.collect();
                }
                LineEvent::Packet => self.run_adapter(),
            }
        };
        self.now = self.now.max(until);
        next
    }

    /// Time of the next event known now: the instant up to which a waiting test bench can advance.
    pub fn next_event(&self) -> Option<Instant> {
        self.next().map(|(at, _)| at)
    }

    fn next(&self) -> Option<(Instant, LineEvent)> {
        let on_wire = |direction: &Direction| direction.on_wire.map(|byte| byte.at);
        let offered = || {
            let host = self.host.as_ref().filter(|_| !self.held)?;
            let byte = self.waiting.front().copied().or_else(|| host.peek())?;
            let (end, ..) = self.to_device.end(byte.at.max(self.now));
            Some(end)
        };
        let packet = || {
            let adapter = self.adapter.as_ref().filter(|adapter| adapter.count > 0)?;
            Some(adapter.expires())
        };
        // Explicit comparisons: this code runs for each byte, and an iterator over pairs doubled the cost of a whole
        // cell.
        let mut first = (Instant::FAR_FUTURE, LineEvent::TimeOut);
        let mut consider = |at: Option<Instant>, event| {
            if let Some(at) = at.filter(|&at| at < first.0) {
                first = (at, event);
            }
        };
        consider(self.time_out, LineEvent::TimeOut);
        consider(on_wire(&self.to_device).or_else(offered), LineEvent::ToDevice);
        consider(on_wire(&self.to_host), LineEvent::ToHost);
        consider(packet(), LineEvent::Packet);
        (first.0 < Instant::FAR_FUTURE).then_some(first)
    }

    fn take_from_host(&mut self) {
        let Some(host) = &mut self.host else {
            return;
        };
        if self.held || !self.waiting.is_empty() {
            self.waiting.extend(std::iter::from_fn(|| host.take()));
        }
        if self.held && !self.waiting.is_empty() {
            self.damage.telegrams = self.damage.telegrams.max(1);
        }
        if self.to_device.on_wire.is_none()
            && !self.held
            && let Some(next) = self.waiting.pop_front().or_else(|| host.take())
        {
            self.to_device.start(next.byte, next.at.max(self.now));
        }
    }

    /// Takes the device's next byte, if the line is free, and the device's next time-out.
    fn collect(&mut self) {
        if self.to_host.on_wire.is_none()
            && let Some(byte) = self.device.poll_transmit(self.now)
        {
            self.to_host.start(byte, self.now);
        }
        self.time_out = self.device.poll_timeout();
    }

    fn run_adapter(&mut self) {
        if let Some(adapter) = &mut self.adapter {
            adapter.run(self.now, self.host.as_mut());
        }
    }
}
