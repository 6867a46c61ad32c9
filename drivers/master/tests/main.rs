//! Tests of the state machines by their public interface, in one executable.

mod arbitrary_frames;
mod block_transfer;
mod client_and_server;
mod lss_slaves;
