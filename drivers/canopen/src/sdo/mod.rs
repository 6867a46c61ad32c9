//! SDO (CiA 301): reading (upload) and writing (download) one object of a node's dictionary.
//!
//! [`Request`] goes from client to server, [`Response`] back; both are always 8 bytes. A server has
//! one channel, so a [`Client`] asks one thing at a time. Large objects go faster by [`block`] transfer.

mod abort;
pub mod block;
mod layout;
mod server;

pub use abort::AbortCode;
pub use layout::{Expedited, Initiate, Request, Response, Segment, Unsupported, Write};
pub use server::{Dictionary, MAX_SIZE, Server};
