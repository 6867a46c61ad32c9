//! SDO (CiA 301 §7.2.4): reading (upload) and writing (download) one object of a node's dictionary.
//!
//! A [`Request`] goes from the client to the server, a [`Response`] from the server to the client. Both have 8 bytes. A
//! server has one channel, and serves one transfer at a time. [`block`] transfer needs fewer frames for large objects.

mod abort;
pub mod block;
mod layout;
mod server;

pub use abort::AbortCode;
pub use layout::{Expedited, Initiate, Request, Response, Segment, Write};
pub use server::{Dictionary, MAX_SIZE, Server};
