use std::time::Duration;

use can::{Frame, Instant};
use thiserror::Error;

use super::{AbortCode, Expedited, Initiate, Request, Response, Segment, Write};
use crate::{NodeId, Object};

/// The longest object a [`Client`] transfers, bytes.
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
///    └◄───────────────────────────────────────────────────────────────────── poll ──┘
/// ```
///
/// Each answer has `timeout` to come; the first frame counts from the call that starts the transfer.
/// A missing answer is met by an abort (0x0504_0000) and a fresh start, `retries` times; then
/// the transfer fails. An abort by the server or a broken protocol fails it at once.
///
/// Answers of another object, of the other direction or of another step are late ones of an
/// earlier request and are passed over. SDO numbers no request: an answer that comes after
/// its time-out is taken for that of the retry, or of the next equal request. Read back what matters.
///
/// Block transfer is left out; it would be further states beside the segmented ones.
#[derive(Clone, Debug)]
pub struct Client {
    node: NodeId,
    timeout: Duration,
    retries: u8,
    state: State,
    object: Object,
    buffer: [u8; CAPACITY],
    /// Bytes received by an upload, or to be sent by a download.
    length: usize,
    /// Whether `length` is the object's, and not just the four bytes of an expedited frame.
    exact: bool,
    started: Instant,
    deadline: Instant,
    retries_left: u8,
    abort: Option<Frame>,
    request: Option<Frame>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Idle,
    UploadInitiated,
    /// `toggle` is that of the segment asked for, `announced` the size the server gave.
    UploadSegments {
        toggle: bool,
        announced: Option<usize>,
    },
    DownloadInitiated,
    /// `toggle` is that of the segment in flight, `sent` the bytes up to its end.
    DownloadSegments {
        toggle: bool,
        sent: usize,
    },
    Finished(Result<(), SdoError>),
}

/// Why a transfer was not started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum StartError {
    /// A transfer is under way, or its result was not taken.
    #[error("{object} is being transferred")]
    Busy {
        /// The object of that transfer.
        object: Object,
    },
    /// More data than [`CAPACITY`].
    #[error("{object} would take {size} bytes, at most {CAPACITY} are transferred")]
    TooLarge {
        /// The object to write.
        object: Object,
        /// Bytes given.
        size: usize,
    },
}

/// Why a transfer failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum SdoError {
    /// The server aborted.
    #[error("{object} aborted by the server: {code}")]
    Aborted {
        /// The object.
        object: Object,
        /// Why.
        code: AbortCode,
    },
    /// No answer, for all the retries.
    #[error("{object} timed out after {waited:?}")]
    TimedOut {
        /// The object.
        object: Object,
        /// Since the transfer was started.
        waited: Duration,
    },
    /// A segment came or was confirmed twice, or one is missing.
    #[error("{object}: toggle bit did not alternate")]
    Toggle {
        /// The object.
        object: Object,
    },
    /// A segment without data that is not the last, so that the transfer might never end.
    #[error("{object}: empty segment")]
    EmptySegment {
        /// The object.
        object: Object,
    },
    /// An answer that is none of expedited and segmented transfer.
    #[error("{object}: unexpected command specifier {specifier:#04x}")]
    Specifier {
        /// The object.
        object: Object,
        /// Byte 0 of the answer.
        specifier: u8,
    },
    /// The object is longer than [`CAPACITY`].
    #[error("{object} has at least {size} bytes, at most {CAPACITY} are transferred")]
    TooLarge {
        /// The object.
        object: Object,
        /// Bytes known of.
        size: usize,
    },
    /// The server sent more or fewer bytes than it announced, or than the reader's type has.
    #[error("{object} has {found} bytes, expected {expected}")]
    Length {
        /// The object.
        object: Object,
        /// Bytes announced, or of the type asked for.
        expected: usize,
        /// Bytes received.
        found: usize,
    },
}

/// A transfer that succeeded: what was read, or what was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer<'a> {
    /// The object.
    pub object: Object,
    /// Its data.
    pub data: &'a [u8],
    exact: bool,
}

impl Transfer<'_> {
    /// The data as a number of the object's type.
    ///
    /// Lengths must agree. From a server that does not give sizes the first bytes of four are taken.
    pub fn number<T: Number>(&self) -> Result<T, SdoError> {
        let longer = !self.exact && self.data.len() > T::BYTES;
        let data = if longer {
            &self.data[..T::BYTES]
        } else {
            self.data
        };
        T::from_le(data).ok_or(SdoError::Length {
            object: self.object,
            expected: T::BYTES,
            found: data.len(),
        })
    }
}

/// The integers that objects are read as.
pub trait Number: Sized {
    /// Its size.
    const BYTES: usize;
    /// `None` unless there are as many bytes as it has.
    fn from_le(data: &[u8]) -> Option<Self>;
}

macro_rules! number {
    ($($number:ty),*) => {
        $(impl Number for $number {
            const BYTES: usize = size_of::<Self>();
            fn from_le(data: &[u8]) -> Option<Self> {
                Some(Self::from_le_bytes(data.try_into().ok()?))
            }
        })*
    };
}
number!(u8, u16, u32, u64, i8, i16, i32, i64);

impl Client {
    /// A client of the server `node` that waits `timeout` for each answer and starts a transfer anew
    /// `retries` times.
    pub fn new(node: NodeId, timeout: Duration, retries: u8) -> Self {
        Self {
            node,
            timeout,
            retries,
            state: State::Idle,
            object: Object::new(0, 0),
            buffer: [0; CAPACITY],
            length: 0,
            exact: true,
            started: Instant::ZERO,
            deadline: Instant::FAR_FUTURE,
            retries_left: 0,
            abort: None,
            request: None,
        }
    }

    /// The server.
    pub fn node(&self) -> NodeId {
        self.node
    }

    /// Starts to read `object`.
    pub fn upload(&mut self, object: Object, now: Instant) -> Result<(), StartError> {
        self.begin(object, State::UploadInitiated, &[], now)
    }

    /// Starts to write a number.
    pub fn write(&mut self, write: Write, now: Instant) -> Result<(), StartError> {
        self.download(write.object, write.data.data(), now)
    }

    /// Starts to write `data` to `object`: expedited if it has 1 to 4 bytes, else segmented.
    pub fn download(
        &mut self,
        object: Object,
        data: &[u8],
        now: Instant,
    ) -> Result<(), StartError> {
        if data.len() > CAPACITY {
            return Err(StartError::TooLarge {
                object,
                size: data.len(),
            });
        }
        self.begin(object, State::DownloadInitiated, data, now)
    }

    /// Takes a frame from the bus; frames of others are passed over.
    pub fn handle(&mut self, frame: &Frame, now: Instant) {
        let Some(response) = Response::decode(frame, self.node) else {
            return;
        };
        match (self.state, response) {
            (State::Idle | State::Finished(_), _) => {}
            (_, Response::Abort { object, code }) if object == self.object => {
                self.finish(Err(SdoError::Aborted { object, code }));
            }
            (_, Response::Unsupported(response)) => {
                let (object, specifier) = (self.object, response.specifier());
                self.fail(
                    AbortCode::COMMAND_SPECIFIER,
                    SdoError::Specifier { object, specifier },
                );
            }
            (State::UploadInitiated, Response::InitiateUpload { object, initiate })
                if object == self.object =>
            {
                self.upload_initiated(initiate, now);
            }
            (State::UploadSegments { toggle, announced }, Response::UploadSegment(segment)) => {
                self.segment_received(&segment, toggle, announced, now);
            }
            (State::DownloadInitiated, Response::InitiateDownload { object })
                if object == self.object =>
            {
                if self.expedited().is_some() {
                    self.finish(Ok(()));
                } else {
                    self.send_segment(0, false, now);
                }
            }
            (
                State::DownloadSegments { toggle, sent },
                Response::DownloadSegment { toggle: taken },
            ) => {
                if taken != toggle {
                    self.fail(
                        AbortCode::TOGGLE,
                        SdoError::Toggle {
                            object: self.object,
                        },
                    );
                } else if sent == self.length {
                    self.finish(Ok(()));
                } else {
                    self.send_segment(sent, !toggle, now);
                }
            }
            // A late answer to an earlier request.
            (
                State::UploadInitiated
                | State::UploadSegments { .. }
                | State::DownloadInitiated
                | State::DownloadSegments { .. },
                _,
            ) => {}
        }
    }

    /// The next frame to send, if any: an abort before a request.
    pub fn poll_transmit(&mut self, _now: Instant) -> Option<Frame> {
        self.abort.take().or_else(|| self.request.take())
    }

    /// When the answer is due that it waits for.
    pub fn poll_timeout(&self) -> Option<Instant> {
        match self.state {
            State::Idle | State::Finished(_) => None,
            State::UploadInitiated
            | State::UploadSegments { .. }
            | State::DownloadInitiated
            | State::DownloadSegments { .. } => Some(self.deadline),
        }
    }

    /// Starts anew or gives up if the answer is overdue at `now`.
    pub fn handle_timeout(&mut self, now: Instant) {
        if self.poll_timeout().is_none_or(|deadline| now < deadline) {
            return;
        }
        let (object, waited) = (self.object, now.since(self.started));
        let upload = matches!(
            self.state,
            State::UploadInitiated | State::UploadSegments { .. }
        );
        self.fail(AbortCode::TIME_OUT, SdoError::TimedOut { object, waited });
        if self.retries_left > 0 {
            self.retries_left -= 1;
            self.state = if upload {
                State::UploadInitiated
            } else {
                State::DownloadInitiated
            };
            self.initiate(now);
        }
    }

    /// The result of the transfer, once; then the next may be started.
    pub fn poll(&mut self) -> Option<Result<Transfer<'_>, SdoError>> {
        let State::Finished(result) = self.state else {
            return None;
        };
        self.state = State::Idle;
        Some(result.map(|()| Transfer {
            object: self.object,
            data: &self.buffer[..self.length],
            exact: self.exact,
        }))
    }

    fn begin(
        &mut self,
        object: Object,
        state: State,
        data: &[u8],
        now: Instant,
    ) -> Result<(), StartError> {
        if self.state != State::Idle {
            return Err(StartError::Busy {
                object: self.object,
            });
        }
        self.object = object;
        self.state = state;
        self.buffer[..data.len()].copy_from_slice(data);
        self.length = data.len();
        self.exact = true;
        self.started = now;
        self.retries_left = self.retries;
        self.initiate(now);
        Ok(())
    }

    /// Sends the first frame of the transfer that `state` begins.
    fn initiate(&mut self, now: Instant) {
        let object = self.object;
        let request = if self.state == State::UploadInitiated {
            self.length = 0;
            Request::InitiateUpload { object }
        } else {
            let initiate = match self.expedited() {
                Some(data) => Initiate::Expedited(data),
                None => Initiate::Segmented {
                    size: Some(self.length as u32),
                },
            };
            Request::InitiateDownload { object, initiate }
        };
        self.send(request, now);
    }

    /// The data to write, if they fit into the first frame.
    fn expedited(&self) -> Option<Expedited> {
        Expedited::new(&self.buffer[..self.length])
    }

    fn upload_initiated(&mut self, initiate: Initiate, now: Instant) {
        match initiate {
            Initiate::Expedited(data) => {
                self.exact = data.size_given();
                self.append(data.data());
                self.finish(Ok(()));
            }
            Initiate::Segmented { size } => {
                let announced = size.map(|size| usize::try_from(size).unwrap_or(usize::MAX));
                if let Some(size) = announced.filter(|size| *size > CAPACITY) {
                    let object = self.object;
                    self.fail(
                        AbortCode::OUT_OF_MEMORY,
                        SdoError::TooLarge { object, size },
                    );
                    return;
                }
                self.state = State::UploadSegments {
                    toggle: false,
                    announced,
                };
                self.send(Request::UploadSegment { toggle: false }, now);
            }
        }
    }

    fn segment_received(
        &mut self,
        segment: &Segment,
        toggle: bool,
        announced: Option<usize>,
        now: Instant,
    ) {
        let object = self.object;
        let found = self.length + segment.data().len();
        if segment.toggle != toggle {
            self.fail(AbortCode::TOGGLE, SdoError::Toggle { object });
        } else if segment.data().is_empty() && !segment.last {
            self.fail(AbortCode::GENERAL, SdoError::EmptySegment { object });
        } else if let Some(expected) = announced
            && (found > expected || segment.last && found < expected)
        {
            self.fail(
                AbortCode::LENGTH_MISMATCH,
                SdoError::Length {
                    object,
                    expected,
                    found,
                },
            );
        } else if !self.append(segment.data()) {
            self.fail(
                AbortCode::OUT_OF_MEMORY,
                SdoError::TooLarge {
                    object,
                    size: found,
                },
            );
        } else if segment.last {
            self.finish(Ok(()));
        } else {
            self.state = State::UploadSegments {
                toggle: !toggle,
                announced,
            };
            self.send(Request::UploadSegment { toggle: !toggle }, now);
        }
    }

    /// Sends the segment that begins at byte `from`.
    fn send_segment(&mut self, from: usize, toggle: bool, now: Instant) {
        let sent = self.length.min(from + 7);
        let segment = Segment::new(&self.buffer[from..sent], toggle, sent == self.length);
        self.state = State::DownloadSegments { toggle, sent };
        self.send(
            Request::DownloadSegment(segment.expect("at most 7 bytes were taken")),
            now,
        );
    }

    fn append(&mut self, data: &[u8]) -> bool {
        let Some(free) = self.buffer[self.length..].get_mut(..data.len()) else {
            return false;
        };
        free.copy_from_slice(data);
        self.length += data.len();
        true
    }

    fn send(&mut self, request: Request, now: Instant) {
        self.request = Some(request.encode(self.node));
        self.deadline = now + self.timeout;
    }

    fn fail(&mut self, code: AbortCode, error: SdoError) {
        self.abort = Some(
            Request::Abort {
                object: self.object,
                code,
            }
            .encode(self.node),
        );
        self.finish(Err(error));
    }

    fn finish(&mut self, result: Result<(), SdoError>) {
        self.request = None;
        self.state = State::Finished(result);
    }
}

#[cfg(test)]
mod tests;
