//! A chain as one of the robots with numbers of their own.

use std::sync::Arc;

use super::super::{Mass, MotorRating, ParameterError, Robot, RobotParameters};
use super::{Chain, ChainJoint, ChainParameters};

impl RobotParameters for ChainParameters {
    fn axes(&self) -> usize {
        self.joints.len()
    }

    fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError> {
        Ok(Arc::new(Chain::new(self)?))
    }

    fn with_room_at_home(self, motors: &[f64]) -> Self {
        self.roomy(motors)
    }

    /// The masses that are known; none if that of any link is unknown.
    fn masses(&self) -> Vec<Mass> {
        self.known_masses().unwrap_or_default()
    }

    /// Ratings that the joints ask of their motors; none if those of any joint are unknown, or if motors are coupled.
    fn motors(&self) -> Vec<MotorRating> {
        let rating = |joint: &ChainJoint| {
            let ratio = joint.ratio.abs();
            Some(MotorRating::new(joint.velocity? * ratio, joint.effort? / ratio))
        };
        let ratings = self.joints.iter().map(rating).collect::<Option<_>>();
        ratings.filter(|_| self.motors_from_joints.is_none()).unwrap_or_default()
    }

    fn up(&self) -> [f64; 3] {
        self.up
    }
}
