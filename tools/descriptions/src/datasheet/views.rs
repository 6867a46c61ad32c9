//! Viewing direction and posture for the figure of each robot.

use controller::robot::{ConveyorParameters, GripperParameters, Joints, Vector};
use nalgebra::Vector3;

use super::figure::View;

/// Content of the figure of a machine.
pub(crate) enum Drawing<'a> {
    Arm(Box<[View; 2]>),
    Gripper(&'a GripperParameters),
    Conveyor(&'a ConveyorParameters),
}

pub(crate) fn from_degrees(degrees: &[f64]) -> Joints {
    let radians: Vec<_> = degrees.iter().map(|degrees| degrees.to_radians()).collect();
    Vector::new(&radians).expect("no robot has more axes than a vector")
}

/// A ring in the plane of x and y, or a sector of a ring.
pub(crate) fn sector(radii: [f64; 2], [from, to]: [f64; 2]) -> Vec<Vec<Vector3<f64>>> {
    let [inner, outer] = radii.map(|radius| {
        let point = |step| {
            let (sin, cos) = (from + (to - from) * f64::from(step) / 72.0).sin_cos();
            Vector3::new(radius * cos, radius * sin, 0.0)
        };
        (0..=72).map(point).collect::<Vec<_>>()
    });
    if to - from >= std::f64::consts::TAU {
        return vec![outer, inner];
    }
    vec![outer.into_iter().chain(inner.into_iter().rev()).collect()]
}
