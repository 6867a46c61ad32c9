//! Contact of a sphere on one frame with a surface on another frame.

use nalgebra::{Matrix3, Vector3};

use super::motion::{Motion, Moving};
use super::surface::{Material, Shape};

/// A sphere: centre in the frame of its carrier, m, and radius, m.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sphere {
    pub(super) centre: Vector3<f64>,
    pub(super) radius: f64,
}

/// A surface and the velocity of a belt on it, in the frame of the surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    pub(super) shape: Shape,
    pub(super) material: Material,
    /// Velocity of the belt, m/s.
    pub(super) belt: Vector3<f64>,
}

/// Forces of a contact on the sphere, in the axes of the world. The opposite forces act on the surface at the same
/// points.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Push {
    /// Centre of the sphere, m.
    pub(super) centre: Vector3<f64>,
    /// Force through the centre, N.
    pub(super) normal: Vector3<f64>,
    /// Point of the sphere that touches the surface, m.
    pub(super) touch: Vector3<f64>,
    /// Friction at that point, N.
    pub(super) drag: Vector3<f64>,
    /// The new displacement of the bristle, in the frame of the surface, m.
    pub(super) bristle: Vector3<f64>,
}

/// Mean forces over a step of `dt` seconds; `None` if there is no contact at either end of the step.
///
/// The work of the forces is the decrease of the energy of the springs, less the losses by damping and friction.
pub(super) fn over_step(
    sphere: &Sphere,
    carrier: &Motion,
    surface: &Surface,
    ground: &Motion,
    bristle: &Vector3<f64>,
    dt: f64,
) -> Option<Push> {
    let points = carrier.points(&sphere.centre);
    let arms = [points[0] - ground.origin[0], points[1] - ground.origin[1]];
    let extent = surface.shape.extent() + sphere.radius;
    if arms[0].norm_squared().min(arms[1].norm_squared()) > extent * extent {
        return None;
    }
    let local = [ground.axes[0].tr_mul(&arms[0]), ground.axes[1].tr_mul(&arms[1])];
    let gaps = local.map(|point| surface.shape.gap(&point).0 - sphere.radius);
    if gaps[0] >= 0.0 && gaps[1] >= 0.0 {
        return None;
    }
    let way = local[1] - local[0];
    let slope = slope(&surface.shape, &local, &way, gaps[1] - gaps[0]);
    let size = surface.material.normal(gaps, (gaps[1] - gaps[0]) / dt);
    let axes = ground.mean_axes();
    let normal = axes * (slope * size);
    // A sphere that crosses a box from face to face has no mean gradient and no force.
    let direction = slope.try_normalize(f64::EPSILON).unwrap_or_else(|| face(&surface.shape, &local));
    let lever = -sphere.radius * (axes * direction);
    let middle = 0.5 * (points[0] + points[1]);
    let rolling = carrier.spin.cross(&lever) - ground.spin.cross(&lever);
    let slide = way + axes.tr_mul(&(rolling * dt)) - surface.belt * dt;
    let slide = along(&slide, &direction);
    let (drag, bristle) = surface.material.drag(size, along(bristle, &direction), slide, slide / dt);
    Some(Push { centre: middle, normal, touch: middle + lever, drag: axes * drag, bristle })
}

/// Mean gradient of the gap over a step: gradient times displacement is the change of the gap (Gonzalez, 1996).
fn slope(shape: &Shape, points: &[Vector3<f64>; 2], way: &Vector3<f64>, change: f64) -> Vector3<f64> {
    let normal = face(shape, points);
    let squared = way.norm_squared();
    let missing = change - normal.dot(way);
    // On a plane the normal is the gradient, and `missing` is a rounding error.
    if missing.abs() <= 1e-14 { normal } else { normal + way * (missing / squared) }
}

/// Normal of the surface that is nearest to the middle of a step.
fn face(shape: &Shape, points: &[Vector3<f64>; 2]) -> Vector3<f64> {
    shape.gap(&(0.5 * (points[0] + points[1]))).1
}

/// The part of a vector along the surface with this normal.
fn along(vector: &Vector3<f64>, normal: &Vector3<f64>) -> Vector3<f64> {
    vector - normal * normal.dot(vector)
}

/// Distance of a sphere from a surface, m. A negative distance is a penetration.
pub(super) fn clearance(sphere: &Sphere, carrier: &Moving, surface: &Surface, ground: &Moving) -> f64 {
    let arm = carrier.origin + carrier.axes * sphere.centre - ground.origin;
    surface.shape.gap(&ground.axes.tr_mul(&arm)).0 - sphere.radius
}

/// Forces at one instant; `None` without a contact. The motion of the last `dt` seconds displaces the bristle first.
pub(super) fn at_instant(
    sphere: &Sphere,
    carrier: &Moving,
    surface: &Surface,
    ground: &Moving,
    bristle: &Vector3<f64>,
    dt: f64,
) -> Option<Push> {
    let centre = carrier.origin + carrier.axes * sphere.centre;
    let arm = centre - ground.origin;
    let extent = surface.shape.extent() + sphere.radius;
    if arm.norm_squared() > extent * extent {
        return None;
    }
    let (gap, direction) = surface.shape.gap(&ground.axes.tr_mul(&arm));
    let gap = gap - sphere.radius;
    if gap >= 0.0 {
        return None;
    }
    let axes: &Matrix3<f64> = &ground.axes;
    let normal = axes * direction;
    let touch = centre - sphere.radius * normal;
    let approach = carrier.velocity_at(&centre) - ground.velocity_at(&centre);
    let size = surface.material.normal([gap; 2], normal.dot(&approach));
    let rate = axes.tr_mul(&(carrier.velocity_at(&touch) - ground.velocity_at(&touch))) - surface.belt;
    let rate = along(&rate, &direction);
    let bristle = along(bristle, &direction) + rate * dt;
    let (drag, bristle) = surface.material.drag(size, bristle, Vector3::zeros(), rate);
    Some(Push { centre, normal: normal * size, touch, drag: axes * drag, bristle })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crossing_a_box_from_face_to_face_is_no_force() {
        // A fast point crosses a plate of 20 mm, in various directions, from depth to the same depth.
        let half = [0.2, 0.1, 0.01];
        let material = Material { stiffness: 1e5, damping: 300.0, friction: 0.5 };
        let surface = Surface { shape: Shape::Box { half }, material, belt: Vector3::zeros() };
        let plate = Motion::standing(Vector3::zeros(), Matrix3::identity());
        for depth in [1e-3, 5e-3] {
            let height = half[2] - depth;
            let point = Sphere { centre: Vector3::zeros(), radius: 0.0 };
            let carrier = Motion {
                origin: [Vector3::new(0.0, 0.0, height), Vector3::new(0.0, 0.0, -height)],
                ..Motion::standing(Vector3::zeros(), Matrix3::identity())
            };
            let bristle = Vector3::new(1e-4, 0.0, 0.0);
            let push = over_step(&point, &carrier, &surface, &plate, &bristle, 1e-4).expect("a contact");
            let finite = push.drag.iter().chain(&push.bristle).chain(&push.normal).all(|value| value.is_finite());
            assert!(finite && push.normal.norm() < 1e-9, "{push:?}");
        }
    }
}
