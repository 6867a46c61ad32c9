//! An axis as a whole: plant, sensors and loops.

use super::{Axis, AxisConfig, Demand, Irp6Axis};

#[test]
fn velocity_demand_is_reached() {
    for axis in Irp6Axis::ALL {
        let mut axis = Axis::new(&AxisConfig::irp6(axis), 1);
        axis.advance(10_000, Demand::Velocity(-20_000.0));
        let velocity = axis.feedback().velocity;
        assert!((velocity + 20_000.0).abs() < 1_000.0, "{velocity} counts/s");
    }
}
