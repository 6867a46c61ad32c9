//! CiA 301, 305, 306, 401 and 402 as frame layouts, object tables and description files, shared by both ends of the wire.
//!
//! A *layout* turns a [`can::Frame`] into a value of Rust and back. Every value can be encoded, unknown numbers are kept,
//! and a frame of another layout decodes to `None`. Golden bytes in the tests pin each layout.
//!
//! State machines of the host (SDO client, LSS master, power states) are in the room `drivers/master`. The device's end of
//! SDO is here: [`sdo::Server`] answers for the emulated devices and for the tests of the client.
//!
//! No layout and no server allocates. The files that describe devices, [`eds`] and [`dcf`], are read on the heap.
//!
//! Section numbers are those of CiA 301 version 4.2.0, CiA 305 version 3.0.0, CiA 306-1 version 1.4.0 and CiA 402-2
//! version 3.0.0.
//!
//! Left out: PDO mappings whose entries are not whole bytes. Read [`cob`] and [`sdo`] first, then [`cia402`].

pub mod cia401;
pub mod cia402;
pub mod cob;
pub mod dcf;
pub mod eds;
pub mod emcy;
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

/// The first four bytes of little-endian data as a number; missing bytes are zero.
pub fn number(data: &[u8]) -> u32 {
    data.iter().take(4).rev().fold(0, |number, &byte| number << 8 | u32::from(byte))
}

/// The frame that candump prints as `text`.
#[cfg(test)]
fn parse(text: &str) -> Frame {
    let line = format!("(0.000000) vcan0 {text}");
    can::candump::Entry::parse(line.as_bytes()).unwrap().frame
}
