//! Serial lines and the telegrams of axis controllers and sensors on them.
//!
//! A [`Line`] carries bytes and never waits. [`hi_moxa`] and [`nfv2`] have the telegrams of the axis controllers of the
//! IRb-6 and IRp-6 at Warsaw University of Technology. [`ati`] has the telegrams of the force/torque sensors of these
//! robots. [`ultrasonic`] has the frames of an ultrasonic matrix, and [`camera`] those of a network camera. [`epos2`]
//! and [`epos4`] have the frames of maxon's service ports. Telegrams and frames are layouts only, in both directions,
//! shared by drivers and emulators. [`service`] is the client of the service ports. Read [`Line`] first.

pub mod ati;
pub mod camera;
pub mod epos2;
pub mod epos4;
pub mod hi_moxa;
mod line;
mod line_tracer;
pub mod nfv2;
pub mod service;
mod slcan_port;
mod tty;
pub mod ultrasonic;
mod virtual_line;

pub use line::{Line, LineCounters, LineError, Settings, StopBits};
pub use line_tracer::{CHUNK as TRACE_CHUNK, LineEntry, LineEvent, LineFeed, LineTraceReader, LineTracer, ReplayLine};
pub use slcan_port::{SlcanError, SlcanPort};
pub use tty::{OpenError, Tty};
pub use virtual_line::{TimedByte, VirtualLine, VirtualLinePeer, virtual_line};
