//! Mass, centre and inertia of a rigid body.

use nalgebra::{Isometry3, Matrix3, Vector3};

/// A rigid body in some frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass, m.
    pub centre: Vector3<f64>,
    /// Inertia about the centre of mass, kg·m², in the axes of the frame.
    pub inertia: Matrix3<f64>,
}

impl Body {
    /// The body in a frame in which its own frame is `placed`.
    pub(crate) fn placed(&self, placed: &Isometry3<f64>) -> Self {
        let turn = placed.rotation.to_rotation_matrix();
        Self {
            mass: self.mass,
            centre: placed.transform_point(&self.centre.into()).coords,
            inertia: turn.matrix() * self.inertia * turn.matrix().transpose(),
        }
    }

    /// Both bodies as one. Both masses are above zero.
    pub(crate) fn and(&self, other: &Self) -> Self {
        let mass = self.mass + other.mass;
        let centre = (self.centre * self.mass + other.centre * other.mass) / mass;
        let moved = |body: &Self| {
            let arm = body.centre - centre;
            body.inertia + body.mass * (Matrix3::identity() * arm.norm_squared() - arm * arm.transpose())
        };
        Self { mass, centre, inertia: moved(self) + moved(other) }
    }

    /// The six components of the inertia: xx, yy, zz, xy, xz, yz.
    pub fn components(&self) -> [f64; 6] {
        let it = &self.inertia;
        [it[(0, 0)], it[(1, 1)], it[(2, 2)], it[(0, 1)], it[(0, 2)], it[(1, 2)]]
    }
}
