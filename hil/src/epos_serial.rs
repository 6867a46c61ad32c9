//! The service port of maxon's axis controllers: the object dictionary of an emulated EPOS over a serial line.
//!
//! An [`EposSerial`] speaks [`serial::epos4`] or [`serial::epos2`]. Each port has an [`Epos4`] with an axis of its
//! own, which is connected to no CAN bus. The dictionary served is always that of the EPOS4. The
//! dictionary of a real EPOS2 differs, but shares the objects of CiA 301 and CiA 402.
//!
//! The maxon documents that were read leave the following open. The behaviour is chosen here:
//!
//! * A booting device sends nothing.
//! * In the NMT state stopped, access to objects is refused with 0x0F00_FFC0.
//! * Requests to other nodes are refused with 0x0F00_FFB9, since no bus leads to other nodes.
//! * An EPOS4 answers a frame with a wrong CRC with 0x0504_0004.
//! * An object of more than four bytes can only be read in segments.
//! * Bytes that arrive before the answer to an earlier request are ignored.

mod epos2;
mod epos4;
#[cfg(test)]
mod tests;

use std::time::Duration;

use can::Instant;

use crate::{Device, Epos4, Epos4Config, LineDevice, Mechanism, outbox::Outbox};
use epos2::Exchange;
use epos4::Frames;

/// Time from the last received byte to the first byte of the answer or acknowledgement.
const TURN_AROUND: Duration = Duration::from_micros(100);

/// Configuration of the port of one unit.
#[derive(Clone, Debug)]
pub struct EposSerialConfig {
    /// The device.
    pub epos: Epos4Config,
    /// Maximum length of a segment that an EPOS4 sends, bytes, 1 to [`serial::epos4::MAX_SEGMENT`].
    pub segment: u8,
}

impl EposSerialConfig {
    /// A port that sends segments of the maximum length.
    pub fn new(epos: Epos4Config) -> Self {
        Self { epos, segment: serial::epos4::MAX_SEGMENT as u8 }
    }
}

/// The service port of an axis controller, with its device.
pub struct EposSerial {
    service: Service,
    protocol: Box<dyn Protocol>,
    last: Instant,
}

trait Protocol: Send {
    /// Abandons a frame or an exchange in progress.
    fn reset(&mut self);

    /// Takes a byte, and answers the request that ends with the byte.
    fn receive(&mut self, byte: u8, service: &mut Service, now: Instant);
}

impl EposSerial {
    /// The USB or RS-232 port of an EPOS4 after power-on.
    ///
    /// Every complete frame is answered, an invalid frame with an error code. A torn frame is not answered. A new
    /// initiation replaces a segmented transfer in progress. Any error ends the transfer.
    pub fn epos4(config: EposSerialConfig) -> Self {
        Self::new(Box::new(Frames::new(config.segment)), config.epos)
    }

    /// The RS-232 port of an EPOS2 after power-on.
    ///
    /// An unknown opcode is received to its end and refused with 0x0F00_FFBF.
    pub fn epos2(config: EposSerialConfig) -> Self {
        Self::new(Box::new(Exchange::new()), config.epos)
    }

    fn new(protocol: Box<dyn Protocol>, config: Epos4Config) -> Self {
        Self { service: Service { epos: Epos4::new(config), outbox: Outbox::new() }, protocol, last: Instant::ZERO }
    }
}

impl LineDevice for EposSerial {
    fn receive(&mut self, byte: u8, now: Instant) {
        self.service.run(now);
        // A pause ends a frame or exchange (objects 0x2005, 0x2006).
        if now.since(self.last) > serial::epos4::TIME_OUT {
            self.protocol.reset();
        }
        self.last = now;
        // Bytes are lost during boot, and while an answer is being sent.
        if self.service.epos.has_booted() && self.service.outbox.is_empty() {
            self.protocol.receive(byte, &mut self.service, now);
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<u8> {
        self.service.outbox.poll_transmit(now)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let answers = self.service.outbox.poll_timeout().into_iter();
        answers.chain(self.service.epos.poll_timeout()).min()
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.service.run(now);
    }

    fn advance_mechanics(&mut self, now: Instant) -> bool {
        self.service.epos.advance_mechanics(now)
    }

    fn mechanism(&self) -> Option<&Mechanism> {
        self.service.epos.mechanism()
    }
}

/// The device behind a port, and the bytes on their way to the host.
struct Service {
    epos: Epos4,
    outbox: Outbox,
}

impl Service {
    /// Sends `bytes` after the turn-around.
    fn send(&mut self, bytes: &[u8], now: Instant) {
        self.outbox.put(now + TURN_AROUND, bytes);
    }

    /// Runs the device to `now`. Its CAN frames are dropped.
    fn run(&mut self, now: Instant) {
        self.outbox.run(now);
        if self.epos.poll_timeout().is_some_and(|at| at <= now) {
            self.epos.handle_timeout(now);
        }
        while self.epos.poll_transmit(now).is_some() {}
    }
}
