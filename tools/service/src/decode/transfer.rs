//! SDO channel of one node as a listener sees it: which frames are commands, and which are segments of data.
//!
//! The first byte of a segment of a block transfer takes every value but 0x00 and 0x80. Such a segment therefore looks
//! like any command, and only earlier frames tell the two apart. [`Channel`] follows both directions of the channel
//! through segmented and block transfers. If the earlier frames were not seen, the result is [`Reading::Unknown`] until
//! an exchange fits only one kind of transfer.
//!
//! ```text
//! Idle ──command──▶ Asked ──answer──▶ …Segments, Block(Start ▶ Segments ⇄ Acknowledge ▶ End ▶ Ended) ──▶ Idle
//! any state ──abort──▶ Idle
//! any state ──a segment out of turn, or frames were lost──▶ Unknown ──a fitting exchange, or QUIET──▶ …
//! ```
//!
//! A client that falls silent within a sub-block may continue it or start a new transfer. After [`QUIET`], a frame with
//! the segment number that is due is [`Reading::Unknown`]. Any other command starts a new transfer.

use std::time::Duration;

use can::{Frame, Instant};
use canopen::sdo::block::{self, MAX_BLOCK_SIZE};
use canopen::sdo::{Initiate, Request, Response};
use canopen::{NodeId, Object};

/// Silence of a channel after which neither side waits any longer. The value exceeds the time-outs of SDO clients in
/// use.
pub(super) const QUIET: Duration = Duration::from_secs(1);

/// Meaning of a frame of 8 bytes on the channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reading {
    /// A command, as its command specifier says. The object of the transfer is given if known.
    Command(Option<Object>),
    /// A segment of a block transfer. The object of the transfer is given if known.
    BlockSegment(Option<Object>),
    /// A command or a segment of a block transfer: the start of the transfer was not seen.
    Unknown,
}

/// Sender of a frame. The client sends the data of a download, and the server the data of an upload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    Client,
    Server,
}

#[derive(Clone, Copy, Debug)]
enum SessionState {
    /// A transfer whose start was not seen may be under way. Holds the last frame.
    Unknown(Option<(Side, Frame)>),
    Idle,
    /// A transfer was requested. The answer of the server decides which kind of transfer follows.
    Asked(Asked),
    DownloadSegments {
        object: Option<Object>,
        /// The last segment was seen.
        last: bool,
    },
    UploadSegments(Option<Object>),
    Block(Block),
}

/// Transfer that a client requests.
#[derive(Clone, Copy, Debug)]
enum Asked {
    Expedited(Object),
    DownloadSegments(Object),
    UploadSegments(Object),
    BlockDownload(Object),
    BlockUpload {
        object: Object,
        /// Maximum number of segments in the first sub-block.
        size: u8,
    },
}

/// State of a block transfer.
#[derive(Clone, Copy, Debug)]
struct Block {
    /// Sender of the data.
    sender: Side,
    object: Option<Object>,
    stage: Stage,
    /// Maximum number of segments in the present sub-block.
    size: u8,
    /// Number of segments seen in the present sub-block, all in order.
    sent: u8,
    /// Whether the last segment seen is the last of the transfer.
    last: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// The client of an upload has yet to request the first sub-block.
    Start,
    /// Segments follow.
    Segments,
    /// The sub-block is complete; its acknowledgement is due.
    Acknowledge,
    /// The frame with the checksum is due.
    End,
    /// The checksum was sent; its acknowledgement is due.
    Ended,
}

/// SDO channel of one node.
#[derive(Clone, Debug)]
pub(super) struct Channel {
    node: NodeId,
    state: SessionState,
    /// Time of the last frame, or of the start of listening.
    last: Instant,
}

impl Channel {
    /// A channel without a transfer under way.
    pub(super) fn idle(node: NodeId) -> Self {
        Self { node, state: SessionState::Idle, last: Instant::ZERO }
    }

    /// A channel that is observed since `began`, possibly from the middle of a transfer on.
    pub(super) fn listened_to_since(node: NodeId, began: Instant) -> Self {
        Self { node, state: SessionState::Unknown(None), last: began }
    }

    /// Processes a frame.
    pub(super) fn read(&mut self, side: Side, frame: &Frame, at: Instant) -> Reading {
        let quiet = self.passed(at);
        if first(frame) == ABORT {
            self.state = SessionState::Idle;
            return Reading::Command(None);
        }
        self.resolve(side, frame, quiet);
        match self.state {
            SessionState::Unknown(_) => self.unknown(side, frame),
            SessionState::Block(block) if block.expects(side) => match Asked::of(frame, self.node).filter(|_| quiet) {
                Some(asked) if !block.is_next(frame) => self.ask(asked),
                _ => self.segment(block, side, frame, quiet),
            },
            _ => self.command(side, frame),
        }
    }

    /// Whether the channel was silent for [`QUIET`] before `at`.
    fn passed(&mut self, at: Instant) -> bool {
        let since = at.since(self.last);
        self.last = self.last.max(at);
        since >= QUIET
    }

    /// Leaves the unknown state as soon as the present state is certain: after a silence, or after two frames that fit
    /// only one kind of transfer.
    fn resolve(&mut self, side: Side, frame: &Frame, quiet: bool) {
        let SessionState::Unknown(before) = self.state else {
            return;
        };
        let resolved = match before {
            _ if quiet => Some(SessionState::Idle),
            Some((earlier, before)) if earlier != side => self.answered(earlier, &before, frame),
            _ => None,
        };
        self.state = resolved.unwrap_or(self.state);
    }

    /// State after a frame of `sender` and the answer of the other side, if exactly one state is possible.
    fn answered(&self, sender: Side, frame: &Frame, answer: &Frame) -> Option<SessionState> {
        let asked = Asked::of(frame, self.node);
        if let Some(asked) = asked.filter(|asked| asked.begun(answer, self.node).is_some()) {
            return Some(SessionState::Asked(asked));
        }
        match (sender, first(frame), first(answer)) {
            (Side::Client, 0x00..=0x1F, 0x20 | 0x30) => {
                Some(SessionState::DownloadSegments { object: None, last: is_last_of_segments(frame) })
            }
            (Side::Client, 0x60 | 0x70, 0x00..=0x1F) => Some(SessionState::UploadSegments(None)),
            (Side::Client, 0xA3, 0x01 | 0x81) => Some(Block::at(Side::Server, Stage::Segments, MAX_BLOCK_SIZE)),
            (_, _, ACKNOWLEDGE) => Block::complete(sender, frame, answer),
            (_, end, 0xA1) if is_end(end) => Some(Block::at(sender, Stage::Ended, 0)),
            _ => None,
        }
    }

    fn unknown(&mut self, side: Side, frame: &Frame) -> Reading {
        self.state = SessionState::Unknown(Some((side, *frame)));
        // The segments of a block transfer are numbered from 1.
        if first(frame) == 0 { Reading::Command(None) } else { Reading::Unknown }
    }

    /// Processes a frame within a sub-block from the side that sends the data.
    fn segment(&mut self, mut block: Block, side: Side, frame: &Frame, quiet: bool) -> Reading {
        if !block.is_next(frame) || quiet {
            return self.unknown(side, frame);
        }
        block.sent += 1;
        block.last = first(frame) & LAST != 0;
        if block.last || block.sent == block.size {
            block.stage = Stage::Acknowledge;
        }
        self.state = SessionState::Block(block);
        Reading::BlockSegment(block.object)
    }

    fn ask(&mut self, asked: Asked) -> Reading {
        self.state = SessionState::Asked(asked);
        Reading::Command(None)
    }

    /// Processes a frame that is not a segment of a block transfer.
    fn command(&mut self, side: Side, frame: &Frame) -> Reading {
        if let Some(asked) = Asked::of(frame, self.node) {
            return match self.state {
                // The server may still be sending the sub-block of the previous transfer.
                SessionState::Block(block) if block.expects(Side::Server) => {
                    self.state = SessionState::Unknown(Some((side, *frame)));
                    Reading::Command(None)
                }
                _ => self.ask(asked),
            };
        }
        let (state, object) = match (self.state, side, first(frame)) {
            (SessionState::Asked(asked), Side::Server, _) => (asked.begun(frame, self.node), None),
            (SessionState::DownloadSegments { object, .. }, Side::Client, 0x00..=0x1F) => {
                (Some(SessionState::DownloadSegments { object, last: is_last_of_segments(frame) }), object)
            }
            (SessionState::DownloadSegments { object, last: true }, Side::Server, 0x20 | 0x30) => {
                (Some(SessionState::Idle), object)
            }
            (SessionState::UploadSegments(object), Side::Server, 0x00..=0x1F) if is_last_of_segments(frame) => {
                (Some(SessionState::Idle), object)
            }
            (SessionState::DownloadSegments { object, .. } | SessionState::UploadSegments(object), ..) => {
                (None, object)
            }
            (SessionState::Block(block), ..) => match (block.commanded(side, frame), side) {
                (None, Side::Client) => return self.unknown(side, frame),
                (state, _) => (state, block.object),
            },
            // An answer to a client that has already given up.
            (SessionState::Unknown(_) | SessionState::Idle | SessionState::Asked(_), ..) => (None, None),
        };
        self.state = state.unwrap_or(self.state);
        Reading::Command(object)
    }
}

impl Asked {
    /// Transfer that a frame of the client requests; `None` for all other frames.
    fn of(frame: &Frame, node: NodeId) -> Option<Self> {
        Some(match Request::decode(frame, node)? {
            Request::InitiateDownload { object, initiate } => match initiate {
                Initiate::Expedited(_) => Self::Expedited(object),
                Initiate::Segmented { .. } => Self::DownloadSegments(object),
            },
            Request::InitiateUpload { object } => Self::UploadSegments(object),
            Request::Block(block::Request::InitiateDownload { object, .. }) => Self::BlockDownload(object),
            Request::Block(block::Request::InitiateUpload { object, block_size, .. }) => {
                Self::BlockUpload { object, size: block_size.min(MAX_BLOCK_SIZE) }
            }
            _ => return None,
        })
    }

    /// State of the channel after `answer`; `None` if the frame of the server does not answer this request.
    fn begun(self, answer: &Frame, node: NodeId) -> Option<SessionState> {
        let (asked, object, state) = match (self, Response::decode(answer, node)?) {
            (Self::Expedited(asked), Response::InitiateDownload { object }) => (asked, object, SessionState::Idle),
            (Self::DownloadSegments(asked), Response::InitiateDownload { object }) => {
                (asked, object, SessionState::DownloadSegments { object: Some(object), last: false })
            }
            // A server may answer a request for a block upload with an expedited or segmented upload.
            (
                Self::UploadSegments(asked) | Self::BlockUpload { object: asked, .. },
                Response::InitiateUpload { object, initiate },
            ) => match initiate {
                Initiate::Expedited(_) => (asked, object, SessionState::Idle),
                Initiate::Segmented { .. } => (asked, object, SessionState::UploadSegments(Some(object))),
            },
            (
                Self::BlockDownload(asked),
                Response::Block(block::Response::InitiateDownload { object, block_size, .. }),
            ) => {
                let block =
                    Block { stage: Stage::Segments, size: block_size, ..Block::new(Side::Client, Some(object)) };
                let valid = (1..=MAX_BLOCK_SIZE).contains(&block_size);
                let state = if valid { SessionState::Block(block) } else { SessionState::Idle };
                (asked, object, state)
            }
            (
                Self::BlockUpload { object: asked, size },
                Response::Block(block::Response::InitiateUpload { object, .. }),
            ) => (asked, object, SessionState::Block(Block { size, ..Block::new(Side::Server, Some(object)) })),
            _ => return None,
        };
        (asked == object).then_some(state)
    }
}

impl Block {
    const fn new(sender: Side, object: Option<Object>) -> Self {
        Self { sender, object, stage: Stage::Start, size: 0, sent: 0, last: false }
    }

    /// A transfer of an unknown object at this stage, with sub-blocks of `size` segments.
    const fn at(sender: Side, stage: Stage, size: u8) -> SessionState {
        SessionState::Block(Self { stage, size, ..Self::new(sender, None) })
    }

    /// Whether segments of `side` are due.
    fn expects(self, side: Side) -> bool {
        self.sender == side && self.stage == Stage::Segments
    }

    /// Whether a frame has the segment number that is due.
    fn is_next(self, frame: &Frame) -> bool {
        number(frame) == self.sent + 1
    }

    /// State after a segment of `sender` and `answer`, if the answer acknowledges the segment.
    fn complete(sender: Side, segment: &Frame, answer: &Frame) -> Option<SessionState> {
        let [_, sequence, size, rest @ ..] = answer.data() else {
            return None;
        };
        let fits = *sequence == number(segment) && rest.iter().all(|byte| *byte == 0);
        let block = Self {
            stage: Stage::Acknowledge,
            size: (*size).min(MAX_BLOCK_SIZE),
            sent: *sequence,
            last: first(segment) & LAST != 0,
            ..Self::new(sender, None)
        };
        fits.then_some(SessionState::Block(block))
    }

    /// State after a frame of `side` that is not a segment; `None` if no such frame is due.
    fn commanded(self, side: Side, frame: &Frame) -> Option<SessionState> {
        let to = |stage| Some(SessionState::Block(Self { stage, ..self }));
        match (self.stage, side == self.sender, first(frame)) {
            (Stage::Start, false, 0xA3) => to(Stage::Segments),
            (Stage::Segments | Stage::Acknowledge, false, ACKNOWLEDGE) => Some(self.acknowledged(frame)),
            (Stage::End, true, specifier) if is_end(specifier) => to(Stage::Ended),
            (Stage::Ended, false, 0xA1) => Some(SessionState::Idle),
            // The client ends an upload, although the checksum was not seen.
            (Stage::End, false, 0xA1) if side == Side::Client => Some(SessionState::Idle),
            _ => None,
        }
    }

    /// State after the receiver of a sub-block has acknowledged it.
    fn acknowledged(self, frame: &Frame) -> SessionState {
        let [_, sequence, size, ..] = *frame.data() else {
            return SessionState::Unknown(None);
        };
        if sequence == self.sent && self.last {
            return SessionState::Block(Self { stage: Stage::End, ..self });
        }
        if sequence > self.sent || !(1..=MAX_BLOCK_SIZE).contains(&size) {
            return SessionState::Unknown(None);
        }
        SessionState::Block(Self { stage: Stage::Segments, size, sent: 0, last: false, ..self })
    }
}

const ABORT: u8 = 0x80;
const ACKNOWLEDGE: u8 = 0xA2;
/// Bit of the first byte that marks the last segment of a block transfer.
const LAST: u8 = 0x80;

fn first(frame: &Frame) -> u8 {
    frame.data().first().copied().unwrap_or(0)
}

/// Segment number of a frame that is read as a segment of a block transfer.
pub(super) fn number(frame: &Frame) -> u8 {
    first(frame) & !LAST
}

/// Whether a frame that is read as a segment of a block transfer is the last segment.
pub(super) fn is_last(frame: &Frame) -> bool {
    first(frame) & LAST != 0
}

/// Whether an ordinary segment is the last of its transfer.
fn is_last_of_segments(frame: &Frame) -> bool {
    first(frame) & 1 != 0
}

/// Whether a first byte is the command specifier of a checksum frame, `110n nn01`.
fn is_end(first: u8) -> bool {
    first & 0b1110_0011 == 0xC1
}
