//! Reports of an slcan adapter to its host.

use crate::timing::Format;
use crate::{ControllerState, Frame};

use super::splitter::Piece;
use super::text::{LineError, Rest, TextLine};

/// What an adapter says to its host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum AdapterReport {
    /// An empty line: a command was done.
    Done,
    /// A bell: a command was refused.
    Refused,
    /// `z`, `Z`: a frame of that format was taken for sending; some adapters say [`AdapterReport::Done`].
    Transmitted(Format),
    /// `t`, `T`, `r`, `R`: a frame came from the bus. `stamp`, where time stamps are on, is the time since the
    /// adapter's minute began, ms, 0 to 59 999.
    Received { frame: Frame, stamp: Option<u16> },
    /// `s`: fault confinement state, and receive and transmit error counters of three decimals, so 999 stands for more.
    State { state: ControllerState, receive: u16, transmit: u16 },
    /// `e`: errors seen on the bus.
    Errors(BusErrors),
    /// `Vxxyy`: two decimals each for hardware and software, read as hexadecimal digits.
    Version { hardware: u8, software: u8 },
    /// `vxxyy`: major and minor version of the firmware.
    Firmware { major: u8, minor: u8 },
    /// `Nxxxx`: four letters or digits.
    SerialNumber([u8; 4]),
    /// `Fxx`: what happened since flags were last asked for.
    Flags(StatusFlags),
    /// `A`: no received frame is left to be polled.
    PollEnd,
}

impl AdapterReport {
    /// The line that says it; `None` for what no line can say: an error frame, or a serial number
    /// of other than letters and digits.
    pub fn encode(&self) -> Option<TextLine> {
        let line = match *self {
            Self::Done => TextLine::new(b""),
            Self::Refused => return Some(TextLine::new(b"\x07")),
            Self::Transmitted(Format::Standard) => TextLine::new(b"z"),
            Self::Transmitted(Format::Extended) => TextLine::new(b"Z"),
            Self::Received { frame, stamp } => match stamp {
                Some(stamp) => TextLine::frame(&frame)?.hex(u32::from(stamp), 4),
                None => TextLine::frame(&frame)?,
            },
            Self::State { state, receive, transmit } => {
                let [a, b, c] = decimals(receive);
                let [d, e, f] = decimals(transmit);
                TextLine::new(&[b's', state_letter(state), a, b, c, d, e, f])
            }
            Self::Errors(errors) => {
                let mut line = TextLine::new(b"e").hex(errors.letters().count() as u32, 1);
                errors.letters().for_each(|letter| line.push(letter));
                line
            }
            Self::Version { hardware, software } => {
                TextLine::new(b"V").hex(u32::from(hardware), 2).hex(u32::from(software), 2)
            }
            Self::Firmware { major, minor } => TextLine::new(b"v").hex(u32::from(major), 2).hex(u32::from(minor), 2),
            Self::SerialNumber(number) => {
                if !number.iter().all(u8::is_ascii_alphanumeric) {
                    return None;
                }
                let [a, b, c, d] = number;
                TextLine::new(&[b'N', a, b, c, d])
            }
            Self::Flags(flags) => TextLine::new(b"F").hex(u32::from(flags.0), 2),
            Self::PollEnd => TextLine::new(b"A"),
        };
        Some(line.end())
    }

    /// Reads what a [`Splitter`](super::Splitter) cut out.
    pub fn parse(piece: Piece<'_>) -> Result<Self, LineError> {
        let line = match piece {
            Piece::Line(line) => line,
            Piece::Bell => return Ok(Self::Refused),
        };
        let Some((&letter, rest)) = line.split_first() else {
            return Ok(Self::Done);
        };
        let mut rest = Rest(rest);
        let report = match letter {
            b'z' => Self::Transmitted(Format::Standard),
            b'Z' => Self::Transmitted(Format::Extended),
            b't' | b'T' | b'r' | b'R' => {
                let frame = rest.frame(letter)?;
                let stamp = match rest.0 {
                    [] => None,
                    _ => Some(rest.hex(4)? as u16),
                };
                Self::Received { frame, stamp }
            }
            b's' => Self::State {
                state: state_of(rest.byte()?).ok_or(LineError::Character)?,
                receive: rest.decimal(3)? as u16,
                transmit: rest.decimal(3)? as u16,
            },
            b'e' => {
                let count = rest.decimal(1)?;
                let errors = (0..count).try_fold(BusErrors::default(), |errors, _| {
                    let error = BusErrors::of_letter(rest.byte()?).ok_or(LineError::Character)?;
                    Ok(errors | error)
                })?;
                Self::Errors(errors)
            }
            b'V' => Self::Version { hardware: rest.hex(2)? as u8, software: rest.hex(2)? as u8 },
            b'v' => Self::Firmware { major: rest.hex(2)? as u8, minor: rest.hex(2)? as u8 },
            b'N' => {
                let number = [rest.byte()?, rest.byte()?, rest.byte()?, rest.byte()?];
                if !number.iter().all(u8::is_ascii_alphanumeric) {
                    return Err(LineError::Character);
                }
                Self::SerialNumber(number)
            }
            b'F' => Self::Flags(StatusFlags(rest.hex(2)? as u8)),
            b'A' => Self::PollEnd,
            b'd' | b'D' | b'b' | b'B' => return Err(LineError::Fd),
            _ => return Err(LineError::Unknown(letter)),
        };
        rest.end()?;
        Ok(report)
    }
}

fn decimals(number: u16) -> [u8; 3] {
    let number = number.min(999);
    [number / 100, number / 10 % 10, number % 10].map(|digit| b'0' + digit as u8)
}

fn state_letter(state: ControllerState) -> u8 {
    match state {
        ControllerState::Active => b'a',
        ControllerState::Warning => b'w',
        ControllerState::Passive => b'p',
        ControllerState::BusOff => b'b',
    }
}

fn state_of(letter: u8) -> Option<ControllerState> {
    use ControllerState::{Active, BusOff, Passive, Warning};
    [Active, Warning, Passive, BusOff].into_iter().find(|&state| state_letter(state) == letter)
}

/// Kinds of errors seen on the bus; a line names each at most once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusErrors(u8);

impl BusErrors {
    /// `a`: nobody acknowledged a frame.
    pub const ACKNOWLEDGE: Self = Self(0x01);
    /// `b`: a bit sent dominant was read recessive.
    pub const BIT_0: Self = Self(0x02);
    /// `B`: a bit sent recessive was read dominant.
    pub const BIT_1: Self = Self(0x04);
    /// `c`: a checksum was wrong.
    pub const CRC: Self = Self(0x08);
    /// `f`: a fixed bit of a frame was wrong.
    pub const FORM: Self = Self(0x10);
    /// `o`: the adapter lost a frame from the bus.
    pub const RECEIVE_OVERRUN: Self = Self(0x20);
    /// `O`: the adapter lost a frame from the host.
    pub const TRANSMIT_OVERRUN: Self = Self(0x40);
    /// `s`: six equal bits in a row.
    pub const STUFF: Self = Self(0x80);

    /// Letters in the order of the bits.
    const LETTERS: [u8; 8] = *b"abBcfoOs";

    /// Whether all of `other` are among these.
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    fn letters(self) -> impl Iterator<Item = u8> {
        let letters = Self::LETTERS.into_iter().enumerate();
        letters.filter_map(move |(bit, letter)| (self.0 >> bit & 1 == 1).then_some(letter))
    }

    fn of_letter(letter: u8) -> Option<Self> {
        let bit = Self::LETTERS.iter().position(|&known| known == letter)?;
        Some(Self(1 << bit))
    }
}

impl std::ops::BitOr for BusErrors {
    type Output = Self;
    fn bitor(self, rhs: Self) -> Self {
        Self(self.0 | rhs.0)
    }
}

/// The flags of [`AdapterReport::Flags`], those of an SJA1000.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StatusFlags(pub u8);

impl StatusFlags {
    /// The queue of received frames was full.
    pub const RECEIVE_QUEUE_FULL: u8 = 0x01;
    /// An error counter passed 96.
    pub const ERROR_WARNING: u8 = 0x04;
    /// The controller lost a received frame.
    pub const DATA_OVERRUN: u8 = 0x08;
    /// An error counter passed 127.
    pub const ERROR_PASSIVE: u8 = 0x20;
    /// An error was seen on the bus.
    pub const BUS_ERROR: u8 = 0x80;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ExtendedId, StandardId};

    fn parse(text: &str) -> Result<AdapterReport, LineError> {
        match text.strip_suffix('\r') {
            Some(line) => AdapterReport::parse(Piece::Line(line.as_bytes())),
            None => AdapterReport::parse(Piece::Bell),
        }
    }

    #[test]
    fn reports_are_written_and_read_as_on_the_line() {
        use ControllerState::{Active, BusOff, Passive, Warning};
        let received = |frame: Option<Frame>, stamp| AdapterReport::Received { frame: frame.unwrap(), stamp };
        let state = |state, receive, transmit| AdapterReport::State { state, receive, transmit };
        let standard = |raw| StandardId::new(raw).unwrap();
        let extended = |raw| ExtendedId::new(raw).unwrap();
        let full = [0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88];
        let version = AdapterReport::Version { hardware: 0x10, software: 0x13 };
        let firmware = AdapterReport::Firmware { major: 1, minor: 8 };
        let three = BusErrors::BIT_0 | BusErrors::CRC | BusErrors::TRANSMIT_OVERRUN;
        let cases = [
            (AdapterReport::Done, "\r"),
            (AdapterReport::Refused, "\x07"),
            (AdapterReport::Transmitted(Format::Standard), "z\r"),
            (AdapterReport::Transmitted(Format::Extended), "Z\r"),
            (received(Frame::new(standard(0x701), &[0x7F]), None), "t70117F\r"),
            (received(Frame::new(standard(0x080), &[]), Some(59_999)), "t0800EA5F\r"),
            (received(Frame::new(extended(0x1111_2222), &full), Some(0xEA5F)), "T1111222281122334455667788EA5F\r"),
            (received(Frame::remote(standard(0x701), 1), Some(0)), "r70110000\r"),
            (received(Frame::remote(extended(0x1FFF_FFFF), 0), None), "R1FFFFFFF0\r"),
            (state(Active, 57, 33), "sa057033\r"),
            (state(Warning, 0, 96), "sw000096\r"),
            (state(Passive, 128, 0), "sp128000\r"),
            (state(BusOff, 256, 256), "sb256256\r"),
            (AdapterReport::Errors(BusErrors::ACKNOWLEDGE), "e1a\r"),
            (AdapterReport::Errors(three), "e3bcO\r"),
            (AdapterReport::Errors(BusErrors(0xFF)), "e8abBcfoOs\r"),
            (version, "V1013\r"),
            (firmware, "v0108\r"),
            (AdapterReport::SerialNumber(*b"A123"), "NA123\r"),
            (AdapterReport::Flags(StatusFlags(0xA4)), "FA4\r"),
            (AdapterReport::PollEnd, "A\r"),
        ];
        for (report, text) in cases {
            let line = report.encode().unwrap();
            assert_eq!(str::from_utf8(&line).unwrap(), text);
            assert_eq!(parse(text), Ok(report), "{text:?}");
        }
    }

    #[test]
    fn counters_above_999_are_written_as_999() {
        let state = AdapterReport::State { state: ControllerState::BusOff, receive: 1000, transmit: u16::MAX };
        assert_eq!(*state.encode().unwrap(), *b"sb999999\r");
    }

    #[test]
    fn an_error_named_twice_is_read_once() {
        assert_eq!(parse("e3aba\r"), Ok(AdapterReport::Errors(BusErrors(0x03))));
    }

    #[test]
    fn what_no_line_can_say_is_not_encoded() {
        let frame = Frame::from_raw(0x2000_0004, 8, [0; 8]).unwrap();
        let error = AdapterReport::Received { frame, stamp: None };
        for report in [error, AdapterReport::SerialNumber(*b"A\r23")] {
            assert_eq!(report.encode(), None, "{report:?}");
        }
    }

    #[test]
    fn a_wrong_report_is_refused_for_what_is_wrong_with_it() {
        use LineError::{Character, DataLength, Fd, Id, Length, Unknown};
        let cases = [
            ("O", Unknown(b'O')),
            ("D1238", Fd),
            ("zz", Length),
            ("t0800EA5", Length),
            ("t0800EA5F0", Length),
            ("t0800EA5G", Character),
            ("t0809", DataLength),
            ("TFFFFFFFF0", Id),
            ("sx000000", Character),
            ("sa00000", Length),
            ("sa0000000", Length),
            ("sa00A000", Character),
            ("e", Length),
            ("e2a", Length),
            ("e1ab", Length),
            ("e1x", Character),
            ("V101", Length),
            ("N12 4", Character),
            ("F1", Length),
        ];
        for (line, error) in cases {
            assert_eq!(parse(&format!("{line}\r")), Err(error), "{line}");
        }
    }
}
