//! Telegrams of both protocols, by what they ask for.

use serial::hi_moxa;
use serial::hi_moxa::{DriverMode, Parameter, Request};
use serial::nfv2::{Command, FrameBuilder, Mode};

use super::config::{Control, Protocol};
use super::objects::Objects;

/// Greatest length: a mode, a flag, a set-point and three reads have fewer bytes.
const LONGEST: usize = 64;

/// Answers to telegrams with a mode until the drive is taken to be in the mode: one answer could belong to an earlier
/// telegram.
pub(super) const ANSWERS_TO_EFFECT: u32 = 2;

/// The mode that a drive is told, in either protocol.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum ControllerMode {
    /// No torque; the drive clears its latched errors.
    #[default]
    Manual,
    /// Error state: the drive opens its power stage and the emergency-stop circuit.
    Error,
    /// Follows set-points.
    Drive,
    /// Follows set-points, and takes the next index pulse for its reference.
    Index,
}

/// Address and language of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Dialect {
    pub(super) protocol: Protocol,
    pub(super) address: u8,
    pub(super) control: Control,
    /// Objects that NFv2 telegrams ask for. An answer of the older protocol always has all.
    objects: Objects,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Telegram {
    bytes: [u8; LONGEST],
    length: usize,
}

impl Telegram {
    pub(super) const NONE: Self = Self { bytes: [0; LONGEST], length: 0 };

    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }

    pub(super) fn append(mut self, bytes: &[u8]) -> Self {
        let end = self.length + bytes.len();
        self.bytes[self.length..end].copy_from_slice(bytes);
        self.length = end;
        self
    }
}

impl Dialect {
    /// Telegrams that ask for all objects.
    pub(super) fn new(protocol: Protocol, address: u8, control: Control) -> Self {
        Self { protocol, address, control, objects: Objects::All }
    }

    /// The same with telegrams that ask for `objects`.
    pub(super) fn asking(self, objects: Objects) -> Self {
        Self { objects, ..self }
    }

    /// A set-point. `tell` includes the mode, and `unreference` tells the drive to forget its reference.
    ///
    /// One NFv2 frame carries all of them. In the older protocol a flag of every set-point carries the mode. A parameter
    /// has a telegram of its own there, so the drive follows its last set-point meanwhile.
    pub(super) fn follow(self, mode: ControllerMode, setpoint: i16, tell: bool, unreference: bool) -> Telegram {
        match self.protocol {
            Protocol::Nfv2 => {
                let mut frame = self.frame(setpoint);
                if unreference {
                    frame.command(Command::SetMisc(Command::RESET_SYNCHRONIZED));
                }
                if tell {
                    frame.command(Command::SetMode(self.mode(mode)));
                }
                self.read(&mut frame)
            }
            Protocol::HiMoxa if unreference => set(Parameter::Synchronized(false)),
            Protocol::HiMoxa => moxa_setpoint(setpoint, mode == ControllerMode::Index),
        }
    }

    /// Whether a set-point names its mode, and so switches a drive on.
    pub(super) fn setpoints_switch_on(self) -> bool {
        self.protocol == Protocol::HiMoxa
    }

    /// Whether the telegram of this cycle tells the drive to forget its reference; `cycle` counts from 1. In the older
    /// protocol every other telegram is a set-point.
    pub(super) fn may_unreference(self, cycle: u32) -> bool {
        match self.protocol {
            Protocol::Nfv2 => true,
            Protocol::HiMoxa => cycle % 2 == 1,
        }
    }

    /// A zero set-point without a mode.
    pub(super) fn zero(self) -> Telegram {
        self.follow(ControllerMode::Drive, 0, false, false)
    }

    /// Gives a drive torque; `answers` counts the answers to such telegrams. The zero set-point goes before the mode, so
    /// that no mode begins with an old set-point.
    pub(super) fn switch_on(self, answers: u32) -> Telegram {
        match self.protocol {
            Protocol::Nfv2 => self.follow(ControllerMode::Drive, 0, true, false),
            Protocol::HiMoxa if answers < ANSWERS_TO_EFFECT => self.zero(),
            Protocol::HiMoxa => set(Parameter::DriverMode(DriverMode::Pwm)),
        }
    }

    /// Answers until a drive is taken to have torque.
    pub(super) fn answers_to_switch_on(self) -> u32 {
        match self.protocol {
            Protocol::Nfv2 => ANSWERS_TO_EFFECT,
            Protocol::HiMoxa => 2 * ANSWERS_TO_EFFECT,
        }
    }

    /// Takes torque away by a zero set-point and the mode [`ControllerMode::Manual`] or [`ControllerMode::Error`]; `told`
    /// counts such telegrams. In the older protocol the set-point goes first, except before an error state.
    /// `unreference` tells the drive to forget its reference too, in every other telegram of the older protocol.
    pub(super) fn rest(self, mode: ControllerMode, told: u32, unreference: bool) -> Telegram {
        match (self.protocol, mode) {
            (Protocol::Nfv2, _) => prefixed(self.follow(mode, 0, true, unreference)),
            (Protocol::HiMoxa, _) if unreference && told % 2 == 1 => set(Parameter::Synchronized(false)),
            (Protocol::HiMoxa, ControllerMode::Error) => set(Parameter::DriverMode(DriverMode::Error)),
            (Protocol::HiMoxa, _) if told == 0 => self.zero(),
            (Protocol::HiMoxa, _) => set(Parameter::DriverMode(DriverMode::Manual)),
        }
    }

    /// All of [`rest`](Self::rest) at once, for a drive whose answers are not read any more.
    pub(super) fn farewell(self, mode: ControllerMode, unreference: bool) -> Telegram {
        match self.protocol {
            Protocol::Nfv2 => self.rest(mode, 0, unreference),
            Protocol::HiMoxa => {
                let off = self.zero().append(self.rest(mode, 1, false).bytes());
                if unreference { off.append(set(Parameter::Synchronized(false)).bytes()) } else { off }
            }
        }
    }

    /// Puts the drive into its error state without an order to answer. In NFv2 the set-point is zeroed as well.
    pub(super) fn error_state(self) -> Telegram {
        match self.protocol {
            Protocol::Nfv2 => {
                let mut frame = self.frame(0);
                frame.command(Command::SetMode(Mode::Error));
                prefixed(Telegram::NONE.append(frame.finish().expect("a frame of two commands fits 256 bytes")))
            }
            Protocol::HiMoxa => set(Parameter::DriverMode(DriverMode::Error)),
        }
    }

    /// A request to set the greatest current, mA.
    pub(super) fn max_current(self, current: i16) -> Telegram {
        match self.protocol {
            Protocol::Nfv2 => prefixed(self.read(self.frame(0).command(Command::SetMaxCurrent(current)))),
            Protocol::HiMoxa => set(Parameter::MaxCurrent(current)),
        }
    }

    /// The first telegram, to a drive that may have torque and may speak the other protocol: a zero set-point and, in
    /// NFv2, manual mode. The zeros of [`rest`](Self::rest) are left out, with which a drive of the older protocol would
    /// take the frame for a set-point.
    pub(super) fn opening(self) -> Telegram {
        match self.protocol {
            Protocol::Nfv2 => self.follow(ControllerMode::Manual, 0, true, false),
            Protocol::HiMoxa => self.zero(),
        }
    }

    /// Tells the drive with `address` to be in manual mode, in `protocol`.
    pub(super) fn probe(self, protocol: Protocol, address: u8) -> Telegram {
        let dialect = Self { protocol, address, ..self };
        match protocol {
            Protocol::Nfv2 => dialect.opening(),
            Protocol::HiMoxa => dialect.rest(ControllerMode::Manual, 1, false),
        }
    }

    fn frame(self, setpoint: i16) -> FrameBuilder {
        let mut frame = FrameBuilder::new(self.address);
        frame.command(match self.control {
            Control::Current => Command::SetCurrent(setpoint),
            Control::Pwm => Command::SetPwm(setpoint),
        });
        frame
    }

    fn read(self, frame: &mut FrameBuilder) -> Telegram {
        frame.command(Command::ReadPosition);
        if self.objects != Objects::Status {
            frame.command(Command::ReadCurrent);
        }
        if self.objects != Objects::Current {
            frame.command(Command::ReadStatus);
        }
        let bytes = frame.finish().expect("a frame of some commands fits 256 bytes");
        Telegram::NONE.append(bytes)
    }

    fn mode(self, mode: ControllerMode) -> Mode {
        match (mode, self.control) {
            (ControllerMode::Manual, _) => Mode::Manual,
            (ControllerMode::Error, _) => Mode::Error,
            (ControllerMode::Drive, Control::Current) => Mode::Current,
            (ControllerMode::Drive, Control::Pwm) => Mode::Pwm,
            (ControllerMode::Index, Control::Current) => Mode::SyncCurrent,
            (ControllerMode::Index, Control::Pwm) => Mode::SyncPwm,
        }
    }
}

/// A frame behind five zeros, as MRROC++ sends parameters and emergency stops: the zeros end a torn frame that the drive
/// still waits for.
fn prefixed(frame: Telegram) -> Telegram {
    Telegram::NONE.append(&[0; 5]).append(frame.bytes())
}

fn set(parameter: Parameter) -> Telegram {
    Telegram::NONE.append(&Request::Set(parameter).encode())
}

fn moxa_setpoint(value: i16, latch_index: bool) -> Telegram {
    let request = Request::Drive { mode: hi_moxa::Mode::Pwm, value, latch_index };
    Telegram::NONE.append(&request.encode_cyclic())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dialect(protocol: Protocol, control: Control) -> Dialect {
        Dialect::new(protocol, 8, control)
    }

    #[test]
    fn a_cycle_is_the_bytes_of_the_line() {
        let nfv2 = dialect(Protocol::Nfv2, Control::Pwm);
        let moxa = dialect(Protocol::HiMoxa, Control::Pwm);
        let cases: [(Telegram, &[u8]); 8] = [
            (
                nfv2.follow(ControllerMode::Drive, 100, false, false),
                &[0x23, 0x0E, 0xF1, 0x08, 0x14, 0x02, 0x64, 0x00, 0x1A, 0x00, 0x1B, 0x00, 0x1F, 0x00, 0xE0],
            ),
            (
                moxa.follow(ControllerMode::Drive, 745, true, false),
                &[0, 0, 0, 0, 0x23, 0x00, 0xE9, 0x02, 0, 0, 0x20, 0x20],
            ),
            (
                moxa.follow(ControllerMode::Index, -1, true, false),
                &[0, 0, 0, 0, 0x23, 0x10, 0xFF, 0xFF, 0, 0, 0x20, 0x20],
            ),
            (moxa.follow(ControllerMode::Drive, 5, true, true), &[0, 0, 0, 0, 0x23, 0x1F, 0x00, 0x00, 0, 0]),
            (moxa.rest(ControllerMode::Manual, 1, false), &[0, 0, 0, 0, 0x23, 0x9F, 0x00, 0x00, 0, 0]),
            (moxa.rest(ControllerMode::Error, 0, false), &[0, 0, 0, 0, 0x23, 0x9F, 0x04, 0x00, 0, 0]),
            (moxa.switch_on(2), &[0, 0, 0, 0, 0x23, 0x9F, 0x03, 0x00, 0, 0]),
            (
                moxa.farewell(ControllerMode::Manual, false),
                &[0, 0, 0, 0, 0x23, 0x00, 0, 0, 0, 0, 0x20, 0x20, 0, 0, 0, 0, 0x23, 0x9F, 0, 0, 0, 0],
            ),
        ];
        for (telegram, bytes) in cases {
            assert_eq!(telegram.bytes(), bytes);
        }
        let stop = [0, 0, 0, 0, 0, 0x23, 0x0B, 0xF4, 0x08, 0x14, 0x02, 0, 0, 0x10, 0x01, 0x00, 0x18];
        assert_eq!(nfv2.error_state().bytes(), stop);
        assert_eq!(moxa.error_state().bytes(), [0, 0, 0, 0, 0x23, 0x9F, 0x04, 0, 0, 0]);
        for first in [moxa.switch_on(0), moxa.switch_on(1), moxa.rest(ControllerMode::Manual, 0, false)] {
            assert_eq!(first.bytes(), moxa.zero().bytes());
        }
    }

    #[test]
    fn a_set_point_stands_before_the_mode_that_it_is_for() {
        let nfv2 = dialect(Protocol::Nfv2, Control::Current);
        let items = |telegram: Telegram| {
            let bytes = telegram.bytes();
            let start = bytes.iter().position(|byte| *byte == 0x23).unwrap();
            bytes[start + 4..bytes.len() - 1].to_vec()
        };
        // 12 set-point, 1E forget the reference, 10 mode, then the reads.
        assert_eq!(
            items(nfv2.follow(ControllerMode::Index, -250, true, true)),
            [0x12, 2, 0x06, 0xFF, 0x1E, 4, 2, 0, 0, 0, 0x10, 1, 0x11, 0x1A, 0, 0x1B, 0, 0x1F, 0]
        );
        let objects = |objects| items(nfv2.asking(objects).follow(ControllerMode::Drive, 1, false, false));
        assert_eq!(objects(Objects::Current), [0x12, 2, 1, 0, 0x1A, 0, 0x1B, 0]);
        assert_eq!(objects(Objects::Status), [0x12, 2, 1, 0, 0x1A, 0, 0x1F, 0]);
        let off = [0x12, 2, 0, 0, 0x10, 1, 0x01, 0x1A, 0, 0x1B, 0, 0x1F, 0];
        assert_eq!(items(nfv2.rest(ControllerMode::Manual, 0, false)), off);
        assert_eq!(items(nfv2.farewell(ControllerMode::Manual, false)), off);
    }
}
