//! LSS, the layer setting services (CiA 305): node-IDs and bit rates for nodes that have none.
//!
//! A [`Request`] goes from the master to all slaves, a [`Response`] from the addressed slave to the master. Neither has a
//! node-ID. A node without a node-ID takes part in LSS alone. Slaves obey the configuring requests only in
//! [`Mode::Configuration`].

mod layout;

pub use layout::{Bound, FASTSCAN_RESET, Fastscan, Mode, Outcome, Part, Request, Response};

/// The node-ID of a node that has none.
pub const UNCONFIGURED: u8 = 0xFF;

/// The bit timing table of CiA (CiA 305 §6.4.3). [`BitRate::from_index`] has its indices.
pub const CIA_TABLE: u8 = 0;

/// The LSS address of a node, unique among all nodes of CANopen: object 0x1018 (CiA 301 §7.5.2.21).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Identity {
    /// Vendor-ID, given by CiA.
    pub vendor: u32,
    /// Product code, given by the vendor.
    pub product: u32,
    /// Revision number.
    pub revision: u32,
    /// Serial number.
    pub serial: u32,
}

impl Identity {
    /// One of the four numbers.
    pub const fn get(&self, part: Part) -> u32 {
        [self.vendor, self.product, self.revision, self.serial][part as usize]
    }

    /// One of the four numbers, to write it.
    pub const fn get_mut(&mut self, part: Part) -> &mut u32 {
        match part {
            Part::Vendor => &mut self.vendor,
            Part::Product => &mut self.product,
            Part::Revision => &mut self.revision,
            Part::Serial => &mut self.serial,
        }
    }
}

/// A bit rate of the [`CIA_TABLE`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BitRate {
    /// kbit/s.
    Kbps(u16),
    /// The node detects the bit rate of the bus.
    Automatic,
}

impl BitRate {
    /// `None` for an index that the table does not have; 5 is reserved.
    pub const fn from_index(index: u8) -> Option<Self> {
        Some(Self::Kbps(match index {
            0 => 1000,
            1 => 800,
            2 => 500,
            3 => 250,
            4 => 125,
            6 => 50,
            7 => 20,
            8 => 10,
            9 => return Some(Self::Automatic),
            _ => return None,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bit_rates_have_the_indices_of_the_table() {
        let rates = [1000, 800, 500, 250, 125, 0, 50, 20, 10].map(BitRate::Kbps);
        for (rate, index) in rates.into_iter().chain([BitRate::Automatic]).zip(0..) {
            let expected = Some(rate).filter(|_| index != 5);
            assert_eq!(BitRate::from_index(index), expected);
        }
        for index in [10, 255] {
            assert_eq!(BitRate::from_index(index), None);
        }
    }
}
