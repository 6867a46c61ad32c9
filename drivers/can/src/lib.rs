//! CAN as the rest of the stack sees it: frames, identifiers, ports, recordings and bus time.
//!
//! Read [`Frame`] and [`Port`] first. Nothing here interprets a payload; that is `canopen`'s work.
//! Only [`SocketCanPort`], [`Claim`], [`card`], [`clock`] and [`send_only`] touch the operating system.

pub mod candump;
pub mod card;
mod claim;
pub mod clock;
mod counted;
mod error_frame;
mod frame;
mod id;
mod instant;
mod interface;
mod port;
mod replay_port;
pub mod schedule;
pub mod send_only;
pub mod slcan;
mod socketcan;
pub mod timing;
mod tracer;
mod virtual_port;

pub use self::socketcan::{BATCH, OpenError, SocketCanOptions, SocketCanPort};
pub use claim::{Claim, ClaimError, Holder};
pub use counted::{counted, counted_as};
pub use frame::Frame;
pub use id::{ExtendedId, Id, StandardId};
pub use instant::Instant;
pub use interface::InterfaceName;
pub use port::{ControllerState, Counters, Port, PortError, Received};
pub use replay_port::{ReplayFeed, ReplayPort};
pub use tracer::{TraceEntry, TraceEvent, TraceReader, Traced, Tracer};
pub use virtual_port::{VirtualPeer, VirtualPort, virtual_port};
