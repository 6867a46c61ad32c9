//! Recordings in the format of `candump -L`, which `canplayer`, Wireshark and most CAN tools read:
//!
//! ```text
//! (1795242630.522011) vcan0 601#4041600000000000
//! (1795242630.522153) vcan0 581#4F41600000000000 R
//! ```
//!
//! An [`Entry`] is one line. Times keep their microseconds and lose the nanoseconds. A frame that was
//! written reads back the same, error frames included. CAN FD frames and raw length codes above 8
//! (`_9` to `_F`) are left out: reading one is an error.

use std::fmt;

use thiserror::Error;

use crate::frame::{ERROR, EXTENDED, REMOTE};
use crate::{Frame, Instant, InterfaceName};

/// Which way a frame went, seen from the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Direction {
    /// The host sent it (`T`).
    Sent,
    /// The host received it (`R`).
    Received,
}

/// A line of a recording; `Display` writes it without the line's end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// When the frame was sent or received.
    pub at: Instant,
    /// On which interface.
    pub interface: InterfaceName,
    /// The frame.
    pub frame: Frame,
    /// Which way it went; `candump` says so if run with `-x`.
    pub direction: Option<Direction>,
}

impl fmt::Display for Entry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({}) {} {}", self.at, self.interface, self.frame)?;
        match self.direction {
            Some(Direction::Sent) => f.write_str(" T"),
            Some(Direction::Received) => f.write_str(" R"),
            None => Ok(()),
        }
    }
}

impl Entry {
    /// Reads a line; white space at its end is ignored.
    pub fn parse(line: &[u8]) -> Result<Self, LineError> {
        let mut words = line.trim_ascii_end().split(|&byte| byte == b' ');
        let time = words.next().ok_or(LineError::Time)?;
        let interface = words.next().ok_or(LineError::Interface)?;
        let frame = words.next().ok_or(LineError::Id)?;
        let direction = match words.next() {
            None => None,
            Some(b"T") => Some(Direction::Sent),
            Some(b"R") => Some(Direction::Received),
            Some(_) => return Err(LineError::Direction),
        };
        if words.next().is_some() {
            return Err(LineError::Direction);
        }
        Ok(Self {
            at: parse_time(time).ok_or(LineError::Time)?,
            interface: str::from_utf8(interface).ok().and_then(InterfaceName::new).ok_or(LineError::Interface)?,
            frame: parse_frame(frame)?,
            direction,
        })
    }
}

/// What is wrong with a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum LineError {
    #[error("expected a time such as (1795242630.522011)")]
    Time,
    #[error("expected an interface name of 1 to 15 bytes")]
    Interface,
    #[error("expected an identifier of 3 or 8 hexadecimal digits and a #")]
    Id,
    #[error("a CAN FD frame, which is not supported")]
    Fd,
    #[error("expected 0 to 8 bytes in hexadecimal, or R and a length of 0 to 8")]
    Data,
    #[error("expected nothing, T or R behind the frame")]
    Direction,
}

fn parse_time(text: &[u8]) -> Option<Instant> {
    let text = text.strip_prefix(b"(")?.strip_suffix(b")")?;
    let (seconds, micros) = text.split_at_checked(text.len().checked_sub(7)?)?;
    let micros = number(micros.strip_prefix(b".")?, 10)?;
    let nanos = number(seconds, 10)?.checked_mul(1_000_000_000)?;
    nanos.checked_add(micros * 1000).map(Instant::from_nanos)
}

/// `None` for no digits, for a byte that is none, and beyond 64 bits.
fn number(digits: &[u8], radix: u32) -> Option<u64> {
    let all = digits.iter().try_fold(0_u64, |number, &digit| {
        let digit = char::from(digit).to_digit(radix)?;
        number.checked_mul(radix.into())?.checked_add(digit.into())
    });
    all.filter(|_| !digits.is_empty())
}

fn parse_frame(text: &[u8]) -> Result<Frame, LineError> {
    let split = text.iter().position(|&byte| byte == b'#');
    let (digits, payload) = text.split_at(split.ok_or(LineError::Id)?);
    let payload = &payload[1..];
    if payload.starts_with(b"#") {
        return Err(LineError::Fd);
    }
    let raw = number(digits, 16).and_then(|raw| u32::try_from(raw).ok());
    let raw = match (digits.len(), raw.ok_or(LineError::Id)?) {
        (3, raw @ ..=0x7FF) => raw,
        (8, raw @ ..=0x1FFF_FFFF) => raw | EXTENDED,
        (8, raw @ ERROR..=0x3FFF_FFFF) => raw,
        _ => return Err(LineError::Id),
    };
    let frame = if let Some(length) = payload.strip_prefix(b"R") {
        if raw & ERROR != 0 {
            return Err(LineError::Id);
        }
        let len = match length {
            [] => 0,
            [_] => number(length, 16).ok_or(LineError::Data)? as u8,
            _ => return Err(LineError::Data),
        };
        Frame::from_raw(raw | REMOTE, len, [0; 8])
    } else {
        let (pairs, odd) = payload.as_chunks::<2>();
        let mut data = [0; 8];
        let bytes = data.get_mut(..pairs.len()).filter(|_| odd.is_empty());
        for (byte, pair) in bytes.ok_or(LineError::Data)?.iter_mut().zip(pairs) {
            *byte = number(pair, 16).ok_or(LineError::Data)? as u8;
        }
        Frame::from_raw(raw, pairs.len() as u8, data)
    };
    frame.ok_or(LineError::Data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ExtendedId, StandardId};

    fn entry(frame: Frame, direction: Option<Direction>) -> Entry {
        Entry {
            at: Instant::from_nanos(1_795_242_630_522_011_000),
            interface: InterfaceName::new("vcan0").unwrap(),
            frame,
            direction,
        }
    }

    #[test]
    fn every_kind_of_frame_is_written_and_read_alike() {
        let upload = [0x40, 0x41, 0x60, 0, 0, 0, 0, 0];
        let standard = |raw| StandardId::new(raw).unwrap();
        let extended = ExtendedId::new(0x0000_0001).unwrap();
        let error = Frame::from_raw(0x2000_0204, 8, [0, 0x0C, 0, 0, 0, 0, 96, 0]);
        let cases = [
            (Frame::new(standard(0x601), &upload), None, "601#4041600000000000"),
            (Frame::new(standard(0x080), &[]), None, "080#"),
            (Frame::new(extended, &[0xAB]), None, "00000001#AB"),
            (Frame::remote(standard(0x701), 1), None, "701#R1"),
            (Frame::remote(extended, 0), None, "00000001#R0"),
            (error, None, "20000204#000C000000006000"),
            (Frame::new(standard(0x080), &[]), Some(Direction::Sent), "080# T"),
            (Frame::new(standard(0x7FF), &[1]), Some(Direction::Received), "7FF#01 R"),
        ];
        for (frame, direction, text) in cases {
            let entry = entry(frame.unwrap(), direction);
            let line = format!("(1795242630.522011) vcan0 {text}");
            assert_eq!(entry.to_string(), line);
            assert_eq!(Entry::parse(line.as_bytes()), Ok(entry), "{line}");
        }
    }

    #[test]
    fn what_other_tools_write_is_read() {
        let sync = Frame::new(StandardId::new(0x080).unwrap(), &[0x0A]).unwrap();
        let remote = Frame::remote(StandardId::new(0x080).unwrap(), 0).unwrap();
        for (text, frame) in [("080#0a", sync), ("080#0A\r\n", sync), ("080#R  ", remote)] {
            let line = format!("(1795242630.522011) vcan0 {text}");
            assert_eq!(Entry::parse(line.as_bytes()), Ok(entry(frame, None)), "{line}");
        }
    }

    #[test]
    fn a_wrong_line_is_refused_for_what_is_wrong_with_it() {
        use LineError::{Data, Direction, Fd, Id, Interface, Time};
        let cases = [
            ("", Interface),
            ("1.000000 can0 080#", Time),
            ("(1.0) can0 080#", Time),
            ("(.000000) can0 080#", Time),
            ("(1.00000x) can0 080#", Time),
            ("(99999999999.000000) can0 080#", Time),
            ("(1.000000) sixteen-letters- 080#", Interface),
            ("(1.000000)  080#", Interface),
            ("(1.000000) can0", Id),
            ("(1.000000) can0 080", Id),
            ("(1.000000) can0 #", Id),
            ("(1.000000) can0 800#", Id),
            ("(1.000000) can0 0080#", Id),
            ("(1.000000) can0 x80#", Id),
            ("(1.000000) can0 40000000#", Id),
            ("(1.000000) can0 123456789#", Id),
            ("(1.000000) can0 20000004#R1", Id),
            ("(1.000000) can0 080##311", Fd),
            ("(1.000000) can0 080#1", Data),
            ("(1.000000) can0 080#1x", Data),
            ("(1.000000) can0 080#112233445566778899", Data),
            ("(1.000000) can0 080#1122334455667788_9", Data),
            ("(1.000000) can0 080#R9", Data),
            ("(1.000000) can0 080#R12", Data),
            ("(1.000000) can0 080# X", Direction),
            ("(1.000000) can0 080# T R", Direction),
        ];
        for (line, error) in cases {
            assert_eq!(Entry::parse(line.as_bytes()), Err(error), "{line}");
        }
    }
}
