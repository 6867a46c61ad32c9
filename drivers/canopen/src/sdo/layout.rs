//! Frames of SDO: expedited and segmented transfer (CiA 301 §7.2.4.3.3 to §7.2.4.3.7), abort (§7.2.4.3.17), and
//! [block transfer](super::block).

use can::Frame;

use super::{AbortCode, block};
use crate::{NodeId, Object, cob, frame, payload};

/// A request of the client, on `0x600 + node`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum Request {
    /// Begin to write an object, or write all of it where expedited.
    InitiateDownload { object: Object, initiate: Initiate },
    /// The next segment of a segmented download.
    DownloadSegment(Segment),
    /// Read an object.
    InitiateUpload { object: Object },
    /// Ask for the next segment of a segmented upload. `toggle` alternates, starting with `false`.
    UploadSegment { toggle: bool },
    /// End the transfer.
    Abort { object: Object, code: AbortCode },
    /// Of block transfer. In the middle of a sub-block the frame may be a [`block::Segment`] all the same.
    Block(block::Request),
    /// Any other command specifier, kept byte for byte.
    Unsupported([u8; 8]),
}

/// An answer of the server, on `0x580 + node`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum Response {
    /// The download was taken, or its segments may follow.
    InitiateDownload { object: Object },
    /// The segment with this toggle bit was taken.
    DownloadSegment { toggle: bool },
    /// The object's data where expedited, else its segments may be asked for.
    InitiateUpload { object: Object, initiate: Initiate },
    /// The next segment of a segmented upload.
    UploadSegment(Segment),
    /// End the transfer.
    Abort { object: Object, code: AbortCode },
    /// Of block transfer. In the middle of a sub-block the frame may be a [`block::Segment`] all the same.
    Block(block::Response),
    /// Any other command specifier, kept byte for byte.
    Unsupported([u8; 8]),
}

/// Contents of the first frame of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum Initiate {
    /// All the data.
    Expedited(Expedited),
    /// Nothing yet; segments follow, of this many bytes together where the sender says.
    Segmented { size: Option<u32> },
}

/// One to four bytes that travel in the first frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Expedited {
    bytes: [u8; 4],
    /// 1 ..= 4; `None` where the sender does not say.
    length: Option<u8>,
}

impl Expedited {
    /// Data with their size; `None` unless there are 1 to 4 bytes.
    pub fn new(data: &[u8]) -> Option<Self> {
        let mut bytes = [0; 4];
        bytes.get_mut(..data.len())?.copy_from_slice(data);
        (!data.is_empty()).then_some(Self { bytes, length: Some(data.len() as u8) })
    }

    /// Data whose size is known to the receiver alone; unused bytes come last.
    pub const fn without_size(bytes: [u8; 4]) -> Self {
        Self { bytes, length: None }
    }

    /// The data; all four bytes if the size was not given.
    pub fn data(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length.unwrap_or(4))]
    }

    /// Whether the sender said how many bytes there are.
    pub const fn size_given(&self) -> bool {
        self.length.is_some()
    }
}

macro_rules! expedited_from {
    ($($number:ty),*) => {
        $(impl From<$number> for Expedited {
            fn from(number: $number) -> Self {
                Self::new(&number.to_le_bytes()).expect("a number of 1 to 4 bytes fits")
            }
        })*
    };
}
expedited_from!(u8, u16, u32, i8, i16, i32);

/// A number and the object it is to be written to, in the size that the object has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Write {
    /// Where to.
    pub object: Object,
    /// The number, little endian.
    pub data: Expedited,
}

impl Write {
    /// The type of `number` is the type of the object.
    pub fn new(object: Object, number: impl Into<Expedited>) -> Self {
        Self { object, data: number.into() }
    }
}

/// Up to seven bytes of a segmented transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Segment {
    bytes: [u8; 7],
    length: u8,
    /// Alternates, starting with `false`.
    pub toggle: bool,
    /// Whether no segment follows.
    pub last: bool,
}

impl Segment {
    /// `None` above 7 bytes.
    pub fn new(data: &[u8], toggle: bool, last: bool) -> Option<Self> {
        let mut bytes = [0; 7];
        bytes.get_mut(..data.len())?.copy_from_slice(data);
        Some(Self { bytes, length: data.len() as u8, toggle, last })
    }

    /// The data.
    pub fn data(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }

    fn encode(&self) -> [u8; 8] {
        let [a, b, c, d, e, f, g] = self.bytes;
        let specifier = toggle_bit(self.toggle) | (7 - self.length) << 1 | u8::from(self.last);
        [specifier, a, b, c, d, e, f, g]
    }

    fn decode(bytes: [u8; 8]) -> Self {
        let [specifier, data @ ..] = bytes;
        let length = 7 - (specifier >> 1 & 0b111);
        Self::new(&data[..usize::from(length)], toggled(specifier), specifier & 1 != 0)
            .expect("a length of three bits is at most 7")
    }
}

impl Request {
    /// The frame to the server `node`.
    pub fn encode(&self, node: NodeId) -> Frame {
        let bytes = match *self {
            Self::InitiateDownload { object, initiate } => initiate.encode(0x20, object),
            Self::DownloadSegment(segment) => segment.encode(),
            Self::InitiateUpload { object } => addressed(0x40, object, [0; 4]),
            Self::UploadSegment { toggle } => [0x60 | toggle_bit(toggle), 0, 0, 0, 0, 0, 0, 0],
            Self::Abort { object, code } => addressed(0x80, object, code.0.to_le_bytes()),
            Self::Block(block) => block.encode(),
            Self::Unsupported(bytes) => bytes,
        };
        frame(cob::sdo_request(node), bytes)
    }

    /// `None` unless it is a frame of 8 bytes to the server `node`.
    pub fn decode(frame: &Frame, node: NodeId) -> Option<Self> {
        let bytes: [u8; 8] = payload(frame, cob::sdo_request(node))?.try_into().ok()?;
        let (object, initiate) = (object(bytes), Initiate::decode(bytes));
        let (toggle, code) = (toggled(bytes[0]), abort_code(bytes));
        Some(match bytes[0] {
            0x00..=0x1F => Self::DownloadSegment(Segment::decode(bytes)),
            0x20..=0x2F => Self::InitiateDownload { object, initiate },
            0x40 => Self::InitiateUpload { object },
            0x60 | 0x70 => Self::UploadSegment { toggle },
            0x80 => Self::Abort { object, code },
            _ => match block::Request::decode(bytes) {
                Some(block) => Self::Block(block),
                None => Self::Unsupported(bytes),
            },
        })
    }
}

impl Response {
    /// The frame from the server `node`.
    pub fn encode(&self, node: NodeId) -> Frame {
        let bytes = match *self {
            Self::InitiateDownload { object } => addressed(0x60, object, [0; 4]),
            Self::DownloadSegment { toggle } => [0x20 | toggle_bit(toggle), 0, 0, 0, 0, 0, 0, 0],
            Self::InitiateUpload { object, initiate } => initiate.encode(0x40, object),
            Self::UploadSegment(segment) => segment.encode(),
            Self::Abort { object, code } => addressed(0x80, object, code.0.to_le_bytes()),
            Self::Block(block) => block.encode(),
            Self::Unsupported(bytes) => bytes,
        };
        frame(cob::sdo_response(node), bytes)
    }

    /// `None` unless it is a frame of 8 bytes from the server `node`.
    pub fn decode(frame: &Frame, node: NodeId) -> Option<Self> {
        let bytes: [u8; 8] = payload(frame, cob::sdo_response(node))?.try_into().ok()?;
        let (object, initiate) = (object(bytes), Initiate::decode(bytes));
        let (toggle, code) = (toggled(bytes[0]), abort_code(bytes));
        Some(match bytes[0] {
            0x00..=0x1F => Self::UploadSegment(Segment::decode(bytes)),
            0x20 | 0x30 => Self::DownloadSegment { toggle },
            0x40..=0x4F => Self::InitiateUpload { object, initiate },
            0x60 => Self::InitiateDownload { object },
            0x80 => Self::Abort { object, code },
            _ => match block::Response::decode(bytes) {
                Some(block) => Self::Block(block),
                None => Self::Unsupported(bytes),
            },
        })
    }
}

const EXPEDITED: u8 = 0b10;
const SIZE_GIVEN: u8 = 0b01;

impl Initiate {
    fn encode(self, command: u8, object: Object) -> [u8; 8] {
        match self {
            Self::Expedited(Expedited { bytes, length: None }) => addressed(command | EXPEDITED, object, bytes),
            Self::Expedited(Expedited { bytes, length: Some(length) }) => {
                addressed(command | (4 - length) << 2 | EXPEDITED | SIZE_GIVEN, object, bytes)
            }
            Self::Segmented { size: None } => addressed(command, object, [0; 4]),
            Self::Segmented { size: Some(size) } => addressed(command | SIZE_GIVEN, object, size.to_le_bytes()),
        }
    }

    fn decode(bytes: [u8; 8]) -> Self {
        let [specifier, _, _, _, data @ ..] = bytes;
        match (specifier & EXPEDITED != 0, specifier & SIZE_GIVEN != 0) {
            (true, true) => {
                let length = 4 - (specifier >> 2 & 0b11);
                let expedited = Expedited::new(&data[..usize::from(length)]);
                Self::Expedited(expedited.expect("4 minus two bits is 1 to 4"))
            }
            (true, false) => Self::Expedited(Expedited::without_size(data)),
            (false, true) => Self::Segmented { size: Some(u32::from_le_bytes(data)) },
            (false, false) => Self::Segmented { size: None },
        }
    }
}

pub(super) fn addressed(specifier: u8, object: Object, data: [u8; 4]) -> [u8; 8] {
    let [low, high] = object.index.to_le_bytes();
    let [a, b, c, d] = data;
    [specifier, low, high, object.subindex, a, b, c, d]
}

pub(super) fn object(bytes: [u8; 8]) -> Object {
    Object::new(u16::from_le_bytes([bytes[1], bytes[2]]), bytes[3])
}

fn abort_code(bytes: [u8; 8]) -> AbortCode {
    AbortCode(u32::from_le_bytes([bytes[4], bytes[5], bytes[6], bytes[7]]))
}

fn toggle_bit(toggle: bool) -> u8 {
    u8::from(toggle) << 4
}

fn toggled(specifier: u8) -> bool {
    specifier & 0x10 != 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::{ABORT_CONNECTION_OPTION, CONTROLWORD, DEVICE_NAME, STATUSWORD};

    const NODE: NodeId = NodeId::new(2).unwrap();

    fn download(object: Object, data: &[u8]) -> Request {
        let initiate = Initiate::Expedited(Expedited::new(data).unwrap());
        Request::InitiateDownload { object, initiate }
    }

    fn uploaded(object: Object, data: &[u8]) -> Response {
        let initiate = Initiate::Expedited(Expedited::new(data).unwrap());
        Response::InitiateUpload { object, initiate }
    }

    #[test]
    fn requests_are_these_bytes() {
        let table = [
            (download(ABORT_CONNECTION_OPTION, &[1]), "602#2F07600001000000"),
            (download(CONTROLWORD, &[0x0F, 0x00]), "602#2B4060000F000000"),
            (download(CONTROLWORD, &[1, 2, 3]), "602#2740600001020300"),
            (download(CONTROLWORD, &[1, 2, 3, 4]), "602#2340600001020304"),
            (
                Request::InitiateDownload {
                    object: CONTROLWORD,
                    initiate: Initiate::Expedited(Expedited::without_size([1, 2, 3, 4])),
                },
                "602#2240600001020304",
            ),
            (
                Request::InitiateDownload { object: DEVICE_NAME, initiate: Initiate::Segmented { size: Some(0x0102) } },
                "602#2108100002010000",
            ),
            (
                Request::InitiateDownload { object: DEVICE_NAME, initiate: Initiate::Segmented { size: None } },
                "602#2008100000000000",
            ),
            (
                Request::DownloadSegment(Segment::new(&[1, 2, 3, 4, 5, 6, 7], false, false).unwrap()),
                "602#0001020304050607",
            ),
            (Request::DownloadSegment(Segment::new(&[9], true, true).unwrap()), "602#1D09000000000000"),
            (Request::InitiateUpload { object: STATUSWORD }, "602#4041600000000000"),
            (Request::UploadSegment { toggle: false }, "602#6000000000000000"),
            (Request::UploadSegment { toggle: true }, "602#7000000000000000"),
            (Request::Abort { object: STATUSWORD, code: AbortCode::TIME_OUT }, "602#8041600000000405"),
            (Request::Unsupported([0xE6, 0x08, 0x10, 0, 7, 0, 0, 0]), "602#E608100007000000"),
        ];
        for (request, bytes) in table {
            assert_eq!(request.encode(NODE).to_string(), bytes);
            assert_eq!(Request::decode(&request.encode(NODE), NODE), Some(request));
        }
    }

    #[test]
    fn responses_are_these_bytes() {
        let table = [
            (uploaded(STATUSWORD, &[0x37, 0x07]), "582#4B41600037070000"),
            (uploaded(STATUSWORD, &[1]), "582#4F41600001000000"),
            (uploaded(STATUSWORD, &[1, 2, 3]), "582#4741600001020300"),
            (uploaded(STATUSWORD, &[1, 2, 3, 4]), "582#4341600001020304"),
            (
                Response::InitiateUpload {
                    object: STATUSWORD,
                    initiate: Initiate::Expedited(Expedited::without_size([1, 2, 3, 4])),
                },
                "582#4241600001020304",
            ),
            (
                Response::InitiateUpload { object: DEVICE_NAME, initiate: Initiate::Segmented { size: Some(5) } },
                "582#4108100005000000",
            ),
            (
                Response::InitiateUpload { object: DEVICE_NAME, initiate: Initiate::Segmented { size: None } },
                "582#4008100000000000",
            ),
            (Response::InitiateDownload { object: CONTROLWORD }, "582#6040600000000000"),
            (Response::DownloadSegment { toggle: false }, "582#2000000000000000"),
            (Response::DownloadSegment { toggle: true }, "582#3000000000000000"),
            (Response::UploadSegment(Segment::new(b"EPOS4", true, true).unwrap()), "582#1545504F53340000"),
            (Response::UploadSegment(Segment::new(&[], false, true).unwrap()), "582#0F00000000000000"),
            (Response::Abort { object: STATUSWORD, code: AbortCode::NO_OBJECT }, "582#8041600000000206"),
        ];
        for (response, bytes) in table {
            assert_eq!(response.encode(NODE).to_string(), bytes);
            assert_eq!(Response::decode(&response.encode(NODE), NODE), Some(response));
        }
    }

    #[test]
    fn bytes_past_the_given_size_are_ignored() {
        let frame = Frame::new(cob::sdo_response(NODE), &[0x4B, 0x41, 0x60, 0, 0x37, 0x07, 0xAA, 0x55]);
        let decoded = Response::decode(&frame.unwrap(), NODE);
        assert_eq!(decoded, Some(uploaded(STATUSWORD, &[0x37, 0x07])));
    }

    #[test]
    fn short_frames_and_other_nodes_frames_are_refused() {
        for length in 0..8 {
            let request = Frame::new(cob::sdo_request(NODE), &[0x40; 8][..length]).unwrap();
            let response = Frame::new(cob::sdo_response(NODE), &[0x60; 8][..length]).unwrap();
            assert_eq!(Request::decode(&request, NODE), None);
            assert_eq!(Response::decode(&response, NODE), None);
        }
        let request = Request::InitiateUpload { object: STATUSWORD }.encode(NODE);
        assert_eq!(Request::decode(&request, NodeId::MAX), None);
        assert_eq!(Response::decode(&request, NODE), None);
    }

    #[test]
    fn unknown_specifiers_are_kept_whole() {
        for specifier in [0x50, 0x90, 0xA5, 0xC3, 0xE0, 0xFF] {
            let bytes = [specifier, 0x08, 0x10, 0x03, 1, 2, 3, 4];
            let frame = Frame::new(cob::sdo_request(NODE), &bytes).unwrap();
            assert_eq!(Request::decode(&frame, NODE), Some(Request::Unsupported(bytes)));
            let frame = Frame::new(cob::sdo_response(NODE), &bytes).unwrap();
            assert_eq!(Response::decode(&frame, NODE), Some(Response::Unsupported(bytes)));
        }
    }

    #[test]
    fn data_that_do_not_fit_are_refused() {
        assert_eq!(Expedited::new(&[]), None);
        assert_eq!(Expedited::new(&[0; 5]), None);
        assert_eq!(Segment::new(&[0; 8], false, false), None);
    }
}
