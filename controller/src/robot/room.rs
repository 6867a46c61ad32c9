//! Extension of the ranges of axes by the positions in which homing leaves the axes.
//!
//! An axis that is homed at the end of its range comes to rest on either side of that end. The range has to include
//! both positions. Otherwise no command could move the axis away from there.

use std::f64::consts::TAU;

use super::{GearAxis, Limits, ScrewAxis};

/// Largest extension of a range, rad of the motor. If homing may leave a motor farther from home, the motor needs a
/// configured range.
const MOST: f64 = 1.0;

impl Limits {
    /// With room for a place that lies up to `by` beside `home`, if the range includes `home`.
    pub(super) fn with_room(self, home: f64, by: f64) -> Self {
        if self.exceeded_by(home).is_some() {
            return self;
        }
        Self::new(self.low.min(home - by), self.high.max(home + by))
    }

    /// With room for the values of `function` up to `by` beside `home`. Where `function` has no value, no room is added.
    pub(super) fn with_room_through(self, function: impl Fn(f64) -> Option<f64>, home: f64, by: f64) -> Self {
        let Some(value) = function(home) else {
            return self;
        };
        let ways = [-by, by].map(|by| function(home + by)).into_iter().flatten().map(|end| (end - value).abs());
        self.with_room(value, ways.fold(0.0, f64::max))
    }
}

/// The extension for motor `axis`, rad.
pub(super) fn room(motors: &[f64], axis: usize) -> f64 {
    motors.get(axis).map_or(0.0, |motor| motor.min(MOST))
}

impl GearAxis {
    /// Extends the range of a motor that rests up to `motor` rad from home, and is carried by up to `carried` rad.
    pub(super) fn with_room(mut self, motor: f64, carried: f64) -> Self {
        let joint = (motor + carried) / self.ratio.abs();
        self.joint_limits = self.joint_limits.with_room(self.joint_at_home, joint);
        self.motor_limits = self.motor_limits.with_room(self.motor_at_home, motor);
        self
    }
}

impl ScrewAxis {
    pub(super) fn with_room(mut self, motor: f64) -> Self {
        let screw = motor * self.lead / TAU;
        let joint = |length| self.joint(length).ok();
        self.joint_limits = self.joint_limits.with_room_through(joint, self.length_at_home, screw);
        self.motor_limits = self.motor_limits.with_room(self.motor_at_home, motor);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{ConveyorParameters, Irb6Parameters, Irp6TrackParameters, RobotParameters as _};

    #[test]
    fn a_range_that_ends_at_home_gets_room_there_and_no_other_does() {
        let all = Irp6TrackParameters::irp6ot();
        let motors = [0.08; 7];
        assert_eq!(all.with_room_at_home(&motors), all);
        let mut at_the_end = all;
        at_the_end.track.joint_limits.low = 0.0;
        at_the_end.robot.arm.roll.motor_limits.high = at_the_end.robot.arm.roll.motor_at_home;
        let roomy = at_the_end.with_room_at_home(&motors);
        let track = 0.08 / at_the_end.track.ratio;
        assert_eq!(roomy.track.joint_limits.low, -track);
        let roll = roomy.robot.arm.roll.motor_limits.high;
        assert_eq!(roll, at_the_end.robot.arm.roll.motor_at_home + 0.08);
        let home = at_the_end.robot.arm.roll.motor_at_home;
        let expected = Irp6TrackParameters {
            track: roomy.track,
            robot: {
                let mut robot = at_the_end.robot;
                robot.arm.roll.motor_limits.high = home + 0.08;
                robot
            },
        };
        assert_eq!(roomy, expected);
    }

    #[test]
    fn a_screw_has_room_for_its_joint_on_both_sides_of_home() {
        let mut arm = Irb6Parameters::irb6().arm;
        let home = arm.upper_arm.joint(arm.upper_arm.length_at_home).unwrap();
        arm.upper_arm.joint_limits.low = home;
        let roomy = arm.with_room_at_home(&[0.08; 5]).upper_arm;
        let lowest = arm.upper_arm.joint(arm.upper_arm.length_at_home - 0.08 * 0.005 / TAU);
        assert!(roomy.joint_limits.low <= lowest.unwrap());
        assert!(roomy.joint_limits.low > home - 2.0 * (home - lowest.unwrap()));
    }

    #[test]
    fn a_home_outside_its_range_and_a_wild_homing_get_no_range_of_their_own() {
        let mut belt = ConveyorParameters::belt();
        belt.motor_limits.low = 10.0;
        assert_eq!(belt.with_room_at_home(&[0.08]), belt);
        belt.motor_limits.low = 0.0;
        let roomy = belt.with_room_at_home(&[1e6]);
        assert_eq!(roomy.motor_limits.low, -MOST);
    }
}
