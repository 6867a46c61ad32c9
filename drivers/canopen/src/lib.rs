//! CiA 301 and CiA 402 as sans-I/O objects and tables.
//!
//! Two levels. The *layouts* turn [`can::Frame`]s into typed representations and back: whatever can
//! be built can be encoded, unknown values are kept, and what is not the layout's frame decodes to
//! `None`. Both ends of the wire share them. The *objects* ([`sdo::Client`], [`nmt::Master`],
//! [`heartbeat::Consumer`], [`sync::Producer`] …) are state machines that own no port and no clock:
//! frames and the time are handed in, frames and events are taken out. Nothing allocates, but for the
//! room for data that a [`sdo::Client`] makes when it is made, and the files that describe devices, [`eds`] and
//! [`dcf`].
//!
//! Left out: PDO mappings that are not byte aligned.
//!
//! Read [`cob`] and [`sdo`] first, then [`cia402`].

pub mod cia402;
pub mod cob;
pub mod dcf;
pub mod eds;
pub mod emcy;
pub mod guarding;
pub mod heartbeat;
pub mod lss;
pub mod nmt;
mod node_id;
pub mod objects;
pub mod pdo;
pub mod sdo;
pub mod sync;
pub mod time;
pub mod wire_timing;

pub use node_id::NodeId;
pub use objects::Object;

use can::{Frame, StandardId};

/// A data frame of `N` bytes; more than 8 do not compile.
fn frame<const N: usize>(id: StandardId, data: [u8; N]) -> Frame {
    const { assert!(N <= 8) };
    Frame::new(id, &data).expect("at most 8 bytes fit a frame")
}

/// The payload of a data frame sent under `id`.
fn payload(frame: &Frame, id: StandardId) -> Option<&[u8]> {
    (frame.standard_data_id() == Some(id)).then(|| frame.data())
}

/// The frame that candump prints as `text`.
#[cfg(test)]
fn parse(text: &str) -> Frame {
    let line = format!("(0.000000) vcan0 {text}");
    can::candump::Entry::parse(line.as_bytes()).unwrap().frame
}
