//! Commands of a host to an slcan adapter.

use crate::Frame;
use crate::timing::Bitrate;

use super::text::{LineError, Rest, TextLine};

/// What `S0` to `S8` stand for, kbit/s, as Linux's driver has it.
///
/// python-can takes `S7` for 750 kbit/s, and its `S9` of 83.3 kbit/s is refused here.
pub const BITRATES_KBPS: [u32; 9] = [10, 20, 50, 100, 125, 250, 500, 800, 1000];

/// What a host says to an adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum Command {
    /// An empty line: asks for nothing, ends what noise may stand in the adapter's buffer.
    Empty,
    /// `S0` to `S8`: one of [`BITRATES_KBPS`]; while the channel is closed.
    Bitrate(Bitrate),
    /// `sxxyy`: the registers BTR0 (synchronisation jump width and prescaler) and BTR1 (sampling and time segments) of
    /// an SJA1000 at 16 MHz; while the channel is closed.
    BitTiming { btr0: u8, btr1: u8 },
    /// `O`: opens the channel.
    Open,
    /// `L`: opens the channel to listen: nothing is sent, not even acknowledge bits.
    ListenOnly,
    /// `l`: opens the channel to itself.
    Loopback,
    /// `C`: closes the channel.
    Close,
    /// `t`, `T`, `r`, `R`: sends a frame. An error frame cannot be sent.
    Transmit(Frame),
    /// `V`: asks for [`AdapterReport::Version`](super::AdapterReport::Version).
    Version,
    /// `v`: asks for [`AdapterReport::Firmware`](super::AdapterReport::Firmware).
    Firmware,
    /// `N`: asks for [`AdapterReport::SerialNumber`](super::AdapterReport::SerialNumber).
    SerialNumber,
    /// `F`: asks for [`AdapterReport::Flags`](super::AdapterReport::Flags) and clears them.
    Flags,
    /// `Z0`, `Z1`: whether received frames carry a time stamp.
    TimeStamps(bool),
    /// `Mxxxxxxxx`: the acceptance code registers of an SJA1000.
    AcceptanceCode(u32),
    /// `mxxxxxxxx`: the acceptance mask registers of an SJA1000; a set bit is not looked at.
    AcceptanceMask(u32),
    /// `U0` to `U6`: the speed of the serial line, 230 400 to 2400 baud.
    LineSpeed(u8),
    /// `X0`, `X1`: whether received frames are reported unasked.
    AutoPoll(bool),
    /// `P`: asks for one received frame.
    Poll,
    /// `A`: asks for all received frames and a [`AdapterReport::PollEnd`](super::AdapterReport::PollEnd).
    PollAll,
}

impl Command {
    /// The line that says it; `None` for what no line can say: an error frame, a bit rate that is
    /// none of [`BITRATES_KBPS`], a line speed above 6.
    pub fn encode(&self) -> Option<TextLine> {
        let line = match *self {
            Self::Empty => TextLine::new(b""),
            Self::Bitrate(bitrate) => {
                let mut rates = BITRATES_KBPS.iter();
                let number = rates.position(|&kbps| kbps == bitrate.kbps())?;
                TextLine::new(b"S").hex(number as u32, 1)
            }
            Self::BitTiming { btr0, btr1 } => TextLine::new(b"s").hex(u32::from(btr0), 2).hex(u32::from(btr1), 2),
            Self::Open => TextLine::new(b"O"),
            Self::ListenOnly => TextLine::new(b"L"),
            Self::Loopback => TextLine::new(b"l"),
            Self::Close => TextLine::new(b"C"),
            Self::Transmit(frame) => TextLine::frame(&frame)?,
            Self::Version => TextLine::new(b"V"),
            Self::Firmware => TextLine::new(b"v"),
            Self::SerialNumber => TextLine::new(b"N"),
            Self::Flags => TextLine::new(b"F"),
            Self::TimeStamps(on) => TextLine::new(b"Z").hex(u32::from(on), 1),
            Self::AcceptanceCode(code) => TextLine::new(b"M").hex(code, 8),
            Self::AcceptanceMask(mask) => TextLine::new(b"m").hex(mask, 8),
            Self::LineSpeed(speed) if speed > 6 => return None,
            Self::LineSpeed(speed) => TextLine::new(b"U").hex(u32::from(speed), 1),
            Self::AutoPoll(on) => TextLine::new(b"X").hex(u32::from(on), 1),
            Self::Poll => TextLine::new(b"P"),
            Self::PollAll => TextLine::new(b"A"),
        };
        Some(line.end())
    }

    /// Reads a line without its end.
    pub fn parse(line: &[u8]) -> Result<Self, LineError> {
        let Some((&letter, rest)) = line.split_first() else {
            return Ok(Self::Empty);
        };
        let mut rest = Rest(rest);
        let command = match letter {
            b'S' => {
                let kbps = BITRATES_KBPS.get(rest.decimal(1)? as usize);
                let bitrate = kbps.and_then(|&kbps| Bitrate::from_kbps(kbps));
                Self::Bitrate(bitrate.ok_or(LineError::Character)?)
            }
            b's' => Self::BitTiming { btr0: rest.hex(2)? as u8, btr1: rest.hex(2)? as u8 },
            b'O' => Self::Open,
            b'L' => Self::ListenOnly,
            b'l' => Self::Loopback,
            b'C' => Self::Close,
            b't' | b'T' | b'r' | b'R' => Self::Transmit(rest.frame(letter)?),
            b'V' => Self::Version,
            b'v' => Self::Firmware,
            b'N' => Self::SerialNumber,
            b'F' => Self::Flags,
            b'Z' => Self::TimeStamps(rest.switch()?),
            b'M' => Self::AcceptanceCode(rest.hex(8)?),
            b'm' => Self::AcceptanceMask(rest.hex(8)?),
            b'U' => match rest.decimal(1)? as u8 {
                speed @ 0..=6 => Self::LineSpeed(speed),
                _ => return Err(LineError::Character),
            },
            b'X' => Self::AutoPoll(rest.switch()?),
            b'P' => Self::Poll,
            b'A' => Self::PollAll,
            b'd' | b'D' | b'b' | b'B' => return Err(LineError::Fd),
            _ => return Err(LineError::Unknown(letter)),
        };
        rest.end()?;
        Ok(command)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ExtendedId, StandardId};

    #[test]
    fn commands_are_written_and_read_as_on_the_line() {
        let standard = |raw| StandardId::new(raw).unwrap();
        let extended = |raw| ExtendedId::new(raw).unwrap();
        let upload = [0x40, 0x41, 0x60, 0, 0, 0, 0, 0];
        let send = |frame: Option<Frame>| Command::Transmit(frame.unwrap());
        let cases = [
            (Command::Empty, "\r"),
            (Command::Bitrate(Bitrate::from_kbps(10).unwrap()), "S0\r"),
            (Command::Bitrate(Bitrate::from_kbps(800).unwrap()), "S7\r"),
            (Command::Bitrate(Bitrate::KBPS_1000), "S8\r"),
            (Command::BitTiming { btr0: 0x03, btr1: 0x1C }, "s031C\r"),
            (Command::Open, "O\r"),
            (Command::ListenOnly, "L\r"),
            (Command::Loopback, "l\r"),
            (Command::Close, "C\r"),
            (send(Frame::new(standard(0x601), &upload)), "t60184041600000000000\r"),
            (send(Frame::new(standard(0x080), &[])), "t0800\r"),
            (send(Frame::new(extended(0x12AB_CDEF), &[0xAA, 0x55])), "T12ABCDEF2AA55\r"),
            (send(Frame::remote(standard(0x701), 1)), "r7011\r"),
            (send(Frame::remote(extended(1), 8)), "R000000018\r"),
            (Command::Version, "V\r"),
            (Command::Firmware, "v\r"),
            (Command::SerialNumber, "N\r"),
            (Command::Flags, "F\r"),
            (Command::TimeStamps(false), "Z0\r"),
            (Command::TimeStamps(true), "Z1\r"),
            (Command::AcceptanceCode(0x1234_5678), "M12345678\r"),
            (Command::AcceptanceMask(0xFFFF_FFFF), "mFFFFFFFF\r"),
            (Command::LineSpeed(6), "U6\r"),
            (Command::AutoPoll(true), "X1\r"),
            (Command::Poll, "P\r"),
            (Command::PollAll, "A\r"),
        ];
        for (command, text) in cases {
            let line = command.encode().unwrap();
            assert_eq!(str::from_utf8(&line).unwrap(), text);
            assert_eq!(Command::parse(&line[..line.len() - 1]), Ok(command), "{text:?}");
        }
    }

    #[test]
    fn small_letters_are_read_as_digits() {
        let frame = Frame::new(StandardId::new(0x7AB).unwrap(), &[0xCD]).unwrap();
        assert_eq!(Command::parse(b"t7ab1cd"), Ok(Command::Transmit(frame)));
    }

    #[test]
    fn what_no_line_can_say_is_not_encoded() {
        let error = Frame::from_raw(0x2000_0004, 8, [0; 8]).unwrap();
        let odd = Bitrate::from_kbps(40).unwrap();
        for command in [Command::Transmit(error), Command::Bitrate(odd), Command::LineSpeed(7)] {
            assert_eq!(command.encode(), None, "{command:?}");
        }
    }

    #[test]
    fn a_wrong_command_is_refused_for_what_is_wrong_with_it() {
        use LineError::{Character, DataLength, Fd, Id, Length, Unknown};
        let cases = [
            ("z", Unknown(b'z')),
            (" ", Unknown(b' ')),
            ("d1238", Fd),
            ("S", Length),
            ("S88", Length),
            ("S9", Character),
            ("Sx", Character),
            ("OO", Length),
            ("s031", Length),
            ("Z", Length),
            ("Z2", Character),
            ("U7", Character),
            ("M1234567", Length),
            ("m123456789", Length),
            ("t", Length),
            ("t080", Length),
            ("t8000", Id),
            ("t0809112233445566778899", DataLength),
            ("t080F", DataLength),
            ("t0801112", Length),
            ("t08021", Length),
            ("t080x", Character),
            ("t08011x", Character),
            ("t+801", Character),
            ("T200000000", Id),
            ("r0809", DataLength),
            ("r080211", Length),
        ];
        for (line, error) in cases {
            assert_eq!(Command::parse(line.as_bytes()), Err(error), "{line}");
        }
    }
}
