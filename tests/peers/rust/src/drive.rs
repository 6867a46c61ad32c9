//! A CiA 402 drive on the object dictionary of a peer: power states, homing, and cyclic synchronous position mode. The
//! drive reaches every set-point at once.

/// An object dictionary; all objects here have sub-index 0.
pub trait Objects {
    fn get(&self, index: u16) -> i64;
    fn set(&mut self, index: u16, value: i64);
}

/// Profile and type, object 0x1000.
pub const DEVICE_TYPE: u32 = 0x0002_0192;

const CONTROLWORD: u16 = 0x6040;
const STATUSWORD: u16 = 0x6041;
const MODE: u16 = 0x6060;
const MODE_DISPLAY: u16 = 0x6061;
const POSITION: u16 = 0x6064;
const TARGET: u16 = 0x607A;

const HOMING: i64 = 6;
const CSP: i64 = 8;

// Low byte of the statusword.
const DISABLED: i64 = 0x50;
const READY: i64 = 0x31;
const SWITCHED_ON: i64 = 0x33;
const ENABLED: i64 = 0x37;
const QUICK_STOP: i64 = 0x17;

/// State of the drive that is not in the dictionary.
#[derive(Default)]
pub struct Drive {
    power: Option<i64>,
    word: i64,
}

impl Drive {
    fn power(&self) -> i64 {
        self.power.unwrap_or(DISABLED)
    }

    /// Processes a controlword, which may be unchanged, and updates the statusword.
    pub fn step(&mut self, objects: &mut impl Objects, operational: bool) {
        let word = objects.get(CONTROLWORD) & 0xFFFF;
        let power = next_power(self.power(), word);
        let mode = objects.get(MODE);
        objects.set(MODE_DISPLAY, mode);
        let starts = word & 0x10 != 0 && self.word & 0x10 == 0;
        if mode == HOMING && power == ENABLED && starts {
            objects.set(POSITION, 0);
        }
        (self.power, self.word) = (Some(power), word);
        let mut status = power;
        if operational {
            status |= 0x0200;
        }
        if power == ENABLED && mode == CSP {
            status |= 0x1000;
        }
        if power == ENABLED && mode == HOMING && word & 0x10 != 0 {
            status |= 0x1400;
        }
        objects.set(STATUSWORD, status);
    }

    /// Moves to the set-point.
    pub fn synchronise(&mut self, objects: &mut impl Objects) {
        if self.power() == ENABLED && objects.get(MODE_DISPLAY) == CSP {
            objects.set(POSITION, objects.get(TARGET));
        }
    }
}

/// Power state after a controlword. This drive has no faults.
fn next_power(power: i64, word: i64) -> i64 {
    match word & 0x0F {
        low if low & 0x02 == 0 => DISABLED,
        low if low & 0x04 == 0 => match power {
            ENABLED | QUICK_STOP => QUICK_STOP,
            _ => DISABLED,
        },
        low if low & 0x01 == 0 => match power {
            QUICK_STOP => QUICK_STOP,
            _ => READY,
        },
        low if low & 0x08 == 0 => match power {
            READY | SWITCHED_ON | ENABLED => SWITCHED_ON,
            other => other,
        },
        _ => match power {
            READY => SWITCHED_ON,
            SWITCHED_ON | QUICK_STOP | ENABLED => ENABLED,
            other => other,
        },
    }
}
