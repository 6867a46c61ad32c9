//! Emulation of the IRb-6 and of the IRp-6, on its pedestal and on its track.

use controller::robot::{Irb6Parameters, Irp6Parameters, Irp6TrackParameters};
use hil::plant::Switch;
use hil::{AxisConfig, Irp6Axis, MechanismConfig};

use super::{AS_MANY, Emulated};
use crate::cell::Plant;

impl Emulated for Irb6Parameters {
    fn plants(&self) -> &'static [Plant] {
        &[Plant::Physical, Plant::Wut]
    }

    fn mechanism(&self) -> Option<MechanismConfig> {
        Some(MechanismConfig::Irb6)
    }

    fn plant(&self, plant: Plant, number: usize, home: f64) -> AxisConfig {
        on_pedestal(plant, number, home)
    }
}

impl Emulated for Irp6Parameters {
    fn plants(&self) -> &'static [Plant] {
        &[Plant::Physical, Plant::Wut]
    }

    fn mechanism(&self) -> Option<MechanismConfig> {
        Some(MechanismConfig::Irp6)
    }

    fn plant(&self, plant: Plant, number: usize, home: f64) -> AxisConfig {
        on_pedestal(plant, number, home)
    }
}

impl Emulated for Irp6TrackParameters {
    fn mechanism(&self) -> Option<MechanismConfig> {
        Some(MechanismConfig::Irp6OnTrack)
    }

    fn plant(&self, _: Plant, number: usize, home: f64) -> AxisConfig {
        AxisConfig::irp6_track(number)
            .expect(AS_MANY)
            .with_home(home)
    }
}

fn on_pedestal(plant: Plant, number: usize, home: f64) -> AxisConfig {
    let axis = Irp6Axis::ALL[number];
    let preset = match plant {
        Plant::Physical => AxisConfig::irp6(axis),
        Plant::Wut => AxisConfig::wut(axis),
    };
    AxisConfig {
        index_angle: home,
        start_angle: home + 20.0,
        home_switch: Some(Switch {
            from: home - 20.0,
            to: home - 2.0,
            bounce: 0,
        }),
        ..preset
    }
}
