//! Positions of a robot's axes after homing.

use std::f64::consts::TAU;

use super::{Axis, Cell};
use controller::generator::{Axes, PlannedStart};
use controller::robot::{Arm, ParameterError};

/// Periods from a motor's reference to the start of its braking. The reference appears in the next sample, the command
/// takes effect a period later, and a group has a delay of up to two periods.
const LATE: f64 = 4.0;

/// Greatest distance of a motor at rest from its set-point, counts, when the servo takes over its position.
const SETTLING: f64 = 4.0;

impl Cell {
    /// Like [`Robot::arm`](super::Robot::arm) for robot `robot`, with room for homing in each range that ends at home.
    pub fn arm(&self, robot: usize) -> Result<Arm, ParameterError> {
        let given = &self.robot[robot];
        let parameters = given.numbers();
        let roomy = super::Robot {
            parameters: Some(parameters.with_room_at_home(&self.home_tolerances(robot))),
            ..given.clone()
        };
        roomy.arm().or_else(|_| given.arm())
    }

    /// The home position of robot `robot`, and the tolerance of each motor after homing.
    pub fn home(&self, robot: usize, arm: &Arm) -> PlannedStart {
        PlannedStart { motors: arm.robot().home().padded(), tolerance: self.home_tolerances(robot) }
    }

    fn home_tolerances(&self, robot: usize) -> Axes {
        let axes = &self.robot[robot].axis;
        std::array::from_fn(|number| axes.get(number).map_or(0.0, |axis| self.home_tolerance(axis)))
    }

    /// Greatest distance of a homed motor from its home position, rad.
    ///
    /// A search reaches the home position with the velocity v of its last phase, `zero_velocity`. The motor continues
    /// by v²/2a under the homing acceleration a, and by v for each period until it brakes. On a serial line the host
    /// brakes, and up to `tolerated_missing` answers may be lost before the answer with the reference. With the
    /// figures of the example cells, 3.5 rad/s, 150 rad/s² and 2 ms, the two distances are 0.041 + 0.028 rad. 4 counts
    /// of 4000 are 0.006 rad. The sum of 0.08 rad of the motor is 0.5 mrad of a joint behind a gear of 158, or 0.4 mm
    /// of a tool 0.8 m from its axis.
    fn home_tolerance(&self, axis: &Axis) -> f64 {
        let homing = &axis.homing;
        let bundle = self.serial.iter().find(|bundle| bundle.name == axis.bus);
        let lost = bundle.map_or(0, |bundle| bundle.tolerated_missing);
        let late = (LATE + f64::from(lost)) * self.period().as_secs_f64();
        let velocity = homing.zero_velocity;
        let count = TAU / f64::from(axis.counts_per_revolution());
        velocity * (velocity / (2.0 * homing.acceleration) + late) + SETTLING * count
    }
}
