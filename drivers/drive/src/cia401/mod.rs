//! Digital inputs and outputs of a CiA 401 node on a CAN bus: touch probes, light gates, valves.
//!
//! [`CanBus::with_io`](crate::bus::CanBus::with_io) takes one [`IoConfig`] per node and returns one [`IoLink`] per
//! node.
//!
//! - **Inputs.** The node sends TPDO 1 when an input changes, at most once per inhibit time, and at least once per
//!   event timer. [`InputImage`] has the level, the number of edges and the time of the last edge of each input. The
//!   time of an edge is the receive time of the frame that showed it first. An input that changes twice within the
//!   inhibit time may show no edge. [`InputImage::edges_since`] has the last 32 edges of all inputs in their
//!   order. A reader that reads before 32 further edges have come misses no edge.
//! - **Outputs.** [`OutputCommand`] is a word of levels. The owner of the bus sends RPDO 1 in the cycle after a change,
//!   and repeats it once per heartbeat period: a lost frame is repaired within a heartbeat period. The node takes the
//!   levels at once. Before the first command the outputs are commanded to their error values. An output that keeps its
//!   level in the error state has the last level sent, through any number of faults, resets and bring-ups.
//! - **Levels** are logical. The driver inverts the inputs and outputs that are configured as inverted.
//! - **Silence of the node** is a fault: three event timers without inputs, or three heartbeat periods without a
//!   heartbeat. A faulted node has no levels ([`InputImage::input`] returns `None`), and its outputs are commanded to
//!   their error state. The axes of the bus do not stop by themselves.
//! - **A fault is latched** until [`IoLink::reset_fault`] or the next bring-up. A reset configures and starts the node
//!   as bring-up does, while the axes go on. The outputs then have the levels of the error state until the next command.
//! - **Faults of the bus** are faults of every I/O node as well: bus-off, an error of the port, another controller, and
//!   a heartbeat of the host that the port did not take.
//! - **An EMCY** of the node is a warning of the group and [`InputImage::error`]. The node goes on.
//! - **Silence of the host.** After three missing heartbeats of the host the node enters the state stopped by itself
//!   (0x1029:01). There the outputs take the error state (0x6206, 0x6207): an error value, or the level that they have.
//!   The same happens when the owner of the bus is dropped. The images then have the fault [`IoFault::Ended`].
//! - **Rehearsals** have no bus. [`RehearsedIo`] stands in for the node there.
//!
//! # Which objects are written
//!
//! Bring-up checks device type, identity and the numbers of blocks. Bring-up writes and reads back the following:
//! - the settings of the cell ([`IoConfig::configuration`]), before all others;
//! - heartbeats (0x1016:01, 0x1017) and the reaction to their loss (0x1029:01);
//! - inputs: polarity (0x6002), filter (0x6003) and interrupts (0x6005 to 0x6008), where the node has these objects. A
//!   filter is required in a block with a filtered input;
//! - outputs: polarity (0x6202) and filter (0x6208), where the node has these objects; error mode (0x6206) and error
//!   value (0x6207);
//! - process data: TPDO 1 and RPDO 1 are mapped and the other PDOs switched off. The deadline of RPDO 1 (0x1400:05) is
//!   switched off, where the node has it: the heartbeat watches the host.
//!
//! Not supported: more than 64 inputs or outputs, analogue channels, and nodes whose mapping is fixed.

mod config;
mod edges;
mod fault;
mod image;
mod node;
mod program;
mod rehearsed;
mod reserved;

#[cfg(test)]
mod tests;

pub use config::{IoConfig, IoQuantity, check};
pub use edges::{EDGES, Edge, EdgesLost};
pub use fault::IoFault;
pub use image::{Input, InputImage, IoError, IoLink, LatestInputs, OutputCommand, SentOutputs};
pub(crate) use node::IoNode;
pub use program::pdo_setups;
pub(crate) use program::program;
pub use rehearsed::RehearsedIo;
pub use reserved::reserved;
