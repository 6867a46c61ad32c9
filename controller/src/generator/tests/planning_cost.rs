//! Cost of the planning of lines, in calls of the kinematics.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use nalgebra::Isometry3;

use super::limits::{HIGH, PERIOD, arms, beside, standing};
use super::*;
use crate::robot::{Arm, Jacobian, Joints, KinematicsError, Limits, Motors, Robot, Solutions};

/// A robot that counts the calls of its kinematics.
#[derive(Debug)]
struct Counted {
    robot: Arm,
    calls: Arc<AtomicU64>,
}

impl Counted {
    fn count(&self) -> &dyn Robot {
        self.calls.fetch_add(1, Ordering::Relaxed);
        self.robot.robot()
    }
}

impl Robot for Counted {
    fn joint_limits(&self) -> &[Limits] {
        self.robot.robot().joint_limits()
    }

    fn motor_limits(&self) -> &[Limits] {
        self.robot.robot().motor_limits()
    }

    fn home(&self) -> Motors {
        self.robot.robot().home()
    }

    fn forward(&self, joints: &Joints) -> Result<Isometry3<f64>, KinematicsError> {
        self.count().forward(joints)
    }

    fn inverse(&self, base_from_flange: &Isometry3<f64>, near: &Joints) -> Result<Solutions, KinematicsError> {
        self.count().inverse(base_from_flange, near)
    }

    fn motors_from_joints(&self, joints: &Joints) -> Result<Motors, KinematicsError> {
        self.robot.robot().motors_from_joints(joints)
    }

    fn joints_from_motors(&self, motors: &Motors) -> Result<Joints, KinematicsError> {
        self.robot.robot().joints_from_motors(motors)
    }

    fn jacobian(&self, joints: &Joints) -> Result<Jacobian, KinematicsError> {
        self.count().jacobian(joints)
    }
}

#[test]
fn planning_a_line_needs_a_bounded_number_of_kinematics() {
    for (name, arm) in arms() {
        let calls = Arc::new(AtomicU64::new(0));
        let counted = Counted { robot: arm.clone(), calls: Arc::clone(&calls) };
        let counted = Arm::new(Arc::new(counted), *arm.flange_from_tool());
        let mut found: Vec<u64> = Vec::new();
        for seed in 0..60 {
            let mut random = Random(seed);
            let Some((_, image)) = standing(&arm, &mut random) else { continue };
            let target = beside(&arm, &image.commanded.pose, &mut random);
            let mut line = StraightLine::new(counted.clone(), target, HIGH.line(), HIGH.joints).unwrap();
            calls.store(0, Ordering::Relaxed);
            if line.first_step(&image, PERIOD).is_ok() {
                found.push(calls.load(Ordering::Relaxed));
            }
        }
        found.sort_unstable();
        let [median, most] = [found[found.len() / 2], found[found.len() - 1]];
        println!("{name}: {} lines, {median} calls in the median, at most {most}", found.len());
        assert!(found.len() >= 10 && median <= 1_000 && most <= 4_000, "{name}: {median} and {most}");
    }
}
