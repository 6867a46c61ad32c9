//! A motor for an axis of which only torque, velocity and load are known.

use super::axis::{AxisConfig, PlantConfig};
use super::lab::MotorData;
use super::thermal::ThermalConfig;

/// What the motor of an axis must do. All values are at the motor shaft, and above zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Duty {
    /// Greatest torque, N·m.
    pub torque: f64,
    /// Greatest velocity, rad/s.
    pub velocity: f64,
    /// Inertia of the load at home, kg·m².
    pub load: f64,
    /// Range of the motor, rad; `None` for an axis without ends.
    pub travel: Option<(f64, f64)>,
}

impl Duty {
    /// Inertia of the nominal rotor, kg·m²: the greatest torque brings it to the greatest velocity in 50 ms.
    pub fn rotor(&self) -> f64 {
        0.05 * self.torque / self.velocity
    }
}

impl AxisConfig {
    /// An axis with a motor for this duty and its home at 0. Nominal are all its numbers: a supply of 48 V, of which the
    /// greatest velocity takes four fifths and the greatest current a tenth; friction of 2 % of the torque; a winding
    /// that the greatest current heats by 100 K in the end; a brake of twice the torque; 4000 counts; a home switch from
    /// 20 rad to half a turn below home; limit switches at the ends of the range.
    pub fn nominal(duty: &Duty) -> Self {
        const SUPPLY: f64 = 48.0;
        let torque_constant = 0.8 * SUPPLY / duty.velocity;
        let current = duty.torque / torque_constant;
        let resistance = 0.1 * SUPPLY / current;
        let motor = MotorData {
            home: 0.0,
            travel: duty.travel,
            counts: 4000,
            torque_constant,
            winding: (resistance, 1e-3 * resistance),
            inertia: duty.rotor() + duty.load,
            gravity: (0.0, 1.0, 0.0),
            friction: (0.01 * duty.torque / duty.velocity, 0.02 * duty.torque, 0.025 * duty.torque),
            max_current: current,
            trip_current: 1.5 * current,
            max_voltage: SUPPLY,
            brake: 2.0 * duty.torque,
        };
        let mut axis = motor.config(-20.0);
        if let PlantConfig::Physical(motor) = &mut axis.plant {
            motor.thermal = heated(resistance * current * current);
        }
        axis
    }
}

/// A motor whose winding becomes 100 K warmer than the air at a loss of so many W.
fn heated(loss: f64) -> ThermalConfig {
    let resistance = 100.0 / loss;
    ThermalConfig {
        winding_to_housing: resistance / 3.0,
        housing_to_air: 2.0 * resistance / 3.0,
        winding_capacity: 180.0 / resistance,
        housing_capacity: 1800.0 / resistance,
        air: 25.0,
        trip: 155.0,
    }
}
