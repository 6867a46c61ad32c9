//! Recordings in the format of `candump -L`, which `canplayer`, Wireshark and most CAN tools read:
//!
//! ```text
//! (1795242630.522011) vcan0 601#4041600000000000
//! (1795242630.522153) vcan0 581#4F41600000000000 R
//! ```
//!
//! An [`Entry`] is one line. Times keep their microseconds and lose the nanoseconds. A frame that was
//! written reads back the same, error frames included.
//!
//! Lines of other tools are read in every form of `candump -l` and `-L`: names of interfaces padded to a column, times
//! with nanoseconds (`-N`) or with the date (`-t A`), data with `.` between the bytes, and raw length codes above 8
//! (`_9` to `_F`), which are not kept. CAN FD and CAN XL frames are told apart and are no [`Frame`]: reading one is an
//! error. A [`Line`] is any of these, and the note of lost frames that `candump -d` inserts.

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
        let (head, frame) = Head::split(line)?;
        let Head { at, interface, direction } = head;
        Ok(Self { at, interface, frame: parse_frame(frame)?, direction })
    }
}

/// A line of a log that any tool wrote.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line<'a> {
    /// A classic frame.
    Frame(Entry),
    /// A CAN FD or CAN XL frame.
    Other(Head, OtherFrame, &'a str),
    /// So many frames were lost before the next line.
    Dropped(u64),
}

/// Kinds of frames that are no [`Frame`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum OtherFrame {
    /// CAN FD.
    Fd,
    /// CAN XL.
    Xl,
}

impl<'a> Line<'a> {
    /// Reads a line; white space at its end is ignored.
    pub fn parse(line: &'a [u8]) -> Result<Self, LineError> {
        if let Some(note) = line.strip_prefix(b"DROPCOUNT: dropped ") {
            let digits = note.split(|&byte| byte == b' ').next().unwrap_or_default();
            return number(digits, 10).map(Self::Dropped).ok_or(LineError::Time);
        }
        let (head, text) = Head::split(line)?;
        let Head { at, interface, direction } = head;
        let other = match parse_frame(text) {
            Ok(frame) => return Ok(Self::Frame(Entry { at, interface, frame, direction })),
            Err(LineError::Fd) => OtherFrame::Fd,
            Err(LineError::Xl) => OtherFrame::Xl,
            Err(error) => return Err(error),
        };
        Ok(Self::Other(head, other, str::from_utf8(text).map_err(|_| LineError::Data)?))
    }
}

/// What a line says beside its frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    /// When the frame was sent or received.
    pub at: Instant,
    /// On which interface.
    pub interface: InterfaceName,
    /// Which way it went.
    pub direction: Option<Direction>,
}

impl Head {
    /// Splits a line into its head and the text of its frame.
    fn split(line: &[u8]) -> Result<(Self, &[u8]), LineError> {
        let line = line.trim_ascii_end();
        let end = line.iter().position(|&byte| byte == b')').ok_or(LineError::Time)?;
        let (time, rest) = line.split_at(end + 1);
        let at = parse_time(time).ok_or(LineError::Time)?;
        let rest = rest.strip_prefix(b" ").ok_or(LineError::Interface)?;
        let mut words = rest.split(|&byte| byte == b' ').filter(|word| !word.is_empty());
        let interface = words.next().ok_or(LineError::Interface)?;
        let interface = str::from_utf8(interface).ok().and_then(InterfaceName::new).ok_or(LineError::Interface)?;
        let frame = words.next().ok_or(LineError::Id)?;
        let direction = match (words.next(), words.next()) {
            (None, _) => None,
            (Some(b"T"), None) => Some(Direction::Sent),
            (Some(b"R"), None) => Some(Direction::Received),
            _ => return Err(LineError::Direction),
        };
        Ok((Self { at, interface, direction }, frame))
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
    #[error("a CAN XL frame, which is not supported")]
    Xl,
    #[error("expected 0 to 8 bytes in hexadecimal, or R and a length of 0 to 8")]
    Data,
    #[error("expected nothing, T or R behind the frame")]
    Direction,
}

/// Reads seconds with 6 or 9 decimals, or a date and a time of day, which is taken for UTC.
fn parse_time(text: &[u8]) -> Option<Instant> {
    let text = text.strip_prefix(b"(")?.strip_suffix(b")")?;
    let point = text.iter().position(|&byte| byte == b'.')?;
    let (whole, decimals) = (&text[..point], &text[point + 1..]);
    let nanos = match decimals.len() {
        6 => number(decimals, 10)? * 1000,
        9 => number(decimals, 10)? / 1000 * 1000,
        _ => return None,
    };
    let seconds = if whole.len() == "2026-01-31 12:00:00".len() { date_and_time(whole)? } else { number(whole, 10)? };
    seconds.checked_mul(1_000_000_000)?.checked_add(nanos).map(Instant::from_nanos)
}

/// Seconds since 1970 of a text such as `2026-01-31 12:00:00`.
fn date_and_time(text: &[u8]) -> Option<u64> {
    let field = |from: usize, to: usize| number(&text[from..to], 10);
    let separators = [(4, b'-'), (7, b'-'), (10, b' '), (13, b':'), (16, b':')];
    if separators.iter().any(|&(at, separator)| text[at] != separator) {
        return None;
    }
    let (year, month, day) = (field(0, 4)?, field(5, 7)?, field(8, 10)?);
    let (hour, minute, second) = (field(11, 13)?, field(14, 16)?, field(17, 19)?);
    if year < 1970 || !(1..=12).contains(&month) || !(1..=31).contains(&day) || hour > 23 || minute > 59 || second > 60
    {
        return None;
    }
    // Years begin in March, so that the leap day is the last day of its year.
    let (year, month) = if month < 3 { (year - 1, month + 9) } else { (year, month - 3) };
    let days =
        (365 * year + year / 4 - year / 100 + year / 400 + (153 * month + 2) / 5 + day - 1).checked_sub(719_468)?;
    Some(((days * 24 + hour) * 60 + minute) * 60 + second)
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
    let raw = number(digits, 16).and_then(|raw| u32::try_from(raw).ok());
    let (xl, raw) = (is_xl(payload), raw.ok_or(LineError::Id)?);
    let raw = match (digits.len(), raw) {
        (3, raw @ ..=0x7FF) => raw,
        // The upper bits of a CAN XL frame are its virtual network.
        (5, _) if xl => return Err(LineError::Xl),
        (8, raw @ ..=0x1FFF_FFFF) => raw | EXTENDED,
        (8, raw @ ERROR..=0x3FFF_FFFF) => raw,
        _ => return Err(LineError::Id),
    };
    if xl {
        return Err(LineError::Xl);
    }
    if let Some(fd) = payload.strip_prefix(b"#") {
        return Err(if is_fd(fd) { LineError::Fd } else { LineError::Data });
    }
    let (payload, code) = match payload {
        [payload @ .., b'_', code] => (payload, Some(*code)),
        _ => (payload, None),
    };
    let frame = if let Some(length) = payload.strip_prefix(b"R").or(payload.strip_prefix(b"r")) {
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
        let mut data = [0; 8];
        let len = read_bytes(payload, &mut data).ok_or(LineError::Data)?;
        Frame::from_raw(raw, len as u8, data)
    };
    let frame = frame.ok_or(LineError::Data)?;
    match code {
        None => Ok(frame),
        // A raw length code is a second reading of the length of a full frame.
        Some(code) if frame.len_code() == 8 && number(&[code], 16).is_some_and(|code| code > 8) => Ok(frame),
        Some(_) => Err(LineError::Data),
    }
}

/// Reads bytes in hexadecimal, which may have a `.` between them. Returns their number; `None` if they are too many.
fn read_bytes(text: &[u8], into: &mut [u8]) -> Option<usize> {
    let (mut rest, mut count) = (text, 0);
    while let [high, low, tail @ ..] = rest {
        *into.get_mut(count)? = number(&[*high, *low], 16)? as u8;
        count += 1;
        rest = match tail {
            [b'.', next, ..] if *next != b'.' => &tail[1..],
            _ => tail,
        };
    }
    rest.is_empty().then_some(count)
}

/// Whether `text` is the flags and the data of a CAN FD frame.
fn is_fd(text: &[u8]) -> bool {
    let [flags, data @ ..] = text else {
        return false;
    };
    let len = read_bytes(data, &mut [0; 64]);
    number(&[*flags], 16).is_some() && len.is_some_and(|len| matches!(len, 0..=8 | 12 | 16 | 20 | 24 | 32 | 48 | 64))
}

/// Whether `text` is `FLAGS:SDT:AF#DATA`, as in a CAN XL frame.
fn is_xl(text: &[u8]) -> bool {
    let [f, g, b':', s, t, b':', rest @ ..] = text else {
        return false;
    };
    let Some((acceptance, [b'#', data @ ..])) = rest.split_at_checked(8) else {
        return false;
    };
    let numbers = [&[*f, *g], &[*s, *t], acceptance].iter().all(|digits| number(digits, 16).is_some());
    numbers && read_bytes(data, &mut [0; 2048]).is_some_and(|len| len > 0)
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
        for (text, frame) in [("080#0a", sync), ("080#0A\r\n", sync), ("080#R  ", remote), ("080#r0", remote)] {
            let line = format!("(1795242630.522011) vcan0 {text}");
            assert_eq!(Entry::parse(line.as_bytes()), Ok(entry(frame, None)), "{line}");
        }
    }

    #[test]
    fn every_form_of_the_lines_of_candump_is_read() {
        let id = StandardId::new(0x123).unwrap();
        let full = Frame::new(id, &[0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88]).unwrap();
        let remote = Frame::remote(id, 8).unwrap();
        let table = [
            // Names of several interfaces are padded to one column.
            ("(1795242630.522011)    vcan0 123#1122334455667788", full),
            ("(1795242630.522011000) vcan0 123#1122334455667788", full),
            ("(2026-11-21 06:30:30.522011) vcan0 123#1122334455667788", full),
            ("(1795242630.522011) vcan0 123#11.22.33.44.55.66.77.88", full),
            ("(1795242630.522011) vcan0 123#1122334455667788_F", full),
            ("(1795242630.522011) vcan0 123#R8_9", remote),
        ];
        for (line, frame) in table {
            assert_eq!(Entry::parse(line.as_bytes()), Ok(entry(frame, None)), "{line}");
        }
        let early = Entry::parse(b"(0000000001.000250) vcan0 123#R8").unwrap();
        assert_eq!(early.at, Instant::from_nanos(1_000_250_000));
        let early = Entry::parse(b"(1970-03-01 00:00:01.000000) vcan0 123#R8").unwrap();
        assert_eq!(early.at, Instant::from_nanos(59 * 86_400_000_000_000 + 1_000_000_000));
    }

    #[test]
    fn frames_of_newer_buses_and_notes_of_losses_are_told_apart() {
        let head = Head {
            at: Instant::from_nanos(1_000_000_000),
            interface: InterfaceName::new("can0").unwrap(),
            direction: Some(Direction::Received),
        };
        let table = [
            ("(1.000000) can0 080##3 R", OtherFrame::Fd, "080##3"),
            ("(1.000000) can0 12345678##1112233 R", OtherFrame::Fd, "12345678##1112233"),
            ("(1.000000) can0 123#81:00:12345678#11223344 R", OtherFrame::Xl, "123#81:00:12345678#11223344"),
            ("(1.000000) can0 45123#81:00:12345678#11 R", OtherFrame::Xl, "45123#81:00:12345678#11"),
        ];
        for (line, kind, text) in table {
            assert_eq!(Line::parse(line.as_bytes()), Ok(Line::Other(head, kind, text)), "{line}");
        }
        let note = b"DROPCOUNT: dropped 12 CAN frames on 'can0' socket (total drops 12)";
        assert_eq!(Line::parse(note), Ok(Line::Dropped(12)));
    }

    #[test]
    fn a_wrong_line_is_refused_for_what_is_wrong_with_it() {
        use LineError::{Data, Direction, Fd, Id, Interface, Time, Xl};
        let cases = [
            ("", Time),
            ("1.000000 can0 080#", Time),
            ("(1.0) can0 080#", Time),
            ("(.000000) can0 080#", Time),
            ("(1.00000x) can0 080#", Time),
            ("(99999999999.000000) can0 080#", Time),
            ("(1.000000) sixteen-letters- 080#", Interface),
            ("(1.000000)", Interface),
            ("(1.000000)can0 080#", Interface),
            ("(1.0000000) can0 080#", Time),
            ("(2026-13-21 07:50:30.522011) can0 080#", Time),
            ("(0000-01-21 07:50:30.522011) can0 080#", Time),
            ("(2026/11/21 07:50:30.522011) can0 080#", Time),
            ("> (1.000000) can0 080#", Time),
            ("(1.000000)  080#", Id),
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
            ("(1.000000) can0 080##", Data),
            ("(1.000000) can0 080##3112233445566778899", Data),
            ("(1.000000) can0 080#81:00:12345678#11", Xl),
            ("(1.000000) can0 080#11..22", Data),
            ("(1.000000) can0 080#11.", Data),
            ("(1.000000) can0 080#1", Data),
            ("(1.000000) can0 080#1x", Data),
            ("(1.000000) can0 080#112233445566778899", Data),
            ("(1.000000) can0 080#1122334455667788_8", Data),
            ("(1.000000) can0 080#11_9", Data),
            ("(1.000000) can0 080#R9", Data),
            ("(1.000000) can0 080#R12", Data),
            ("(1.000000) can0 080# X", Direction),
            ("(1.000000) can0 080# T R", Direction),
            ("(1.000000) can0 080# <- the SYNC", Direction),
        ];
        for (line, error) in cases {
            assert_eq!(Entry::parse(line.as_bytes()), Err(error), "{line}");
        }
    }
}
