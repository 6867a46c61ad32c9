//! Motion of a sensor at the flange of an arm, by the set-points of the arm.

use std::time::Duration;

use can::Instant;
use nalgebra::{UnitQuaternion, Vector3};
use servo::{MAX_AXES, Trail};

use super::SensorMotion;
use crate::robot::{Arm, KinematicsError, Motors, Pose};

impl SensorMotion {
    /// Motion at `time` of the sensor at `flange_from_sensor`, by the set-points of its arm. `orientation`: rotation from
    /// the axes of the sensor to axes whose z points upward.
    ///
    /// Velocities and accelerations are differences of three set-points, one servo period apart. The set-points are those
    /// that the arm executes at `time`, behind the servo by the delay of the drive group ([`Trail::around`]) plus `lag`. The
    /// motion of the sensor is zero
    /// while the set-points stand. Fails where the set-points are out of the reach of the kinematics. All numbers are finite.
    pub fn commanded(
        arm: &Arm,
        flange_from_sensor: &Pose,
        orientation: UnitQuaternion<f64>,
        trail: &Trail,
        time: Instant,
        lag: Duration,
    ) -> Result<Self, KinematicsError> {
        let rest = Self::at_rest(orientation);
        let around = trail.around(Instant::from_nanos(time.as_nanos().saturating_sub(lag.as_nanos() as u64)));
        let period = trail.period();
        if around[0] == around[1] && around[1] == around[2] || period <= 0.0 {
            return Ok(rest);
        }
        let mut poses = [Pose::identity(); 3];
        for (pose, motors) in poses.iter_mut().zip(&around) {
            *pose = flange(arm, motors)? * flange_from_sensor;
        }
        let [before, there, after] = poses;
        let to_sensor = there.rotation.inverse();
        // Rotations from before to the present, and from there on, in the axes of the sensor.
        let [first, second] = [before, after].map(|pose| (to_sensor * pose.rotation).scaled_axis());
        let [first_step, second_step] =
            [before, after].map(|pose| to_sensor * (pose.translation.vector - there.translation.vector));
        let square = period * period;
        let motion = Self {
            angular_velocity: (second - first) / (2.0 * period),
            angular_acceleration: (second + first) / square,
            acceleration: (second_step + first_step) / square,
            ..rest
        };
        let finite = |vector: &Vector3<f64>| vector.iter().all(|component| component.is_finite());
        let all = [&motion.angular_velocity, &motion.angular_acceleration, &motion.acceleration];
        if all.into_iter().all(finite) { Ok(motion) } else { Err(KinematicsError::NotFinite) }
    }
}

fn flange(arm: &Arm, motors: &[f64; MAX_AXES]) -> Result<Pose, KinematicsError> {
    let motors = Motors::new(&motors[..arm.axes()]).ok_or(KinematicsError::NotFinite)?;
    let robot = arm.robot();
    robot.forward(&robot.joints_from_motors(&motors)?)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Translation3};

    use super::*;
    use crate::force::{Load, Wrench};
    use crate::robot::{Irb6Parameters, RobotParameters};

    const PERIOD: f64 = 0.002;

    /// The IRb-6, whose column turns at 2 rad/s and accelerates by 3 rad/s², at the end of 100 ms.
    fn trail(arm: &Arm) -> Trail {
        Trail::along(Instant::from_nanos(100_000_000), PERIOD, 3, |after| {
            let mut joints = [0.0; MAX_AXES];
            joints[..5].copy_from_slice(&[2.0 * after + 1.5 * after * after, -1.571, 0.0, 1.571, 0.0]);
            arm.motors(&joints).unwrap()
        })
    }

    #[test]
    fn a_turning_column_accelerates_the_tool_toward_its_axis_and_along_its_path() {
        let arm = Arm::new(Irb6Parameters::irb6().robot().unwrap(), Pose::identity());
        let flange_from_sensor = Pose::translation(0.0, 0.0, 0.09);
        // The sample of 98 ms shows the set-points of 94 ms, 6 ms before the end.
        let at = Instant::ZERO + Duration::from_millis(98);
        let motion = SensorMotion::commanded(
            &arm,
            &flange_from_sensor,
            UnitQuaternion::identity(),
            &trail(&arm),
            at,
            Duration::ZERO,
        );
        let motion = motion.unwrap();
        let (turned, rate) = (2.0 * -0.006 + 1.5 * 3.6e-5, 2.0 - 3.0 * 0.006);
        let mut joints = [0.0; MAX_AXES];
        joints[..5].copy_from_slice(&[turned, -1.571, 0.0, 1.571, 0.0]);
        let sensor = arm.forward(&joints).unwrap() * flange_from_sensor;
        let (spin, turning) = (Vector3::z() * rate, Vector3::z() * 3.0);
        let lever = sensor.translation.vector;
        let expected = turning.cross(&lever) + spin.cross(&spin.cross(&lever));
        let in_base = |vector: Vector3<f64>| sensor.rotation * vector;
        assert!((in_base(motion.acceleration) - expected).norm() < 1e-3, "{motion:?} {expected}");
        assert!((in_base(motion.angular_velocity) - spin).norm() < 1e-4, "{motion:?}");
        assert!((in_base(motion.angular_acceleration) - turning).norm() < 1e-3, "{motion:?}");
        assert!(expected.norm() > 3.0);
    }

    #[test]
    fn a_standing_arm_has_no_motion_even_where_the_kinematics_has_no_pose() {
        let arm = Arm::new(Irb6Parameters::irb6().robot().unwrap(), Pose::identity());
        let orientation = UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3);
        for place in [0.0, 1e6] {
            let trail = Trail::along(Instant::ZERO, PERIOD, 3, |_| [place; MAX_AXES]);
            let motion =
                SensorMotion::commanded(&arm, &Pose::identity(), orientation, &trail, Instant::ZERO, Duration::ZERO);
            assert_eq!(motion, Ok(SensorMotion::at_rest(orientation)));
        }
        let lost = Trail::along(Instant::ZERO, PERIOD, 3, |after| [after * f64::NAN; MAX_AXES]);
        let refused =
            SensorMotion::commanded(&arm, &Pose::identity(), orientation, &lost, Instant::ZERO, Duration::ZERO);
        assert!(refused.is_err(), "{refused:?}");
    }

    #[test]
    fn the_moment_of_the_inertia_is_about_the_sensor() {
        let arm = Arm::new(Irb6Parameters::irb6().robot().unwrap(), Pose::identity());
        let flange_from_sensor = Pose::from_parts(Translation3::new(0.0, 0.0, 0.09), UnitQuaternion::identity());
        let at = Instant::ZERO + Duration::from_millis(98);
        let orientation = UnitQuaternion::identity();
        let motion =
            SensorMotion::commanded(&arm, &flange_from_sensor, orientation, &trail(&arm), at, Duration::ZERO).unwrap();
        let centre = Vector3::new(0.0, 0.05, 0.1);
        let inertia = Matrix3::from_diagonal(&Vector3::new(0.01, 0.02, 0.025));
        let (point, body) = (Load::of_weight(2.0, centre).unwrap(), Load::new(2.0, centre, inertia).unwrap());
        let inertial = |load: &Load| load.wrench(&motion) - load.wrench(&SensorMotion::at_rest(orientation));
        let Wrench { force, torque } = inertial(&point);
        assert!((torque - centre.cross(&force)).norm() < 1e-9 && force.norm() > 5.0, "{force} {torque}");
        let (spin, turning) = (motion.angular_velocity, motion.angular_acceleration);
        let of_body = inertia * turning + spin.cross(&(inertia * spin));
        assert!((inertial(&body).torque - torque + of_body).norm() < 1e-9 && of_body.norm() > 0.01);
    }
}
