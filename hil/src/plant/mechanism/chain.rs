//! Rigid links on revolute joints, and what they are to a motor that turns some of the joints.

/// Free fall, m/s².
pub(super) const GRAVITY: f64 = 9.81;

pub(super) type Vector = [f64; 3];

pub(super) fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn cross(a: Vector, b: Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// `a + factor · b`.
pub(super) fn add(a: Vector, factor: f64, b: Vector) -> Vector {
    [
        a[0] + factor * b[0],
        a[1] + factor * b[1],
        a[2] + factor * b[2],
    ]
}

/// A mass with its centre and its spread: half of it sits `spread` to either side of the centre, which for a
/// rod of length l is l / √12.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body {
    /// kg.
    pub(super) mass: f64,
    /// m.
    pub(super) centre: Vector,
    /// m.
    pub(super) spread: Vector,
}

impl Body {
    pub(super) const NONE: Self = Self::point(0.0, [0.0; 3]);

    pub(super) const fn point(mass: f64, centre: Vector) -> Self {
        Self {
            mass,
            centre,
            spread: [0.0; 3],
        }
    }

    /// A uniform rod from the origin of its frame to `end`.
    pub(super) fn rod(mass: f64, end: Vector) -> Self {
        Self {
            mass,
            centre: end.map(|x| 0.5 * x),
            spread: end.map(|x| x / 12_f64.sqrt()),
        }
    }

    /// What it is to whatever moves its frame so.
    pub(super) fn load(&self, motion: &Motion) -> Load {
        let velocity = add(motion.velocity, 1.0, cross(motion.spin, self.centre));
        let around = cross(motion.spin, self.spread);
        Load {
            torque: -GRAVITY * self.mass * dot(motion.up, velocity),
            inertia: self.mass * (dot(velocity, velocity) + dot(around, around)),
        }
    }
}

/// How a frame moves while a motor turns at 1 rad/s, and where it is upright; all in the frame's own axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    /// Unit vector against gravity.
    pub(super) up: Vector,
    /// rad/s.
    pub(super) spin: Vector,
    /// Of the frame's origin, m/s.
    pub(super) velocity: Vector,
}

impl Motion {
    /// A frame that stands.
    pub(super) const fn standing(up: Vector) -> Self {
        Self {
            up,
            spin: [0.0; 3],
            velocity: [0.0; 3],
        }
    }
}

/// What hangs on a motor, at its shaft.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Load {
    /// Of weight, N·m.
    pub torque: f64,
    /// kg·m².
    pub inertia: f64,
}

impl Load {
    pub(super) fn and(self, other: Self) -> Self {
        Self {
            torque: self.torque + other.torque,
            inertia: self.inertia + other.inertia,
        }
    }
}

/// A joint and the link behind it, by Denavit and Hartenberg: turn about z, shift `d` along z, shift `a` along
/// the new x, turn by `alpha` about it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Link {
    /// Of `alpha`: sine and cosine.
    twist: (f64, f64),
    /// From the frame before to this one, in this one, m.
    reach: Vector,
    /// In this frame.
    body: Body,
    /// The last angle of the joint, rad, its sine and its cosine: between two turns of one motor most joints stand.
    turn: (f64, (f64, f64)),
}

impl Link {
    /// Lengths in m, `alpha` in quarter turns, so that it is exact.
    pub(super) fn new(d: f64, a: f64, alpha: i8, body: Body) -> Self {
        let twist = match alpha {
            1 => (1.0, 0.0),
            -1 => (-1.0, 0.0),
            _ => (0.0, 1.0),
        };
        Self {
            twist,
            reach: [a, d * twist.0, d * twist.1],
            body,
            turn: (0.0, (0.0, 1.0)),
        }
    }

    /// The same with a uniform rod from the frame before to this one.
    pub(super) fn rod(d: f64, a: f64, alpha: i8, mass: f64) -> Self {
        let link = Self::new(d, a, alpha, Body::NONE);
        // The rod begins where the frame before is, which this one sees at `-reach`.
        let body = Body::rod(mass, link.reach.map(|x| -x));
        Self { body, ..link }
    }

    fn turn(&mut self, angle: f64) -> (f64, f64) {
        if angle != self.turn.0 {
            self.turn = (angle, angle.sin_cos());
        }
        self.turn.1
    }

    /// A vector in the frame before, as this one sees it.
    fn turned(&self, (sin, cos): (f64, f64), [x, y, z]: Vector) -> Vector {
        let (s, c) = self.twist;
        let across = cos * y - sin * x;
        [cos * x + sin * y, c * across + s * z, c * z - s * across]
    }
}

/// Links one after another, with a payload on the last.
#[derive(Clone, Debug)]
pub(super) struct Chain<const N: usize> {
    pub(super) links: [Link; N],
    pub(super) payload: Body,
}

impl<const N: usize> Chain<N> {
    /// What it is to a motor which, at 1 rad/s, moves the base so and turns the joints, which are at `angles`,
    /// at `rates`.
    pub(super) fn load(&mut self, base: &Motion, angles: &[f64; N], rates: &[f64; N]) -> Load {
        let mut motion = *base;
        let mut load = Load::default();
        for ((link, angle), rate) in self.links.iter_mut().zip(angles).zip(rates) {
            let angle = link.turn(*angle);
            motion.spin[2] += rate;
            motion.up = link.turned(angle, motion.up);
            motion.spin = link.turned(angle, motion.spin);
            motion.velocity = link.turned(angle, motion.velocity);
            motion.velocity = add(motion.velocity, 1.0, cross(motion.spin, link.reach));
            load = load.and(link.body.load(&motion));
        }
        load.and(self.payload.load(&motion))
    }
}
