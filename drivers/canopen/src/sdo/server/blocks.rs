//! The server's side of block transfer.

use can::{Frame, Instant};

use super::{Dictionary, Direction, Server, check_download};
use crate::sdo::block::{self, Acknowledge, End, MAX_BLOCK_SIZE, SEGMENT, Segment};
use crate::sdo::{AbortCode, Response};
use crate::{NodeId, Object, cob};

/// A download by blocks; the transfer's `done` counts whole segments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Download {
    size: Option<usize>,
    /// Whether the client makes the checksum.
    crc: bool,
    /// The last segment of the sub-block that came in order; 0 for none.
    sequence: u8,
    /// Whether the last segment of all has come.
    complete: bool,
}

/// An upload by blocks; the transfer's `done` counts what the client has acknowledged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Upload {
    size: usize,
    /// Whether the client checks the checksum.
    crc: bool,
    block_size: u8,
    /// Segments of the sub-block that were sent.
    sent: u8,
    phase: Phase,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// The client has been told the size.
    Offered,
    Sending,
    /// The sub-block is out.
    Sent,
    /// The client has been told the checksum.
    Ended,
}

impl Server {
    /// The next segment of an upload by blocks. A sub-block may be more than a controller can take at once:
    /// what is not asked for waits.
    pub fn poll_transmit(&mut self, node: NodeId, now: Instant) -> Option<Frame> {
        let transfer = self.transfer.as_mut()?;
        let Direction::BlockUpload(upload) = &mut transfer.direction else {
            return None;
        };
        if upload.phase != Phase::Sending {
            return None;
        }
        let from = transfer.done + usize::from(upload.sent) * SEGMENT;
        let to = upload.size.min(from + SEGMENT);
        let mut data = [0; SEGMENT];
        data[..to - from].copy_from_slice(&self.buffer[from..to]);
        upload.sent += 1;
        let last = to == upload.size;
        if last || upload.sent == upload.block_size {
            upload.phase = Phase::Sent;
        }
        transfer.deadline = now + self.time_out;
        let segment = Segment::new(upload.sent, last, data).expect("a block size is 1 to 127");
        Some(segment.encode(cob::sdo_response(node)))
    }

    /// Whether a sub-block of an upload is on its way: [`Server::poll_transmit`] has segments.
    pub fn transmits(&self) -> bool {
        let direction = self.transfer.map(|transfer| transfer.direction);
        matches!(direction, Some(Direction::BlockUpload(upload)) if upload.phase == Phase::Sending)
    }

    /// Whether the next frame may be a segment of a download by blocks.
    pub(super) fn receives_blocks(&self) -> bool {
        let direction = self.transfer.map(|transfer| transfer.direction);
        matches!(direction, Some(Direction::BlockDownload(download)) if !download.complete)
    }

    /// Takes a request of block transfer. Returns the object that an abort names, and the answer.
    pub(super) fn handle_block<D: Dictionary>(
        &mut self,
        request: block::Request,
        dictionary: &mut D,
        now: Instant,
    ) -> (Object, Result<Option<Response>, AbortCode>) {
        let transferred = self.object();
        match request {
            block::Request::InitiateDownload { object, crc, size } => {
                let answer = self.begin_download(object, crc, size, dictionary, now);
                (object, answer.map(Some))
            }
            block::Request::InitiateUpload { object, crc, block_size, threshold } => {
                let upload = Upload { size: 0, crc, block_size, sent: 0, phase: Phase::Offered };
                let answer = self.begin_upload(object, upload, threshold, dictionary, now);
                (object, answer.map(Some))
            }
            block::Request::EndDownload(end) => (transferred, self.end_download(end, dictionary).map(Some)),
            block::Request::StartUpload => (transferred, self.start_upload(now).map(|()| None)),
            block::Request::Acknowledge(acknowledge) => (transferred, self.acknowledged(acknowledge, now)),
            block::Request::EndUpload => (transferred, self.end_upload().map(|()| None)),
        }
    }

    fn begin_download<D: Dictionary>(
        &mut self,
        object: Object,
        crc: bool,
        size: Option<u32>,
        dictionary: &D,
        now: Instant,
    ) -> Result<Response, AbortCode> {
        self.transfer = None;
        let download = Download { size: check_download(object, size, dictionary)?, crc, sequence: 0, complete: false };
        self.begin(object, Direction::BlockDownload(download), now);
        Ok(Response::Block(block::Response::InitiateDownload { object, crc: true, block_size: self.block_size }))
    }

    /// Takes a segment that comes in order, and acknowledges the segments at the end of the sub-block.
    pub(super) fn append(&mut self, segment: Segment, now: Instant) -> Result<Option<Response>, AbortCode> {
        let transfer = self.transfer.as_mut().ok_or(AbortCode::COMMAND_SPECIFIER)?;
        let Direction::BlockDownload(download) = &mut transfer.direction else {
            return Err(AbortCode::COMMAND_SPECIFIER);
        };
        if segment.sequence() > self.block_size {
            return Err(AbortCode::SEQUENCE_NUMBER);
        }
        transfer.deadline = now + self.time_out;
        if segment.sequence() == download.sequence + 1 {
            let end = transfer.done + SEGMENT;
            if download.size.is_some_and(|size| end >= size + SEGMENT && end > SEGMENT) {
                return Err(AbortCode::TOO_LONG);
            }
            self.buffer.get_mut(transfer.done..end).ok_or(AbortCode::OUT_OF_MEMORY)?.copy_from_slice(&segment.data);
            transfer.done = end;
            download.sequence += 1;
            download.complete = segment.last;
        }
        let ends = segment.last || segment.sequence() == self.block_size;
        let acknowledge =
            ends.then(|| Acknowledge { sequence: std::mem::take(&mut download.sequence), block_size: self.block_size });
        Ok(acknowledge.map(|taken| Response::Block(block::Response::Acknowledge(taken))))
    }

    fn end_download<D: Dictionary>(&mut self, end: End, dictionary: &mut D) -> Result<Response, AbortCode> {
        let transfer = self.transfer.ok_or(AbortCode::COMMAND_SPECIFIER)?;
        let download = match transfer.direction {
            Direction::BlockDownload(download) if download.complete => download,
            _ => return Err(AbortCode::COMMAND_SPECIFIER),
        };
        // One segment came at least, and no more of it is unused than it has.
        let data = &self.buffer[..transfer.done - end.unused()];
        match download.size {
            Some(size) if data.len() > size => return Err(AbortCode::TOO_LONG),
            Some(size) if data.len() < size => return Err(AbortCode::TOO_SHORT),
            _ => {}
        }
        if download.crc && block::checksum(data) != end.crc {
            return Err(AbortCode::CRC);
        }
        dictionary.write(transfer.object, data)?;
        self.transfer = None;
        Ok(Response::Block(block::Response::EndDownload))
    }

    fn begin_upload<D: Dictionary>(
        &mut self,
        object: Object,
        upload: Upload,
        threshold: u8,
        dictionary: &mut D,
        now: Instant,
    ) -> Result<Response, AbortCode> {
        self.transfer = None;
        check_block_size(upload.block_size)?;
        let size = dictionary.read(object, &mut self.buffer)?;
        if threshold > 0 && size <= usize::from(threshold) {
            return self.upload(object, dictionary, now);
        }
        let upload = Upload { size, ..upload };
        self.begin(object, Direction::BlockUpload(upload), now);
        Ok(Response::Block(block::Response::InitiateUpload {
            object,
            // The server has offered the checksum. A client that did not ask for it may check it nevertheless.
            crc: upload.crc,
            size: Some(size as u32),
        }))
    }

    /// The upload in progress. The time-out of the client restarts.
    fn upload_by_blocks(&mut self, now: Instant) -> Result<(&mut Upload, &mut usize), AbortCode> {
        let transfer = self.transfer.as_mut().ok_or(AbortCode::COMMAND_SPECIFIER)?;
        transfer.deadline = now + self.time_out;
        match &mut transfer.direction {
            Direction::BlockUpload(upload) => Ok((upload, &mut transfer.done)),
            _ => Err(AbortCode::COMMAND_SPECIFIER),
        }
    }

    fn start_upload(&mut self, now: Instant) -> Result<(), AbortCode> {
        let (upload, _) = self.upload_by_blocks(now)?;
        if upload.phase != Phase::Offered {
            return Err(AbortCode::COMMAND_SPECIFIER);
        }
        upload.phase = Phase::Sending;
        Ok(())
    }

    /// Goes on behind what came in order, or ends.
    fn acknowledged(&mut self, acknowledge: Acknowledge, now: Instant) -> Result<Option<Response>, AbortCode> {
        let Acknowledge { sequence, block_size } = acknowledge;
        let (upload, done) = self.upload_by_blocks(now)?;
        if !matches!(upload.phase, Phase::Sending | Phase::Sent) {
            return Err(AbortCode::COMMAND_SPECIFIER);
        }
        if sequence > upload.sent {
            return Err(AbortCode::SEQUENCE_NUMBER);
        }
        *done += usize::from(sequence) * SEGMENT;
        upload.sent = 0;
        if sequence == 0 || *done < upload.size {
            check_block_size(block_size)?;
            upload.block_size = block_size;
            upload.phase = Phase::Sending;
            return Ok(None);
        }
        upload.phase = Phase::Ended;
        let (size, checked) = (upload.size, upload.crc);
        let sum = checked.then(|| block::checksum(&self.buffer[..size]));
        let crc = sum.unwrap_or(0);
        let end = block::Response::EndUpload(End::of(size, crc));
        Ok(Some(Response::Block(end)))
    }

    fn end_upload(&mut self) -> Result<(), AbortCode> {
        let direction = self.transfer.map(|transfer| transfer.direction);
        match direction {
            Some(Direction::BlockUpload(upload)) if upload.phase == Phase::Ended => {
                self.transfer = None;
                Ok(())
            }
            _ => Err(AbortCode::COMMAND_SPECIFIER),
        }
    }
}

fn check_block_size(block_size: u8) -> Result<(), AbortCode> {
    if (1..=MAX_BLOCK_SIZE).contains(&block_size) { Ok(()) } else { Err(AbortCode::BLOCK_SIZE) }
}

#[cfg(test)]
mod tests;
