//! Subproblems of Paden and Kahan: angles of one rotation that fulfil one condition.

use nalgebra::{Rotation3, Unit, Vector3};

/// Distance of a vector from an axis, or amplitude of a condition, below which the angle counts as open.
const OPEN: f64 = 1e-10;

/// Relative excess of a condition beyond its amplitude up to which the nearest angle is tried.
const EXCESS: f64 = 1e-4;

/// Angles that fulfil a condition.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Roots {
    /// Two angles, equal at the edge of the range.
    Two([f64; 2]),
    /// Any angle fulfils the condition.
    Open,
    /// No angle fulfils the condition.
    None,
}

impl Roots {
    /// The angles. If any angle fulfils the condition, returns `near` and sets `open`.
    pub(super) fn or_near(self, near: f64, open: &mut bool) -> impl Iterator<Item = f64> + use<> {
        let (angles, count) = match self {
            Self::Two(angles) if angles[0] == angles[1] => (angles, 1),
            Self::Two(angles) => (angles, 2),
            Self::Open => {
                *open = true;
                ([near; 2], 1)
            }
            Self::None => ([near; 2], 0),
        };
        angles.into_iter().take(count)
    }
}

/// A vector turned about a unit vector.
pub(super) fn turned(axis: &Vector3<f64>, angle: f64, vector: &Vector3<f64>) -> Vector3<f64> {
    let (sin, cos) = angle.sin_cos();
    vector * cos + axis.cross(vector) * sin + axis * (axis.dot(vector) * (1.0 - cos))
}

/// A rotation about a unit vector.
pub(super) fn rotation(axis: &Vector3<f64>, angle: f64) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Unit::new_unchecked(*axis), angle)
}

/// A unit vector across a unit vector.
pub(super) fn across(axis: &Vector3<f64>) -> Vector3<f64> {
    let least = axis.iamin();
    let mut across = -axis * axis[least];
    across[least] += 1.0;
    across.normalize()
}

/// The angle about `axis` from one vector to another, both seen along the axis. `None` if one of the vectors lies on
/// the axis.
pub(super) fn angle(axis: &Vector3<f64>, from: &Vector3<f64>, to: &Vector3<f64>) -> Option<f64> {
    let (from, to) = (from - axis * axis.dot(from), to - axis * axis.dot(to));
    let (sin, cos) = (axis.dot(&from.cross(&to)), from.dot(&to));
    (sin * sin + cos * cos > OPEN.powi(4)).then(|| sin.atan2(cos))
}

/// The angles about `axis` by which `vector` turns to a vector whose product with `with` is `product`.
pub(super) fn product(axis: &Vector3<f64>, with: &Vector3<f64>, vector: &Vector3<f64>, product: f64) -> Roots {
    let along = axis * axis.dot(vector);
    let (a, b) = (with.dot(&(vector - along)), with.dot(&axis.cross(vector)));
    let (c, square) = (product - with.dot(&along), a * a + b * b);
    let amplitude = square.sqrt();
    if amplitude < OPEN {
        return if c.abs() < OPEN { Roots::Open } else { Roots::None };
    }
    if c.abs() > amplitude * (1.0 + EXCESS) {
        return Roots::None;
    }
    let (middle, half) = (b.atan2(a), (square - c * c).max(0.0).sqrt().atan2(c));
    Roots::Two([middle + half, middle - half])
}

/// The angles about `axis` by which `vector` turns to a vector at this distance from `from`.
pub(super) fn distance(axis: &Vector3<f64>, vector: &Vector3<f64>, from: &Vector3<f64>, distance: f64) -> Roots {
    let squares = vector.norm_squared() + from.norm_squared() - distance * distance;
    product(axis, from, vector, 0.5 * squares)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn each_angle_fulfils_its_condition_and_the_given_angle_is_among_the_angles() {
        let mut random = Random(7);
        for _ in 0..1_000 {
            let mut any = || Vector3::from_fn(|_, _| random.within(-1.0, 1.0));
            let (axis, vector, with) = (any().normalize(), any(), any());
            let sought = 2.0 * any().x;
            let moved = turned(&axis, sought, &vector);
            assert!((rotation(&axis, sought) * vector - moved).norm() < 1e-15);
            assert!((angle(&axis, &vector, &moved).unwrap() - sought).abs() < 1e-12);
            let length = (moved - with).norm();
            let found = product(&axis, &with, &vector, with.dot(&moved));
            for roots in [found, distance(&axis, &vector, &with, length)] {
                let Roots::Two(angles) = roots else { panic!("{roots:?}") };
                assert!(angles.iter().any(|angle| (turned(&axis, *angle, &vector) - moved).norm() < 1e-6));
                for angle in angles {
                    assert!(((turned(&axis, angle, &vector) - with).norm() - length).abs() < 1e-7);
                }
            }
        }
    }

    #[test]
    fn vectors_on_the_axis_leave_the_angle_open() {
        let (z, x) = (Vector3::z(), Vector3::x());
        assert_eq!(angle(&z, &z, &x), None);
        assert_eq!(product(&z, &x, &z, 0.0), Roots::Open);
        assert_eq!(product(&z, &x, &z, 0.5), Roots::None);
        assert_eq!(product(&z, &x, &x, 1.5), Roots::None);
        let mut open = false;
        assert_eq!(Roots::Open.or_near(0.3, &mut open).collect::<Vec<_>>(), [0.3]);
        assert!(open);
        assert_eq!(product(&z, &x, &x, 1.0).or_near(0.0, &mut open).count(), 1);
    }
}
