//! View of sensors at a distance: rays and cones to the surfaces of a scene.

use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{Isometry3, Point3, Unit, Vector3};

use super::{BodyId, BodyProbe, Scene, Shape};

/// Number of rays on the surface of a cone.
const RAYS: usize = 64;

/// Steps of the refinement between two rays. Each step reduces the interval to two thirds.
const REFINEMENTS: usize = 24;

/// Greatest angle between the axis of a cone and the normal of a face, rad: a wave that meets a face at a greater angle is
/// not reflected to its source.
const STEEPEST: f64 = 30.0 * std::f64::consts::PI / 180.0;

/// The walls and bodies of a scene, for the emulated sensors outside the scene. Clones see the same scene.
///
/// Bodies are seen in their place at the last step of the scene. A body that is placed while the scene runs is seen
/// from its first step on. Tools and links of robots are not seen.
#[derive(Clone, Debug)]
pub struct View {
    walls: Vec<(Shape, Isometry3<f64>)>,
    /// Whether each wall is a plane or a belt.
    grounds: Vec<bool>,
    /// The bodies; `None` in a view without a scene.
    bodies: Option<SeenBodies>,
}

/// The bodies of a scene in the order of their numbers, for its views. Clones are the same list.
#[derive(Clone, Debug, Default)]
pub(super) struct SeenBodies(Arc<Mutex<Vec<(Shape, BodyProbe)>>>);

impl SeenBodies {
    fn push(&self, shape: Shape, probe: BodyProbe) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push((shape, probe));
    }

    /// Calls `visit` with each body and its present place.
    fn each(&self, mut visit: impl FnMut(&Shape, &Isometry3<f64>)) {
        let bodies = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        bodies.iter().for_each(|(shape, probe)| visit(shape, &probe.state().pose));
    }
}

/// The point at which a ray meets a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance from the origin of the ray, m.
    pub distance: f64,
    /// Unit vector out of the surface, in the axes of the world.
    pub normal: Vector3<f64>,
    /// Number of the surface: the walls in their order, then the bodies in theirs.
    pub surface: usize,
}

impl Scene {
    /// A view of the present walls, and of all bodies, including those that are added later. Walls that are added later
    /// are not seen.
    pub fn view(&mut self) -> View {
        if self.seen.is_none() {
            self.seen = Some(SeenBodies::default());
            (0..self.bodies.len()).for_each(|body| self.show_to_views(BodyId(body)));
        }
        let place = |wall: &super::Wall| {
            let turn = nalgebra::Rotation3::from_matrix_unchecked(wall.moving.axes);
            (wall.surface.shape, Isometry3::from_parts(wall.moving.origin.into(), turn.into()))
        };
        let ground = |wall: &super::Wall| {
            let surface = &wall.surface;
            let driven = wall.belt.is_some() || wall.drift.is_some() || surface.belt != Vector3::zeros();
            driven || surface.shape == Shape::HalfSpace
        };
        let grounds = self.walls.iter().map(ground).collect();
        View { walls: self.walls.iter().map(place).collect(), grounds, bodies: self.seen.clone() }
    }

    /// Adds a body to the views of this scene, if there are any.
    pub(super) fn show_to_views(&mut self, body: BodyId) {
        if let Some(seen) = self.seen.clone() {
            seen.push(self.bodies[body.0].surface.shape, self.watch(body));
        }
    }
}

impl View {
    /// A view without any surface.
    pub const EMPTY: Self = Self { walls: Vec::new(), grounds: Vec::new(), bodies: None };

    /// Calls `visit` with each surface and its present place: the walls, then the bodies.
    fn each(&self, mut visit: impl FnMut(&Shape, &Isometry3<f64>)) {
        self.walls.iter().for_each(|(shape, pose)| visit(shape, pose));
        if let Some(bodies) = &self.bodies {
            bodies.each(visit);
        }
    }

    /// Whether surface `surface` of a [`Hit`] is a plane or a belt, on which objects stand.
    pub fn is_ground(&self, surface: usize) -> bool {
        self.grounds.get(surface).is_some_and(|ground| *ground)
    }

    /// The first surface on a ray from `origin` along `direction`, in the world.
    pub fn ray(&self, origin: &Point3<f64>, direction: &Unit<Vector3<f64>>) -> Option<Hit> {
        let (mut first, mut surface): (Option<Hit>, _) = (None, 0);
        self.each(|shape, pose| {
            let (from, along) = (pose.inverse_transform_point(origin), pose.inverse_transform_vector(direction));
            if let Some((distance, normal)) = meets(shape, &from, &along)
                && first.is_none_or(|first| distance < first.distance)
            {
                first = Some(Hit { distance, normal: pose * normal, surface });
            }
            surface += 1;
        });
        first
    }

    /// Distance from `apex` to the nearest point of a surface in a cone, m; `None` if the cone meets no surface that
    /// reflects to its apex. `axis`: direction of the cone in the world. `half_cone`: half its opening angle, rad.
    ///
    /// A face reflects if its normal is within 30° of the axis. The edges of such a face reflect like the face.
    pub fn nearest_in_cone(&self, apex: &Point3<f64>, axis: &Unit<Vector3<f64>>, half_cone: f64) -> Option<f64> {
        let mut least: Option<f64> = None;
        self.each(|shape, pose| {
            let (apex, axis) = (pose.inverse_transform_point(apex), pose.inverse_transform_vector(axis));
            if let Some(distance) = nearest(shape, &apex, &axis, half_cone) {
                least = Some(least.map_or(distance, |least| least.min(distance)));
            }
        });
        least
    }
}

/// Distance of the first point of a shape on a ray, and the normal there, in the frame of the shape.
fn meets(shape: &Shape, from: &Point3<f64>, along: &Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
    match shape {
        Shape::HalfSpace => {
            if from.z <= 0.0 {
                return Some((0.0, Vector3::z()));
            }
            (along.z < 0.0).then(|| (from.z / -along.z, Vector3::z()))
        }
        Shape::Box { half } => {
            let (mut enter, mut leave, mut face) = (0.0_f64, f64::INFINITY, 0);
            for axis in 0..3 {
                let (start, speed) = (from[axis], along[axis]);
                if speed.abs() < 1e-12 {
                    if start.abs() > half[axis] {
                        return None;
                    }
                    continue;
                }
                let near = (-half[axis].copysign(speed) - start) / speed;
                let far = (half[axis].copysign(speed) - start) / speed;
                if near > enter {
                    (enter, face) = (near, axis);
                }
                leave = leave.min(far);
            }
            let mut normal = Vector3::zeros();
            normal[face] = -1.0_f64.copysign(along[face]);
            (enter <= leave).then_some((enter, normal))
        }
    }
}

/// Distance to the nearest point of a face in a cone, in the frame of the shape.
fn nearest(shape: &Shape, apex: &Point3<f64>, axis: &Vector3<f64>, half_cone: f64) -> Option<f64> {
    let reflects = |normal: &Vector3<f64>| normal.angle(&-axis) <= STEEPEST;
    match shape {
        Shape::HalfSpace => {
            let on_plane = |point: &Point3<f64>| Point3::new(point.x, point.y, point.z.min(0.0));
            reflects(&Vector3::z()).then(|| nearest_of(shape, apex, &on_plane(apex), axis, half_cone))?
        }
        Shape::Box { half } => {
            let faces = (0..3).filter_map(|number| {
                // The face towards the apex.
                let sign = 1.0_f64.copysign(apex[number]);
                let mut normal = Vector3::zeros();
                normal[number] = sign;
                if apex[number].abs() < half[number] || !reflects(&normal) {
                    return None;
                }
                let mut face = *half;
                face[number] = 0.0;
                let apex = apex - normal * half[number];
                let foot = Point3::from(Vector3::from_fn(|row, _| apex[row].clamp(-face[row], face[row])));
                nearest_of(&Shape::Box { half: face }, &apex, &foot, axis, half_cone)
            });
            faces.min_by(f64::total_cmp)
        }
    }
}

/// Distance to the nearest point of a convex shape in a cone. `foot`: the nearest point of the shape.
fn nearest_of(
    shape: &Shape,
    apex: &Point3<f64>,
    foot: &Point3<f64>,
    axis: &Vector3<f64>,
    half_cone: f64,
) -> Option<f64> {
    let way = foot - apex;
    if way.norm() == 0.0 || way.angle(axis) <= half_cone {
        return Some(way.norm());
    }
    // The nearest point is then on the surface of the cone.
    let side = axis.cross(&if axis.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() }).normalize();
    let other = axis.cross(&side);
    let (sine, cosine) = half_cone.sin_cos();
    let distance = |angle: f64| {
        let along = axis * cosine + (side * angle.cos() + other * angle.sin()) * sine;
        meets(shape, apex, &along).map_or(f64::INFINITY, |(distance, _)| distance)
    };
    let spacing = std::f64::consts::TAU / RAYS as f64;
    let best = (0..RAYS).map(|ray| ray as f64 * spacing).min_by(|a, b| distance(*a).total_cmp(&distance(*b)))?;
    let (mut low, mut high) = (best - spacing, best + spacing);
    for _ in 0..REFINEMENTS {
        let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if distance(a) <= distance(b) { high = b } else { low = a }
    }
    let found = distance(best).min(distance(0.5 * (low + high)));
    found.is_finite().then_some(found)
}

#[cfg(test)]
mod tests {
    use super::super::{BodyConfig, Material, STEP, WallConfig};
    use super::*;

    /// A cube of 0.1 m on the floor at `x`.
    fn cube(x: f64) -> BodyConfig {
        BodyConfig {
            mass: 1.0,
            half: [0.05; 3],
            material: Material::NOMINAL,
            pose: Isometry3::translation(x, 0.0, 0.05),
            velocity: [0.0; 3],
            spin: [0.0; 3],
        }
    }

    /// A floor at z = 0 and a cube of 0.1 m on it, 0.2 m along x.
    fn view() -> (Scene, View) {
        let mut scene = Scene::new();
        let floor = WallConfig { shape: Shape::HalfSpace, pose: Isometry3::identity(), material: Material::NOMINAL };
        scene.add_wall(&floor).unwrap();
        scene.add_body(&cube(0.2)).unwrap();
        let view = scene.view();
        (scene, view)
    }

    #[test]
    fn a_ray_meets_the_first_surface() {
        let (_scene, view) = view();
        let ray = |origin: [f64; 3], along: [f64; 3]| {
            view.ray(&Point3::from(origin), &Unit::new_normalize(Vector3::from(along)))
        };
        for (x, distance, surface) in [(0.0, 1.0, 0), (0.2, 0.9, 1)] {
            let hit = ray([x, 0.0, 1.0], [0.0, 0.0, -1.0]).unwrap();
            assert!((hit.distance - distance).abs() < 1e-12, "{hit:?}");
            assert_eq!((hit.normal, hit.surface), (Vector3::z(), surface));
        }
        let from_side = ray([0.0, 0.0, 0.05], [1.0, 0.0, 0.0]).unwrap();
        assert!((from_side.distance - 0.15).abs() < 1e-12 && from_side.surface == 1);
        assert_eq!(from_side.normal, Vector3::new(-1.0, 0.0, 0.0));
        assert_eq!(ray([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]), None);
        assert_eq!(View::EMPTY.ray(&Point3::origin(), &Vector3::z_axis()), None);
    }

    #[test]
    fn bodies_placed_after_the_view_was_made_are_seen_from_their_first_step_on() {
        let (mut scene, view) = view();
        let clone = view.clone();
        scene.place_body(scene.now() + 2 * STEP, &cube(0.5)).unwrap();
        let down = -Vector3::z_axis();
        let above = |x: f64| Point3::new(x, 0.0, 0.4);
        for step in 0..5 {
            for view in [&view, &clone, &scene.view()] {
                // The cube is placed at the beginning of the third step, and sinks into the floor by its weight.
                let (surface, distance) = if step < 3 { (0, 0.4) } else { (2, 0.3) };
                let hit = view.ray(&above(0.5), &down).unwrap();
                assert_eq!(hit.surface, surface, "after {step} steps");
                assert!((hit.distance - distance).abs() < 1e-5, "after {step} steps: {hit:?}");
                let nearest = view.nearest_in_cone(&above(0.5), &down, 0.1).unwrap();
                assert!((nearest - distance).abs() < 1e-5, "after {step} steps: {nearest} m");
                assert!(!view.is_ground(2));
                assert_eq!(view.ray(&above(0.2), &down).unwrap().surface, 1, "the other cube");
            }
            scene.step();
        }
        let later = scene.add_body(&cube(0.8)).unwrap();
        assert_eq!((later, view.ray(&above(0.8), &down).unwrap().surface), (BodyId(2), 3));
    }

    #[test]
    fn a_cone_sees_the_nearest_face_or_edge_within_it() {
        let (_scene, view) = view();
        let half = 8.0_f64.to_radians();
        let down = -Vector3::z_axis();
        // At 0.3 m over the top face the cone has a radius of 42.2 mm.
        let radius = 0.3 * half.tan();
        let cases = [
            // Place along x, distance.
            (0.2, 0.3),
            (0.151, 0.3),
            (0.14, 0.3_f64.hypot(0.01)),
            (0.15 - 0.99 * radius, 0.3_f64.hypot(0.99 * radius)),
            (0.15 - 1.01 * radius, 0.4),
            (-0.5, 0.4),
        ];
        for (x, distance) in cases {
            let found = view.nearest_in_cone(&Point3::new(x, 0.0, 0.4), &down, half).unwrap();
            assert!((found - distance).abs() < 1e-6, "at {x}: {found} m, not {distance} m");
        }
        // Beside a corner, both distances count.
        let beside = 0.025;
        let found = view.nearest_in_cone(&Point3::new(0.15 - beside, 0.05 + beside, 0.4), &down, half).unwrap();
        assert!((found - (0.3_f64.powi(2) + 2.0 * beside * beside).sqrt()).abs() < 1e-6, "{found}");
    }

    #[test]
    fn a_tilted_cone_sees_a_plane_up_to_30_degrees() {
        let (_scene, view) = view();
        let half = 8.0_f64.to_radians();
        for (degrees, seen) in [(5.0_f64, true), (20.0, true), (29.9, true), (30.1, false), (90.0, false)] {
            let tilt = degrees.to_radians();
            let axis = Unit::new_normalize(Vector3::new(-tilt.sin(), 0.0, -tilt.cos()));
            let found = view.nearest_in_cone(&Point3::new(-1.0, 0.0, 1.0), &axis, half);
            let distance = 1.0 / (tilt - half).max(0.0).cos();
            match found {
                Some(found) => assert!(seen && (found - distance).abs() < 1e-6, "{degrees}°: {found} m"),
                None => assert!(!seen, "{degrees}°"),
            }
        }
        assert_eq!(View::EMPTY.nearest_in_cone(&Point3::origin(), &-Vector3::z_axis(), half), None);
    }
}
