//! SDO (CiA 301): reading (upload) and writing (download) one object of a node's dictionary.
//!
//! [`Request`] goes from client to server, [`Response`] back; both are always 8 bytes. A server has
//! one channel, so a client asks one thing at a time.

mod abort;
mod layout;
mod server;

pub use abort::AbortCode;
pub use layout::{Expedited, Initiate, Request, Response, Segment, Unsupported};
pub use server::{Dictionary, MAX_SIZE, Server};
