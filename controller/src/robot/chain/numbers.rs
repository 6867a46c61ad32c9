//! The parameters of a chain, with the functions of all robot parameters.

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

    /// The masses of the links; empty if the mass of any link is unknown.
    fn masses(&self) -> Vec<Mass> {
        self.known_masses().unwrap_or_default()
    }

    /// Ratings that the joints require of their motors. Empty if a rating of any joint is unknown, or if motors are
    /// coupled.
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
