//! Surfaces: shapes that a sphere can touch, and their springs, dampers and friction.

use nalgebra::Vector3;

/// The solid behind a surface, in the frame of the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// All points with z below zero.
    HalfSpace,
    /// A box around the origin.
    Box {
        /// Half of each edge, m.
        half: [f64; 3],
    },
}

/// Elasticity and friction of a surface.
///
/// A spring and a damper in parallel push a penetrating sphere out of the surface. The magnitude of the damping force
/// is at most the spring force. The normal force is therefore never a pull, and begins at zero. Friction is Coulomb
/// friction with an elastic bristle of the same stiffness and damping. A body can therefore stand on a slope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Force per penetration, N/m.
    pub stiffness: f64,
    /// Force per velocity of penetration, N·s/m.
    pub damping: f64,
    /// Largest ratio of friction force to normal force.
    pub friction: f64,
}

impl Material {
    /// A rigid body on metal: 1e5 N/m, 300 N·s/m, friction 0.3 (nominal).
    pub const NOMINAL: Self = Self { stiffness: 1e5, damping: 300.0, friction: 0.3 };

    /// Whether the values describe a passive surface.
    pub(super) fn is_passive(&self) -> bool {
        let valid = |value: f64| value.is_finite() && value >= 0.0;
        self.stiffness > 0.0 && valid(self.stiffness) && valid(self.damping) && valid(self.friction)
    }

    /// Energy of the spring, J, at a gap, m. A negative gap is a penetration.
    pub(super) fn energy(&self, gap: f64) -> f64 {
        let depth = (-gap).max(0.0);
        0.5 * self.stiffness * depth * depth
    }

    /// Mean spring force while the gap changes between two values, N: decrease of the spring's energy per change of the
    /// gap. Equal gaps give the force at this gap.
    fn spring(&self, gaps: [f64; 2]) -> f64 {
        let [start, end] = gaps.map(|gap| (-gap).max(0.0));
        if start > 0.0 && end > 0.0 {
            0.5 * self.stiffness * (start + end)
        } else if start == end {
            0.0
        } else {
            0.5 * self.stiffness * (start + end) * (start - end) / (gaps[1] - gaps[0])
        }
    }

    /// Mean normal force while the gap changes between two values, m, at `rate`, m/s. The force, N, is never negative.
    pub(super) fn normal(&self, gaps: [f64; 2], rate: f64) -> f64 {
        let spring = self.spring(gaps);
        spring + (-self.damping * rate).clamp(-spring, spring)
    }

    /// Friction force, N, and new displacement of the bristle, m, under the normal force `normal`, N. The sphere moves
    /// from the displacement `bristle`, m, by `slide`, m, along the surface, at the velocity `rate`, m/s.
    ///
    /// The energy of the bristle grows at most by the work of the force.
    pub(super) fn drag(
        &self,
        normal: f64,
        bristle: Vector3<f64>,
        slide: Vector3<f64>,
        rate: Vector3<f64>,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let stuck = bristle + slide;
        let force = -self.stiffness * (bristle + 0.5 * slide) - self.damping * rate;
        let most = self.friction * normal;
        let size = force.norm();
        // The spring force of the bristle never exceeds the friction limit, even after a decrease of the normal force.
        let longest = most / self.stiffness;
        if size <= most {
            return (force, shortened(stuck, longest));
        }
        let share = most / size;
        let stored = (1.0 - share) * bristle.norm_squared() + share * stuck.norm_squared();
        (force * share, shortened(stuck, longest.min(stored.sqrt())))
    }
}

fn shortened(vector: Vector3<f64>, longest: f64) -> Vector3<f64> {
    let size = vector.norm();
    if size <= longest { vector } else { vector * (longest / size) }
}

impl Shape {
    /// Distance of a point from the surface, m, negative inside the solid, and unit vector along which the distance
    /// grows. Both are in the frame of the surface.
    pub(super) fn gap(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        match self {
            Self::HalfSpace => (point.z, Vector3::z()),
            Self::Box { half } => {
                let beyond = point.abs() - Vector3::from(*half);
                let sign = point.map(|x| 1.0_f64.copysign(x));
                let outside = beyond.map(|x| x.max(0.0));
                let distance = outside.norm();
                if distance > 0.0 {
                    return (distance, outside.component_mul(&sign) / distance);
                }
                let nearest = beyond.imax();
                let mut normal = Vector3::zeros();
                normal[nearest] = sign[nearest];
                (beyond[nearest], normal)
            }
        }
    }

    /// Radius of the sphere around the origin that contains the shape, m.
    pub(super) fn extent(&self) -> f64 {
        match self {
            Self::HalfSpace => f64::INFINITY,
            Self::Box { half } => Vector3::from(*half).norm(),
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::{Material, Shape};

    const METAL: Material = Material { stiffness: 1e5, damping: 300.0, friction: 0.5 };

    #[test]
    fn gap_of_a_box_is_the_distance_from_its_nearest_face_edge_or_corner() {
        let shape = Shape::Box { half: [1.0, 2.0, 3.0] };
        let cases = [
            ([0.9, 0.0, 0.0], -0.1, [1.0, 0.0, 0.0]),
            ([-0.9, 0.0, 0.0], -0.1, [-1.0, 0.0, 0.0]),
            ([0.0, 0.0, -3.5], 0.5, [0.0, 0.0, -1.0]),
            ([4.0, 6.0, 0.0], 5.0, [0.6, 0.8, 0.0]),
            ([2.0, -4.0, 5.0], 3.0, [1.0 / 3.0, -2.0 / 3.0, 2.0 / 3.0]),
        ];
        for (point, gap, normal) in cases {
            let found = shape.gap(&Vector3::from(point));
            assert!((found.0 - gap).abs() < 1e-12, "{point:?}: {found:?}");
            assert!((found.1 - Vector3::from(normal)).norm() < 1e-12, "{point:?}: {found:?}");
        }
    }

    #[test]
    fn normal_force_pushes_and_never_pulls() {
        // Gaps at the beginning and at the end, mm; rate, m/s; force, N.
        let cases = [
            ([1.0, 1.0], -1.0, 0.0),
            ([-1.0, -1.0], 0.0, 100.0),
            ([-1.0, -1.0], -0.1, 130.0),
            ([-1.0, -1.0], 0.1, 70.0),
            ([-1.0, -1.0], 10.0, 0.0),
            ([-1.0, -1.0], -10.0, 200.0),
            ([-1.0, -3.0], 0.0, 200.0),
            // Half of the way is outside: 0.5 k (1 mm)² over 2 mm.
            ([1.0, -1.0], 0.0, 25.0),
            ([-1.0, 1.0], 0.0, 25.0),
        ];
        for (gaps, rate, force) in cases {
            let found = METAL.normal(gaps.map(|gap| gap * 1e-3), rate);
            assert!((found - force).abs() < 1e-9, "{gaps:?} mm at {rate} m/s: {found} N");
        }
    }

    #[test]
    fn bristle_holds_up_to_the_friction_and_then_slides() {
        let x = |value: f64| Vector3::new(value, 0.0, 0.0);
        let still = Vector3::zeros();
        // 40 N of 50 N: the bristle holds.
        let (force, bristle) = METAL.drag(100.0, x(4e-4), still, still);
        assert!((force - x(-40.0)).norm() < 1e-9 && (bristle - x(4e-4)).norm() < 1e-15, "{force} {bristle}");
        // 80 N: the bristle slides and stays as long as 50 N demand.
        let (force, bristle) = METAL.drag(100.0, x(8e-4), still, still);
        assert!((force - x(-50.0)).norm() < 1e-9 && (bristle - x(5e-4)).norm() < 1e-12, "{force} {bristle}");
        // Without a normal force nothing holds.
        let (force, bristle) = METAL.drag(0.0, x(8e-4), x(1e-4), x(1.0));
        assert!(force.norm() == 0.0 && bristle.norm() == 0.0, "{force} {bristle}");
    }
}
