//! The SDO server: the device's side of a transfer, expedited, segmented or by blocks.
//!
//! The server has one channel, as devices have: a new initiate request replaces the transfer in progress. A transfer
//! without further requests ends after the time-out with [`AbortCode::TIME_OUT`]. Objects are read and written whole, up
//! to [`MAX_SIZE`] bytes. Only emulated devices use the server. Read [`Dictionary`] first, then [`Server::handle_frame`].

mod blocks;

use std::time::Duration;

use can::{Frame, Instant};

use super::block::MAX_BLOCK_SIZE;
use super::{AbortCode, Expedited, Initiate, Request, Response, Segment, block, layout};
use crate::{NodeId, Object, cob};

/// The longest object a server transfers, bytes: a whole number of a block transfer's segments.
pub const MAX_SIZE: usize = 146 * block::SEGMENT;

/// The objects behind a server.
pub trait Dictionary {
    /// The size of an object in bytes; `None` where it varies or there is no such object.
    fn size(&self, object: Object) -> Option<usize>;

    /// Refuses a write before its data is sent, so that the client saves the data.
    fn check_write(&self, _object: Object) -> Result<(), AbortCode> {
        Ok(())
    }

    /// Writes an object's data to the front of `into` and returns how many bytes there are.
    fn read(&mut self, object: Object, into: &mut [u8; MAX_SIZE]) -> Result<usize, AbortCode>;

    /// Takes an object's data, all of them or none.
    fn write(&mut self, object: Object, data: &[u8]) -> Result<(), AbortCode>;
}

/// One server channel.
#[derive(Clone, Debug)]
pub struct Server {
    time_out: Duration,
    /// Segments of a sub-block that it takes, 1 ..= 127.
    block_size: u8,
    transfer: Option<Transfer>,
    buffer: [u8; MAX_SIZE],
}

#[derive(Clone, Copy, Debug)]
struct Transfer {
    object: Object,
    direction: Direction,
    /// Bytes that went across so far.
    done: usize,
    /// Expected of the next segment.
    toggle: bool,
    deadline: Instant,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Direction {
    Upload { size: usize },
    Download { size: Option<usize> },
    BlockUpload(blocks::Upload),
    BlockDownload(blocks::Download),
}

impl Server {
    /// A server with the greatest block size. It ends a transfer `time_out` after the last request of the client.
    pub fn new(time_out: Duration) -> Self {
        Self { time_out, block_size: MAX_BLOCK_SIZE, transfer: None, buffer: [0; MAX_SIZE] }
    }

    /// The same server, but it takes blocks of `block_size` segments, 1 ..= 127.
    pub fn with_block_size(mut self, block_size: u8) -> Self {
        self.block_size = block_size.clamp(1, MAX_BLOCK_SIZE);
        self
    }

    /// Takes a frame to the server of `node` and returns the answer, if there is one. [`Server::poll_transmit`]
    /// returns further frames. Other frames are ignored.
    pub fn handle_frame<D: Dictionary>(
        &mut self,
        frame: &Frame,
        node: NodeId,
        dictionary: &mut D,
        now: Instant,
    ) -> Option<Frame> {
        let answer = if self.receives_blocks()
            && let Some(segment) = block::Segment::decode(frame, cob::sdo_request(node))
        {
            let answer = self.append(segment, now);
            self.answer(self.object(), answer)
        } else {
            self.handle(Request::decode(frame, node)?, dictionary, now)
        };
        Some(answer?.encode(node))
    }

    /// Forgets the transfer in progress.
    pub fn reset(&mut self) {
        self.transfer = None;
    }

    /// Takes a request and answers it. An abort has no answer.
    fn handle<D: Dictionary>(&mut self, request: Request, dictionary: &mut D, now: Instant) -> Option<Response> {
        let (object, answer) = match request {
            Request::Abort { .. } => {
                self.transfer = None;
                return None;
            }
            Request::InitiateDownload { object, initiate } => {
                let answer = self.download(object, initiate, dictionary, now);
                (object, answer.map(Some))
            }
            Request::InitiateUpload { object } => (object, self.upload(object, dictionary, now).map(Some)),
            Request::DownloadSegment(segment) => {
                let answer = self.take(segment, dictionary, now);
                (self.object(), answer.map(Some))
            }
            Request::UploadSegment { toggle } => (self.object(), self.give(toggle, now).map(Some)),
            Request::Block(request) => self.handle_block(request, dictionary, now),
            Request::Unsupported(bytes) => {
                let transferred = self.transfer.map(|transfer| transfer.object);
                let object = transferred.unwrap_or_else(|| layout::object(bytes));
                (object, Err(AbortCode::COMMAND_SPECIFIER))
            }
        };
        self.answer(object, answer)
    }

    /// The answer to a request about `object`. An error ends the transfer.
    fn answer(&mut self, object: Object, answer: Result<Option<Response>, AbortCode>) -> Option<Response> {
        answer.unwrap_or_else(|code| {
            self.transfer = None;
            Some(Response::Abort { object, code })
        })
    }

    /// When the transfer in progress times out.
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.transfer.map(|transfer| transfer.deadline)
    }

    /// Ends a transfer whose time is over.
    pub fn handle_timeout(&mut self, now: Instant) -> Option<Response> {
        let transfer = self.transfer.take_if(|transfer| transfer.deadline <= now)?;
        Some(Response::Abort { object: transfer.object, code: AbortCode::TIME_OUT })
    }

    /// The object of the transfer in progress, for an abort.
    fn object(&self) -> Object {
        self.transfer.map_or(Object::new(0, 0), |transfer| transfer.object)
    }

    fn begin(&mut self, object: Object, direction: Direction, now: Instant) {
        self.transfer = Some(Transfer { object, direction, done: 0, toggle: false, deadline: now + self.time_out });
    }

    fn download<D: Dictionary>(
        &mut self,
        object: Object,
        initiate: Initiate,
        dictionary: &mut D,
        now: Instant,
    ) -> Result<Response, AbortCode> {
        self.transfer = None;
        match initiate {
            Initiate::Expedited(data) => {
                let size =
                    if data.size_given() { data.data().len() } else { dictionary.size(object).unwrap_or(4).min(4) };
                dictionary.write(object, &data.data()[..size])?;
            }
            Initiate::Segmented { size } => {
                let size = check_download(object, size, dictionary)?;
                self.begin(object, Direction::Download { size }, now);
            }
        }
        Ok(Response::InitiateDownload { object })
    }

    fn upload<D: Dictionary>(
        &mut self,
        object: Object,
        dictionary: &mut D,
        now: Instant,
    ) -> Result<Response, AbortCode> {
        self.transfer = None;
        let size = dictionary.read(object, &mut self.buffer)?;
        let initiate = match Expedited::new(&self.buffer[..size]) {
            Some(data) => Initiate::Expedited(data),
            None => {
                self.begin(object, Direction::Upload { size }, now);
                Initiate::Segmented { size: Some(size as u32) }
            }
        };
        Ok(Response::InitiateUpload { object, initiate })
    }

    fn take<D: Dictionary>(
        &mut self,
        segment: Segment,
        dictionary: &mut D,
        now: Instant,
    ) -> Result<Response, AbortCode> {
        let transfer = self.transfer.as_mut().ok_or(AbortCode::COMMAND_SPECIFIER)?;
        let Direction::Download { size } = transfer.direction else {
            return Err(AbortCode::COMMAND_SPECIFIER);
        };
        if segment.toggle != transfer.toggle {
            return Err(AbortCode::TOGGLE);
        }
        let end = transfer.done + segment.data().len();
        if size.is_some_and(|size| end > size) {
            return Err(AbortCode::TOO_LONG);
        }
        self.buffer.get_mut(transfer.done..end).ok_or(AbortCode::OUT_OF_MEMORY)?.copy_from_slice(segment.data());
        transfer.done = end;
        transfer.toggle = !transfer.toggle;
        transfer.deadline = now + self.time_out;
        if segment.last {
            if size.is_some_and(|size| end < size) {
                return Err(AbortCode::TOO_SHORT);
            }
            dictionary.write(transfer.object, &self.buffer[..end])?;
            self.transfer = None;
        }
        Ok(Response::DownloadSegment { toggle: segment.toggle })
    }

    fn give(&mut self, toggle: bool, now: Instant) -> Result<Response, AbortCode> {
        let transfer = self.transfer.as_mut().ok_or(AbortCode::COMMAND_SPECIFIER)?;
        let Direction::Upload { size } = transfer.direction else {
            return Err(AbortCode::COMMAND_SPECIFIER);
        };
        if toggle != transfer.toggle {
            return Err(AbortCode::TOGGLE);
        }
        let end = size.min(transfer.done + 7);
        let last = end == size;
        let segment =
            Segment::new(&self.buffer[transfer.done..end], toggle, last).expect("at most 7 bytes were cut off");
        transfer.done = end;
        transfer.toggle = !toggle;
        transfer.deadline = now + self.time_out;
        if last {
            self.transfer = None;
        }
        Ok(Response::UploadSegment(segment))
    }
}

/// The announced size of a download, if there is room for it and the object can be written.
fn check_download<D: Dictionary>(
    object: Object,
    size: Option<u32>,
    dictionary: &D,
) -> Result<Option<usize>, AbortCode> {
    let size = size.map(|size| size as usize);
    if size.is_some_and(|size| size > MAX_SIZE) {
        return Err(AbortCode::OUT_OF_MEMORY);
    }
    dictionary.check_write(object)?;
    Ok(size)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{NodeId, cob};
    use can::Frame;

    const NODE: NodeId = NodeId::new(2).unwrap();
    const TIME_OUT: Duration = Duration::from_millis(500);
    const TEXT: Object = Object::new(0x1008, 0);
    const WORD: Object = Object::new(0x6040, 0);

    struct Two {
        text: Vec<u8>,
        word: u16,
    }

    impl Dictionary for Two {
        fn size(&self, object: Object) -> Option<usize> {
            (object == WORD).then_some(2)
        }
        fn read(&mut self, object: Object, into: &mut [u8; MAX_SIZE]) -> Result<usize, AbortCode> {
            let data = match object {
                TEXT => self.text.clone(),
                WORD => self.word.to_le_bytes().to_vec(),
                _ => return Err(AbortCode::NO_OBJECT),
            };
            into[..data.len()].copy_from_slice(&data);
            Ok(data.len())
        }
        fn write(&mut self, object: Object, data: &[u8]) -> Result<(), AbortCode> {
            match object {
                TEXT => self.text = data.to_vec(),
                WORD => {
                    let word = data.try_into().map_err(|_| AbortCode::LENGTH_MISMATCH)?;
                    self.word = u16::from_le_bytes(word);
                }
                _ => return Err(AbortCode::NO_OBJECT),
            }
            Ok(())
        }
    }

    /// Plays requests against a fresh server and compares its answers; "" is none.
    fn check(dialogue: &[(&str, &str)]) -> Two {
        let mut server = Server::new(TIME_OUT);
        let mut objects = Two { text: b"EPOS4 50/5".to_vec(), word: 0x0737 };
        for (step, &(request, expected)) in dialogue.iter().enumerate() {
            let bytes: Vec<u8> =
                (0..8).map(|at| u8::from_str_radix(&request[2 * at..2 * at + 2], 16).unwrap()).collect();
            let frame = Frame::new(cob::sdo_request(NODE), &bytes).unwrap();
            let request = Request::decode(&frame, NODE).unwrap();
            let answer = server.handle(request, &mut objects, Instant::ZERO);
            let answer = answer.map_or(String::new(), |answer| answer.encode(NODE).to_string()[4..].to_owned());
            assert_eq!(answer, expected, "step {step}");
        }
        objects
    }

    #[test]
    fn short_objects_travel_in_one_frame_each_way() {
        let objects = check(&[
            ("4040600000000000", "4B40600037070000"),
            ("2B4060000F000000", "6040600000000000"),
            ("4040600000000000", "4B4060000F000000"),
            // The size is not given: the object's own counts.
            ("2240600034120000", "6040600000000000"),
        ]);
        assert_eq!(objects.word, 0x1234);
    }

    #[test]
    fn long_objects_travel_in_segments() {
        let objects = check(&[
            ("4008100000000000", "410810000A000000"),
            ("6000000000000000", "0045504F53342035"),
            ("7000000000000000", "19302F3500000000"),
            ("2108100009000000", "6008100000000000"),
            ("0041424344454647", "2000000000000000"),
            ("1B48490000000000", "3000000000000000"),
        ]);
        assert_eq!(objects.text, b"ABCDEFGHI");
    }

    #[test]
    fn refusals_name_their_reason() {
        let table: &[&[(&str, &str)]] = &[
            // No such object, read and written.
            &[("4000200000000000", "8000200000000206")],
            &[("2F00200001000000", "8000200000000206")],
            // A byte for a word.
            &[("2F40600001000000", "8040600010000706")],
            // Segments without a transfer, or of the other direction.
            &[("6000000000000000", "8000000001000405")],
            &[("0041424344454647", "8000000001000405")],
            &[
                ("4008100000000000", "410810000A000000"),
                ("0041424344454647", "8008100001000405"),
                ("6000000000000000", "8000000001000405"),
            ],
            // The toggle bit begins with 0 and alternates.
            &[("4008100000000000", "410810000A000000"), ("7000000000000000", "8008100000000305")],
            &[
                ("2008100000000000", "6008100000000000"),
                ("0041424344454647", "2000000000000000"),
                ("0041424344454647", "8008100000000305"),
            ],
            // More and fewer bytes than announced, and more than there is room for.
            &[("2108100003000000", "6008100000000000"), ("0141424344454647", "8008100012000706")],
            &[("2108100009000000", "6008100000000000"), ("0141424344454647", "8008100013000706")],
            &[("21081000FF030000", "8008100005000405")],
            // An unknown specifier.
            &[("E008100007000000", "8008100001000405")],
            // An abort is not answered, and ends the transfer.
            &[
                ("4008100000000000", "410810000A000000"),
                ("8008100000000405", ""),
                ("6000000000000000", "8000000001000405"),
            ],
        ];
        for dialogue in table {
            check(dialogue);
        }
    }

    #[test]
    fn a_new_initiate_replaces_the_transfer() {
        check(&[
            ("4008100000000000", "410810000A000000"),
            ("4040600000000000", "4B40600037070000"),
            ("6000000000000000", "8000000001000405"),
        ]);
    }

    #[test]
    fn a_transfer_whose_client_falls_silent_is_aborted() {
        let mut server = Server::new(TIME_OUT);
        let mut objects = Two { text: vec![0; 20], word: 0 };
        assert_eq!(server.poll_timeout(), None);
        let upload = Request::InitiateUpload { object: TEXT };
        server.handle(upload, &mut objects, Instant::ZERO);
        let later = Instant::ZERO + Duration::from_millis(400);
        server.handle(Request::UploadSegment { toggle: false }, &mut objects, later);
        assert_eq!(server.poll_timeout(), Some(later + TIME_OUT));
        assert_eq!(server.handle_timeout(Instant::ZERO + TIME_OUT), None);
        let abort = Response::Abort { object: TEXT, code: AbortCode::TIME_OUT };
        assert_eq!(server.handle_timeout(later + TIME_OUT), Some(abort));
        assert_eq!(server.poll_timeout(), None);
    }
}
