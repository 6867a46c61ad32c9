//! The host's end of CANopen: state machines of a controller, without ports and without clocks.
//!
//! | module | what the host does |
//! |---|---|
//! | [`sdo`] | reads and writes the objects of a node |
//! | [`pdo`] | configures a PDO of a node |
//! | [`power`] | leads a drive of CiA 402 through its power states |
//! | [`lss`] | gives node-IDs to nodes, and finds nodes that have none |
//!
//! The caller owns the port and the clock. It gives each received frame to `handle`, sends the frames of
//! `poll_transmit`, calls `handle_timeout` at the time of `poll_timeout`, and takes results from `poll`. Memory is
//! allocated only when an [`sdo::Client`] is made.
//!
//! The frame layouts are those of [`canopen`]. The emulated devices share these layouts and do not depend on this room:
//! an emulator with a state machine of the host would have the same mistakes as the host.
//!
//! Read [`sdo::Client`] first.

pub mod lss;
pub mod pdo;
pub mod power;
pub mod sdo;

/// The frame that candump prints as `text`.
#[cfg(test)]
fn parse(text: &str) -> can::Frame {
    let line = format!("(0.000000) vcan0 {text}");
    can::candump::Entry::parse(line.as_bytes()).unwrap().frame
}
