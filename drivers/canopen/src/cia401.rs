//! Generic I/O modules (CiA 401): the objects of digital inputs and outputs in blocks of eight.
//!
//! Each object is an array. Sub-index 0 is the number of blocks. Sub-index *n*, from 1, is block *n* of eight channels:
//! channel 8 (*n* − 1) in bit 0, the next channel in bit 1. Every entry has eight bits.

use crate::Object;
use crate::pdo::Entry;

/// Device profile, in the low half of object 0x1000.
pub const PROFILE: u16 = 401;

/// Greatest number of channels in one PDO: eight blocks.
pub const CHANNELS: u8 = 64;

/// Global interrupt enable: 1 lets changed inputs send their TPDO.
pub const INTERRUPT_ENABLE: Object = Object::new(0x6005, 0);

/// One array of an I/O module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum Array {
    /// Levels of the inputs, read-only.
    Input = 0x6000,
    /// Inverted inputs: 1 inverts.
    InputPolarity = 0x6002,
    /// Filtered inputs: 1 filters. The filter time belongs to the module.
    InputFilter = 0x6003,
    /// Inputs of which each change sends the TPDO.
    InterruptAnyChange = 0x6006,
    /// Inputs of which a rising edge sends the TPDO.
    InterruptLowToHigh = 0x6007,
    /// Inputs of which a falling edge sends the TPDO.
    InterruptHighToLow = 0x6008,
    /// Commanded levels of the outputs.
    Output = 0x6200,
    /// Inverted outputs: 1 inverts.
    OutputPolarity = 0x6202,
    /// Outputs that take their error value on an internal failure and in NMT state stopped: 1. The other outputs keep
    /// their level.
    ErrorMode = 0x6206,
    /// Levels that the outputs of [`ErrorMode`](Self::ErrorMode) take.
    ErrorValue = 0x6207,
    /// Outputs that follow [`Output`](Self::Output): 1. The other outputs keep their level.
    OutputFilter = 0x6208,
}

impl Array {
    /// The number of blocks.
    pub const fn count(self) -> Object {
        Object::new(self as u16, 0)
    }

    /// Block `block`, from 1.
    pub const fn block(self, block: u8) -> Object {
        Object::new(self as u16, block)
    }

    /// Block `block`, from 1, as an entry of a PDO mapping.
    pub const fn entry(self, block: u8) -> Entry {
        Entry::new(self.block(block), 8)
    }
}

/// Number of blocks of so many channels.
pub const fn blocks(channels: u8) -> u8 {
    channels.div_ceil(8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_come_in_blocks_of_eight() {
        for (channels, count) in [(0, 0), (1, 1), (8, 1), (9, 2), (64, 8)] {
            assert_eq!(blocks(channels), count);
        }
        assert_eq!(Array::Input.entry(1).raw(), 0x6000_0108);
        assert_eq!(Array::Output.entry(8).raw(), 0x6200_0808);
        assert_eq!(Array::ErrorMode.block(2).to_string(), "0x6206:02");
        assert_eq!(Array::Output.count().to_string(), "0x6200:00");
    }
}
