//! The text that CAN adapters on serial lines speak (slcan, after Lawicel's CAN232): both ways, no I/O.
//!
//! A [`Command`] goes from host to adapter, a [`AdapterReport`] from adapter to host; each encodes to a
//! [`TextLine`] and parses from what a [`Splitter`] cuts out of the stream. Lines end with a carriage
//! return; the adapter's refusal is a bell without one. Numbers are hexadecimal, written in capitals
//! and read in either case, but for the decimal counters of a state line.
//!
//! ```text
//! S8 O                    bit rate 1 Mbit/s, open
//! t6018 4041600000000000  data frame 0x601 of 8 bytes (without the blanks), back with 4 digits of ms behind
//! T000000011AB r7011      extended data frame; remote frame that asks for 1 byte
//! sw096000 e2ac           error warning at 96 receive and 0 transmit errors; acknowledge and CRC errors
//! ```
//!
//! Left out: CAN FD (`d`, `D`, `b`, `B`: [`LineError::Fd`]) and raw length codes above 8. Linux's own slcan driver
//! drops lines of up to four characters unread. The answer `z` and error lines of one or two letters are therefore
//! not sent.

mod command;
mod report;
mod splitter;
mod text;

pub use command::{BITRATES_KBPS, Command};
pub use report::{AdapterReport, BusErrors, StatusFlags};
pub use splitter::{Piece, Splitter};
pub use text::{LONGEST, LineError, TextLine};
