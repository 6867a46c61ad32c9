//! SDO client: expedited, segmented and block transfer (CiA 301 §7.2.4.3).

use std::time::Duration;

use can::{Frame, Instant};

use canopen::sdo::block::SEGMENT;
use canopen::sdo::{Expedited, Initiate, Request, Response, Segment, Write};
use canopen::{NodeId, Object};

mod block;
mod error;
mod transfer;

pub use error::{SdoCause, SdoError, StartError};
pub use transfer::{Number, Transfer};

/// The longest object that a client of [`Client::new`] transfers, bytes.
pub const CAPACITY: usize = 256;

/// Reads and writes the objects of one node, one at a time.
///
/// ```text
///          upload              InitiateUpload                 last UploadSegment
///   Idle ─────────► UploadInitiated ───────► UploadSegments ───────────────────► Finished
///    │                     └──────── expedited ─────────────────────────────────►   │
///    │ download            InitiateDownload             last DownloadSegment        │
///    ├───────────► DownloadInitiated ───────► DownloadSegments ─────────────────►   │
///    │                     └──────── expedited ─────────────────────────────────►   │
///    │ block_upload, block_download                                                 │
///    ├───────────► Block ───────────────────────────────────────────────────────►   │
///    └◄───────────────────────────────────────────────────────────────────── poll ──┘
/// ```
///
/// The deadline of each answer is `timeout` after its request. The first deadline counts from the call that starts the
/// transfer. After a missing answer the client sends an abort (0x0504_0000) and restarts the transfer, `retries` times.
/// Then the transfer fails. An abort of the server and a violation of the protocol fail the transfer at once.
///
/// An answer of another object, of the other direction or of another step is a late answer to an earlier request, and is
/// ignored. SDO requests have no number. An answer after its time-out therefore counts as the answer to the retry, or to the next
/// equal request. Read important values back.
///
/// [Block transfer](canopen::sdo::block) sends up to 127 frames for one answer. [`Client::poll_transmit`] returns one frame
/// per call. A caller with a short transmit queue takes as many frames as the queue holds, and continues when they are sent.
/// * The client falls back to an ordinary transfer if the server refuses block transfer (0x0504_0001). It uses an ordinary
///   transfer for up to 28 bytes, where block transfer saves at most a frame.
/// * The receiver of the data recovers lost segments. It acknowledges the segments that came in order, and the others are
///   sent again. If the end of a sub-block is missing, the acknowledgement follows after `timeout`.
/// * As receiver, the client halves the size of its sub-blocks at each loss, since a queue on the way may be too short.
///   After `retries` successive sub-blocks without any segment the transfer restarts as above.
/// * A wrong checksum fails the transfer (0x0504_0004). The data of a server without checksum are not checked. A missing
///   end of a sub-block of such a server restarts the transfer.
#[derive(Clone, Debug)]
pub struct Client {
    node: NodeId,
    timeout: Duration,
    retries: u8,
    state: TransferState,
    start: Start,
    object: Object,
    capacity: usize,
    /// `capacity` bytes, rounded up to whole segments.
    buffer: Box<[u8]>,
    /// Bytes received by an upload, or to be sent by a download.
    length: usize,
    /// Whether `length` is the object's, and not just the four bytes of an expedited frame.
    exact: bool,
    started: Instant,
    deadline: Instant,
    retries_left: u8,
    /// What ends a transfer; it goes before the request of the next.
    ending: Option<Frame>,
    request: Option<Frame>,
}

/// How the transfer starts, and starts anew after a time-out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Start {
    Upload,
    Download,
    BlockUpload,
    BlockDownload,
}

/// `toggle` is the toggle bit of the segment asked for or in flight, `announced` the size that the server gave, and `sent`
/// the number of bytes up to the end of the segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TransferState {
    Idle,
    UploadInitiated,
    UploadSegments { toggle: bool, announced: Option<usize> },
    DownloadInitiated,
    DownloadSegments { toggle: bool, sent: usize },
    Block(block::BlockState),
    Finished(Result<(), SdoCause>),
}

impl Client {
    /// A client of the server `node`. It waits `timeout` for each answer, and restarts a transfer up to `retries` times.
    pub fn new(node: NodeId, timeout: Duration, retries: u8) -> Self {
        Self::with_capacity(node, timeout, retries, CAPACITY)
    }

    /// One that transfers objects of up to `capacity` bytes, for which it allocates here and nowhere else.
    pub fn with_capacity(node: NodeId, timeout: Duration, retries: u8, capacity: usize) -> Self {
        Self {
            node,
            timeout,
            retries,
            state: TransferState::Idle,
            start: Start::Upload,
            object: Object::new(0, 0),
            capacity,
            buffer: vec![0; capacity.next_multiple_of(SEGMENT)].into(),
            length: 0,
            exact: true,
            started: Instant::ZERO,
            deadline: Instant::FAR_FUTURE,
            retries_left: 0,
            ending: None,
            request: None,
        }
    }

    /// The server.
    pub fn node(&self) -> NodeId {
        self.node
    }

    /// Starts to read `object`.
    pub fn upload(&mut self, object: Object, now: Instant) -> Result<(), StartError> {
        self.begin(object, Start::Upload, &[], now)
    }

    /// Starts to write a number.
    pub fn write(&mut self, write: Write, now: Instant) -> Result<(), StartError> {
        self.download(write.object, write.data.data(), now)
    }

    /// Starts to write `data` to `object`: expedited if it has 1 to 4 bytes, else segmented.
    pub fn download(&mut self, object: Object, data: &[u8], now: Instant) -> Result<(), StartError> {
        self.begin(object, Start::Download, data, now)
    }

    /// Starts to read `object` by block transfer.
    pub fn block_upload(&mut self, object: Object, now: Instant) -> Result<(), StartError> {
        self.begin(object, Start::BlockUpload, &[], now)
    }

    /// Starts to write `data` to `object` by block transfer.
    pub fn block_download(&mut self, object: Object, data: &[u8], now: Instant) -> Result<(), StartError> {
        let start = if data.len() <= block::THRESHOLD { Start::Download } else { Start::BlockDownload };
        self.begin(object, start, data, now)
    }

    /// Drops the transfer in progress and sends no abort: the server has booted.
    pub fn reset(&mut self) {
        self.state = TransferState::Idle;
        self.ending = None;
        self.request = None;
    }

    /// Takes a frame from the bus; frames of other nodes are ignored.
    pub fn handle(&mut self, frame: &Frame, now: Instant) {
        match (self.state, Response::decode(frame, self.node)) {
            (TransferState::Idle | TransferState::Finished(_), _) => {}
            (TransferState::Block(state), _) => self.handle_block(state, frame, now),
            (_, Some(response)) => self.handle_response(response, now),
            (_, None) => {}
        }
    }

    /// The next frame to send, if any: what ends a transfer before what begins the next.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        self.ending.take().or_else(|| self.request.take()).or_else(|| self.next_block_segment(now))
    }

    /// When the answer is due that it waits for, or the next segment of a sub-block is to be sent.
    pub fn poll_timeout(&self) -> Option<Instant> {
        match self.state {
            TransferState::Idle | TransferState::Finished(_) => None,
            TransferState::UploadInitiated
            | TransferState::UploadSegments { .. }
            | TransferState::DownloadInitiated
            | TransferState::DownloadSegments { .. }
            | TransferState::Block(_) => Some(self.deadline),
        }
    }

    /// Recovers, restarts or fails the transfer if the answer is overdue at `now`.
    pub fn handle_timeout(&mut self, now: Instant) {
        if self.poll_timeout().is_none_or(|deadline| now < deadline) {
            return;
        }
        if let TransferState::Block(block::BlockState::Upload(receiving)) = self.state
            && self.acknowledge_overdue(receiving, now)
        {
            return;
        }
        self.start_anew(now);
    }

    /// The result of the transfer, once; then the next may be started.
    pub fn poll(&mut self) -> Option<Result<Transfer<'_>, SdoError>> {
        let TransferState::Finished(result) = self.state else {
            return None;
        };
        self.state = TransferState::Idle;
        let transfer = Transfer { object: self.object, data: &self.buffer[..self.length], exact: self.exact };
        Some(result.map(|()| transfer).map_err(|cause| cause.of(self.object)))
    }

    fn begin(&mut self, object: Object, start: Start, data: &[u8], now: Instant) -> Result<(), StartError> {
        if self.state != TransferState::Idle {
            return Err(StartError::Busy { object: self.object });
        }
        if data.len() > self.capacity {
            return Err(StartError::TooLarge { object, size: data.len(), capacity: self.capacity });
        }
        self.object = object;
        self.start = start;
        self.buffer[..data.len()].copy_from_slice(data);
        self.length = data.len();
        self.started = now;
        self.retries_left = self.retries;
        self.initiate(now);
        Ok(())
    }

    /// Sends the first frame of the transfer.
    fn initiate(&mut self, now: Instant) {
        let object = self.object;
        self.exact = true;
        match self.start {
            Start::Upload => {
                self.length = 0;
                self.state = TransferState::UploadInitiated;
                self.send(Request::InitiateUpload { object }, now);
            }
            Start::Download => {
                let initiate = match self.expedited() {
                    Some(data) => Initiate::Expedited(data),
                    None => Initiate::Segmented { size: u32::try_from(self.length).ok() },
                };
                self.state = TransferState::DownloadInitiated;
                self.send(Request::InitiateDownload { object, initiate }, now);
            }
            Start::BlockUpload => self.initiate_block_upload(now),
            Start::BlockDownload => self.initiate_block_download(now),
        }
    }

    /// Aborts, and starts anew while there are retries left.
    fn start_anew(&mut self, now: Instant) {
        let waited = now.since(self.started);
        self.fail(SdoCause::TimedOut { waited });
        if self.retries_left > 0 {
            self.retries_left -= 1;
            self.initiate(now);
        }
    }

    fn handle_response(&mut self, response: Response, now: Instant) {
        match (self.state, response) {
            (_, Response::Abort { object, code }) if object == self.object => {
                self.finish(Err(SdoCause::Aborted { code }));
            }
            (_, Response::Block(_) | Response::Unsupported(_)) => {
                let specifier = response.encode(self.node).data()[0];
                self.fail(SdoCause::Specifier { specifier });
            }
            (TransferState::UploadInitiated, Response::InitiateUpload { object, initiate })
                if object == self.object =>
            {
                self.upload_initiated(initiate, now);
            }
            (TransferState::UploadSegments { toggle, announced }, Response::UploadSegment(segment)) => {
                self.segment_received(&segment, toggle, announced, now);
            }
            (TransferState::DownloadInitiated, Response::InitiateDownload { object }) if object == self.object => {
                if self.expedited().is_some() {
                    self.finish(Ok(()));
                } else {
                    self.send_segment(0, false, now);
                }
            }
            (TransferState::DownloadSegments { toggle, sent }, Response::DownloadSegment { toggle: taken }) => {
                if taken != toggle {
                    self.fail(SdoCause::Toggle);
                } else if sent == self.length {
                    self.finish(Ok(()));
                } else {
                    self.send_segment(sent, !toggle, now);
                }
            }
            // A late answer to an earlier request.
            (
                TransferState::Idle
                | TransferState::UploadInitiated
                | TransferState::UploadSegments { .. }
                | TransferState::DownloadInitiated
                | TransferState::DownloadSegments { .. }
                | TransferState::Block(_)
                | TransferState::Finished(_),
                _,
            ) => {}
        }
    }

    /// The data to write, if they fit into the first frame.
    fn expedited(&self) -> Option<Expedited> {
        Expedited::new(&self.buffer[..self.length])
    }

    fn upload_initiated(&mut self, initiate: Initiate, now: Instant) {
        match initiate {
            Initiate::Expedited(data) if data.data().len() <= self.capacity => {
                self.exact = data.size_given();
                self.append(data.data());
                self.finish(Ok(()));
            }
            Initiate::Expedited(data) => self.too_large(data.data().len()),
            Initiate::Segmented { size } => {
                if let Ok(announced) = self.announced(size) {
                    self.state = TransferState::UploadSegments { toggle: false, announced };
                    self.send(Request::UploadSegment { toggle: false }, now);
                }
            }
        }
    }

    /// The size that the server announced; fails the transfer if there is no room for it.
    fn announced(&mut self, size: Option<u32>) -> Result<Option<usize>, ()> {
        let size = size.map(|size| usize::try_from(size).unwrap_or(usize::MAX));
        match size {
            Some(size) if size > self.capacity => {
                self.too_large(size);
                Err(())
            }
            size => Ok(size),
        }
    }

    fn segment_received(&mut self, segment: &Segment, toggle: bool, announced: Option<usize>, now: Instant) {
        let found = self.length + segment.data().len();
        if segment.toggle != toggle {
            self.fail(SdoCause::Toggle);
        } else if segment.data().is_empty() && !segment.last {
            self.fail(SdoCause::EmptySegment);
        } else if let Some(expected) = announced
            && (found > expected || segment.last && found < expected)
        {
            self.fail(SdoCause::Length { expected, found });
        } else if found > self.capacity {
            self.too_large(found);
        } else {
            self.append(segment.data());
            if segment.last {
                self.finish(Ok(()));
            } else {
                self.state = TransferState::UploadSegments { toggle: !toggle, announced };
                self.send(Request::UploadSegment { toggle: !toggle }, now);
            }
        }
    }

    fn send_segment(&mut self, from: usize, toggle: bool, now: Instant) {
        let sent = self.length.min(from + SEGMENT);
        let segment = Segment::new(&self.buffer[from..sent], toggle, sent == self.length);
        self.state = TransferState::DownloadSegments { toggle, sent };
        self.send(Request::DownloadSegment(segment.expect("at most 7 bytes were taken")), now);
    }

    /// Keeps data that were found to fit.
    fn append(&mut self, data: &[u8]) {
        self.buffer[self.length..][..data.len()].copy_from_slice(data);
        self.length += data.len();
    }

    fn send(&mut self, request: Request, now: Instant) {
        self.request = Some(request.encode(self.node));
        self.deadline = now + self.timeout;
    }

    fn too_large(&mut self, size: usize) {
        let capacity = self.capacity;
        self.fail(SdoCause::TooLarge { size, capacity });
    }

    fn fail(&mut self, cause: SdoCause) {
        let (object, code) = (self.object, cause.abort_code());
        self.ending = Some(Request::Abort { object, code }.encode(self.node));
        self.finish(Err(cause));
    }

    fn finish(&mut self, result: Result<(), SdoCause>) {
        self.request = None;
        self.state = TransferState::Finished(result);
    }
}

#[cfg(test)]
mod tests;
