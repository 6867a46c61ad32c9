//! The older telegrams of the IRb-6 axis controllers, one drive per line, without a checksum.
//!
//! The host writes [`Request`]s of 10 bytes, and two additional spaces after each cyclic request. The drive answers
//! each request with an [`Answer`] of 8 bytes. Names follow the MRROC++ interface `hi_moxa`, which defines the bytes.
//! No source gives the value of the start byte of an answer; the original host ignored it. Layouts only. Without a
//! checksum, the driver must check the plausibility of the contents.

/// Length of a request that sets a parameter, bytes.
pub const REQUEST: usize = 10;

/// Length of a cyclic request with the two following spaces, bytes.
pub const CYCLIC_REQUEST: usize = 12;

/// Length of an answer, bytes.
pub const ANSWER: usize = 8;

/// Sequence to which the drive synchronises: four zeros and `#`.
pub const PREAMBLE: [u8; 5] = [0, 0, 0, 0, 0x23];

/// Pulse width of a fully driven power stage.
pub const FULL_PWM: i16 = 1000;

const LATCH_INDEX: u8 = 0x10;
const SET_PARAMETER: u8 = 0x0F;

/// Request of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum Request {
    /// The set-point of a cycle, by `mode`: pulse width, -1000 to 1000; current, mA; or position. `latch_index`: the next
    /// index pulse zeroes the position counter.
    Drive { mode: Mode, value: i16, latch_index: bool },
    /// Sets a parameter.
    Set(Parameter),
}

/// Quantity of a set-point. The original host used pulse widths only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Pulse width.
    Pwm,
    /// Current.
    Current,
    /// Position.
    Position,
}

/// A parameter of a drive. Gains are in internal units of the drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parameter {
    /// Whether the position counter is referenced.
    Synchronized(bool),
    /// Current at which the overcurrent protection acts, mA.
    MaxCurrent(i16),
    /// A gain of the position loop.
    PositionGain(Gain, i16),
    /// A gain of the current loop.
    CurrentGain(Gain, i16),
    /// State of the power stage.
    DriverMode(DriverMode),
}

/// Selection of a gain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gain {
    /// Proportional.
    P,
    /// Integral.
    I,
    /// Differential.
    D,
}

/// Requested state of a drive, by its code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum DriverMode {
    /// Manual: power off, latched errors cleared.
    Manual = 0,
    /// Follows pulse widths.
    Pwm = 3,
    /// Opens the power stage and with it the emergency stop of the cabinet.
    Error = 4,
}

impl DriverMode {
    const ALL: [Self; 3] = [Self::Manual, Self::Pwm, Self::Error];
}

impl Mode {
    const ALL: [Self; 3] = [Self::Pwm, Self::Current, Self::Position];
}

impl Gain {
    const ALL: [Self; 3] = [Self::P, Self::I, Self::D];
}

impl Request {
    /// The request in wire format, without the spaces after a cyclic request.
    pub fn encode(self) -> [u8; REQUEST] {
        let (code, [low, high]) = match self {
            Self::Drive { mode, value, latch_index } => {
                let latch = if latch_index { LATCH_INDEX } else { 0 };
                (mode as u8 | latch, value.to_le_bytes())
            }
            Self::Set(parameter) => {
                let (id, data) = match parameter {
                    Parameter::Synchronized(on) => (0x10, [u8::from(on), 0]),
                    Parameter::MaxCurrent(current) => (0x20, current.to_le_bytes()),
                    Parameter::PositionGain(gain, value) => (0x30 + 0x10 * gain as u8, value.to_le_bytes()),
                    Parameter::CurrentGain(gain, value) => (0x60 + 0x10 * gain as u8, value.to_le_bytes()),
                    Parameter::DriverMode(mode) => (0x90, [mode as u8, 0]),
                };
                (id | SET_PARAMETER, data)
            }
        };
        [0, 0, 0, 0, 0x23, code, low, high, 0, 0]
    }

    /// The request with the two spaces of a cyclic request.
    pub fn encode_cyclic(self) -> [u8; CYCLIC_REQUEST] {
        let mut bytes = [0x20; CYCLIC_REQUEST];
        bytes[..REQUEST].copy_from_slice(&self.encode());
        bytes
    }

    /// Decodes a request; `None` without the preamble or for an unknown code.
    ///
    /// The last two bytes are ignored, because the original host left them uninitialised.
    pub fn decode(bytes: &[u8; REQUEST]) -> Option<Self> {
        let [0, 0, 0, 0, 0x23, code, low, high, ..] = *bytes else {
            return None;
        };
        let value = i16::from_le_bytes([low, high]);
        if code & 0x0F != SET_PARAMETER {
            let mode = *Mode::ALL.get(usize::from(code & 0x0F))?;
            return (code & 0xF0 & !LATCH_INDEX == 0).then_some(Self::Drive {
                mode,
                value,
                latch_index: code & LATCH_INDEX != 0,
            });
        }
        let gain = |first: u8| Gain::ALL[usize::from((code >> 4) - first)];
        Some(Self::Set(match code >> 4 {
            1 => Parameter::Synchronized(low != 0),
            2 => Parameter::MaxCurrent(value),
            3..=5 => Parameter::PositionGain(gain(3), value),
            6..=8 => Parameter::CurrentGain(gain(6), value),
            9 => {
                let mut modes = DriverMode::ALL.into_iter();
                Parameter::DriverMode(modes.find(|mode| *mode as u8 == low)?)
            }
            _ => return None,
        }))
    }
}

/// Answer of a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Answer {
    /// The first byte; no source gives its value.
    pub start: u8,
    /// Switches, state and faults.
    pub flags: Flags,
    /// Motor current, mA, signed.
    pub current: i16,
    /// Position counter, encoder pulses.
    pub position: i32,
}

impl Answer {
    /// The answer in wire format.
    pub fn encode(self) -> [u8; ANSWER] {
        let [c0, c1] = self.current.to_le_bytes();
        let [p0, p1, p2, p3] = self.position.to_le_bytes();
        [self.start, self.flags.0, c0, c1, p0, p1, p2, p3]
    }

    /// Decodes eight bytes. Any eight bytes are a valid answer.
    pub fn decode(bytes: [u8; ANSWER]) -> Self {
        let [start, flags, c0, c1, p0, p1, p2, p3] = bytes;
        Self {
            start,
            flags: Flags(flags),
            current: i16::from_le_bytes([c0, c1]),
            position: i32::from_le_bytes([p0, p1, p2, p3]),
        }
    }
}

/// The second byte of an answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags(pub u8);

impl Flags {
    /// The upper limit switch is closed.
    pub const UPPER_LIMIT: u8 = 0x01;
    /// The lower limit switch is closed.
    pub const LOWER_LIMIT: u8 = 0x02;
    /// The synchronisation (home) switch is closed.
    pub const HOME_SWITCH: u8 = 0x04;
    /// The index pulse of the encoder zeroed the counter.
    pub const INDEX: u8 = 0x08;
    /// The power stage has failed or is off.
    pub const POWER_STAGE_FAULT: u8 = 0x10;
    /// The current exceeded its limit.
    pub const OVERCURRENT: u8 = 0x20;
    /// The drive is in its error state.
    pub const ERROR: u8 = 0x40;
    /// The position counter is referenced.
    pub const SYNCHRONIZED: u8 = 0x80;

    /// Whether any of `bits` is set.
    pub const fn any(self, bits: u8) -> bool {
        self.0 & bits != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_the_bytes_of_the_line() {
        let pwm = |value, latch_index| Request::Drive { mode: Mode::Pwm, value, latch_index };
        let cases: [(Request, [u8; REQUEST]); 8] = [
            (pwm(745, false), [0, 0, 0, 0, 0x23, 0x00, 0xE9, 0x02, 0, 0]),
            (pwm(-1, true), [0, 0, 0, 0, 0x23, 0x10, 0xFF, 0xFF, 0, 0]),
            (
                Request::Drive { mode: Mode::Position, value: 2, latch_index: false },
                [0, 0, 0, 0, 0x23, 0x02, 0x02, 0x00, 0, 0],
            ),
            (Request::Set(Parameter::Synchronized(true)), [0, 0, 0, 0, 0x23, 0x1F, 0x01, 0x00, 0, 0]),
            (Request::Set(Parameter::MaxCurrent(18_000)), [0, 0, 0, 0, 0x23, 0x2F, 0x50, 0x46, 0, 0]),
            (Request::Set(Parameter::PositionGain(Gain::D, 5)), [0, 0, 0, 0, 0x23, 0x5F, 0x05, 0x00, 0, 0]),
            (Request::Set(Parameter::CurrentGain(Gain::P, -2)), [0, 0, 0, 0, 0x23, 0x6F, 0xFE, 0xFF, 0, 0]),
            (Request::Set(Parameter::DriverMode(DriverMode::Error)), [0, 0, 0, 0, 0x23, 0x9F, 0x04, 0x00, 0, 0]),
        ];
        for (request, bytes) in cases {
            assert_eq!(request.encode(), bytes, "{request:?}");
            assert_eq!(Request::decode(&bytes), Some(request));
        }
        assert_eq!(pwm(0, false).encode_cyclic()[REQUEST..], [0x20, 0x20]);
    }

    #[test]
    fn what_is_no_request_is_refused() {
        let good = Request::Set(Parameter::DriverMode(DriverMode::Manual)).encode();
        let with = |index: usize, byte| {
            let mut bytes = good;
            bytes[index] = byte;
            Request::decode(&bytes)
        };
        assert_eq!(with(9, 0xAA), Request::decode(&good));
        for (index, byte) in [(3, 1), (4, 0x24), (5, 0x03), (5, 0x20), (5, 0xAF), (6, 1)] {
            assert_eq!(with(index, byte), None, "byte {index} {byte:#x}");
        }
    }

    #[test]
    fn answers_are_the_bytes_of_the_line() {
        let answer = Answer {
            start: 0x23,
            flags: Flags(Flags::SYNCHRONIZED | Flags::HOME_SWITCH),
            current: 250,
            position: -1234,
        };
        let bytes = [0x23, 0x84, 0xFA, 0x00, 0x2E, 0xFB, 0xFF, 0xFF];
        assert_eq!(answer.encode(), bytes);
        assert_eq!(Answer::decode(bytes), answer);
    }
}
