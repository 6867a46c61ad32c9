//! Distances in front of a matrix, from the view of a scene.

use can::Instant;
use nalgebra::{Isometry3, Point3, Vector3};

use super::{EchoProbe, UltrasonicConfig};
use crate::scene::View;

/// An [`EchoProbe`] of a matrix in a scene.
#[derive(Clone, Debug)]
pub struct SceneEchoes {
    view: View,
    pose: Isometry3<f64>,
    config: UltrasonicConfig,
}

impl SceneEchoes {
    /// The echoes of the matrix `config` in `view`. `pose`: frame of the matrix in the world; columns grow along x, rows
    /// along y, and the elements look along z.
    pub fn new(view: View, pose: Isometry3<f64>, config: &UltrasonicConfig) -> Self {
        Self { view, pose, config: config.clone() }
    }
}

impl EchoProbe for SceneEchoes {
    fn distance(&mut self, element: (usize, usize), _now: Instant) -> Option<f64> {
        let [x, y] = self.config.position(element);
        let apex = self.pose * Point3::new(x, y, 0.0);
        self.view.nearest_in_cone(&apex, &(self.pose.rotation * Vector3::z_axis()), self.config.half_cone)
    }
}
