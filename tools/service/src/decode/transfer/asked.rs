//! The request that starts an SDO transfer, its answer, and the state of the channel after the answer.

use can::Frame;
use canopen::sdo::block::{self, MAX_BLOCK_SIZE};
use canopen::sdo::{Initiate, Request, Response};
use canopen::{NodeId, Object};

use super::{Block, SessionState, Stage, Way};

/// Transfer that a client requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Asked {
    Expedited(Object),
    Segments(Way, Object),
    BlockDownload(Object),
    BlockUpload {
        object: Object,
        /// Maximum number of segments in the first sub-block.
        size: u8,
    },
}

impl Asked {
    /// Transfer that a frame of the client requests; `None` for all other frames.
    pub(super) fn of(frame: &Frame, node: NodeId) -> Option<Self> {
        if let Some(request) = block::Request::decode(frame, node) {
            return match request {
                block::Request::InitiateDownload { object, .. } => {
                    Some(Self::BlockDownload(object))
                }
                block::Request::InitiateUpload {
                    object, block_size, ..
                } => Some(Self::BlockUpload {
                    object,
                    size: block_size.min(MAX_BLOCK_SIZE),
                }),
                block::Request::EndDownload(_)
                | block::Request::StartUpload
                | block::Request::Acknowledge(_)
                | block::Request::EndUpload => None,
            };
        }
        match Request::decode(frame, node)? {
            Request::InitiateDownload { object, initiate } => Some(match initiate {
                Initiate::Expedited(_) => Self::Expedited(object),
                Initiate::Segmented { .. } => Self::Segments(Way::Download, object),
            }),
            Request::InitiateUpload { object } => Some(Self::Segments(Way::Upload, object)),
            Request::DownloadSegment(_)
            | Request::UploadSegment { .. }
            | Request::Abort { .. }
            | Request::Unsupported(_) => None,
        }
    }

    const fn object(self) -> Object {
        match self {
            Self::Expedited(object)
            | Self::Segments(_, object)
            | Self::BlockDownload(object)
            | Self::BlockUpload { object, .. } => object,
        }
    }

    /// Whether a frame of the server answers this request.
    pub(super) fn is_answered(self, frame: &Frame, node: NodeId) -> bool {
        let answered = match block::Response::decode(frame, node) {
            Some(block::Response::InitiateDownload { object, .. }) => {
                matches!(self, Self::BlockDownload(_)).then_some(object)
            }
            Some(block::Response::InitiateUpload { object, .. }) => {
                matches!(self, Self::BlockUpload { .. }).then_some(object)
            }
            Some(_) => None,
            None => match (self, Response::decode(frame, node)) {
                // A server may answer a request for a block upload with an expedited or segmented upload.
                (
                    Self::Segments(Way::Upload, _) | Self::BlockUpload { .. },
                    Some(Response::InitiateUpload { object, .. }),
                )
                | (
                    Self::Expedited(_) | Self::Segments(Way::Download, _),
                    Some(Response::InitiateDownload { object }),
                ) => Some(object),
                _ => None,
            },
        };
        answered == Some(self.object())
    }

    /// State of the channel after `answer`, the server's answer to this request.
    pub(super) fn begun(self, answer: &Frame, node: NodeId) -> SessionState {
        let object = Some(self.object());
        match (self, block::Response::decode(answer, node)) {
            (Self::Segments(Way::Download, _), _) => SessionState::DownloadSegments {
                object,
                last: false,
            },
            (
                Self::BlockDownload(_),
                Some(block::Response::InitiateDownload { block_size, .. }),
            ) if (1..=MAX_BLOCK_SIZE).contains(&block_size) => SessionState::Block(Block {
                stage: Stage::Segments,
                size: block_size,
                ..Block::new(Way::Download, object)
            }),
            (Self::BlockUpload { size, .. }, Some(_)) => SessionState::Block(Block {
                size,
                ..Block::new(Way::Upload, object)
            }),
            (Self::Segments(Way::Upload, _) | Self::BlockUpload { .. }, None)
                if is_segmented(answer, node) =>
            {
                SessionState::UploadSegments(object)
            }
            // The answer completes the transfer, or its block size is invalid.
            (
                Self::Expedited(_)
                | Self::Segments(Way::Upload, _)
                | Self::BlockDownload(_)
                | Self::BlockUpload { .. },
                _,
            ) => SessionState::Idle,
        }
    }
}

/// Whether the answer to an upload request announces a segmented upload.
fn is_segmented(answer: &Frame, node: NodeId) -> bool {
    matches!(
        Response::decode(answer, node),
        Some(Response::InitiateUpload {
            initiate: Initiate::Segmented { .. },
            ..
        })
    )
}
