//! Emulation of the Polycrank.

use controller::robot::PolycrankParameters;
use hil::{AxisConfig, MechanismConfig};

use super::{AS_MANY, Emulated};
use crate::cell::Plant;

impl Emulated for PolycrankParameters {
    fn mechanism(&self) -> Option<MechanismConfig> {
        Some(MechanismConfig::Polycrank {
            coupled: self.coupled,
            at_home: self.axes.map(|axis| axis.joint_at_home),
        })
    }

    fn plant(&self, _: Plant, number: usize, home: f64) -> AxisConfig {
        AxisConfig::polycrank(number)
            .expect(AS_MANY)
            .with_home(home)
    }
}
