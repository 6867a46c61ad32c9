//! Emulation of the gripper and of the conveyor.

use controller::robot::{ConveyorParameters, GripperParameters};
use hil::AxisConfig;

use super::Emulated;
use crate::cell::Plant;

impl Emulated for GripperParameters {
    fn plant(&self, _: Plant, _: usize, home: f64) -> AxisConfig {
        AxisConfig::gripper().with_home(home)
    }
}

impl Emulated for ConveyorParameters {
    fn plant(&self, _: Plant, _: usize, home: f64) -> AxisConfig {
        AxisConfig::conveyor().with_home(home)
    }
}
