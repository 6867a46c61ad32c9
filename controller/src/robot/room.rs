//! Extension of the ranges of axes by the positions in which homing leaves the axes.
//!
//! An axis that is homed at the end of its range comes to rest on either side of that end. The range has to include
//! both positions. Otherwise no command could move the axis away from there.

use std::f64::consts::TAU;

use super::{
    ArmParameters, ConveyorParameters, GearAxis, GripperParameters, Irb6Parameters, Irp6Parameters,
    Irp6TrackParameters, LegAxis, Limits, PolycrankParameters, RntParameters, ScrewAxis,
};

/// Largest extension of a range, rad of the motor. If homing may leave a motor farther from home, the motor needs a
/// configured range.
const MOST: f64 = 1.0;

/// Parameters of a robot, with ranges that can be extended.
pub trait Room: Sized {
    /// Extends each range that includes the home position. `motors` holds the largest distance from home at which
    /// homing leaves each motor, in the order of the axes, rad.
    #[must_use]
    fn with_room_at_home(self, motors: &[f64]) -> Self;
}

impl Limits {
    fn with_room(self, home: f64, by: f64) -> Self {
        if self.exceeded_by(home).is_some() {
            return self;
        }
        Self {
            low: self.low.min(home - by),
            high: self.high.max(home + by),
        }
    }
}

/// The extension for motor `axis`, rad.
fn room(motors: &[f64], axis: usize) -> f64 {
    motors.get(axis).map_or(0.0, |motor| motor.min(MOST))
}

impl GearAxis {
    /// Extends the range of a motor that rests up to `motor` rad from home, and is carried by up to `carried` rad.
    fn with_room(mut self, motor: f64, carried: f64) -> Self {
        let joint = (motor + carried) / self.ratio.abs();
        self.joint_limits = self.joint_limits.with_room(self.joint_at_home, joint);
        self.motor_limits = self.motor_limits.with_room(self.motor_at_home, motor);
        self
    }
}

impl ScrewAxis {
    fn with_room(mut self, motor: f64) -> Self {
        let screw = motor * self.lead / TAU;
        let at = |length| self.joint(length).ok();
        if let Some(home) = at(self.length_at_home) {
            let ends = [-screw, screw].map(|by| at(self.length_at_home + by));
            let ways = ends.into_iter().flatten().map(|end| (end - home).abs());
            let joint = ways.fold(0.0, f64::max);
            self.joint_limits = self.joint_limits.with_room(home, joint);
        }
        self.motor_limits = self.motor_limits.with_room(self.motor_at_home, motor);
        self
    }
}

impl Room for ArmParameters {
    fn with_room_at_home(self, motors: &[f64]) -> Self {
        let room = |axis| room(motors, axis);
        Self {
            column: self.column.with_room(room(0), 0.0),
            lower_arm: self.lower_arm.with_room(room(1)),
            upper_arm: self.upper_arm.with_room(room(2)),
            pitch: self.pitch.with_room(room(3), 0.0),
            roll: self.roll.with_room(room(4), room(3)),
            ..self
        }
    }
}

impl Room for Irb6Parameters {
    fn with_room_at_home(self, motors: &[f64]) -> Self {
        Self {
            arm: self.arm.with_room_at_home(motors),
            ..self
        }
    }
}

impl Room for Irp6Parameters {
    fn with_room_at_home(self, motors: &[f64]) -> Self {
        Self {
            arm: self.arm.with_room_at_home(motors),
            hand: self.hand.with_room(room(motors, 5), 0.0),
        }
    }
}

impl Room for Irp6TrackParameters {
    fn with_room_at_home(self, motors: &[f64]) -> Self {
        Self {
            track: self.track.with_room(room(motors, 0), 0.0),
            robot: self.robot.with_room_at_home(motors.get(1..).unwrap_or(&[])),
        }
    }
}

impl Room for PolycrankParameters {
    fn with_room_at_home(mut self, motors: &[f64]) -> Self {
        for (axis, gear) in self.axes.iter_mut().enumerate() {
            let carried = self.coupled && matches!(axis, 1 | 2 | 4 | 5);
            let carried = if carried { room(motors, axis - 1) } else { 0.0 };
            *gear = gear.with_room(room(motors, axis), carried);
        }
        self
    }
}

/// The ranges of alpha, beta and rho are not extended: their home positions are not parameters.
impl Room for RntParameters {
    fn with_room_at_home(mut self, motors: &[f64]) -> Self {
        for (axis, leg) in self.legs.iter_mut().enumerate() {
            let LegAxis {
                lead,
                length_at_home,
                ..
            } = *leg;
            let length = room(motors, axis) * lead.abs() / TAU;
            leg.length_limits = leg.length_limits.with_room(length_at_home, length);
        }
        Self {
            roll: self.roll.with_room(room(motors, 3), 0.0),
            pitch: self.pitch.with_room(room(motors, 4), 0.0),
            spin: self.spin.with_room(room(motors, 5), 0.0),
            ..self
        }
    }
}

impl Room for GripperParameters {
    fn with_room_at_home(mut self, motors: &[f64]) -> Self {
        let motor = room(motors, 0);
        if let Ok(home) = self.opening(self.motor_at_home) {
            let ends = [-motor, motor].map(|by| self.opening(self.motor_at_home + by));
            let ways = ends.into_iter().flatten().map(|end| (end - home).abs());
            let opening = ways.fold(0.0, f64::max);
            self.opening_limits = self.opening_limits.with_room(home, opening);
        }
        self.motor_limits = self.motor_limits.with_room(self.motor_at_home, motor);
        self
    }
}

impl Room for ConveyorParameters {
    fn with_room_at_home(mut self, motors: &[f64]) -> Self {
        self.motor_limits = self
            .motor_limits
            .with_room(self.motor_at_home, room(motors, 0));
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let lowest = arm
            .upper_arm
            .joint(arm.upper_arm.length_at_home - 0.08 * 0.005 / TAU);
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
