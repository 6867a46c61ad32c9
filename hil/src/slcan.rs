//! A CAN adapter on a serial line that speaks slcan, as a function of (bytes, frames, now).
//!
//! [`SlcanDevice`] is a [`Device`] of a [`World`](crate::World), so several adapters and drives share one bus. Its
//! other side is a serial line. [`SlcanDevice::handle_bytes`] takes the bytes of the host. [`SlcanDevice::bytes`]
//! holds the bytes for the host until [`SlcanDevice::consume`] removes them.
//!
//! The adapter accepts the start-up sequences of Linux's slcan driver, slcand and python-can. These hosts close a
//! closed channel, open an open channel and send empty lines, all of which is accepted. Other violations of Lawicel's
//! manual are refused with a bell. These are: configuring an open channel, opening a channel without a bit rate,
//! sending without an open channel. Opening a channel restarts the controller.
//!
//! A bit rate other than that of the bus is a fault as on a real bus. The first frame sent ends in bus-off. Each
//! frame on the bus counts as a receive error. Unlike on a real bus, the frames of the other nodes stay intact.
//!
//! Every queue is bounded. While the bus accepts no more frames, lines wait in the adapter. [`SlcanDevice::room`]
//! then holds up the host, as USB and flow control do. Other overflows are counted in [`SlcanCounts`] and set the
//! status flags that the host can read. Left out: the speed of the serial line, and storing settings.

use std::collections::VecDeque;

use can::slcan::{AdapterReport, BusErrors, Command, Piece, Splitter, StatusFlags};
use can::{ControllerState, Frame, Id, Instant, timing::Bitrate};

use crate::Device;

/// Capacity for bytes of the host that wait while the bus accepts no frames.
const FROM_HOST: usize = 1024;
/// Capacity for frames that wait for the bus, in addition to the transmit queue of the bus.
const TO_BUS: usize = 32;
/// Capacity for frames that wait to be polled.
const TO_POLL: usize = 64;
/// Capacity for bytes that wait for the host: some 150 frames.
const TO_HOST: usize = 4096;
/// Part of [`TO_HOST`] that is reserved for the answers to commands.
const FOR_ANSWERS: usize = 256;

/// Counters of an adapter. Counters only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlcanCounts {
    /// Lines refused with a bell.
    pub refused: u64,
    /// Frames taken from the host.
    pub sent: u64,
    /// Frames from the bus that were reported or wait to be polled.
    pub received: u64,
    /// Frames from the bus that were lost for lack of room.
    pub lost: u64,
    /// Answers that were lost for lack of room: the host does not read.
    pub unsaid: u64,
    /// Bytes of the host that were lost because the host sent more than [`SlcanDevice::room`].
    pub overrun: u64,
}

/// An emulated adapter.
pub struct SlcanDevice {
    /// The bit rate of the connected bus.
    bus: Bitrate,
    from_host: VecDeque<u8>,
    splitter: Splitter,
    channel: Channel,
    /// Whether the configured bit rate equals that of the bus; `None` until a bit rate is configured.
    in_tune: Option<bool>,
    time_stamps: bool,
    auto_poll: bool,
    /// The acceptance filter of an SJA1000 in dual filter mode. Set bits of the mask are ignored.
    acceptance_code: u32,
    acceptance_mask: u32,
    flags: StatusFlags,
    state: ControllerState,
    receive_errors: u16,
    transmit_errors: u16,
    to_bus: VecDeque<Frame>,
    to_poll: VecDeque<AdapterReport>,
    to_host: VecDeque<u8>,
    counts: SlcanCounts,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Channel {
    Closed,
    Open,
    ListenOnly,
    Loopback,
}

impl SlcanDevice {
    /// An adapter with a closed channel on a bus of this bit rate.
    pub fn new(bus: Bitrate) -> Self {
        Self {
            bus,
            from_host: VecDeque::with_capacity(FROM_HOST),
            splitter: Splitter::default(),
            channel: Channel::Closed,
            in_tune: None,
            time_stamps: false,
            auto_poll: true,
            acceptance_code: 0,
            acceptance_mask: u32::MAX,
            flags: StatusFlags::default(),
            state: ControllerState::Active,
            receive_errors: 0,
            transmit_errors: 0,
            to_bus: VecDeque::with_capacity(TO_BUS),
            to_poll: VecDeque::with_capacity(TO_POLL),
            to_host: VecDeque::with_capacity(TO_HOST),
            counts: SlcanCounts::default(),
        }
    }

    /// Takes bytes sent by the host, at most as many as there is [room](SlcanDevice::room) for.
    pub fn handle_bytes(&mut self, bytes: &[u8], now: Instant) {
        let taken = bytes.len().min(self.room());
        self.from_host.extend(&bytes[..taken]);
        self.counts.overrun += (bytes.len() - taken) as u64;
        self.work(now);
    }

    /// Number of bytes that the host may send.
    pub fn room(&self) -> usize {
        FROM_HOST - self.from_host.len()
    }

    /// Executes the host's commands while there is room for frames to the bus.
    fn work(&mut self, now: Instant) {
        while self.to_bus.len() < TO_BUS
            && let Some(byte) = self.from_host.pop_front()
        {
            let dropped = self.splitter.dropped();
            let command = match self.splitter.push(byte) {
                Some(Piece::Line(line)) => Command::parse(line).ok(),
                Some(Piece::Bell) | None => {
                    if self.splitter.dropped() == dropped {
                        continue;
                    }
                    None
                }
            };
            let answer = command.map_or(AdapterReport::Refused, |command| self.obey(command, now));
            self.counts.refused += u64::from(answer == AdapterReport::Refused);
            self.counts.unsaid += u64::from(!self.say(&answer, TO_HOST));
        }
    }

    /// Bytes for the host, as one contiguous slice; empty when there are none.
    pub fn bytes(&self) -> &[u8] {
        self.to_host.as_slices().0
    }

    /// Removes the first `count` of [`SlcanDevice::bytes`] after they were sent to the host.
    pub fn consume(&mut self, count: usize) {
        self.to_host.drain(..count);
    }

    /// The counters of the adapter.
    pub fn counts(&self) -> SlcanCounts {
        self.counts
    }

    /// Sets the controller's error counters to values that faults on the bus would cause. The state follows from the
    /// counters (ISO 11898-1), and a change of state is reported. On a closed channel the call has no effect.
    pub fn set_error_counters(&mut self, receive: u16, transmit: u16) {
        if self.channel == Channel::Closed {
            return;
        }
        let before = self.state;
        self.receive_errors = receive;
        self.transmit_errors = transmit;
        self.state = match receive.max(transmit) {
            _ if transmit >= 256 => ControllerState::BusOff,
            128.. => ControllerState::Passive,
            96.. => ControllerState::Warning,
            _ => ControllerState::Active,
        };
        if self.state >= ControllerState::Warning {
            self.flags.0 |= StatusFlags::ERROR_WARNING;
        }
        if self.state >= ControllerState::Passive {
            self.flags.0 |= StatusFlags::ERROR_PASSIVE;
        }
        if self.state == ControllerState::BusOff {
            self.to_bus.clear();
        }
        if self.state != before {
            self.volunteer(&AdapterReport::State { state: self.state, receive, transmit });
        }
    }

    /// Reports errors as if they had occurred on the bus. On a closed channel the call has no effect.
    pub fn report_errors(&mut self, errors: BusErrors) {
        if self.channel != Channel::Closed {
            self.flags.0 |= StatusFlags::BUS_ERROR;
            self.volunteer(&AdapterReport::Errors(errors));
        }
    }

    fn obey(&mut self, command: Command, now: Instant) -> AdapterReport {
        let closed = self.channel == Channel::Closed;
        match command {
            Command::Empty | Command::LineSpeed(_) => {}
            Command::Bitrate(bitrate) if closed => self.in_tune = Some(bitrate == self.bus),
            Command::BitTiming { btr0, btr1 } if closed => {
                self.in_tune = Some(nanos_per_bit(btr0, btr1) == 1_000_000 / self.bus.kbps());
            }
            Command::TimeStamps(on) if closed => self.time_stamps = on,
            Command::AutoPoll(on) if closed => self.auto_poll = on,
            Command::AcceptanceCode(code) if closed => self.acceptance_code = code,
            Command::AcceptanceMask(mask) if closed => self.acceptance_mask = mask,
            Command::Bitrate(_)
            | Command::BitTiming { .. }
            | Command::TimeStamps(_)
            | Command::AutoPoll(_)
            | Command::AcceptanceCode(_)
            | Command::AcceptanceMask(_) => return AdapterReport::Refused,
            Command::Open => return self.open(Channel::Open),
            Command::ListenOnly => return self.open(Channel::ListenOnly),
            Command::Loopback => return self.open(Channel::Loopback),
            Command::Close => self.close(),
            Command::Transmit(frame) => return self.transmit(frame, now),
            Command::Version => return AdapterReport::Version { hardware: 0x10, software: 0x10 },
            Command::Firmware => return AdapterReport::Firmware { major: 1, minor: 0 },
            Command::SerialNumber => return AdapterReport::SerialNumber(*b"HIL1"),
            Command::Flags => return AdapterReport::Flags(std::mem::take(&mut self.flags)),
            Command::Poll | Command::PollAll if closed || self.auto_poll => return AdapterReport::Refused,
            Command::Poll => return self.to_poll.pop_front().unwrap_or(AdapterReport::Done),
            Command::PollAll => {
                while let Some(&report) = self.to_poll.front()
                    && self.say(&report, TO_HOST - FOR_ANSWERS)
                {
                    self.to_poll.pop_front();
                }
                return AdapterReport::PollEnd;
            }
        }
        AdapterReport::Done
    }

    fn open(&mut self, how: Channel) -> AdapterReport {
        match (self.channel, self.in_tune) {
            (Channel::Closed, Some(_)) => {
                self.channel = how;
                self.state = ControllerState::Active;
                (self.receive_errors, self.transmit_errors) = (0, 0);
                AdapterReport::Done
            }
            (as_before, _) if as_before == how => AdapterReport::Done,
            _ => AdapterReport::Refused,
        }
    }

    fn close(&mut self) {
        self.channel = Channel::Closed;
        self.to_bus.clear();
        self.to_poll.clear();
    }

    fn transmit(&mut self, frame: Frame, now: Instant) -> AdapterReport {
        match self.channel {
            _ if self.state == ControllerState::BusOff => return AdapterReport::Refused,
            Channel::Closed | Channel::ListenOnly => return AdapterReport::Refused,
            Channel::Loopback => self.report(frame, now),
            Channel::Open if self.in_tune == Some(false) => self.set_error_counters(self.receive_errors, 256),
            Channel::Open => self.to_bus.push_back(frame),
        }
        self.counts.sent += 1;
        AdapterReport::Done
    }

    /// Reports a frame to the host, or queues the frame for polling.
    fn report(&mut self, frame: Frame, now: Instant) {
        let millis = now.as_nanos() / 1_000_000 % 60_000;
        let stamp = self.time_stamps.then_some(millis as u16);
        let report = AdapterReport::Received { frame, stamp };
        if self.auto_poll {
            self.counts.received += u64::from(self.volunteer(&report));
        } else if self.to_poll.len() < TO_POLL {
            self.to_poll.push_back(report);
            self.counts.received += 1;
        } else {
            self.flags.0 |= StatusFlags::RECEIVE_QUEUE_FULL;
            self.counts.lost += 1;
        }
    }

    /// Sends an unsolicited report, if there is room.
    fn volunteer(&mut self, report: &AdapterReport) -> bool {
        let said = self.say(report, TO_HOST - FOR_ANSWERS);
        if !said {
            self.flags.0 |= StatusFlags::DATA_OVERRUN;
            self.counts.lost += 1;
        }
        said
    }

    fn say(&mut self, report: &AdapterReport, room: usize) -> bool {
        // Encoding succeeds for each report of this device: a frame comes from the bus, and other reports fit into a
        // line.
        let Some(line) = report.encode() else {
            return false;
        };
        let fits = self.to_host.len() + line.len() <= room;
        if fits {
            self.to_host.extend(line.iter());
        }
        fits
    }

    /// Whether either filter accepts the frame. The first filter compares an 11-bit identifier, RTR and the first
    /// data byte. The second filter compares identifier and RTR. Of a 29-bit identifier both filters compare the
    /// upper 16 bits.
    fn accepts(&self, frame: &Frame) -> bool {
        let remote = u32::from(frame.is_remote());
        let (seen, first, second) = match frame.id() {
            Some(Id::Standard(id)) => {
                let word = u32::from(id.raw()) << 5 | remote << 4;
                let byte = frame.data().first().copied();
                let data = u32::from(byte.unwrap_or(0));
                let nibbles = (data >> 4) << 16 | data & 0xF;
                let first = 0xFFF0_0000 | if byte.is_some() { 0x000F_000F } else { 0 };
                (word << 16 | word | nibbles, first, 0x0000_FFF0)
            }
            Some(Id::Extended(id)) => {
                let word = id.raw() >> 13;
                (word << 16 | word, 0xFFFF_0000, 0x0000_FFFF)
            }
            None => return false,
        };
        let differs = (seen ^ self.acceptance_code) & !self.acceptance_mask;
        differs & first == 0 || differs & second == 0
    }
}

impl Device for SlcanDevice {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        let listening = matches!(self.channel, Channel::Open | Channel::ListenOnly);
        if !listening || self.state == ControllerState::BusOff {
            return;
        }
        if self.in_tune == Some(false) {
            self.flags.0 |= StatusFlags::BUS_ERROR;
            if self.channel == Channel::Open {
                // A controller stops counting receive errors in error passive.
                let receive = (self.receive_errors + 1).min(128);
                self.set_error_counters(receive, self.transmit_errors);
            }
        } else if self.accepts(frame) {
            self.report(*frame, now);
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        let frame = self.to_bus.pop_front();
        self.work(now);
        frame
    }

    fn poll_timeout(&self) -> Option<Instant> {
        None
    }

    fn handle_timeout(&mut self, _now: Instant) {}
}

/// The bit time, ns, that the registers of an SJA1000 at 16 MHz set.
fn nanos_per_bit(btr0: u8, btr1: u8) -> u32 {
    let prescaler = u32::from(btr0 & 0x3F) + 1;
    let quanta = 3 + u32::from(btr1 & 0xF) + u32::from(btr1 >> 4 & 0x7);
    125 * prescaler * quanta
}

#[cfg(test)]
mod tests;
