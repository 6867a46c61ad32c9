//! Emulation of the RNT.

use controller::robot::RntParameters;
use hil::{AxisConfig, MechanismConfig};

use super::{AS_MANY, Emulated};
use crate::cell::Plant;

impl Emulated for RntParameters {
    fn mechanism(&self) -> Option<MechanismConfig> {
        Some(MechanismConfig::Rnt {
            home_lengths: self.legs.map(|leg| leg.length_at_home),
        })
    }

    fn plant(&self, _: Plant, number: usize, home: f64) -> AxisConfig {
        AxisConfig::rnt(number).expect(AS_MANY).with_home(home)
    }
}
