//! Service requests during operation: the mode of operation, and the code of a fault without EMCY.

use canopen::Object;
use canopen::objects::{ERROR_CODE, MODE_OF_OPERATION, MODE_OF_OPERATION_DISPLAY};
use canopen::sdo::Write;

use super::mode::ModeRequest;

/// One service request during operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Service {
    Mode(ModeRequest),
    /// Read object 0x603F, after a fault without EMCY.
    ErrorCode,
}

impl Service {
    pub(super) fn object(self) -> Object {
        match self {
            Self::Mode(ModeRequest::Tell(_)) => MODE_OF_OPERATION,
            Self::Mode(ModeRequest::Look) => MODE_OF_OPERATION_DISPLAY,
            Self::ErrorCode => ERROR_CODE,
        }
    }

    /// The value to write; `None` for a read.
    pub(super) fn write(self) -> Option<Write> {
        match self {
            Self::Mode(ModeRequest::Tell(mode)) => Some(Write::new(self.object(), mode.raw())),
            Self::Mode(ModeRequest::Look) | Self::ErrorCode => None,
        }
    }
}
