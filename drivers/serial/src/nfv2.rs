//! NFv2, the later telegrams of the IRb-6 axis controllers: framed, addressed, with a CRC-8.
//!
//! ```text
//! 23  N  !N  address  (code length data…)…  crc      N: index of the crc byte
//! ```
//!
//! Host and drive use the same frame. A read request is a code without data, and its answer is the same code with data.
//! The CRC polynomial ends in three zero bits, so only five bits are effective. One damaged frame in 32 passes the CRC;
//! the reader must check the plausibility of the contents. Layouts only, for the codes that an axis needs. Not
//! implemented: RC servos, digital and analogue inputs, displays, and other boards of the family.

use crc::{Algorithm, Crc};

/// First byte of a frame.
pub const START: u8 = 0x23;

/// Bytes before the first command.
const HEADER: usize = 4;

/// Length of the longest frame: commands up to index 254, and the CRC.
pub const LONGEST: usize = 256;

/// Address of the host.
pub const MASTER: u8 = 0xFE;

/// Address of all devices.
pub const BROADCAST: u8 = 0xFF;

/// Pulse width of a fully driven power stage.
pub const FULL_PWM: i16 = 1000;

/// CRC-8, polynomial 0xD8, initial 0, most significant bit first, neither reflected nor inverted.
pub fn crc8(bytes: &[u8]) -> u8 {
    static TABLE: Crc<u8> = Crc::<u8>::new(&Algorithm {
        width: 8,
        poly: 0xD8,
        init: 0,
        refin: false,
        refout: false,
        xorout: 0,
        check: 0xF8,
        residue: 0,
    });
    TABLE.checksum(bytes)
}

/// Operating mode of a drive, and state of its power stage, by the code on the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Mode {
    /// Error: power stage and emergency stop of the cabinet are open.
    Error = 0,
    /// Manual: power off, latched errors cleared.
    Manual = 1,
    /// Speed control.
    Speed = 2,
    /// Current control.
    Current = 3,
    /// Position control.
    Position = 4,
    /// Pulse-width control.
    Pwm = 5,
    /// As [`Mode::Pwm`]. The next index pulse also zeroes the position counter and sets [`Status::SYNCHRONIZED`].
    SyncPwm = 0x10,
    /// As [`Mode::Current`], with the same effect of the next index pulse.
    SyncCurrent = 0x11,
    /// As [`Mode::Position`], with the same effect of the next index pulse.
    SyncPosition = 0x12,
}

impl Mode {
    const ALL: [Self; 9] = [
        Self::Error,
        Self::Manual,
        Self::Speed,
        Self::Current,
        Self::Position,
        Self::Pwm,
        Self::SyncPwm,
        Self::SyncCurrent,
        Self::SyncPosition,
    ];

    /// Decodes a code; `None` for an unknown code.
    pub fn from_raw(raw: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| *mode as u8 == raw)
    }
}

/// Gains of a regulator in the drive, in units of 2⁻¹⁵.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gains {
    /// Proportional.
    pub p: u16,
    /// Integral.
    pub i: u16,
    /// Differential.
    pub d: u16,
    /// Not used by the drives.
    pub t: u16,
}

impl Gains {
    /// Gains of the current regulator after power-on: p 0.06, i 0.05.
    pub const POWER_ON: Self = Self { p: 1966, i: 1638, d: 0, t: 0 };
}

/// One command of a frame from the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Changes the mode.
    SetMode(Mode),
    /// Set-point of the speed modes.
    SetSpeed(i32),
    /// Set-point of the current modes, mA.
    SetCurrent(i16),
    /// Set-point of the position modes, encoder pulses.
    SetPosition(i32),
    /// Set-point of the pulse-width modes, -1000 to 1000.
    SetPwm(i16),
    /// Current at which the overcurrent protection acts, mA.
    SetMaxCurrent(i16),
    /// [`Command::SET_SYNCHRONIZED`], [`Command::RESET_SYNCHRONIZED`].
    SetMisc(u32),
    /// Gains of the current regulator.
    SetCurrentRegulator(Gains),
    /// Requests the position.
    ReadPosition,
    /// Requests the current.
    ReadCurrent,
    /// Requests the status.
    ReadStatus,
}

impl Command {
    /// Declares the position counter referenced.
    pub const SET_SYNCHRONIZED: u32 = 1;
    /// Declares the position counter unreferenced.
    pub const RESET_SYNCHRONIZED: u32 = 2;
}

/// One item of a frame from a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Position counter, encoder pulses.
    Position(i32),
    /// Motor current, mA, signed.
    Current(i16),
    /// Switches, state and faults.
    Status(Status),
}

/// Status of a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status(pub u16);

impl Status {
    /// The upper limit switch is closed.
    pub const UPPER_LIMIT: u16 = 1 << 0;
    /// The lower limit switch is closed.
    pub const LOWER_LIMIT: u16 = 1 << 1;
    /// The synchronisation (home) switch is closed.
    pub const HOME_SWITCH: u16 = 1 << 2;
    /// The index signal of the encoder.
    pub const INDEX: u16 = 1 << 3;
    /// The position counter is referenced.
    pub const SYNCHRONIZED: u16 = 1 << 4;
    /// A position limit of the drive was reached.
    pub const POSITION_LIMITED: u16 = 1 << 10;
    /// A speed limit of the drive was reached.
    pub const SPEED_LIMITED: u16 = 1 << 11;
    /// A current limit of the drive was reached.
    pub const CURRENT_LIMITED: u16 = 1 << 12;
    /// The current exceeded the limit of the overcurrent protection.
    pub const OVERCURRENT: u16 = 1 << 13;
    /// The power stage has failed or is off.
    pub const POWER_STAGE_FAULT: u16 = 1 << 14;
    /// The drive is in its error state.
    pub const ERROR: u16 = 1 << 15;

    /// Whether any of `bits` is set.
    pub const fn any(self, bits: u16) -> bool {
        self.0 & bits != 0
    }
}

/// A frame under construction. An item that does not fit is left out, and `finish` then returns `None`.
#[derive(Clone, Debug)]
pub struct FrameBuilder {
    bytes: [u8; LONGEST],
    length: usize,
    fits: bool,
}

impl FrameBuilder {
    /// A frame from the host to the drive `address`, or from the drive `address` to the host.
    pub fn new(address: u8) -> Self {
        let mut bytes = [0; LONGEST];
        bytes[0] = START;
        bytes[3] = address;
        Self { bytes, length: HEADER, fits: true }
    }

    /// Appends a command of the host.
    pub fn command(&mut self, command: Command) -> &mut Self {
        match command {
            Command::SetMode(mode) => self.item(0x10, &[mode as u8]),
            Command::SetSpeed(speed) => self.item(0x11, &speed.to_le_bytes()),
            Command::SetCurrent(current) => self.item(0x12, &current.to_le_bytes()),
            Command::SetPosition(position) => self.item(0x13, &position.to_le_bytes()),
            Command::SetPwm(pwm) => self.item(0x14, &pwm.to_le_bytes()),
            Command::SetMaxCurrent(current) => self.item(0x15, &current.to_le_bytes()),
            Command::ReadPosition => self.item(0x1A, &[]),
            Command::ReadCurrent => self.item(0x1B, &[]),
            Command::SetMisc(bits) => self.item(0x1E, &bits.to_le_bytes()),
            Command::ReadStatus => self.item(0x1F, &[]),
            Command::SetCurrentRegulator(Gains { p, i, d, t }) => {
                let [[p0, p1], [i0, i1], [d0, d1], [t0, t1]] = [p, i, d, t].map(u16::to_le_bytes);
                self.item(0x40, &[p0, p1, i0, i1, d0, d1, t0, t1])
            }
        }
    }

    /// Appends an answer of a drive.
    pub fn answer(&mut self, answer: Answer) -> &mut Self {
        match answer {
            Answer::Position(position) => self.item(0x1A, &position.to_le_bytes()),
            Answer::Current(current) => self.item(0x1B, &current.to_le_bytes()),
            Answer::Status(status) => self.item(0x1F, &status.0.to_le_bytes()),
        }
    }

    fn item(&mut self, code: u8, data: &[u8]) -> &mut Self {
        let end = self.length + 2 + data.len();
        // The last byte is reserved for the CRC.
        self.fits &= end < LONGEST;
        if self.fits {
            self.bytes[self.length] = code;
            self.bytes[self.length + 1] = data.len() as u8;
            self.bytes[self.length + 2..end].copy_from_slice(data);
            self.length = end;
        }
        self
    }

    /// The frame in wire format; `None` if the frame has no command or an item did not fit.
    pub fn finish(&mut self) -> Option<&[u8]> {
        if !self.fits || self.length == HEADER {
            return None;
        }
        let last = self.length;
        self.bytes[1] = last as u8;
        self.bytes[2] = !(last as u8);
        self.bytes[last] = crc8(&self.bytes[3..last]);
        Some(&self.bytes[..=last])
    }
}

/// A frame with correct header and CRC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Address of the drive that receives or sends the frame.
    pub address: u8,
    items: &'a [u8],
}

impl<'a> Frame<'a> {
    /// Length of the frame that starts with these bytes; `None` if no frame starts here, or for fewer than three bytes.
    pub fn length(bytes: &[u8]) -> Option<usize> {
        match *bytes {
            [START, index, inverted, ..] if index == !inverted && usize::from(index) > HEADER => {
                Some(usize::from(index) + 1)
            }
            _ => None,
        }
    }

    /// Decodes a frame from exactly these bytes; `None` if header, length or CRC are wrong.
    pub fn parse(bytes: &'a [u8]) -> Option<Self> {
        let last = Self::length(bytes)?.checked_sub(1)?;
        if bytes.len() != last + 1 || crc8(&bytes[3..last]) != bytes[last] {
            return None;
        }
        Some(Self { address: bytes[3], items: &bytes[HEADER..last] })
    }

    /// Items of the frame: code and data. An item that claims more data than available ends the sequence with an `Err`.
    fn items(self) -> impl Iterator<Item = Result<(u8, &'a [u8]), Malformed>> {
        let mut rest = self.items;
        std::iter::from_fn(move || match *rest {
            [] => None,
            [code, length, ref tail @ ..] if usize::from(length) <= tail.len() => {
                let (data, after) = tail.split_at(usize::from(length));
                rest = after;
                Some(Ok((code, data)))
            }
            _ => {
                rest = &[];
                Some(Err(Malformed))
            }
        })
    }

    /// Commands of the host.
    pub fn commands(self) -> impl Iterator<Item = Result<Command, Malformed>> {
        self.items().map(|item| {
            let (code, data) = item?;
            Ok(match (code, data) {
                (0x10, &[mode]) => Command::SetMode(Mode::from_raw(mode).ok_or(Malformed)?),
                (0x11, &[a, b, c, d]) => Command::SetSpeed(i32::from_le_bytes([a, b, c, d])),
                (0x12, &[a, b]) => Command::SetCurrent(i16::from_le_bytes([a, b])),
                (0x13, &[a, b, c, d]) => Command::SetPosition(i32::from_le_bytes([a, b, c, d])),
                (0x14, &[a, b]) => Command::SetPwm(i16::from_le_bytes([a, b])),
                (0x15, &[a, b]) => Command::SetMaxCurrent(i16::from_le_bytes([a, b])),
                (0x1A, []) => Command::ReadPosition,
                (0x1B, []) => Command::ReadCurrent,
                (0x1E, &[a, b, c, d]) => Command::SetMisc(u32::from_le_bytes([a, b, c, d])),
                (0x1F, []) => Command::ReadStatus,
                (0x40, &[p0, p1, i0, i1, d0, d1, t0, t1]) => {
                    let [p, i, d, t] = [[p0, p1], [i0, i1], [d0, d1], [t0, t1]].map(u16::from_le_bytes);
                    Command::SetCurrentRegulator(Gains { p, i, d, t })
                }
                _ => return Err(Malformed),
            })
        })
    }

    /// Answers of a drive.
    pub fn answers(self) -> impl Iterator<Item = Result<Answer, Malformed>> {
        self.items().map(|item| {
            Ok(match item? {
                (0x1A, &[a, b, c, d]) => Answer::Position(i32::from_le_bytes([a, b, c, d])),
                (0x1B, &[a, b]) => Answer::Current(i16::from_le_bytes([a, b])),
                (0x1F, &[a, b]) => Answer::Status(Status(u16::from_le_bytes([a, b]))),
                _ => return Err(Malformed),
            })
        })
    }
}

/// An item that cannot be decoded: an unknown code, or data of a wrong length.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("item not understood")]
pub struct Malformed;

#[cfg(test)]
mod tests {
    use super::*;

    const CYCLIC: [u8; 15] = [0x23, 0x0E, 0xF1, 0x08, 0x14, 0x02, 0x64, 0x00, 0x1A, 0x00, 0x1B, 0x00, 0x1F, 0x00, 0xE0];
    const ANSWER: [u8; 19] = [
        0x23, 0x12, 0xED, 0x08, 0x1A, 0x04, 0x2E, 0xFB, 0xFF, 0xFF, 0x1B, 0x02, 0xFA, 0x00, 0x1F, 0x02, 0x10, 0x00,
        0x38,
    ];

    #[test]
    fn the_crc_has_its_check_value_and_only_five_bits() {
        assert_eq!(crc8(b"123456789"), 0xF8);
        let values: std::collections::BTreeSet<u8> = (0..=u8::MAX).map(|byte| crc8(&[byte])).collect();
        assert_eq!(values.len(), 32);
    }

    #[test]
    fn commands_are_the_bytes_of_the_line() {
        use Command::{
            ReadCurrent, ReadPosition, ReadStatus, SetCurrent, SetCurrentRegulator, SetMaxCurrent, SetMisc, SetMode,
            SetPosition, SetPwm, SetSpeed,
        };
        let gains = Gains { p: 1, i: 0x203, d: 4, t: 5 };
        let all = [
            SetSpeed(-1),
            SetCurrent(-250),
            SetPosition(70_000),
            SetMisc(Command::RESET_SYNCHRONIZED),
            SetCurrentRegulator(gains),
        ];
        let cases: [(u8, &[Command], &[u8]); 4] = [
            (8, &[SetPwm(100), ReadPosition, ReadCurrent, ReadStatus], &CYCLIC),
            (0, &[SetMode(Mode::Manual), ReadStatus], &[0x23, 0x09, 0xF6, 0x00, 0x10, 0x01, 0x01, 0x1F, 0x00, 0xF8]),
            (
                1,
                &[SetMaxCurrent(18_000), ReadStatus],
                &[0x23, 0x0A, 0xF5, 0x01, 0x15, 0x02, 0x50, 0x46, 0x1F, 0x00, 0xF8],
            ),
            (
                15,
                &all,
                &[
                    0x23, 0x24, 0xDB, 0x0F, 0x11, 0x04, 0xFF, 0xFF, 0xFF, 0xFF, 0x12, 0x02, 0x06, 0xFF, 0x13, 0x04,
                    0x70, 0x11, 0x01, 0x00, 0x1E, 0x04, 0x02, 0x00, 0x00, 0x00, 0x40, 0x08, 0x01, 0x00, 0x03, 0x02,
                    0x04, 0x00, 0x05, 0x00, 0xE8,
                ],
            ),
        ];
        for (address, commands, bytes) in cases {
            let mut builder = FrameBuilder::new(address);
            commands.iter().for_each(|command| _ = builder.command(*command));
            assert_eq!(builder.finish(), Some(bytes), "{commands:?}");
            let frame = Frame::parse(bytes).unwrap();
            assert_eq!(frame.address, address);
            let parsed: Result<Vec<_>, _> = frame.commands().collect();
            assert_eq!(parsed.as_deref(), Ok(commands));
        }
    }

    #[test]
    fn answers_are_the_bytes_of_the_line() {
        let answers = [Answer::Position(-1234), Answer::Current(250), Answer::Status(Status(Status::SYNCHRONIZED))];
        let mut builder = FrameBuilder::new(8);
        answers.into_iter().for_each(|answer| _ = builder.answer(answer));
        assert_eq!(builder.finish(), Some(&ANSWER[..]));
        let parsed: Result<Vec<_>, _> = Frame::parse(&ANSWER).unwrap().answers().collect();
        assert_eq!(parsed, Ok(answers.to_vec()));
    }

    #[test]
    fn a_damaged_frame_is_no_frame() {
        for length in 0..CYCLIC.len() {
            assert_eq!(Frame::parse(&CYCLIC[..length]), None);
        }
        for (index, bit) in (0..CYCLIC.len()).flat_map(|index| (0..8).map(move |bit| (index, bit))) {
            let mut bytes = CYCLIC;
            bytes[index] ^= 1 << bit;
            let seen = Frame::parse(&bytes);
            // The CRC detects every single-bit error, because its polynomial has more than one term.
            assert_eq!(seen, None, "bit {bit} of byte {index}");
        }
        assert_eq!(Frame::length(&[START, 3, !3]), None);
        assert_eq!(Frame::length(&CYCLIC[..3]), Some(15));
    }

    #[test]
    fn an_item_that_means_nothing_is_said_so() {
        let item = |items: &[u8]| -> Result<Vec<Command>, Malformed> {
            let frame = Frame { address: 0, items };
            frame.commands().collect()
        };
        for items in [&[0x14, 2, 1][..], &[0x14], &[0x14, 1, 1], &[0x99, 0], &[0x10, 1, 9]] {
            assert_eq!(item(items), Err(Malformed), "{items:x?}");
        }
        assert_eq!(item(&[0x1F, 0]), Ok(vec![Command::ReadStatus]));
    }

    #[test]
    fn what_does_not_fit_makes_no_frame() {
        let full = |count: usize| {
            let mut builder = FrameBuilder::new(0);
            (0..count).for_each(|_| _ = builder.command(Command::SetMisc(0)));
            builder.finish().map(<[u8]>::len)
        };
        assert_eq!(full(0), None);
        assert_eq!(full(41), Some(HEADER + 41 * 6 + 1));
        assert_eq!(full(42), None);
    }
}
