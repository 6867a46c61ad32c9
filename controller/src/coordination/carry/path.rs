//! Path of a carried object: straight legs and rotations about the vertical axis.

use nalgebra::{Translation3, UnitQuaternion, Vector3, Vector4};

use super::CarryError;
use crate::generator::Pose;
use crate::path::PoseState;

/// Speed and acceleration of an object and of its grips. Both are finite and above 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectLimits {
    /// Greatest speed of the object's origin, m/s.
    pub velocity: f64,
    /// Greatest acceleration of the object's origin along a leg, m/s².
    pub acceleration: f64,
    /// Distance of the outermost grip from the origin, m. The speed of this grip by the rotation about the origin is at
    /// most `velocity`.
    pub radius: f64,
}

/// Path of an upright object through places. The object stops at each place.
///
/// On each leg, position and yaw change in proportion. The speed rises as a cubic of the time, stays, and falls.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectPath {
    legs: Vec<Leg>,
    last: Vector4<f64>,
    duration: f64,
}

/// A straight motion from rest to rest. Places are x, y, z, m, and yaw, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Leg {
    from: Vector4<f64>,
    to: Vector4<f64>,
    /// Time of the start, s.
    begin: f64,
    /// Duration of the acceleration, s.
    ramp: f64,
    /// Duration of the whole leg, s.
    duration: f64,
}

impl ObjectPath {
    /// A path through places in the frame of the cell: x, y, z, m, and yaw, rad. Fails if there are fewer than two
    /// places, if two neighbours are equal, or if a number is invalid.
    pub fn through(places: &[[f64; 4]], limits: &ObjectLimits) -> Result<Self, CarryError> {
        let ObjectLimits { velocity, acceleration, radius } = *limits;
        for (limit, value) in [("velocity", velocity), ("acceleration", acceleration), ("radius", radius)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(CarryError::Limit { limit, value });
            }
        }
        let [_, _, ..] = places else {
            return Err(CarryError::Places { given: places.len() });
        };
        let mut legs = Vec::with_capacity(places.len() - 1);
        let mut begin = 0.0;
        for (number, pair) in places.windows(2).enumerate() {
            let (from, to) = (Vector4::from(pair[0]), Vector4::from(pair[1]));
            let by = to - from;
            let length = by.xyz().norm().max(radius * by.w.abs());
            if !(length > 0.0 && length.is_finite()) {
                return Err(CarryError::Leg { number });
            }
            // The greatest acceleration of a cubic ramp is 1.5 times the mean.
            let speed = velocity.min((length * acceleration / 1.5).sqrt());
            let ramp = 1.5 * speed / acceleration;
            let duration = ramp + length / speed;
            legs.push(Leg { from, to, begin, ramp, duration });
            begin += duration;
        }
        let last = legs.last().map_or_else(Vector4::zeros, |leg| leg.to);
        Ok(Self { legs, last, duration: begin })
    }

    /// Duration, s.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Pose, velocities and accelerations of the object `time` seconds after the start, in the frame of the cell. After
    /// the end of the path, the object stands.
    pub fn at(&self, time: f64) -> PoseState {
        let Some(leg) = self.legs.iter().find(|leg| time < leg.begin + leg.duration) else {
            return state(self.last, Vector4::zeros(), Vector4::zeros());
        };
        let [share, rate, change] = leg.progress((time - leg.begin).max(0.0));
        let by = leg.to - leg.from;
        state(leg.from + share * by, rate * by, change * by)
    }

    /// Distance of a point from the path of the origin, m.
    pub fn distance(&self, point: &Vector3<f64>) -> f64 {
        let from_leg = |leg: &Leg| {
            let (from, by) = (leg.from.xyz(), leg.to.xyz() - leg.from.xyz());
            let length = by.norm_squared();
            let share = if length > 0.0 { ((point - from).dot(&by) / length).clamp(0.0, 1.0) } else { 0.0 };
            (point - from - share * by).norm()
        };
        self.legs.iter().map(from_leg).fold(f64::INFINITY, f64::min)
    }
}

impl Leg {
    /// Share of the leg, 0 to 1, after `time` seconds of it, and its first two derivatives by time.
    fn progress(&self, time: f64) -> [f64; 3] {
        let &Self { ramp, duration, .. } = self;
        let speed = 1.0 / (duration - ramp);
        let rising = |t: f64| {
            let u = t / ramp;
            let way = speed * ramp * (u.powi(3) - 0.5 * u.powi(4));
            [way, speed * u * u * (3.0 - 2.0 * u), speed / ramp * 6.0 * u * (1.0 - u)]
        };
        if time < ramp {
            rising(time)
        } else if time <= duration - ramp {
            [speed * (time - 0.5 * ramp), speed, 0.0]
        } else {
            let [way, rate, change] = rising((duration - time).max(0.0));
            [1.0 - way, rate, -change]
        }
    }
}

fn state(place: Vector4<f64>, rate: Vector4<f64>, change: Vector4<f64>) -> PoseState {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), place.w);
    PoseState {
        pose: Pose::from_parts(Translation3::from(place.xyz()), turn),
        linear: rate.xyz(),
        angular: Vector3::z() * rate.w,
        linear_acceleration: change.xyz(),
        angular_acceleration: Vector3::z() * change.w,
    }
}
