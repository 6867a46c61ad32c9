//! Frames of the emulated USB or RS-232 port of an EPOS4.

use can::Instant;
use canopen::sdo::{AbortCode, MAX_SIZE};
use serial::epos4::{Address, Answer, Deframer, Frame, FrameError, LONGEST, MAX_SEGMENT, Request};

use super::{Protocol, Service};

pub(super) struct Frames {
    deframer: Deframer,
    transfer: Option<Transfer>,
    /// Maximum length of a segment sent, bytes.
    segment: u8,
}

struct Transfer {
    address: Address,
    writing: bool,
    object: [u8; MAX_SIZE],
    size: usize,
    done: usize,
    /// Toggle bit expected in the next segment.
    toggle: bool,
}

impl Protocol for Frames {
    fn reset(&mut self) {
        self.deframer.reset();
    }

    fn receive(&mut self, byte: u8, service: &mut Service, now: Instant) {
        let answer = match self.deframer.take(byte) {
            Some(Ok(frame)) => self.serve(&frame, service, now),
            Some(Err(FrameError::Crc | FrameError::TooLong(_))) => Answer::Refused(AbortCode::CRC.0).encode(),
            Some(Err(FrameError::Torn)) | None => return,
        };
        let mut bytes = [0; LONGEST];
        let length = answer.encode(&mut bytes);
        service.send(&bytes[..length], now);
    }
}

impl Frames {
    pub(super) fn new(segment: u8) -> Self {
        Self { deframer: Deframer::new(), transfer: None, segment }
    }

    fn serve(&mut self, frame: &Frame, service: &mut Service, now: Instant) -> Frame {
        let mut segment = [0; MAX_SEGMENT];
        let obeyed = match Request::decode(frame) {
            Some(request) => self.obey(request, &mut segment, service, now),
            None => Err(AbortCode::MAXON_ILLEGAL_COMMAND),
        };
        match obeyed {
            Ok(answer) => answer.encode(),
            Err(code) => {
                self.transfer = None;
                Answer::Refused(code.0).encode()
            }
        }
    }

    fn obey<'s>(
        &mut self,
        request: Request,
        segment: &'s mut [u8; MAX_SEGMENT],
        service: &mut Service,
        now: Instant,
    ) -> Result<Answer<'s>, AbortCode> {
        match request {
            Request::Read(address) => Ok(Answer::Value(service.epos.read_value(address, now)?)),
            Request::Write(address, value) => {
                service.epos.write_value(address, value, now)?;
                Ok(Answer::Done)
            }
            Request::Nmt { node, command } => {
                service.epos.command_nmt(command, node, now)?;
                Ok(Answer::Done)
            }
            Request::InitiateSegmentedRead(address) => {
                let mut transfer = Transfer::new(address, false);
                transfer.size = service.epos.read(address, &mut transfer.object, now)?;
                let first = transfer.take(self.segment, segment);
                let size = transfer.size as u32;
                self.transfer = Some(transfer).filter(|transfer| !transfer.is_complete());
                Ok(Answer::Started(size, first))
            }
            Request::SegmentRead { toggle } => {
                let limit = self.segment;
                let transfer = self.continued(toggle, false)?;
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
                self.transfer = Some(Transfer { size, ..Transfer::new(address, true) });
                Ok(Answer::Done)
            }
            Request::SegmentWrite { toggle, last, data } => {
                self.continued(toggle, true)?.put(data)?;
                if last {
                    let transfer = self.transfer.take().expect("it was continued");
                    if !transfer.is_complete() {
                        return Err(AbortCode::LENGTH_MISMATCH);
                    }
                    let data = &transfer.object[..transfer.size];
                    service.epos.write(transfer.address, data, now)?;
                }
                Ok(Answer::Taken { toggle, length: data.len() as u8 })
            }
        }
    }

    /// The transfer in progress, if a segment in this direction with this toggle bit continues it.
    fn continued(&mut self, toggle: bool, writing: bool) -> Result<&mut Transfer, AbortCode> {
        match &mut self.transfer {
            Some(transfer) if transfer.writing == writing => {
                if transfer.toggle != toggle {
                    return Err(AbortCode::TOGGLE);
                }
                transfer.toggle = !toggle;
                Ok(transfer)
            }
            _ => Err(AbortCode::MAXON_ILLEGAL_COMMAND),
        }
    }
}

impl Transfer {
    fn new(address: Address, writing: bool) -> Self {
        Self { address, writing, object: [0; MAX_SIZE], size: 0, done: 0, toggle: false }
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
