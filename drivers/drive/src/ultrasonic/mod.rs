//! Ultrasonic matrices on serial lines of their own.
//!
//! [`UltrasonicMatrix`] is a [`DriveGroup`](crate::DriveGroup) without axes. The driver measures one scan after the other.
//! Through the [`UltrasonicLink`] a controller reads the [`UltrasonicState`] of each cycle with the last complete
//! [`Scan`].
//!
//! # Scans
//! A scan has up to 16 shots with up to 16 echo times each ([`ScanKind`]). The driver sends one query at a time. The
//! matrix measures during several cycles. A cycle without an answer writes nothing. The reply has a checksum and repeats
//! its query. The time of a shot is the arrival time of its query; emission *i* of the shot begins *i* firing slots later
//! ([`Scan::emission`]). A query without a valid reply within its time is lost: its echoes are missing in the scan.
//!
//! # Faults
//! A fault is latched until [`UltrasonicLink::reset_fault`] or the next bring-up. During a fault the state keeps the last
//! scan, and [`UltrasonicState::measured`] returns `None`. A requested reset takes effect with the next complete scan.
//!
//! | fault | condition |
//! |---|---|
//! | [`Silent`](UltrasonicFault::Silent) | more than the tolerated queries in a row had no reply |
//! | [`Garbage`](UltrasonicFault::Garbage) | the same, and at least one reading among them was no valid reply |
//! | [`Refused`](UltrasonicFault::Refused) | the matrix refused a query |
//! | [`Line`](UltrasonicFault::Line) | the line failed |
//!
//! A fault of a matrix does not stop any axis: the task that reads the matrix must stop them.
//!
//! # Bring-up
//! Bring-up waits until the line is quiet and asks for the identity. A matrix that is absent, sends garbage or has another
//! size, pitch or firing slot than declared ends bring-up with an [`UltrasonicError`].
//!
//! A rehearsal has no wire: [`RehearsedUltrasonic`] replaces the matrix.

mod bring_up;
mod config;
mod fault;
mod matrix;
mod receiver;
mod rehearsed;
mod state;

pub use config::{ScanKind, UltrasonicConfig, UltrasonicConfigError};
pub use fault::{UltrasonicError, UltrasonicFault};
pub use matrix::{UltrasonicCounters, UltrasonicMatrix};
pub use rehearsed::RehearsedUltrasonic;
pub use state::{MOST_ECHOES, MOST_SHOTS, Scan, UltrasonicLink, UltrasonicState};
