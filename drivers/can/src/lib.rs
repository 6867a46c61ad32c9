//! CAN as the rest of the stack sees it: frames, identifiers, ports, recordings and bus time.
//!
//! Read [`Frame`] and [`Port`] first. Nothing here interprets a payload; that is `canopen`'s work.
//! Only the SocketCAN port touches the operating system.

pub mod clock;
mod error_frame;
mod frame;
mod id;
mod instant;
mod port;
mod socketcan;
pub mod timing;
mod virtual_port;

pub use error_frame::{ControllerFlags, ErrorCounts, ErrorFrame, ProtocolViolation};
pub use frame::Frame;
pub use id::{ExtendedId, Id, StandardId};
pub use instant::Instant;
pub use port::{ControllerState, Counters, Port, PortError, Received};
pub use self::socketcan::{BATCH, InterfaceName, OpenError, SocketCanOptions, SocketCanPort};
pub use virtual_port::{VirtualPeer, VirtualPort, virtual_port};
