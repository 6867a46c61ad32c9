//! SDO block transfer in words.

use can::Frame;
use canopen::NodeId;
use canopen::sdo::block;

use super::{bytes, named};

pub(super) fn request(frame: &Frame, node: NodeId) -> Option<String> {
    use block::Request::{
        Acknowledge, EndDownload, EndUpload, InitiateDownload, InitiateUpload, StartUpload,
    };
    Some(match block::Request::decode(frame, node)? {
        InitiateDownload { object, size, .. } => {
            format!("write {} in blocks{}", named(object), of_size(size))
        }
        InitiateUpload {
            object, block_size, ..
        } => format!("read {} in blocks of {block_size}", named(object)),
        StartUpload => "first block, please".to_owned(),
        Acknowledge(taken) => acknowledged(&taken),
        EndDownload(end) => format!("end of blocks, checksum {:#06x}", end.crc),
        EndUpload => "end of blocks taken".to_owned(),
    })
}

pub(super) fn response(frame: &Frame, node: NodeId) -> Option<String> {
    use block::Response::{Acknowledge, EndDownload, EndUpload, InitiateDownload, InitiateUpload};
    Some(match block::Response::decode(frame, node)? {
        InitiateDownload {
            object, block_size, ..
        } => format!("{}, in blocks of {block_size}", named(object)),
        InitiateUpload { object, size, .. } => {
            format!("{} in blocks{}", named(object), of_size(size))
        }
        Acknowledge(taken) => acknowledged(&taken),
        EndUpload(end) => format!("end of blocks, checksum {:#06x}", end.crc),
        EndDownload => "end of blocks taken".to_owned(),
    })
}

pub(super) fn segment(frame: &Frame) -> String {
    format!("segment of a block: {}", bytes(frame.data()))
}

fn of_size(size: Option<u32>) -> String {
    size.map_or(String::new(), |size| format!(", {size} bytes"))
}

fn acknowledged(taken: &block::Acknowledge) -> String {
    format!(
        "block taken up to segment {}, next of {}",
        taken.sequence, taken.block_size
    )
}
