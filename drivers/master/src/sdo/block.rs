//! Block transfer of the SDO client.

use can::{Frame, Instant};

use super::{Client, SdoCause, Start, TransferState};
use canopen::cob;
use canopen::sdo::block::{Acknowledge, End, MAX_BLOCK_SIZE, Request, Response, SEGMENT, Segment, checksum};
use canopen::sdo::{self, AbortCode};

/// Objects up to this size, bytes, use ordinary transfer: 2 + 2 m frames for m segments. A block
/// upload takes 6 + m frames, a block download 5 + m.
pub(super) const THRESHOLD: usize = 4 * SEGMENT;

/// The regimes of a block transfer.
///
/// ```text
///   UploadInitiated ──► Upload ◄─► (sub-blocks) ──► UploadEnd
///   DownloadInitiated ──► Download ◄─► (sub-blocks) ──► DownloadEnd
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BlockState {
    UploadInitiated,
    Upload(Receiving),
    /// All segments came; the checksum is due.
    UploadEnd(Receiving),
    DownloadInitiated,
    Download(Sending),
    /// The checksum was sent.
    DownloadEnd,
}

/// A sub-block that the server sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Receiving {
    /// Whether the server sends a checksum.
    crc: bool,
    announced: Option<usize>,
    block_size: u8,
    /// Last segment in order, or 0.
    in_order: u8,
    /// Highest segment received.
    highest: u8,
    /// Successive sub-blocks without a segment in order.
    stalls: u8,
}

/// A sub-block that the client sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Sending {
    /// Whether the server checks the checksum.
    crc: bool,
    /// Maximum number of segments of this sub-block.
    block_size: u8,
    /// Byte offset of its start. Earlier bytes are acknowledged.
    from: usize,
    /// Number of segments sent.
    sent: u8,
    /// Successive acknowledgements of nothing.
    stalls: u8,
}

impl Client {
    pub(super) fn initiate_block_upload(&mut self, now: Instant) {
        self.length = 0;
        self.state = TransferState::Block(BlockState::UploadInitiated);
        let request = Request::InitiateUpload {
            object: self.object,
            crc: true,
            block_size: MAX_BLOCK_SIZE,
            threshold: THRESHOLD as u8,
        };
        self.send(sdo::Request::Block(request), now);
    }

    pub(super) fn initiate_block_download(&mut self, now: Instant) {
        self.state = TransferState::Block(BlockState::DownloadInitiated);
        let request =
            Request::InitiateDownload { object: self.object, crc: true, size: u32::try_from(self.length).ok() };
        self.send(sdo::Request::Block(request), now);
    }

    /// Handles a frame during a block transfer.
    ///
    /// Frames of other transfers and unknown specifiers are ignored: after a restart, segments of the abandoned
    /// sub-block may still arrive.
    pub(super) fn handle_block(&mut self, state: BlockState, frame: &Frame, now: Instant) {
        if let BlockState::Upload(receiving) = state
            && let Some(segment) = Segment::decode(frame, cob::sdo_response(self.node))
        {
            return self.block_segment_received(receiving, segment, now);
        }
        match (state, sdo::Response::decode(frame, self.node)) {
            (_, Some(sdo::Response::Abort { object, code })) if object == self.object => {
                self.aborted(state, code, now);
            }
            (BlockState::UploadInitiated, Some(sdo::Response::InitiateUpload { object, initiate }))
                if object == self.object =>
            {
                self.upload_initiated(initiate, now);
            }
            (_, Some(sdo::Response::Block(response))) => {
                self.handle_block_response(state, response, now);
            }
            _ => {}
        }
    }

    /// Falls back to ordinary transfer if the server refuses block transfer. Repeats a request that the server
    /// took for a segment after a missed abort. Any other abort fails the transfer.
    fn aborted(&mut self, state: BlockState, code: AbortCode, now: Instant) {
        match (state, code) {
            (BlockState::UploadInitiated, AbortCode::COMMAND_SPECIFIER) => {
                self.start = Start::Upload;
            }
            (BlockState::DownloadInitiated, AbortCode::COMMAND_SPECIFIER) => {
                self.start = Start::Download;
            }
            (BlockState::UploadInitiated | BlockState::DownloadInitiated, AbortCode::SEQUENCE_NUMBER)
                if self.retries_left > 0 =>
            {
                self.retries_left -= 1;
            }
            _ => return self.finish(Err(SdoCause::Aborted { code })),
        }
        self.initiate(now);
    }

    fn handle_block_response(&mut self, state: BlockState, response: Response, now: Instant) {
        match (state, response) {
            (BlockState::UploadInitiated, Response::InitiateUpload { object, crc, size }) if object == self.object => {
                if let Ok(announced) = self.announced(size) {
                    self.state = TransferState::Block(BlockState::Upload(Receiving {
                        crc,
                        announced,
                        block_size: MAX_BLOCK_SIZE,
                        in_order: 0,
                        highest: 0,
                        stalls: 0,
                    }));
                    self.send(sdo::Request::Block(Request::StartUpload), now);
                }
            }
            (BlockState::UploadEnd(receiving), Response::EndUpload(end)) => {
                self.block_upload_ended(receiving, end);
            }
            (BlockState::DownloadInitiated, Response::InitiateDownload { object, crc, block_size })
                if object == self.object =>
            {
                let sending = Sending { crc, block_size, from: 0, sent: 0, stalls: 0 };
                self.send_sub_block(sending, now);
            }
            (BlockState::Download(sending), Response::Acknowledge(acknowledge)) if sending.sent > 0 => {
                self.sub_block_acknowledged(sending, acknowledge, now);
            }
            (BlockState::DownloadEnd, Response::EndDownload) => self.finish(Ok(())),
            // A late answer to an earlier request.
            (
                BlockState::UploadInitiated
                | BlockState::Upload(_)
                | BlockState::UploadEnd(_)
                | BlockState::DownloadInitiated
                | BlockState::Download(_)
                | BlockState::DownloadEnd,
                _,
            ) => {}
        }
    }

    fn block_segment_received(&mut self, mut receiving: Receiving, segment: Segment, now: Instant) {
        let sequence = segment.sequence();
        // After a late acknowledgement, segments of the last sub-block may arrive.
        if sequence > receiving.block_size {
            return;
        }
        let in_order = sequence == receiving.in_order + 1;
        if in_order {
            let found = self.length + SEGMENT;
            if let Some(expected) = receiving.announced
                && found > expected.max(1).next_multiple_of(SEGMENT)
            {
                return self.fail(SdoCause::Length { expected, found });
            }
            if found > self.buffer.len() {
                return self.too_large(found);
            }
            self.append(&segment.data);
            receiving.in_order = sequence;
        }
        if in_order || sequence > receiving.highest {
            receiving.highest = receiving.highest.max(sequence);
            self.deadline = now + self.timeout;
        }
        self.state = TransferState::Block(BlockState::Upload(receiving));
        if segment.last || sequence == receiving.block_size {
            self.sub_block_received(receiving, in_order && segment.last, now);
        }
    }

    /// Acknowledges a sub-block; `complete` if the data also end.
    fn sub_block_received(&mut self, mut receiving: Receiving, complete: bool, now: Instant) {
        if receiving.in_order > 0 {
            receiving.stalls = 0;
        } else if receiving.stalls < self.retries {
            receiving.stalls += 1;
        } else {
            return self.start_anew(now);
        }
        let lost = receiving.in_order < receiving.highest;
        self.acknowledge(receiving, lost, now);
        if complete {
            self.state = TransferState::Block(BlockState::UploadEnd(receiving));
        }
    }

    /// Acknowledges the received segments of a sub-block whose end is missing. A segment in order shows that the
    /// server is in this sub-block, and a checksum detects the contrary. Without both, returns false. The block size
    /// halves each time, down to one segment, so this happens at most seven times.
    pub(super) fn acknowledge_overdue(&mut self, receiving: Receiving, now: Instant) -> bool {
        let recovers = receiving.crc && receiving.in_order > 0;
        if recovers {
            self.acknowledge(receiving, true, now);
        }
        recovers
    }

    fn acknowledge(&mut self, receiving: Receiving, lost: bool, now: Instant) {
        let block_size = if lost { receiving.block_size.div_ceil(2) } else { receiving.block_size };
        self.state =
            TransferState::Block(BlockState::Upload(Receiving { block_size, in_order: 0, highest: 0, ..receiving }));
        let acknowledge = Acknowledge { sequence: receiving.in_order, block_size };
        self.send(sdo::Request::Block(Request::Acknowledge(acknowledge)), now);
    }

    fn block_upload_ended(&mut self, receiving: Receiving, end: End) {
        let found = self.length - end.unused();
        let sum = checksum(&self.buffer[..found]);
        match receiving.announced {
            Some(expected) if found != expected => {
                self.fail(SdoCause::Length { expected, found });
            }
            _ if found > self.capacity => self.too_large(found),
            _ if receiving.crc && sum != end.crc => self.fail(SdoCause::Crc { expected: end.crc, found: sum }),
            _ => {
                self.length = found;
                self.finish(Ok(()));
                let end = sdo::Request::Block(Request::EndUpload);
                self.ending = Some(end.encode(self.node));
            }
        }
    }

    /// Starts a sub-block. A size outside 1 ..= 127 fails.
    fn send_sub_block(&mut self, sending: Sending, now: Instant) {
        let block_size = sending.block_size;
        if (1..=MAX_BLOCK_SIZE).contains(&block_size) {
            self.state = TransferState::Block(BlockState::Download(sending));
            self.deadline = now + self.timeout;
        } else {
            self.fail(SdoCause::BlockSize { block_size });
        }
    }

    /// The next segment of the sub-block that is being sent.
    pub(super) fn next_block_segment(&mut self, now: Instant) -> Option<Frame> {
        let TransferState::Block(BlockState::Download(sending)) = &mut self.state else {
            return None;
        };
        let from = sending.from + SEGMENT * usize::from(sending.sent);
        if sending.sent == sending.block_size || from >= self.length {
            return None;
        }
        sending.sent += 1;
        self.deadline = now + self.timeout;
        let data = &self.buffer[from..self.length.min(from + SEGMENT)];
        let mut bytes = [0; SEGMENT];
        bytes[..data.len()].copy_from_slice(data);
        let segment =
            Segment::new(sending.sent, from + SEGMENT >= self.length, bytes).expect("a block size is at most 127");
        Some(segment.encode(cob::sdo_request(self.node)))
    }

    /// Continues the download after the last acknowledged segment.
    ///
    /// After a gap, the server may acknowledge an incomplete sub-block.
    fn sub_block_acknowledged(&mut self, sending: Sending, acknowledge: Acknowledge, now: Instant) {
        let (sequence, sent) = (acknowledge.sequence, sending.sent);
        let from = sending.from + SEGMENT * usize::from(sequence);
        if sequence > sent {
            self.fail(SdoCause::Sequence { sequence, sent });
        } else if from >= self.length {
            let data = &self.buffer[..self.length];
            let crc = if sending.crc { checksum(data) } else { 0 };
            self.state = TransferState::Block(BlockState::DownloadEnd);
            self.send(sdo::Request::Block(Request::EndDownload(End::of(self.length, crc))), now);
        } else if sequence > 0 || sending.stalls < self.retries {
            let stalls = if sequence > 0 { 0 } else { sending.stalls + 1 };
            let sending = Sending { block_size: acknowledge.block_size, from, sent: 0, stalls, ..sending };
            self.send_sub_block(sending, now);
        } else {
            self.start_anew(now);
        }
    }
}

#[cfg(test)]
mod tests;
