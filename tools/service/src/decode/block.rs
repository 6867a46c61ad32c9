//! Text of the frames of an SDO block transfer.

use can::Frame;
use canopen::Object;
use canopen::sdo::block;

use super::{bytes, named, transfer};
use mrroc::report::counted;

pub(super) fn request(request: block::Request) -> String {
    use block::Request::{Acknowledge, EndDownload, EndUpload, InitiateDownload, InitiateUpload, StartUpload};
    match request {
        InitiateDownload { object, size, .. } => format!("write {} in blocks{}", named(object), of_size(size)),
        InitiateUpload { object, block_size, .. } => format!("read {} in blocks of {block_size}", named(object)),
        StartUpload => "first block, please".to_owned(),
        Acknowledge(taken) => acknowledged(&taken),
        EndDownload(end) => format!("end of blocks, checksum {:#06x}", end.crc),
        EndUpload => "end of blocks taken".to_owned(),
    }
}

pub(super) fn response(response: block::Response) -> String {
    use block::Response::{Acknowledge, EndDownload, EndUpload, InitiateDownload, InitiateUpload};
    match response {
        InitiateDownload { object, block_size, .. } => format!("{}, in blocks of {block_size}", named(object)),
        InitiateUpload { object, size, .. } => format!("{} in blocks{}", named(object), of_size(size)),
        Acknowledge(taken) => acknowledged(&taken),
        EndUpload(end) => format!("end of blocks, checksum {:#06x}", end.crc),
        EndDownload => "end of blocks taken".to_owned(),
    }
}

/// Text of a segment of a block transfer; `object` is the transferred object, if known.
pub(super) fn segment(frame: &Frame, object: Option<Object>) -> String {
    let last = if transfer::is_last(frame) { "last segment" } else { "segment" };
    let of = object.map_or("a block".to_owned(), named);
    let data = frame.data().get(1..).unwrap_or_default();
    format!("{last} {} of {of}: {}", transfer::number(frame), bytes(data))
}

/// Text of a frame that is either a segment of a block transfer or the command described by `other`.
pub(super) fn unknown(frame: &Frame, other: &str) -> String {
    format!("unknown, {other} or segment {} of a block: {}", transfer::number(frame), bytes(frame.data()))
}

fn of_size(size: Option<u32>) -> String {
    size.map_or(String::new(), |size| format!(", {}", counted(size, "byte")))
}

fn acknowledged(taken: &block::Acknowledge) -> String {
    format!("block taken up to segment {}, next of {}", taken.sequence, taken.block_size)
}
