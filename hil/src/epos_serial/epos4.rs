//! Emulated USB or RS-232 port of an EPOS4.

use can::Instant;
use canopen::Object;
use canopen::sdo::{AbortCode, MAX_SIZE};
use serial::epos4::{Address, Answer, Deframer, Frame, FrameError, LONGEST, MAX_SEGMENT, Request};

use super::{EposSerialConfig, Service};
use crate::outbox::Heard;
use crate::{Epos4, LineDevice};

/// The USB or RS-232 port of an EPOS4.
///
/// Every complete frame is answered, an invalid frame with an error code. A torn frame is not answered. A new
/// initiation replaces a segmented transfer in progress. Any error ends the transfer.
pub struct Epos4Serial {
    service: Service,
    deframer: Deframer,
    transfer: Option<Transfer>,
    last: Instant,
}

/// A segmented transfer in progress.
struct Transfer {
    address: Address,
    writing: bool,
    object: [u8; MAX_SIZE],
    size: usize,
    done: usize,
    /// Toggle bit expected in the next segment.
    toggle: bool,
}

impl Epos4Serial {
    /// A port after power-on, with its device.
    pub fn new(config: EposSerialConfig) -> Self {
        Self {
            deframer: Deframer::new(),
            transfer: None,
            last: config.epos.power_on,
            service: Service::new(config),
        }
    }

    /// The device.
    pub fn epos(&self) -> &Epos4 {
        &self.service.epos
    }

    /// Receive counters.
    pub fn heard(&self) -> Heard {
        self.service.heard
    }

    fn answer(&mut self, found: Result<Frame, FrameError>, now: Instant) {
        let answer = match found {
            Ok(frame) => self.serve(&frame, now),
            Err(FrameError::Torn) => {
                self.service.heard.damaged += 1;
                return;
            }
            Err(FrameError::Crc | FrameError::TooLong(_)) => {
                self.service.heard.damaged += 1;
                Answer::Refused(AbortCode::CRC.0).encode()
            }
        };
        let mut bytes = [0; LONGEST];
        let length = answer.encode(&mut bytes);
        self.service.send(&bytes[..length], now);
    }

    fn serve(&mut self, frame: &Frame, now: Instant) -> Frame {
        let mut segment = [0; MAX_SEGMENT];
        let obeyed = match Request::decode(frame) {
            Some(request) => self.obey(request, &mut segment, now),
            None => Err(AbortCode::MAXON_ILLEGAL_COMMAND),
        };
        match obeyed {
            Ok(answer) => {
                self.service.heard.obeyed += 1;
                answer.encode()
            }
            Err(code) => {
                self.service.heard.refused += 1;
                self.transfer = None;
                Answer::Refused(code.0).encode()
            }
        }
    }

    fn obey<'s>(
        &mut self,
        request: Request,
        segment: &'s mut [u8; MAX_SEGMENT],
        now: Instant,
    ) -> Result<Answer<'s>, AbortCode> {
        let object = |address: Address| Object::new(address.index, address.subindex);
        let service = &mut self.service;
        match request {
            Request::Read(address) => {
                let value = service.read(address.node, object(address), now)?;
                Ok(Answer::Value(value))
            }
            Request::Write(address, value) => {
                service.write(address.node, object(address), value, now)?;
                Ok(Answer::Done)
            }
            Request::Nmt { node, command } => {
                service.epos.command_nmt(command, node, now)?;
                Ok(Answer::Done)
            }
            Request::InitiateSegmentedRead(address) => {
                let mut transfer = Transfer::new(address, false);
                let (node, into) = (address.node, &mut transfer.object);
                transfer.size = service.read_whole(node, object(address), into, now)?;
                let first = transfer.take(self.service.config.segment, segment);
                let size = transfer.size as u32;
                self.transfer = Some(transfer).filter(|transfer| !transfer.is_complete());
                Ok(Answer::Started(size, first))
            }
            Request::SegmentRead { toggle } => {
                let transfer = self.continued(toggle, false)?;
                transfer.toggle = !toggle;
                let limit = self.service.config.segment;
                let transfer = self.transfer.as_mut().expect("it was continued");
                let data = transfer.take(limit, segment);
                let last = transfer.is_complete();
                self.transfer.take_if(|_| last);
                Ok(Answer::Segment { toggle, last, data })
            }
            Request::InitiateSegmentedWrite(address, size) => {
                let size = usize::try_from(size).unwrap_or(usize::MAX);
                if size > MAX_SIZE {
                    return Err(AbortCode::OUT_OF_MEMORY);
                }
                let mut transfer = Transfer::new(address, true);
                transfer.size = size;
                self.transfer = Some(transfer);
                Ok(Answer::Done)
            }
            Request::SegmentWrite { toggle, last, data } => {
                let transfer = self.continued(toggle, true)?;
                transfer.toggle = !toggle;
                transfer.put(data)?;
                if last {
                    let transfer = self.transfer.take().expect("it was continued");
                    self.write_transferred(&transfer, now)?;
                }
                Ok(Answer::Taken {
                    toggle,
                    length: data.len() as u8,
                })
            }
        }
    }

    fn write_transferred(&mut self, transfer: &Transfer, now: Instant) -> Result<(), AbortCode> {
        if !transfer.is_complete() {
            return Err(AbortCode::LENGTH_MISMATCH);
        }
        let Address {
            node,
            index,
            subindex,
        } = transfer.address;
        let data = &transfer.object[..transfer.size];
        self.service
            .write_whole(node, Object::new(index, subindex), data, now)
    }

    fn continued(&mut self, toggle: bool, writing: bool) -> Result<&mut Transfer, AbortCode> {
        match &mut self.transfer {
            Some(transfer) if transfer.writing == writing => {
                if transfer.toggle == toggle {
                    Ok(transfer)
                } else {
                    Err(AbortCode::TOGGLE)
                }
            }
            _ => Err(AbortCode::MAXON_ILLEGAL_COMMAND),
        }
    }
}

impl Transfer {
    fn new(address: Address, writing: bool) -> Self {
        Self {
            address,
            writing,
            object: [0; MAX_SIZE],
            size: 0,
            done: 0,
            toggle: false,
        }
    }

    fn is_complete(&self) -> bool {
        self.done == self.size
    }

    /// The next segment of an object that is being read.
    fn take<'s>(&mut self, limit: u8, segment: &'s mut [u8; MAX_SEGMENT]) -> &'s [u8] {
        let rest = &self.object[self.done..self.size];
        let count = rest.len().min(usize::from(limit)).min(MAX_SEGMENT);
        segment[..count].copy_from_slice(&rest[..count]);
        self.done += count;
        &segment[..count]
    }

    /// Stores the next segment of an object that is being written.
    fn put(&mut self, data: &[u8]) -> Result<(), AbortCode> {
        if data.len() > self.size - self.done {
            return Err(AbortCode::LENGTH_MISMATCH);
        }
        self.object[self.done..self.done + data.len()].copy_from_slice(data);
        self.done += data.len();
        Ok(())
    }
}

impl LineDevice for Epos4Serial {
    fn receive(&mut self, byte: u8, now: Instant) {
        self.service.run(now);
        if self.deframer.is_inside() && now.since(self.last) > self.service.config.time_out {
            self.deframer.reset();
            self.service.heard.damaged += 1;
        }
        self.last = now;
        if !self.service.listens() {
            self.service.heard.skipped += 1;
            return;
        }
        match self.deframer.take(byte) {
            Some(found) => self.answer(found, now),
            None if self.deframer.is_inside() => {}
            None => self.service.heard.skipped += 1,
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<u8> {
        self.service.outbox.poll_transmit(now)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.service.poll_timeout()
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.service.run(now);
    }
}
