//! Rigid links on revolute joints, and their load on a motor that turns some of the joints.

use nalgebra::{Matrix3, Vector3};

use super::kinematics::{Frame, Twist};

pub(super) type Vector = Vector3<f64>;

/// Free fall, m/s².
pub(super) const GRAVITY: f64 = 9.81;

/// A mass with its centre and its spread. Half of the mass lies at the distance `spread` on either side of the
/// centre. For a rod of length l the spread is l / √12.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body {
    /// Mass, kg.
    pub(super) mass: f64,
    /// Centre of mass, m.
    pub(super) centre: Vector,
    /// Spread, m.
    pub(super) spread: Vector,
}

impl Body {
    pub(super) const NONE: Self = Self::point(0.0, [0.0; 3]);

    pub(super) const fn point(mass: f64, [x, y, z]: [f64; 3]) -> Self {
        Self { mass, centre: Vector::new(x, y, z), spread: Vector::new(0.0, 0.0, 0.0) }
    }

    /// A uniform rod from the origin of its frame to `end`.
    pub(super) fn rod(mass: f64, end: Vector) -> Self {
        Self { mass, centre: 0.5 * end, spread: end / 12_f64.sqrt() }
    }

    /// Load on a motor that moves the body's frame with `motion`.
    pub(super) fn load(&self, motion: &Motion) -> Load {
        let velocity = motion.velocity + motion.spin.cross(&self.centre);
        let around = motion.spin.cross(&self.spread);
        Load {
            torque: -GRAVITY * self.mass * motion.up.dot(&velocity),
            inertia: self.mass * (velocity.dot(&velocity) + around.dot(&around)),
        }
    }
}

/// Motion of a frame while a motor turns at 1 rad/s, and its upward direction, in the frame's own axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    /// Unit vector against gravity.
    pub(super) up: Vector,
    /// Angular velocity, rad/s.
    pub(super) spin: Vector,
    /// Velocity of the frame's origin, m/s.
    pub(super) velocity: Vector,
}

impl Motion {
    /// A frame at rest.
    pub(super) fn standing(up: Vector) -> Self {
        Self { up, spin: Vector::zeros(), velocity: Vector::zeros() }
    }
}

/// Load of a motor, at its shaft.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Load {
    /// Torque of the weight, N·m.
    pub torque: f64,
    /// Inertia, kg·m².
    pub inertia: f64,
}

impl Load {
    pub(super) fn and(self, other: Self) -> Self {
        Self { torque: self.torque + other.torque, inertia: self.inertia + other.inertia }
    }
}

/// A joint and the link behind it, by Denavit and Hartenberg: rotate about z, shift `d` along z, shift `a` along the
/// new x, rotate by `alpha` about the new x.
#[derive(Clone, Copy, Debug)]
pub(super) struct Link {
    /// Sine and cosine of `alpha`.
    twist: (f64, f64),
    /// Vector from the origin of the previous frame to the origin of this frame, in this frame, m.
    reach: Vector,
    body: Body,
    /// The last angle of the joint, rad, and its sine and cosine. Most joints stand still between two turns of one
    /// motor, so the values are kept.
    turn: (f64, (f64, f64)),
}

impl Link {
    /// Lengths are in m. `alpha` is in quarter turns, so that its sine and cosine are exact.
    pub(super) fn new(d: f64, a: f64, alpha: i8, body: Body) -> Self {
        let twist = match alpha {
            1 => (1.0, 0.0),
            -1 => (-1.0, 0.0),
            _ => (0.0, 1.0),
        };
        Self { twist, reach: Vector::new(a, d * twist.0, d * twist.1), body, turn: (0.0, (0.0, 1.0)) }
    }

    /// A link with a uniform rod from the previous frame to this frame.
    pub(super) fn rod(d: f64, a: f64, alpha: i8, mass: f64) -> Self {
        let link = Self::new(d, a, alpha, Body::NONE);
        // The rod begins at the origin of the previous frame, which lies at `-reach` in this frame.
        let body = Body::rod(mass, -link.reach);
        Self { body, ..link }
    }

    fn turn(&mut self, angle: f64) -> (f64, f64) {
        if angle != self.turn.0 {
            self.turn = (angle, angle.sin_cos());
        }
        self.turn.1
    }

    /// Converts a vector from the previous frame to this frame.
    fn turned(&self, (sin, cos): (f64, f64), vector: Vector) -> Vector {
        let [x, y, z] = vector.into();
        let (s, c) = self.twist;
        let across = cos * y - sin * x;
        Vector::new(cos * x + sin * y, c * across + s * z, c * z - s * across)
    }

    /// Axes of this frame, as columns, from the axes of the previous frame.
    fn axes(&self, (sin, cos): (f64, f64), previous: &Matrix3<f64>) -> Matrix3<f64> {
        let (s, c) = self.twist;
        let (x, y, z) = (previous.column(0), previous.column(1), previous.column(2));
        let across = y * cos - x * sin;
        Matrix3::from_columns(&[x * cos + y * sin, across * c + z * s, z * c - across * s])
    }
}

/// Links in series, with a payload on the last link.
#[derive(Clone, Debug)]
pub(super) struct Chain<const N: usize> {
    pub(super) links: [Link; N],
    pub(super) payload: Body,
}

impl<const N: usize> Chain<N> {
    /// Greatest distance of the last frame from any joint, m.
    pub(super) fn length(&self) -> f64 {
        self.links.iter().map(|link| link.reach.norm()).sum()
    }

    /// Load on a motor that, at 1 rad/s, moves the base with `base` and turns the joints, at `angles`, at `rates`.
    pub(super) fn load(&mut self, base: &Motion, angles: &[f64; N], rates: &[f64; N]) -> Load {
        let mut motion = *base;
        let mut load = Load::default();
        for ((link, angle), rate) in self.links.iter_mut().zip(angles).zip(rates) {
            let angle = link.turn(*angle);
            motion.spin[2] += rate;
            motion.up = link.turned(angle, motion.up);
            motion.spin = link.turned(angle, motion.spin);
            motion.velocity = link.turned(angle, motion.velocity);
            motion.velocity += motion.spin.cross(&link.reach);
            load = load.and(link.body.load(&motion));
        }
        load.and(self.payload.load(&motion))
    }

    /// The last frame of the chain on a `base`, and the motion of that frame per rad/s of each joint. All vectors are
    /// in the axes in which `base` is given.
    pub(super) fn place(&mut self, base: Frame, angles: &[f64; N]) -> (Frame, [Twist; N]) {
        let mut frame = base;
        let mut joints = [(Vector::zeros(), Vector::zeros()); N];
        for ((link, angle), joint) in self.links.iter_mut().zip(angles).zip(&mut joints) {
            let angle = link.turn(*angle);
            *joint = (frame.axes.column(2).into_owned(), frame.origin);
            frame.axes = link.axes(angle, &frame.axes);
            frame.origin += frame.axes * link.reach;
        }
        let motion =
            |(axis, through): (Vector, Vector)| Twist { velocity: axis.cross(&(frame.origin - through)), spin: axis };
        (frame, joints.map(motion))
    }
}
