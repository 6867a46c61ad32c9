//! Thermal model of a motor.

/// Thermal model of two bodies that the losses of a motor heat: the winding, and the housing with its magnets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThermalConfig {
    /// Thermal resistance from winding to housing, K/W.
    pub winding_to_housing: f64,
    /// Thermal resistance from housing to the air, K/W.
    pub housing_to_air: f64,
    /// Heat capacity of the winding, J/K.
    pub winding_capacity: f64,
    /// Heat capacity of the housing, J/K.
    pub housing_capacity: f64,
    /// Temperature of the air, °C. The motor starts at this temperature.
    pub air: f64,
    /// Winding temperature at which the drive trips, °C.
    pub trip: f64,
}

#[derive(Clone, Debug)]
pub(crate) struct Thermal {
    config: ThermalConfig,
    /// Temperature of the winding, °C.
    pub(super) winding: f64,
    /// Temperature of the housing, °C.
    pub(super) housing: f64,
    /// Whether the winding is too hot. The state lasts until the winding is 5 K below the trip temperature.
    pub(super) tripped: bool,
}

/// Temperature drop of the winding that clears a trip, K.
const HYSTERESIS: f64 = 5.0;

impl Thermal {
    pub(crate) fn new(config: &ThermalConfig) -> Self {
        Self { config: *config, winding: config.air, housing: config.air, tripped: false }
    }

    /// Takes the mean loss of the last `dt` seconds, W. Explicit Euler: `dt` must be far below the product of the
    /// winding's heat capacity and thermal resistance.
    pub(crate) fn step(&mut self, loss: f64, dt: f64) {
        let inward = (self.winding - self.housing) / self.config.winding_to_housing;
        let outward = (self.housing - self.config.air) / self.config.housing_to_air;
        self.winding += (loss - inward) / self.config.winding_capacity * dt;
        self.housing += (inward - outward) / self.config.housing_capacity * dt;
        let limit = self.config.trip - if self.tripped { HYSTERESIS } else { 0.0 };
        self.tripped = self.winding >= limit;
    }
}

#[cfg(test)]
mod tests {
    use super::{Thermal, ThermalConfig};

    const CONFIG: ThermalConfig = ThermalConfig {
        winding_to_housing: 1.0,
        housing_to_air: 2.0,
        winding_capacity: 60.0,
        housing_capacity: 800.0,
        air: 25.0,
        trip: 155.0,
    };

    fn after(thermal: &mut Thermal, loss: f64, seconds: f64) {
        for _ in 0..(seconds * 10.0) as u32 {
            thermal.step(loss, 0.1);
        }
    }

    #[test]
    fn steady_loss_settles_at_the_sum_of_resistances() {
        let mut thermal = Thermal::new(&CONFIG);
        after(&mut thermal, 20.0, 20_000.0);
        assert!((thermal.winding - 85.0).abs() < 0.1, "{}", thermal.winding);
        assert!((thermal.housing - 65.0).abs() < 0.1, "{}", thermal.housing);
    }

    #[test]
    fn winding_warms_first() {
        let mut thermal = Thermal::new(&CONFIG);
        after(&mut thermal, 50.0, 60.0);
        let rise = (thermal.winding - 25.0) / 50.0;
        assert!((0.6..0.66).contains(&rise), "{rise} of the final rise over the housing");
        assert!(thermal.housing < 27.5);
    }

    #[test]
    fn trip_holds_until_the_winding_has_cooled() {
        let mut thermal = Thermal::new(&CONFIG);
        let (mut trips, mut clears) = (Vec::new(), Vec::new());
        let mut was = false;
        for tick in 0..20_000 {
            let loss = if thermal.tripped { 0.0 } else { 200.0 };
            thermal.step(loss, 0.01);
            match (was, thermal.tripped) {
                (false, true) => trips.push(thermal.winding),
                (true, false) => clears.push(thermal.winding),
                _ => {}
            }
            was = thermal.tripped;
            assert!(thermal.winding < 155.1, "at tick {tick}");
        }
        assert!(trips.len() > 1 && trips.iter().all(|t| *t >= 155.0), "{trips:?}");
        assert!(!clears.is_empty() && clears.iter().all(|t| *t < 150.0), "{clears:?}");
    }
}
