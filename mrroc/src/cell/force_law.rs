//! The keys of the force law of a robot.

use controller::law::ForceLimits;
use controller::robot::Axes;
use serde::{Deserialize, Serialize};
use servo::LawBound;

use super::{Cell, ForceSensor, defaults};

/// Position-force control of a robot in each servo cycle, by a force/torque sensor at its flange, and the limits of this
/// law. Generators send what the law does; without this table they cannot.
///
/// All lists have one value per axis, base first. The set-points of the law pass the limits of the axes in addition.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ForceLaw {
    /// The force sensor, which sits at the flange of this robot.
    pub sensor: String,
    /// Greatest forces of the contact along x, y and z of the sensor, N. A greater force stops the robot with a fault.
    pub force: [f64; 3],
    /// Greatest torques of the contact about x, y and z of the sensor, N·m. A greater torque stops the robot with a fault.
    pub torque: [f64; 3],
    /// Greatest displacement of each motor from the planned path, rad. A greater displacement stops the robot with a fault.
    pub displacement: Vec<f64>,
    /// Greatest velocity of each motor beside the planned path, rad/s. The law moves more slowly instead of faster.
    pub velocity: Vec<f64>,
    /// Greatest acceleration of each motor beside the planned path, rad/s².
    pub acceleration: Vec<f64>,
    /// Greatest age of a sample, servo periods. An older sample stops the robot with a fault.
    #[serde(default = "defaults::count::<4, u32>")]
    pub max_age_periods: u32,
}

impl ForceLaw {
    /// Limits of the law in a cell with this servo period.
    pub fn limits(&self, cell: &Cell) -> ForceLimits {
        let ([fx, fy, fz], [tx, ty, tz]) = (self.force, self.torque);
        ForceLimits {
            wrench: [fx, fy, fz, tx, ty, tz],
            age: cell.period() * self.max_age_periods,
            speed: per_axis(&self.velocity),
            acceleration: per_axis(&self.acceleration),
        }
    }

    /// Bounds that the servo checks, one per axis.
    pub fn bounds(&self) -> Vec<LawBound> {
        let bound = |(&displacement, &speed)| LawBound { displacement, speed };
        self.displacement.iter().zip(&self.velocity).map(bound).collect()
    }

    /// Index of the sensor in [`Cell::force_sensor`].
    pub(crate) fn sensor(&self, sensors: &[ForceSensor]) -> Option<usize> {
        sensors.iter().position(|sensor| sensor.name == self.sensor)
    }
}

fn per_axis(values: &[f64]) -> Axes {
    std::array::from_fn(|axis| values.get(axis).copied().unwrap_or(0.0))
}
